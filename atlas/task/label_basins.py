"""The last step of an atlas of basins: final labels of all initial states, and the table of the attractors.

While tiles are solved, cells get labels of a reference set of attractors that is found first. Other attractors get
their labels here.
"""

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from atlas.store.groups import ATTRACTORS, group_attributes, write_table
from atlas.store.record_format import Index, Rows
from atlas.store.schema import DIMENSIONS, StoredArray, variable_attributes
from atlas.store.store import AtlasStore, done_tiles
from atlas.store.tiles import read_tile, relabel_tile
from workers.attractors.initial_states import wilson
from workers.results import ATTRACTOR, BEYOND_TABLE, INVALID, LABEL, REGIME

if TYPE_CHECKING:
    from workers.attractors.basins import AttractorTable

POINTS = 256
"""Number of section states, one per forcing period, that the table has of each attractor."""
BYTES_OF_LABEL = 64
"""Memory, in bytes, that labelling takes per cell besides the cell's state: labels, position and order."""


def complete_basins(handle: AtlasStore) -> dict[Index, Rows]:
    """Give every initial state its final label, write the table of the attractors, and return changed tile records.

    Cells are labelled in the order of the plane, so labels do not depend on tiles, workers and interruptions. This is
    done for one band of tiles, those with equal leading indices, after another, so memory does not grow with the plane,
    see ``labelling_bytes``. Nothing is done while tiles are unfinished, or after completion.
    """
    from workers.attractors.basins import AttractorTable, fixed_values

    spec, tiles = handle.spec, sorted(done_tiles(handle))
    if len(tiles) < handle.tiling.count:
        return {}
    complete = group_attributes(handle, ATTRACTORS) is not None
    if complete and not any((_labels(handle, index) == BEYOND_TABLE).any() for index in tiles):
        return {}
    assert spec.attractors is not None
    params = spec.cell_params(tuple(slice(0, n) for n in spec.shape))
    values = fixed_values(spec.system_def, params)
    table = AttractorTable(spec.system_def, values, spec.settings, spec.attractors)
    reference, solved = len(table.attractors), 0
    hits: Counter[int] = Counter()
    records: dict[Index, Rows] = {}
    for _, band in itertools.groupby(tiles, lambda index: index[: _leading(handle.tile)]):
        for index, labels in _label_band(handle, table, reference, list(band), records):
            present, counts = np.unique(labels, return_counts=True)
            hits.update(dict(zip(present.tolist(), counts.tolist(), strict=True)))
            solved += int((read_tile(handle, index, [REGIME.name])[REGIME.name] != INVALID).sum())
    columns = _columns(handle, table, hits, solved)
    write_table(handle, ATTRACTORS, columns, {"title": "attractors by their labels"})
    return records


def labelling_bytes(handle: AtlasStore) -> int:
    """Return the maximum memory, in bytes, of ``complete_basins``, not counting the results of one tile.

    It is reached if no cell of a band of tiles has its final label yet.
    """
    n_leading = _leading(handle.tile)
    cells = math.prod(handle.tile[:n_leading]) * math.prod(handle.spec.shape[n_leading:])
    return cells * (2 * 8 * len(handle.spec.system_def.states) + BYTES_OF_LABEL)


def _leading(tile: tuple[int, ...]) -> int:
    """Return the number of leading indices that tiles of one band have in common.

    In the order of the plane, all cells of a band then come before those of the next.
    """
    return next((dim for dim, side in enumerate(tile) if side > 1), len(tile) - 1) + 1


def _labels(handle: AtlasStore, index: tuple[int, ...]) -> NDArray[np.int64]:
    return read_tile(handle, index, [LABEL.name])[LABEL.name].astype(np.int64)


def _label_band(
    handle: AtlasStore, table: "AttractorTable", reference: int, band: list[Index], records: dict[Index, Rows]
) -> Iterator[tuple[Index, NDArray[np.int64]]]:
    """Yield (tile, labels) for each tile of a band, once its final labels are written.

    table      table of the attractors, to which new ones are added
    reference  number of attractors that were known before any cell was solved
    band       indices of the tiles
    records    tile records by tile, to which changed ones are added

    Only cells with other attractors are labelled, also if a killed attempt has labelled them before.
    """
    from workers.attractors.basins import labels_beyond

    labels = {index: _labels(handle, index) for index in band}
    beyond = {index: (label == BEYOND_TABLE) | (label >= reference) for index, label in labels.items()}
    beyond = {index: mask for index, mask in beyond.items() if mask.any()}
    if beyond:
        places = np.concatenate([_places(handle, index, mask) for index, mask in beyond.items()])
        states = np.concatenate([read_tile(handle, index, ["state"])["state"][mask] for index, mask in beyond.items()])
        order, last = np.argsort(places), np.empty(places.size, dtype=np.int64)
        last[order] = labels_beyond(table, states[order])
        ends = np.cumsum([int(mask.sum()) for mask in beyond.values()])
        for (index, mask), new in zip(beyond.items(), np.split(last, ends[:-1]), strict=True):
            labels[index][mask] = new
            arrays = read_tile(handle, index)
            arrays[LABEL.name][mask] = new
            records[index] = relabel_tile(handle, index, arrays)
    yield from labels.items()


def _places(handle: AtlasStore, index: tuple[int, ...], mask: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the positions, in the order of the plane, of the cells of a tile that are True in a mask."""
    begins = [part.start for part in handle.tiling.at(index).slices]
    return np.ravel_multi_index(tuple((np.argwhere(mask) + begins).T), handle.spec.shape)


def _columns(
    handle: AtlasStore, table: "AttractorTable", cells: Mapping[int, int], solved: int
) -> Mapping[str, StoredArray]:
    """Return the columns of the table of attractors. ``cells`` has the number of cells by label.

    Shares refer to the ``solved`` initial states, those between the stops.
    """
    from workers.attractors.basins import section_points

    count = len(table.attractors)
    hits = np.array([cells[k] for k in range(count)], dtype=np.int64)
    low, high = wilson(hits, max(solved, 1))
    shares: dict[str, tuple[NDArray[Any], str]] = {
        "cells": (hits, "initial states of the plane that reach it"),
        "share": (hits / max(solved, 1), "share of the plane that reaches it"),
        "share_low": (low, "lower end of the 95 % Wilson interval of the share"),
        "share_high": (high, "upper end of the 95 % Wilson interval of the share"),
        "mirror": (table.mirror_labels().astype(np.int32), "label of its mirror image; itself where symmetric; or -1"),
        "points": (section_points(table, POINTS), "section states; of an orbit each once"),
    }
    axes = (ATTRACTOR, "point", DIMENSIONS["state"])
    columns = {
        name: StoredArray(values, axes[: values.ndim], {"long_name": meaning, "units": "1"})
        for name, (values, meaning) in shares.items()
    }
    for variable in table.record.variables(table.settings):
        values: list[Any] = [attractor.result[variable.name] for attractor in table.attractors]
        dims = (ATTRACTOR, *(DIMENSIONS.get(dim, dim) for dim in variable.extra_dims))
        shape = np.shape(values[0]) if values else tuple(0 for _ in variable.extra_dims)
        array = np.array(values, dtype=variable.dtype).reshape(count, *shape)
        columns[variable.name] = StoredArray(array, dims, variable_attributes(variable, []))
    return columns
