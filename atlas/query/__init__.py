"""Opening an atlas as an xarray dataset, and queries that read it."""
