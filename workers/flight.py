"""Closed-form flight of the blocks, and the certified next crossing of a stop: no sampling in time.

The step rule: with a bound K on the curvature toward a stop, a point at gap g that approaches at v cannot
arrive before g = v s + K s^2 / 2. Bounds on the second and third derivative of the signal hold for all
later times, so a march of such steps cannot jump over an impact, however short it would be.
"""

import math

import numpy as np

from workers.jit import kernel

ROUNDING = 4e-16
"""Gap below which the mass is at the stop, in units of the terms that add up to y."""

MAX_EVALUATIONS = 1_000_000
"""Evaluations of one flight after which it is given up; the certified march needs about five between impacts."""

REFRESH = 8
"""Evaluations after which the derivative bounds are renewed from the decayed state."""

TINY = 1e-300
"""Keeps a quotient finite where there is no motion at all."""

ON_STOP_MOVING, ON_STOP_AT_REST, ON_STOP_RELEASED = 1, 2, 3
"""How a flight starts on its own stop: with v away from it; with v = 0; with v = a = 0 (after sticking)."""


@kernel
def block_flow(eta, lam, s):
    """The flow of h'' + 2 eta h' + lam h = 0 over s: (f11, f12, f21, f22), (h, h') -> f (h, h').

    e = exp(-eta s), d = lam - eta^2; C, S = cos(wd s), sin(wd s)/wd for d > 0, their series near d = 0;
    for d < 0 the slow root is lam / (eta + w), which does not cancel.
    """
    d = lam - eta * eta
    x = d * s * s
    if abs(x) < 1e-3:
        e = math.exp(-eta * s)
        C = e * (1.0 - x / 2.0 * (1.0 - x / 12.0 * (1.0 - x / 30.0 * (1.0 - x / 56.0))))
        S = e * s * (1.0 - x / 6.0 * (1.0 - x / 20.0 * (1.0 - x / 42.0 * (1.0 - x / 72.0))))
        return C + eta * S, S, -lam * S, C - eta * S
    if d > 0.0:
        wd = math.sqrt(d)
        e = math.exp(-eta * s)
        C = e * math.cos(wd * s)
        S = e * math.sin(wd * s) / wd
        return C + eta * S, S, -lam * S, C - eta * S
    w = math.sqrt(-d)
    fast = eta + w
    slow = lam / fast
    e_slow, e_fast = math.exp(-slow * s), math.exp(-fast * s)
    S = -e_slow * math.expm1(-2.0 * w * s) / (2.0 * w)
    return (
        (fast * e_slow - slow * e_fast) / (2.0 * w),
        S,
        -lam * S,
        (fast * e_fast - slow * e_slow) / (2.0 * w),
    )


@kernel
def flow(signal, s, h):
    """Move the block state h (n, 2) on by s, in place."""
    for j in range(len(signal.eta)):
        f11, f12, f21, f22 = block_flow(signal.eta[j], signal.lam[j], s)
        h0, h1 = h[j, 0], h[j, 1]
        h[j, 0] = f11 * h0 + f12 * h1
        h[j, 1] = f21 * h0 + f22 * h1


@kernel
def flow_with_tangent(signal, s, h, V):
    """Move the block state h (n, 2) and the tangent vectors V (m, n, 2) on by s, in place."""
    for j in range(len(signal.eta)):
        f11, f12, f21, f22 = block_flow(signal.eta[j], signal.lam[j], s)
        h0, h1 = h[j, 0], h[j, 1]
        h[j, 0] = f11 * h0 + f12 * h1
        h[j, 1] = f21 * h0 + f22 * h1
        for i in range(V.shape[0]):
            v0, v1 = V[i, j, 0], V[i, j, 1]
            V[i, j, 0] = f11 * v0 + f12 * v1
            V[i, j, 1] = f21 * v0 + f22 * v1


@kernel
def dot(row, h):
    """row . h over all blocks, both (n, 2)."""
    total = 0.0
    for j in range(len(row)):
        total += row[j][0] * h[j, 0] + row[j][1] * h[j, 1]
    return total


@kernel
def forced(signal, phase):
    """The forced part at a phase: value, first, second and third derivative in time."""
    w = signal.omega
    sin, cos = math.sin(phase), math.cos(phase)
    value = signal.sin_part * sin + signal.cos_part * cos
    rate = w * (signal.sin_part * cos - signal.cos_part * sin)
    return value, rate, -w * w * value, -w * w * rate


