"""Closed-form flight of the blocks, and the certified next crossing of a stop: no sampling in time.

The step rule: with a bound K on the curvature toward a stop, a point at gap g that approaches at v cannot
arrive before g = v s + K s^2 / 2. Bounds on the second and third derivative of the signal hold for all
later times, so a march of such steps cannot jump over an impact, however short it would be.
"""

import math

import numpy as np

from workers.kernel.elementary import cosc_sinc, exp_minus, sin_cos
from workers.kernel.fma import fma
from workers.kernel.jit import inlined, kernel
from workers.model.oscillator import COLUMN

GAP_ROUNDING = 4e-16
"""Gap below which the mass is at the stop, in units of the terms that add up to y."""

MAX_EVALUATIONS = 1_000_000
"""Evaluations of one flight after which it is given up; the certified march needs about five between impacts."""

LEAST_STEP = 4e-16
"""Least step of a flight, as a share of the time it may take: rounding of time."""

REFRESH = 8
"""Evaluations after which the derivative bounds are renewed from the decayed state."""

TRIALS = 4
"""Trial lengths at the end of a safe step."""

TINY = 1e-300
"""Keeps a quotient finite where there is no motion at all."""

ON_STOP_MOVING, ON_STOP_AT_REST, ON_STOP_RELEASED = 1, 2, 3
"""How a flight starts on its own stop: with v away from it; with v = 0; with v = a = 0 (after sticking)."""


@inlined
def oscillating_flow(s, eta, lam, w, inv_w):
    """flow_entries of an underdamped block."""
    decay = exp_minus(eta * s)
    sin, cos = sin_cos(w * s)
    S = sin * inv_w
    f12 = decay * S
    return decay * fma(eta, S, cos), f12, -lam * f12, decay * fma(-eta, S, cos)


@inlined
def flow_entries(s, eta, lam, d, w, inv_w, slow, fast):
    """The flow of h'' + 2 eta h' + lam h = 0 over s: (f11, f12, f21, f22), (h, h') -> f (h, h').

    f = e^(-eta s) (C + eta S, S, -lam S, C - eta S). With d = lam - eta^2 and w = sqrt|d|: C, S = cos(w s),
    sin(w s) / w where d > 0; for d <= 0 their series in d s^2 where that is small; and else, with the decay rates
    slow = lam / (eta + w) and fast = eta + w, the exponentials themselves, which do not cancel.
    """
    o11, o12, o21, o22 = oscillating_flow(s, eta, lam, w, inv_w)
    oscillates = d > 0.0
    e_slow = exp_minus(slow * s)
    e_w = exp_minus(w * s)
    x = d * s * s
    C, sinc = cosc_sinc(x)
    near = x > -0.1
    S = s * sinc
    decay = e_slow * e_w
    ratio = e_w * e_w
    half = 0.5 * e_slow * inv_w
    f11 = decay * fma(eta, S, C) if near else half * fma(-slow, ratio, fast)
    f12 = decay * S if near else half * (1.0 - ratio)
    f22 = decay * fma(-eta, S, C) if near else half * fma(fast, ratio, -slow)
    return (
        o11 if oscillates else f11,
        o12 if oscillates else f12,
        o21 if oscillates else -lam * f12,
        o22 if oscillates else f22,
    )


@inlined
def block_flow(block, s):
    """flow_entries of the constants of a block, a row of Signal.block."""
    eta, lam, w, inv_w = block[COLUMN.eta], block[COLUMN.lam], block[COLUMN.w], block[COLUMN.inv_w]
    if block[COLUMN.d] > 0.0:
        return oscillating_flow(s, eta, lam, w, inv_w)
    return flow_entries(s, eta, lam, block[COLUMN.d], w, inv_w, block[COLUMN.slow], block[COLUMN.fast])


@inlined
def fall(s, eta):
    """How far a rigid mode moves from rest in s under a unit load: s^2 (x - 1 + e^-x) / x^2 with x = 2 eta s."""
    x = 2.0 * eta * s
    p = 1.0 / 1307674368000.0
    p = fma(-p, x, 1.0 / 87178291200.0)
    p = fma(-p, x, 1.0 / 6227020800.0)
    p = fma(-p, x, 1.0 / 479001600.0)
    p = fma(-p, x, 1.0 / 39916800.0)
    p = fma(-p, x, 1.0 / 3628800.0)
    p = fma(-p, x, 1.0 / 362880.0)
    p = fma(-p, x, 1.0 / 40320.0)
    p = fma(-p, x, 1.0 / 5040.0)
    p = fma(-p, x, 1.0 / 720.0)
    p = fma(-p, x, 1.0 / 120.0)
    p = fma(-p, x, 1.0 / 24.0)
    p = fma(-p, x, 1.0 / 6.0)
    p = fma(-p, x, 0.5)
    far = ((x - 1.0) + exp_minus(x)) / (x * x)
    return s * s * (p if x < 1.0 else far)


