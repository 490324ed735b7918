"""Orbits from a cell's state at a section t = k T, many at once from neighbouring cells, and such states of orbits."""

from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.continuation.admissibility import first_fault
from workers.continuation.equations import admit, check_orbits, motion_of, motion_of_unknowns, solve_orbits
from workers.continuation.families import Family, family_of
from workers.continuation.floquet import multipliers
from workers.continuation.itinerary import Itinerary, Orbit, many_orbits
from workers.continuation.legs import EVENT, NO_EVENT
from workers.continuation.orbit_equality import is_minimal
from workers.continuation.orbit_from_motion import record_orbit, reduce_symmetry
from workers.continuation.shooting import OrbitMotion
from workers.model.family import OrbitMachines, machines_over
from workers.model.oscillator import Array, Mask
from workers.model.system import System
from workers.orbit.section import PAST_SECTION


class OrbitBatch(NamedTuple):
    """N orbits with one sequence of events.

    orbits     the orbits, as a batch
    values     (N, free) parameters
    converged  (N,) mask of orbits to which Newton's method converged
    """

    orbits: Orbit
    values: Array
    converged: Mask

    def orbit(self, k: int) -> Orbit:
        """Return orbit k."""
        return self.orbits.at_rows(k)


def group_indices(keys: Iterable[Hashable | None]) -> list[NDArray[np.int64]]:
    """Return the indices of equal keys, one array per key, in the order in which the keys occur.

    Keys of None are left out.
    """
    places_of: dict[Hashable, list[int]] = {}
    for index, key in enumerate(keys):
        if key is not None:
            places_of.setdefault(key, []).append(index)
    return [np.array(places, dtype=np.int64) for places in places_of.values()]


def many_of(orbits: list[Orbit], values: Array) -> OrbitBatch:
    """Return orbits with one sequence of events as one batch, with their parameters (N, free)."""
    return OrbitBatch(many_orbits(orbits), values, np.ones(len(orbits), dtype=bool))


def continued_to(family: Family, orbits: OrbitBatch, values: Array) -> OrbitBatch:
    """Return the orbits near those of ``orbits`` at other parameters ``values`` (N, free), by Newton's method on each.

    Newton's method starts from impacts at the same phases. It fails if steps do not shrink or are long, since the orbit
    found would hardly be the same one.
    """
    lin, itinerary = family.model(values), orbits.orbits.itinerary
    check_orbits(lin, itinerary)
    may_be = orbits.converged & admit(lin, itinerary)
    if not itinerary.sides or not may_be.any():
        return orbits._replace(values=values, converged=may_be)
    known = np.flatnonzero(may_be)
    machines, known_orbits = lin.at_rows(known), orbits.orbits.at_rows(known)
    if not itinerary.is_cycle:
        phases = known_orbits.times * family.model(orbits.values[known]).omega[:, None]
        known_orbits = known_orbits._replace(times=phases / machines.omega[:, None])
    start = motion_of(machines, known_orbits)
    scale = np.concatenate([start.scale()[0], np.ones(known_orbits.times.shape) / start.lin.omega[:, None]], axis=1)
    solved = solve_orbits(start, scale, start.forced_sizes)
    after, converged = orbits.orbits.at_rows(np.arange(len(values))), np.zeros(len(values), dtype=np.bool_)
    fields = motion_of_unknowns(machines, itinerary, solved.X).orbits[1:]
    after.times[known], after.speeds[known], after.length[known] = fields
    converged[known] = solved.converged
    return OrbitBatch(after, values, converged)


def attract(family: Family, orbits: OrbitBatch) -> Mask:
    """Return the mask of orbits that attract.

    All their multipliers lie inside the unit circle; they are admissible, and none is a shorter orbit repeated.
    """
    good = orbits.converged.copy()
    rows = np.flatnonzero(good)
    if not len(rows):
        return good
    motion = motion_of(family.model(orbits.values[rows]), orbits.orbits.at_rows(rows))
    good[rows] = np.all(np.abs(multipliers(motion)) < 1.0, axis=1)
    for k in np.flatnonzero(good[rows])[:, None]:
        one = OrbitMotion(motion.lin.at_rows(k), motion.itinerary, motion.times[k], motion.start[k])
        good[rows[k]] = is_minimal(one) and not (family.certified and first_fault(one))
    return good


