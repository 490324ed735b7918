"""The jobs that the workers of a run execute: solving tiles, building overviews, labelling basins."""
