"""States of a machine with modes in physical and in block coordinates, and signals of the states.

A mode is one set of linear equations of motion, decoupled into blocks h'' + 2 eta h' + lam h = load. A physical state
is z = (x, v), displacements and velocities; a block state is (h, h') of each block.

Where functions take ``harmonics`` (H, 2), these are sine and cosine of each harmonic of the force, see
``harmonics_at``.
"""

import numpy as np

from workers.kernel.by_reference import as_many, row_in
from workers.kernel.elementary import sin_cos
from workers.kernel.jit import inline_always, inlined, kernel
from workers.kernel.linalg import copy_into
from workers.model.hybrid_modes import ON
from workers.model.machines import PARALLEL
from workers.model.oscillator import COLUMN

ROW_ROUNDING = 16.0 * float(np.finfo(np.float64).eps)
"""Rounding of y = row . x as a share of sum |row_i x_i|, and of y' likewise: 16 units in the last place."""


@inlined
def number_of(elements, states, slips, phase_index):
    """Return the number that encodes a mode: its phase, the states of its contacts and the slips of its frictions.

    A mode is one set of linear equations of motion, and its phase a part of the forcing period. For the code see
    hybrid_modes.ModeCode.
    """
    number, half, most = phase_index, 2 * elements.depths.shape[2], elements.speeds.shape[2]
    for state in states:
        number = (2 * half + 1) * number + state + half
    for sign in slips:
        number = (2 * most + 1) * number + sign + most
    return number


@inlined
def read_number(elements, number, states, slips):
    """Decode the number of a mode: write its states of contacts (C,) and slips of frictions (F,), and return its phase.

    A mode is one set of linear equations of motion, and its phase a part of the forcing period. For the code see
    hybrid_modes.ModeCode.
    """
    half, most = 2 * elements.depths.shape[2], elements.speeds.shape[2]
    for f in range(len(slips) - 1, -1, -1):
        slips[f] = number % (2 * most + 1) - most
        number //= 2 * most + 1
    for c in range(len(states) - 1, -1, -1):
        states[c] = number % (2 * half + 1) - half
        number //= 2 * half + 1
    return number


@inlined
def segment_of(starts, at):
    """Return the index of the segment of a piecewise linear law that has the argument ``at``.

    starts  (S,) arguments at which the segments begin, ascending
    """
    i = 0
    while i + 1 < len(starts) and starts[i + 1] < at:
        i += 1
    return i


@inlined
def slip_of(elements, e, sliding):
    """Return the state of friction e that slides at this nonzero velocity, see hybrid_modes.ModeCode."""
    side = 1 if sliding > 0.0 else 0
    return (2 * side - 1) * (1 + segment_of(elements.speeds[e, side], abs(sliding)))


@inline_always
def slot_of(codes, number):
    """Return the index, among the modes built so far, of the mode with this number; -1 if it is not built.

    A mode is one set of linear equations of motion; ``codes`` are the numbers of those built.
    """
    for k in range(len(codes)):
        if codes[k] == number:
            return k
    return -1


@inlined
def write_harmonics(phase, harmonics):
    """Write sine and cosine of each harmonic of the force at a phase to ``harmonics`` (H, 2)."""
    for w in range(len(harmonics)):
        harmonics[w, 0], harmonics[w, 1] = sin_cos((w + 1.0) * phase)


@kernel
def harmonics_at(phase, harmonics):
    """Return sine and cosine (H, 2) of this number of harmonics of the force at a phase."""
    turn = np.empty((harmonics, 2))
    write_harmonics(phase, turn)
    return turn


@inlined
def wave(parts, harmonics):
    """Return the value, at the phase of the force in ``harmonics``, of a sum of harmonics, and its rate per radian.

    The sum is sum_k sin_part_k sin(k phase) + cos_part_k cos(k phase). ``parts`` (H, 2) are its amplitudes, and
    ``harmonics`` (H, 2) sine and cosine, see ``harmonics_at``.
    """
    value, rate = 0.0, 0.0
    for k in range(len(harmonics)):
        sin, cos = harmonics[k, 0], harmonics[k, 1]
        value += parts[k, 0] * sin + parts[k, 1] * cos
        rate += (k + 1.0) * (parts[k, 0] * cos - parts[k, 1] * sin)
    return value, rate


@inlined
def guard_value(modes, k, g, z, harmonics):
    """Return the value of signal g of mode k at a physical state z (2n,), and the sum of the moduli of its terms.

    A mode is one set of linear equations of motion, and an event is a signal at an end of its range.
    """
    row = modes.rows[k, g]
    value, _ = wave(modes.direct[k, g], harmonics)
    size = abs(value) + abs(row[len(z)])
    value += row[len(z)]
    for i in range(len(z)):
        value += row[i] * z[i]
        size += abs(row[i] * z[i])
    return value, size


