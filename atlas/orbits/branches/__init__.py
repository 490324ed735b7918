"""Branches of periodic orbits in one parameter, stable and unstable, from a cell or from all cells of a sweep."""
