"""Cycles of machines without a force as equations: their period is unknown, and the time of the first event is given.

    sign z(L) - z(0) = 0,  r_1(z(0)) = its end,  r_i(z(t_i^-)) = its end

The equations are those of ``shooting``, with the frequency whose period is the period of the cycle. No force depends on
the frequency, so that it only determines that length. The unknowns are the state z(0) just before the first event, the
length L of a turn and the times t_2 ... t_m. A disturbance along the motion lasts: its multiplier is exactly 1, and it
is no unknown of the section of the first event.
"""

from typing import NamedTuple

import numpy as np

from workers.continuation.admissibility import first_fault
from workers.continuation.equations import motion_of, motion_of_unknowns, solve_orbits
from workers.continuation.floquet import error_along, multipliers
from workers.continuation.itinerary import Orbit, many_orbits
from workers.continuation.shooting import OrbitMotion
from workers.model.family import OrbitMachines
from workers.model.oscillator import Array


class LimitCycle(NamedTuple):
    """A limit cycle of one machine without a force, with its stability.

    motion  its motion
    period  its period
    logs    ln|mu| of all multipliers but the 1 along the cycle, largest first; -inf if a direction is lost
    error   error of ln|mu| near 0: the deviation of the multiplier along the cycle from 1
    """

    motion: OrbitMotion
    period: float
    logs: Array
    error: float


def cycle_near(machine: OrbitMachines, orbit: Orbit) -> LimitCycle | None:
    """Return the cycle of one machine near an orbit whose events begin at time 0.

    Return None if Newton's method finds no admissible cycle.
    """
    itinerary, first = orbit.itinerary, motion_of(machine, many_orbits([orbit]))
    scale = np.concatenate([first.scale()[0], np.repeat(first.span[:, None], len(itinerary.sides), axis=1)], axis=1)

    with np.errstate(all="ignore"):
        solved = solve_orbits(first, scale)
        closed = motion_of_unknowns(machine, itinerary, solved.X)
        if not solved.converged[0] or not closed.span[0] > 0.0 or first_fault(closed):
            return None
        return _cycle_of(closed)


def cycle_through(machine: OrbitMachines, orbit: Orbit) -> LimitCycle:
    """Return the cycle of one machine with the events of an orbit that closes to rounding already.

    Newton's method cannot find a cycle with another multiplier 1: its matrix is singular there.
    """
    with np.errstate(all="ignore"):
        return _cycle_of(motion_of(machine, many_orbits([orbit])))


def _cycle_of(motion: OrbitMotion) -> LimitCycle:
    turn, logs = motion.itinerary.turn, np.log(np.sort(np.abs(multipliers(motion)[0]))[::-1])
    return LimitCycle(motion, float(motion.span[0] / turn), logs / turn, float(error_along(motion)[0]) / turn)
