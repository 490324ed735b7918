"""The stroboscopic map: ``advance`` takes one cell through one forcing period.

The loop over legs, the parts of a motion between two events, is the only hot kernel. On each leg it solves the linear
equations of one mode, finds the first event, and applies the jump there. A section is the instant of one fixed phase of
the force in each period. Between sections the phase runs from tau to tau + 2 pi; absolute time never enters.
"""

import numpy as np
from numba import types

from workers.kernel.by_reference import without_mode_table
from workers.kernel.chatter import UNKNOWN, chatter_end, chatter_left, fastest_rate, hop, with_estimate
from workers.kernel.contact import (
    LEAVE,
    REST,
    is_rebound,
    kick,
    load_at_rest,
    outcome,
    rest_projection,
    saltation,
    shift,
    stop_position,
)
from workers.kernel.crossing import TINY, next_crossing
from workers.kernel.excursion import turning_points
from workers.kernel.external import external
from workers.kernel.flow import flow_with_tangent
from workers.kernel.hybrid.motion import through_events
from workers.kernel.jit import inline_always, inlined, kernel
from workers.kernel.motion import (
    BEYOND,
    FLIGHT,
    LOSS,
    LOST,
    MARCH_GAVE_UP,
    MAX_SPEED,
    MIN_SPEED,
    MOTION,
    OVERDRAFT,
    RIGID,
    RUNNING,
    SPREAD,
    STARTED_BEYOND,
    STATUS,
    STUCK,
    WORK,
    count_contact,
    has_modes,
    spend,
    write_down_rest,
)
from workers.kernel.signal import evaluate
from workers.kernel.sticking import stay_on_stop
from workers.kernel.tangent import (
    MAX_SPREAD,
    fly_far,
    impact_spread,
    loss_spread,
    needs_reset,
    reset_frame,
    spread_rate,
)
from workers.model.hybrid_modes import DETACHED, OPEN
from workers.model.oscillator import HEAD, NUMBER

AT_THE_END = 1e-9
"""Time left after a release from a stop, as a share of the motion's duration. Up to this share the motion ends on the
stop: its displacement is of third order in that time, far below rounding."""

NOWHERE = (0.0, 0.0, 0.0, 0.0, 0.0)
"""Values in place of an arrival, for a flight that ends at no stop."""


@inline_always
def come_to_rest(blocks, cA2k, motion, v):
    """Let the mass come to rest on a stop at the end of a chatter, a sequence of ever lower hops.

    blocks, cA2k  constants of the flight's decoupled equations, see Block, and of the impact, see OscillatorScalars
    motion        changed in place
    v             velocity before the last impact that is resolved

    The impact is counted, its velocity is removed, and the tangent vectors are projected, see ``rest_projection``.
    """
    tally = motion.tally
    tally[MAX_SPEED] = max(tally[MAX_SPEED], abs(v))
    tally[LOSS] += v * v
    kick(blocks, motion.h, -v)
    rest_projection(blocks, cA2k, motion.V)


@inline_always
def leave_stop(oscillator, motion, phase, side, remaining, chatter):
    """Advance a motion whose mass rests on a stop, in place, until the mass is released, at most for ``remaining``.

    phase    forcing phase at the start
    side     side of the stop, +-1
    chatter  first part of the time, which the mass still spends hopping

    Return the time spent, and True if the mass was released and the motion continues.
    """
    h, V, tally = motion.h, motion.V, motion.tally
    s, released, evaluations = stay_on_stop(oscillator, h, V, motion.growth, motion.triangle, phase, side, remaining)
    tally[STUCK] += max(s - chatter, min(s, TINY))  # sticking counts, however short
    spend(tally, evaluations)
    tally[LOST] = 2.0
    tally[MIN_SPEED] = 0.0
    reset_frame(oscillator.gap.blocks, motion)
    if released == 0:
        motion.mode[0] = FLIGHT + side
    if released == 2:
        tally[STATUS] = MARCH_GAVE_UP
    return s, tally[STATUS] == RUNNING and released == 1


