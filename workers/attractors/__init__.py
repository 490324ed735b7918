"""All attractors of a cell: found from many initial states and distinguished, and their basins."""
