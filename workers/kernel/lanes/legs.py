"""Search for the next event of many motions of machines with modes, in vectorised loops.

A mode is one set of linear equations of motion, and a leg the motion in one mode, from one event to the next. A lane is
a slot that holds one motion. A signal is a number computed from the state; at an end of its range there is an event.
Every signal of a lane has the fields of a gap, see ``layout.py``. The same passes search it, with the ends of its range
as stops. ``records`` (U, size) are the fields of U signals; the first record also holds the time, and the flow of the
blocks, the decoupled equations. The kernels of one motion carry it through its events, which few lanes have.
"""

import math
from typing import NamedTuple

import numpy as np

from workers.kernel.borrow import borrow
from workers.kernel.crossing import MIN_STEP, REFRESH
from workers.kernel.fma import fma
from workers.kernel.jit import inline_always, inlined, kernel, named_constants
from workers.kernel.lanes.layout import (
    BLOCK,
    BLOCK_SIZE,
    FLYING,
    HARMONIC,
    HARMONIC_SIZE,
    LANE,
    LANE_SIZE,
    LEFT,
    STRIDE,
    padded_blocks,
)
from workers.kernel.lanes.run import move_lane, park
from workers.kernel.lanes.search import MAX_MARCH_STEPS, safe_steps
from workers.kernel.lanes.signal import (
    add_share,
    block_pass,
    fields_of,
    fields_of_harmonic,
    forced_pass,
    harmonic_pass,
    loaded_output_of,
    oscillating_block_pass,
    output_of,
    renewal_pass,
)
from workers.model.oscillator import COLUMN, NUMBER

REACHED, OVER = 1.0, 2.0
"""Events of a lane besides FLYING and LEFT. REACHED: a signal has reached an end of its range. OVER: the leg has ended
without an event."""

RENEWAL = float(REFRESH)


class LegFields(NamedTuple):
    """Fields of the search in a lane, a slot that holds one motion, apart from the fields of its signals."""

    event: int  # FLYING, REACHED, OVER, or LEFT: the search needs very many steps
    hit: int  # the first signal to reach an end of its range, -1 for none
    side: int  # the end reached, +-1
    step: int  # the least step of all signals
    oscillates: int  # 1 if all blocks are underdamped, else 0
    length: int  # duration of the leg without an event; LANE.period may be longer, see trajectory.SECTION_WIDTH


LEG_FIELD = LegFields(*(k * STRIDE for k in range(len(LegFields._fields))))
named_constants(LegFields)
LEG_SIZE = len(LegFields._fields) * STRIDE


@inline_always
def record_size(blocks, harmonics):
    """Return the size of the array of fields of one signal of all lanes (one motion each).

    blocks     number of blocks, the decoupled equations of motion
    harmonics  number of harmonics of the force
    """
    return LANE_SIZE + padded_blocks(blocks) * BLOCK_SIZE + (harmonics - 1) * HARMONIC_SIZE


@kernel
def empty_lane(records, i):
    """Fill lane i, which holds no motion, with a mass at rest, over which the passes can run."""
    records = borrow(records)
    for u in range(records.shape[0]):
        park(records[u], i)


@kernel
def copy_lane(records, source, target):
    """Copy the motion in lane ``source`` to lane ``target``, with the fields of all its signals.

    A lane is a slot of the loops. A signal is a number with an event at each end of its range.
    """
    records = borrow(records)
    for u in range(records.shape[0]):
        move_lane(records[u], source, target)


@inlined
def load_mode(records, i, modes, signals, k, omega):
    """Load the constants of mode k, a set of linear equations, into lane i (one motion), for a force of this frequency.

    ``signals`` (U,) are those to search. Return True if all blocks (decoupled equations) oscillate.
    """
    harmonics, n, oscillates, mode = modes.waves.shape[2], modes.blocks.shape[2], True, np.uint64(k)
    for u in range(len(signals)):
        a, g = records[u], np.uint64(signals[u])
        offset, numbers, waves, blocks = (
            modes.offset[mode, g],
            modes.numbers[mode, g],
            modes.waves[mode, g],
            modes.blocks[mode, g],
        )
        a[LANE.omega + i] = omega
        a[LANE.amplitude + i], a[LANE.swing2 + i] = numbers[NUMBER.amplitude], numbers[NUMBER.swing2]
        a[LANE.swing3 + i], a[LANE.swing4 + i] = numbers[NUMBER.swing3], numbers[NUMBER.swing4]
        a[LANE.lower + i], a[LANE.upper + i] = modes.ends[mode, g, 0] - offset, modes.ends[mode, g, 1] - offset
        a[LANE.sin_part + i], a[LANE.cos_part + i] = waves[0, 0], waves[0, 1]
        for w in range(1, harmonics):
            fields = fields_of_harmonic(a, padded_blocks(n), w - 1)
            fields[HARMONIC.sin_part + i], fields[HARMONIC.cos_part + i] = waves[w, 0], waves[w, 1]
        for j in range(n):
            first, columns = LANE_SIZE + j * BLOCK_SIZE + i, blocks[j]
            for f in range(COLUMN.k0):
                a[np.uint64(first + f * STRIDE)] = columns[f]
            oscillates = oscillates and columns[COLUMN.d] > 0.0
    return oscillates


