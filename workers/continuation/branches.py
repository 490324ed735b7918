"""Branches of periodic orbits in one parameter, stable and unstable, with their events; and what leaves at events."""

from typing import NamedTuple

import numpy as np

from workers.continuation.equations import Itinerary, Orbit, unpacked
from workers.continuation.events import Event
from workers.continuation.extended import MINUS_ONE, Condition, Extended, solve
from workers.continuation.follow import BranchRun, Until, follow, never, window_of
from workers.continuation.oscillator import Family

RESOLUTION, MOST_POINTS = 0.02, 2000
"""The longest step as a share of the window; points of either direction after which it ends and says so."""


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
    budget: int = MOST_POINTS,
    until: Until = never,
) -> BranchRun:
    """The branch of an orbit of a family with one free parameter, in both directions from ``value``.

    Pseudo-arclength in times, speeds and the parameter. Events are folds, symmetry breakings, period doublings,
    Neimark-Sacker points, and the grazes and lost impacts at which the orbit ceases to exist and the branch ends.
    Either direction ends at the first event of which ``until`` is true.
    Raises ValueError, in one line, for R = 0, for a start that no orbit is near, that is not admissible, or that is a
    shorter or symmetric orbit repeated.
    """
    bounds = window_of(family.free, dict.fromkeys(family.free, window))
    values = np.array([value])
    equations = Extended(family, orbit, (), values, bounds.width)
    row = np.eye(1, len(equations.scale), equations.states)[0] / equations.scale
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
    none, widths, (values, orbit, *_) = np.zeros(0), np.array([width]), event.point
    square = Extended(family, orbit, event.conditions, values, widths)
    critical = square.at(square.pack(orbit, none, values)).null_vector(0)
    w = unpacked((critical * square.unit[: len(critical)])[None], square.m, len(critical) - 2 * square.m)
    (sides, periods, symmetric), sign = orbit.itinerary, orbit.itinerary.sign
    span = float(orbit.itinerary.span(square.model(values))[0])
    itinerary = Itinerary(sides + tuple(sign * side for side in sides), periods if symmetric else 2 * periods)
    times = np.concatenate([orbit.times, orbit.times + span])
    whole = Orbit(itinerary, times, np.concatenate([orbit.speeds, sign * orbit.speeds]), orbit.offset)
    equations = Extended(family, whole, (), values, widths)
    change = Orbit(itinerary, np.append(w.t, -w.t), np.append(w.v, -sign * w.v), float(w.offset[0]))
    unit = equations.pack(change, none, np.zeros(1)) / equations.scale
    unit /= np.linalg.norm(unit)
    X = equations.pack(whole, none, values) + amplitude * unit * equations.scale
    found = solve(equations, X, unit / equations.scale)
    if not found.converged:
        raise ValueError(f"Newton's method finds no orbit beside the {event.kind}; try another amplitude")
    return Start(equations.orbit(found.X), float(equations.values(found.X)[0]))
