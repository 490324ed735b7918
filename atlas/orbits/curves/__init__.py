"""The exact curves that bound the regions of a two-parameter atlas: bifurcations and grazes of the orbits of its
cells.
"""
