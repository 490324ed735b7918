"""Labels of coexisting attractors: attractors of different cells share a label if they are on one branch of orbits."""
