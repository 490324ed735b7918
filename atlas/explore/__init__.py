"""The explorer: a page in the browser that shows a plane anywhere, at any depth, and computes the cells in view."""
