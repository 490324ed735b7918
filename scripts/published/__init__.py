"""Published results of the field, each reproduced with its numbers and a verdict: ``python -m scripts.published``."""
