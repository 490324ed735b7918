"""How far the gap coordinate goes: its least and greatest value along a motion, from every turning point.

y' is a signal like y, so that the certified search for the next crossing finds its zeros: no turning point is missed.
"""

import numpy as np

from workers.kernel.borrow import borrowed
from workers.kernel.flight import ON_STOP_AT_REST, ON_STOP_MOVING, ON_STOP_RELEASED, next_crossing
from workers.kernel.flow import flow
from workers.kernel.impact import LEAVE, REST, kick, outcome, shift, stay_on_stop, stop_position
from workers.kernel.jit import inline_always, kernel
from workers.kernel.motion import AT_REST, FREE, oscillator_of
from workers.kernel.signal import evaluate
from workers.kernel.stroboscopic import AT_THE_END, arrival_of
from workers.model.oscillator import COLUMN, Signal


@inline_always
def velocity_of(gap):
    """The signal y', and what a constant load adds to it.

    Its rows are row1, row2 and row2 A, and a load adds row[1] load. Y' has the sine parts -k omega cos_part and the
    cosine parts k omega sin_part.
    """
    row2, row3 = gap.row2, np.empty(gap.row2.shape)
    offset = 0.0
    for j in range(len(gap.lam)):
        row3[j, 0] = -gap.lam[j] * row2[j, 1]
        row3[j, 1] = row2[j, 0] - 2.0 * gap.eta[j] * row2[j, 1]
        offset += gap.row[j, 1] * gap.block[j, COLUMN.load]
    harmonics = len(gap.sin_part)
    sin_part, cos_part, swing = np.empty(harmonics), np.empty(harmonics), np.zeros(3)
    amplitude = 0.0
    for k in range(harmonics):
        w = (k + 1.0) * gap.omega
        sin_part[k], cos_part[k] = -w * gap.cos_part[k], w * gap.sin_part[k]
        size = np.hypot(sin_part[k], cos_part[k])
        amplitude += size
        for power in range(3):
            swing[power] += size * w ** (power + 2.0)
    return Signal(
        gap.eta, gap.lam, gap.metric, gap.block, gap.row1, row2, row3, sin_part, cos_part, amplitude, swing, gap.omega
    ), offset  # fmt: skip


@inline_always
def turning_points(gap, velocity, offset, h, phase, duration, own, kind, low, high, scratch):
    """(low, high) widened by y - y0 at every turning point of a flight of this duration from block state h (n, 2).

    own and kind: as in next_crossing, how the flight starts on a stop. Returns also the evaluations; high is NaN where
    the search gave up. h is moved on; scratch (n, 2) is overwritten.
    """
    _, v, a, _, _ = evaluate(gap, h, 0.0, phase, 0.0)
    # The zero of y' is a stop of that signal: the upper one where y falls, the lower one where it rises.
    falls = own > 0 or (own == 0 and (v < 0.0 or (v == 0.0 and a < 0.0)))
    zero = np.int64(0)
    if kind != ON_STOP_MOVING and own != 0:
        zero = own
    zero_kind = ON_STOP_AT_REST if kind == ON_STOP_RELEASED else ON_STOP_MOVING
    t, spent = 0.0, 0
    while True:
        upper, lower = (0.0, -np.inf) if falls else (np.inf, 0.0)
        s, side, evaluations = next_crossing(
            velocity, h, phase, offset, upper, lower, zero, zero_kind, duration - t, scratch
        )
        spent += max(1, evaluations)
        flow(gap.block, s, h)
        phase += gap.omega * s
        t += s
        if side == 0:
            return low, high, spent
        if side == 2:
            return low, np.nan, spent
        y = evaluate(gap, h, 0.0, phase, 0.0)[0]
        low, high = min(low, y), max(high, y)
        falls = not falls
        zero, zero_kind = np.int64(side), ON_STOP_MOVING


