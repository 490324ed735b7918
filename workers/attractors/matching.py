"""Matching of motions to known attractors: exactly for orbits, by statistics otherwise.

An orbit is given by its state h* at a section t = k T, its period p, and the Jacobian J of p periods there. A motion is
matched to the orbit if two conditions hold. One of its section states lies near h*, and the part of its last turns that
J does not explain is less than half of the contraction. An orbit itself is accepted by the same test, see
``orbit.attraction``, so no new proof is needed. Two proved orbits are compared on the section of one of the proofs,
since both may impact at t = k T.

Chaos and tori are given by batches of BATCH section states: the means of the 2n coordinates (h, h') of the decoupled
equations and of their squares. Two motions differ if one of these 4n means differs by more than DIFFERENT standard
errors, of the pooled variance of the batches.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from workers.attractors.attractor import Attractor
from workers.cell.cell_batch import CellCycle, energy_norms
from workers.cell.interval import batch_of, begin, run
from workers.kernel.cell_loops import physical_states, scale_of
from workers.kernel.jit import kernel
from workers.kernel.motion import FLIGHT, RUNNING, STATUS, Motion, motion_at
from workers.model.hybrid_modes import ModeCode, code_of
from workers.model.machines import about_centre
from workers.model.natural_period import set_period
from workers.model.oscillator import COLUMN, Array, Oscillator, Rows, at_rows, many_of, map_fields, take_one
from workers.orbit.attraction import falls_into, stays_nearer
from workers.orbit.map import separation
from workers.orbit.section import motion_after
from workers.results import NO_IMPACT, NO_REASON

NEAR_ORBIT = 1e-2
"""Largest distance from a known orbit, relative to the motion's scale, at which a motion is tested for the orbit."""
ALONG = 256
"""Number of states along a cycle without a force, for pictures and for the distance of a motion from the cycle."""
SAME_ATTRACTOR = 1e-6
"""Largest distance between states at sections t = k T of equal orbits, relative to the motion's scale."""
BATCH = 64
"""Number of states at sections t = k T whose mean is taken as one batch."""
REFERENCE, FIRST_LOOK, SECOND_LOOK = 64, 16, 48
"""Number of batches of an attractor, of a motion compared with it, and of the same motion afterwards if it differs."""
DIFFERENT = 5.0
"""Standard errors beyond which two motions are on different attractors."""
LEAST_SPREAD = 1e-9
"""Spread of a mean by rounding, relative to the root mean square of the averaged numbers."""


class KnownOrbits(NamedTuple):
    """M known stable orbits, cell by cell, with which motions are compared.

    first, last  (N,) the orbits of cell c are first[c] to last[c] - 1
    h            (M, n, 2) states at a section t = k T, in decoupled coordinates
    period       (M,) periods
    jacobian     (M, 2n, 2n) Jacobians of a turn
    contraction  (M,) 1 - |mu| of a turn
    norm         (M, 2n, 2n) norms in which the Jacobians shrink deviations
    """

    first: Rows
    last: Rows
    h: Array
    period: Rows
    jacobian: Array
    contraction: Array
    norm: Array


@kernel
def orbits_reached(blocks, sections, counts, rows, owner, known):
    """Return the indices of the known orbits into which these motions fall; -1 if there is none.

    blocks    decoupled equations of the oscillators
    sections  (N, K, n, 2) last states of the motions at sections t = k T
    counts    (N,) number of the last sections that are known
    rows      motions that are compared
    owner     (N,) cells of the motions
    known     KnownOrbits of the cells

    A motion needs three turns to be matched, or two on the orbit.
    """
    numbers = np.full(len(rows), -1)
    last = sections.shape[1] - 1
    for e in range(len(rows)):
        r = rows[e]
        c = owner[r]
        for m in range(known.first[c], known.last[c]):
            p = known.period[m]
            if 2 * p > counts[r]:
                continue
            at, nearest = 0, np.inf
            for j in range(p):
                apart = separation(blocks[r], sections[r, last - p - j], known.h[m])
                if apart < nearest:
                    at, nearest = j, apart
            scale = scale_of(blocks[r], sections[r, last - p - at])
            if not nearest <= NEAR_ORBIT * scale:
                continue
            P, J, h = known.norm[m], known.jacobian[m], known.h[m]
            k, reached = last - at, nearest <= 1e-9 * scale
            while not reached and k - p > last - counts[r]:
                start, image = sections[r, k - p], sections[r, k]
                if not falls_into(P, J, known.contraction[m], h, start, image):
                    break
                before = sections[r, last - at - p]
                reached = k < last - at and stays_nearer(blocks[r], P, J, h, before, separation(blocks[r], start, h))
                k -= p
            if reached:
                numbers[e] = m
                break
    return numbers


