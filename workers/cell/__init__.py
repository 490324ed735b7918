"""The computation of cells, many at once: their stages, averages and results."""
