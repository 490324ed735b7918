"""Exact orbits of the stroboscopic map, proved by Newton's method, with their multipliers and attraction."""
