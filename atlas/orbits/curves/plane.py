"""The finished two-parameter atlas in which curves are searched: its cells as arrays, regions of cells with one kind of
orbit, and the edges between regions.
"""

import hashlib
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.orbits.orbit_table import Array, OrbitTable, columns_of, must_be_finished
from atlas.spec.cells import edges_of
from atlas.spec.system import must_offer
from atlas.store.store import AtlasStore
from workers.model.parameter import TAU
from workers.model.system import System
from workers.results import CYCLE_PERIOD, INVALID, NO_IMPACT, PERIODIC, REGIME

Cells = NDArray[np.int64]

SMALL = 4
"""Number of cells from which on a connected region is searched by default. Smaller regions count as ``small``."""

JUMP, ALONE = 0.03, 3.0
"""Thresholds above which a change of the mean impact speed from cell to cell suggests that the orbit is another one.

JUMP applies to the relative change, ALONE to the ratio of the change to the changes one cell before and after. Both
must be exceeded.
"""

SPEED = "mean_impact_speed"
NEEDED = (REGIME.name, "period", "impacts_upper", "impacts_lower", "symmetric", "state", SPEED)


@dataclass(frozen=True, eq=False, kw_only=True)
class CurvePlane(OrbitTable):
    """The cells of a finished two-parameter atlas, in which curves are searched; they are numbered row by row, x
    fastest.

    axes                names of the axes, x first
    x                   values of the x axis
    y                   values of the y axis
    log                 True for each logarithmic axis
    speed (cells,)      mean speed of impacts, NaN without impacts
    changes (cells, K)  results that tell apart orbits of equal period and impacts: whether friction or a stop makes the
                        motion stick, and contacts at each stop; None if unknown
    """

    axes: tuple[str, str]
    x: Array
    y: Array
    log: tuple[bool, bool]
    speed: Array
    changes: Cells | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Number of cells along y and x."""
        return len(self.y), len(self.x)

    @cached_property
    def proven(self) -> NDArray[np.bool_]:
        """Mask (cells,) of cells with a known periodic orbit, which includes motion without impact."""
        return np.isin(self.regime, (PERIODIC, NO_IMPACT)) & (self.period > 0)

    @cached_property
    def valid(self) -> NDArray[np.bool_]:
        """Mask (cells,) of cells with valid parameters."""
        return self.regime != INVALID

    def values(self, cells: Cells) -> Array:
        """Return the parameters (N, 2) of cells, x axis first."""
        return np.stack([self.x[cells % len(self.x)], self.y[cells // len(self.x)]], axis=-1)

    @cached_property
    def window(self) -> dict[str, tuple[float, float]]:
        """The limits (low, high) of each axis by name, from the first to the last edge of the cells.

        If the parameter's valid range ends at a closer value, the limit is the outermost point of the axis.
        """
        bounds = {}
        for name, points, log in zip(self.axes, (self.x, self.y), self.log, strict=True):
            parameter, edges = self.system.parameter(name), edges_of(np.sort(points), log)
            low, high = float(edges[0]), float(edges[-1])
            bounds[name] = (
                low if parameter.admits(low) else float(points.min()),
                high if parameter.admits(high) else float(points.max()),
            )
        return bounds

    @cached_property
    def width(self) -> Array:
        """The widths (2,) of the plane along x and y, in units of the parameters."""
        return np.array([self.window[name][1] - self.window[name][0] for name in self.axes])

    def places(self, values: Array) -> Array:
        """Convert points (N, 2) of the plane from parameter values to units of cells, x first.

        The point of the cell in column i and row j becomes (i, j).
        """
        places = np.empty_like(values)
        for k, (points, log) in enumerate(zip((self.x, self.y), self.log, strict=True)):
            scaled_values = np.log(values[:, k]) if log else values[:, k]
            scaled_points = np.log(points) if log else points
            steps = np.diff(scaled_points)
            inner = np.interp(scaled_values, scaled_points, np.arange(len(scaled_points), dtype=float))
            inner = np.where(scaled_values < scaled_points[0], (scaled_values - scaled_points[0]) / steps[0], inner)
            places[:, k] = np.where(
                scaled_values > scaled_points[-1],
                len(scaled_points) - 1 + (scaled_values - scaled_points[-1]) / steps[-1],
                inner,
            )
        return places

    @cached_property
    def regions(self) -> Cells:
        """The number (cells,) of the connected region to which each cell belongs; 0 for cells without a known periodic
        orbit.

        All cells of a region have the same kind of orbit: regime, period, impacts, symmetry, contacts and slides.
        """
        from atlas.query.connected_regions import (
            label_components,  # imports SciPy, the slowest import of all
        )

        changes = np.zeros((len(self.kind), 0), dtype=np.int64) if self.changes is None else self.changes
        features = np.column_stack([self.kind, changes])
        kind = np.unique(features, axis=0, return_inverse=True)[1].ravel()
        kinds = np.where(self.proven, kind + 1, 0).reshape(self.shape)
        return (
            label_components(kinds, [(kind, kind) for kind in np.unique(kinds[kinds > 0]).tolist()])[0]
            .ravel()
            .astype(np.int64)
        )

    @cached_property
    def region_sizes(self) -> Cells:
        """The number of cells of each region, indexed by the region's number. Number 0, for cells in no region, has
        size 0.
        """
        sizes = np.bincount(self.regions)
        sizes[0] = 0
        return sizes

    @cached_property
    def edges(self) -> Cells:
        """The edges (E, 2) between neighbouring cells across which the orbit may change, each a pair of cell numbers.

        An edge is listed if its cells are in different regions, or in one region with a jump of the mean impact speed.
        At least one of its cells has a known periodic orbit. Edges between cells adjacent in x come first, then those
        in y.
        """
        number = np.arange(len(self.regime)).reshape(self.shape)
        pairs = [(number[:, :-1], number[:, 1:]), (number[:-1], number[1:])]
        neighbours = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in pairs])
        region = self.regions[neighbours]
        jumps = np.concatenate([self._jumps(1), self._jumps(0)])
        differ = (region[:, 0] != region[:, 1]) | jumps
        return np.asarray(neighbours[differ & self.valid[neighbours].all(axis=1)])

    def _jumps(self, axis: int) -> NDArray[np.bool_]:
        """Return the mask of pairs of neighbours along an axis whose orbits may differ although they are of the same
        kind.

        The mean impact speed jumps between the two cells of such a pair, and changes less just before and after.
        """
        speed, region = (np.moveaxis(values.reshape(self.shape), axis, 0) for values in (self.speed, self.regions))
        inside = (region[1:] == region[:-1]) & (region[1:] > 0)
        steps = np.where(inside, np.nan_to_num(np.abs(np.diff(speed, axis=0))), 0.0)
        around = np.pad(steps, [(1, 1), (0, 0)])
        alone = steps > ALONE * np.maximum(around[:-2], around[2:])
        large = steps > JUMP * 0.5 * np.nan_to_num(np.abs(speed[1:]) + np.abs(speed[:-1]))
        return np.moveaxis(alone & large, 0, axis).ravel()

    @cached_property
    def digest(self) -> str:
        """Digest of all data of the atlas on which its curves depend: results of the cells, axes, system and fixed
        parameters.
        """
        digest = hashlib.sha256(repr((self.system.table(), self.axes, sorted(self.fixed.items()))).encode())
        names = ("x", "y", "regime", "period", "impacts_upper", "impacts_lower", "symmetric", "speed", "state")
        for name in (*names, *([CYCLE_PERIOD.name] if self.system.definition.unforced else [])):
            digest.update(np.ascontiguousarray(getattr(self, name)).tobytes())
        digest.update(b"" if self.changes is None else np.ascontiguousarray(self.changes).tobytes())
        return digest.hexdigest()


def plane_of(handle: AtlasStore) -> CurvePlane:
    """Read the two-parameter atlas of a store as arrays for a search of its curves.

    Raise InputError unless the store is finished and has two axes, both parameters on which orbits depend. Raise
    ChunkError if a chunk is missing or damaged.
    """
    spec = handle.spec
    if spec.points or len(spec.axes) != 2:
        shape = "a table of points" if spec.points else "one axis" if len(spec.axes) == 1 else f"{len(spec.axes)} axes"
        raise InputError(f"{handle.backend}: found {shape}; curves need a plane with two axes")
    system = spec.system_def
    must_offer(system, "curves", unforced=True)
    for axis in spec.axes:
        phases = system.definition.phase_count
        if axis.name in system.states or (axis.name == TAU and phases < 2):
            raise InputError(
                f"{handle.backend}: axis {axis.name} only sets the start of a motion, on which no orbit depends; "
                "curves take two other parameters as axes"
            )
        if len(axis) < 2:
            raise InputError(f"{handle.backend}: axis {axis.name} has one value; curves need 2 or more")
    must_be_finished(handle)
    needed = (*NEEDED, CYCLE_PERIOD.name) if system.definition.unforced else NEEDED
    counts, shares = changes_of(system)
    columns = columns_of(handle, list(dict.fromkeys((*needed, *counts, *shares))))
    leading: dict[str, Any] = {name: values[:, 0] for name, values in columns.items()}
    changes = [leading[name] for name in counts] + [leading[name] > 0.0 for name in shares]
    x, y = spec.axes
    return CurvePlane(
        system=system,
        axes=(x.name, y.name),
        x=np.array(x.values),
        y=np.array(y.values),
        log=(x.scale == "log", y.scale == "log"),
        fixed={name: float(value) for name, value in spec.parameters.items()},
        speed=leading.pop(SPEED),
        changes=np.stack(changes, axis=1).astype(np.int64),
        **{name: leading[name] for name in needed if name != SPEED},
    )


def changes_of(system: System) -> tuple[list[str], list[str]]:
    """Return the names of the results that change where an orbit continues but gains or loses a contact or a slide.

    The first list has flags and counts of contacts. The second list has shares of time that are 0 if friction does not
    stick.
    """
    variable_names, definition = {variable.name for variable in system.own_variables}, system.definition
    counts = [f"{contact.name}_{side}" for contact in definition.contacts for side in ("upper", "lower")]
    shares = [f"{friction.name}_stuck" for friction in definition.friction]
    return ["sticks", *(name for name in counts if name in variable_names)], [
        name for name in shares if name in variable_names
    ]
