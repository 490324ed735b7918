"""The motion of a cell as plot data: phase portraits of its attractors, and the positions of its masses in time."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.cell.trajectory import CellTrajectory, cell_orbit, samples_of
from atlas.errors import InputError
from atlas.explore.subject import Subject
from workers.model.oscillator import Oscillator

MAX_PORTRAITS = 5
"""Maximum number of attractors whose portraits are drawn."""
POINTS = 4000
"""Maximum number of points of a trajectory that are sent to the browser."""
Array = NDArray[np.float64]


@dataclass(frozen=True)
class MotionPlotData:
    """The plot data of a motion.

    y, v         (N,) gap coordinate and its velocity along the trajectory, with points before and after each impact
    moving       (2 + n, K) gap coordinate, its velocity and the n displacements, at evenly spaced times
    stops        positions of the stops if they limit a single displacement; empty otherwise
    lane         index of that displacement; None if the stops limit a combination of several
    per_period   number of evenly spaced times in a forcing period
    """

    y: Array
    v: Array
    moving: Array
    stops: list[float]
    lane: int | None
    per_period: float

    @property
    def fields(self) -> dict[str, Any]:
        """The plot data as fields of a message."""
        return vars(self)


def motion_of(orbit: CellTrajectory) -> MotionPlotData:
    """Return the plot data of a trajectory, with at most POINTS evenly spaced times."""
    samples = samples_of(orbit.system)
    piece = orbit.period / samples
    step = np.rint(orbit.times / piece)
    even = np.abs(orbit.times - step * piece) < 1e-9 * orbit.period
    stride = max(1, -(-int(np.count_nonzero(even)) // POINTS))
    sampled = even & (step % stride == 0)
    drawn = sampled | ~even
    return motion_through(orbit.system.build(orbit.parameters), orbit.states[drawn], sampled[drawn], samples / stride)


def motion_through(osc: Oscillator, states: Array, even: NDArray[np.bool_], per_period: float) -> MotionPlotData:
    """Return the plot data of a machine's motion through given states.

    osc          the machine: the mechanical system at given parameters
    states       (N, 2n) displacements and velocities
    even         (N,) mask of the states at evenly spaced times
    per_period   number of evenly spaced times in a forcing period
    """
    row = np.array(osc.gap_row)
    n, limited = row.size, np.flatnonzero(row).tolist()
    lane = limited[0] if len(limited) == 1 else None
    stops = [] if lane is None else [stop / row[lane] for stop in (osc.lower, osc.upper) if np.isfinite(stop)]
    y, v = states[:, :n] @ row, states[:, n:] @ row
    return MotionPlotData(y, v, np.column_stack([y, v, states[:, :n]])[even].T, stops, lane, per_period)


def motions(
    subject: Subject, parameters: Mapping[str, float], states: Sequence[Sequence[float]]
) -> dict[int, MotionPlotData]:
    """Return the plot data of a cell's motions from several initial states, by the index of the initial state.

    subject      the subject that is explored
    parameters   value of each parameter of the cell, by name
    states       the initial states

    States whose motions cannot be shown are left out, as are those beyond MAX_PORTRAITS.
    """
    pictures = {}
    for index, state in enumerate(states[:MAX_PORTRAITS]):
        values = dict(parameters) | dict(zip(subject.system.states, map(float, state), strict=True))
        with suppress(InputError):
            pictures[index] = motion_of(cell_orbit(values, subject.system, subject.settings))
    return pictures