@inlined
def widen(extremes, y):
    """Widen the least and the greatest position (2,) of the gap coordinate to include y."""
    extremes[0], extremes[1] = min(extremes[0], y), max(extremes[1], y)


@inline_always
def watch_flight(gap, motion, phase, s, start, top, bottom):
    """Widen the extremes of the gap coordinate y, in place, to include the turning points of a free flight.

    gap          free flight with y as its signal
    motion       state at the start of the flight; ``extremes`` and counts change
    phase, s     forcing phase at the start, and duration
    start        as in ``next_crossing``
    top, bottom  the stops

    Only turning points beyond the range known so far are sought, with the ends of that range as stops.
    """
    extremes, tally = motion.extremes, motion.tally
    low, high = extremes[0], extremes[1]
    if low <= bottom and high >= top:
        return
    upper, lower = high if high < top else np.inf, low if low > bottom else -np.inf  # no flight passes a stop
    _, side, evaluations = next_crossing(gap, motion.h, phase, 0.0, upper, lower, start, s, motion.scratch)
    if abs(side) == 1:
        allowance = tally[WORK] + OVERDRAFT
        extremes[0], extremes[1], more = turning_points(gap, motion.h, phase, s, start, low, high, allowance)
        evaluations += more
    if side == 2 or extremes[1] != extremes[1]:
        tally[STATUS] = MARCH_GAVE_UP
    spend(tally, evaluations)


@external(RIGID, MOTION, types.float64)
def through_impacts(oscillator, motion, duration):
    """Advance a motion of a machine with one rigid contact by ``duration``, in place, through its impacts.

    The loop finds the next impact, advances the state to it, and applies the jump of the velocity. See ``propagate``.
    """
    gap, h, V, tally, scratch, impacts = (
        oscillator.gap,
        motion.h,
        motion.V,
        motion.tally,
        motion.scratch,
        motion.impacts,
    )
    blocks, waves, omega = gap.blocks, gap.waves, gap.numbers[NUMBER.omega]
    R, cA2k, top, bottom = (
        oscillator.head[HEAD.R],
        oscillator.head[HEAD.cA2k],
        oscillator.head[HEAD.top],
        oscillator.head[HEAD.bottom],
    )
    if motion.mode[0] == BEYOND:
        tally[STATUS] = STARTED_BEYOND
        return
    state = motion.mode[0] - FLIGHT
    motion.mode[0] = FLIGHT
    vectors, frame, watched = V.shape[0] > 0, motion.growth.shape[0] > 0, motion.extremes.shape[0] > 0
    rate = spread_rate(blocks) if vectors else 0.0
    unit, loss = oscillator.head[HEAD.time_unit], loss_spread(R)
    start, chatter, ends, period = 0, 0.0, UNKNOWN, oscillator.head[HEAD.period]
    w, fastest = 0.0, fastest_rate(blocks, waves, omega)
    t, phase = 0.0, oscillator.tau
    if watched:
        y = evaluate(blocks, waves, omega, h, 0.0, phase, 0.0)[0]
        widen(motion.extremes, min(max(y, bottom), top) if state == OPEN else stop_position(oscillator, state))
    if abs(state) == DETACHED:
        start, state = state, OPEN
    while True:
        if state != OPEN:
            s, released = leave_stop(oscillator, motion, phase, state, duration - t, chatter)
            if not released:
                return
            t += s
            phase += omega * s
            start = 3 * state
            if duration - t <= AT_THE_END * duration:
                motion.mode[0] = FLIGHT + state * DETACHED
                return
        s, side, evaluations = next_crossing(gap, h, phase, 0.0, top, bottom, start, duration - t, scratch)
        spend(tally, evaluations)
        hit, speed = abs(side) == 1, 0.0
        y, v, a, jerk, scale = NOWHERE
        if w > 0.0 and side == start:
            s, speed = hop(blocks, waves, omega, h, phase, side, w, s, fastest)
            s = min(s, duration - t)
        if hit:
            y, v, a, jerk, scale = evaluate(blocks, waves, omega, h, s, phase, 0.0)
            v = side * max(side * v, TINY)  # the mass approaches; a new evaluation may differ in the last digit
        if watched:
            watch_flight(gap, motion, phase, s, start, top, bottom)
        spread = impact_spread(a / v, unit, loss) if vectors and hit else 0.0
        flown = s * rate
        if needs_reset(tally[SPREAD], flown + spread, MAX_SPREAD):
            reset_frame(blocks, motion)
        if frame and tally[SPREAD] + flown > MAX_SPREAD:
            fly_far(oscillator, motion, s)
        else:
            flow_with_tangent(blocks, s, h, V)
            tally[SPREAD] += flown
        if side == 0:
            return
        if side == 2:
            tally[STATUS] = MARCH_GAVE_UP
        if tally[STATUS] != RUNNING:
            return
        t += s
        phase += omega * s
        stop = top if side > 0 else bottom
        if watched:
            widen(motion.extremes, stop)
        scale += abs(y)
        if speed > 0.0:
            kick(blocks, h, side * speed - v)  # rounding hides the end speed of a low hop
            v = side * speed
        load = load_at_rest(side, v, a, cA2k)
        following = outcome(load, v, R, scale, period)
        remaining, w = 0.0, 0.0
        if load > 0.0 and 0.0 < R < 1.0:
            remaining = chatter_left(load, side * jerk, cA2k, R * abs(v), R)
            ends = with_estimate(ends if side == start else UNKNOWN, t + remaining)
            w = 0.0 if is_rebound(load, v, R, cA2k, scale, duration - t, period) else R * abs(v)
        start, state = side, OPEN
        if following == REST:
            chatter = chatter_end(ends, remaining, R) - t if R > 0.0 else 0.0
            come_to_rest(blocks, cA2k, motion, v)
            write_down_rest(tally, impacts, t, side, abs(v), chatter)
            state = side
            continue
        count_contact(tally, impacts, t, side, abs(v))
        tally[LOSS] += (1.0 - R * R) * (v * v)
        kick(blocks, h, -(1.0 + R) * v)
        shift(blocks, h, stop - y)  # else rounding would add up over many impacts
        saltation(blocks, R, V, a / v)
        tally[SPREAD] += spread
        if following == LEAVE:
            start = 2 * side
            tally[LOST] = max(tally[LOST], 1.0)
            reset_frame(blocks, motion)


