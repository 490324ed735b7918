"""All attractors of a cell: found from many initial states and distinguished, with their basins."""
