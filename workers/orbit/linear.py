"""Machines whose law changes with phases alone: their map z -> J z + c is affine, known for all states.

Other machines are treated so while their motion certainly meets no contact and phases change contacts alone.
"""

import numpy as np

from workers.kernel.borrow import row_of
from workers.kernel.by_reference import by_reference
from workers.kernel.hybrid.state import enter_from_section, number_of, read_number, slot_of
from workers.kernel.jit import inline_always, kernel
from workers.kernel.linalg import copy_into, highest, sort_down
from workers.kernel.motion import CONTRACTION, RUNNING, STATUS
from workers.kernel.signal import derivative_bounds
from workers.model.hybrid_modes import OPEN, SIGNALS
from workers.model.oscillator import COLUMN, HEAD
from workers.orbit.floquet import floquet
from workers.orbit.map import FixedPoint, map_with_jacobian
from workers.orbit.newton import CYCLES, newton_step

UNKNOWN, STAYS, GROWS = range(3)
"""Future of such a motion. UNKNOWN: undecided. STAYS: it decays, comes to rest or continues forever. GROWS: it grows.
"""

ELLIPTIC = 1.5e-8
"""Maximum logarithm of a multiplier of an undamped machine that counts as zero. Multipliers come in pairs m, 1/m, and
two that meet on the unit circle are known to the square root of rounding."""

SQUARINGS, LOOK = 60, 20
"""Maximum number of squarings of the map until damped parts are gone, and number of squarings after which growth of the
remaining motion shows."""

SETTLED, BOUNDED = 1e-12, 1e3
"""Relative change of a settled map by another squaring, and growth up to which a map is bounded."""


@inline_always
def meets_nothing(oscillator, h, mode):
    """Return True if this motion never meets a contact and no phase changes it; True without contacts and friction."""
    table, pieces, n = oscillator.table, oscillator.table.pieces, h.shape[0]
    C, F, P = table.elements.row.shape[0], table.elements.friction_rows.shape[0], table.elements.starts.shape[0] - 1
    if F > 0 or C == 0:
        return F == 0
    states, slips = np.zeros(C, dtype=np.int64), np.zeros(0, dtype=np.int64)
    k = slot_of(table.codes, number_of(table.elements, states, slips, 0))
    read_number(table.elements, mode, states, slips)
    if k < 0 or np.any(states != OPEN):
        return False
    for p in range(1, P):
        other = slot_of(table.codes, number_of(table.elements, states, slips, p))
        same = other >= 0 and np.all(pieces.acceleration[other] == pieces.acceleration[k])
        if not (same and np.all(pieces.drive[other] == pieces.drive[k])):
            return False
    at = np.zeros((n, 2))
    enter_from_section(oscillator, k, h, at)
    for c in range(C):
        g = SIGNALS * c
        reach = derivative_bounds(pieces.blocks[k, g], pieces.numbers[k, g], at, np.inf)[0] * (1.0 + 1e-12)
        low, high = pieces.ends[k, g, 0], pieces.ends[k, g, 1]
        if not (pieces.offset[k, g] + reach < high and pieces.offset[k, g] - reach > low):
            return False
    return True


@inline_always
def rates_if_undamped(oscillator, mode, logs):
    """Write the exact logarithms of multipliers if a block of this mode is not damped and no phase changes the mode.

    Return their error, infinity if the logarithms stay unchanged. Two multipliers that meet at 1, as of a free mass,
    would be known only to the square root of rounding by the map.
    """
    table, T = oscillator.table, oscillator.head[HEAD.period]
    k = slot_of(table.codes, mode)
    if k < 0 or table.elements.starts.shape[0] > 2 or not np.any(table.pieces.blocks[k, 0, :, COLUMN.eta] == 0.0):
        return np.inf
    largest = 0.0
    for j in range(table.pieces.blocks.shape[2]):
        for e in range(2):
            rate = table.pieces.blocks[k, 0, j, COLUMN.fast if e else COLUMN.slow]
            logs[2 * j + e] = -rate * T
            largest = max(largest, abs(rate) * T)
    return 1e-15 * largest


@kernel
def contact_free(oscillators, motions, cells):
    """Return the mask of motions of machines with modes that never meet a contact, see meets_nothing."""
    oscillators, motions = by_reference(oscillators), by_reference(motions)
    free = np.empty(len(cells), dtype=np.bool_)
    for e in range(len(cells)):
        r = cells[e]
        osc = row_of(oscillators, r)
        free[e] = meets_nothing(osc, motions.h[r], motions.mode[r, 0])
    return free


