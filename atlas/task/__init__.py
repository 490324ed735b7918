"""One tile, on a worker."""
