"""Stability of attractors: decay and growth of deviations, fatal shocks, saddles."""
