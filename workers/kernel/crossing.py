"""The certified search for the next time at which a motion in free flight reaches a stop, without sampling in time.

The step rule uses a bound K on the curvature toward a stop. A point at gap g that approaches at speed v cannot arrive
before g = v s + K s^2 / 2. The bounds on the second and third derivative of the gap coordinate hold for all later
times. A march of such steps therefore cannot jump over an impact, however short. Bounds of a growing motion hold until
its size may have doubled, and are then computed again.
"""

import math

import numpy as np

from workers.kernel.borrow import borrow
from workers.kernel.flow import flow
from workers.kernel.fma import fma
from workers.kernel.jit import inline_always, inlined, kernel
from workers.kernel.signal import derivative_bounds, evaluate, growth_rate
from workers.model.oscillator import NUMBER

GAP_ROUNDING = 4e-16
"""Maximum gap at which the mass counts as at the stop, in units of the sum of moduli that add up to y."""

MAX_EVALUATIONS = 1_000_000
"""Maximum number of evaluations of one flight; the certified march needs about five between impacts."""

MIN_STEP = 4e-16
"""Minimum step of a flight, as a share of its longest duration: the rounding of time."""

REFRESH = 8
"""Number of evaluations after which the derivative bounds are renewed from the decayed state."""

DOUBLED = math.log(2.0)
"""Log of the growth after which the derivative bounds of a growing motion are renewed."""

TRIALS = 4
"""Number of trial lengths at the end of a safe step."""

UNCLEAR = 4
"""Value in place of the order of a start whose derivatives are hidden by rounding: a guard that returns to its end at
once."""

TINY = 1e-300
"""Number that keeps a quotient finite for a state at rest."""


@inlined
def arrival(g, v, K):
    """Return the earliest time at which a gap can close: the first s > 0 with g = v s + K s^2 / 2.

    g >= 0  the gap
    v       speed at which it closes
    K       bound of the acceleration at which it closes

    The result is infinity if the gap cannot close.
    """
    D = fma(v, v, 2.0 * K * g)
    r = math.sqrt(max(D, 0.0))
    closing = v > 0.0
    above = 2.0 * g if closing else r - v
    below = v + r if closing else K
    never = D < 0.0 or (K <= 0.0 and not closing)
    return np.inf if never else above / below


@inlined
def curvature(a, j3, M2, M3, M4, h):
    """Return a bound K(h) of the curvature of a signal y: y(s) - y(0) <= v s + K s^2 / 2 for all s <= h.

    a, j3       second and third derivative of y at s = 0
    M2, M3, M4  bounds of the moduli of the second to fourth derivative

    K is the least of three bounds.

    M2                                   by the second derivative
    a + M3 h / 3                         by the third derivative
    a + max(0, j3 + M4 h / 4) h / 3      by the fourth derivative
    """
    return min(M2, fma(min(M3, max(0.0, fma(0.25 * M4, h, j3))), h * (1.0 / 3.0), a))


@inlined
def stays_open(g, v, K, h):
    """Return True if a gap g >= 0 stays open for all times s <= h, that is if v s + K s^2 / 2 < g.

    v is the speed at which the gap closes, K a bound of its acceleration. The inequality is checked at h and at an
    earlier peak.
    """
    end = fma(0.5 * K, h, v) * h < g
    peaks = K < 0.0 and fma(K, h, v) < 0.0
    return (v <= 0.0 or v * v < -2.0 * K * g) if peaks else end


@inlined
def bracket(g, v, a, j3, M2, M3, M4, H):
    """Return two times L <= U, at most H. A gap certainly stays open before L; the longest certified time is at most U.

    g, v, a, j3  the gap, and the speed, acceleration and jerk at which it closes
    M2, M3, M4   bounds of the moduli of its second to fourth derivative

    The gap cannot close before min(h, s(h)), where s(h) is the arrival under the curvature bound K(h). Since s falls
    with h, L = min(h, s(h)) of any h is certified and U = s(L) is a limit. The best h lies between both.
    """
    L = min(H, arrival(g, v, curvature(a, j3, M2, M3, M4, H)))
    U = min(H, arrival(g, v, curvature(a, j3, M2, M3, M4, L)))
    return max(L, min(U, arrival(g, v, curvature(a, j3, M2, M3, M4, U)))), U


@inlined
def close_in(L, U, g, v, a, j3, M2, M3, M4, trials):
    """Return a time from L to U for which a gap certainly stays open, the longest found in ``trials`` bisections.

    L is certified already, and is returned if no longer time is. For the other arguments see ``bracket``.
    """
    h = math.sqrt(L * U)  # at a graze L and U can differ by orders of magnitude
    for _ in range(trials):
        free = stays_open(g, v, curvature(a, j3, M2, M3, M4, h), h)
        L, U = h if free else L, U if free else h
        h = 0.5 * (L + U)
    return L


@inlined
def safe_step(g, v, a, j3, M2, M3, M4, H):
    """Return a time <= H for which a gap g certainly stays open.

    The gap closes at speed v, acceleration a and jerk j3. For the bounds M2, M3 and M4 see ``bracket``.
    """
    L, U = bracket(g, v, a, j3, M2, M3, M4, H)
    return close_in(L, U, g, v, a, j3, M2, M3, M4, TRIALS)


@inlined
def safe_retreat(g, v, a, j3, M2, M3, M4, H):
    """Return a time <= H for which an opening gap, v <= 0, certainly stays open: ``safe_step`` with less effort.

    Such a gap seldom limits a step.
    """
    L = min(H, arrival(g, v, curvature(a, j3, M2, M3, M4, H)))
    return close_in(L, H, g, v, a, j3, M2, M3, M4, TRIALS) if L < H else H


