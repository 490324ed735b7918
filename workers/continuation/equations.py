"""Motions of orbits from their unknowns, or from the times of their events alone, and checks of the equations."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from workers.continuation.itinerary import Itinerary, Orbit
from workers.continuation.legs import ACT, END, REBOUNDS, SIGNAL
from workers.continuation.newton import NewtonResult, newton
from workers.continuation.shooting import OrbitMotion, plan_of
from workers.model.block_decomposition import apply_stacked
from workers.model.family import OrbitMachines
from workers.model.hybrid_modes import SIGNALS
from workers.model.oscillator import Array, Mask, Rows

FARTHEST = 0.5
"""Maximum length of Newton's first step, relative to the motion and its fastest impact; of times, relative to the
length of a cycle, or in radians of the force."""


def check_orbits(machines: OrbitMachines, itinerary: Itinerary) -> None:
    """Raise ValueError, in one line, if none of the machines can have an orbit with this sequence of events.

    See ``admit``.
    """
    for wrong, why in _faults(machines, itinerary):
        if np.all(wrong):
            raise ValueError(why)


def admit(machines: OrbitMachines, itinerary: Itinerary) -> Mask:
    """Return the mask (N,) of machines that can have an orbit with this itinerary, its sequence of events.

    They cannot if the orbit would be falsely symmetric, rebound with R = 0, or hit a stop that does not exist.
    """
    return ~np.any([np.broadcast_to(wrong, machines.omega.shape) for wrong, _ in _faults(machines, itinerary)], axis=0)


def _faults(machines: OrbitMachines, itinerary: Itinerary) -> Iterator[tuple[Mask, str]]:
    """Yield masks (N,) of machines that cannot have an orbit with this sequence of events, each with the reason."""
    unknown = itinerary.periods < (0 if itinerary.sides else 1)
    unknown |= not itinerary.legs and any(side not in (1, -1) for side in itinerary.sides)
    yield np.array(unknown), f"itinerary {itinerary}: sides must be +1 or -1 and periods at least 1"
    even = itinerary.symmetric and itinerary.periods % 2 == 0 and not itinerary.is_cycle
    yield np.array(even), f"periods of a symmetric orbit: found {itinerary.periods}, must be odd"
    if itinerary.symmetric:
        uneven = "a symmetric orbit needs equal stops, odd harmonics only, no constant load and no moving belt"
        yield ~machines.mirrored, uneven
    if unknown:
        return
    slow = "this orbit leaves a stop at once after an impact without rebound, instead of resting"
    reached = plan_of(machines, itinerary).reached
    rebounds = reached[reached[:, ACT] == REBOUNDS]
    for signal, end in {(signal, end) for signal, end in rebounds[:, [SIGNAL, END]].tolist()}:
        contact, name = signal // SIGNALS, ("lower", "upper")[end]
        yield machines.elements.R[:, contact] <= 0.0, f"R: found 0, must be positive: {slow}"
        stop = machines.elements.stops[:, contact, end]
        yield (
            ~np.isfinite(stop),
            f"b_{name}: found {abs(stop[0])}, must be finite: the orbit has impacts at the {name} stop",
        )


def at_lengths(machines: OrbitMachines, itinerary: Itinerary, lengths: Array) -> OrbitMachines:
    """Return machines without a force with frequencies at which one turn of an orbit has these lengths (N,).

    Nothing else in the machines depends on the frequency.
    """
    return replace(machines, omega=2.0 * np.pi * itinerary.turn / lengths, known=machines.known)


def motion_of_unknowns(machines: OrbitMachines, itinerary: Itinerary, X: Array) -> OrbitMotion:
    """Return the motions of N orbits with this sequence of events from the unknowns X (N, ...) of their equations.

    The states come first in X, then the times of events, see ``Orbit.unknown_times``.
    """
    size = machines.dimension
    start, times = np.split(X[:, : size + len(itinerary.sides)], [size], axis=1)
    if itinerary.is_cycle:
        machines, times = at_lengths(machines, itinerary, times[:, 0]), times.copy()
        times[:, 0] = 0.0
    return OrbitMotion(machines, itinerary, np.ascontiguousarray(times), np.ascontiguousarray(start))


def motion_of(machines: OrbitMachines, orbits: Orbit) -> OrbitMotion:
    """Return the motions of a batch of orbits: events at their times, and the states that solve the equations best.

    For given times these equations are linear in the state, 2n + m equations for 2n numbers.
    """
    times, size = np.ascontiguousarray(orbits.times), machines.dimension
    if orbits.itinerary.is_cycle:
        machines = at_lengths(machines, orbits.itinerary, orbits.length)
    still = OrbitMotion(machines, orbits.itinerary, times, np.zeros((len(times), size)))
    J, right = still.linearised()[:, :, :size], still.turn.residuals[..., None]
    start = -apply_stacked(np.linalg.pinv, J.swapaxes(1, 2).shape, J) @ right
    return OrbitMotion(machines, orbits.itinerary, times, np.ascontiguousarray(start[..., 0]))


def solve_orbits(start: OrbitMotion, scale: Array, sizes: Array | None = None) -> NewtonResult:
    """Return the result of Newton's method for N orbits with the same sequence of events, from motions near them.

    The unknowns are those of ``motion_of_unknowns``. For ``scale`` (N, U) of the unknowns and ``sizes`` see ``newton``.
    """

    def motion(X: Array, rows: Rows) -> OrbitMotion:
        return motion_of_unknowns(start.lin.at_rows(rows), start.itinerary, X)

    def with_jacobian(X: Array, rows: Rows) -> tuple[Array, Array]:
        trial = motion(X, rows)
        return trial.turn.residuals, trial.linearised()

    return newton(
        lambda X, rows: motion(X, rows).turn.residuals, with_jacobian, start.unknowns, scale, farthest=FARTHEST,
        sizes=sizes,
    )  # fmt: skip
