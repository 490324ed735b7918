"""Find events, that is bifurcations and grazes of orbits, near an edge between cells, and follow their curves."""

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
"""Maximum step of a branch that leads from a cell past an edge, as a share of the distance between cells."""

SAME_EVENT_DISTANCE = 1e-8
"""Distance in the plane, relative to its width, below which two bifurcations or grazes with the same orbit are one."""

NEAR_CURVE = 5e-3
"""Maximum distance, relative to the width of the plane, between an event and the polyline of a curve that may contain
it.
"""


class PlaneEvent(NamedTuple):
    """An event, that is a bifurcation or a graze of an orbit, at a point of a two-parameter plane.

    kind           kind of the event
    condition      the condition that the orbit meets, such as a multiplier of -1 or a contact at zero velocity
    orbit          the orbit
    contact_times  times of the orbit's contacts at zero velocity
    values (2,)    parameters
    kappa          cos theta of a pair of multipliers exp(+-i theta), else NaN
    """

    kind: str
    condition: Condition
    orbit: Orbit
    contact_times: Array
    values: Array
    kappa: float

    def as_event(self) -> Event:
        """Return the bifurcation or graze as an event of ``workers.continuation``, from which its curve can be
        followed.
        """
        none = np.zeros(0, dtype=np.complex128)
        return Event(
            self.kind,
            (self.condition,),
            SolutionPoint(self.values, self.orbit, self.contact_times, none, 0),
            self.kappa,
        )

    @property
    def signature(self) -> tuple[str, int, int, bool]:
        """What all events of one curve have in common: kind, period, number of impacts and other events, and symmetry.

        An exception are curves along which the orbit gains or loses a contact.
        """
        itinerary = self.orbit.itinerary
        return self.kind, itinerary.sections, len(itinerary.sides), itinerary.symmetric


class FollowedCurve(NamedTuple):
    """A curve of bifurcations or grazes as it was followed, with the orbit at each point.

    The orbits may gain or lose contacts or slides along the curve at points at which nothing jumps.

    event          the event from which the curve was followed
    values (N, 2)  parameters of the points
    orbits         orbits of the points
    contact_times  times, at each point, of the orbit's contacts at zero velocity
    conditions     condition of the event on each orbit
    unstable (N,)  number of multipliers with modulus above 1, not counting the event's own
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
    """The events found near an edge between two cells, by following the orbit of one cell to the other.

    events  the events
    why     the reason in words if there are none
    fate    what becomes of the cell's orbit at the neighbour's parameters: CEASES, PERSISTS or IS
    """

    events: list[PlaneEvent]
    why: str = ""
    fate: int = CEASES


def events_between(orbits: CellOrbits, start: int, beyond: int, cells: float) -> EdgeSearchResult:
    """Return the events at which a cell's orbit gains or loses stability, or ends, towards a neighbour and beyond it.

    orbits  orbits of the plane's cells
    start   number of the cell
    beyond  number of the neighbour
    cells   distance, in cells, over which the orbit is followed

    Events are in order along the branch of the orbit.
    """
    plane, orbit = orbits.plane, orbits.orbit_of_row(start)
    if orbit is None:
        return EdgeSearchResult([], "found no orbit from the state of a cell")
    start_values, target_values = plane.values(np.array([start, beyond]))
    axis = 0 if start_values[0] != target_values[0] else 1
    low, high = plane.window[plane.axes[axis]]
    end = float(np.clip(start_values[axis] + cells * (target_values[axis] - start_values[axis]), low, high))
    try:
        run, events = follow_towards(orbits, orbit, start_values, axis, end, min(STEP, 2.0 * STEP / cells))
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


def follow_towards(
    orbits: CellOrbits,
    orbit: Orbit,
    parameters: Array,
    axis: int,
    end: float,
    resolution: float,
    until: Until | None = None,
) -> tuple[BranchRun, list[PlaneEvent]]:
    """Return the branch of an orbit at parameters (2,) along an axis, and its events that bound stability.

    The parameter with index ``axis`` is varied to ``end``, or to the first event for which ``until`` is True. Steps are
    at most ``resolution``, a share of that range. At the events the orbit gains or loses stability, or ends; they are
    in order along the branch, which may turn back. Errors are those of ``workers.continuation.branch``.
    """
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
    """Return True if a stable orbit loses stability or ends at this bifurcation or graze of a branch."""
    return event.point.unstable == 0 and len(event.conditions) == 1 and event.kind not in (VERTEX, EXCHANGE)


def _located(event: Event, values: Array) -> PlaneEvent:
    """Convert an event of a branch at parameters ``values`` (2,) to an event of the plane.

    If an impact loses its speed, the event becomes the graze of the orbit without that impact.
    """
    (condition,), point = event.conditions, event.point
    if is_impact_loss(event):
        orbit, graze, contacts = without_impact(point.orbit, condition.impact)
        return PlaneEvent(GRAZING, graze, orbit, contacts, values, event.kappa)
    if condition.kind == PAIR:
        condition = condition._replace(kappa=event.kappa)
    kind = GRAZING if event.kind in LOST else event.kind
    return PlaneEvent(kind, condition, point.orbit, point.contacts, values, event.kappa)


def follow_event(orbits: CellOrbits, event: PlaneEvent, resolution: float, budget: int) -> FollowedCurve | str:
    """Follow the curve of an event through the plane, to the limits of its axes; return a reason in words on failure.

    resolution  longest step, as a share of the plane's width
    budget      maximum number of points

    Among the events of equilibria, only Hopf bifurcations are followed.
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
    """Return the points of a branch or curve without the different orbits at which it may end.

    An end point whose orbit has another sequence of impacts and other events than its neighbour is replaced by the
    neighbour.
    """
    curve_points = list(points)
    for end, neighbour in ((0, 1), (-1, -2)):
        if curve_points[end].orbit.itinerary != curve_points[neighbour].orbit.itinerary:
            curve_points[end] = curve_points[neighbour]
    return curve_points


def _length(itinerary: Itinerary) -> tuple[int, bool]:
    return itinerary.sections, itinerary.symmetric


def _conditions(orbits: CellOrbits, event: PlaneEvent, points: list[SolutionPoint]) -> list[Condition] | None:
    """Return, for the orbit of each point of a curve, the condition that makes the point a point of the curve.

    The condition of the event holds for orbits with the event's own sequence of impacts. It is translated, from there
    to both ends, whenever this sequence changes. Return None if a translation fails.
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
    """Return True if an event, a bifurcation or graze at a point of the plane, belongs to a known curve.

    The equations of the curve are solved next to the event, and the solution must have the parameters and the orbit of
    the event. Distance in the plane is not enough: curves of different orbits cross, and may coincide.
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
    """Return True if the orbits at both ends of a chord have the same sequence of impacts and other events.

    A chord is the straight line between two consecutive points of a curve.
    """
    return known.orbits[chord].itinerary == known.orbits[chord + 1].itinerary


def _solved_at(
    family: Family, event: PlaneEvent, known: FollowedCurve, chord: int, share: float, width: Array
) -> tuple[Array, Orbit] | None:
    """Return the parameters (2,) and the orbit of a curve's exact point near a chord, the line between two of its
    points.

    The point lies on the line across the chord at position ``share``, from 0 at the chord's first point to 1 at its
    last. None if no end of the chord has an orbit like the event's, or Newton's method does not converge.
    """
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
