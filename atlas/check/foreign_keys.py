"""Find objects in the folders of a store's chunks that are no chunks, such as a tile beyond the grid or ``05``."""

import re
from collections.abc import Iterator

from atlas.overview.pyramid import GROUP, Pyramid
from atlas.store.backend import StoreBackend
from atlas.store.store import AtlasStore
from atlas.store.tiling import chunk_places
from workers.results import Variable

_PARTIAL = re.compile(r"\.[0-9a-f]{32}\.partial$")
"""Pattern of the end of a file's name while the file is being written, by this package or by Zarr."""


def leftovers(backend: StoreBackend) -> list[str]:
    """Return the files that killed writes have left in a store's folder. Nothing reads these files."""
    if backend.local is None:
        return []
    files = (path for path in backend.local.rglob("*.partial") if _PARTIAL.search(path.name) and path.is_file())
    return sorted(path.relative_to(backend.local).as_posix() for path in files)


def foreign_keys(handle: AtlasStore) -> Iterator[str]:
    """Yield the keys of all objects in the folders of chunks that are no chunks, from a listing of each array."""
    for variable in handle.variables:
        yield from _foreign(handle, "", variable, handle.tiling.grid)
    pyramid = Pyramid(handle)
    for level in range(1, pyramid.levels.count + 1) if pyramid.exists else ():
        for variable in pyramid.variables:
            yield from _foreign(handle, f"{GROUP}/{level}/", variable, pyramid.levels.grid(level))


def _foreign(handle: AtlasStore, folder: str, variable: Variable, grid: tuple[int, ...]) -> Iterator[str]:
    root = f"{folder}{variable.name}/c"
    full_grid = grid + (1,) * len(variable.extra_dims)  # all numbers of a cell lie in one chunk
    keys = list(handle.backend.list_keys(f"{root}/"))
    at = chunk_places(keys, root, full_grid)
    yield from sorted(key for key, position in zip(keys, at, strict=True) if position < 0)
