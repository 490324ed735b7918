"""The overviews of an atlas: levels of coarser cells."""
