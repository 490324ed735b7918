"""One run: what the coordinator does."""