@inlined
def guard_rate(modes, k, g, f, omega, harmonics):
    """Return the rate of change of signal g of mode k, for a state that changes at the rates f (2n,).

    ``modes`` is the table of modes (sets of linear equations), ``omega`` the forcing frequency. An event is a signal at
    an end of its range. For ``harmonics`` see ``harmonics_at``.
    """
    row = modes.rows[k, g]
    _, rate = wave(modes.direct[k, g], harmonics)
    rate *= omega
    for i in range(len(f)):
        rate += row[i] * f[i]
    return rate


@inlined
def right_hand_side(modes, k, z, harmonics, f):
    """Write the time derivative of a physical state z (2n,) in mode k, one set of linear equations, to f (2n,)."""
    at = np.uint64(k)
    n, drive, acceleration = len(z) // 2, modes.drive[at], modes.acceleration[at]
    for i in range(n):
        total, _ = wave(drive[i], harmonics)
        row = acceleration[i]
        total += row[2 * n]
        for j in range(2 * n):
            total += row[j] * z[j]
        f[i], f[n + i] = z[n + i], total


@inlined
def enter(modes, k, z, W, harmonics, h, V):
    """Convert a physical state z (2n,) and tangent vectors W (m, 2n) to coordinates of decoupled equations of mode k.

    Write them to h (n, 2) and V (m, n, 2). The forced response is left out of h. A mode is one set of linear equations
    of motion. For ``harmonics`` see ``harmonics_at``.
    """
    at = np.uint64(k)  # no check for negative indices, here and below
    matrix, blocks, forced = modes.to_blocks[at], modes.blocks[at, 0], modes.forced[at]
    size = len(z)
    for i in range(size):
        total = -blocks[i // 2, COLUMN.rest0 + i % 2] - wave(forced[i // 2, i % 2], harmonics)[0]
        row = matrix[i]
        for j in range(size):
            total += row[j] * z[j]
        h[i // 2, i % 2] = total
    enter_frame(matrix, W, V)


@inlined
def leave(modes, k, h, V, harmonics, z, W):
    """Convert a state h (n, 2) and tangent vectors V (m, n, 2) of the decoupled equations of mode k to physical ones.

    Write them to z (2n,) and W (m, 2n). A mode is one set of linear equations of motion. This is the inverse of
    ``enter``.
    """
    at = np.uint64(k)
    matrix, blocks, forced = modes.to_physical[at], modes.blocks[at, 0], modes.forced[at]
    size = len(z)
    z[:] = 0.0
    for j in range(size):
        rest = blocks[j // 2, COLUMN.rest0 + j % 2]
        full = h[j // 2, j % 2] + wave(forced[j // 2, j % 2], harmonics)[0] + rest
        for i in range(size):
            z[i] += matrix[i, j] * full
    leave_frame(matrix, V, W)


@inline_always
def enter_from_section(oscillator, k, h, at):
    """Convert a state h (n, 2) at t = k T to a state ``at`` (n, 2) of the decoupled equations of mode k.

    A mode is one set of linear equations of motion. At t = k T the coordinates h are the same for all modes, see
    Oscillator.
    """
    n = h.shape[0]
    z = np.empty((1, 2 * n))
    leave_frame(oscillator.to_physical, h.copy().reshape((1, n, 2)), z)
    turn = harmonics_at(oscillator.tau, oscillator.table.pieces.waves.shape[2])
    enter(row_in(as_many(oscillator.table), 0).pieces, k, z[0], np.zeros((0, 2 * n)), turn, at, np.zeros((0, n, 2)))


@inlined
def enter_frame(matrix, W, V):
    """Multiply physical tangent vectors W (m, 2n) by a matrix (2n, 2n), and write the products to V (m, n, 2).

    V are tangent vectors of n decoupled equations.
    """
    for e in range(len(V)):
        for i in range(len(matrix)):
            V[e, i // 2, i % 2] = product(matrix[i], W[e], 0)


@inlined
def leave_frame(matrix, V, W):
    """Multiply tangent vectors V (m, n, 2) by a matrix (2n, 2n), and write the products to W (m, 2n).

    V are tangent vectors of n decoupled equations, W physical ones: displacements, then velocities.
    """
    for e in range(len(V)):
        for i in range(len(matrix)):
            W[e, i] = product_of_blocks(matrix[i], V[e])


@inlined
def row_product(row, z):
    """Return the product row . z, summed over the length of z; the row may be longer."""
    total = 0.0
    for i in range(len(z)):
        total += row[i] * z[i]
    return total


@inlined
def product(row, z, first):
    """Return the product of a row with the part of z that begins at index ``first``."""
    total = 0.0
    for i in range(len(row)):
        total += row[i] * z[first + i]
    return total


@inlined
def product_of_blocks(row, h):
    """Return the product of a row (2n,) with a state h (n, 2), summed in the order of ``product``."""
    total = 0.0
    for j in range(len(h)):
        total += row[2 * j] * h[j, 0]
        total += row[2 * j + 1] * h[j, 1]
    return total


@kernel
def size_of(row, z, first):
    """Return the sum of the moduli of the terms of ``product``, the unit of its rounding."""
    total = 0.0
    for i in range(len(row)):
        total += abs(row[i] * z[first + i])
    return total


@inlined
def reset(z, first, row, kick, target, factor):
    """Apply the jump at an event to a state z, in place.

    The distance of row . z[first:] from ``target`` shrinks by the share ``factor``, along ``kick`` with row . kick = 1.
    """
    change = factor * (target - product(row, z, first))
    for i in range(len(row)):
        z[first + i] += change * kick[i]


@kernel
def damping_along(acceleration, row, kick):
    """Return cA^2k, minus the decay rate of the velocity of y = row . x after a change along ``kick`` (n,).

    acceleration  (n, 2n + 1) accelerations in the mode (set of linear equations) as rows on (x, v, 1)
    """
    n, total = len(row), 0.0
    for i in range(n):
        for j in range(n):
            total += row[i] * acceleration[i, n + j] * kick[j]
    return total


@kernel
def mode_number_of_state(elements, z):
    """Return the number of the mode in which a motion starts at a physical state z (2n,) at t = k T; -1 beyond a stop.

    The mode, a set of linear equations, is one of the machine's first phase, a part of the forcing period.

    A contact on a rigid stop with v = 0, to ROW_ROUNDING, sticks. Friction sticks at sliding velocity zero. Forces that
    contradict this mode change it at once, see events.follow_jumps.
    """
    n = elements.row.shape[1]
    states = np.zeros(elements.row.shape[0], dtype=np.int64)
    slips = np.zeros(elements.friction_rows.shape[0], dtype=np.int64)
    for c in range(len(states)):
        row = elements.row[c]
        y, v = product(row, z, 0), product(row, z, n)
        near, slow = ROW_ROUNDING * size_of(row, z, 0), ROW_ROUNDING * size_of(row, z, n)
        for side in (-1, 1):
            stop = elements.stops[c, 1 if side > 0 else 0]
            depth = side * (y - stop)
            if elements.soft[c] > 0.0 and depth > 0.0:
                states[c] = side * (ON + 2 * segment_of(elements.depths[c, 1 if side > 0 else 0], depth))
            elif elements.soft[c] == 0.0 and depth > near:
                return -1
            elif elements.soft[c] == 0.0 and abs(depth) <= near and abs(v) <= slow:
                states[c] = side
    for e in range(len(slips)):
        sliding = product(elements.friction_rows[e], z, n) - elements.belt[e]
        if abs(sliding) > ROW_ROUNDING * (size_of(elements.friction_rows[e], z, n) + abs(elements.belt[e])):
            slips[e] = slip_of(elements, e, sliding)
    return number_of(elements, states, slips, 0)


@kernel
def snap_to_mode(elements, number, z):
    """Remove deviations of rounding size from a physical state z (2n,), in place, in the mode of this number.

    A mode is one set of linear equations. A sticking contact is put on its stop with v = 0; sticking friction does not
    slide.
    """
    C, F, n = len(elements.row), len(elements.friction_rows), elements.row.shape[1]
    states, slips = np.zeros(C, dtype=np.int64), np.zeros(F, dtype=np.int64)
    rows, values, count = np.zeros((C + F, n)), np.zeros(C + F), 0
    read_number(elements, number, states, slips)
    for c in range(C):
        if abs(states[c]) == ON and elements.soft[c] == 0.0:
            copy_into(rows[count], elements.row[c])
            values[count] = elements.stops[c, 1 if states[c] > 0 else 0]
            count += 1
    satisfy_rows(rows[:count], values[:count], z[:n])
    values[:count] = 0.0
    for e in range(F):
        if slips[e] == 0:
            copy_into(rows[count], elements.friction_rows[e])
            values[count] = elements.belt[e]
            count += 1
    satisfy_rows(rows[:count], values[:count], z[n:])


@kernel
def satisfy_rows(rows, values, x):
    """Change x (n,) so that rows x = values, in place, in one coordinate for each row of ``rows`` (r, n).

    The coordinate is the one with the largest weight. The result is exact for rows that are coordinates with weights
    +-1, or differences of two. Rows that depend on earlier ones, such as friction on the row of a contact, are left
    out.
    """
    A, right, pivots = rows.copy(), values.copy(), np.full(len(rows), -1)
    for i in range(len(rows)):
        for j in range(i):
            if pivots[j] >= 0:
                share = A[i, pivots[j]] / A[j, pivots[j]]
                right[i] -= share * right[j]
                for k in range(len(x)):
                    A[i, k] = 0.0 if k == pivots[j] else A[i, k] - share * A[j, k]
        most, least = 0.0, PARALLEL * np.max(np.abs(rows[i]))
        for k in range(len(x)):
            if abs(A[i, k]) > max(most, least):
                most, pivots[i] = abs(A[i, k]), k
    for i in range(len(rows) - 1, -1, -1):
        if pivots[i] >= 0:
            total = right[i]
            for k in range(len(x)):
                if k != pivots[i]:
                    total -= A[i, k] * x[k]
            x[pivots[i]] = total / A[i, pivots[i]]
