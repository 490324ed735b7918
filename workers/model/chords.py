"""The fewest segments of a piecewise linear law within a bound of a smooth one.

A law f may be off by eps to both sides. Of a law that bends one way the longest segment begins at one side of that
band, touches the other one and ends where it began: chords of a sag of 2 eps, moved by eps, so that

    n = integral of sqrt|f''| / (4 sqrt(eps)),

half as many as with vertices on the law, to leading order. The first vertex is on the law: nothing jumps there.
Source: Imai & Iri, J. Inf. Process. 9 (1986) 159, with the slopes that are left open in place of a visible window.
"""

from collections.abc import Callable

import numpy as np

from workers.model.oscillator import Array

POINTS = 2**15
"""Intervals of the range between which the law is taken for straight."""

SPARE = 1e-3
"""Share of the bound that is left for that."""

FIRST_LOOK = 64
"""Points ahead among which the end of a segment is sought first; four times as many each time that it is not there."""


def fewest(
    law: Callable[[Array], Array], end: float, bound: float, least: float = -np.inf, reach: float = 0.0
) -> Array:
    """Vertices (V, 2) from 0 to ``end``, of either sign, of the law that is within ``bound`` there.

    No slope, with the sign of ``end``, is below ``least``. The law is looked at every POINTS-th part of ``reach``, of
    |end| where that is larger: the sides of an odd law are alike as far as both go. Not finite where the law is not.
    """
    run: Array = max(abs(end), reach) / POINTS * np.arange(POINTS, dtype=np.float64)
    run = np.append(run[run < abs(end)], abs(end))
    f = law(np.copysign(run, end))
    if not (np.all(np.isfinite(f)) and bound > 0.0 and end != 0.0):
        return np.full((2, 2), np.nan)
    i, at, y = 0, 0.0, float(f[0])
    found = [(at, y)]
    while i < len(run) - 1:
        j, at, y = _segment(run, f, (1.0 - SPARE) * bound, i, at, y, least)
        found.append((float(np.copysign(at, end)), y))
        i = j
    return np.array(found)


def _segment(run: Array, f: Array, bound: float, i: int, at: float, y: float, least: float) -> tuple[int, float, float]:
    """The end of the longest segment from (at, y), at point i or next after it: the last point up to it, and itself."""
    look = FIRST_LOOK
    while True:
        ahead = slice(i + 1, min(i + 1 + look, len(run)))
        steps = run[ahead] - at
        low = np.maximum.accumulate(np.maximum((f[ahead] - bound - y) / steps, least))
        high = np.minimum.accumulate((f[ahead] + bound - y) / steps)
        over = low > high
        k = int(np.argmax(over))
        if over[k]:
            break
        if ahead.stop == len(run):
            slope = float(np.clip((f[-1] - y) / steps[-1], low[-1], high[-1]))
            return len(run) - 1, float(run[-1]), y + slope * float(steps[-1])
        look *= 4
    if k == 0:  # a law that jumps further than the band is wide
        return i + 1, float(run[i + 1]), float(f[i + 1])
    fell = low[k] > low[k - 1]  # the line along the upper side of the band leaves it through the lower one
    slope, side = (float(high[k - 1]), -bound) if fell else (float(low[k - 1]), bound)
    inner, outer = (f[i + k + of] + side - (y + slope * (run[i + k + of] - at)) for of in (0, 1))
    share = float(np.clip(inner / (inner - outer), 0.0, 1.0))
    reached = float(run[i + k] + share * (run[i + k + 1] - run[i + k]))
    return i + k + int(reached >= run[i + k + 1]), reached, y + slope * (reached - at)
