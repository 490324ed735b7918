"""The spec of an atlas, its axes, and the geometry of cells on them."""