def periods_to_settle(blocks: Array, sections: Array, flown: int, period: int) -> int:
    """Return the number of periods after which a motion stays within NEAR_ORBIT of its state one turn later.

    blocks    decoupled equations of the oscillator
    sections  (K, n, 2) last states at sections t = k T
    flown     periods simulated
    period    period of the orbit that the motion reaches
    """
    away = energy_norms(blocks[:, COLUMN.metric], sections[period:] - sections[:-period])
    far = np.flatnonzero(~(away <= NEAR_ORBIT * scale_of(blocks, sections[-1])))
    return flown - len(sections) + 1 + (int(far[-1]) + 1 if len(far) else 0)


def periods_along(blocks: Array, sections: Array, flown: int, along: Array) -> int:
    """Return the number of periods after which a motion stays within NEAR_ORBIT of a cycle without a force.

    blocks    decoupled equations of the oscillator
    sections  (K, n, 2) last states of the motion, at t = k T with T the natural period
    flown     periods simulated
    along     (K, n, 2) states on the cycle in order, connected by straight lines
    """
    weight = np.sqrt(np.stack([blocks[:, COLUMN.metric], np.ones(len(blocks))], axis=1))
    a, s = ((weight * states).reshape(len(states), -1) for states in (along, sections))
    chord = np.roll(a, -1, axis=0) - a
    away = s[:, None] - a
    part = np.sum(away * chord, axis=2) / np.maximum(np.sum(chord * chord, axis=1), 1e-300)
    nearest = np.linalg.norm(away - np.clip(part, 0.0, 1.0)[..., None] * chord, axis=2).min(axis=1)
    far = np.flatnonzero(~(nearest <= NEAR_ORBIT * np.linalg.norm(a, axis=1).max()))
    return flown - len(sections) + 1 + (int(far[-1]) + 1 if len(far) else 0)


def states_along(oscillator: Oscillator, cycle: CellCycle, state: Array, mode: int) -> Array:
    """Return states (ALONG, n, 2) along a cycle without a force, evenly in time, from a physical state on it.

    The states are those of decoupled equations. ``mode`` is the number of the mode, a set of linear equations, at the
    start.
    """
    machine = at_rows(oscillator, np.zeros(1, dtype=np.int64))
    set_period(machine, np.zeros(1, dtype=np.int64), np.array([cycle.period / ALONG]))
    motions, _ = begin(machine, np.full(1, NO_REASON, dtype=np.int8), state[None], np.array([mode]))
    batch = batch_of(machine, motions, ALONG)
    batch.periods[0] = ALONG
    run(batch, np.zeros(1, dtype=np.int64))
    return batch.sections[0]


def seen_from(oscillator: Oscillator, orbit: Attractor, shift: float) -> tuple[Oscillator, Motion]:
    """Return the oscillator with t = shift T as time 0, and the motion of an orbit there; T is the forcing period."""
    osc = take_one(oscillator, 0)
    if shift == 0.0:
        return osc, motion_at(orbit.h, orbit.mode)
    return osc._replace(tau=osc.tau + 2.0 * np.pi * shift), motion_after(osc, orbit.h, orbit.mode, shift)


def states_of_turn(oscillator: Oscillator, orbit: Attractor) -> Array:
    """Return the states (period, n, 2) of an orbit at the sections t = (k + shift) T at which it was proved.

    They are states of decoupled equations; T is the forcing period.
    """
    osc, motion = seen_from(oscillator, orbit, orbit.shift)
    batch = batch_of(many_of(osc), map_fields(motion, lambda field: field[None]), orbit.period)
    batch.periods[0] = orbit.period
    run(batch, np.zeros(1, dtype=np.int64))
    return batch.sections[0]


def image_of(oscillators: Oscillator, r: int, oscillator: Oscillator, h: Array, mode: int) -> tuple[Array, int]:
    """Return the mirror image (n, 2) of a motion from the state h, half a period later, and the number of its mode.

    States are those of decoupled equations; a mode is a set of linear equations between two events.

    oscillators  all machines
    r            row of the machine
    oscillator   machine r, its phase counted from the time of h
    h, mode      (n, 2) state, and the number of its mode

    The image is NaN if it cannot be simulated. A machine with modes is mirrored in its centre, with all contacts and
    slips on the other side.
    """
    machines = oscillators.table.machines
    later = oscillators.with_modes(lambda _: motion_after(oscillator, h, mode, 0.5), np.array([r]))
    image, other = -later.h, 2 * FLIGHT - int(later.mode[0])
    if oscillators.has_modes:
        centre = about_centre(at_rows(machines, np.array([r])))[1][0]
        image += (2.0 * oscillator.to_blocks[:, : len(centre)] @ centre).reshape(h.shape)
        _, contacts, slips = code_of(int(later.mode[0]), *machines.sizes[1:], *machines.segments)
        code = ModeCode(0, tuple(-state for state in contacts), tuple(-sign for sign in slips))
        other = code.number_of(*machines.segments)
        if oscillators.drifts:
            image[-1, 1] = h[-1, 1]
    return (image if later.tally[STATUS] == RUNNING else np.full_like(h, np.nan)), other


