"""The motion of one machine from its initial state, with its state at any time, before and after impacts."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError
from workers.history import Trace, trace, within_periods
from workers.model.machines import Machines
from workers.model.mode_table import elements_of
from workers.model.oscillator import Array, Oscillator
from workers.model.system import System


@dataclass(frozen=True)
class CellMotion:
    """The motion of one machine from its initial state, with its state at any time.

    machines    numbers of the machine, in a batch of one
    oscillator  the machine in the form for kernels, in a batch of one
    followed    states at the beginnings of periods, and impacts
    """

    machines: Machines
    oscillator: Oscillator
    followed: Trace

    @classmethod
    def follow(cls, system: System, parameters: Mapping[str, float], periods: int, cycle: float | None) -> Self:
        """Simulate a machine over ``periods`` periods from its initial state, and return the motion.

        ``cycle`` is the length of a period for a machine without a force. Raise InputError if the motion cannot be
        followed.
        """
        try:
            followed = trace(system, parameters, periods, cycle=cycle)
        except ValueError as error:
            raise InputError(f"this cell cannot be followed: {error}") from None
        values = system.with_cycle({name: np.array([value]) for name, value in parameters.items()}, cycle)
        oscillator, _ = system.build_many(values)
        return cls(system.definition.machines(values), oscillator, followed)

    @property
    def period(self) -> float:
        """The length of a period in units of time."""
        return float(self.oscillator.period[0])

    def states_at(self, times: Array) -> Array:
        """Return the states (N, 2n) at times (N,) in ascending order, each computed from the beginning of its
        period.
        """
        periods = np.clip(np.floor(times / self.period).astype(int), 0, len(self.followed.times) - 2)
        states = [np.empty((0, self.followed.states.shape[1]))]
        for k in np.unique(periods).tolist():
            since = times[periods == k] - self.followed.times[k]
            states.append(within_periods(self.oscillator, self.followed.states[k : k + 1], np.maximum(since, 0.0))[0])
        return np.concatenate(states)

    def states_at_impacts(self, impacts: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return the states (K, 2n) just before and just after K impacts, and the mask (K,) of impacts at which a
        velocity jumps.

        impacts (K, 3)  time, side and speed of each impact

        A velocity jumps at an impact on a rigid stop, and not where a chatter ends.
        """
        elements, contacts = elements_of(self.machines), np.abs(impacts[:, 1]).astype(np.int64) - 1
        rigid = (impacts[:, 2] > 0.0) & (elements.soft[0, contacts] == 0.0)
        before = self.states_at(impacts[:, 0])
        after = before.copy()
        for i in np.flatnonzero(rigid).tolist():
            c, velocity = contacts[i], np.sign(impacts[i, 1]) * impacts[i, 2]
            row, kick, R = elements.row[0, c], elements.kick[0, c], elements.R[0, c]
            stop, state = elements.stops[0, c, int(velocity > 0.0)], before[i].copy()
            before[i], after[i] = (_at_stop(row, kick, stop, state, speed) for speed in (velocity, -R * velocity))
        return before, after, rigid


def _at_stop(row: Array, kick: Array, stop: float, state: Array, velocity: float) -> Array:
    """Return a state moved to a stop, so that row . x = stop, and with the given velocity there.

    row       (n,) coefficients of the gap coordinate
    kick      (n,) direction in which impacts change the velocities
    stop      position of the stop
    state     (2n,) state close to the stop
    velocity  velocity of the gap coordinate

    All other components stay as they are.
    """
    n, on_stop = row.size, state.copy()
    on_stop[:n] += row / (row @ row) * (stop - row @ state[:n])
    on_stop[n:] += kick * (velocity - row @ state[n:])
    return on_stop
