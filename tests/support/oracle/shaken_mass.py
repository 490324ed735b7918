"""A free mass under a constant load in a shaken frame, followed by exact monotonicity: fast enough for long runs.

    y'' = load + F sin(phi),   phi = omega t + tau,   lower <= y <= upper,   impacts y' -> -R y'

The acceleration changes its sign at phases known in closed form. Between two of them the velocity is monotone, so it
has at most one zero; between the zeros of the velocity the position is monotone, so it crosses a stop at most once.
Each zero is bisected. Nothing is bounded, marched or sampled: no code and no method is shared with the solver, nor with
the multiprecision simulator. Double precision, with differences of sines written so that the shortest hop keeps its
relative accuracy.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

FREE, LOWER, UPPER = 0, -1, 1
COMPLETE = 1e-11
"""Duration of chatter, in radians of the forcing, that counts as completed."""

AT_ONCE = 1e-9
"""Length in phase below which a change of sign counts as past: a mass leaves a stop exactly at one."""

MOST_IMPACTS = 100_000
"""Most impacts of a period: beyond it a run gives up."""


@dataclass(frozen=True)
class ShakenMassHistory:
    """History of a motion, one row per period.

    states    (N + 1, 2) y and y' at the sections; contact (N + 1,) the stop on which the mass rests there, 0 if free
    hits      (N, 2) impacts at the lower and the upper stop; rests (N,) begun or continued in that period
    stretch   (N,) log of the growth of a tangent vector; -infinity if the mass rested
    jacobian  (2, 2) of the whole run; singular if the mass rested
    gave_up   true if a period had more than MOST_IMPACTS impacts: the rows after it are NaN
    """

    states: Array
    contact: Counts
    hits: Counts
    rests: Counts
    stretch: Array
    jacobian: Array
    gave_up: bool


def follow(
    *, load: float, force: float, omega: float, tau: float, lower: float, upper: float, R: float,
    start: tuple[float, float], periods: int,
) -> ShakenMassHistory:  # fmt: skip
    """The motion over these forcing periods from (y, y') at t = 0, at rest on a stop if pressed there."""
    N = periods
    states, contact = np.full((N + 1, 2), np.nan), np.zeros(N + 1, dtype=np.int64)
    hits, rests, stretch = np.zeros((N, 2), dtype=np.int64), np.zeros(N, dtype=np.int64), np.zeros(N)
    states[0] = start
    if start[1] == 0.0 and start[0] in (lower, upper):
        side = UPPER if start[0] == upper else LOWER
        contact[0] = side if side * (load + force * math.sin(tau)) > 0.0 else FREE
    jacobian = np.eye(2)
    done = _follow(load, force, omega, tau, lower, upper, R, states, contact, hits, rests, stretch, jacobian)
    return ShakenMassHistory(states, contact, hits, rests, stretch, jacobian, done < N)


@njit(cache=True)
def _moved(load: float, force: float, omega: float, phase: float, v: float, s: float) -> tuple[float, float]:
    """Changes of y and y' in a flight of s from a phase and a velocity."""
    x = omega * s
    rise = 2.0 * math.sin(0.5 * x) ** 2  # 1 - cos x
    if abs(x) < 0.5:
        lag = x * x * x / 6.0
        term, k = lag, 3
        while abs(term) > 1e-18 * abs(lag):
            term *= -x * x / ((k + 1) * (k + 2))
            lag += term
            k += 2
    else:
        lag = x - math.sin(x)
    sine, cosine = math.sin(phase), math.cos(phase)
    dy = v * s + 0.5 * load * s * s + force / (omega * omega) * (sine * rise + cosine * lag)
    dv = load * s + force / omega * (cosine * rise + sine * math.sin(x))
    return dy, dv


@njit(cache=True)
def _turns(load: float, force: float, phase: float, reach: float, turns: Array) -> int:
    """Write the lengths in phase, below ``reach``, to the sign changes of the acceleration; returns their number."""
    count = 0
    if abs(load) < abs(force):
        angle = math.asin(-load / force)
        for zero in (angle, math.pi - angle):
            ahead = (zero - phase) % (2.0 * math.pi)
            while ahead < reach and count < len(turns):
                if ahead > AT_ONCE:
                    turns[count] = ahead
                    count += 1
                ahead += 2.0 * math.pi
    turns[:count].sort()
    return count


@njit(cache=True)
def _first_hit(
    load: float, force: float, omega: float, phase: float, y: float, v: float, own: int,
    lower: float, upper: float, H: float,
) -> tuple[float, int]:  # fmt: skip
    """(time, side) of the first crossing of a stop within H, side 0 if there is none; y is on the stop ``own``."""
    turns = np.empty(6)
    count = _turns(load, force, phase, omega * H, turns)
    begin = 0.0
    for k in range(count + 1):
        end = H if k == count else turns[k] / omega
        v0, v1 = v + _moved(load, force, omega, phase, v, begin)[1], v + _moved(load, force, omega, phase, v, end)[1]
        still = end
        if v0 * v1 < 0.0:
            low, high = begin, end
            while True:
                still = 0.5 * (low + high)
                if still <= low or still >= high:
                    break
                if (v + _moved(load, force, omega, phase, v, still)[1]) * v0 > 0.0:
                    low = still
                else:
                    high = still
        a, b = begin, still
        for _ in range(2):
            if b > a:
                dy = _moved(load, force, omega, phase, v, b)[0]
                for side in (LOWER, UPPER):
                    stop = lower if side == LOWER else upper
                    distance = 0.0 if side == own else side * (y - stop)  # from the stop to the start: <= 0
                    from_here = _moved(load, force, omega, phase, v, a)[0]
                    if distance + side * dy > 0.0 and distance + side * from_here <= 0.0:
                        low, high = a, b
                        while True:
                            middle = 0.5 * (low + high)
                            if middle <= low or middle >= high:
                                return high, side
                            if distance + side * _moved(load, force, omega, phase, v, middle)[0] > 0.0:
                                high = middle
                            else:
                                low = middle
            a, b = still, end
        begin = end
    return H, 0


@njit(cache=True)
def _let_go(load: float, force: float, phase: float, side: int) -> float:
    """Length in phase until the acceleration stops pressing the mass on this stop; infinite if it never does."""
    if abs(load) >= abs(force):
        return math.inf
    angle = math.asin(-load / force)
    shortest = math.inf
    for zero in (angle, math.pi - angle):
        if side * force * math.cos(zero) < 0.0:  # falling through zero
            shortest = min(shortest, (zero - phase) % (2.0 * math.pi))
    return shortest


@njit(cache=True)
def _follow(
    load: float, force: float, omega: float, tau: float, lower: float, upper: float, R: float,
    states: Array, contact: Counts, hits: Counts, rests: Counts, stretch: Array, jacobian: Array,
) -> int:  # fmt: skip
    """Write the rows of a Run; returns the periods completed."""
    T = 2.0 * math.pi / omega
    y, v, held = states[0, 0], states[0, 1], contact[0]
    vector = np.array([0.6, 0.8])
    own = FREE
    if y == lower:
        own = LOWER
    elif y == upper:
        own = UPPER
    for n in range(len(hits)):
        t, count = 0.0, 0
        while t < T:
            phase = tau + omega * t
            if held != FREE:
                rests[n] += 1
                stretch[n] = -math.inf
                jacobian[:] = 0.0
                left = _let_go(load, force, phase, held) / omega
                if left >= T - t:
                    break
                t, own, held = t + left, held, FREE
                vector[0], vector[1] = 0.6, 0.8
                continue
            s, side = _first_hit(load, force, omega, phase, y, v, own, lower, upper, T - t)
            dy, dv = _moved(load, force, omega, phase, v, s)
            t, y, v, own = t + s, y + dy, v + dv, FREE
            vector[0] += s * vector[1]
            for i in range(2):
                jacobian[0, i] += s * jacobian[1, i]
            if side == 0:
                break
            count += 1
            if count > MOST_IMPACTS:
                return n
            y, own = (lower if side == LOWER else upper), side
            hits[n, 0 if side == LOWER else 1] += 1
            a = load + force * math.sin(tau + omega * t)
            # A neighbour at distance dy hits dt = -dy / v later; it moves with (v, a) before and (-R v, a) after.
            ratio = (1.0 + R) * a / v
            dy0, dv0 = vector[0], vector[1]
            vector[0], vector[1] = -R * dy0, ratio * dy0 - R * dv0
            for i in range(2):
                dy0, dv0 = jacobian[0, i], jacobian[1, i]
                jacobian[0, i], jacobian[1, i] = -R * dy0, ratio * dy0 - R * dv0
            v = -R * v
            pressing = side * a
            if pressing > 0.0 and R < 1.0 and omega * 2.0 * abs(v) <= COMPLETE * pressing * (1.0 - R):
                v, held = 0.0, side
            size = math.sqrt(vector[0] ** 2 + vector[1] ** 2)
            if size == 0.0:
                vector[0], vector[1] = 0.6, 0.8
                stretch[n] = -math.inf
            else:
                stretch[n] += math.log(size)
                vector /= size
        states[n + 1, 0], states[n + 1, 1], contact[n + 1] = y, v, held
        size = math.sqrt(vector[0] ** 2 + vector[1] ** 2)
        stretch[n] += math.log(size)
        vector /= size
    return len(hits)
