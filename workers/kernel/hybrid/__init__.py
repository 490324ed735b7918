"""Kernels for the motion of machines with modes: modes, guards and reset maps; see ``workers/model/hybrid_modes``."""
