"""One cell: its stages, averages and results. Many cells at a time."""
