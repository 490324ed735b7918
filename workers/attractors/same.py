"""Which known attractor a motion falls into: exactly where that is an orbit, by statistics where it is not.

An orbit is known by its section state h*, its period p and the Jacobian J of p periods there. A motion falls into it
where a section state h of it lies near h* and what J does not explain of its last turns is less than half of the
contraction: the test by which an orbit itself is accepted, see ``orbit.attraction``, without a new proof. Whether two
orbits that were proved are one is seen on the section of one of the proofs: at t = k T both may impact.

Chaos and tori are known by batches of BATCH section states each: the means of the 2n block coordinates and of their
squares. Two motions are told apart where one of these 4n means differs by more than DIFFERENT standard errors, of the
pooled variance of the batches.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from workers.attractors.record import Attractor
from workers.cell.cells import Array, Rows
from workers.kernel.cells import physical_states, scale_at, start_motions
from workers.kernel.jit import kernel
from workers.kernel.motion import RUNNING, STATUS, axes, motion_with, motions_at, oscillator_of
from workers.kernel.period import step
from workers.model.oscillator import Oscillator, many_of, one_of
from workers.orbit.attraction import falls_into, stays_nearer
from workers.orbit.map import jacobian_of, separation
from workers.orbit.section import moved
from workers.results import NO_IMPACT

NEAR_ORBIT = 1e-2
"""Distance from a known orbit, relative to the motion's scale, from which on a motion may be falling into it."""
SAME_ORBIT = 1e-6
"""Distance of section states of one orbit, found twice, relative to the motion's scale."""
BATCH = 64
"""Section states of a batch."""
REFERENCE, FIRST_LOOK, SECOND_LOOK = 64, 16, 48
"""Batches that an attractor is known by; those by which a motion is compared with it, and once more if it differs."""
DIFFERENT = 5.0
"""Standard errors from which on two motions are not on one attractor."""
LEAST_SPREAD = 1e-9
"""Spread of a mean that is rounding, relative to the root mean square of what is averaged."""


class KnownOrbits(NamedTuple):
    """M orbits, those of cell c from first[c] on to before last[c].

    h (M, n, 2), period (M,), jacobian (M, 2n, 2n) and contraction (M,), 1 - |mu|, of a turn; norm (M, 2n, 2n) in
    which that shrinks deviations.
    """

    first: Rows
    last: Rows
    h: Array
    period: Rows
    jacobian: Array
    contraction: Array
    norm: Array


@kernel
def orbits_reached(metric, swing, sections, kept, rows, owner, known):
    """Which known orbit of its cell each of these motions falls into, -1 for none.

    sections (N, K, n, 2), of which the last ``kept`` (N,) are known; owner (N,) the cell of each motion. An orbit can
    be told from three turns of the motion, or two on it.
    """
    found = np.full(len(rows), -1)
    last = sections.shape[1] - 1
    for e in range(len(rows)):
        r = rows[e]
        c = owner[r]
        for m in range(known.first[c], known.last[c]):
            p = known.period[m]
            if 2 * p > kept[r]:
                continue
            at, nearest = 0, np.inf
            for j in range(p):
                here = separation(metric[r], sections[r, last - p - j], known.h[m])
                if here < nearest:
                    at, nearest = j, here
            scale = scale_at(metric[r], swing[r], sections[r, last - p - at])
            if not nearest <= NEAR_ORBIT * scale:
                continue
            P, J, h = known.norm[m], known.jacobian[m], known.h[m]
            k, reached = last - at, nearest <= 1e-9 * scale
            while not reached and k - p > last - kept[r]:
                start, image = sections[r, k - p], sections[r, k]
                if not falls_into(P, J, known.contraction[m], h, start, image):
                    break
                before = sections[r, last - at - p]
                reached = k < last - at and stays_nearer(metric[r], P, J, h, before, separation(metric[r], start, h))
                k -= p
            if reached:
                found[e] = m
                break
    return found


@kernel
def periods_to_settle(metric, swing, sections, kept, rows, flown, period):
    """Periods (len(rows),) after which sections of these motions stay within NEAR_ORBIT of those a turn later.

    flown (N,) periods gone through, of which the last ``kept`` (N,) sections are known; period (len(rows),) of the
    orbit that each falls into.
    """
    found = np.empty(len(rows), dtype=np.int64)
    last = sections.shape[1] - 1
    for e in range(len(rows)):
        r, p = rows[e], period[e]
        k = last
        near = NEAR_ORBIT * scale_at(metric[r], swing[r], sections[r, last])
        while k - p > last - kept[r] and separation(metric[r], sections[r, k], sections[r, k - p]) <= near:
            k -= 1
        found[e] = flown[r] - (last - k) - p + 1
    return found


