"""Labels of coexisting attractors that persist from cell to cell: attractors of one branch share a label."""
