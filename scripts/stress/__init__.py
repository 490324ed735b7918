"""Random cells of the whole parameter space, and checks of their results; run by ``python -m scripts.stress``."""