@inline_always
def propagate(oscillator, motion, duration):
    """Advance a motion from a section by ``duration`` <= one period, in place, through all its impacts.

    A section is an instant of fixed phase of the force. The motion stops early, with tally[STATUS] set, if it cannot be
    completed. A motion beyond a stop ends at once.
    """
    if has_modes(oscillator):
        through_events(oscillator, motion, duration)
    else:
        through_impacts(without_mode_table(oscillator), motion, duration)


@inline_always
def advance(oscillator, motion):
    """Apply the stroboscopic map P to a motion, in place: one forcing period. Its tangent vectors V become DP V."""
    propagate(oscillator, motion, oscillator.head[HEAD.period])


@inline_always
def step(oscillator, motion, half):
    """Apply the map P over one forcing period to a motion, in place, or with ``half`` the half-period map G.

    G(z) = -P_{T/2}(z) is a map of machines with a symmetric gap, and G o G = P.
    """
    period = oscillator.head[HEAD.period]
    propagate(oscillator, motion, 0.5 * period if half else period)
    if half:
        mirror(motion)


@kernel
def mirror(motion):
    """Mirror a motion, in place: its state z becomes -z, and upper and lower stop are exchanged.

    The tangent vectors change sign as well.
    """
    motion.mode[0] = 2 * FLIGHT - motion.mode[0]
    for j in range(motion.h.shape[0]):
        for k in range(2):
            motion.h[j, k] = -motion.h[j, k]
            for i in range(motion.V.shape[0]):
                motion.V[i, j, k] = -motion.V[i, j, k]
