"""Motion without contacts and friction: its map z -> J z + c over a period is affine, and so known for all states.

The matrices of such a machine may change with phases, parts of the forcing period. Other machines are treated in the
same way while their motion certainly meets no contact and phases change contacts alone.
"""

from typing import NamedTuple

import numpy as np

from workers.kernel.borrow import row_of
from workers.kernel.by_reference import by_reference
from workers.kernel.hybrid.state import enter_from_section, number_of, read_number, slot_of
from workers.kernel.jit import inline_always, kernel
from workers.kernel.linalg import copy_into
from workers.kernel.motion import CONTRACTION, RUNNING, STATUS, TALLIES, Motion
from workers.kernel.signal import derivative_bounds
from workers.model.hybrid_modes import OPEN, SIGNALS
from workers.model.oscillator import COLUMN, Array, Oscillator, Rows
from workers.orbit.floquet import floquet
from workers.orbit.map import FixedPoint, map_with_jacobian
from workers.orbit.newton import CYCLES, PeriodicOrbits, newton_step

UNKNOWN, STAYS, GROWS = range(3)
"""Future of such a motion. UNKNOWN: undecided. STAYS: it decays, comes to rest or continues forever. GROWS: it grows.
"""

ELLIPTIC = 1.5e-8
"""Maximum logarithm of a multiplier of an undamped machine that counts as zero. Multipliers come in pairs m, 1/m, and
two that meet on the unit circle are known to the square root of rounding."""

SQUARINGS, LOOK = 60, 20
"""Maximum number of squarings of the map until damped parts are gone, and number of squarings after which growth of the
remaining motion shows."""

SETTLED_CHANGE, BOUNDED = 1e-12, 1e3
"""Relative change of a settled map by another squaring, and growth up to which a map is bounded."""


@inline_always
def meets_nothing(oscillator, h, mode):
    """Return True if a motion certainly never meets a contact, and its law does not change within the forcing period.

    h (n, 2)  state of the decoupled equations of motion
    mode      number of the mode, the set of linear equations that holds

    The result is True for a machine without contacts and friction, whose law may change within the period.
    """
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


@kernel
def contact_free(oscillators, motions, cells):
    """Return the mask of the motions that certainly never meet a contact, see meets_nothing.

    All machines have modes, sets of linear equations of motion that hold between two events.
    """
    oscillators, motions = by_reference(oscillators), by_reference(motions)
    free = np.empty(len(cells), dtype=np.bool_)
    for e in range(len(cells)):
        r = cells[e]
        osc = row_of(oscillators, r)
        free[e] = meets_nothing(osc, motions.h[r], motions.mode[r, 0])
    return free


class AffineMaps(NamedTuple):
    """The maps z -> J z + c of E motions over one period, from states (E, n, 2) of the decoupled equations.

    images     (E, n, 2)    images of the states
    jacobians  (E, 2n, 2n)  J
    fixed      (E, n, 2)    fixed points, see newton_step
    logs       (E, 2n)      log moduli of the multipliers, in any order
    errors     (E,)         their rounding errors
    turns      (E,)         periods simulated for the multipliers; 0 if the multipliers are not known
    tally      (E, TALLIES) counts over the period, see motion.Motion
    """

    images: Array
    jacobians: Array
    fixed: Array
    logs: Array
    errors: Array
    turns: Rows
    tally: Array


@kernel
def affine_maps(oscillators, mode, states, cells, cycles):
    """Return the fields of AffineMaps: the map of one period, and its multipliers, at states (E, n, 2) of these cells.

    oscillators, mode  machines, and numbers of the modes (sets of linear equations) that hold
    states             (E, n, 2) states of the decoupled equations
    cells              rows of the machines
    cycles             maximum number of periods simulated for the multipliers
    """
    oscillators = by_reference(oscillators)
    E, n = states.shape[0], states.shape[1]
    images, fixed, jacobians = np.empty((E, n, 2)), np.empty((E, n, 2)), np.empty((E, 2 * n, 2 * n))
    logs, errors, turns, tally = np.empty((E, 2 * n)), np.empty(E), np.zeros(E, dtype=np.int64), np.empty((E, TALLIES))
    steps, half = np.int64(1), np.bool_(False)  # no literals, as in run_batch
    for e in range(E):
        osc, h = row_of(oscillators, cells[e]), states[e].copy()
        motion, J = map_with_jacobian(osc, h, mode[cells[e], 0], steps, half)
        copy_into(tally[e], motion.tally)
        if motion.tally[STATUS] != RUNNING:
            continue
        copy_into(images[e], motion.h)
        copy_into(fixed[e], newton_step(h, motion.h, J))
        copy_into(jacobians[e], J)
        rates, errors[e], turns[e] = floquet(osc, FixedPoint(h, motion.h, motion.mode[0], J, 0.0), steps, half, cycles)
        copy_into(logs[e], rates)
    return images, jacobians, fixed, logs, errors, turns, tally


