"""The explorer: a page in the browser that shows a plane in any window, at any zoom level, and solves the visible
cells.
"""
