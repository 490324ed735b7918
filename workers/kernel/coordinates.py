"""Conversion between physical section states and block coordinates, with the contact of a motion.

A motion carries its contact. A physical state alone gets its contact from ``placed``.
"""

import numpy as np
from numba import types
from numpy.typing import NDArray

from workers.kernel.apart import FLOATS, apart
from workers.kernel.contact import load_on_stop, to_held, wave
from workers.kernel.hybrid.state import ROUNDING, enter_frame, leave_frame, show, shown_number
from workers.kernel.jit import inline_always, kernel
from workers.kernel.lend import whole
from workers.kernel.motion import AT_REST, BEYOND, FREE, HELD, OSCILLATOR, Motion, has_modes, motion_at
from workers.model.hybrid import FIRST_NUMBER
from workers.model.oscillator import COLUMN, HEAD, Oscillator
from workers.results import BEYOND_STOP, InvalidError


def motion_from(osc: Oscillator, state: NDArray[np.float64], vectors: int = 0, record: int = 0) -> Motion:
    """A motion that starts at physical section state (x..., v...).

    The state decides the contact: held or about to leave on a stop with v = 0, else free. InvalidError beyond a stop.
    """
    h = np.zeros((len(osc.gap_row), 2))
    contact = start_at(osc, np.asarray(state, dtype=np.float64), h)
    if contact == BEYOND:
        raise InvalidError(BEYOND_STOP)
    return motion_at(h, contact, vectors, record)


@apart(OSCILLATOR, FLOATS[1], FLOATS[2], result=types.int64, modes=True)
def start_hybrid(osc, state, h):
    """start_at for a machine with modes: the contact is the number of its mode."""
    state, h = whole(state), whole(h)
    enter_frame(osc.to_blocks, state.reshape((1, len(state))), h.reshape((1, len(h), 2)))
    number = shown_number(osc.table.elements, state)
    return BEYOND if number < 0 else number + FIRST_NUMBER


@kernel
def start_at(osc, state, h):
    """Write the block coordinates h (n, 2), less forced response, of a physical section state; its contact."""
    if has_modes(osc):
        return start_hybrid(osc, state, h)
    row, blocks, tau = osc.gap_row, osc.gap.blocks, osc.tau
    n, y, v, y_sum, v_sum = h.shape[0], 0.0, 0.0, 0.0, 0.0
    for j in range(n):
        for k in range(2):
            full = 0.0
            for i in range(2 * n):
                full += osc.to_blocks[2 * j + k, i] * state[i]
            h[j, k] = full - wave(osc.gap.forced[j, k], tau)[0] - blocks[j, COLUMN.rest0 + k]
        coasts = blocks[j, COLUMN.lam] == 0.0 and blocks[j, COLUMN.eta] == 0.0
        if coasts and abs(h[j, 1]) <= ROUNDING * blocks[j, COLUMN.swing1]:
            h[j, 1] = 0.0  # else rounding of h would drift forever
        y += row[j] * state[j]
        v += row[j] * state[n + j]
        y_sum += abs(row[j] * state[j])
        v_sum += abs(row[j] * state[n + j])
    contact = placed(y, v, ROUNDING * y_sum, ROUNDING * v_sum, osc.head[HEAD.upper], osc.head[HEAD.lower])
    return contact_at_rest(osc, np.sign(contact), h) if abs(contact) == AT_REST else contact


@inline_always
def contact_at_rest(osc, side, h):
    """The contact of a state at rest on this stop: held if the load presses, else about to leave."""
    u = np.zeros((h.shape[0] - 1, 2))
    to_held(osc, h, osc.tau, side, u)
    return side * HELD if load_on_stop(osc, u, osc.tau, side) > 0.0 else side * AT_REST


@inline_always
def placed(y, v, y_error, v_error, upper, lower):
    """The contact of y and y' apart from the load: +-AT_REST on a stop with v = 0, BEYOND outside, else FREE.

    A state within rounding of a stop is on it, on either side.
    """
    on_upper = abs(y - upper) <= y_error
    on_lower = abs(y - lower) <= y_error
    contact = FREE
    if on_upper or on_lower:
        if abs(v) <= v_error:
            contact = AT_REST if on_upper else -AT_REST
    elif y > upper or y < lower:
        contact = BEYOND
    return contact


@kernel
def put_on_stop(row, stop, x):
    """Set the coordinate with the largest weight in g . x, the first numbers of x (n or more,), so that g . x = stop.

    g . x then equals the stop to rounding, see ROUNDING, and exactly if it is one coordinate with weight +-1.
    """
    k, others = 0, 0.0
    for i in range(len(row)):
        if abs(row[i]) > abs(row[k]):
            k = i
    for i in range(len(row)):
        if i != k:
            others += row[i] * x[i]
    x[k] = (stop - others) / row[k]


@apart(OSCILLATOR, FLOATS[2], types.int64, FLOATS[1], modes=True)
def leave_hybrid(osc, h, contact, state):
    """leave_blocks for a machine with modes."""
    h, state = whole(h), whole(state)
    leave_frame(osc.to_physical, h.reshape((1, len(h), 2)), state.reshape((1, len(state))))
    if contact >= FIRST_NUMBER:  # else the mode is not known
        show(osc.table.elements, contact - FIRST_NUMBER, state)


@kernel
def leave_blocks(osc, h, contact, state):
    """Add ``blocks_to_physical`` of block coordinates h (n, 2) at a contact to a state (2n,) of zeros."""
    if has_modes(osc):
        leave_hybrid(osc, h, contact, state)
        return
    row, blocks, upper, lower = osc.gap_row, osc.gap.blocks, osc.head[HEAD.upper], osc.head[HEAD.lower]
    n = h.shape[0]
    terms = np.zeros(n)
    for j in range(n):
        for k in range(2):
            full = h[j, k] + wave(osc.gap.forced[j, k], osc.tau)[0] + blocks[j, COLUMN.rest0 + k]
            for i in range(2 * n):
                state[i] += osc.to_physical[i, 2 * j + k] * full
            for i in range(n):
                terms[i] += abs(osc.to_physical[i, 2 * j + k]) * (abs(full) + abs(h[j, k]))
    y, size = 0.0, 0.0
    for i in range(n):
        y += row[i] * state[i]
        size += abs(row[i]) * terms[i]
    if contact != FREE:
        put_on_stop(row, upper if contact > 0 else lower, state)
        put_on_stop(row, 0.0, state[n:])
    else:
        stop = min(max(y, lower), upper)
        if y != stop and abs(y - stop) <= 1e-12 * size:
            put_on_stop(row, stop, state)


@kernel
def blocks_to_physical(osc, motion):
    """Physical section state (2n,) of a motion; at rest it is exactly on the stop with v = 0, as in ``placed``.

    A motion is never beyond a stop: overshoot by rounding is removed.
    """
    state = np.zeros(2 * motion.h.shape[0])
    leave_blocks(osc, motion.h, motion.contact[0], state)
    return state
