"""A state of a hybrid machine: physical between modes, z = (x, v), in blocks within one; its guards and its rates."""

import numpy as np

from workers.kernel.contact import wave
from workers.kernel.jit import inline_always, kernel
from workers.model.hybrid_modes import CONTACT_DIGIT, SLIP_DIGIT
from workers.model.oscillator import COLUMN


@kernel
def number_of(states, slips, where):
    """The number of the mode of these contacts and slips in this phase, see model.hybrid.Code."""
    number = where
    for state in states:
        number = CONTACT_DIGIT * number + state + CONTACT_DIGIT // 2
    for sign in slips:
        number = SLIP_DIGIT * number + sign + SLIP_DIGIT // 2
    return number


@kernel
def read_number(number, states, slips):
    """Write what contacts and slips do in the mode of this number; its phase."""
    for f in range(len(slips) - 1, -1, -1):
        slips[f] = number % SLIP_DIGIT - SLIP_DIGIT // 2
        number //= SLIP_DIGIT
    for c in range(len(states) - 1, -1, -1):
        states[c] = number % CONTACT_DIGIT - CONTACT_DIGIT // 2
        number //= CONTACT_DIGIT
    return number


@inline_always
def slot_of(codes, number):
    """Where the mode of this number is among those built, -1 where it is not."""
    for k in range(len(codes)):
        if codes[k] == number:
            return k
    return -1


@kernel
def guard_value(pieces, k, g, z, phase):
    """Signal g of mode k at a physical state z (2n,), and the sum of the moduli that add up to it."""
    row = pieces.rows[k, g]
    value, _ = wave(pieces.direct[k, g], phase)
    size = abs(value) + abs(row[len(z)])
    value += row[len(z)]
    for i in range(len(z)):
        value += row[i] * z[i]
        size += abs(row[i] * z[i])
    return value, size


@kernel
def guard_rate(pieces, k, g, f, omega, phase):
    """The rate of signal g of mode k where the state has the rates f (2n,)."""
    _, rate = wave(pieces.direct[k, g], phase)
    rate *= omega
    for i in range(len(f)):
        rate += pieces.rows[k, g, i] * f[i]
    return rate


@kernel
def right_hand_side(pieces, k, z, phase, f):
    """Write z' (2n,) in mode k."""
    n = len(z) // 2
    for i in range(n):
        total, _ = wave(pieces.drive[k, i], phase)
        row = pieces.acceleration[k, i]
        total += row[2 * n]
        for j in range(2 * n):
            total += row[j] * z[j]
        f[i], f[n + i] = z[n + i], total


@kernel
def enter(pieces, k, z, W, phase, h, V):
    """Write the block state h (n, 2), forced response taken off, and the tangent vectors V (m, n, 2) in mode k."""
    matrix, blocks, forced = pieces.to_blocks[k], pieces.blocks[k, 0], pieces.forced[k]
    size = len(z)
    for i in range(size):
        total = -blocks[i // 2, COLUMN.rest0 + i % 2] - wave(forced[i // 2, i % 2], phase)[0]
        for j in range(size):
            total += matrix[i, j] * z[j]
        h[i // 2, i % 2] = total
    transform(matrix, W, V)


@kernel
def leave(pieces, k, h, V, phase, z, W):
    """Write the physical state z (2n,) and the tangent vectors W (m, 2n) of those of mode k."""
    matrix, blocks, forced = pieces.to_physical[k], pieces.blocks[k, 0], pieces.forced[k]
    size = len(z)
    z[:] = 0.0
    for j in range(size):
        rest = blocks[j // 2, COLUMN.rest0 + j % 2]
        full = h[j // 2, j % 2] + wave(forced[j // 2, j % 2], phase)[0] + rest
        for i in range(size):
            z[i] += matrix[i, j] * full
    transform(matrix, V, W)


@kernel
def transform(matrix, given, found):
    """Write the m vectors that a matrix (2n, 2n) makes of given ones, each (m, 2n), or (m, n, 2) in blocks."""
    m, size = len(given), len(matrix)
    given, found = given.reshape((m, size)), found.reshape((m, size))
    for e in range(m):
        for i in range(size):
            found[e, i] = product(matrix[i], given[e], 0)


@kernel
def product(row, z, first):
    """row . z[first:], as many terms as the row has."""
    total = 0.0
    for i in range(len(row)):
        total += row[i] * z[first + i]
    return total


@kernel
def reset(z, first, row, kick, target, factor):
    """Take row . z[first:] by ``factor`` of its distance to ``target`` nearer to it, along ``kick``, row . kick = 1."""
    change = factor * (target - product(row, z, first))
    for i in range(len(row)):
        z[first + i] += change * kick[i]


@kernel
def damping_along(acceleration, row, kick):
    """cA^2k: minus the rate at which a velocity along ``kick`` (n,) decays, as y = row . x sees it."""
    n, total = len(row), 0.0
    for i in range(n):
        for j in range(n):
            total += row[i] * acceleration[i, n + j] * kick[j]
    return total


@kernel
def shown_number(elements, z):
    """The number of the mode that a physical section state z (2n,) shows, in the first phase; -1 beyond a rigid stop.

    On a rigid stop with v = 0 it is held; friction sticks where nothing slides. Forces that say otherwise are heeded
    at once, see events.follow_jumps.
    """
    n = elements.row.shape[1]
    states = np.zeros(elements.row.shape[0], dtype=np.int64)
    slips = np.zeros(elements.slide.shape[0], dtype=np.int64)
    for c in range(len(states)):
        y, v = product(elements.row[c], z, 0), product(elements.row[c], z, n)
        for side in (-1, 1):
            stop = elements.stops[c, 1 if side > 0 else 0]
            depth = side * (y - stop)
            if elements.soft[c] > 0.0 and depth > 0.0:
                states[c] = side
            elif elements.soft[c] == 0.0 and depth > 0.0:
                return -1
            elif elements.soft[c] == 0.0 and depth == 0.0 and v == 0.0:
                states[c] = side
    for e in range(len(slips)):
        slips[e] = np.sign(product(elements.slide[e], z, n) - elements.belt[e])
    return number_of(states, slips, 0)
