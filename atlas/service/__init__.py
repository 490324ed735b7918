"""The coordinator's part of a run."""
