"""The distance of an operating point to the bifurcations and grazes of its orbit."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError, check_names
from atlas.orbits.curves.cell_orbits import CellOrbits
from atlas.orbits.curves.following import PlaneEvent, bounds_stability, follow_towards
from atlas.orbits.curves.plane import CurvePlane, plane_of
from atlas.orbits.curves.table import KINDS
from atlas.query.open import handle_of
from atlas.query.queries import nearest_cell
from workers.continuation import Event, Orbit
from workers.continuation.events import GRAZING, LOST

if TYPE_CHECKING:
    import xarray as xr

RESOLUTION = 0.02
"""Maximum step along a branch, relative to the range of the parameter."""


def distance_to(ds: "xr.Dataset", kind: str | None, point: Mapping[str, float]) -> list[dict[str, Any]]:
    """Return the bifurcations and grazes nearest to an operating point: the first along each axis in either direction.

    They are located exactly, on branches of the orbit of the point's cell through the whole plane, and sorted by
    distance. ``kind`` is the kind of event, None for any. Each event is a dict with the keys:

    axis      name of the axis
    kind      kind of the event; a lost impact is a graze
    value     value of the axis at the event
    distance  signed distance to the event, in the axis's unit
    share     distance as a share of the plane's width

    Events are those at which the orbit loses or gains stability, or ends. None is listed if the orbit continues to the
    edge of the plane. Raise InputError if the cell has no proven periodic orbit, or if the orbit does not attract at
    the point.
    """
    if kind is not None:
        check_names("kind of event", [kind], KINDS)
        kind = GRAZING if kind in LOST else kind
    plane = plane_of(handle_of(ds))
    results = nearest_cell(ds, point)
    orbits, coordinates = CellOrbits(plane), np.array([float(point[name]) for name in plane.axes])
    orbit = _orbit_at(orbits, plane, results, coordinates)
    entries = [
        _entry(plane, axis, coordinates, event)
        for axis in (0, 1)
        for end in plane.window[plane.axes[axis]]
        for event in _first(orbits, orbit, coordinates, axis, end, kind)
    ]
    return sorted(entries, key=lambda entry: float(entry["share"]))


def _orbit_at(orbits: CellOrbits, plane: CurvePlane, cell: Mapping[str, Any], point: NDArray[np.float64]) -> Orbit:
    """Return the orbit of the cell nearest to an operating point (2,), continued to the point's parameters."""
    x, y = (int(np.argmin(np.abs(v - cell[name]))) for v, name in zip((plane.x, plane.y), plane.axes, strict=True))
    number = y * len(plane.x) + x
    where = ", ".join(f"{name} = {cell[name]:g}" for name in plane.axes)
    cell_orbit = orbits.orbit_of_row(number)
    if cell_orbit is None:
        raise InputError(f"the cell at {where} is {cell['regime']}: events need a proven periodic orbit")
    reached = orbits.continue_orbits([cell_orbit], plane.values(np.array([number])), point[None], attracting=True)
    if not reached.converged[0]:
        raise InputError(f"the orbit of the cell at {where} does not attract at the point; use the cell's point")
    return reached.orbit(0)


def _first(
    orbits: CellOrbits, orbit: Orbit, point: NDArray[np.float64], axis: int, end: float, kind: str | None
) -> Iterator[PlaneEvent]:
    """Yield the first bifurcation or graze of an orbit along an axis from a point to the value ``end``; nothing if
    none.

    ``kind`` is the kind to look for, None for any.
    """
    if point[axis] == end:
        return

    def ends_search(event: Event) -> bool:
        return bounds_stability(event) and kind in (None, GRAZING if event.kind in LOST else event.kind)

    _, events = follow_towards(orbits, orbit, point, axis, end, RESOLUTION, ends_search)
    yield from [event for event in events if kind in (None, event.kind)][:1]


def _entry(plane: CurvePlane, axis: int, point: NDArray[np.float64], event: PlaneEvent) -> dict[str, Any]:
    distance = float(event.values[axis] - point[axis])
    return {
        "axis": plane.axes[axis],
        "kind": event.kind,
        "value": float(event.values[axis]),
        "distance": distance,
        "share": abs(distance) / float(plane.width[axis]),
    }
