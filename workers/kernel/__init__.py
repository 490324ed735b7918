"""Compiled kernels, the hot path of the solver: functions of numbers and arrays, without Python objects."""
