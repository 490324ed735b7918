"""Labels of coexisting attractors that persist from cell to cell: those of one branch have the same."""
