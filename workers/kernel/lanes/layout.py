"""The layout of the fields of lanes, slots that hold one cell each: offsets by name, constants in kernels.

All fields lie in one flat array: ``a[LANE.v + i]`` is the velocity of lane i. Constant offsets, STRIDE apart, show the
compiler that fields do not overlap, so loops over lanes become vector instructions.
"""

from collections import namedtuple
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from workers.kernel.jit import inline_always, named_constants
from workers.model.oscillator import COLUMN, Block

LANES = 128
"""Number of lanes of a batch: their fields stay in the processor's nearest caches."""

VECTOR_WIDTH = 8
"""Number of float64 values in the longest vectors of today's processors. Loops run over multiples of it, since a
remainder is scalar."""

STRIDE = LANES + VECTOR_WIDTH
"""Distance from one field to the next. A power of two would map all fields of a lane to the same few cache lines."""

FLYING, AT_SECTION, LEFT = 0.0, 2.0, 3.0
"""Events of a lane besides +-1, an impact at that stop. LEFT: the kernels of one cell complete this period."""


class LaneFields(NamedTuple):
    """Fields of a lane, a slot that holds one cell, as offsets.

    Velocity, acceleration and so on are of the gap coordinate y.
    """

    # those of oscillator.ForcedBounds
    omega: int
    amplitude: int  # bounds of the forced part and of its second to fourth derivative
    swing2: int
    swing3: int
    swing4: int
    # the first ones of oscillator.OscillatorScalars
    upper: int  # position of the upper stop
    lower: int  # position of the lower stop
    restitution: int
    cA2k: int
    period: int
    time_unit: int  # see tangent.impact_spread
    # other constants of the oscillator, and numbers derived from them
    tau: int
    sin_part: int  # amplitude of the first harmonic; for the others see HarmonicFields
    cos_part: int
    forced_at_section: int  # forced part at a section, and its derivatives
    forced_rate_at_section: int
    forced_second_at_section: int
    forced_third_at_section: int
    spread_rate: int  # see tangent.spread_rate
    loss_spread: int  # see tangent.loss_spread
    # the current flight
    flight_start: int  # time of the flight's start since the section
    flight_phase: int  # phase of the force at the flight's start
    time: int  # time from the flight's start, at which the signal is evaluated
    flown: int  # duration of the last flight, or of its part flown so far
    event: int  # event at ``time``: FLYING, AT_SECTION, LEFT, or +-1 for an impact
    own_stop: int  # the stop that the flight starts on, +-1; 0 from its first step on
    flight_evaluations: int
    starts: int  # 1 if a flight starts, else 0
    stops: int  # 1 at a section and if the lane has LEFT, else 0
    renews: int  # 1 if the bounds must be computed anew, else 0
    # the signal at ``time``
    forced: int  # forced part of the signal, with derivatives
    forced_rate: int
    forced_second: int
    forced_third: int
    y: int
    v: int
    a: int
    jerk: int
    scale: int  # sum of the moduli of the terms of y, the unit of its rounding error
    bound0: int  # bounds of |y| and of its second to fourth derivative, for all later times
    bound2: int
    bound3: int
    bound4: int
    # an impact
    kick: int  # change of velocity
    shift: int  # change of position, which removes rounding
    # counts
    impacts_upper: int
    impacts_lower: int
    slowest_impact: int
    fastest_impact: int
    impact_speeds: int  # sum of the speeds of the impacts
    impact_loss: int  # loss of the square of y' by impacts
    evaluations: int
    period_cost: int  # evaluations of this period, at least one per flight
    recorded: int
    cell: int  # row of the batch in this lane
    # the tangent frame
    rank: int  # number of directions that exist
    frame_spread: int  # see motion.SPREAD
    log_length: int  # log of the length of the first tangent vector, at the last section
    period_growth: int  # increase of log_length since the last section
    due: int  # 1 if the frame must be made orthonormal, else 0
    flows: int  # 1 if the frame must pass a completed flight, else 0
    far: int  # 1 if the flight spreads the frame far, else 0
    loss: int  # 1 + R at an impact, else 0
    ratio: int  # a / v just before an impact, else 0
    # the search for the next step
    side: int  # the stop considered, +-1
    gap: int  # distance from the stop
    contact_time: int  # time after which contact with the stop ahead is certain; infinity if unknown
    safe_time: int  # time for which the gap certainly stays open
    limit: int  # upper limit of safe_time
    step: int
    searched: int  # 1 if a longer step is sought, else 0


FIELDS_OF_BLOCK = (
    *Block._fields[: COLUMN.cAA0],  # constants of the oscillator: the first columns of its blocks
    *("start0", "start1"),  # state (h, h') of the block at the flight's start
    *("h0", "h1"),  # state of the block at LANE.time
    *("f11", "f12", "f21", "f22"),  # the flow between both states
)
"""Names of the fields of one block of a lane."""

BlockFields: Any = namedtuple("BlockFields", FIELDS_OF_BLOCK)  # type: ignore[misc]


class HarmonicFields(NamedTuple):
    """Fields of one harmonic of the force in each lane (one cell), as offsets, from the second harmonic on."""

    sin_part: int
    cos_part: int


class GapFields(NamedTuple):
    """Fields of the gaps of some cells to their stops, as offsets: closing motion, and bounds of a safe time.

    The cells are gathered contiguously. A safe time is one in which the gap certainly stays open.
    """

    gap: int
    v: int  # > 0 if the gap closes
    a: int
    jerk: int
    bound2: int
    bound3: int
    bound4: int
    low: int  # a safe time
    high: int  # a limit of the safe time


LANE = LaneFields(*(k * STRIDE for k in range(len(LaneFields._fields))))
BLOCK: Any = BlockFields(*(k * STRIDE for k in range(len(BlockFields._fields))))
HARMONIC = HarmonicFields(*(k * STRIDE for k in range(len(HarmonicFields._fields))))
GAP = GapFields(*(k * STRIDE for k in range(len(GapFields._fields))))
named_constants(LaneFields, BlockFields, HarmonicFields, GapFields)


@register_jitable
def padded_blocks(n: int) -> int:
    """Return the number of blocks for which arrays have room: n, rounded up to an even number.

    Passes over tangent vectors take two blocks, decoupled equations of motion, at a time.
    """
    return n + n % 2


LANE_SIZE = len(LaneFields._fields) * STRIDE
BLOCK_SIZE = len(BlockFields._fields) * STRIDE
HARMONIC_SIZE = len(HarmonicFields._fields) * STRIDE
GAP_SIZE = len(GapFields._fields) * STRIDE
"""Sizes of the fields of all lanes, of one block, of one harmonic, and of the gathered gaps."""


@inline_always
def room_for_vectors(size):
    """Return zeros (size,) aligned to a vector register: a register that spans two cache lines is read twice."""
    room = np.zeros(size + VECTOR_WIDTH)
    first = (VECTOR_WIDTH - np.int64(room.ctypes.data) // 8 % VECTOR_WIDTH) % VECTOR_WIDTH
    return room[first : first + size]