@kernel
def linear_orbits(oscillators, motions, cells, orbits, spent):
    """Return the future of each of these motions, all of them contact_free: STAYS, GROWS or UNKNOWN.

    Write the limit of the motion, or its own state if it continues forever, and its exponents into the rows of
    ``orbits``. Write the periods spent into ``spent`` (N,). Multipliers of one to rounding have exponents of 0.
    """
    oscillators, motions, orbits = by_reference(oscillators), by_reference(motions), by_reference(orbits)
    verdicts = np.empty(len(cells), dtype=np.int64)
    steps, half = np.int64(1), np.bool_(False)  # no literals, as in run_batch
    for e in range(len(cells)):
        r = cells[e]
        osc, start, mode = row_of(oscillators, r), motions.h[r].copy(), motions.mode[r, 0]
        verdicts[e] = UNKNOWN
        base = (
            np.zeros(start.shape) if osc.table.elements.row.shape[0] == 0 else start
        )  # if the start is the orbit, the result is exact
        first, J = map_with_jacobian(osc, base, mode, steps, half)
        if first.tally[STATUS] != RUNNING:
            continue
        point = FixedPoint(base, first.h, first.mode[0], J, 0.0)
        logs, error, turns = floquet(osc, point, steps, half, CYCLES)
        spent[r] = 2 + turns
        if turns == 0:
            continue
        error = max(error, ELLIPTIC if first.tally[CONTRACTION] == 0.0 else 0.0)
        error = min(error, rates_if_undamped(osc, mode, logs))
        neutral = 0.0
        for k in range(len(logs)):
            if abs(logs[k]) <= error:
                neutral, logs[k] = max(neutral, abs(logs[k])), 0.0
        largest = highest(logs, 0, len(logs))
        if largest > 0.0:
            stands = osc.table.elements.row.shape[0] > 0 and np.all(first.h == base)  # contacts would limit the growth
            verdicts[e] = UNKNOWN if stands else GROWS
            continue
        h = newton_step(base, first.h, J) if largest < 0.0 else where_it_stays(J, base, first.h, start)
        turn, _ = map_with_jacobian(osc, h, mode, steps, half)
        if not np.all(np.isfinite(h)) or turn.tally[STATUS] != RUNNING:
            continue
        verdicts[e] = STAYS
        sort_down(logs)
        orbits.mode[r, 0], orbits.period[r] = mode, 1
        orbits.error[r] = error if largest < 0.0 else neutral
        copy_into(orbits.h[r], h)
        copy_into(orbits.tally[r], turn.tally)
        copy_into(orbits.exponents[r], logs)
    return verdicts


@kernel
def where_it_stays(J, base, image, h):
    """Return the limit of block state h (n, 2) under the affine map z -> J z + c that takes ``base`` to ``image``.

    The largest multiplier is one. Return h itself if the motion continues forever, and NaN if it is unbounded, as for a
    free mass that moves.
    """
    size = h.size
    A, start, c, zero = J.copy(), h.ravel(), image.copy().ravel(), base.ravel()
    for i in range(size):
        for k in range(size):
            c[i] -= J[i, k] * zero[k]
    before = max(np.max(np.abs(A)), 1.0), np.max(np.abs(c)) + np.max(np.abs(start))
    bounded, state = True, start.copy()
    for count in range(SQUARINGS):
        square, twice = np.zeros((size, size)), c.copy()
        for i in range(size):
            for k in range(size):
                twice[i] += A[i, k] * c[k]
                for j in range(size):
                    square[i, k] += A[i, j] * A[j, k]
        settled = np.max(np.abs(square - A)) <= SETTLED * np.max(np.abs(A))
        still = np.max(np.abs(twice - c)) <= SETTLED * before[1]
        A, c, earlier = square, twice, state
        state = c.copy()
        for i in range(size):
            for k in range(size):
                state[i] += A[i, k] * start[k]
        if np.max(np.abs(state - earlier)) <= SETTLED * np.max(np.abs(state)):
            return state.reshape(h.shape)
        if count == LOOK:
            bounded = np.max(np.abs(A)) <= BOUNDED * before[0] and np.max(np.abs(c)) <= BOUNDED * before[1]
        if settled and still:
            return state.reshape(h.shape)
    return h.copy() if bounded else np.full_like(h, np.nan)
