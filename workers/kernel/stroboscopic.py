"""The stroboscopic map: ``advance`` takes one cell through one forcing period, the only hot kernel.

Between sections the phase runs from tau to tau + 2 pi; absolute time never enters.
"""

import math

import numpy as np
from numpy.typing import NDArray

from workers.kernel.borrow import borrowed
from workers.kernel.coordinates import enter_blocks, leave_blocks, placed
from workers.kernel.excursion import turning_points
from workers.kernel.flight import ON_STOP_AT_REST, ON_STOP_MOVING, ON_STOP_RELEASED, TINY, next_crossing
from workers.kernel.flow import flow, flow_with_tangent
from workers.kernel.frame import graded_flow, orthonormalise
from workers.kernel.impact import (
    LEAVE,
    REBOUND,
    REST,
    chatter_time,
    is_rebound,
    kick,
    load_at_rest,
    load_on_stop,
    outcome,
    rest_projection,
    saltation,
    shift,
    stay_on_stop,
    stop_position,
    to_held,
)
from workers.kernel.jit import inline_always, inlined, kernel, kernel_and_part, kernel_within
from workers.kernel.motion import (
    AT_REST,
    BEYOND,
    EVALUATIONS,
    FREE,
    HELD,
    LOSS,
    LOST,
    LOWER,
    MARCH_GAVE_UP,
    MAX_SPEED,
    MIN_SPEED,
    OUT_OF_WORK,
    RECORDED,
    RUNNING,
    SPEEDS,
    SPREAD,
    STARTED_BEYOND,
    STATUS,
    STUCK,
    UPPER,
    WORK,
    Motion,
    motion_at,
)
from workers.kernel.signal import evaluate
from workers.model.oscillator import COLUMN, HEAD, NUMBER, Oscillator
from workers.results import BEYOND_STOP, InvalidError

OVERDRAFT = 1_000_000
"""Evaluations by which a period may exceed what is left, so that motions can end at a section."""

AT_THE_END = 1e-9
"""Share of its duration before which a motion that is released from a stop ends at rest on it: in so short a time the
cube of it, which the mass would move by, is far below rounding."""

NOWHERE = (0.0, 0.0, 0.0, 0.0)
"""In place of an arrival where a flight ends at no stop."""

MAX_SPREAD = 8.0
"""|log| of how far flights and impacts may stretch or contract the frame before it is made orthonormal again: keeps 12
digits of the most contracted direction. One flight with its impact may go further."""


def motion_from(osc: Oscillator, state: NDArray[np.float64], vectors: int = 0, record: int = 0) -> Motion:
    """A motion that starts at physical section state (x..., v...).

    Its contact is the one that the state shows: on a stop with v = 0 held or about to leave, else free. InvalidError
    beyond a stop.
    """
    h = np.zeros((len(osc.gap_row), 2))
    contact = start_at(osc, np.asarray(state, dtype=np.float64), h)
    if contact == BEYOND:
        raise InvalidError(BEYOND_STOP)
    return motion_at(h, contact, vectors, record)


@kernel
def start_at(osc, state, h):
    """Write the block coordinates h (n, 2), forced response taken off, of a physical section state; its contact."""
    y, v, y_error, v_error = enter_blocks(osc.to_blocks, osc.gap.forced, osc.rest, osc.gap_row, osc.tau, state, h)
    contact = placed(y, v, y_error, v_error, osc.head[HEAD.upper], osc.head[HEAD.lower])
    return contact_at_rest(osc, np.sign(contact), h) if abs(contact) == AT_REST else contact


@kernel_within
def contact_at_rest(osc, side, h):
    """The contact of a state that lies on this stop with v = 0: held where the load presses, else about to leave."""
    u = np.zeros((h.shape[0] - 1, 2))
    to_held(osc, h, osc.tau, side, u)
    return side * HELD if load_on_stop(osc, u, osc.tau, side) > 0.0 else side * AT_REST


@kernel
def blocks_to_physical(osc, motion):
    """Physical section state (2n,) of a motion; on the stop with v = 0 where it rests there, see ``placed``."""
    state = np.empty(2 * motion.h.shape[0])
    leave_blocks(
        osc.to_physical, osc.gap.forced, osc.rest, osc.gap_row, osc.tau, osc.head[HEAD.upper], osc.head[HEAD.lower],
        motion.h, motion.contact[0], state,
    )  # fmt: skip
    return state


@kernel
def spread_rate(blocks):
    """How fast a flight spreads the frame, per time: the largest contraction rate of the blocks.

    The flow of a rigid mode is a shear too, (h, h') -> (h + h' s, h'), which spreads by at most sqrt(metric) per time.
    """
    rate = 0.0
    for j in range(len(blocks)):
        shear = math.sqrt(blocks[j, COLUMN.metric]) if blocks[j, COLUMN.lam] == 0.0 else 0.0
        rate = max(rate, blocks[j, COLUMN.fast] + shear)
    return rate


