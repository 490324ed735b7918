"""Stability of attractors: decay and growth of deviations, smallest shocks that lead to another attractor, saddles."""
