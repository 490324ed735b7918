"""Kernels for the motion of machines with modes, the sets of linear equations that hold between two events.

Guards are the signals whose ends are events; reset maps are the jumps of the state there. See
``workers/model/hybrid_modes``.
"""
