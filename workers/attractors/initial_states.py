"""The initial states of a search for attractors, their box, and the statistics of shares."""

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.model.oscillator import Array, Oscillator
from workers.model.system import System
from workers.settings import check_whole

MAX_STARTS, MAX_KEPT = 10_000, 64
INTEGER_BOUNDS = {"starts": (1, MAX_STARTS), "seed": (0, 2**31), "keep": (1, MAX_KEPT)}
"""Minimum and maximum of the integer settings of a search."""
REACH = 2.0
"""Half of the width of the default box, in amplitudes of the motion."""
MAX_DRAWS_PER_STATE = 16
"""Maximum number of points of the sequence per initial state; points beyond a stop are skipped."""
CONFIDENCE = 0.05
"""Probability of missing an attractor of the share ``unseen_share``."""
NORMAL_95 = 1.959963984540054


@dataclass(frozen=True)
class AttractorSettings:
    """The initial states of a search in a cell: its own first, then points that fill a box evenly.

    count  number of initial states, with the cell's own; 1 to 10,000. Half of them suffice if these all reach one
           attractor
    seed   seed of the points, a scrambled Halton sequence; 0 to 2^31
    box    (name, low, high) of components of the physical state; the others have the default, see ``boxes``
    keep   number of attractors kept for each cell, those with the largest shares; 1 to 64

    Raise ValueError, in one line that names the field, for any other value.
    """

    count: int = 32
    seed: int = 0
    box: tuple[tuple[str, float, float], ...] = ()
    keep: int = 4

    def __post_init__(self) -> None:
        for name, value in (("starts", self.count), ("seed", self.seed), ("keep", self.keep)):
            check_whole(name, value, *INTEGER_BOUNDS[name])
        for name, low, high in self.box:
            if not (math.isfinite(low) and math.isfinite(high) and low <= high):
                raise ValueError(f"box.{name}: found {low!r} to {high!r}, must be finite numbers that rise")

    @property
    def enough(self) -> int:
        """Number of initial states after which a cell is finished if all of them reach one attractor."""
        return -(-self.count // 2)

    def waves(self) -> list[range]:
        """Return the numbers of the initial states in groups that are solved one after the other."""
        doublings = (2**k for k in range(self.enough.bit_length()))
        ends = {0, *(end for end in doublings if end < self.enough), self.enough, self.count}
        return [range(first, end) for first, end in pairwise(sorted(ends))]


def initial_states(starts: AttractorSettings, oscillators: Oscillator, system: System, first: Array) -> Array:
    """Return the initial states (N, starts, 2n) of N cells, in order.

    first  (N, 2n) the cells' own initial states, which come first

    States are NaN if too few points of the box lie between the stops.
    """
    N, size = first.shape
    all_states = np.full((N, starts.count, size), np.nan)
    all_states[:, 0] = first
    if starts.count == 1:
        return all_states
    low, high = boxes(starts, oscillators, system)
    points, stops = _points(size, MAX_DRAWS_PER_STATE * (starts.count - 1), starts.seed), oscillators.rigid_stops
    for k in range(N):
        states = low[k] + points * (high[k] - low[k])
        free = np.ones(len(states), dtype=np.bool_)
        for row, upper, lower in stops:
            y = states[:, : size // 2] @ row[k]
            free &= (y > lower[k]) & (y < upper[k])
        inside = np.flatnonzero(free)[: starts.count - 1]
        all_states[k, 1 : 1 + len(inside)] = states[inside]
    return all_states


def boxes(starts: AttractorSettings, oscillators: Oscillator, system: System) -> tuple[Array, Array]:
    """Return the lowest and highest initial states (N, 2n) of N cells.

    By default a displacement lies within REACH a of its rest position, and a velocity within REACH v of 0. Here a and v
    are the amplitudes of the impact-free response to the force. The amplitude a is at least half of the gap, as far as
    the coordinate takes part in the gap. The amplitude v is at least omega times that half. A gap that is one
    coordinate stays between the stops.
    """
    N, n = oscillators.gap_row.shape
    moves = oscillators.to_physical
    forced = oscillators.gap.forced.reshape(N, 2 * n, -1, 2)
    amplitude = np.sum(np.hypot(*np.moveaxis(np.einsum("nij,njhp->nihp", moves, forced), -1, 0)), axis=-1)
    if oscillators.has_modes:  # the amplitude of the mode with all contacts open, or a little more
        amplitude = np.einsum("nij,nj->ni", np.abs(moves), oscillators.gap.swing.reshape(N, 2 * n))
    middle = np.einsum("nij,nj->ni", moves, oscillators.gap.rest.reshape(N, 2 * n))
    row = np.abs(oscillators.gap_row)
    half = 0.5 * (oscillators.upper - oscillators.lower)
    gap = np.where(np.isfinite(half), half, 0.0)[:, None] * row / np.sum(row * row, axis=1)[:, None]
    omega = 2.0 * np.pi * system.definition.turns / oscillators.period
    scale = np.maximum(amplitude, np.concatenate([gap, omega[:, None] * gap], axis=1))
    low, high = middle - REACH * scale, middle + REACH * scale
    for name, first, last in starts.box:
        k = system.states.index(name)
        low[:, k], high[:, k] = first, last
    for row, upper, lower in oscillators.rigid_stops:
        (alone,) = np.nonzero((row != 0.0).sum(axis=1) == 1)
        at = np.argmax(row[alone] != 0.0, axis=1)
        ends = np.stack([lower[alone], upper[alone]]) / row[alone, at]
        low[alone, at] = np.maximum(low[alone, at], ends.min(axis=0))
        high[alone, at] = np.minimum(high[alone, at], ends.max(axis=0))
    return low, high


@lru_cache(maxsize=8)
def _points(size: int, count: int, seed: int) -> Array:
    """Return ``count`` points of the unit cube (count, size)."""
    from scipy.stats import qmc  # imported here, since it loads slowly

    points: Array = qmc.Halton(size, scramble=True, rng=seed).random(count)
    return points


def wilson(hits: NDArray[Any] | int, count: NDArray[Any] | int, z: float = NORMAL_95) -> tuple[Array, Array]:
    """Return the ends of Wilson's interval of a share, after ``hits`` in ``count`` trials, for z standard errors.

    (p + z^2/2n -+ z sqrt(p (1 - p)/n + z^2/4n^2)) / (1 + z^2/n), p = hits/n; 0 to 1 for a count of 0.

    >>> low, high = wilson(0, 32)
    >>> round(float(high), 4)
    0.1072
    """
    counted = np.asarray(count, dtype=np.float64)
    n = np.where(counted > 0.0, counted, 1.0)
    p = np.asarray(hits) / n
    middle = (p + z * z / (2.0 * n)) / (1.0 + z * z / n)
    half = z * np.sqrt(p * (1.0 - p) / n + z * z / (4.0 * n * n)) / (1.0 + z * z / n)
    low, high = np.maximum(middle - half, 0.0), np.minimum(middle + half, 1.0)
    return np.where(counted > 0.0, low, 0.0), np.where(counted > 0.0, high, 1.0)


def unseen_share(count: NDArray[Any] | int) -> Array:
    """Return the share of an attractor that n = ``count`` starts all miss with probability CONFIDENCE.

    1 - 0.05^(1/n)
    """
    return np.asarray(1.0 - CONFIDENCE ** (1.0 / np.asarray(count, dtype=np.float64)))