@kernel
def flow(signal, s, h):
    """Move the block state h (n, 2) on by s, in place."""
    block = signal.block  # taken out once, here and elsewhere: a field of a record costs a reference count at every use
    for j in range(len(block)):
        flow_block(block[j], s, h[j])


@inlined
def flow_block(block, s, h):
    """Move the state h (2,) of one block on by s, in place; its flow."""
    f11, f12, f21, f22 = block_flow(block, s)
    h0, h1, load = h[0], h[1], block[COLUMN.load]
    h[0], h[1] = fma(f11, h0, f12 * h1), fma(f21, h0, f22 * h1)
    if load != 0.0:
        h[0], h[1] = fma(load, fall(s, block[COLUMN.eta]), h[0]), fma(load, f12, h[1])
    return f11, f12, f21, f22


@kernel
def flow_with_tangent(signal, s, h, V):
    """Move the block state h (n, 2) and the tangent vectors V (m, n, 2) on by s, in place."""
    block = signal.block
    for j in range(len(block)):
        f11, f12, f21, f22 = flow_block(block[j], s, h[j])
        for i in range(V.shape[0]):
            v0, v1 = V[i, j, 0], V[i, j, 1]
            V[i, j, 0], V[i, j, 1] = fma(f11, v0, f12 * v1), fma(f21, v0, f22 * v1)


@kernel
def dot(row, h):
    """row . h over all blocks, both (n, 2)."""
    total = 0.0
    for j in range(len(row)):
        total = fma(row[j, 1], h[j, 1], fma(row[j, 0], h[j, 0], total))
    return total


@kernel
def dot_vector(row, V, i):
    """row . V[i] over all blocks."""
    total = 0.0
    for j in range(len(row)):
        total = fma(row[j, 1], V[i, j, 1], fma(row[j, 0], V[i, j, 0], total))
    return total


@inlined
def forced(phase, w, sin_part, cos_part):
    """One harmonic of the forced part at its phase, of frequency w: value and derivatives in time."""
    sin, cos = sin_cos(phase)
    y, v = fma(sin_part, sin, cos_part * cos), w * fma(sin_part, cos, -cos_part * sin)
    return y, v, -w * w * y, -w * w * v


@inlined
def all_forced(signal, phase):
    """The forced part at a phase, its first three derivatives, and the sum of the moduli that add up to it."""
    sin_part, cos_part = signal.sin_part, signal.cos_part
    y, v, a, j3, scale = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(sin_part)):
        order = k + 1.0
        y_, v_, a_, j_ = forced(order * phase, order * signal.omega, sin_part[k], cos_part[k])
        y, v, a, j3, scale = y + y_, v + v_, a + a_, j3 + j_, scale + abs(y_)
    return y, v, a, j3, scale


@inlined
def block_output(h0, h1, eta, lam, c0, c1, d0, d1):
    """A block's share q = c . (h, h') of the signal, q' = d . (h, h'), and two more: q'' = -2 eta q' - lam q."""
    q0 = fma(c0, h0, c1 * h1)
    q1 = fma(d0, h0, d1 * h1)
    q2 = fma(-2.0 * eta, q1, -lam * q0)
    return q0, q1, q2, fma(-2.0 * eta, q2, -lam * q1)


@inlined
def loaded_output(h0, h1, eta, lam, c0, c1, d0, d1, load):
    """block_output of a block under a load: q'' = -2 eta q' - lam q + c0 load."""
    q0 = fma(c0, h0, c1 * h1)
    q1 = fma(c1, load, fma(d0, h0, d1 * h1))
    q2 = fma(c0, load, fma(-2.0 * eta, q1, -lam * q0))
    return q0, q1, q2, fma(-2.0 * eta, q2, -lam * q1)


