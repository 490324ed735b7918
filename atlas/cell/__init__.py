"""One cell in detail."""
