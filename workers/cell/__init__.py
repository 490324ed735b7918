"""One cell: the stages that it goes through, what is averaged of it, and its results. Many cells at a time."""
