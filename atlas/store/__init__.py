"""An atlas as Zarr at a location, one tile one chunk of every array."""
