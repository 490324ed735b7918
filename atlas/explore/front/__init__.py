"""The JavaScript modules of the explorer's page and of the static page: they draw planes from numbers of cells."""
