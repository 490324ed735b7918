"""Stored cells as orbits; branches, curves and labels of these orbits."""
