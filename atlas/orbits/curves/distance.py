"""The distance of an operating point to the events of its orbit."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError, check_names
from atlas.orbits.curves.cell_orbits import CellOrbits
from atlas.orbits.curves.following import PlaneEvent, bounds_stability, events_towards
from atlas.orbits.curves.plane import CurvePlane, plane_of
from atlas.orbits.curves.table import KINDS
from atlas.query.open import handle_of
from atlas.query.queries import at
from workers.continuation import Event, Orbit
from workers.continuation.events import GRAZING, LOST

if TYPE_CHECKING:
    import xarray as xr

RESOLUTION = 0.02
"""The longest step along a branch, as a share of its window."""


def distance_to(ds: "xr.Dataset", kind: str | None, point: Mapping[str, float]) -> list[dict[str, Any]]:
    """The nearest events of the orbit at an operating point: along each axis, either way, the first of a kind, or of
    any; exact, from branches of the orbit of the point's cell through the whole plane. The nearest first.

    Keys: ``axis``; ``kind``; ``value`` of the axis at the event; ``distance`` to it, signed, in the axis's unit, and
    ``share`` of the plane's width. An impact that is lost is a graze. Events are those where the orbit loses or gains
    stability or ends; none is listed if it continues to the plane's edge.
    Raises InputError if the cell has no proven periodic orbit, or if the orbit does not attract at the point.
    """
    if kind is not None:
        check_names("kind of event", [kind], KINDS)
        kind = GRAZING if kind in LOST else kind
    plane = plane_of(handle_of(ds))
    results = at(ds, point)
    orbits, here = CellOrbits(plane), np.array([float(point[name]) for name in plane.axes])
    orbit = _orbit_at(orbits, plane, results, here)
    entries = [
        _entry(plane, axis, here, event)
        for axis in (0, 1)
        for end in plane.window[plane.axes[axis]]
        for event in _first(orbits, orbit, here, axis, end, kind)
    ]
    return sorted(entries, key=lambda entry: float(entry["share"]))


def _orbit_at(orbits: CellOrbits, plane: CurvePlane, cell: Mapping[str, Any], here: NDArray[np.float64]) -> Orbit:
    """The orbit of a cell, taken to a point near it."""
    x, y = (int(np.argmin(np.abs(v - cell[name]))) for v, name in zip((plane.x, plane.y), plane.axes, strict=True))
    number = y * len(plane.x) + x
    where = ", ".join(f"{name} = {cell[name]:g}" for name in plane.axes)
    own = orbits.orbit_of_row(number)
    if own is None:
        raise InputError(f"the cell at {where} is {cell['regime']}: only a proven periodic orbit has events")
    reached = orbits.continue_orbits([own], plane.values(np.array([number])), here[None], attracting=True)
    if not reached.converged[0]:
        raise InputError(f"the orbit of the cell at {where} does not attract at the point itself; ask at the cell")
    return reached.orbit(0)


def _first(
    orbits: CellOrbits, orbit: Orbit, here: NDArray[np.float64], axis: int, end: float, kind: str | None
) -> Iterator[PlaneEvent]:
    """The first event of a kind on the way to an end, if any."""
    if here[axis] == end:
        return

    def wanted(event: Event) -> bool:
        return bounds_stability(event) and kind in (None, GRAZING if event.kind in LOST else event.kind)

    events = events_towards(orbits, orbit, here, axis, end, RESOLUTION, wanted)
    yield from [event for event in events if kind in (None, event.kind)][:1]


def _entry(plane: CurvePlane, axis: int, here: NDArray[np.float64], event: PlaneEvent) -> dict[str, Any]:
    distance = float(event.values[axis] - here[axis])
    return {
        "axis": plane.axes[axis],
        "kind": event.kind,
        "value": float(event.values[axis]),
        "distance": distance,
        "share": abs(distance) / float(plane.width[axis]),
    }
