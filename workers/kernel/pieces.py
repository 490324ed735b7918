"""Motion through changing laws: one loop of mode, first guard and reset, for any machine of model/pieces.py.

Between events a mode's blocks carry the motion; at events it is a physical state z = (x, v), and so are its tangent
vectors. An event at which a guard r falls to zero takes a tangent vector w to

    R w + (f+ - R f-) (r.w) / (r.f- + r's own rate),

f the right-hand sides before and after it, R what it does to the state.
"""

import math

import numpy as np
from numba import types

from workers.kernel.contact import chatter_time, forced_state, is_rebound, load_at_rest
from workers.kernel.crossing import TINY, next_crossing
from workers.kernel.elementary import sin_cos
from workers.kernel.flow import flow, flow_with_tangent
from workers.kernel.jit import inline_always, kernel
from workers.kernel.motion import (
    LOST,
    MARCH_GAVE_UP,
    RECORDED,
    RUNNING,
    STATUS,
    STUCK,
)
from workers.kernel.period import record_impact, spend
from workers.kernel.signal import derivative_bounds
from workers.kernel.tangent import MAX_SPREAD, graded_flow, orthonormalise, spread_rate
from workers.model.oscillator import Mode
from workers.model.pieces import DETACHED, ON, OPEN, SIGNALS

MODE_MISSING, NO_MODE, ENDLESS, SIMULTANEOUS = 5, 6, 7, 8
"""Status: a mode has to be built first; what it came to is none; events follow each other without end; two rigid
contacts at once."""

EPS = float(np.finfo(np.float64).eps)

JUMPED = 1e-12
"""Share of its terms by which a guard has to be outside for a jump to have taken it there."""

COMPLETION = 1e-4
"""See contact.COMPLETION."""


@kernel
def slot_of(codes, states, slips, where):
    """Where the mode of these contacts and slips in this phase is among those built, -1 where it is not."""
    number = where
    for state in states:
        number = 5 * number + state + 2
    for sign in slips:
        number = 3 * number + sign + 1
    for k in range(len(codes)):
        if codes[k] == number:
            return k, number
    return -1, number


@kernel
def read_code(number, states, slips):
    """Write what contacts and slips do in the mode of this number; its phase."""
    for f in range(len(slips) - 1, -1, -1):
        slips[f] = number % 3 - 1
        number //= 3
    for c in range(len(states) - 1, -1, -1):
        states[c] = number % 5 - 2
        number //= 5
    return number


@kernel
def wave(parts, phase):
    """sum_k sin_part_k sin(k phase) + cos_part_k cos(k phase) of parts (H, 2), and its rate per radian."""
    value, rate = 0.0, 0.0
    for k in range(len(parts)):
        sin, cos = sin_cos((k + 1.0) * phase)
        value += parts[k, 0] * sin + parts[k, 1] * cos
        rate += (k + 1.0) * (parts[k, 0] * cos - parts[k, 1] * sin)
    return value, rate


@kernel
def guard_value(piece, k, g, z, phase):
    """Signal g of mode k at a physical state z (2n,), and the sum of the moduli that add up to it."""
    row = piece.rows[k, g]
    value, _ = wave(piece.direct[k, g], phase)
    value += row[len(z)]
    size = abs(value) + abs(row[len(z)])
    for i in range(len(z)):
        value += row[i] * z[i]
        size += abs(row[i] * z[i])
    return value, size


@kernel
def right_hand_side(piece, k, z, phase, f):
    """Write z' (2n,) in mode k."""
    n = len(z) // 2
    rows = piece.acceleration[k]
    for i in range(n):
        total, _ = wave(piece.drive[k, i], phase)
        total += rows[i, 2 * n]
        for j in range(2 * n):
            total += rows[i, j] * z[j]
        f[i], f[n + i] = z[n + i], total


