"""Physical section states and block coordinates, the one made of the other; fields of one oscillator as arrays.

A motion carries its contact. Where there is a physical state alone, ``placed`` says by one rule what its contact is.
"""

import numpy as np

from workers.kernel.impact import forced_state
from workers.kernel.jit import inline_always
from workers.kernel.motion import AT_REST, BEYOND, FREE

ROUNDING = 16.0 * float(np.finfo(np.float64).eps)
"""Rounding of y = g . x as a share of sum |g_i x_i|, and of y' likewise: 16 units in the last place."""


@inline_always
def enter_blocks(to_blocks, response, rest, row, tau, state, h):
    """Write the block coordinates h (n, 2), forced response taken off, of a physical state (2n,).

    Returns its y and y', and the rounding of either.
    """
    n, y, v, y_sum, v_sum = h.shape[0], 0.0, 0.0, 0.0, 0.0
    for j in range(n):
        for k in range(2):
            full = 0.0
            for i in range(2 * n):
                full += to_blocks[2 * j + k, i] * state[i]
            h[j, k] = full - forced_state(response, tau, j, k) - rest[j, k]
        y += row[j] * state[j]
        v += row[j] * state[n + j]
        y_sum += abs(row[j] * state[j])
        v_sum += abs(row[j] * state[n + j])
    return y, v, ROUNDING * y_sum, ROUNDING * v_sum


@inline_always
def placed(y, v, y_error, v_error, upper, lower):
    """The contact that y and y' show but for the load: on a stop with v = 0 +-AT_REST, further out BEYOND, else FREE.

    What is within rounding of a stop is on it, on either side of it.
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


@inline_always
def put_on_stop(row, stop, state, first):
    """Set the coordinate that weighs most in g . x, those of x from place ``first`` of the state, so that g . x = stop.

    g . x is the stop to rounding then, see ROUNDING, and exactly where it is one coordinate with weight +-1.
    """
    k, others = 0, 0.0
    for i in range(len(row)):
        if abs(row[i]) > abs(row[k]):
            k = i
    for i in range(len(row)):
        if i != k:
            others += row[i] * state[first + i]
    state[first + k] = (stop - others) / row[k]


@inline_always
def leave_blocks(to_physical, response, rest, row, tau, upper, lower, h, contact, state):
    """Write the physical state (2n,) of block coordinates h (n, 2); on the stop with v = 0 at a contact: ``placed`` so.

    A motion is never beyond a stop; what rounding leaves of that in the coordinates is taken off.
    """
    n = h.shape[0]
    terms = np.zeros(n)
    for i in range(2 * n):
        state[i] = 0.0
    for j in range(n):
        for k in range(2):
            full = h[j, k] + forced_state(response, tau, j, k) + rest[j, k]
            for i in range(2 * n):
                state[i] += to_physical[i, 2 * j + k] * full
            for i in range(n):
                terms[i] += abs(to_physical[i, 2 * j + k]) * (abs(full) + abs(h[j, k]))
    y, size = 0.0, 0.0
    for i in range(n):
        y += row[i] * state[i]
        size += abs(row[i]) * terms[i]
    if contact != FREE:
        put_on_stop(row, upper if contact > 0 else lower, state, 0)
        put_on_stop(row, 0.0, state, n)
    else:
        stop = min(max(y, lower), upper)
        if y != stop and abs(y - stop) <= 1e-12 * size:
            put_on_stop(row, stop, state, 0)