@inline_always
def fly_far(osc, motion, s):
    """Move the state and the frame on by s in free flight, however far that spreads the frame."""
    blocks = osc.gap.blocks
    rank = 2 * len(blocks) - int(motion.tally[LOST])
    flow(blocks, s, motion.h)
    graded_flow(blocks, s, motion.V, motion.growth, motion.triangle, rank)
    reset_frame(osc, motion)


@inline_always
def reset_frame(osc, motion):
    """Make the frame orthonormal and count its growth."""
    reset_frame_of(osc.gap.metric, motion)


@kernel
def reset_frame_of(metric, motion):
    """reset_frame for blocks of this metric (n,)."""
    V, growth, tally = motion.V, motion.growth, motion.tally
    if growth.shape[0] > 0:
        orthonormalise(metric, V, growth, motion.triangle, 2 * V.shape[1] - int(tally[LOST]))
    tally[SPREAD] = 0.0


@inlined
def needs_reset(spread, more, limit):
    """Whether the frame has to be made orthonormal before the next flight and impact spread it that much further."""
    return spread > 0.0 and spread + more > limit


@inline_always
def record_impact(tally, impacts, t, side, speed, R):
    """Count an impact and, while there is room in impacts (K, 3), write it down."""
    tally[UPPER if side > 0 else LOWER] += 1.0
    tally[MIN_SPEED] = min(tally[MIN_SPEED], speed)
    tally[MAX_SPEED] = max(tally[MAX_SPEED], speed)
    tally[SPEEDS] += speed
    tally[LOSS] += (1.0 - R * R) * (speed * speed)
    row = int(tally[RECORDED])
    if row < impacts.shape[0]:
        impacts[row, 0] = t
        impacts[row, 1] = side
        impacts[row, 2] = speed
        tally[RECORDED] += 1.0


@inline_always
def come_to_rest(blocks, cA2k, motion, v):
    """The end of chatter that an impact at velocity v begins."""
    tally = motion.tally
    tally[MAX_SPEED] = max(tally[MAX_SPEED], abs(v))
    tally[LOSS] += v * v
    kick(blocks, motion.h, -v)
    rest_projection(blocks, cA2k, motion.V)


@inlined
def impact_spread(ratio, unit, loss):
    """How far an impact with ratio = a / v spreads the frame at most, as a logarithm.

    2 ln(1 + u) - ln R, u = |ratio| unit, where unit is the oscillator's time_unit; ln x < (x - 1) / sqrt(x) spares the
    logarithms.
    """
    u = abs(ratio) * unit
    return 2.0 * u / math.sqrt(1.0 + u) + loss


@inlined
def loss_spread(R):
    """The part of impact_spread that the restitution makes: at least -ln R."""
    return (1.0 - R) / math.sqrt(max(R, TINY))


@inline_always
def spend(tally, evaluations):
    """Count evaluations; every piece of motion costs one at least, so that no chain of them is endless."""
    tally[EVALUATIONS] += evaluations
    tally[WORK] -= max(1, evaluations)
    if tally[WORK] < -OVERDRAFT:
        tally[STATUS] = OUT_OF_WORK


@inline_always
def leave_stop(osc, motion, phase, contact, remaining, chatter):
    """Rest on a stop until release or for ``remaining``: the time it took, and whether to go on from there.

    The first part of it, ``chatter``, the mass spends hopping.
    """
    h, V, tally = motion.h, motion.V, motion.tally
    s, released, evaluations = stay_on_stop(osc, h, V, motion.growth, motion.triangle, phase, contact, remaining)
    tally[STUCK] += min(s, max(s - chatter, TINY))  # a rest counts, however short
    spend(tally, evaluations)
    tally[LOST] = 2.0
    tally[MIN_SPEED] = 0.0
    reset_frame(osc, motion)
    if released == 0:
        motion.contact[0] = contact
    if released == 2:
        tally[STATUS] = MARCH_GAVE_UP
    return s, tally[STATUS] == RUNNING and released == 1


@inlined
def widen(extremes, y):
    """Take a position of the gap coordinate into the least and greatest one (2,)."""
    extremes[0], extremes[1] = min(extremes[0], y), max(extremes[1], y)


@inline_always
def watch_flight(gap, motion, phase, s, own, kind, top, bottom):
    """Take the turning points of a free flight of duration s into the motion's extremes.

    They are looked for where the flight leaves the range known so far: as certainly as it would meet two stops there.
    """
    extremes, tally = motion.extremes, motion.tally
    low, high = extremes[0], extremes[1]
    if low <= bottom and high >= top:
        return
    _, side, evaluations = next_crossing(gap, motion.h, phase, 0.0, high, low, own, kind, s, motion.scratch)
    if (side == 1 and high < top) or (side == -1 and low > bottom):
        extremes[0], extremes[1], more = turning_points(gap, motion.h, phase, s, own, kind, low, high)
        evaluations += more
    if side == 2 or extremes[1] != extremes[1]:
        tally[STATUS] = MARCH_GAVE_UP
    spend(tally, evaluations)


