"""Finished stores: the results and the parameters of their cells as columns."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError, check_names
from atlas.query.open import open_atlas
from atlas.spec.spec import Spec
from atlas.store.store import Atlas, done_tiles
from atlas.store.tiles import read_tile
from atlas.text import plural


def must_be_finished(handle: Atlas) -> None:
    """InputError, with what to do, where a tile of a store is not done."""
    missing = handle.tiling.count - len(done_tiles(handle))
    if missing:
        raise InputError(f"{handle.place}: {plural(missing, 'tile')} not done; complete it with atlas run first")


def columns_of(handle: Atlas, names: Sequence[str], tile: tuple[int, ...] | None = None) -> dict[str, NDArray[Any]]:
    """Results (cells, keep, ...) of a store's cells, or of those of a tile, in C order; keep is 1 for one attractor.

    InputError for a result that the store does not have, ChunkError where a chunk is missing or damaged.
    """
    check_names("result of this atlas", names, [each.name for each in handle.variables])
    if tile is None:
        ds = open_atlas(handle)
        arrays = {name: ds[name].values for name in names}
    else:
        arrays = read_tile(handle, tile, names)
    dims, keep = len(handle.spec.shape), int(handle.spec.coexistence)
    return {
        name: values.reshape(-1, *(values.shape[dims : dims + 1] if keep else (1,)), *values.shape[dims + keep :])
        for name, values in arrays.items()
    }


def params_of(spec: Spec, slices: tuple[slice, ...] | None = None) -> dict[str, NDArray[np.float64]]:
    """The value (cells,) of every parameter in a block of cells, by default in all, in C order."""
    block = tuple(slice(0, n) for n in spec.shape) if slices is None else slices
    given, shape = spec.cell_params(block), tuple(part.stop - part.start for part in block)
    return {
        p.name: np.broadcast_to(np.asarray(given.get(p.name, p.default), dtype=np.float64), shape).ravel()
        for p in spec.record.parameters
    }
