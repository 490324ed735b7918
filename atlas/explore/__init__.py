"""The explorer: a page in the browser that shows a plane of an atlas in any window and at any zoom level.

Cells that are visible and not yet known are solved on a Dask cluster.
"""
