"""The minimal fatal shock: the smallest deviation at a time t = k T that takes a motion to another attractor.

    min |W dz|  over deviations dz of the attractor's states z_k at t = k T from which z_k + dz reaches another one

T is the forcing period, and W the diagonal matrix of the norm's weights. Any fatal shock is an upper bound, so the
search only has to find small ones. It begins with the nearest states that are known to reach another attractor, and
improves the best few. Rays in directions near that of the best shock are tried at smaller sizes; if none is fatal,
nearer directions are tried. The best shock is bisected along its ray. Then states that fill the ball of its size evenly
are tried. The search begins again from any fatal state, and ends if there is none. A part of that ball that is fatal
throughout, with the share ``unseen`` of its volume, is missed in one search of twenty.

Halekotte & Feudel, Sci. Rep. 10 (2020) 11783.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.attractors.attractor import SHOWN
from workers.attractors.basins import AttractorTable, section_points
from workers.attractors.cell_attractors import attractor_of
from workers.attractors.initial_states import unseen_share
from workers.model.oscillator import Array
from workers.results import BEYOND_TABLE, INVALID, UNKNOWN_LABEL

Labels = NDArray[np.int64]
Reached = Callable[[Array], Labels]
"""Function that returns the attractor that each state (N, 2n) at the start of a forcing period reaches.

The result is UNKNOWN_LABEL if the attractor is unknown, and NO_MOTION if the state lies beyond a stop.
"""

CHAOS_STATES = 64
"""Number of states at t = k T of chaos or a torus from which shocks begin; of an orbit, all states are used."""

NO_MOTION = -3
"""Label of a state from which no motion can begin, since it lies beyond a stop."""

CANDIDATES, DIRECTIONS, SIZES = 4, 8, 6
"""Numbers of shocks improved together, of directions tried about a shock in a round, and of sizes per direction."""

WIDEST, NARROWEST = 0.5, 2e-4
"""Angles between a shock and the directions tried about it, at first and at last.

