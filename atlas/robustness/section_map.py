"""The map of one machine over forcing periods, from a state at t = k T to the state one or more periods later.

All states are in physical coordinates.
"""

from functools import lru_cache

import numpy as np

from atlas.robustness.linear_measures import one_period
from workers.cell.interval import begin, sections_from
from workers.kernel.cell_loops import physical_states
from workers.kernel.motion import RUNNING, STATUS
from workers.model.oscillator import Array, Oscillator, at_rows
from workers.results import NO_REASON

FIRST = np.zeros(1, dtype=np.int64)


class SectionMap:
    """The map P^m of one machine over m forcing periods: images of many states, and the Jacobian at one state.

    ``oscillator`` is a record with one machine.
    """

    def __init__(self, oscillator: Oscillator) -> None:
        self.oscillator = oscillator
        self.many = lru_cache(maxsize=4)(lambda count: at_rows(oscillator, np.zeros(count, dtype=np.int64)))

    def orbits(self, states: Array, periods: int) -> Array:
        """Return the states (N, periods + 1, 2n) at the start of each forcing period of motions from N states (N, 2n).

        States are NaN beyond a stop, and after a motion ends.
        """
        many = self.many(len(states))
        motions, reasons = begin(many, np.full(len(states), NO_REASON, dtype=np.int8), np.ascontiguousarray(states))
        sections = sections_from(many, motions, np.where(reasons == NO_REASON, periods + 1, 0))
        if sections.shape[1]:
            return np.asarray(sections)
        return np.full((len(states), periods + 1, states.shape[1]), np.nan)

    def images(self, states: Array, periods: int) -> Array:
        """Return the states ``periods`` forcing periods after given states (N, 2n)."""
        return np.asarray(self.orbits(states, periods)[:, -1])

    def orbit_with_jacobian(self, state: Array, periods: int) -> tuple[Array, Array, Array]:
        """Return a motion from one state over some forcing periods: its states, its last state, and the Jacobian.

        The states (periods, 2n) are those at the start of each period, the last state (2n,) that at the end. The
        Jacobian (2n, 2n) is that of the last state with respect to the first. All are NaN if the motion cannot be
        followed.
        """
        size = len(state)
        motions, _ = begin(self.oscillator, np.full(1, NO_REASON, dtype=np.int8), state[None])
        h, mode = motions.h[0], int(motions.mode[0, 0])
        states, jacobian = [state], np.eye(size)
        for _ in range(periods):
            motion, one = one_period(self.oscillator, h, mode)
            if motion.tally[STATUS] != RUNNING:
                return np.full((periods, size), np.nan), np.full(size, np.nan), np.full((size, size), np.nan)
            jacobian = one @ jacobian
            h, mode = motion.h, int(motion.mode[0])
            motions.h[0], motions.mode[0, 0] = h, mode
            states.append(physical_states(self.oscillator, motions, FIRST)[0])
        return np.array(states[:-1]), states[-1], jacobian
