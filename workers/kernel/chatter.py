"""Chatter: ever lower hops of a mass off a stop under a load, and the time at which their sequence ends.

Each hop is computed to rounding of its own height. The gap coordinate y is a sum of terms of the machine's size, whose
rounding hides low hops. The speed at which a hop begins is known, and so are the second and higher derivatives of y.
The hop is their Taylor series.
"""

import numpy as np

from workers.kernel.jit import inlined, kernel
from workers.kernel.signal import forced, loaded_output
from workers.model.oscillator import COLUMN

ORDER = 17
"""Order of the Taylor series of a hop."""

SHORT = 1.0
"""Maximum phase, in radians of the fastest oscillation, for which the series is exact to rounding: SHORT^17 / 18!."""

NEWTON_STEPS, HOP_DIFFERENCE = 4, 1e-2
"""Number of Newton steps for the end of a hop, and tolerated difference to the end that the search found, as a share of
the hop. The search sees only y."""

AGREES = 0.1
"""Maximum difference of two estimates of a chatter's end, as a share of the time left, for the better one to count."""

UNKNOWN = (np.nan, np.nan, np.nan)
"""Estimates of a chatter's end before the first one."""


@inlined
def chatter_time(load, w, R):
    """Return the duration of chatter, hops of a mass on a stop until it rests, to leading order.

    load  acceleration toward the stop
    w, R  speed after the first rebound, coefficient of restitution
    """
    return 2.0 * w / (load * (1.0 - R)) if w > 0.0 else 0.0


@inlined
def chatter_left(load, jerk, cA2k, w, R):
    """Return the duration of chatter, hops of a mass on a stop until it rests, to second order.

    load   acceleration toward the stop
    jerk   third derivative of the gap coordinate toward the stop
    cA2k   velocity decays at the rate -cA^2k
    w, R   speed after the rebound, coefficient of restitution

    The result is t (1 - t (jerk / load - 3 cA^2k / 2) / 3), with t the time to leading order, see ``chatter_time``. At
    zero velocity the load rises at the rate jerk - cA^2k load. The result is limited to [t/2, 2t] for R near 1, where
    chatter is the slowest process.
    """
    t = chatter_time(load, w, R)
    return t * min(max(1.0 - t * (jerk / load - 1.5 * cA2k) * (1.0 / 3.0), 0.5), 2.0)


@inlined
def with_estimate(ends, end):
    """Return the last three estimates of the time at which a chatter ends: the newer two of ``ends``, and ``end``."""
    return ends[1], ends[2], end


@inlined
def chatter_end(ends, remaining, R):
    """Return the time at which a chatter ends, to fourth order.

    ends       estimates at its last three impacts, each from ``chatter_left``; NaN if there are fewer
    remaining  time until the newest estimate
    R          coefficient of restitution

    The error of an estimate is a w^3 + b w^4 + ..., with w the speed of the rebound. At the next impact these terms are
    multiplied by R^3 and R^4. Richardson's extrapolation removes both terms, or the first if there are only two
    estimates.
    """
    cube, fourth = R**3 / (1.0 - R**3), R**4 / (1.0 - R**4)
    before, after = ends[1] + cube * (ends[1] - ends[0]), ends[2] + cube * (ends[2] - ends[1])
    best = after + fourth * (after - before)
    best = best if abs(best - ends[2]) <= AGREES * remaining else after  # false for NaN
    return best if abs(best - ends[2]) <= AGREES * remaining else ends[2]


@inlined
def fastest_rate(blocks, waves, omega):
    """Return the largest rate, in radians or e-folds per time, at which a flight oscillates, decays or grows.

    blocks  constants of the decoupled equations, see Block
    waves   (H, 2) harmonics of the force of frequency ``omega``
    """
    rate = omega * len(waves)
    for j in range(len(blocks)):
        rate = max(rate, blocks[j, COLUMN.fast], -blocks[j, COLUMN.slow], np.sqrt(abs(blocks[j, COLUMN.lam])))
    return rate


@kernel
def hop(blocks, waves, omega, h, phase, side, w, s, rate):
    """Return (time, speed) of the impact that ends a hop off stop ``side``.

    blocks, waves, omega  free flight with the gap coordinate y as its signal, see GuardedFlow
    h     (n, 2)          block state at the start, (h, h') of each decoupled equation
    phase                 forcing phase at the start
    w                     speed of the rebound, > 0
    s                     time of the impact that the certified search has found
    rate                  see ``fastest_rate``

    The distance from the stop is t p(t) with p = w + sum_k u_k t^(k-1) / k!; at its zero the speed is -t p'(t). Return
    (s, 0) if the hop is longer than SHORT or the series fails.
    """
    if not s * rate <= SHORT:
        return s, 0.0
    u = np.zeros(ORDER + 2)  # indexed by the order of the derivative
    for k in range(len(waves)):
        square = ((k + 1.0) * omega) ** 2
        _, _, even, odd = forced((k + 1.0) * phase, (k + 1.0) * omega, waves[k, 0], waves[k, 1])
        for order in range(2, ORDER + 1, 2):
            u[order] += even
            u[order + 1] += odd
            even, odd = -square * even, -square * odd
    for j in range(len(blocks)):
        block = blocks[j]
        eta, lam = block[COLUMN.eta], block[COLUMN.lam]
        _, _, this, following = loaded_output(
            h[j, 0], h[j, 1], eta, lam,
            block[COLUMN.c0], block[COLUMN.c1], block[COLUMN.cA0], block[COLUMN.cA1], block[COLUMN.load],
        )  # fmt: skip
        for order in range(2, ORDER + 1):
            u[order] += this
            this, following = following, -2.0 * eta * following - lam * this
    share = 1.0
    for order in range(2, ORDER + 1):
        share /= order
        u[order] *= -side * share
    t = s
    for _ in range(NEWTON_STEPS):
        height, slope = series(u, w, t)
        t -= height / slope
    _, slope = series(u, w, t)
    if abs(t - s) <= HOP_DIFFERENCE * s and slope < 0.0:
        return t, -t * slope
    return s, 0.0


@inlined
def series(u, w, t):
    """Return the polynomial p(t) = w + sum_k u_k t^(k-1) over k = 2...ORDER, and its derivative p'(t).

    In a hop that begins at speed w the distance of the mass from the stop is t p(t), see ``hop``.
    """
    p, slope = 0.0, 0.0
    for order in range(ORDER, 1, -1):
        slope = slope * t + p
        p = p * t + u[order]
    return w + t * p, slope * t + p