@kernel_and_part
def propagate(osc, motion, duration):
    """Take a motion from a section on by ``duration`` <= one period, in place, through all its impacts.

    The one loop of mode, first guard and reset. Stops early with tally[STATUS] set if it cannot be completed, at once
    where it starts beyond a stop.
    """
    osc, motion = borrowed(osc), borrowed(motion)
    gap, h, V, tally, scratch, impacts = osc.gap, motion.h, motion.V, motion.tally, motion.scratch, motion.impacts
    blocks, waves, metric, omega = gap.blocks, gap.waves, gap.metric, gap.numbers[NUMBER.omega]
    R, cA2k, top, bottom = osc.head[HEAD.R], osc.head[HEAD.cA2k], osc.head[HEAD.top], osc.head[HEAD.bottom]
    contact = motion.contact[0]
    if abs(contact) == BEYOND:
        tally[STATUS] = STARTED_BEYOND
        return
    motion.contact[0] = FREE
    vectors, frame, watched = V.shape[0] > 0, motion.growth.shape[0] > 0, motion.extremes.shape[0] > 0
    rate = spread_rate(blocks) if vectors else 0.0
    unit, loss = osc.head[HEAD.time_unit], loss_spread(R)
    own, kind, chatter = 0, ON_STOP_MOVING, 0.0
    t, phase = 0.0, osc.tau
    if watched:
        y = evaluate(blocks, waves, omega, h, 0.0, phase, 0.0)[0]
        widen(motion.extremes, min(max(y, bottom), top) if contact == FREE else stop_position(osc, contact))
    if abs(contact) == AT_REST:
        own, kind, contact = np.sign(contact), ON_STOP_AT_REST, FREE
    while True:
        if contact != FREE:
            s, released = leave_stop(osc, motion, phase, contact, duration - t, chatter)
            if not released:
                return
            t += s
            phase += omega * s
            own, kind = contact, ON_STOP_RELEASED
            if duration - t <= AT_THE_END * duration:
                motion.contact[0] = contact * AT_REST
                return
        s, side, evaluations = next_crossing(gap, h, phase, 0.0, top, bottom, own, kind, duration - t, scratch)
        spend(tally, evaluations)
        hit = abs(side) == 1
        y, v, a, scale = NOWHERE
        if hit:
            y, v, a, _, scale = evaluate(blocks, waves, omega, h, s, phase, 0.0)
            v = side * max(side * v, TINY)  # seen to approach; evaluated anew, the last digit may differ
        if watched:
            watch_flight(gap, motion, phase, s, own, kind, top, bottom)
        spread = impact_spread(a / v, unit, loss) if vectors and hit else 0.0
        flown = s * rate
        if needs_reset(tally[SPREAD], flown + spread, MAX_SPREAD):
            reset_frame_of(metric, motion)
        if frame and tally[SPREAD] + flown > MAX_SPREAD:
            fly_far(osc, motion, s)
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
        following = REBOUND
        if not is_rebound(load_at_rest(side, v, a, cA2k), v, R, cA2k, scale, duration - t):
            following = outcome(osc, h, side, v, a, scale, duration - t)
        own, kind, contact = side, ON_STOP_MOVING, FREE
        if following == REST:
            come_to_rest(blocks, cA2k, motion, v)
            contact, chatter = side, chatter_time(load_at_rest(side, v, a, cA2k), R * abs(v), R)
            continue
        record_impact(tally, impacts, t, side, abs(v), R)
        kick(blocks, h, -(1.0 + R) * v)
        shift(blocks, h, stop - y)  # or rounding would add up over many impacts
        saltation(blocks, R, V, a / v)
        tally[SPREAD] += spread
        if following == LEAVE:
            kind = ON_STOP_AT_REST
            tally[LOST] = max(tally[LOST], 1.0)
            reset_frame_of(metric, motion)


@inline_always
def advance(osc, motion):
    """The stroboscopic map P: one forcing period, section to section, in place; V becomes DP V."""
    propagate(osc, motion, osc.head[HEAD.period])


@inline_always
def step(osc, motion, half):
    """The stroboscopic map P, or the half-period map G(z) = -P_{T/2}(z) of a symmetric gap, in place; G o G = P."""
    period = osc.head[HEAD.period]
    propagate(osc, motion, 0.5 * period if half else period)
    if half:
        mirror(motion)


@kernel
def mirror(motion):
    """z -> -z, in place."""
    motion.contact[0] = -motion.contact[0]
    for j in range(motion.h.shape[0]):
        for k in range(2):
            motion.h[j, k] = -motion.h[j, k]
            for i in range(motion.V.shape[0]):
                motion.V[i, j, k] = -motion.V[i, j, k]
