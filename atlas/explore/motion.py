"""The motion of a cell as it is drawn: the phase portraits of its attractors, and its machine over the orbit."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from atlas.cell.trajectory import CellTrajectory, cell_orbit, samples_of
from atlas.errors import InputError
from atlas.explore.subject import Subject
from workers.model.oscillator import Oscillator

MAX_PORTRAITS = 5
"""Attractors whose portraits are drawn."""
POINTS = 4000
"""Points of a path that are sent to the browser, at most."""
Array = NDArray[np.float64]


@dataclass(frozen=True)
class MotionPlotData:
    """What is drawn of a motion.

    y, v         gap coordinate and its velocity (N,) along the path, before and after every impact too
    moving       (2 + n, K) the same and the displacements in even steps of time
    stops, lane  where stops limit one displacement, and which; None where they limit a combination of several
    per_period   even steps a forcing period
    """

    y: Array
    v: Array
    moving: Array
    stops: list[float]
    lane: int | None
    per_period: float


def motion_of(orbit: CellTrajectory) -> MotionPlotData:
    """A path as it is drawn, of at most POINTS even steps."""
    samples = samples_of(orbit.system)
    piece = orbit.period / samples
    step = np.rint(orbit.times / piece)
    even = np.abs(orbit.times - step * piece) < 1e-9 * orbit.period
    stride = max(1, -(-int(np.count_nonzero(even)) // POINTS))
    kept = even & (step % stride == 0)
    drawn = kept | ~even
    return motion_through(orbit.system.build(orbit.parameters), orbit.states[drawn], kept[drawn], samples / stride)


def motion_through(osc: Oscillator, states: Array, even: NDArray[np.bool_], per_period: float) -> MotionPlotData:
    """The motion of a machine through states (N, 2n), some of which are ``even`` steps of time."""
    row = np.array(osc.gap_row)
    n, limited = row.size, np.flatnonzero(row).tolist()
    lane = limited[0] if len(limited) == 1 else None
    stops = [] if lane is None else [stop / row[lane] for stop in (osc.lower, osc.upper) if np.isfinite(stop)]
    y, v = states[:, :n] @ row, states[:, n:] @ row
    return MotionPlotData(y, v, np.column_stack([y, v, states[:, :n]])[even].T, stops, lane, per_period)


def motions(
    subject: Subject, parameters: Mapping[str, float], states: Sequence[Sequence[float]]
) -> dict[int, MotionPlotData]:
    """The motions from these states of a cell, by their places, as far as they can be shown."""
    pictures = {}
    for place, state in enumerate(states[:MAX_PORTRAITS]):
        given = dict(parameters) | dict(zip(subject.system.states, map(float, state), strict=True))
        with suppress(InputError):
            pictures[place] = motion_of(cell_orbit(given, subject.system, subject.settings))
    return pictures
