"""Motion of machines with modes, see model/hybrid.py: modes, guards and resets."""
