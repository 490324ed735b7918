"""Solving of one tile on a worker."""
