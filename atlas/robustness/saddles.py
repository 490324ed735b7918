"""The saddles between the basins of the attractors of one cell, and for one mass their stable manifolds."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from atlas.argument_checks import validate_flag, validate_interval, validate_type
from atlas.errors import InputError
from atlas.query.basins import is_basin_atlas
from atlas.robustness.attractors import AttractorSearch
from atlas.robustness.norm import validate_weights
from atlas.spec.spec import given_values
from atlas.spec.system import must_offer
from workers import Settings
from workers.attractors.initial_states import AttractorSettings
from workers.model.system import DEFAULT, System

if TYPE_CHECKING:
    import xarray as xr

    from atlas.robustness.boundary_tracking import Saddle
    from atlas.robustness.manifold import Across, ManifoldBranch
    from atlas.spec.spec import Spec
    from workers.attractors.basins import AttractorTable
    from workers.model.oscillator import Array

Box = Mapping[str, tuple[float, float]]

CONTRACTED = 0.5
"""Maximum multiplier, along a manifold, of the map that grows it, a power of P."""
TIMES = 20.0
"""Length of a branch of a manifold, in diagonals of the box."""
BEYOND = 0.5
"""Margin around a plane in which the manifolds of its saddles are grown, relative to its sides.

Manifolds may leave the plane and return.
"""


def saddles(
    parameters: Mapping[str, Any] | None = None,
    /,
    *,
    system: str | Mapping[str, Any] | System = DEFAULT,
    settings: Settings | None = None,
    starts: int = AttractorSettings.count,
    norm: Mapping[str, float] | None = None,
    manifolds: bool = False,
    box: Box | None = None,
    **named: Any,
) -> dict[str, Any]:
    """Return the unstable orbits between the basins of one cell's attractors, exact, with the boundary's direction
    there.

    Parameters, ``starts`` and ``norm`` are as in ``atlas.stability``; attractors have their indices in
    ``atlas.attractors``. Each of ``saddles`` has:

    period       its period in forcing periods
    between      the two attractors whose basins meet at the saddle
    multipliers  multipliers as [real, imaginary], one of them outside the unit circle
    states       its section states
    normal       normal of the boundary at each state, a unit vector in the norm's coordinates w z
    slopes       for one mass, dv/dx along the boundary at each state
    manifold     with ``manifolds``, for one mass: lines, lists of states (x, v) in order, on the boundary
    ends         with ``manifolds``: why the branches of the manifold end

    ``box`` limits the manifolds by (low, high) of x and v; the default is the box of the initial states. ``troubles``
    lists boundaries on which no saddle was found, in words. Raise InputError as ``atlas.stability`` does, for manifolds
    of more than one mass, and if a coordinate drifts.

    >>> import atlas
    >>> found = atlas.saddles(system="gear-mesh", starts=8)
    >>> [(one["period"], one["between"]) for one in found["saddles"]]
    [(1, [0, 1])]
    """
    validate_flag("manifolds", manifolds)
    asked = AttractorSearch.from_arguments(given_values(parameters, named), system, settings, starts)
    return saddles_between(asked, validate_weights(norm, asked.record), manifolds, box)


def saddles_between(
    requested: AttractorSearch, norm: Mapping[str, float] | None = None, manifolds: bool = False, box: Box | None = None
) -> dict[str, Any]:
    """Return the ``saddles`` of an attractor search."""
    from atlas.robustness.boundary_tracking import saddles_of

    record = requested.record
    must_offer(record, "saddles")
    if manifolds and len(record.states) != 2:
        raise InputError(f"manifolds need a system with one mass, and {record.name!r} has {len(record.states) // 2}")
    table = requested.table
    w = requested.weights(norm)
    tracked = saddles_of(table, w)
    entries = [_described(saddle) for saddle in tracked.saddles]
    if manifolds:
        ends = _box(table, box)
        for entry, saddle in zip(entries, tracked.saddles, strict=True):
            branches = manifold_of(table, saddle, ends)
            entry["manifold"] = [(piece / w).tolist() for branch in branches for piece in branch.pieces]
            entry["ends"] = [branch.end for branch in branches]
    results = {"norm": dict(zip(record.states, w.tolist(), strict=True)), "attractors": len(table.attractors)}
    return requested.described | results | {"saddles": entries, "troubles": tracked.troubles}


def saddles_in(ds: "xr.Dataset", spec: "Spec", box: Box) -> "tuple[list[Array], list[Array]]":
    """Return the section points (N, 2) of the saddles between the basins of one mass, and the lines of their manifolds.

    ``box`` has the limits of both axes, x first. Raise InputError if the atlas is not one of basins of one mass.
    """
    from workers.attractors.basins import fixed_values

    if not is_basin_atlas(ds) or len(spec.system_def.states) != 2 or spec.attractors is None:
        raise InputError("overlay 'saddles' needs basins of one mass")
    values, order = fixed_values(spec.system_def, spec.parameters), [spec.system_def.states.index(name) for name in box]
    wide = {name: (low - BEYOND * (high - low), high + BEYOND * (high - low)) for name, (low, high) in box.items()}
    asked = AttractorSearch(spec.system_def, values, spec.settings, spec.attractors)
    saddles = saddles_between(asked, manifolds=True, box=wide)["saddles"]
    lines = [np.array(line)[:, order] for entry in saddles for line in entry["manifold"] if len(line) > 1]
    return [np.array(entry["states"])[:, order] for entry in saddles], lines


def _described(saddle: "Saddle") -> dict[str, Any]:
    return {
        "period": saddle.period,
        "between": sorted(saddle.sides),
        "multipliers": [[float(multiplier.real), float(multiplier.imag)] for multiplier in saddle.multipliers],
        "residual": saddle.residual,
        "states": saddle.states.tolist(),
        "normal": saddle.normal.tolist(),
        **({"slopes": saddle.slopes.tolist()} if len(saddle.along[0]) else {}),
    }


def _box(table: "AttractorTable", parameters: Box | None) -> tuple["Array", "Array"]:
    """Return the lowest and the highest state. Raise InputError for an unknown name, or limits that do not increase."""
    from workers.attractors.initial_states import boxes

    names = table.record.states
    low, high = (side[0].copy() for side in boxes(table.starts, table.oscillators, table.record))
    for name, ends in (
        {} if parameters is None else validate_type("box", parameters, Mapping, "(low, high) by state")
    ).items():
        first, last = validate_interval(f"box.{name}", ends)
        if name not in names or not first < last:
            raise InputError(f"box.{name}: found {first:g} to {last:g}, must increase and be of {' or '.join(names)}")
        low[names.index(name)], high[names.index(name)] = first, last
    return low, high


def manifold_of(table: "AttractorTable", saddle: "Saddle", box: tuple["Array", "Array"]) -> "Sequence[ManifoldBranch]":
    """Return the branches of the stable manifold of a saddle of one mass, two at each of its states, in coordinates w
    z.
    """
    from atlas.robustness.manifold import grow_manifold
    from atlas.robustness.section_map import SectionMap

    w, section_map = saddle.weights, SectionMap(table.cell.oscillator)
    inner = float(np.real(saddle.multipliers[np.argmin(np.abs(saddle.multipliers))]))
    turns = max(1, int(np.ceil(np.log(CONTRACTED) / np.log(max(abs(inner), 1e-300)))))
    turns += turns % 2 if inner < 0.0 else 0
    ends = _beyond_stops(table, box, w)
    length = TIMES * float(np.linalg.norm(ends[1] - ends[0]))
    across = _across(table, w)

    def image(states: "Array") -> "Array":
        return section_map.images(states / w, turns * saddle.period) * w

    return [
        grow_manifold(image, state * w, sign * along, ends, length, across)
        for state, along in zip(saddle.states, saddle.along, strict=True)
        for sign in (1.0, -1.0)
    ]


def _stops(table: "AttractorTable") -> list[tuple[float, float]]:
    """Return the position x of each rigid stop of one mass, and its side: 1 above, -1 below."""
    return [
        (stop[0] / row[0, 0], side if row[0, 0] > 0.0 else -side)
        for row, *both in table.cell.oscillator.rigid_stops
        for stop, side in zip(both, (1.0, -1.0), strict=True)
        if np.isfinite(stop[0]) and row[0, 0] != 0.0
    ]


def _beyond_stops(table: "AttractorTable", box: tuple["Array", "Array"], w: "Array") -> tuple["Array", "Array"]:
    """Return the limits of the box in coordinates w z, extended beyond a stop at its edge: manifolds continue there."""
    low, high = box[0] * w, box[1] * w
    room = 0.01 * (high[0] - low[0])
    for stop, side in _stops(table):
        if side > 0.0 and high[0] >= w[0] * stop - room:
            high[0] = w[0] * stop + room
        if side < 0.0 and low[0] <= w[0] * stop + room:
            low[0] = w[0] * stop - room
    return low, high


def _across(table: "AttractorTable", w: "Array") -> "Across":
    """Return the continuation of a manifold at a rigid stop, in coordinates w z."""
    from workers.model.oscillator import HEAD

    oscillator = table.cell.oscillator
    R, stops = float(oscillator.head[0, HEAD.R]), _stops(table)

    def across(point: "Array", step: "Array") -> "tuple[Array, Array, Array] | None":
        x, dx = point[0] / w[0], step[0] / w[0]
        for stop, side in stops if not oscillator.has_modes else ():
            share = (stop - x) / dx if dx != 0.0 else -1.0
            if side * dx > 0.0 and 0.0 <= share <= 1.0:
                last = point + share * step
                speed = side * last[1] / w[1]
                beyond = -R * speed if speed > 0.0 else -speed / R if R > 0.0 else np.inf
                if not np.isfinite(beyond) or speed == 0.0:
                    return None
                heading = np.array([-side, 0.0])
                return last, np.array([stop * w[0], side * beyond * w[1]]), heading
        return None

    return across
