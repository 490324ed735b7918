"""Piecewise linear fits: the fewest segments within an error bound of a smooth law.

The error may be eps to both sides. For a law f of one curvature the longest segment begins on one side of that band,
touches the other side, and ends on the first. Such segments are chords of a sag of 2 eps, moved by eps, so that

    n = integral of sqrt|f''| / (4 sqrt(eps)),

half of the number with vertices on the law, to leading order. The first vertex is on the law, so nothing jumps there.
Source: Imai & Iri, J. Inf. Process. 9 (1986) 159, with a window of slopes in place of a visible window.
"""

from collections.abc import Callable

import numpy as np

from workers.model.oscillator import Array

POINTS = 2**15
"""Number of intervals of the range; within an interval the law counts as straight."""

SPARE = 1e-3
"""Share of the error bound reserved for the curvature of the law within an interval."""

FIRST_LOOK = 64
"""Number of points ahead among which the end of a segment is searched for first. The number grows fourfold until the
end is found.
"""


def fewest(
    law: Callable[[Array], Array], end: float, bound: float, minimum: float = -np.inf, reach: float = 0.0
) -> Array:
    """Return vertices (V, 2) from 0 to ``end`` of the law with the fewest segments within ``bound`` of the given law.

    law      function of arguments
    end      end of the range, of either sign
    bound    largest error
    minimum  lower bound of the slopes, with the sign of ``end``
    reach    length of the range that the samples divide; |end| if that is larger

    The law is sampled at every POINTS-th part of ``reach``, so that both sides of an odd law agree where both exist.
    The vertices are not finite if the law is not.
    """
    run: Array = max(abs(end), reach) / POINTS * np.arange(POINTS, dtype=np.float64)
    run = np.append(run[run < abs(end)], abs(end))
    f = law(np.copysign(run, end))
    if not (np.all(np.isfinite(f)) and bound > 0.0 and end != 0.0):
        return np.full((2, 2), np.nan)
    i, at, y = 0, 0.0, float(f[0])
    vertices = [(at, y)]
    while i < len(run) - 1:
        j, at, y = _segment(run, f, (1.0 - SPARE) * bound, i, at, y, minimum)
        vertices.append((float(np.copysign(at, end)), y))
        i = j
    return np.array(vertices)


def _segment(
    run: Array, f: Array, bound: float, i: int, at: float, y: float, minimum: float
) -> tuple[int, float, float]:
    """Return index, argument and value of the end of the longest segment that begins at (at, y).

    run      (K,) arguments of the samples
    f        (K,) values of the law there
    bound    largest error of the segment
    i        index of the last sample at or before ``at``
    minimum  lower bound of the slope

    The index is that of the last sample at or before the end.
    """
    look = FIRST_LOOK
    while True:
        ahead = slice(i + 1, min(i + 1 + look, len(run)))
        steps = run[ahead] - at
        low = np.maximum.accumulate(np.maximum((f[ahead] - bound - y) / steps, minimum))
        high = np.minimum.accumulate((f[ahead] + bound - y) / steps)
        over = low > high
        k = int(np.argmax(over))
        if over[k]:
            break
        if ahead.stop == len(run):
            slope = float(np.clip((f[-1] - y) / steps[-1], low[-1], high[-1]))
            return len(run) - 1, float(run[-1]), y + slope * float(steps[-1])
        look *= 4
    if k == 0:  # the law jumps further than the band is wide
        return i + 1, float(run[i + 1]), float(f[i + 1])
    fell = low[k] > low[k - 1]  # the line along the upper side leaves the band through the lower side
    slope, side = (float(high[k - 1]), -bound) if fell else (float(low[k - 1]), bound)
    inner, outer = (f[i + k + of] + side - (y + slope * (run[i + k + of] - at)) for of in (0, 1))
    share = float(np.clip(inner / (inner - outer), 0.0, 1.0))
    reached = float(run[i + k] + share * (run[i + k + 1] - run[i + k]))
    return i + k + int(reached >= run[i + k + 1]), reached, y + slope * (reached - at)
