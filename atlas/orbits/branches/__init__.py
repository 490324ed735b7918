"""Branches of periodic orbits in one parameter, stable and unstable, from one cell or from all cells of a sweep."""
