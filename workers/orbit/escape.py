"""The proof that a growing motion meets no contact or other event again and goes to infinity."""

import math

import numpy as np

from workers.kernel.borrow import row_of
from workers.kernel.by_reference import by_reference
from workers.kernel.hybrid.state import enter_from_section, slot_of
from workers.kernel.jit import inline_always, kernel
from workers.kernel.motion import FLIGHT, has_modes
from workers.kernel.signal import DERIVATIVE_ROUNDING, block_bounds
from workers.model.oscillator import COLUMN, HEAD, NUMBER

MARGIN = 1.0 + 1e-12
"""Factor on sums of bounds that covers their rounding."""


REACHED, INSIDE, BEHIND = range(3)
"""Future of a guard. REACHED: uncertain. INSIDE: it stays between its ends. BEHIND: it moves away from its only end
forever."""


@kernel
def future_of(blocks, numbers, h, offset, low, high):
    """Return where a signal certainly stays for ever, from state h (n, 2) of the decoupled equations on.

    The result is BEHIND, INSIDE, or REACHED if the future is uncertain.

    The signal plus ``offset`` has an event at its ends ``low`` and ``high``; ``blocks`` and ``numbers`` describe it,
    see GuardedFlow. BEHIND: the fastest growth a e^(r s), r real, moves the signal away from its only end, and the
    other terms are at most M e^(m s). Then y - end >= offset - end + a e^(r s) - M e^(m s) has no zero if it is
    positive at s = 0 and a r >= M m. INSIDE: nothing grows in the signal, m = 0 and a = 0, and M keeps it between its
    ends.
    """
    first, r = 0, 0.0
    for j in range(len(blocks)):
        if -blocks[j, COLUMN.slow] > r:
            first, r = j, -blocks[j, COLUMN.slow]
    M, m, a, lost = numbers[NUMBER.amplitude], 0.0, 0.0, 0.0
    for j in range(len(blocks)):
        block = blocks[j]
        load, c0, c1, d0, d1 = (
            block[COLUMN.load], block[COLUMN.c0], block[COLUMN.c1], block[COLUMN.cA0], block[COLUMN.cA1]
        )  # fmt: skip
        eta, d, inv_w, slow, fast = (
            block[COLUMN.eta], block[COLUMN.d], block[COLUMN.inv_w], block[COLUMN.slow], block[COLUMN.fast]
        )  # fmt: skip
        q0 = c0 * h[j, 0] + c1 * h[j, 1]
        q1 = d0 * h[j, 0] + d1 * h[j, 1] + c1 * load
        if slow >= 0.0:
            M += block_bounds(
                q0, q1, c0 * load, eta, block[COLUMN.lam], d, inv_w, slow, fast, block[COLUMN.tilt],
                block[COLUMN.weight], block[COLUMN.grow2], block[COLUMN.grow3], block[COLUMN.grow4],
            )[0]  # fmt: skip
            continue
        e0 = DERIVATIVE_ROUNDING * (abs(c0 * h[j, 0]) + abs(c1 * h[j, 1]))
        e1 = DERIVATIVE_ROUNDING * (abs(d0 * h[j, 0]) + abs(d1 * h[j, 1]) + abs(c1 * load))
        if e0 + e1 == 0.0:
            continue
        if d == 0.0 or load != 0.0:
            return REACHED
        if d > 0.0:
            turned = (abs(q1 + eta * q0) + e1 + abs(eta) * e0) * inv_w
            M, m = M + math.sqrt((abs(q0) + e0) ** 2 + turned * turned), max(m, -eta)
            continue
        M += 0.5 * inv_w * (abs(q1 + slow * q0) + e1 + abs(slow) * e0)
        m = max(m, -fast)
        mine, error = 0.5 * inv_w * (q1 + fast * q0), 0.5 * inv_w * (e1 + abs(fast) * e0)
        if j == first:
            a, lost = mine, error
        else:
            M, m = M + abs(mine) + error, max(m, -slow)
    M *= MARGIN
    if a == 0.0 and lost == 0.0:
        return INSIDE if m == 0.0 and offset + M < high and offset - M > low else REACHED
    push, end, beyond = abs(a) - lost, low if a > 0.0 else high, high if a > 0.0 else low
    if push <= 0.0 or abs(beyond) < np.inf:
        return REACHED
    room = offset - end if a > 0.0 else end - offset
    return BEHIND if room + push > M and push * r > M * m else REACHED


@kernel
def escaping(oscillators, motions, cells):
    """Return the mask of the motions at t = k T that certainly grow to infinity without another event.

    A machine with modes, sets of linear equations, is decided only if its constants are the same in the whole forcing
    period; others are False.
    """
    oscillators, motions = by_reference(oscillators), by_reference(motions)
    escapes = np.zeros(len(cells), dtype=np.bool_)
    for e in range(len(cells)):
        osc, h, mode = row_of(oscillators, cells[e]), motions.h[cells[e]], motions.mode[cells[e], 0]
        if osc.head[HEAD.growth] == 0.0:
            continue
        if has_modes(osc):
            escapes[e] = escapes_in_modes(osc, h, mode)
        elif mode == FLIGHT:
            low, high = osc.head[HEAD.bottom], osc.head[HEAD.top]
            escapes[e] = future_of(osc.gap.blocks, osc.gap.numbers, h, 0.0, low, high) == BEHIND
    return escapes


@inline_always
def escapes_in_modes(oscillator, h, mode):
    """Return True if a growing motion certainly never leaves its mode, the set of linear equations that holds now.

    No event then ends the mode. Return False if phases, parts of the forcing period, change the mode.
    """
    table, pieces, at = oscillator.table, oscillator.table.pieces, np.zeros(h.shape)
    k = slot_of(table.codes, mode)
    if k < 0 or table.elements.starts.shape[0] > 2:
        return False
    enter_from_section(oscillator, k, h, at)
    departs, met = False, False
    for g in range(pieces.ends.shape[1]):
        blocks, numbers, offset = pieces.blocks[k, g], pieces.numbers[k, g], pieces.offset[k, g]
        low, high = pieces.ends[k, g, 0], pieces.ends[k, g, 1]
        if low > -np.inf or high < np.inf:
            future = future_of(blocks, numbers, at, offset, low, high)
            departs, met = departs or future == BEHIND, met or future == REACHED
    return departs and not met
