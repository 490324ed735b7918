"""Random cells of the whole parameter space, and checks of their results; ``python -m scripts.stress`` runs them."""
