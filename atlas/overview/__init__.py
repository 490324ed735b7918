"""Coarser levels of an atlas."""