@inlined
def landing(g, v, a, j3, M3, M4, tol):
    """Return the time at which a gap g certainly closes; infinity if the time is not certain.

    v, a, j3  speed, acceleration and jerk at which the gap closes
    M3, M4    bounds of the moduli of its third and fourth derivative
    tol       tolerated error of the gap

    The time is certain if the cubic is exact to ``tol`` and v stays positive until then. The time is the root of

        g = v s + a s^2 / 2 + j3 s^3 / 6,

    computed from its series in g / v by a step of Halley's method. The step is exact to rounding where v changes by
    less than a 64th until then. The remainder of the cubic is below M4 s^4 / 24.
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
def certain_crossing(g, v, a, j3, M3, M4, tol, H):
    """Return the time <= H after which a closing gap g has certainly just closed; infinity if no time is certain.

    A gap of at most ``tol`` has closed at time 0. For the arguments see ``landing``.
    """
    s = landing(max(g, 0.0), v, a, j3, M3, M4, tol)
    s = 0.0 if g <= tol and v > 0.0 else s
    return s if s <= H else np.inf


@inline_always
def _first_step(order, side, a, j3, M3, M4, tol):
    """Return a time for which a motion that starts on a stop with v = 0 certainly stays off the stop.

    order   order of the first nonzero derivative of y at the start, see ``next_crossing``
    side    side of the stop, +-1
    a, j3   second and third derivative of y at the start
    M3, M4  bounds of the moduli of the third and fourth derivative

    The time is 3|a|/M3, or 4|j3|/M4 if a = 0 too. If the jerk points inward as well, it is the longer of both, since a
    may be zero up to rounding. If a and j3 are negligible beside M4, it is the time s with M4 s^4 = 24 tol. Until then
    y stays within ``tol`` of the stop.
    """
    hidden = math.sqrt(math.sqrt(24.0 * tol / max(M4, TINY)))
    if order == UNCLEAR and abs(j3) <= M4 * hidden and abs(a) <= M4 * hidden * hidden:
        return hidden
    by_jerk = 4.0 * abs(j3) / max(M4, TINY)
    if order == 3:
        return by_jerk
    by_acceleration = 3.0 * abs(a) / max(M3, TINY)
    return max(by_acceleration, by_jerk) if side * j3 < 0.0 else by_acceleration


@kernel
def next_crossing(mode, h, phase, offset, upper, lower, start, H, scratch):
    """Find the first time in [0, H] when a signal plus ``offset`` reaches ``upper`` from below or ``lower`` from above.

    mode            GuardedFlow: linear equations of motion in n decoupled blocks, and the signal, called their guard
    h       (n, 2)  block state at the start, (h, h') of each equation
    phase           forcing phase at the start
    start           0 if the start is inside; +-k at ``upper`` or ``lower``, if the k-th derivative of the signal is the
                    first nonzero one: 1 after a rebound, 2 with v = 0, 3 after a release; UNCLEAR if rounding hides k
    scratch (n, 2)  overwritten

    Return (time, side, evaluations). The side is +1 or -1; 0 if nothing is reached, with time H; 2 if the search needed
    more than MAX_EVALUATIONS.
    """
    h, scratch = borrow(h), borrow(scratch)
    blocks, waves, numbers = mode.blocks, mode.waves, mode.numbers
    omega = numbers[NUMBER.omega]
    growth = growth_rate(blocks)
    horizon = DOUBLED / growth if growth > 0.0 else np.inf
    end = min(H, horizon)  # the bounds hold until then
    M0, M2, M3, M4 = derivative_bounds(blocks, numbers, h, end)
    s = 0.0
    for count in range(1, MAX_EVALUATIONS + 1):
        reach = M0 * (1.0 + 1e-12)
        inside = offset + reach < upper and offset - reach > lower
        if inside and end >= H:
            return H, 0, count - 1
        y, v, a, j3, scale = evaluate(blocks, waves, omega, h, s, phase, offset)
        step = end - s
        ahead = 1 if v > 0.0 else -1
        for side in (ahead, -ahead):
            stop = upper if side == 1 else lower
            if inside or abs(stop) == np.inf or side * (offset - stop) + reach < 0.0:
                continue
            g, approach, push = side * (stop - y), side * v, side * a
            tol = GAP_ROUNDING * (scale + abs(stop))
            if count == 1 and start * side > 0:
                g = 0.0
                if abs(start) > 1:
                    step = min(step, _first_step(abs(start), side, a, j3, M3, M4, tol))
                    continue
            contact = certain_crossing(g, approach, push, side * j3, M3, M4, tol, end - s)
            if contact < np.inf:
                return s + contact, side, count
            if side == ahead:
                step = min(step, safe_step(max(g, 0.0), approach, push, side * j3, M2, M3, M4, step))
            else:
                step = min(step, safe_retreat(max(g, 0.0), approach, push, side * j3, M2, M3, M4, step))
        if s + step >= H:
            return H, 0, count
        s = max(s + step, s + MIN_STEP * H)  # bounds the steps of a flight at rest
        if count % REFRESH == 0 or s >= end:
            for j in range(h.shape[0]):
                scratch[j, 0], scratch[j, 1] = h[j, 0], h[j, 1]
            flow(blocks, s, scratch)
            end = min(H, s + horizon)
            M0, M2, M3, M4 = derivative_bounds(blocks, numbers, scratch, end - s)
    return s, 2, MAX_EVALUATIONS
