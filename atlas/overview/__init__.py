"""The overviews of an atlas: copies with ever coarser cells, from which pictures of the whole are drawn."""