@kernel
def evaluate(signal, h, s, phase, offset):
    """The signal and its first three derivatives a time s after block state h (n, 2) at a phase; scale of rounding."""
    block, row, row1 = signal.block, signal.row, signal.row1
    y, v, a, j3, scale = all_forced(signal, fma(signal.omega, s, phase))
    y, scale = y + offset, scale + abs(offset)
    for j in range(len(block)):
        h0, h1 = h[j, 0], h[j, 1]
        eta, lam, load = block[j, COLUMN.eta], block[j, COLUMN.lam], block[j, COLUMN.load]
        if s > 0.0:
            f11, f12, f21, f22 = block_flow(block[j], s)
            h0, h1 = fma(f11, h0, f12 * h1), fma(f21, h0, f22 * h1)
            if load != 0.0:
                h0, h1 = fma(load, fall(s, eta), h0), fma(load, f12, h1)
        q0, q1, q2, q3 = loaded_output(h0, h1, eta, lam, row[j, 0], row[j, 1], row1[j, 0], row1[j, 1], load)
        y += q0
        v += q1
        a += q2
        j3 += q3
        scale += abs(q0)
    return y, v, a, j3, scale


@inlined
def amplitude_bounds(q0, q1, tilt, weight, grow2, grow3, grow4):
    """Bounds of one block's share q of the signal and of its second to fourth derivatives, for all later times.

    sqrt(q^2 + weight (q' + tilt q)^2) bounds q: with tilt = eta and weight = 1 / d it is the amplitude of the
    oscillation, with 0 and 1 / lam the energy, which never grows. The derivatives are at most grow2...grow4 times that.
    """
    turned = fma(tilt, q0, q1)
    b0 = math.sqrt(fma(q0, q0, weight * (turned * turned)))
    return b0, grow2 * b0, grow3 * b0, grow4 * b0


@inlined
def block_bounds(q0, q1, pull, eta, lam, d, inv_w, slow, fast, tilt, weight, grow2, grow3, grow4):
    """amplitude_bounds where the block oscillates, d > 0; else the smaller of two.

    sqrt(q^2 + q'^2 / lam) of each derivative q, since the energy never grows; and where well overdamped the moduli of
    the two exponentials, |alpha| slow^k + |beta| fast^k. A rigid mode, lam = 0, goes anywhere if under a load or
    undamped, else straight from q to q + q' / (2 eta) = +-alpha; its second and later derivatives never grow. pull is
    what a load adds to q'': see loaded_output.
    """
    a0, a2, a3, a4 = amplitude_bounds(q0, q1, tilt, weight, grow2, grow3, grow4)
    q2 = pull - 2.0 * eta * q1 - lam * q0
    q3 = -2.0 * eta * q2 - lam * q1
    q4 = -2.0 * eta * q3 - lam * q2
    q5 = -2.0 * eta * q4 - lam * q3
    b2 = math.sqrt(q2 * q2 + q3 * q3 * weight)
    b3 = math.sqrt(q3 * q3 + q4 * q4 * weight)
    b4 = math.sqrt(q4 * q4 + q5 * q5 * weight)
    rigid = lam == 0.0
    split = d < -0.5 * lam and not rigid
    alpha = 0.5 * inv_w * abs(fast * q0 + q1)
    beta = 0.5 * inv_w * abs(slow * q0 + q1)
    b0 = min(a0, alpha + beta) if split else a0
    coasts = eta > 0.0 and pull == 0.0
    b0 = (max(abs(q0), alpha) if coasts else np.inf) if rigid else b0
    alpha, beta = alpha * slow * slow, beta * fast * fast
    b2 = min(b2, alpha + beta) if split else b2
    alpha, beta = alpha * slow, beta * fast
    b3 = min(b3, alpha + beta) if split else b3
    alpha, beta = alpha * slow, beta * fast
    b4 = min(b4, alpha + beta) if split else b4
    oscillates = d > 0.0
    return b0, a2 if oscillates else b2, a3 if oscillates else b3, a4 if oscillates else b4


