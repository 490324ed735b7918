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
    """The curve of an event in the plane of a family's two free parameters, in both directions from ``values`` (2,).

    event    one located on a branch, or any Event with conditions, orbit, contact times and kappa near a solution
    window   bounds of both parameters by name
    Where an impact is lost, the orbit without it grazes; that orbit is followed, since its multipliers stay finite. The
    orbit whose friction begins to stick at no rate is followed itself.
    Its events are its points of codimension two: cusp, fold_flip, resonance_1_1 to resonance_1_4,
    graze_fold and the like, double_graze. It continues through points where the event itself continues, and where the
    contacts or slides of its orbit change though neither the motion nor, if it asks for multipliers, its derivative
    jumps. It ends at the window's edge, where it closes, where its orbits cease to be admissible (at another graze), at
    kappa = 1 or -1, or after ``budget`` points per direction, and the result says which. Raises as ``branch``.
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
    # the nearest point of the curve: across its tangent as it is known there
    tangent = tangent_at(equations, equations.with_jacobian(X[None])[1][0], np.ones(len(X)))
    solved = solve(equations, X, tangent / equations.scale)
    if not solved.converged:
        raise ValueError(f"Newton's method finds no {event.kind} there")
    return follow_both_ways(equations, solved.X, bounds, resolution, budget, None)


def is_impact_loss(event: Event) -> bool:
    """Whether an event is where an impact has no speed; a slide that ends at no rate has the same condition."""
    condition = event.conditions[0]
    if condition.kind != SPEED:
        return False
    leg = event.point.orbit.itinerary.chains[condition.impact][0]
    return leg.signal < SIGNALS * len(leg.code.contacts)


def without_impact(orbit: Orbit, impact: int) -> tuple[Orbit, Condition, Array]:
    """The orbit without an impact whose speed is zero, its graze there, and the time of that."""
    kept, own = [i for i in range(len(orbit.times)) if i != impact], orbit.itinerary
    ((leg,), time) = own.chains[impact], orbit.times[impact : impact + 1]
    still = (leg._replace(begun=(0,) * len(leg.begun), signal=-1, side=0),)
    legs = tuple(own.chains[i] for i in kept) or (still,)
    periods = own.periods or int(not kept)
    rest = own._replace(sides=tuple(own.sides[i] for i in kept), periods=periods, legs=legs).bare
    graze = Condition(GRAZE, side=leg.side, signal=leg.signal)
    first = orbit.times[kept[0]] if own.is_cycle and kept else 0.0  # times of a cycle count from its first event
    return Orbit(rest, orbit.times[kept] - first, orbit.speeds[kept], orbit.length), graze, time - first
