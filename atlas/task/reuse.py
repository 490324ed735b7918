"""Reuse of cells from the origin of a store, an older store: known cells of a tile are copied, the others are
solved.
"""

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from atlas.errors import ChunkError, InputError, RunError
from atlas.spec.spec import Slices, Spec
from atlas.store.handle_cache import cached_handle
from atlas.store.host_records import read_hosts, record_host
from atlas.store.object_backend import sibling_backend
from atlas.store.origin import ALLOWANCES
from atlas.store.store import AtlasStore, chunk_key, is_done
from atlas.store.tile_records import EXCHANGED, TileRecords, is_exchanged
from atlas.store.tiles import read_tile, record_of
from workers.results import PENDING, REGIME, empty_results


class SharedPositions(NamedTuple):
    """Positions, along an axis, of the values that two atlases share bit for bit; both arrays have the same order.

    cells          positions in the new atlas
    origin_cells   positions in the old atlas
    """

    cells: NDArray[np.intp]
    origin_cells: NDArray[np.intp]


class ReusedCells(NamedTuple):
    """What is known of a tile before it is solved: results of the origin, the store whose cells are taken over.

    arrays    results of all its cells; in a retried atlas also the budgets of the coming solution
    regime    regime of each cell in the origin, PENDING if unknown
    missing   mask of the cells to solve
    source    the origin, if it has the same cells in the same tiles, so that its objects may be copied; else None
    """

    arrays: dict[str, np.ndarray]
    regime: NDArray[np.int8]
    missing: NDArray[np.bool_]
    source: AtlasStore | None = None


def reuse_cells(handle: AtlasStore, slices: Slices) -> ReusedCells:
    """Return what is known of the cells in these slices: the results of the store's origin, if it has one.

    Raise RunError if the origin no longer exists.
    """
    shape = tuple(part.stop - part.start for part in slices)
    arrays = empty_results(handle.spec.variables, shape, handle.spec.extra_sizes)
    arrays |= {allowance.name: np.full(shape, allowance.fill, allowance.dtype) for allowance in handle.allowances}
    origin = None if handle.origin is None else _origin_of(handle)
    if origin is not None:
        _copy_known(handle, origin, slices, arrays)
    regime = handle.dominant_arrays(arrays)[REGIME.name].copy()
    due = regime == PENDING
    if handle.origin is None or handle.origin.retry is None:
        return ReusedCells(arrays, regime, due)
    again = handle.origin.retry.selects(arrays)
    for allowance in handle.allowances:
        arrays[allowance.name][again] = np.maximum(arrays[allowance.name], handle.origin.retry.least_budget(allowance))[
            again
        ]
    return ReusedCells(arrays, regime, due | again, origin)


def shared(old: Spec, new: Spec) -> tuple[SharedPositions, ...]:
    """Return, for each dimension, the positions of the values that two atlases of the same axes share."""
    pairs = zip(reversed(new.axes), reversed(old.axes), strict=True)
    return tuple(
        SharedPositions(*np.intersect1d(ours.values, theirs.values, assume_unique=True, return_indices=True)[1:])
        for ours, theirs in pairs
    )


def _copy_known(handle: AtlasStore, origin: AtlasStore, slices: Slices, arrays: dict[str, np.ndarray]) -> None:
    """Copy the results of the origin's finished cells into ``arrays``, those of the cells in ``slices`` of the new
    store.

    Raise ChunkError if the origin's cells contradict their record.
    """
    first = True
    for index, cells, origin_cells in _meetings(shared(origin.spec, handle.spec), slices, origin.tile):
        if not is_done(origin, index):
            continue
        if first:
            first = False
            for machine in read_hosts(origin):
                record_host(handle, machine)
        known = read_tile(origin, index)
        records = origin.cached("records", lambda: TileRecords(origin))  # the origin no longer changes
        if is_exchanged(records, index, record_of(origin, index, known)):
            raise ChunkError(origin.backend, {chunk_key(origin.regime, index): EXCHANGED})
        if not handle.allowances:  # a cell with a higher budget than the spec's has other results here
            for allowance in ALLOWANCES:
                known[REGIME.name][known.pop(allowance.name) != allowance.from_spec(origin.spec)] = PENDING
        for name, values in known.items():
            arrays[name][np.ix_(*cells)] = values[np.ix_(*origin_cells)]


def _meetings(
    dimensions: tuple[SharedPositions, ...], slices: Slices, tile: tuple[int, ...]
) -> Iterator[tuple[tuple[int, ...], list[NDArray[np.intp]], list[NDArray[np.intp]]]]:
    """Yield the tiles of the origin that share cells with a tile of the new store.

    dimensions  shared positions along each dimension
    slices      cells of the new store's tile
    tile        shape of the origin's tiles

    Each entry has the index of the origin's tile, and along each dimension the positions of the shared cells in the new
    store's tile and in the origin's tile.
    """
    parts = []
    for (cells, origin_cells), part, length in zip(dimensions, slices, tile, strict=True):
        inside = (cells >= part.start) & (cells < part.stop)
        cells, origin_cells = cells[inside] - part.start, origin_cells[inside]
        tiles, within = origin_cells // length, origin_cells % length
        parts.append([(int(k), cells[tiles == k], within[tiles == k]) for k in np.unique(tiles)])
    for met in itertools.product(*parts):
        yield tuple(k for k, _, _ in met), [cells for _, cells, _ in met], [origin_cells for _, _, origin_cells in met]


def _origin_of(handle: AtlasStore) -> AtlasStore:
    assert handle.origin is not None
    action, otherwise = "extended", f"extend {handle.backend} into a new store"
    if handle.origin.retry is not None:
        action, otherwise = "retried", "recompute it with atlas run and retry it into a new store"
    try:
        origin = cached_handle(sibling_backend(handle.backend, handle.origin.store))
    except InputError as error:
        trouble = str(error)
    else:
        if origin.run_id == handle.origin.run_id:
            return origin
        trouble = f"{origin.backend}: another store than the one that was {action}"
    raise RunError(f"{trouble}; {handle.backend} copies cells from it: restore it, or {otherwise}")


def count_shared(origin: AtlasStore, spec: Spec, finished_tiles: set[tuple[int, ...]]) -> int:
    """Return the number of finished cells of the origin that an extended atlas shares.

    ``finished_tiles`` are the indices of the origin's finished tiles.
    """
    counts = [
        np.bincount(positions // length, minlength=tiles)
        for (_, positions), length, tiles in zip(
            shared(origin.spec, spec), origin.tile, origin.tiling.grid, strict=True
        )
    ]
    return sum(int(np.prod([count[i] for count, i in zip(counts, index, strict=True)])) for index in finished_tiles)