@kernel
def derivative_bounds(signal, h):
    """Bounds M0, M2, M3, M4 of |y - offset| and of its second to fourth derivatives, for all times after h (n, 2)."""
    block, row, row1 = signal.block, signal.row, signal.row1
    swing = signal.swing
    M0, M2, M3, M4 = signal.amplitude, swing[0], swing[1], swing[2]
    for j in range(len(block)):
        load = block[j, COLUMN.load]
        q0 = row[j, 0] * h[j, 0] + row[j, 1] * h[j, 1]
        q1 = row1[j, 0] * h[j, 0] + row1[j, 1] * h[j, 1] + row[j, 1] * load
        pull = row[j, 0] * load
        eta, lam, d, inv_w = block[j, COLUMN.eta], block[j, COLUMN.lam], block[j, COLUMN.d], block[j, COLUMN.inv_w]
        slow, fast, tilt, weight = (
            block[j, COLUMN.slow],
            block[j, COLUMN.fast],
            block[j, COLUMN.tilt],
            block[j, COLUMN.weight],
        )
        grow2, grow3, grow4 = block[j, COLUMN.grow2], block[j, COLUMN.grow3], block[j, COLUMN.grow4]
        b0, b2, b3, b4 = block_bounds(q0, q1, pull, eta, lam, d, inv_w, slow, fast, tilt, weight, grow2, grow3, grow4)
        M0 += b0
        M2 += b2
        M3 += b3
        M4 += b4
    return M0, M2, M3, M4


@inlined
def arrival(g, v, K):
    """First s > 0 with g = v s + K s^2 / 2, infinity if there is none: no arrival before it (g >= 0)."""
    D = fma(v, v, 2.0 * K * g)
    r = math.sqrt(max(D, 0.0))
    closing = v > 0.0
    above = 2.0 * g if closing else r - v
    below = v + r if closing else K
    never = D < 0.0 or (K <= 0.0 and not closing)
    return np.inf if never else above / below


@inlined
def curvature(a, j3, M2, M3, M4, h):
    """K(h) with y(s) - y(0) <= v s + K s^2 / 2 for all s <= h: from the bounds M2, M3, M4.

    M2 itself; from the third derivative a + M3 h / 3; from the fourth a + max(0, j3 + M4 h / 4) h / 3.
    """
    return min(M2, fma(min(M3, max(0.0, fma(0.25 * M4, h, j3))), h * (1.0 / 3.0), a))


@inlined
def stays_open(g, v, K, h):
    """Whether v s + K s^2 / 2 stays below g >= 0 for all s <= h: at its end and, if it has one before, at its peak."""
    end = fma(0.5 * K, h, v) * h < g
    peaks = K < 0.0 and fma(K, h, v) < 0.0
    return (v <= 0.0 or v * v < -2.0 * K * g) if peaks else end


@inlined
def bracket(g, v, a, j3, M2, M3, M4, H):
    """(L, U): times <= H such that a gap g, closing at v with acceleration a and jerk j3, does not close before L.

    No arrival before min(h, s(h)), where s(h) is the arrival under the curvature bound K(h). s falls with h, so
    L = min(h, s(h)) of any h is certified and U = s(L) is a limit: the best h lies between.
    """
    L = min(H, arrival(g, v, curvature(a, j3, M2, M3, M4, H)))
    U = min(H, arrival(g, v, curvature(a, j3, M2, M3, M4, L)))
    return max(L, min(U, arrival(g, v, curvature(a, j3, M2, M3, M4, U)))), U


@inlined
def close_in(L, U, g, v, a, j3, M2, M3, M4, trials):
    """The longest time of some trials between L and U, besides L, for which the gap certainly does not close."""
    h = math.sqrt(L * U)  # at a graze L and U can differ by orders of magnitude
    for _ in range(trials):
        free = stays_open(g, v, curvature(a, j3, M2, M3, M4, h), h)
        L, U = h if free else L, U if free else h
        h = 0.5 * (L + U)
    return L


@inlined
def safe_step(g, v, a, j3, M2, M3, M4, H):
    """A time <= H in which a gap g, closing at v with acceleration a and jerk j3, certainly does not close."""
    L, U = bracket(g, v, a, j3, M2, M3, M4, H)
    return close_in(L, U, g, v, a, j3, M2, M3, M4, TRIALS)


@inlined
def safe_retreat(g, v, a, j3, M2, M3, M4, H):
    """As safe_step for a gap that is opening, v <= 0, and seldom what ends a step: found with less effort."""
    L = min(H, arrival(g, v, curvature(a, j3, M2, M3, M4, H)))
    return close_in(L, H, g, v, a, j3, M2, M3, M4, TRIALS) if L < H else H


