"""Curves of bifurcations and grazes in two parameters."""

import numpy as np

from workers.continuation.branches import MAX_POINTS, RESOLUTION, BranchRun, bounds_of, follow_both_ways
from workers.continuation.events import Event
from workers.continuation.extended_system import GRAZE, PAIR, SPEED, Condition, ExtendedSystem, solve
from workers.continuation.families import Family
from workers.continuation.itinerary import Orbit
from workers.continuation.pseudo_arclength import tangent_at
from workers.model.hybrid_modes import SIGNALS
from workers.model.oscillator import Array


def curve(
    family: Family,
    event: Event,
    values: Array,
    window: dict[str, tuple[float, float]],
    *,
    resolution: float = RESOLUTION,
    budget: int = MAX_POINTS,
) -> BranchRun:
    """Return the curve of an event in two free parameters, in both directions from ``values`` (2,).

    family      machines over two free parameters
    event       an event of a branch, or any Event with conditions, orbit, contact times and kappa near a solution
    values      (2,) parameters of the event
    window      bounds of both parameters, by name
    resolution  longest step, as a share of the window
    budget      maximum number of points of either direction

    Where an impact is lost, the orbit without the impact grazes. That orbit is followed, since its multipliers stay
    finite. An orbit whose friction begins to stick at zero rate is followed itself.

    The events of the curve are its points of codimension two: cusp, fold_flip, resonance_1_1 to resonance_1_4,
    graze_fold and the like, double_graze. The curve continues through points at which the event itself continues. It
    also continues where the contacts or slides of its orbit change without a jump of the motion; on a curve with a
    condition on multipliers the derivative must not jump either. It ends at the edge of the window, where it closes,
    where its orbits cease to be admissible (at another graze), at kappa = 1 or -1, or after ``budget`` points per
    direction. The result contains the reason.

    Raise ValueError as ``branch``.
    """
    if len(family.free) != 2 or len(event.conditions) != 1:
        raise ValueError(f"a curve needs two free parameters and one condition, found {family.free}, {event.kind}")
    bounds = bounds_of(family.free, window)
    condition = event.conditions[0]
    if condition.kind == PAIR:
        condition = condition._replace(kappa=event.kappa)
    orbit, contacts = event.point.orbit, event.point.contacts
    if is_impact_loss(event):
        orbit, condition, contacts = without_impact(orbit, condition.impact)
    equations = ExtendedSystem(family, orbit, (condition,), values, bounds[1] - bounds[0])
    X = equations.pack(orbit, contacts, np.asarray(values, dtype=np.float64))
    equations = equations.rebordered(X)
    # the nearest point of the curve: across its tangent at X
    tangent = tangent_at(equations, equations.with_jacobian(X[None])[1][0], np.ones(len(X)))
    solved = solve(equations, X, tangent / equations.scale)
    if not solved.converged:
        raise ValueError(f"Newton's method finds no {event.kind} near the given parameters")
    return follow_both_ways(equations, solved.X, bounds, resolution, budget, None)


def is_impact_loss(event: Event) -> bool:
    """Return True if an impact of the event's orbit has zero speed.

    A slide that ends at zero rate has the same condition.
    """
    condition = event.conditions[0]
    if condition.kind != SPEED:
        return False
    leg = event.point.orbit.itinerary.chains[condition.impact][0]
    return leg.signal < SIGNALS * len(leg.code.contacts)


def without_impact(orbit: Orbit, impact: int) -> tuple[Orbit, Condition, Array]:
    """Return an orbit without an impact whose speed is zero, the condition of the graze there, and its time (1,)."""
    others, itinerary = [i for i in range(len(orbit.times)) if i != impact], orbit.itinerary
    ((leg,), time) = itinerary.chains[impact], orbit.times[impact : impact + 1]
    still = (leg._replace(begun=(0,) * len(leg.begun), signal=-1, side=0),)
    legs = tuple(itinerary.chains[i] for i in others) or (still,)
    periods = itinerary.periods or int(not others)
    rest = itinerary._replace(sides=tuple(itinerary.sides[i] for i in others), periods=periods, legs=legs).bare
    graze = Condition(GRAZE, side=leg.side, signal=leg.signal)
    first = (
        orbit.times[others[0]] if itinerary.is_cycle and others else 0.0
    )  # times of a cycle count from its first event
    return Orbit(rest, orbit.times[others] - first, orbit.speeds[others], orbit.length), graze, time - first
