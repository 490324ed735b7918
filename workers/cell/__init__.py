"""The computation of cells, the machines at the points of a map, many at once: stages, averages and results."""
