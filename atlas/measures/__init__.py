"""Stability measures of all attractors of an atlas, and the margin of each cell to the nearest curve."""
