"""The command ``atlas`` and its commands."""
