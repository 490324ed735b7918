"""Functions that compute and watch stores: runs of an atlas on Dask workers, searches on a finished atlas, leases,
status.
"""
