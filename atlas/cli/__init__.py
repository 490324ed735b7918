"""The command ``atlas``."""