def is_same_attractor(oscillator: Oscillator, old: Attractor, new: Attractor, half: bool = False) -> bool:
    """Return True if an orbit, or with ``half`` its mirror image, equals a known orbit.

    Orbits are compared at the instants t = (k + shift) T at which the known orbit was proved. Cycles without a force
    are equal if they are the same set of states, in any phase.
    """
    if (old.regime, old.period) != (new.regime, new.period):
        return False
    if old.cycle and new.cycle:
        state = new.result["state"]
        if half:
            _, centre = about_centre(oscillator.table.machines)
            state = 2.0 * np.append(centre, np.zeros_like(centre)) - state
        return old.cycle.is_through(state, new.cycle.period)
    neutral = old.jacobian is None and new.jacobian is None  # neither of these orbits attracts
    if old.regime == NO_IMPACT and not half and (neutral or not oscillator.has_modes):  # counts as one attractor
        return True
    osc, motion = seen_from(oscillator, new, old.shift)
    h = image_of(oscillator, 0, osc, motion.h, int(motion.mode[0]))[0] if half else motion.h
    return bool(energy_norms(osc.gap.metric, old.orbit - h).min() <= SAME_ATTRACTOR * scale_of(osc.gap.blocks, h))


def mirror_states(oscillators: Oscillator, states: Array, mode: Rows) -> tuple[Array, Rows]:
    """Return physical states (N, 2n) on the mirror images of N motions, and the numbers (N,) of their modes.

    A mode is a set of linear equations between two events. ``states`` (N, 2n) and ``mode`` (N,) belong to the motions.
    """
    motions, _ = begin(oscillators, np.full(len(states), NO_REASON, dtype=np.int8), states, mode)
    for r in range(len(states)):
        motions.h[r], motions.mode[r] = image_of(oscillators, r, take_one(oscillators, r), motions.h[r], int(mode[r]))
    return physical_states(oscillators, motions, np.arange(len(states))), motions.mode[:, 0]


def batch_moments(sections: Array, rows: Rows, count: int) -> Array:
    """Return means of coordinates and of their squares (rows, 4n) over the last ``count`` sections t = k T.

    sections  (N, K, n, 2) states of N motions in decoupled coordinates
    rows      motions
    count     number of sections
    """
    states = sections[rows, -count:].reshape(len(rows), count, 2 * sections.shape[2])
    return np.concatenate([states, states * states], axis=2).mean(axis=1)


def distance(one: Array, other: Array) -> float:
    """Return the largest distance between the means of two motions, in standard errors.

    one, other  (k, 4n) and (l, 4n) means over the batches of each motion

    The distance of means a and b is |a - b| / sqrt(s^2 (1/k + 1/l)), s^2 the pooled variance of the batches.
    """
    k, m = len(one), len(other)
    squares = ((one - one.mean(axis=0)) ** 2).sum(axis=0) + ((other - other.mean(axis=0)) ** 2).sum(axis=0)
    half = one.shape[1] // 2
    size = np.sqrt(np.concatenate([one.mean(axis=0)[half:], one.mean(axis=0)[half:]]))
    size[half:] **= 2
    error = np.sqrt((squares / (k + m - 2) + (LEAST_SPREAD * size) ** 2) * (1.0 / k + 1.0 / m))
    away = np.abs(one.mean(axis=0) - other.mean(axis=0))
    return float(np.max(np.where(away == 0.0, 0.0, away / np.where(error > 0.0, error, np.inf))))


def nearest(attractors: Sequence[Attractor], batches: Array) -> tuple[Attractor | None, float]:
    """Return the chaos or torus nearest to ``batches`` (k, 4n) by statistics, and its distance in standard errors.

    The attractor is None if all of ``attractors`` differ from the batches.
    """
    apart = [np.inf if known.reference is None else distance(known.reference, batches) for known in attractors]
    away = min(apart, default=np.inf)
    return attractors[apart.index(away)] if away <= DIFFERENT else None, away
