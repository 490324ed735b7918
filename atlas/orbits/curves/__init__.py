"""The exact curves that bound the regions of a plane: bifurcations and grazes of the orbits of its cells."""