@kernel
def turn(oscillators, r, h, contact, steps, half):
    """Some steps of the map from a block state h (n, 2) of oscillator r.

    Returns each state, h the first, NaN from where the motion cannot be followed; the last one's contact; the Jacobian.
    """
    osc = oscillator_of(oscillators, r)
    motion = motion_with(h, contact, axes(h.shape[0]), np.zeros(0), np.zeros((0, 0)))
    states = np.full((steps + 1, h.shape[0], 2), np.nan)
    states[0] = h
    for k in range(steps):
        step(osc, motion, half)
        if motion.tally[STATUS] != RUNNING:
            break
        states[k + 1] = motion.h
    return states, motion.contact[0], jacobian_of(motion.V)


def states_of_turn(oscillator: Oscillator, orbit: Attractor, shift: float, steps: int, half: bool = False) -> Array:
    """Block states (steps + 1, n, 2) of an orbit at t = shift T, and after each step of the map from there."""
    osc = one_of(oscillator, 0)
    first = moved(osc, orbit.h, orbit.contact, shift)
    there = many_of(osc._replace(tau=osc.tau + 2.0 * np.pi * shift))
    states: Array = turn(there, 0, first.h, int(first.contact[0]), steps, np.bool_(half))[0]
    return states


def same_orbit(oscillator: Oscillator, old: Attractor, new: Attractor, half: bool = False) -> bool:
    """Whether an orbit, or with ``half`` its mirror image, is a known one: on the section where that was proved."""
    if (old.regime, old.period) != (new.regime, new.period):
        return False
    if old.regime == NO_IMPACT and not half:
        return True
    h, metric = states_of_turn(oscillator, new, old.shift, int(half), half)[-1], oscillator.gap.metric[0]
    away = metric * (old.orbit[..., 0] - h[:, 0]) ** 2 + (old.orbit[..., 1] - h[:, 1]) ** 2
    return bool(np.sqrt(away.sum(axis=-1)).min() < SAME_ORBIT * scale_at(metric, oscillator.swing[0], h))


def mirrored(oscillators: Oscillator, states: Array, contact: Rows) -> tuple[Array, Rows]:
    """Physical states (N, 2n) on the mirror images of N motions through these ones, with their contacts (N,)."""
    N, n = oscillators.gap_row.shape
    motions, rows = motions_at(np.zeros((N, n, 2))), np.arange(N)
    start_motions(oscillators, motions, states, rows)
    for r in range(N):
        after, motions.contact[r, 0], _ = turn(oscillators, r, motions.h[r], int(contact[r]), 1, np.bool_(True))
        motions.h[r] = after[1]
    return np.asarray(physical_states(oscillators, motions, rows)), motions.contact[:, 0]


def batch_moments(sections: Array, rows: Rows, count: int) -> Array:
    """Means (len(rows), 4n) over the last ``count`` sections of each motion: of block coordinates, of their squares."""
    states = sections[rows, -count:].reshape(len(rows), count, 2 * sections.shape[2])
    return np.concatenate([states, states * states], axis=2).mean(axis=1)


def distance(one: Array, other: Array) -> float:
    """How far apart the means of two motions are, in standard errors, by batches (k, 4n) of each: the largest of all.

    |a - b| / sqrt(s^2 (1/k + 1/l)), s^2 the pooled variance of the batches.
    """
    k, m = len(one), len(other)
    squares = ((one - one.mean(axis=0)) ** 2).sum(axis=0) + ((other - other.mean(axis=0)) ** 2).sum(axis=0)
    half = one.shape[1] // 2
    size = np.sqrt(np.concatenate([one.mean(axis=0)[half:], one.mean(axis=0)[half:]]))
    size[half:] **= 2
    error = np.sqrt((squares / (k + m - 2) + (LEAST_SPREAD * size) ** 2) * (1.0 / k + 1.0 / m))
    away = np.abs(one.mean(axis=0) - other.mean(axis=0))
    return float(np.max(np.where(away == 0.0, 0.0, away / np.where(error > 0.0, error, np.inf))))


def nearest(attractors: Sequence[Attractor], batches: Array) -> tuple[int, float]:
    """The place of that chaos or torus which batches (k, 4n) are nearest to, and their distance; (-1, inf) of none."""
    apart = [np.inf if known.reference is None else distance(known.reference, batches) for known in attractors]
    place = int(np.argmin(apart)) if apart else -1
    return place, min(apart, default=np.inf)
