"""The store of an atlas: a Zarr hierarchy in a folder, a zip file or an object store, with one object per tile and
array.
"""
