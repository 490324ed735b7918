"""A stored cell as an orbit; branches, curves and labels of orbits."""
