"""Neutral directions: a coordinate that drifts, and the position of friction that sticks for good."""

import numpy as np

from workers.kernel.external import external
from workers.kernel.hybrid.state import enter_frame, leave_frame, product, read_number, slot_of
from workers.kernel.jit import inline_always
from workers.kernel.motion import LOST, MOTION, NEUTRAL, OSCILLATOR, PROGRESS, SLID
from workers.model.hybrid_modes import ON


@inline_always
def remove_held_motion(elements, states, lost, V):
    """Remove from tangent vectors V (m, n, 2) the motion of sticking coordinates: neighbouring motions also stop.

    The last blocks are those of coordinates that stick on a stop, then of sticking friction, see ``hybrid_modes``.
    """
    count = 0
    for c in range(len(states)):
        if abs(states[c]) == ON and elements.soft[c] == 0.0:
            count += 1
    first = V.shape[1] - (int(lost) - count)
    for e in range(V.shape[0]):
        for i in range(first, V.shape[1]):
            V[e, i, 1] = 0.0
            if i < first + count:
                V[e, i, 0] = 0.0


@inline_always
def record_slips(slips, tally):
    """Record which frictions slide, as binary digits: 2^e for friction e."""
    slid = int(tally[SLID])
    for e in range(len(slips)):
        if slips[e] != 0:
            slid |= 1 << e
    tally[SLID] = slid


@external(OSCILLATOR, MOTION, modes=True)
def freeze(oscillator, motion):
    """Remove from all tangent vectors the position of friction that has never slid, which is a parameter of the motion.

    Such friction could stick anywhere nearby. The direction is neutral, with multiplier 1, and counts as lost.
    """
    table, elements = oscillator.table, oscillator.table.elements
    n, m = motion.h.shape[0], motion.V.shape[0]
    states, slips = (
        np.zeros(elements.row.shape[0], dtype=np.int64),
        np.zeros(elements.friction_rows.shape[0], dtype=np.int64),
    )
    number = motion.mode[0]
    read_number(elements, number, states, slips)
    k, slid = slot_of(table.codes, number), int(motion.tally[SLID])
    W, V = np.zeros((m, 2 * n)), np.zeros((m, n, 2))
    leave_frame(oscillator.to_physical, motion.V, W)
    enter_frame(table.pieces.to_blocks[k], W, V)
    column, neutral = n, 0
    for e in range(len(slips) - 1, -1, -1):
        if slips[e] != 0 or rests_on_stop(elements, e, states):
            continue
        column -= 1
        drifts = (
            table.drifts > 0.0 and product(elements.friction_rows[e], oscillator.to_physical[:n, 2 * n - 1], 0) != 0.0
        )
        if not drifts and (slid >> e) & 1 == 0 and elements.belt[e] == 0.0:
            neutral += 1
            for i in range(m):
                V[i, column, 0] = 0.0
    if neutral > 0:
        leave_frame(table.pieces.to_physical[k], V, W)
        enter_frame(oscillator.to_blocks, W, motion.V)
        motion.tally[NEUTRAL] = neutral
        motion.tally[LOST] += neutral


@inline_always
def rests_on_stop(elements, e, states):
    """Return True if friction e sticks on the row of a sticking rigid contact, which then holds its coordinate."""
    for c in range(len(states)):
        if abs(states[c]) == ON and elements.soft[c] == 0.0 and elements.along[e, c] != 0.0:
            return True
    return False


@inline_always
def count_progress(motion, h, omega):
    """Reset the drifting coordinate of a motion to 0 and add its progress to the counts.

    A period has taken the motion to block state h (n, 2). For the drift see Oscillator.
    """
    last = h.shape[0] - 1
    motion.tally[PROGRESS] += (h[last, 1] - motion.h[last, 1]) / omega
    h[last, 1] = 0.0
    for e in range(motion.V.shape[0]):
        motion.V[e, last, 1] = 0.0
