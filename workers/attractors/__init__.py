"""All attractors of a cell: found from many initial states, told apart, and their basins."""