@inlined
def load_leg(records, i, signals, h, phase, turn, signal_starts, H):
    """Load a leg of at most the time H into lane i (one motion), which has the constants of its mode already.

    signals (U,)    signals to search
    phase           forcing phase at the start
    turn (H, 2)     harmonics of the force at that phase, see state.harmonics_at
    signal_starts   start of each signal, see ``hybrid/events.py``

    The leg, the motion in one mode (set of linear equations) until its first event, starts at block state h (n, 2).
    """
    harmonics, n = len(turn), len(h)
    for u in range(len(signals)):
        a, omega = records[u], records[u, LANE.omega + i]
        a[LANE.period + i], a[LANE.flight_start + i], a[LANE.flight_phase + i] = H, 0.0, phase
        a[LANE.time + i], a[LANE.flight_evaluations + i] = 0.0, 0.0
        a[LANE.own_stop + i], a[LANE.starts + i], a[LANE.renews + i] = signal_starts[signals[u]], 1.0, 1.0
        forced, rate, second, third = 0.0, 0.0, 0.0, 0.0
        for w in range(harmonics):
            parts = LANE_SIZE + padded_blocks(n) * BLOCK_SIZE + (w - 1) * HARMONIC_SIZE
            sin_part = a[i + (LANE.sin_part if w == 0 else parts + HARMONIC.sin_part)]
            cos_part = a[i + (LANE.cos_part if w == 0 else parts + HARMONIC.cos_part)]
            fast = (w + 1.0) * omega
            y = fma(sin_part, turn[w, 0], cos_part * turn[w, 1])
            v = fast * fma(sin_part, turn[w, 1], -cos_part * turn[w, 0])
            forced, rate, second, third = forced + y, rate + v, second - fast * fast * y, third - fast * fast * v
        a[LANE.forced + i], a[LANE.forced_rate + i] = forced, rate
        a[LANE.forced_second + i], a[LANE.forced_third + i] = second, third
        for j in range(n):
            first = LANE_SIZE + j * BLOCK_SIZE + i
            a[first + BLOCK.h0], a[first + BLOCK.h1] = h[j, 0], h[j, 1]


@inlined
def read_flow(records, i, flow):
    """Copy the flow of each block since the start of the leg, and the block's state now, to ``flow``.

    flow (n, 6)  see HybridTrajectory

    Lane i holds one motion. A leg is the motion between two events, a block one decoupled equation of motion, and its
    flow a matrix (2, 2).
    """
    for j in range(len(flow)):
        first = LANE_SIZE + j * BLOCK_SIZE + i
        flow[j, 0], flow[j, 1] = records[0, first + BLOCK.f11], records[0, first + BLOCK.f12]
        flow[j, 2], flow[j, 3] = records[0, first + BLOCK.f21], records[0, first + BLOCK.f22]
        flow[j, 4], flow[j, 5] = records[0, first + BLOCK.h0], records[0, first + BLOCK.h1]


@kernel
def least_pass(legs, a, u, n):
    """Take the step of signal u as the step of each of n motions for which it is the smallest so far.

    ``a`` are the fields of the signal, a number with an event at each end of its range.
    """
    for i in range(n):
        contact, before, hit = a[LANE.contact_time + i], legs[LEG_FIELD.step + i], legs[LEG_FIELD.hit + i]
        met = contact < np.inf
        step = contact if met else a[LANE.step + i]
        nearer = step < before or (met and step == before and hit < 0.0)
        legs[LEG_FIELD.step + i] = step if nearer else before
        first = u if met else -1.0
        legs[LEG_FIELD.hit + i] = first if nearer else hit
        legs[LEG_FIELD.side + i] = -a[LANE.side + i] if nearer else legs[LEG_FIELD.side + i]


