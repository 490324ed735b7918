"""Opening an atlas as a dataset, and queries that read it."""
