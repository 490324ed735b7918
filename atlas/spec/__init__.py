"""What to compute: the spec, its axes, and the geometry of cells on them."""