@kernel
def move_pass(legs, a, n):
    """Advance each of n lanes (one motion each) by its step, and set whether it has reached an event.

    Return how many lanes need new bounds of their signals. ``a`` are the fields of the first signal.
    """
    renewing = 0
    for i in range(n):
        s, H, length = a[LANE.time + i], a[LANE.period + i], legs[LEG_FIELD.length + i]
        later = s + legs[LEG_FIELD.step + i]
        met = legs[LEG_FIELD.hit + i] >= 0.0
        over = later >= H and not met
        count = a[LANE.flight_evaluations + i] + 1.0
        stuck = not later > s + MIN_STEP * H or count >= MAX_MARCH_STEPS
        event = LEFT if stuck else FLYING
        event = REACHED if met else event
        event = OVER if over else event
        legs[LEG_FIELD.event + i] = event
        a[LANE.time + i] = length if over else later
        a[LANE.flight_evaluations + i] = count
        renews = count == RENEWAL * math.floor(count * (1.0 / RENEWAL))
        a[LANE.renews + i] = 1.0 if renews else 0.0
        renewing += int(renews)
        a[LANE.starts + i] = 0.0
        a[LANE.own_stop + i] = 0.0
    return renewing


@kernel
def copy_pass(a, first, n):
    """Copy time and flags, which all signals of a motion have in common, from its first signal to another.

    A signal is a number with an event at each end of its range.

    ``first`` and ``a`` are the fields of both signals in n lanes, slots that hold one motion each.
    """
    for i in range(n):
        a[LANE.time + i] = first[LANE.time + i]
        a[LANE.renews + i] = first[LANE.renews + i]
        a[LANE.starts + i] = 0.0
        a[LANE.own_stop + i] = 0.0


@kernel
def share_pass(a, q, flown, n):
    """Add the contribution of one block, a decoupled equation of motion, to a signal of each of n motions.

    a, q   fields of the signal, and of the block in this signal
    flown  fields of the block in the first signal, with its state at LANE.time

    A signal is a number with an event at each end of its range.
    """
    for i in range(n):
        h0, h1 = flown[BLOCK.h0 + i], flown[BLOCK.h1 + i]
        add_share(a, q, i, h0, h1, loaded_output_of(q, i, h0, h1))


@kernel
def oscillating_share_pass(a, q, flown, n):
    """Do ``share_pass`` for a block (decoupled equation) that is underdamped in every lane (one motion each)."""
    for i in range(n):
        h0, h1 = flown[BLOCK.h0 + i], flown[BLOCK.h1 + i]
        add_share(a, q, i, h0, h1, output_of(q, i, h0, h1))


@inline_always
def run_round(records, legs, blocks, harmonics, oscillates, renews, n, lane_list, c):
    """Take the first n lanes through one round: each advances by a certified step, or to an event.

    records, legs  fields of the lanes, slots that hold one motion each
    blocks         number of blocks, the decoupled equations of motion
    harmonics      number of harmonics of the force
    oscillates     whether all blocks of all lanes are underdamped
    renews         whether a lane may need new bounds of its signals
    lane_list, c   overwritten

    A certified step is a time in which certainly no event occurs. Return True if a lane needs new bounds in the next
    round. Both ways to treat an underdamped block give the same bits.
    """
    signals, first = records.shape[0], records[0]
    for i in range(n):
        legs[LEG_FIELD.step + i] = np.inf
        legs[LEG_FIELD.hit + i] = -1.0
    for u in range(signals):
        a = records[u]
        if renews:
            renewal_pass(a, blocks, oscillates, n)
        safe_steps(a, n, lane_list, c)
        least_pass(legs, a, np.float64(u), n)
    renewing = move_pass(legs, first, n)
    for u in range(signals):
        a = records[u]
        if u > 0:
            copy_pass(a, first, n)
        forced_pass(a, n)
        for w in range(1, harmonics):
            harmonic_pass(a, fields_of_harmonic(a, padded_blocks(blocks), w - 1), w + 1.0, n)
        for j in range(blocks):
            q = fields_of(a, j)
            if u == 0 and oscillates:
                oscillating_block_pass(a, q, n)
            elif u == 0:
                block_pass(a, q, n)
            elif oscillates:
                oscillating_share_pass(a, q, fields_of(first, j), n)
            else:
                share_pass(a, q, fields_of(first, j), n)
    return renewing > 0
