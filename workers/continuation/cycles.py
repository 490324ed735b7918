"""Cycles of machines without a force as equations: their period is unknown, and the time of the first event is given.

    sign z(L) - z(0) = 0,  r_1(z(0)) = its end,  r_i(z(t_i^-)) = its end

The equations of ``motion`` with the frequency whose period the cycle lasts: no force sees it, so that it is nothing but
that length. Unknown are the state z(0) just before the first event, the length L of a turn and the times t_2 ... t_m.
A disturbance along the motion lasts: its multiplier is exactly 1, and no unknown of the section of the first event.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from workers.continuation.admissible import first_fault
from workers.continuation.equations import motion_of, motion_of_unknowns
from workers.continuation.itinerary import Itinerary, Orbit
from workers.continuation.legs import MODE, SIGNAL
from workers.continuation.motion import OrbitMotion
from workers.continuation.newton import newton
from workers.kernel.hybrid.state import right_hand_side, turned
from workers.model.family import OrbitMachines
from workers.model.modes import stacked
from workers.model.oscillator import Array, Rows, one_of

FARTHEST = 0.5
"""Newton's first step at most, relative to the motion and to the length of a turn."""


class Cycle(NamedTuple):
    """A cycle: its motion, its period, and ln|mu| of all multipliers but the 1 along it, largest first.

    These are -inf where a direction is lost.
    """

    motion: OrbitMotion
    period: float
    logs: Array


def at_lengths(machines: OrbitMachines, itinerary: Itinerary, lengths: Array) -> OrbitMachines:
    """Machines without a force whose frequency is such that turns of this itinerary have these lengths (N,)."""
    turns = (0.5 if itinerary.symmetric else 1.0) * itinerary.periods
    return replace(machines, omega=2.0 * np.pi * turns / lengths, known=machines.known)


def cycle_near(machine: OrbitMachines, orbit: Orbit) -> Cycle | None:
    """The cycle of one machine near an orbit, whose events begin at time 0, of the length that the machine's period
    tells; None where Newton's method finds none that is admissible.
    """
    itinerary, size = orbit.itinerary, machine.dimension
    first = motion_of(machine, Orbit(itinerary, orbit.times[None], orbit.speeds[None]))
    X = first.unknowns
    X[:, size] = first.span
    own = at_lengths(machine, itinerary, first.span)
    scale = np.concatenate([first.scale()[0], np.repeat(first.span[:, None], len(itinerary.sides), axis=1)], axis=1)

    def motion(X: Array) -> OrbitMotion:
        given = X.copy()
        given[:, size] = 0.0
        return motion_of_unknowns(at_lengths(own, itinerary, X[:, size]), itinerary, given)

    def with_jacobian(X: Array, _: Rows) -> tuple[Array, Array]:
        there = motion(X)
        J = there.linearised()
        J[:, :, size] = -there.turn.shifts[:, :, size]  # what a longer turn adds to its end
        return there.turn.residuals, J

    with np.errstate(all="ignore"):
        solved = newton(lambda X, _: motion(X).turn.residuals, with_jacobian, X, scale, farthest=FARTHEST)
        if not solved.converged[0] or not solved.X[0, size] > 0.0:
            return None
        found = motion(solved.X)
        if first_fault(found):
            return None
        return Cycle(found, float(solved.X[0, size]) * (2.0 if itinerary.symmetric else 1.0), _logs(found))


def _logs(motion: OrbitMotion) -> Array:
    """ln|mu| (2n - 1,) of the multipliers of a whole cycle, the 1 along it left out, largest first.

    Those of the map from the section of the first event to itself, along the motion.
    """
    size, (mode, signal) = motion.start.shape[1], motion.plan.reached[0, [MODE, SIGNAL]]
    row, f = motion.pieces.rows[0, mode, signal, :size], np.empty(size)
    pieces = one_of(motion.pieces, 0)
    right_hand_side(pieces, mode, motion.start[0], turned(0.0, pieces.waves.shape[2]), f)
    back = np.eye(size) - np.outer(f, row) / (row @ f)
    across = np.linalg.svd(row[None])[2][1:]
    section = across @ back @ motion.turn.maps[0] @ across.T
    found = np.sort(np.abs(stacked(np.linalg.eigvals, (1, size - 1), section[None])[0]))[::-1]
    if motion.lost:
        found[max(0, size - 1 - motion.lost) :] = 0.0
    logs = np.log(found)
    return np.asarray(2.0 * logs if motion.itinerary.symmetric else logs)
