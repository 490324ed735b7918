"""Exact orbits: the map of many periods and its Jacobian, Newton's method, Floquet multipliers."""