@kernel
def evaluate_now(signal, h, phase, offset):
    """The signal and its first three derivatives with block state h (n, 2) at a phase, and the scale of rounding.

    Block by block q''' = -2 eta q'' - lam q'.
    """
    y, v, a, j3 = forced(signal, phase)
    scale = abs(y) + abs(offset)
    y += offset
    for j in range(len(signal.eta)):
        q0 = signal.row[j][0] * h[j, 0] + signal.row[j][1] * h[j, 1]
        q1 = signal.row1[j][0] * h[j, 0] + signal.row1[j][1] * h[j, 1]
        q2 = signal.row2[j][0] * h[j, 0] + signal.row2[j][1] * h[j, 1]
        y += q0
        v += q1
        a += q2
        j3 -= 2.0 * signal.eta[j] * q2 + signal.lam[j] * q1
        scale += abs(q0)
    return y, v, a, j3, scale


@kernel
def evaluate(signal, h, s, phase, offset):
    """As evaluate_now, a time s after block state h at a phase."""
    y, v, a, j3 = forced(signal, phase + signal.omega * s)
    scale = abs(y) + abs(offset)
    y += offset
    for j in range(len(signal.eta)):
        f11, f12, f21, f22 = block_flow(signal.eta[j], signal.lam[j], s)
        h0 = f11 * h[j, 0] + f12 * h[j, 1]
        h1 = f21 * h[j, 0] + f22 * h[j, 1]
        q0 = signal.row[j][0] * h0 + signal.row[j][1] * h1
        q1 = signal.row1[j][0] * h0 + signal.row1[j][1] * h1
        q2 = signal.row2[j][0] * h0 + signal.row2[j][1] * h1
        y += q0
        v += q1
        a += q2
        j3 -= 2.0 * signal.eta[j] * q2 + signal.lam[j] * q1
        scale += abs(q0)
    return y, v, a, j3, scale


@kernel
def _envelope(q, dq, lam, spread):
    """Bound of |q(t)| for all later t of one block: its energy never grows, sqrt(q^2 + q'^2 / lam)."""
    return min(math.sqrt(q * q + dq * dq / lam), spread)


@kernel
def derivative_bounds(signal, h):
    """Bounds M0..M4 of |y - offset|, |y'|, ..., |y''''| for all times after block state h (n, 2).

    Per block the smaller of two: the energy bound, and for overdamped blocks the moduli of the two
    exponentials, |alpha| slow^k + |beta| fast^k.
    """
    w = signal.omega
    Y = signal.amplitude
    M0, M1, M2, M3, M4 = Y, w * Y, w**2 * Y, w**3 * Y, w**4 * Y
    for j in range(len(signal.eta)):
        eta, lam = signal.eta[j], signal.lam[j]
        q0 = signal.row[j][0] * h[j, 0] + signal.row[j][1] * h[j, 1]
        q1 = signal.row1[j][0] * h[j, 0] + signal.row1[j][1] * h[j, 1]
        q2 = -2.0 * eta * q1 - lam * q0
        q3 = -2.0 * eta * q2 - lam * q1
        q4 = -2.0 * eta * q3 - lam * q2
        q5 = -2.0 * eta * q4 - lam * q3
        b0 = b1 = b2 = b3 = b4 = np.inf
        if eta * eta > 1.5 * lam:
            w2 = 2.0 * math.sqrt(eta * eta - lam)
            fast = eta + w2 / 2.0
            slow = lam / fast
            alpha, beta = abs(fast * q0 + q1) / w2, abs(slow * q0 + q1) / w2
            b0 = alpha + beta
            b1 = alpha * slow + beta * fast
            b2 = alpha * slow**2 + beta * fast**2
            b3 = alpha * slow**3 + beta * fast**3
            b4 = alpha * slow**4 + beta * fast**4
        M0 += _envelope(q0, q1, lam, b0)
        M1 += _envelope(q1, q2, lam, b1)
        M2 += _envelope(q2, q3, lam, b2)
        M3 += _envelope(q3, q4, lam, b3)
        M4 += _envelope(q4, q5, lam, b4)
    return M0, M1, M2, M3, M4


@kernel
def _arrival(g, v, K):
    """First s > 0 with g = v s + K s^2 / 2, infinity if there is none: no arrival before it (g >= 0)."""
    if K > 0.0:
        r = math.sqrt(v * v + 2.0 * K * g)
        return 2.0 * g / (v + r) if v > 0.0 else (r - v) / K
    if v <= 0.0:
        return np.inf
    D = v * v + 2.0 * K * g
    return 2.0 * g / (v + math.sqrt(D)) if D >= 0.0 else np.inf


