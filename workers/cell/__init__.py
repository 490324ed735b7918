"""One cell: its stages, averages and results; many cells at once."""
