"""Reading an atlas and asking it."""
