"""The store of an atlas: a Zarr hierarchy in a folder, a zip file or an object store.

Each array has one object per tile.
"""
