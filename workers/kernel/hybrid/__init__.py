"""Motion of machines whose law changes, see model/hybrid.py: modes, guards and resets."""
