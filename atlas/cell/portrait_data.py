"""The contents of a portrait, the figure of one cell: time histories, displacements, exponents, enlarged chatter.

A chatter is a series of impacts on one stop at ever shorter intervals.
"""

import math

import numpy as np
from numpy.typing import NDArray

from atlas.cell.trajectory import CellTrajectory, modulation, samples_of
from workers.results import QUASIPERIODIC, REGIME, REGULAR, SPECTRUM, UNDETERMINED

Array = NDArray[np.float64]

_MIN_PERIODS = 6
"""Minimum number of forcing periods that the time histories show; a longer orbit is shown for up to twice as many."""
_CYCLES = 2
"""Number of periods of a limit cycle, of a machine without a force, that the time histories show."""
_MIN_CHATTER_FLIGHTS = 4
"""Minimum number of flights between impacts, each shorter than the one before, that count as a chatter."""


def displacements(orbit: CellTrajectory) -> list[Array]:
    """Return the rows (n,) of coefficients of the two displacements that a portrait shows, or of the only one.

    If the stops are on one coordinate, these are that coordinate and the first other one, in the system's order. If the
    stops are on a combination of coordinates, these are the combination and the first of its coordinates.
    """
    row = orbit.gap_row
    stopped = np.flatnonzero(row).tolist()
    every = np.eye(row.size)
    if len(stopped) > 1:
        return [row, every[stopped[0]]]
    others = [i for i in range(row.size) if i not in stopped][:1]
    return [row if i in stopped else every[i] for i in sorted([*stopped, *others])]


def periods(orbit: CellTrajectory) -> int:
    """Return the number of periods that the time histories show.

    It depends on the period of an orbit. For a torus, it covers one and a half turns of the modulation, if the path is
    that long.
    """
    if orbit.cycle is not None:
        return _CYCLES
    if int(orbit.cell[REGIME.name]) in (QUASIPERIODIC, REGULAR):
        return min(_span(orbit), max(_MIN_PERIODS, math.ceil(1.5 * modulation(orbit.gap(orbit.section)))))
    return min(max(_MIN_PERIODS, int(orbit.cell["period"])), 2 * _MIN_PERIODS)


def path(orbit: CellTrajectory, count: int) -> tuple[Array, Array]:
    """Return times (N,) and states (N, 2n) along the path, over at least ``count`` periods; a shorter closed path is
    repeated.
    """
    turns = max(1, -(-count // _span(orbit)))
    return _repeated(orbit, orbit.times, turns), np.concatenate([orbit.states] * turns)


def impact_times(orbit: CellTrajectory, side: float, count: int) -> Array:
    """Return times of the impacts at the upper (``side`` 1) or the lower stop (-1) over ``count`` periods."""
    turns = max(1, -(-count // _span(orbit)))
    times = _repeated(orbit, orbit.impacts[orbit.impacts[:, 1] == side, 0], turns)
    return times[times <= count * orbit.period]


def chatter(orbit: CellTrajectory) -> slice | None:
    """Return the indices of the impacts of the first chatter, impacts on one stop at ever shorter intervals; None
    without.

    The range begins where flights are still long enough to be drawn.
    """
    times, sides = orbit.impacts[:, 0], orbit.impacts[:, 1]
    flights = np.diff(times)
    shorter = (sides[2:] == sides[1:-1]) & (sides[1:-1] == sides[:-2]) & (flights[1:] < flights[:-1])
    ends = np.flatnonzero(np.diff(np.pad(shorter, 1).astype(np.int8)))
    for first, last in zip(ends[::2], ends[1::2], strict=True):
        drawn = np.flatnonzero(flights[first : last + 1] > 5.0 * orbit.period / samples_of(orbit.system))
        if last - first >= _MIN_CHATTER_FLIGHTS and drawn.size:
            return slice(int(first + max(0, drawn[-1] - 1)), int(last + 2))
    return None


def enlarged(orbit: CellTrajectory, chatter: slice) -> tuple[Array, Array, tuple[float, float], float]:
    """Return the enlarged picture of a chatter, given by the indices of its impacts.

    The first two values are times (N,) in ``CellTrajectory.unit``, and the distance (N,) from the stop at each time.
    Then follow the limits of time, and the largest distance between the first impact and the last.
    """
    impacts, side = orbit.impacts[chatter, 0] / orbit.unit, float(orbit.impacts[chatter.start, 1])
    first, last = impacts[0] - 0.075 * np.ptp(impacts), impacts[-1] + 0.25 * np.ptp(impacts)
    times, away = orbit.times / orbit.unit, np.abs(orbit.gap(orbit.states) - orbit.stops[int(side > 0)])
    highest = away[(times >= impacts[0]) & (times <= impacts[-1])].max()
    inside = (times >= first) & (times <= last)
    return times[inside], away[inside], (first, last), highest


def exponent_ends(running: Array, written: Array) -> tuple[float, float]:
    """Return limits for the plot of running averages of exponents (P, n), which include the exponents ``written``.

    The first averages are left out of the limits, since they may lie far off.
    """
    later = running[min(9, len(running) - 1) :]
    ends = np.concatenate([later[np.isfinite(later)], written[np.isfinite(written)], [0.0]])
    room = 0.08 * float(np.ptp(ends)) or 1.0
    return ends.min() - room, ends.max() + room


def is_few(x: Array, y: Array) -> bool:
    """Return True if the section values form few distinct points in the plot.

    Thousands of states may coincide in one point, if an orbit closes late.
    """
    extent = max(float(np.ptp(x)), float(np.ptp(y)), 1e-12)
    return bool(np.unique(np.round(np.stack([x, y]) / extent, 2), axis=1).shape[1] <= 64)


def written(orbit: CellTrajectory) -> Array:
    """Return the exponents that a portrait writes as numbers.

    These are the cell's stored exponents. If its regime is undetermined, they are those of the path that is drawn: the
    stored exponents of such a cell are averages over motions that it has left.
    """
    if int(orbit.cell[REGIME.name]) == UNDETERMINED:
        return np.sort(orbit.running[-1])[::-1]
    return np.asarray(orbit.cell[SPECTRUM.name])


def _repeated(orbit: CellTrajectory, times: Array, turns: int) -> Array:
    return np.concatenate([times + turn * _span(orbit) * orbit.period for turn in range(turns)])


def _span(orbit: CellTrajectory) -> int:
    """Return the number of forcing periods that the stored path of a motion covers."""
    return round(float(orbit.times[-1] / orbit.period))