def orbit_from_state(
    system: System,
    values: Mapping[str, float],
    state: Array,
    periods: int,
    symmetric: bool = False,
    cycle: float | None = None,
) -> Orbit:
    """Return the periodic orbit through a state at a section t = k T, or next to it, by Newton's method.

    system     mechanical system
    values     parameters by name; the others have their defaults
    state      (2n,) physical section state
    periods    forcing periods in the whole orbit
    symmetric  True if the orbit is known to be symmetric: its halves then need to agree less exactly
    cycle      period of a cycle without a force; None for an orbit with a force

    Raise ValueError if the motion leaves a stop at once after an impact with R = 0, or if no orbit is found.
    """
    if periods < 1:
        raise ValueError(f"periods: found {periods}, must be 1 or more")
    family, none = family_of(system, values, ()), np.zeros(0)
    machine = family.model(none[None])
    orbit = refine_orbit(family, record_orbit(machine, state, periods, symmetric, cycle), none)
    half = reduce_symmetry(machine, orbit)
    return orbit if half is orbit else refine_orbit(family, half, none)


def refine_orbit(family: Family, orbit: Orbit, values: Array) -> Orbit:
    """Return the orbit near the given one, at parameters (free,), to rounding.

    Raise ValueError if Newton's method finds no orbit.
    """
    many = continued_to(family, many_of([orbit], values[None]), values[None])
    if not many.converged[0]:
        raise ValueError("Newton's method finds no orbit near the given one")
    return many.orbit(0)


def section_state(system: System, values: Mapping[str, float], orbit: Orbit) -> Array:
    """Return the physical state (2n,) of an orbit at the section, t = 0."""
    state: Array = section_states(system, {name: np.array([value]) for name, value in values.items()}, [orbit])[0, 0]
    return state


def section_states(
    system: System, values: Mapping[str, Array], orbits: Sequence[Orbit], shift: float = 0.0, known: bool = False
) -> Array:
    """Return the physical states (N, n, 2d) of N orbits at the n sections t = k T.

    system  mechanical system
    values  parameters (N,) by name; the others have their defaults
    orbits  N orbits with one sequence of events
    shift   shift of the section, in forcing periods
    known   True for the states of cycles after all events, see ``comparison_states``

    In a symmetric machine, the negative states at a shift of 1/2 are the section states of the mirror images. An event
    at a section counts as past, also if rounding delays it by up to PAST_SECTION T.
    """
    rows = np.stack(list(values.values()), axis=1) if values else np.zeros((len(orbits), 0))
    machines, _ = machines_over(system, {}, tuple(values))(rows)
    return (comparison_states if known else states_at_sections)(machines, many_orbits(orbits), shift)


def states_at_sections(machines: OrbitMachines, many: Orbit, shift: float = 0.0) -> Array:
    """Return the physical states (N, n, 2d) of orbits at the sections t = k T, see ``section_states``.

    A cycle without a force has, in place of sections, the passages of its rarest event, just after the event. Of
    several rarest events, the one with the smallest key is taken. With a ``shift`` the passages are those of the mirror
    images.
    """
    if many.itinerary.is_cycle:
        return _states_after(machines, many, _rarest(machines, many.itinerary, shift > 0.0))
    period = 2.0 * np.pi / machines.omega[:, None]
    since = np.mod(many.times / period - shift, 1.0)
    many = many._replace(times=np.where(since <= PAST_SECTION, many.times - PAST_SECTION * period, many.times))
    states, _ = motion_of(machines, many).states_at((np.arange(many.itinerary.periods) + shift) * period)
    return np.asarray(states + machines.rest[:, None])


def comparison_states(machines: OrbitMachines, many: Orbit, shift: float = 0.0) -> Array:
    """Return the physical states (N, K, 2d) that two orbits share if they are equal.

    The states are those at sections t = k T; the states of cycles without a force are those after all events.
    """
    if not many.itinerary.is_cycle:
        return states_at_sections(machines, many, shift)
    return _states_after(machines, many, range(len(many.itinerary.sides) * (1 + many.itinerary.symmetric)))


def _states_after(machines: OrbitMachines, many: Orbit, events: Sequence[int]) -> Array:
    """Return physical states (N, K, 2d) of cycles just after the events with indices ``events`` (K,).

    The events of a symmetric cycle's second half follow those of the first half.
    """
    motion, m = motion_of(machines, many), len(many.itinerary.sides)
    legs = 1 + np.searchsorted(np.cumsum(motion.plan.table[:, EVENT] != NO_EVENT), np.arange(1, m + 1))
    after = motion.turn.states[:, legs]
    return np.asarray(np.concatenate([after, -after], axis=1)[:, list(events)] + machines.rest[:, None])


def _rarest(machines: OrbitMachines, itinerary: Itinerary, mirrored: bool) -> list[int]:
    """Return the indices of the events of a cycle that take the place of sections t = k T, see ``states_at_sections``.

    With ``mirrored`` they are those of its mirror image.
    """
    chains = (itinerary.twice if itinerary.symmetric else itinerary).chains
    legs = [leg.mirrored if mirrored else leg for leg, *_ in chains]
    keys = [(leg.signal, leg.side, leg.code.number_of(*machines.machines.segments)) for leg in legs]
    rarest = min(keys, key=lambda key: (keys.count(key), key))
    return [i for i, key in enumerate(keys) if key == rarest]
