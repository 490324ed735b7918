"""Periodic orbits of stored cells: found again from the stored results, followed along branches, bounded by curves and
labelled.
"""
