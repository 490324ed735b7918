"""Stability of attractors: how fast deviations decay, how far they grow first, and which shocks are fatal."""
