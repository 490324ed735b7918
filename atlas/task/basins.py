"""The last step of an atlas of basins: labels of attractors that the reference set missed, and the table of all."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from atlas.store.groups import ATTRACTORS, group_attributes, write_table
from atlas.store.schema import DIMENSIONS, StoredArray, variable_attributes
from atlas.store.store import Header, done_tiles
from atlas.store.tiles import read_tile, write_tile
from workers.attractors.starts import wilson
from workers.results import ATTRACTOR, BEYOND_TABLE, INVALID, LABEL, REGIME, UNKNOWN_LABEL

if TYPE_CHECKING:
    from workers.attractors.basins import Table

POINTS = 256
"""Section states of each attractor in the table."""


def complete_basins(header: Header) -> None:
    """Give every initial state its last label, and write the table of the attractors.

    Cells are labelled in the order of the plane, so that tiles, workers and interruptions decide no label. Nothing is
    done while tiles are missing, or if all is done.
    """
    from workers.attractors.basins import Table, added, fixed_values

    spec, tiles = header.spec, sorted(done_tiles(header))
    if len(tiles) < header.tiling.count:
        return
    labels = np.full(spec.shape, UNKNOWN_LABEL, dtype=np.int64)
    for index in tiles:
        labels[header.tiling.at(index).slices] = read_tile(header, index, [LABEL.name])[LABEL.name]
    if group_attributes(header, ATTRACTORS) is not None and not (labels == BEYOND_TABLE).any():
        return
    assert spec.attractors is not None
    params = spec.cell_params(tuple(slice(0, n) for n in spec.shape))
    defaults = {p.name: p.default for p in spec.record.parameters}
    values = fixed_values(spec.record, defaults | params)
    table = Table(spec.record, values, spec.settings, spec.attractors)
    beyond = (labels == BEYOND_TABLE) | (labels >= len(table.attractors))
    if beyond.any():
        labels[beyond] = added(table, _states(header, tiles, beyond))
        for index in tiles:
            part = header.tiling.at(index).slices
            if beyond[part].any():
                arrays = read_tile(header, index)
                arrays[LABEL.name][beyond[part]] = labels[part][beyond[part]]
                write_tile(header, index, arrays)
    regimes = (read_tile(header, index, [REGIME.name])[REGIME.name] for index in tiles)
    solved = sum(int((regime != INVALID).sum()) for regime in regimes)
    columns = _columns(header, table, labels, solved)
    write_table(header, ATTRACTORS, columns, {"title": "attractors by their labels"})


def _states(header: Header, tiles: list[tuple[int, ...]], wanted: NDArray[np.bool_]) -> NDArray[np.float64]:
    """The states on their attractors of these cells, in the order of the plane."""
    states = np.full((*wanted.shape, len(header.spec.record.states)), np.nan)
    for index in tiles:
        part = header.tiling.at(index).slices
        if wanted[part].any():
            states[part] = read_tile(header, index, ["state"])["state"]
    return states[wanted]


def _columns(header: Header, table: "Table", labels: NDArray[np.int64], solved: int) -> Mapping[str, StoredArray]:
    """The table's variables. Shares are of the initial states of the plane that are not beyond a stop."""
    from workers.attractors.basins import section_points

    count = len(table.attractors)
    hits = np.array([np.count_nonzero(labels == k) for k in range(count)], dtype=np.int64)
    low, high = wilson(hits, max(solved, 1))
    columns: dict[str, tuple[NDArray[Any], str]] = {
        "cells": (hits, "initial states of the plane that reach it"),
        "share": (hits / max(solved, 1), "share of the plane that reaches it"),
        "share_low": (low, "lower end of the 95 % Wilson interval of the share"),
        "share_high": (high, "upper end of the 95 % Wilson interval of the share"),
        "mirror": (table.mirrors().astype(np.int32), "label of its mirror image; itself where symmetric; or -1"),
        "points": (section_points(table, POINTS), "section states; of an orbit each once"),
    }
    axes = (ATTRACTOR, "point", DIMENSIONS["state"])
    made = {
        name: StoredArray(values, axes[: values.ndim], {"long_name": meaning, "units": "1"})
        for name, (values, meaning) in columns.items()
    }
    for variable in table.record.variables(table.settings):
        values: list[Any] = [each.result[variable.name] for each in table.attractors]
        dims = (ATTRACTOR, *(DIMENSIONS.get(dim, dim) for dim in variable.extra))
        shape = np.shape(values[0]) if values else tuple(0 for _ in variable.extra)
        array = np.array(values, dtype=variable.dtype).reshape(count, *shape)
        made[variable.name] = StoredArray(array, dims, variable_attributes(variable, []))
    return made
