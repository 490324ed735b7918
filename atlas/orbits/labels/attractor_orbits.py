"""The attractors of a finished atlas that are periodic orbits, as arrays, and pairs of them in neighbouring cells."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.orbits.orbit_table import Array, OrbitTable, Rows, columns_of, must_be_finished, params_of
from atlas.store.store import AtlasStore
from workers.attractors.attractor import ON_ATTRACTOR
from workers.results import NO_IMPACT, PERIODIC, REGIME

NEEDED = (REGIME.name, "period", "impacts_upper", "impacts_lower", "symmetric", "state", "share", "mirror")


@dataclass(frozen=True, eq=False, kw_only=True)
class AttractorOrbitTable(OrbitTable):
    """The attractors of a finished atlas that are periodic orbits, as A rows; only orbits can be followed to other
    parameters.

    axes              names of the axes, in the order of ``shape``
    shape             number of cells along each dimension
    keep              number of attractors stored per cell
    points (C, axes)  parameters of every cell, in C order
    cell (A,)         cell of each orbit; orbits are in the order of cells and of their index there
    rank (A,)         index of the orbit among the attractors of its cell
    share (A,)        share of the cell's initial states that reach the attractor
    twin (A,)         row of its mirror image in the same cell, its own row if it is symmetric; -1 if there is none
    """

    shape: tuple[int, ...]
    keep: int
    points: Array
    cell: Rows
    rank: Rows
    share: Array
    twin: Rows

    def __len__(self) -> int:
        return len(self.cell)

    @property
    def proven(self) -> NDArray[np.bool_]:
        """The mask (A,) of rows with a periodic orbit: True for all."""
        return np.ones(len(self), dtype=np.bool_)

    def values(self, rows: Rows) -> Array:
        """Return the axes' parameters (R, axes) of the cells of the given R rows."""
        return np.asarray(self.points[self.cell[rows]])

    @cached_property
    def row(self) -> Rows:
        """The row (C, keep) of each attractor of each cell, -1 if there is no attractor or it is no periodic orbit."""
        row = np.full((len(self.points), self.keep), -1)
        row[self.cell, self.rank] = np.arange(len(self))
        return row

    def same_kind_pairs(self, away: int = 1) -> Rows:
        """Return the pairs (N, 2) of rows with one kind of orbit in cells that are ``away`` cells apart along a
        dimension.

        One kind means equal regime, period, impacts and symmetry.
        """
        pairs = self.neighbour_pairs(away)
        return np.asarray(pairs[self.kind[pairs[:, 0]] == self.kind[pairs[:, 1]]])

    def neighbour_pairs(self, away: int = 1) -> Rows:
        """Return the pairs (N, 2) of rows whose orbits are in cells that are ``away`` cells apart along a dimension."""
        number = np.arange(len(self.points)).reshape(self.shape)
        parts = [np.zeros((0, 2), dtype=np.int64)]
        for dim in range(number.ndim):
            along = np.moveaxis(number, dim, 0)
            before, after = self.row[along[:-away].ravel()], self.row[along[away:].ravel()]
            pairs = np.stack(np.broadcast_arrays(before[:, :, None], after[:, None, :]), axis=-1).reshape(-1, 2)
            parts.append(pairs[(pairs >= 0).all(axis=1)])
        return np.concatenate(parts)


def with_images(attractors: AttractorOrbitTable) -> tuple[Rows, Rows]:
    """Extend the A orbits by their U unseen mirror images, which no initial state has reached.

    Return the cell (A + U,) of each orbit and unseen mirror image, and the row (A + U,) of its mirror image. That row
    is the orbit's own if the orbit is symmetric, and -1 if the machine is not symmetric.
    """
    table, count = attractors, len(attractors)
    image = np.where(table.symmetric, np.arange(count), table.twin)
    alone = np.flatnonzero(image < 0)
    values = {p.name: np.full(len(alone), table.fixed.get(p.name, p.default)) for p in table.system.parameters}
    values |= {name: np.ascontiguousarray(table.values(alone)[:, k]) for k, name in enumerate(table.axes)}
    unseen = alone[table.system.build_many(values)[0].symmetric > 0.0]
    image[unseen] = count + np.arange(len(unseen))
    return np.append(table.cell, table.cell[unseen]), np.append(image, unseen)


def attractors_of(handle: AtlasStore) -> tuple[AttractorOrbitTable, int]:
    """Read the periodic orbits of a store as a table, and count its attractors of any kind.

    Raise InputError unless the store is a finished atlas of all attractors over axes. Raise ChunkError if a chunk is
    missing or damaged.
    """
    spec = handle.spec
    if not spec.coexistence:
        raise InputError(
            f"{handle.backend}: found one attractor per cell; labels need an atlas of all, see [attractors]"
        )
    if spec.points:
        raise InputError(f"{handle.backend}: found a table of points; labels go from cell to cell along axes")
    must_be_finished(handle)
    columns, points = columns_of(handle, NEEDED), params_of(spec)
    regime, period = columns[REGIME.name], columns["period"]
    known = np.isin(regime, (NO_IMPACT, PERIODIC)) & (period > 0)
    cell, rank = np.nonzero(known)
    row = np.full(known.shape, -1)
    row[cell, rank] = np.arange(len(cell))
    image = columns.pop("mirror")[known]
    axes = tuple(axis.name for axis in reversed(spec.axes))
    attractors = AttractorOrbitTable(
        system=spec.system_def,
        axes=axes,
        fixed={name: float(value) for name, value in spec.parameters.items()},
        shape=spec.shape,
        keep=known.shape[1],
        points=np.stack([points[name] for name in axes], axis=1),
        cell=cell,
        rank=rank,
        **{name: values[known] for name, values in columns.items()},
        twin=np.where(image >= 0, row[cell, np.maximum(image, 0)], -1),
    )
    return attractors, int(np.sum(np.isin(regime, ON_ATTRACTOR)))
