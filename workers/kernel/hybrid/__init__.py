"""Kernels for machines with modes, whose law of motion changes by contacts, friction, or with the phase of the force.

A mode is one set of linear equations, valid between two events. Guards are the signals whose ends are events; reset
maps are the jumps of the state there. See ``workers/model/hybrid_modes``.
"""
