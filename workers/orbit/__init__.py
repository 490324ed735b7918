"""Exact orbits of the stroboscopic map: proved by Newton's method, their multipliers and attraction."""
