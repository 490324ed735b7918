"""Compiled kernels, the hot path of the solver: functions of numbers and arrays, without Python objects.

The words of this package:

mode     one set of linear equations of motion, valid between two events, such as free flight
block    one decoupled equation h'' + 2 eta h' + lam h = load of a mode; its state is (h, h')
signal   number computed from the state, such as a distance to a stop; an event is a signal at an end of its range
guard    a signal of a mode that can end the mode
leg      the part of a motion in one mode, from one event to the next
section  the instants t = k T at which the force has one fixed phase, T the forcing period
frame    the tangent vectors that a motion carries along, made orthonormal now and then
lane     a slot of vectorised loops over many cells, which holds one cell at a time
tally    the counts of a motion: impacts, time at rest, evaluations, status
"""
