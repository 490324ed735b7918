"""From an edge between cells to the events near it, and from an event to its curve."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from atlas.orbits.curves.cell_orbits import CEASES, CellOrbits
from atlas.orbits.curves.chords import find_passages
from atlas.orbits.orbit_table import SAME_ORBIT
from workers.continuation import Condition, Event, Family, Itinerary, Orbit, SolutionPoint, branch, curve
from workers.continuation.admissibility import VERTEX
from workers.continuation.branches import EDGE, BranchRun, Until
from workers.continuation.curves import is_impact_loss, without_impact
from workers.continuation.equilibria import HOPF, OF_EQUILIBRIA, equilibria, is_equilibrium
from workers.continuation.events import EXCHANGE, GRAZING, LOST
from workers.continuation.extended_system import PAIR, ExtendedSystem, conditions_on, solve
from workers.continuation.hopf import hopf_curve
from workers.continuation.orbit_equality import is_same_orbit
from workers.model.family import NoOscillatorError

Array = NDArray[np.float64]

STEP = 0.6
"""Maximum step of a short branch, as a share of its few cells."""

SAME_EVENT_DISTANCE = 1e-8
"""Distance, in units of the window, within which two events are equal, if their orbits are."""

NEAR_CURVE = 5e-3
"""Distance, in units of the window, from the chords of a curve within which an event may lie on the curve."""


class PlaneEvent(NamedTuple):
    """An event in the plane.

    kind           kind of the event
    condition      its condition
    orbit          its orbit
    contact_times  times of the orbit's contacts
    values (2,)    parameters
    kappa          cos theta of a pair of multipliers, else NaN
    """

    kind: str
    condition: Condition
    orbit: Orbit
    contact_times: Array
    values: Array
    kappa: float

    def as_event(self) -> Event:
        """Return the event as a record of ``workers.continuation``."""
        none = np.zeros(0, dtype=np.complex128)
        return Event(
            self.kind,
            (self.condition,),
            SolutionPoint(self.values, self.orbit, self.contact_times, none, 0),
            self.kappa,
        )

    @property
    def signature(self) -> tuple[str, int, int, bool]:
        """Properties common to all events of its curve up to a change of contacts: kind, periods, events, symmetry."""
        itinerary = self.orbit.itinerary
        return self.kind, itinerary.sections, len(itinerary.sides), itinerary.symmetric


class FollowedCurve(NamedTuple):
    """A curve as it was followed. Its orbits may change contacts or slides at points at which nothing jumps.

    event          the event from which the curve was followed
    values (N, 2)  parameters of the points
    orbits         orbits of the points
    contact_times  contact times of the points
    conditions     condition of the event on each orbit
    unstable (N,)  number of other unstable multipliers
    corners        points of codimension two: kind, and parameters (2,)
    ends           why the curve ends at its first and its last point
    """

    event: PlaneEvent
    values: Array
    orbits: list[Orbit]
    contact_times: Array
    conditions: list[Condition]
    unstable: NDArray[np.int64]
    corners: list[tuple[str, Array]]
    ends: tuple[str, str]


class EdgeSearchResult(NamedTuple):
    """The result of a search near an edge.

    events  the events
    why     the reason in words if there are none
    fate    fate of the cell's orbit at the neighbour's parameters: CEASES, PERSISTS or IS
    """

    events: list[PlaneEvent]
    why: str = ""
    fate: int = CEASES


def events_between(orbits: CellOrbits, start: int, beyond: int, cells: float) -> EdgeSearchResult:
    """Return the events at which a cell's orbit gains or loses stability, or ends, towards a neighbour and beyond it.

    The orbit is followed over ``cells`` cells; events are in order along its branch.
    """
    plane, orbit = orbits.plane, orbits.orbit_of_row(start)
    if orbit is None:
        return EdgeSearchResult([], "found no orbit from the state of a cell")
    start_values, target_values = plane.values(np.array([start, beyond]))
    axis = 0 if start_values[0] != target_values[0] else 1
    low, high = plane.window[plane.axes[axis]]
    end = float(np.clip(start_values[axis] + cells * (target_values[axis] - start_values[axis]), low, high))
    try:
        run, events = _towards(orbits, orbit, start_values, axis, end, min(STEP, 2.0 * STEP / cells))
    except (ValueError, np.linalg.LinAlgError) as error:
        return EdgeSearchResult([], f"the orbit of a cell cannot be followed: {error}")
    why = run.ends[1 if end > start_values[axis] else 0]
    if events or why != EDGE:
        return EdgeSearchResult(
            events, "" if events else f"the branch of a cell's orbit ends at no event of its own: {why}"
        )
    points = [
        point
        for point in run.points
        if abs(point.values[0] - start_values[axis]) <= abs(target_values[axis] - start_values[axis])
    ]
    nearest = min(points, key=lambda point: abs(float(point.values[0]) - float(target_values[axis])))
    values = start_values.copy()
    values[axis] = nearest.values[0]
    return EdgeSearchResult([], "the orbit of a cell continues beyond", orbits.fate_at(nearest.orbit, values, beyond))


def events_towards(
    orbits: CellOrbits,
    orbit: Orbit,
    parameters: Array,
    axis: int,
    end: float,
    resolution: float,
    until: Until | None = None,
) -> list[PlaneEvent]:
    """Return the events at which an orbit at parameters (2,) gains or loses stability, or ends, along an axis.

    The axis's parameter goes to ``end``, or to the first event for which ``until`` is True. Events are in order along
    the branch, which may turn back. Errors are those of ``workers.continuation.branch``.
    """
    return _towards(orbits, orbit, parameters, axis, end, resolution, until)[1]


def _towards(
    orbits: CellOrbits,
    orbit: Orbit,
    parameters: Array,
    axis: int,
    end: float,
    resolution: float,
    until: Until | None = None,
) -> tuple[BranchRun, list[PlaneEvent]]:
    """Return the branch of ``events_towards``, and the events."""
    behind = float(parameters[axis]) - 1e-6 * (end - float(parameters[axis]))
    window = (min(behind, end), max(behind, end))
    family, value = orbits.family_along(axis, parameters), float(parameters[axis])
    if is_equilibrium(orbit, orbits.plane.system):
        run = equilibria(family, orbit, value, window, resolution=resolution).run
    else:
        run = branch(family, orbit, value, window, resolution=resolution, until=until)
    events, ends = [], {id(point): end for point, end in zip((run.points[0], run.points[-1]), run.ends, strict=True)}
    for event in run.events if behind < end else run.events[::-1]:
        if bounds_stability(event) or (event.kind == EXCHANGE == ends.get(id(event.point))):
            values = parameters.copy()
            values[axis] = event.point.values[0]
            events.append(_located(event, values))
    return run, events


def bounds_stability(event: Event) -> bool:
    """Return True if a stable orbit loses stability or ends at an event of a branch."""
    return event.point.unstable == 0 and len(event.conditions) == 1 and event.kind not in (VERTEX, EXCHANGE)


def _located(event: Event, values: Array) -> PlaneEvent:
    """Return the event in the plane; a lost impact becomes the graze of the orbit without it."""
    (condition,), point = event.conditions, event.point
    if is_impact_loss(event):
        orbit, graze, contacts = without_impact(point.orbit, condition.impact)
        return PlaneEvent(GRAZING, graze, orbit, contacts, values, event.kappa)
    if condition.kind == PAIR:
        condition = condition._replace(kappa=event.kappa)
    kind = GRAZING if event.kind in LOST else event.kind
    return PlaneEvent(kind, condition, point.orbit, point.contacts, values, event.kappa)


def follow_event(orbits: CellOrbits, event: PlaneEvent, resolution: float, budget: int) -> FollowedCurve | str:
    """Return the curve of an event through the plane's window, or the reason why there is none.

    resolution  longest step, as a share of the window
    budget      maximum number of points

    Of the events of equilibria only Hopf points are followed.
    """
    still, name = event.condition.kind in OF_EQUILIBRIA, event.kind.replace("_", " ")
    if still and event.kind != HOPF:
        return f"the {name} of an equilibrium is not followed, only Hopf points are"
    family, where = orbits.family, (event.values, orbits.plane.window)
    try:
        if still:
            run = hopf_curve(family, event.orbit, *where, resolution=resolution, budget=budget)
        else:
            run = curve(family, event.as_event(), *where, resolution=resolution, budget=budget)
    except (ValueError, np.linalg.LinAlgError) as error:
        return str(error)
    if len(run.points) < 2:
        return f"the {name} is alone: no step along its curve converges"
    curve_points = run.points if still else with_own_ends(run.points)
    grazes = min(len(point.contacts) for point in curve_points)  # other grazes add their time
    conditions = [event.condition] * len(curve_points) if still else _conditions(orbits, event, curve_points)
    if conditions is None:
        return f"the {name} is lost on its way: its own event is not that of a neighbour"
    return FollowedCurve(
        event=event,
        values=np.array([point.values for point in run.points]),
        orbits=[point.orbit for point in curve_points],
        contact_times=np.array([point.contacts[:grazes] for point in curve_points]),
        conditions=conditions,
        unstable=np.array([point.unstable for point in run.points], dtype=np.int64),
        corners=[(met.kind, met.point.values) for met in run.events if len(met.conditions) == 2],
        ends=run.ends,
    )


def with_own_ends(points: list[SolutionPoint]) -> list[SolutionPoint]:
    """Return the points, with an end at which the orbit becomes another one replaced by its neighbour."""
    curve_points = list(points)
    for end, neighbour in ((0, 1), (-1, -2)):
        if curve_points[end].orbit.itinerary != curve_points[neighbour].orbit.itinerary:
            curve_points[end] = curve_points[neighbour]
    return curve_points


def _length(itinerary: Itinerary) -> tuple[int, bool]:
    return itinerary.sections, itinerary.symmetric


def _conditions(orbits: CellOrbits, event: PlaneEvent, points: list[SolutionPoint]) -> list[Condition] | None:
    """Return the condition of an event on the orbit of each point, from the point with the event's itinerary to both
    ends.
    """
    start = next((k for k, point in enumerate(points) if point.orbit.itinerary == event.orbit.itinerary), 0)
    conditions = {start: event.condition}
    for step, last in ((1, len(points)), (-1, -1)):
        for k in range(start + step, last, step):
            next_point, former = points[k], points[k - step]
            conditions[k] = conditions[k - step]
            if next_point.orbit.itinerary != former.orbit.itinerary:
                span = former.orbit.span(orbits.family.model(former.values[None]))
                carried = conditions_on(next_point.orbit, (conditions[k - step],), former.orbit, span)
                if carried is None:
                    return None
                (conditions[k],) = carried
    return [conditions[k] for k in range(len(points))]


def lies_on(orbits: CellOrbits, event: PlaneEvent, known: FollowedCurve) -> bool:
    """Return True if an event is a point of a known curve: at its parameters the curve's own equations give its orbit.

    Distance in the plane is not enough: curves of different orbits cross, and may coincide.
    """
    if event.kind != known.event.kind or _length(event.orbit.itinerary) != _length(known.event.orbit.itinerary):
        return False
    width = orbits.plane.width
    for chord, share in find_passages(known.values / width, event.values / width, NEAR_CURVE):
        if event.condition.kind in OF_EQUILIBRIA:
            return True  # a machine has one equilibrium that continues this one
        solution = _solved_at(orbits.family, event, known, chord, share, width)
        if solution is None:
            continue
        values, orbit = solution
        omega = float(orbits.omega(values[None])[0])
        near = float(np.max(np.abs(values - event.values) / width)) < SAME_EVENT_DISTANCE
        if near and is_same_orbit(event.orbit, orbit, omega, SAME_ORBIT):
            return True
    return False


def _is_alike(one: Itinerary, other: Itinerary) -> bool:
    return _length(one) == _length(other) and len(one.sides) == len(other.sides)


def _is_whole(known: FollowedCurve, chord: int) -> bool:
    """Return True if the orbits at both ends of a chord have the same events."""
    return known.orbits[chord].itinerary == known.orbits[chord + 1].itinerary


def _solved_at(
    family: Family, event: PlaneEvent, known: FollowedCurve, chord: int, share: float, width: Array
) -> tuple[Array, Orbit] | None:
    """Return the point of a curve on the line across its chord, with its orbit."""
    ends = [k for k in (chord, chord + 1) if _is_alike(known.orbits[k].itinerary, event.orbit.itinerary)]
    if not ends:
        return None
    condition, along = known.conditions[ends[0]], known.values[chord + 1] - known.values[chord]
    if condition.kind == PAIR:
        condition = condition._replace(kappa=event.kappa)
    equations = ExtendedSystem(family, known.orbits[ends[0]], (condition,), known.values[ends[0]], width)
    packed = [equations.pack(known.orbits[k], known.contact_times[k], known.values[k]) for k in ends]
    guess = (1.0 - share) * packed[0] + share * packed[1] if _is_whole(known, chord) else packed[0]
    row = np.zeros(len(guess))
    row[-2:] = along / width**2
    row /= np.linalg.norm(row * equations.scale)
    try:
        equations = equations.rebordered(guess)
        solved = solve(equations, guess, row)
    except (NoOscillatorError, np.linalg.LinAlgError):
        return None
    return (equations.values(solved.X), equations.orbit(solved.X)) if solved.converged else None