@kernel
def enter(piece, k, z, W, phase, h, V):
    """Write the block state h (n, 2), forced response taken off, and the tangent vectors V (m, n, 2) in mode k."""
    matrix, rest, forced = piece.to_blocks[k], piece.rest[k], piece.forced[k]
    size = len(z)
    for i in range(size):
        total = -rest[i] - forced_state(forced, phase, i // 2, i % 2)
        for j in range(size):
            total += matrix[i, j] * z[j]
        h[i // 2, i % 2] = total
        for e in range(W.shape[0]):
            total = 0.0
            for j in range(size):
                total += matrix[i, j] * W[e, j]
            V[e, i // 2, i % 2] = total


@kernel
def leave(piece, k, h, V, phase, z, W):
    """Write the physical state z (2n,) and the tangent vectors W (m, 2n) of those of mode k."""
    matrix, rest, forced = piece.to_physical[k], piece.rest[k], piece.forced[k]
    size = len(z)
    z[:] = 0.0
    W[:] = 0.0
    for j in range(size):
        full = h[j // 2, j % 2] + forced_state(forced, phase, j // 2, j % 2) + rest[j]
        for i in range(size):
            z[i] += matrix[i, j] * full
        for e in range(W.shape[0]):
            for i in range(size):
                W[e, i] += matrix[i, j] * V[e, j // 2, j % 2]


@kernel
def push_along(z, first, row, kick, target, factor):
    """Add to z[first : first + n] what moves row . z[first...] by ``factor`` of its distance to ``target``."""
    total = -target
    for i in range(len(row)):
        total += row[i] * z[first + i]
    for i in range(len(row)):
        z[first + i] += kick[i] * (factor * -total)
    return total


@kernel
def project_to_rest(acceleration, row, kick, w):
    """Carry a tangent vector w (2n,) through complete chatter: w - (A k)(c w) - k (cA w - cA^2k c w)."""
    n = len(row)
    y, v = 0.0, 0.0
    for i in range(n):
        y += row[i] * w[i]
        v += row[i] * w[n + i]
    cA2k = 0.0
    for i in range(n):
        damped = 0.0
        for j in range(n):
            damped += acceleration[i, n + j] * kick[j]
        cA2k += row[i] * damped
        w[i] -= kick[i] * y
        w[n + i] -= damped * y
    for i in range(n):
        w[n + i] -= kick[i] * (v - cA2k * y)


@kernel
def damping_along(acceleration, row, kick):
    """cA^2k: the rate at which a velocity along ``kick`` decays, as y sees it, negative."""
    n, total = len(row), 0.0
    for i in range(n):
        for j in range(n):
            total += row[i] * acceleration[i, n + j] * kick[j]
    return total


@kernel
def after_impact(load, v, a, cA2k, R, scale, remaining, M3):
    """Whether an impact comes to rest: see contact.outcome; 1 rest, 0 rebound, 2 v = 0 with the load pulling away."""
    if is_rebound(load, v, R, cA2k, scale, remaining):
        return 0
    if R == 0.0:
        return 1 if load > 0.0 else 2
    w = R * abs(v)
    if w * w <= 200.0 * load * EPS * scale:
        return 1
    return 1 if chatter_time(load, w, R) * M3 + 2.0 * abs(cA2k * v) <= COMPLETION * load else 0


@kernel
def settle_jumps(table, states, slips, where, z, phase, begun):
    """Let what a jump has taken beyond its guard follow: what sticks slips, what pushes engages. The mode, or -1.

    Returns also its number. Each change may be the cause of others; -2 where they have no end.
    """
    piece, C = table.piece, len(states)
    for _ in range(4 * (C + len(slips) + 1)):
        k, number = slot_of(table.codes, states, slips, where)
        if k < 0 or table.wrong[k]:
            return (-3 if k >= 0 else -1), number
        again = False
        for g in range(len(begun)):
            low, high = piece.ends[k, g, 0], piece.ends[k, g, 1]
            if begun[g] != 0 or (low == -np.inf and high == np.inf):
                continue
            value, size = guard_value(piece, k, g, z, phase)
            side = 1 if value > high + JUMPED * size else (-1 if value < low - JUMPED * size else 0)
            if side == 0:
                continue
            if g >= SIGNALS * C:
                f = g - SIGNALS * C
                slips[f] = -side if slips[f] == 0 else -slips[f]
                begun[g] = -slips[f]
                again = True
            elif g % SIGNALS == 1:
                c = g // SIGNALS
                states[c] = (2 if abs(states[c]) == 1 else 1) * (1 if states[c] > 0 else -1)
                again = True
            elif abs(states[g // SIGNALS]) == 1 and table.elements.soft[g // SIGNALS] == 0.0:
                begun[g] = 2 * states[g // SIGNALS]
                states[g // SIGNALS] = 0
                again = True
            if again:
                break
        if not again:
            return k, number
    return -2, number


@kernel
def through_pieces(table, z, W, code, growth, triangle, tally, duration, events):
    """Take a physical state z (2n,) and tangent vectors W (m, 2n) from a section on by ``duration`` <= one period.

    In place, with the number of the mode in code (1,). growth (m,), triangle: see tangent.orthonormalise; of no length
    where the vectors are not to be made orthonormal. events (K, 4): the first K of them as (time, signal, side, value),
    value being the rate of the guard. Stops early with tally[STATUS] set where it cannot go on.
    """
    piece, elements = table.piece, table.elements
    n, m, G = len(z) // 2, W.shape[0], piece.ends.shape[1]
    states = np.zeros(elements.row.shape[0], dtype=np.int64)
    slips = np.zeros(elements.slide.shape[0], dtype=np.int64)
    begun = np.zeros(G, dtype=np.int64)
    C, period = len(states), 2.0 * math.pi / table.omega
    h, scratch, V = np.empty((n, 2)), np.empty((n, 2)), np.empty((m, n, 2))
    f, after, slopes = np.empty(2 * n), np.empty(2 * n), np.empty(m)
    t, phase = 0.0, table.tau
    where = read_code(code[0], states, slips)
    jumps = where != 0
    where = 0
    while True:
        if jumps:
            k, number = settle_jumps(table, states, slips, where, z, phase, begun)
        else:
            k, number = slot_of(table.codes, states, slips, where)
            if k >= 0 and table.wrong[k]:
                k = -3
        if k < 0:
            tally[STATUS] = MODE_MISSING if k == -1 else (ENDLESS if k == -2 else NO_MODE)
            code[0] = number
            return
        jumps = False
        tally[LOST] = max(tally[LOST], piece.lost[k])
        until = min(duration, elements.starts[where + 1] * period)
        enter(piece, k, z, W, phase, h, V)
        s, hit, side = until - t, -1, 0
        for g in range(G):
            low, high = piece.ends[k, g, 0], piece.ends[k, g, 1]
            if low == -np.inf and high == np.inf:
                continue
            mode = Mode(piece.blocks[k, g], piece.metric[k], piece.waves[k, g], piece.numbers[k, g], piece.forced[k])
            at, there, evaluations = next_crossing(
                mode, h, phase, piece.offset[k, g], high, low, begun[g], s, scratch
            )
            spend(tally, evaluations)
            if there == 2:
                tally[STATUS] = MARCH_GAVE_UP
            if abs(there) == 1 and (at < s or hit < 0):
                s, hit, side = at, g, there
        if tally[STATUS] != RUNNING:
            return
        blocks = piece.blocks[k, 0]
        if growth.shape[0] > 0 and s * spread_rate(blocks) > MAX_SPREAD:
            flow(blocks, s, h)
            graded_flow(blocks, s, V, growth, triangle, 2 * n - int(tally[LOST]))
        else:
            flow_with_tangent(blocks, s, h, V)
        if growth.shape[0] > 0:
            orthonormalise(piece.metric[k], V, growth, triangle, 2 * n - int(tally[LOST]))
        if piece.lost[k] > 0.0:
            tally[STUCK] += s
        if s > 0.0:
            begun[:] = 0
        t += s
        phase += table.omega * s
        leave(piece, k, h, V, phase, z, W)
        if hit < 0:
            if until >= duration:
                code[0] = number
                return
            where, t, jumps = where + 1, until, True
            phase = table.tau + table.omega * t
            continue
        # The event: its guard's rate, and what it does to the state and to the tangent vectors.
        right_hand_side(piece, k, z, phase, f)
        row = piece.rows[k, hit]
        _, rate = wave(piece.direct[k, hit], phase)
        rate *= table.omega
        for i in range(2 * n):
            rate += row[i] * f[i]
        rate = side * max(side * rate, TINY)
        for e in range(m):
            slopes[e] = 0.0
            for i in range(2 * n):
                slopes[e] += row[i] * W[e, i] / rate
        place = int(tally[RECORDED])
        if place < events.shape[0]:
            events[place, 0], events[place, 1], events[place, 2], events[place, 3] = t, hit, side, rate
            tally[RECORDED] += 1.0
        if hit >= SIGNALS * C:
            e = hit - SIGNALS * C
            if slips[e] == 0:
                slips[e] = -side
                begun[hit] = side * (2 if elements.even[e] > 0.0 else 1)
            else:
                sign = slips[e]
                slips[e] = 0
                stuck, number = slot_of(table.codes, states, slips, where)
                if stuck < 0 or table.wrong[stuck]:
                    tally[STATUS] = MODE_MISSING if stuck < 0 else NO_MODE
                    code[0] = number
                    return
                force, _ = guard_value(piece, stuck, hit, z, phase)
                if abs(force) <= piece.ends[stuck, hit, 1]:
                    push_along(z, n, elements.slide[e], elements.brake[e], elements.belt[e], 1.0)
                    push_along(f, n, elements.slide[e], elements.brake[e], 0.0, 1.0)
                    for i in range(m):
                        push_along(W[i], n, elements.slide[e], elements.brake[e], 0.0, 1.0)
                else:
                    slips[e] = -sign if force * sign > 0.0 else -sign
                    slips[e] = -1 if force > 0.0 else 1
                    begun[hit] = -slips[e]
        else:
            c = hit // SIGNALS
            state = states[c]
            if hit % SIGNALS == 1:
                states[c] = (2 if abs(state) == 1 else 1) * (1 if state > 0 else -1)
                begun[hit] = 1 if abs(state) == 1 else -1
            elif elements.soft[c] > 0.0:
                if state == 0:
                    record_impact(tally, events[:0, :3], t, side, abs(rate), 1.0)
                    states[c] = side
                    begun[hit] = -side
                else:
                    states[c] = 0
                    begun[hit] = 1 if state > 0 else -1
            elif state != 0:
                states[c] = 0
                begun[hit] = 3 * state
            else:
                stop = elements.stops[c, 1 if side > 0 else 0]
                g_row, kick, R = elements.row[c], elements.kick[c], elements.R[c]
                for other in range(C):
                    if other != c and states[other] != 0 and elements.soft[other] == 0.0:
                        coupled = 0.0
                        for i in range(n):
                            coupled += elements.row[other, i] * kick[i]
                        if abs(coupled) > JUMPED:
                            tally[STATUS] = SIMULTANEOUS
                            return
                a, cA2k = 0.0, damping_along(piece.acceleration[k], g_row, kick)
                scale = abs(stop)
                for i in range(n):
                    a += g_row[i] * f[n + i]
                    scale += abs(g_row[i] * z[i])
                M3 = derivative_bounds(piece.blocks[k, hit], piece.numbers[k, hit], h)[2]
                load = load_at_rest(side, rate, a, cA2k)
                result = after_impact(load, rate, a, cA2k, R, scale, duration - t, M3)
                push_along(z, 0, g_row, kick, stop, 1.0)
                if result == 1:
                    for i in range(m):
                        project_to_rest(piece.acceleration[k], g_row, kick, W[i])
                        slopes[i] = 0.0
                    push_along(z, n, g_row, kick, 0.0, 1.0)
                    states[c] = side
                else:
                    record_impact(tally, events[:0, :3], t, side, abs(rate), R)
                    push_along(z, n, g_row, kick, 0.0, 1.0 + R)
                    push_along(f, n, g_row, kick, 0.0, 1.0 + R)
                    for i in range(n):
                        f[i] = f[i]
                    for i in range(m):
                        push_along(W[i], n, g_row, kick, 0.0, 1.0 + R)
                    begun[hit] = side * (2 if result == 2 else 1)
                for e in range(len(slips)):  # what friction rubs on has jumped
                    seen, sliding = 0.0, -elements.belt[e]
                    for i in range(n):
                        seen += elements.slide[e, i] * kick[i]
                        sliding += elements.slide[e, i] * z[n + i]
                    if seen != 0.0 and sliding != 0.0:
                        slips[e] = 1 if sliding > 0.0 else -1
                        begun[SIGNALS * C + e] = 0
        k, number = settle_jumps(table, states, slips, where, z, phase, begun)
        if k < 0:
            tally[STATUS] = MODE_MISSING if k == -1 else (ENDLESS if k == -2 else NO_MODE)
            code[0] = number
            return
        right_hand_side(piece, k, z, phase, after)
        for e in range(m):
            for i in range(2 * n):
                W[e, i] += (after[i] - f[i]) * slopes[e]
