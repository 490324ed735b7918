"""Neutral directions, in which neighbouring motions neither approach nor separate.

Two cases are treated: a coordinate that drifts, and the position of friction that sticks for good.
"""

import numpy as np

from workers.kernel.external import external
from workers.kernel.hybrid.state import enter_frame, leave_frame, product, read_number, slot_of
from workers.kernel.jit import inline_always
from workers.kernel.motion import LOST, MOTION, NEUTRAL, OSCILLATOR, PROGRESS, SLID
from workers.model.hybrid_modes import ON


@inline_always
def remove_held_motion(elements, states, lost, V):
    """Remove the motion of coordinates that stick from tangent vectors V (m, n, 2), in place: neighbours stick too.

    elements    contacts and frictions of the machine
    states (C,) states of the contacts
    lost        number of dimensions that the mode (set of linear equations) lacks, since coordinates stick

    The last blocks, decoupled equations, are those of coordinates that stick on a stop, then of sticking friction, see
    ``hybrid_modes``.
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
    """Record which frictions slide in the counts ``tally`` of a motion, as binary digits: 2^e for friction e.

    ``slips`` (F,) is not 0 for a friction that slides.
    """
    slid = int(tally[SLID])
    for e in range(len(slips)):
        if slips[e] != 0:
            slid |= 1 << e
    tally[SLID] = slid


@external(OSCILLATOR, MOTION, modes=True)
def freeze(oscillator, motion):
    """Remove from the tangent vectors of a motion, in place, the position of friction that has never slid.

    This position is a parameter of the motion, since such friction could stick anywhere nearby. The direction is
    neutral, with multiplier 1, and counts as lost.
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
    """Return True if friction e sticks along a coordinate that also rests on a rigid stop, which then holds it.

    ``states`` (C,) are the states of the contacts.
    """
    for c in range(len(states)):
        if abs(states[c]) == ON and elements.soft[c] == 0.0 and elements.along[e, c] != 0.0:
            return True
    return False


@inline_always
def count_progress(motion, h, omega):
    """Add the advance of the drifting coordinate over a period to a motion's counts, and reset the coordinate to 0.

    motion  motion at the start of the period; counts and tangent vectors change
    h       (n, 2) state of the decoupled equations at its end, changed in place
    omega   forcing frequency

    For the drift see Oscillator.
    """
    last = h.shape[0] - 1
    motion.tally[PROGRESS] += (h[last, 1] - motion.h[last, 1]) / omega
    h[last, 1] = 0.0
    for e in range(motion.V.shape[0]):
        motion.V[e, last, 1] = 0.0
