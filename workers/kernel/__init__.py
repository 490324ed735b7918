"""The hot path: compiled functions of numbers and arrays, without Python objects."""