@kernel
def _curvature(a, j3, M3, M4, h):
    """K(h) with y(s) - y(0) <= v s + K s^2 / 2 for all s <= h.

    From y''' <= M3: a + M3 h / 3; from y'''' <= M4: a + max(0, j3 + M4 h / 4) h / 3, whichever is less.
    """
    return a + min(M3, max(0.0, j3 + 0.25 * M4 * h)) * h / 3.0


@kernel
def safe_step(g, v, a, j3, M2, M3, M4, H):
    """A time <= H in which a gap g, closing at v with acceleration a and jerk j3, certainly does not close.

    Trial lengths h between the certified L and a limit U: no arrival before min(h, s(h)) where s(h) is the
    arrival under the curvature bound K(h). Every L is certified; the trials end when they are near the best.
    """
    L = _arrival(g, v, M2)
    if L >= H:
        return H
    U = min(H, _arrival(g, v, _curvature(a, j3, M3, M4, L)))
    h = U
    for _ in range(4):
        s = _arrival(g, v, _curvature(a, j3, M3, M4, h))
        if s >= h:
            L = max(L, h)
        else:
            L = max(L, s)
            U = min(U, h)
        if U <= 1.05 * L:
            break
        h = math.sqrt(L * U) if L > 0.0 else 0.5 * U
    return L


@kernel
def landing(g, v, a, j3, M3, M4, tol):
    """The time at which a gap g closes if its cubic is exact to tol until then and v stays positive; else infinity.

    Root of g = v s + a s^2 / 2 + j3 s^3 / 6 by Newton from g / v; what is left out is below M4 s^4 / 24.
    """
    s = g / v
    if M4 * s**4 > 12.0 * tol or (abs(a) + M3 * s) * s > 0.25 * v:
        return np.inf
    for _ in range(5):
        excess = ((j3 / 6.0 * s + 0.5 * a) * s + v) * s - g
        s -= excess / ((0.5 * j3 * s + a) * s + v)
    return s if M4 * s**4 <= 24.0 * tol else np.inf


@kernel
def _first_step(kind, j3, a, M3, M4):
    """A time for which a start on a stop at rest certainly leaves it: 3|a|/M3, after a release 4|j|/M4."""
    if kind == ON_STOP_AT_REST:
        return 3.0 * abs(a) / max(M3, TINY)
    return 4.0 * abs(j3) / max(M4, TINY)


@kernel
def next_crossing(signal, h, phase, offset, upper, lower, own, kind, H, scratch):
    """The first time in [0, H] at which the signal reaches ``upper`` from below or ``lower`` from above.

    h (n, 2) and phase: the start; own: the stop (+1 upper, -1 lower, 0 none) that the start lies on and
    kind how (ON_STOP_...). scratch: (n, 2) to overwrite.
    Returns (time, side, evaluations): side +1 or -1; 0 if nothing is reached, time = H;
    2 where the march needed more than MAX_EVALUATIONS.
    """
    M0, _, M2, M3, M4 = derivative_bounds(signal, h)
    s = 0.0
    for count in range(1, MAX_EVALUATIONS + 1):
        reach = M0 * (1.0 + 1e-12)
        if offset + reach < upper and offset - reach > lower:
            return H, 0, count - 1
        if count == 1:
            y, v, a, j3, scale = evaluate_now(signal, h, phase, offset)
        else:
            y, v, a, j3, scale = evaluate(signal, h, s, phase, offset)
        step = H - s
        ahead = 1 if v > 0.0 else -1
        for side in (ahead, -ahead):
            stop = upper if side == 1 else lower
            if side * (offset - stop) + reach < 0.0:
                continue
            g, approach, push = side * (stop - y), side * v, side * a
            if count == 1 and own == side:
                g = 0.0
                if kind != ON_STOP_MOVING:
                    step = min(step, _first_step(kind, j3, a, M3, M4))
                    continue
            tol = ROUNDING * (scale + abs(stop))
            if g <= tol:
                if approach > 0.0:
                    return s, side, count
                g = max(g, 0.0)
            if approach > 0.0:
                rest = landing(g, approach, push, side * j3, M3, M4, tol)
                if s + rest <= H:
                    return s + rest, side, count
            step = min(step, safe_step(g, approach, push, side * j3, M2, M3, M4, step))
        if s + step >= H:
            return H, 0, count
        s = s + step if s + step > s else np.nextafter(s, np.inf)
        if count % REFRESH == 0:
            scratch[:] = h
            flow(signal, s, scratch)
            M0, _, M2, M3, M4 = derivative_bounds(signal, scratch)
    return s, 2, MAX_EVALUATIONS