@np.errstate(all="ignore")
def linear_orbits(oscillators: Oscillator, motions: Motion, cells: Rows, orbits: PeriodicOrbits, spent: Rows) -> Rows:
    """Return the future of each of these motions, which never meet a contact: STAYS, GROWS or UNKNOWN.

    oscillators  batch of machines
    motions      batch of motions
    cells        rows of the motions
    orbits       PeriodicOrbits; the limit of a motion, or its own state if it continues for ever, is written with its
                 exponents
    spent        (N,) number of periods simulated, written

    Multipliers of modulus one to rounding have exponents of 0.
    """
    verdicts, starts = np.full(len(cells), UNKNOWN), motions.h[cells]
    contacts = oscillators.table.elements.row.shape[1] > 0
    bases = starts if contacts else np.zeros_like(starts)  # if the start is the orbit, the result is exact
    maps = AffineMaps(*affine_maps(oscillators, motions.mode, bases, cells, CYCLES))
    limits, errors = np.full_like(starts, np.nan), maps.errors
    flown = maps.tally[:, STATUS] == RUNNING
    spent[cells[flown]] = 2 + maps.turns[flown]
    for e in np.flatnonzero(maps.turns).tolist():
        r, logs, image = cells[e], maps.logs[e], maps.images[e]
        error = max(errors[e], ELLIPTIC if maps.tally[e, CONTRACTION] == 0.0 else 0.0)
        error = min(error, rates_if_undamped(oscillators, r, motions.mode[r, 0], logs))
        neutral = np.abs(logs) <= error
        errors[e], largest = np.max(np.abs(logs[neutral]), initial=0.0), np.max(logs[~neutral], initial=-np.inf)
        logs[neutral] = 0.0
        if largest > 0.0:
            stands = contacts and np.array_equal(image, bases[e])  # contacts would limit the growth
            verdicts[e] = UNKNOWN if stands else GROWS
        elif np.any(neutral):
            limits[e] = where_it_stays(maps.jacobians[e], bases[e], image, starts[e])
        else:
            limits[e], errors[e] = maps.fixed[e], error
    bounded = np.flatnonzero(np.isfinite(limits).all(axis=(1, 2)))
    tally = AffineMaps(*affine_maps(oscillators, motions.mode, limits[bounded], cells[bounded], 0)).tally
    bounded, tally = bounded[tally[:, STATUS] == RUNNING], tally[tally[:, STATUS] == RUNNING]
    verdicts[bounded], rows = STAYS, cells[bounded]
    orbits.mode[rows], orbits.period[rows], orbits.error[rows] = motions.mode[rows], 1, errors[bounded]
    orbits.h[rows], orbits.tally[rows] = limits[bounded], tally
    orbits.exponents[rows] = np.sort(maps.logs[bounded], axis=1)[:, ::-1]
    return verdicts


def rates_if_undamped(oscillators: Oscillator, r: int, mode: int, logs: Array) -> float:
    """Write the exact logarithms of the multipliers of an undamped motion to ``logs``, and return their error.

    r     row of the machine
    mode  number of the mode, the set of linear equations that holds

    A motion is undamped if a decoupled equation has no damping and the mode holds in the whole forcing period. For
    other motions ``logs`` stays unchanged and the error is infinity. Two multipliers that meet at 1, as of a free mass,
    would be known from the map only to the square root of rounding.
    """
    table, (slots,) = oscillators.table, np.nonzero(oscillators.table.codes[r] == mode)
    blocks = table.pieces.blocks[r, slots[:1], 0].reshape(-1, len(COLUMN))
    if table.elements.starts.shape[1] > 2 or not np.any(blocks[:, COLUMN.eta] == 0.0):
        return np.inf
    rates = blocks[:, [COLUMN.slow, COLUMN.fast]].ravel()
    logs[:] = -rates * oscillators.period[r]
    return 1e-15 * float(np.max(np.abs(rates) * oscillators.period[r]))


def where_it_stays(J: Array, base: Array, image: Array, h: Array) -> Array:
    """Return the limit of state h (n, 2) if the map z -> J z + c, which takes ``base`` to ``image``, is repeated.

    The largest modulus of the multipliers of J is one. Return h itself if the motion continues forever, and NaN if it
    is unbounded, as for a free mass that moves.
    """
    A, start, c = J, h.ravel(), _add_product(image.ravel(), -J, base.ravel())
    before = max(np.max(np.abs(A)), 1.0), np.max(np.abs(c)) + np.max(np.abs(start))
    bounded, state = True, start
    for count in range(SQUARINGS):
        square, twice = _add_product(np.zeros_like(A), A, A), _add_product(c, A, c)
        settled = np.max(np.abs(square - A)) <= SETTLED_CHANGE * np.max(np.abs(A))
        still = np.max(np.abs(twice - c)) <= SETTLED_CHANGE * before[1]
        A, c, earlier = square, twice, state
        state = _add_product(c, A, start)
        if np.max(np.abs(state - earlier)) <= SETTLED_CHANGE * np.max(np.abs(state)):
            return state.reshape(h.shape)
        if count == LOOK:
            bounded = np.max(np.abs(A)) <= BOUNDED * before[0] and np.max(np.abs(c)) <= BOUNDED * before[1]
        if settled and still:
            return state.reshape(h.shape)
    return h if bounded else np.full_like(h, np.nan)


def _add_product(total: Array, A: Array, B: Array) -> Array:
    """Return total + A B, added up in the order of the columns of A.

    BLAS would add up in an order that depends on the processor.
    """
    for column, row in zip(A.T, B, strict=True):
        total = total + np.multiply.outer(column, row)
    return total
