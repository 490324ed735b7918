"""Physical section states and block coordinates, the one made of the other; fields of one oscillator as arrays."""

import numpy as np

from workers.kernel.impact import forced_state
from workers.kernel.jit import piece
from workers.kernel.motion import FREE


@piece
def enter_blocks(to_blocks, response, rest, row, tau, state, h):
    """Write the block coordinates h (n, 2), forced response taken off, of a physical state (2n,); its y and y'."""
    n, y, v = h.shape[0], 0.0, 0.0
    for j in range(n):
        for k in range(2):
            full = 0.0
            for i in range(2 * n):
                full += to_blocks[2 * j + k, i] * state[i]
            h[j, k] = full - forced_state(response, tau, j, k) - rest[j, k]
        y += row[j] * state[j]
        v += row[j] * state[n + j]
    return y, v


@piece
def leave_blocks(to_physical, response, rest, row, tau, upper, lower, h, contact, state):
    """Write the physical state (2n,) of block coordinates h (n, 2); exactly on the stop with v = 0 at a contact.

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
    y, v, size, square = 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        y += row[i] * state[i]
        v += row[i] * state[n + i]
        size += abs(row[i]) * terms[i]
        square += row[i] * row[i]
    stop = min(max(y, lower), upper)
    if abs(y - stop) > 1e-12 * size:
        stop = y
    if contact != FREE:
        stop = upper if contact > 0 else lower
    for i in range(n):
        state[i] += row[i] / square * (stop - y)
        if contact != FREE:
            state[n + i] -= row[i] / square * v