@inline_always
def excursion(osc, start, contact, periods, allowance):
    """The least and the greatest y - y0 of a motion from block state ``start`` (n, 2) over so many periods.

    At sections y is what it is, at impacts and at rest the stop's position; in flight it is least and greatest where it
    turns. Turning points are looked for in flights that leave the range known so far: as certainly as they would meet
    two stops there, all others stay inside. NaN where the motion cannot be followed, or not with ``allowance``
    evaluations.
    """
    n = start.shape[0]
    gap, h, along, scratch = osc.gap, start.copy(), np.empty((n, 2)), np.empty((n, 2))
    V, growth, triangle = np.zeros((0, n, 2)), np.zeros(0), np.zeros((0, 0))
    velocity, offset = velocity_of(gap)
    low, high, spent = np.inf, -np.inf, 0
    for _ in range(periods):
        t, phase = 0.0, osc.tau
        y = min(max(evaluate(gap, h, 0.0, phase, 0.0)[0], -osc.b_lower), osc.b_upper)
        if contact != FREE:
            y = stop_position(osc, contact)
        low, high = min(low, y), max(high, y)
        own, kind = np.int64(0), ON_STOP_MOVING
        if abs(contact) == AT_REST:
            own, kind, contact = np.int64(np.sign(contact)), ON_STOP_AT_REST, np.int64(FREE)
        while True:
            if contact != FREE:
                s, released, evaluations = stay_on_stop(osc, h, V, growth, triangle, phase, contact, osc.period - t)
                spent += max(1, evaluations)
                if released == 0:
                    break
                if released == 2:
                    return np.nan, np.nan
                t += s
                phase += gap.omega * s
                own, kind = contact, ON_STOP_RELEASED
                if osc.period - t <= AT_THE_END * osc.period:  # as propagate does
                    contact = np.int64(contact * AT_REST)
                    break
            s, side, evaluations = next_crossing(gap, h, phase, 0.0, high, low, own, kind, osc.period - t, scratch)
            spent += max(1, evaluations)
            leaves = (side == 1 and high < osc.b_upper) or (side == -1 and low > -osc.b_lower)
            if leaves:
                s, side, evaluations = next_crossing(
                    gap, h, phase, 0.0, osc.b_upper, -osc.b_lower, own, kind, osc.period - t, scratch
                )
                for j in range(n):
                    along[j, 0], along[j, 1] = h[j, 0], h[j, 1]
                low, high, more = turning_points(gap, velocity, offset, along, phase, s, own, kind, low, high, scratch)
                spent += max(1, evaluations) + more
            if side == 2 or np.isnan(high) or spent > allowance:
                return np.nan, np.nan
            contact = np.int64(FREE)
            if side == 0:
                flow(gap.block, s, h)
                break
            y, v, a, scale = arrival_of(gap, h, s, phase, side)
            flow(gap.block, s, h)
            t += s
            phase += gap.omega * s
            stop = stop_position(osc, side)
            low, high = min(low, stop), max(high, stop)
            following = outcome(osc, h, side, v, a, scale + abs(y), osc.period - t)
            if following == REST:
                kick(osc, h, -v)
                contact = np.int64(side)
            else:
                kick(osc, h, -(1.0 + osc.R) * v)
                shift(osc, h, stop - y)
            own, kind = np.int64(side), ON_STOP_AT_REST if following == LEAVE else ON_STOP_MOVING
    return low, high


@kernel
def excursions(oscillators, h, contact, periods, allowance, cells):
    """excursion (N, 2) of motions at block states h (N, n, 2) with contacts (N, 1), of these cells, over so
    many periods (N,) and for so many evaluations (N,) at most; NaN of the others."""
    found = np.full((len(periods), 2), np.nan)
    for r in cells:
        low, high = excursion(borrowed(oscillator_of(oscillators, r)), h[r], contact[r, 0], periods[r], allowance[r])
        found[r, 0], found[r, 1] = low, high
    return found
