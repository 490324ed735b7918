"""An exact orbit of the stroboscopic map: proved by Newton's method, its multipliers, and what falls into it."""