A smooth boundary is met at distances that differ by half of the angle's square.
"""

PARTS, EXACT = 8, 1e-9
"""Number of parts into which an interval of sizes is divided at once, and relative length of the last interval."""

BEGINNINGS = 8
"""Maximum number of searches for a fatal shock, each from a smaller shock than the last."""


class FatalShock(NamedTuple):
    """The smallest shock found that takes a motion from one attractor to another.

    size         size |W dz| of the deviation dz, with the diagonal matrix W of the norm's weights
    phase        index of the attractor's state at t = k T to which the deviation is added
    state (2n,)  the state after the shock
    reached      label of the attractor reached from that state
    safe         largest smaller size tried along the same ray that is not fatal
    tried        number of states tried in the ball of this size, none of them fatal
    unseen       share of the ball that a fatal part may have and be missed in one search of twenty
    """

    size: float
    phase: int
    state: Array
    reached: int
    safe: float
    tried: int
    unseen: float


def minimal_fatal_shock(
    reached: Reached, label: int, states: Array, weights: Array, known: Array, seed: int = 0, tries: int = 256
) -> FatalShock | None:
    """Return the smallest shock found from an attractor to another; None if no known state reaches another attractor.

    reached         function that returns the label of the attractor that states reach
    label           label of the attractor
    states (p, 2n)  states of the attractor at t = k T, the start of each forcing period
    weights (2n,)   weights of the norm
    known (K, 2n)   states from which another attractor is reached
    seed            seed of the random directions and of the ball
    tries           number of states in the ball that is tried last
    """
    search = _ShockSearch(reached, label, states, weights, np.random.default_rng(seed))
    best = search.nearest(known)
    if best is None:
        return None
    points = _ball(states.shape[1], tries * BEGINNINGS, seed).reshape(BEGINNINGS, tries, -1)
    for ball in points:
        best = search.bisected(search.improved(best))
        smaller, tried = search.within(best.size[0], ball)
        if smaller is None:
            break
        best, tried = smaller, 0
    return search.reported(best, tried)


def shock_of(table: AttractorTable, label: int, weights: Array) -> FatalShock | None:
    """Return the smallest shock found that takes motion from one attractor to another; None if no other is known.

    table           attractors of one machine
    label           label of the attractor from which the shock leads
    weights (2n,)   weights of the norm

    The states known to reach another attractor are initial states of the table, and the states of the other attractors
    at t = k T.
    """
    count = max(CHAOS_STATES, *(attractor.period for attractor in table.attractors))
    sections = section_points(table, count)
    of_each = [points[: a.period or CHAOS_STATES] for a, points in zip(table.attractors, sections, strict=True)]
    others = [k for k in range(len(of_each)) if k != label]
    if not others:
        return None
    starts = [table.states[0, table.attractors[k].starts] for k in others]
    known = np.concatenate([*(of_each[k] for k in others), *starts])
    return minimal_fatal_shock(lambda states: reached_labels(table, states), label, of_each[label], weights, known)


def reached_labels(table: AttractorTable, states: Array) -> Labels:
    """Return the label of the attractor that each state (N, 2n) at the start of a forcing period reaches.

    The label is BEYOND_TABLE for an orbit that the table does not have, NO_MOTION beyond a stop, and UNKNOWN_LABEL if
    not known.
    """
    search = table.search_from(states, references=False)
    labels, regime = search.label.copy(), search.regime
    for r in np.flatnonzero((labels < 0) & np.isin(regime, SHOWN)).tolist():  # these are proved again
        new = attractor_of(table.oscillators, search, r)
        label = table.label(table.cell.find_same(new)[0]) if new else UNKNOWN_LABEL
        labels[r] = BEYOND_TABLE if new and label == UNKNOWN_LABEL else label
    labels[(labels < 0) & (regime == INVALID)] = NO_MOTION
    return np.asarray(labels, dtype=np.int64)


class _Shocks(NamedTuple):
    """K shocks to another attractor, each a deviation from a state of the attractor at t = k T.

    phase (K,)         indices of these states
    direction (K, 2n)  directions of the deviations, of length 1 after multiplication by the weights
    size (K,)          sizes of the deviations in the norm
    """

    phase: Labels
    direction: Array
    size: Array

    def at_rows(self, rows: Labels) -> "_Shocks":
        return _Shocks(self.phase[rows], self.direction[rows], self.size[rows])


class _ShockSearch:
    def __init__(self, reached: Reached, label: int, states: Array, weights: Array, rng: np.random.Generator) -> None:
        self.reached, self.label, self.states, self.weights, self.rng = reached, label, states, weights, rng

    def at(self, phase: Labels, direction: Array, size: Array) -> Array:
        """Return the states (..., 2n) after shocks from the attractor's states ``phase``, by direction and size."""
        return self.states[phase] + size[..., None] * direction / self.weights

    def labels(self, states: Array) -> Labels:
        return self.reached(states.reshape(-1, states.shape[-1])).reshape(states.shape[:-1])

    def fatal(self, states: Array) -> NDArray[np.bool_]:
        """Return the mask of the states (..., 2n) that are known to reach another attractor."""
        return self.others(self.labels(states))

    def others(self, labels: Labels) -> NDArray[np.bool_]:
        """Return the mask of the labels that are known to be those of another attractor."""
        return ~np.isin(labels, (self.label, UNKNOWN_LABEL, NO_MOTION))

    def shocks_to(self, states: Array) -> _Shocks:
        """Return the shocks from the attractor's nearest state to each of these states (K, 2n), the smallest first."""
        away = (states[:, None] - self.states) * self.weights
        sizes = np.linalg.norm(away, axis=2)
        phase, rows = sizes.argmin(axis=1), np.arange(len(states))
        size = sizes[rows, phase]
        shocks = _Shocks(phase, away[rows, phase] / size[:, None], size)
        return shocks.at_rows(np.argsort(size, kind="stable"))

    def nearest(self, states: Array) -> _Shocks | None:
        """Return the smallest shocks to those of the states (K, 2n) that reach another attractor; None if none does."""
        states = states[self.fatal(states)] if len(states) else states
        return self.shocks_to(states).at_rows(np.arange(min(CANDIDATES, len(states)))) if len(states) else None

    def improved(self, shocks: _Shocks) -> _Shocks:
        """Return the smallest shock to another attractor that is found on rays near the given shocks.

        Random directions near each shock are tried at smaller sizes, and ever nearer ones if none leads to another
        attractor.
        """
        angle = np.full(len(shocks.size), WIDEST)
        while len(rows := np.flatnonzero(angle > NARROWEST)):
            phase, direction, size = shocks.at_rows(rows)
            near = self._near(direction, angle[rows])
            cuts = np.minimum(angle[rows][:, None] * 2.0 ** np.arange(1.0, 1.0 - SIZES, -1.0), 0.9)
            cuts = np.append(cuts, angle[rows][:, None] ** 2 / 16.0, axis=1)
            sizes = (size[:, None] * (1.0 - cuts))[:, None] * np.ones((1, near.shape[1], 1))
            fatal = self.fatal(self.at(phase[:, None, None], near[:, :, None], sizes))
            best = np.where(fatal, sizes, np.inf).reshape(len(rows), -1)
            column, row = best.argmin(axis=1), np.arange(len(rows))
            better = np.isfinite(best[row, column])
            shocks.direction[rows[better]] = near[row, column // sizes.shape[2]][better]
            shocks.size[rows[better]] = best[row, column][better]
            angle[rows[~better]] *= 0.5
        return shocks.at_rows(np.array([np.argmin(shocks.size)]))

    def _near(self, direction: Array, angle: Array) -> Array:
        """Return the given directions (K, 2n), each with random ones near it, as an array (K, DIRECTIONS + 1, 2n).

        ``angle`` (K,) is the angle between a given direction and the random ones.
        """
        across = self.rng.standard_normal((len(direction), DIRECTIONS, direction.shape[1]))
        across -= np.vecdot(across, direction[:, None])[..., None] * direction[:, None]
        across /= np.linalg.norm(across, axis=-1, keepdims=True)
        angles = angle[:, None, None]
        return np.concatenate([direction[:, None], np.cos(angles) * direction[:, None] + np.sin(angles) * across], 1)

    def bisected(self, one: _Shocks) -> _Shocks:
        """Return a shock to another attractor, shortened as far as possible along its direction.

        Set ``safe`` to the size just below it that does not lead to another attractor.
        """
        low, high = 0.0, float(one.size[0])
        while high - low > EXACT * high:
            sizes = np.linspace(low, high, PARTS + 1)[1:-1]
            fatal = np.append(self.fatal(self.at(one.phase, one.direction, sizes)), True)
            first = int(np.argmax(fatal))
            low, high = (low if first == 0 else float(sizes[first - 1])), float(np.append(sizes, high)[first])
        self.safe = low
        return one._replace(size=np.array([high]))

    def within(self, size: float, ball: Array) -> tuple[_Shocks | None, int]:
        """Return the smallest shocks to another attractor among states that fill a ball of size ``size``, and 0.

        If no state in the ball reaches another attractor, return None and the number of the states that return.
        ``ball`` are points that fill the unit ball evenly.
        """
        phase = np.arange(len(ball)) % len(self.states)
        states = self.at(phase, ball, np.full(len(ball), size))
        labels = self.labels(states)
        fatal = self.others(labels)
        if not np.any(fatal):
            return None, int(np.sum(labels == self.label))
        sizes = size * np.linalg.norm(ball[fatal], axis=1)
        order = np.argsort(sizes, kind="stable")[:CANDIDATES]
        direction = ball[fatal] * (size / sizes)[:, None]
        return _Shocks(phase[fatal][order], direction[order], sizes[order]), 0

    def reported(self, best: _Shocks, tried: int) -> FatalShock:
        """Return the smallest shock ``best`` as the search's result; ``tried`` states in its ball are not fatal."""
        state = self.at(best.phase, best.direction, best.size)
        reached = int(self.labels(state)[0])
        unseen = float(unseen_share(tried)) if tried else 1.0
        return FatalShock(float(best.size[0]), int(best.phase[0]), state[0], reached, self.safe, tried, unseen)


def _ball(size: int, count: int, seed: int) -> Array:
    """Return points (count, size) of a scrambled Halton sequence that fill the unit ball evenly."""
    from scipy.special import ndtri
    from scipy.stats import qmc  # slow to import

    points = qmc.Halton(size + 1, scramble=True, rng=seed).random(count)
    normal = ndtri(np.clip(points[:, :size], 1e-12, 1.0 - 1e-12))
    return np.asarray(points[:, size:] ** (1.0 / size) * normal / np.linalg.norm(normal, axis=1, keepdims=True))