@inlined
def landing(g, v, a, j3, M3, M4, tol):
    """The time at which a gap g closes if its cubic is exact to tol until then and v stays positive; else infinity.

    Root of g = v s + a s^2 / 2 + j3 s^3 / 6 from its series in g / v by a step of Halley's method, which is exact to
    rounding where v changes by less than a 64th until then; what the cubic leaves out is below M4 s^4 / 24.
    """
    inv_v = 1.0 / v
    first = g * inv_v
    j6, a2, j2 = j3 * (1.0 / 6.0), 0.5 * a, 0.5 * j3
    e = a2 * first * inv_v
    s = first * fma(-j6 * (first * first), inv_v, fma(2.0 * e, e, 1.0 - e))
    excess = fma(fma(fma(j6, s, a2), s, v), s, -g)
    speed = fma(fma(j2, s, a), s, v)
    s -= excess * speed / fma(speed, speed, -0.5 * excess * fma(j3, s, a))
    sure = v > 0.0 and M4 * (first * first * first * first) <= 12.0 * tol
    sure = sure and fma(M3, first, abs(a)) * first <= v * (1.0 / 64.0) and M4 * (s * s * s * s) <= 24.0 * tol
    return s if sure else np.inf


@inlined
def meets(g, v, a, j3, M3, M4, tol, H):
    """The time <= H after which a gap g, closing at v, is certain to have just closed; infinity where none is."""
    s = landing(max(g, 0.0), v, a, j3, M3, M4, tol)
    s = 0.0 if g <= tol and v > 0.0 else s
    return s if s <= H else np.inf


@kernel
def _first_step(kind, side, a, j3, M3, M4):
    """A time for which a start at rest on stop ``side`` certainly leaves it: 3|a|/M3, after a release 4|j|/M4.

    The longer of both where it is about to leave and the jerk points inward too: a may be zero but for rounding.
    """
    by_jerk = 4.0 * abs(j3) / max(M4, TINY)
    if kind == ON_STOP_RELEASED:
        return by_jerk
    by_acceleration = 3.0 * abs(a) / max(M3, TINY)
    return max(by_acceleration, by_jerk) if side * j3 < 0.0 else by_acceleration


@kernel
def next_crossing(signal, h, phase, offset, upper, lower, own, kind, H, scratch):
    """The first time in [0, H] at which the signal reaches ``upper`` from below or ``lower`` from above.

    h (n, 2) and phase: the start; own: the stop (+1 upper, -1 lower, 0 none) that the start lies on and
    kind how (ON_STOP_...). scratch: (n, 2) to overwrite.
    Returns (time, side, evaluations): side +1 or -1; 0 if nothing is reached, time = H;
    2 where the march needed more than MAX_EVALUATIONS.
    """
    M0, M2, M3, M4 = derivative_bounds(signal, h)
    s = 0.0
    for count in range(1, MAX_EVALUATIONS + 1):
        reach = M0 * (1.0 + 1e-12)
        if offset + reach < upper and offset - reach > lower:
            return H, 0, count - 1
        y, v, a, j3, scale = evaluate(signal, h, s, phase, offset)
        step = H - s
        ahead = 1 if v > 0.0 else -1
        for side in (ahead, -ahead):
            stop = upper if side == 1 else lower
            if abs(stop) == np.inf or side * (offset - stop) + reach < 0.0:
                continue
            g, approach, push = side * (stop - y), side * v, side * a
            if count == 1 and own == side:
                g = 0.0
                if kind != ON_STOP_MOVING:
                    step = min(step, _first_step(kind, side, a, j3, M3, M4))
                    continue
            contact = meets(g, approach, push, side * j3, M3, M4, GAP_ROUNDING * (scale + abs(stop)), H - s)
            if contact < np.inf:
                return s + contact, side, count
            if side == ahead:
                step = min(step, safe_step(max(g, 0.0), approach, push, side * j3, M2, M3, M4, step))
            else:
                step = min(step, safe_retreat(max(g, 0.0), approach, push, side * j3, M2, M3, M4, step))
        if s + step >= H:
            return H, 0, count
        s = max(s + step, s + LEAST_STEP * H)  # at rest but for rounding a flight would need any number of steps
        if count % REFRESH == 0:
            for j in range(h.shape[0]):
                scratch[j, 0], scratch[j, 1] = h[j, 0], h[j, 1]
            flow(signal, s, scratch)
            M0, M2, M3, M4 = derivative_bounds(signal, scratch)
    return s, 2, MAX_EVALUATIONS
