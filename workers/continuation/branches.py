"""Branches of periodic orbits in one parameter, stable and unstable, with their events; and what leaves at events."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.continuation.equations import Itinerary, Orbit
from workers.continuation.events import Event
from workers.continuation.extended import MINUS_ONE, Condition, Extended, solve
from workers.continuation.follow import BranchRun, Until, follow, never, window_of
from workers.continuation.linear import Family

Array = NDArray[np.float64]

RESOLUTION, BUDGET = 0.02, 2000
"""The longest step as a share of the window; points of either way after which it ends and says so."""


class Start(NamedTuple):
    """An orbit on a branch near where another one leaves: the orbit and the parameter there."""

    orbit: Orbit
    value: float


def branch(
    family: Family,
    orbit: Orbit,
    value: float,
    window: tuple[float, float],
    *,
    resolution: float = RESOLUTION,
    budget: int = BUDGET,
    until: Until = never,
) -> BranchRun:
    """The branch of an orbit of a family with one free parameter, both ways from ``value``.

    Pseudo-arclength in times, speeds and the parameter. Events are folds, symmetry breakings, period doublings,
    Neimark-Sacker points, and the grazes and lost impacts at which the orbit ceases to exist and the branch ends.
    Either way ends at the first event of which ``until`` is true.
    Raises ValueError, in one line, for R = 0, for a start that no orbit is near, that is not admissible, or that is a
    shorter or symmetric orbit repeated.
    """
    bounds = window_of(family.free, dict.fromkeys(family.free, window))
    values = np.array([value])
    equations = Extended(family, orbit, (), values, bounds.width)
    row = np.zeros(equations.states + 1)
    row[-1] = 1.0 / equations.scale[-1]
    found = solve(equations, equations.pack(orbit, np.zeros(0), values), row)
    if not found.converged:
        raise ValueError(f"Newton's method finds no orbit at {family.free[0]} = {value:g}")
    return follow(equations, found.X, bounds, resolution, budget, until)


def leaving_branch(family: Family, event: Event, width: float, amplitude: float = 0.02) -> Start:
    """The doubled orbit next to a period doubling, or the asymmetric one next to a symmetry breaking.

    ``amplitude``: how far along the critical direction, in units of the scale of times and speeds; ``width``: that
    of the parameter's window. The orbit's other half, or its mirror image, is the same branch the other way.
    Raises ValueError for other events, and where Newton's method finds none.
    """
    if event.conditions != (Condition(MINUS_ONE),):
        raise ValueError(f"a branch leaves at symmetry_breaking and period_doubling, not at {event.kind}")
    point, itinerary = event.point, event.point.orbit.itinerary
    square = Extended(family, point.orbit, event.conditions, point.values, np.array([width]))
    X = square.pack(point.orbit, np.zeros(0), point.values)
    square.follow(X)
    w = square.null_vector(0) * square.unit[: len(square.null_vector(0))]
    m, sign = len(itinerary.sides), itinerary.sign
    span = float(itinerary.span(square.model(point.values)[0])[0])
    sides = itinerary.sides + tuple(sign * side for side in itinerary.sides)
    periods = itinerary.periods if itinerary.symmetric else 2 * itinerary.periods
    t, v = point.orbit.times, point.orbit.speeds
    times, speeds = np.concatenate([t, t + span]), np.concatenate([v, sign * v])
    ways = np.concatenate([w[:m], -w[:m], w[m : 2 * m], -sign * w[m : 2 * m], w[2 * m :]])
    whole = Orbit(Itinerary(sides, periods), times, speeds, point.orbit.offset)
    equations = Extended(family, whole, (), point.values, np.array([width]))
    X = equations.pack(whole, np.zeros(0), point.values)
    direction = np.zeros(len(X))
    direction[: len(ways)] = ways
    unit = direction / equations.scale
    unit /= np.linalg.norm(unit)
    found = solve(equations, X + amplitude * unit * equations.scale, unit / equations.scale)
    if not found.converged:
        raise ValueError(f"Newton's method finds no orbit beside the {event.kind}; try another amplitude")
    return Start(equations.orbit(found.X), float(equations.values(found.X)[0]))
