"""The visible cells as a dataset for the code that draws maps, each cell taken from the finest known tile."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from atlas.explore.subject import Arrays, PlaneParameters, Subject
from atlas.explore.viewport import STAGES, TileKey, Viewport
from atlas.query.open import attach_store
from atlas.query.resample import read_view as read_view
from atlas.query.window import axis_values, cell_edges
from atlas.store.schema import coordinates, variable_attributes
from workers.results import PENDING, REGIME

if TYPE_CHECKING:
    import xarray as xr

Index = NDArray[np.int64]


@dataclass(frozen=True)
class VisibleCells:
    """The visible cells as a dataset, with the density at which each is known.

    ds        the dataset
    sight     the viewport: the ranges of visible cells along both axes
    stages    (y, x) number of halvings of density at which a cell is known; STAGES + 1 if coarser or unknown
    view_id   identifier of the viewport's cells; equal identifiers mean equal cells
    """

    ds: "xr.Dataset"
    sight: Viewport
    stages: NDArray[np.uint8]
    view_id: str = ""


def compose_view(
    subject: Subject,
    plane: PlaneParameters,
    viewport: Viewport,
    tiles: Sequence[tuple[TileKey, Arrays]],
    names: Iterable[str],
    base: "xr.Dataset | None" = None,
) -> VisibleCells:
    """Return the visible cells, with the named variables and the regime; unknown cells are pending.

    subject    the subject that is explored
    plane      the fixed parameters
    viewport   the ranges of visible cells along both axes
    tiles      known tiles with their arrays, the coarsest first
    names      names of the variables
    base       cells of the atlas from ``seen_atlas``; None if there are none

    Cells of the atlas replace those of tiles that are not denser than the atlas.
    """
    canvas = subject.without_results(dict.fromkeys([*names, REGIME.name]), viewport.shape)
    stages = np.full(viewport.shape, STAGES + 1, np.uint8)
    atlas_stage = max(0, viewport.x.level, viewport.y.level)
    for key, arrays in tiles:
        if viewport.stage(key) >= atlas_stage:
            _lay(canvas, stages, viewport, key, arrays)
    if base is not None:
        stages[_lay_base(canvas, subject, viewport, base)] = min(atlas_stage, STAGES + 1)
    for key, arrays in tiles:
        if viewport.stage(key) < atlas_stage:
            _lay(canvas, stages, viewport, key, arrays)
    return VisibleCells(dataset(subject, plane, *subject.points(*viewport), canvas), viewport, stages)


def dataset(
    subject: Subject, plane: PlaneParameters, x: NDArray[np.float64], y: NDArray[np.float64], canvas: Arrays
) -> "xr.Dataset":
    """Return cells of a plane as a dataset with the coordinates and attributes of an opened atlas.

    subject   the subject that is explored
    plane     the fixed parameters
    x, y      values of the axes
    canvas    results (y, x) of the cells, by name
    """
    import xarray

    spec, fixed = subject.spec, [name for name, _ in plane.parameters]
    described = coordinates(spec)
    across, up = subject.axes
    values = {across: x, up: y}
    coords: dict[str, Any] = {name: (name, values[name], described[name].attributes) for name in values}
    coords |= {name: ((), value, described[name].attributes) for name, value in plane.parameters}
    arrays = {
        name: ((up, across), values, variable_attributes(subject.variables[name], fixed))
        for name, values in canvas.items()
    }
    resolved = spec.to_resolved()
    axes = [{"name": axis.name, "scale": axis.scale} for axis in spec.axes]
    solve = dict(vars(subject.settings))
    attrs = {
        "spec": json.dumps({**resolved, "axes": axes, "parameters": dict(plane.parameters), "solve": solve}),
        "digest": subject.digest(plane),
    }
    ds = xarray.Dataset(arrays, coords, attrs)
    if subject.store is not None and plane == subject.plane:
        attach_store(ds, subject.store)  # which holds the curves
    return ds


def seen_atlas(subject: Subject, viewport: Viewport, names: Iterable[str]) -> "xr.Dataset | None":
    """Return the cells of the atlas in and around a viewport, from the overview (coarser copy) that suits its density.

    Return None if the viewport lies outside the atlas.
    """
    if subject.ds is None:
        return None
    part: dict[str, slice] = {}
    pixels = []
    for axis, seen in zip(subject.spec.axes, viewport, strict=True):
        cell = 2.0**-seen.level
        low, high = (int(np.floor(end)) for end in (seen.first * cell, seen.last * cell + 1.0))
        low, high = max(0, low), min(len(axis), high + 1)
        if low >= high:
            return None
        part[axis.name] = slice(low, high)
        pixels.append(max(1, round((high - low) * 2.0 ** min(seen.level, 0))))
    stored_names = [name for name in names if name in subject.ds]
    return read_view(subject.part(part), stored_names, None, pixels).load()


def atlas_cells(subject: Subject, names: Iterable[str], rows: Index, columns: Index) -> Arrays:
    """Return the variables ``names`` of cells of the atlas as arrays (y, x), for the given rows and columns."""
    across, up = subject.axes
    part = subject.part({across: columns, up: rows})[[*names]].load()
    return {str(name): array.transpose(up, across, ...).values for name, array in part.data_vars.items()}


def atlas_covers(subject: Subject, solved_mask: NDArray[np.bool_] | None, plane: PlaneParameters, key: TileKey) -> bool:
    """Return True if the atlas holds all cells of a tile, which is possible only for a tile not finer than the atlas.

    ``solved_mask`` (y, x) is the mask of the solved cells of the atlas.
    """
    if solved_mask is None or plane != subject.plane or max(key.level_x, key.level_y) > 0:
        return False
    rows, columns = key.of_atlas
    inside = rows[0] >= 0 and columns[0] >= 0 and rows[-1] < solved_mask.shape[0] and columns[-1] < solved_mask.shape[1]
    return bool(inside and solved_mask[np.ix_(rows, columns)].all())


def _lay(canvas: Arrays, stages: NDArray[np.uint8], viewport: Viewport, key: TileKey, arrays: Arrays) -> None:
    if not canvas.keys() <= arrays.keys() or not viewport.contains(key):
        return
    rows, columns = viewport.slices_of(key)
    up = key.rows.position_of(viewport.y.level, viewport.y.index[rows])
    across = key.columns.position_of(viewport.x.level, viewport.x.index[columns])
    for name, values in canvas.items():
        values[rows, columns] = arrays[name][np.ix_(up, across)]
    stages[rows, columns] = min(viewport.stage(key), STAGES + 1)


def _lay_base(canvas: Arrays, subject: Subject, viewport: Viewport, base: "xr.Dataset") -> NDArray[np.bool_]:
    """Copy cells of the atlas into the result arrays ``canvas``, and return the mask (y, x) of the cells copied."""
    places, inside = [], []
    dims = subject.axes[::-1]
    for name, values in zip(dims, subject.points(*viewport)[::-1], strict=True):
        edges, count = cell_edges(base, name), axis_values(base, name).size
        index = np.searchsorted(edges, values, side="right") - 1
        inside.append((index >= 0) & (index < count))
        places.append(np.clip(index, 0, count - 1))
    known = base[REGIME.name].transpose(*dims).values[np.ix_(*places)] != PENDING
    known &= np.outer(*inside)
    for name, values in canvas.items():
        if name in base:
            values[known] = base[name].transpose(*dims).values[np.ix_(*places)][known]
    return np.asarray(known)
