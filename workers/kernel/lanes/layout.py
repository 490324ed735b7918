"""Where the fields of a batch's lanes lie: offsets by name, which kernels see as constants.

All fields are in one flat array: ``a[LANE.v + i]`` is the velocity of lane i. Constant offsets, STRIDE apart, let the
compiler see that no two fields overlap, so that loops over lanes become vector instructions.
"""

from collections import namedtuple
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from workers.kernel.jit import inline_always, named_constants
from workers.model.oscillator import COLUMN, Block

LANES = 128
"""Lanes of a batch: their fields stay in the processor's nearest caches."""

VECTOR_WIDTH = 8
"""Numbers in the longest vectors of today's processors: loops run over multiples of it, since a remainder is scalar."""

STRIDE = LANES + VECTOR_WIDTH
"""Numbers from one field to the next; a power of two would put all fields of a lane into the same few cache lines."""

FLYING, AT_SECTION, LEFT = 0.0, 2.0, 3.0
"""Events of a lane, besides +-1, an impact at that stop. LEFT: the kernels of one cell take it through this period."""


class LaneFields(NamedTuple):
    """Fields of a lane. Velocities, accelerations and so on refer to the gap coordinate y."""

    # those of oscillator.Numbers
    omega: int
    amplitude: int  # bounds of the forced part and of its second to fourth derivative
    swing2: int
    swing3: int
    swing4: int
    # the first ones of oscillator.Head
    upper: int  # position of the upper stop
    lower: int  # position of the lower stop
    restitution: int
    cA2k: int
    period: int
    time_unit: int  # see tangent.impact_spread
    # other constants of the oscillator, and what follows from them
    tau: int
    sin_part: int  # of the first harmonic; for others see HarmonicFields
    cos_part: int
    forced_at_section: int  # the forced part at a section, and its derivatives
    forced_rate_at_section: int
    forced_second_at_section: int
    forced_third_at_section: int
    spread_rate: int  # see tangent.spread_rate
    loss_spread: int  # see tangent.loss_spread
    # the flight under way
    flight_start: int  # time from the section to the flight's start
    flight_phase: int  # phase of the force at the flight's start
    time: int  # from the flight's start; the signal is that at this time
    flown: int  # duration of the last flight, or of the part of it that has been flown
    event: int  # what is reached at ``time``: FLYING, AT_SECTION, LEFT, or +-1 for an impact
    own_stop: int  # the stop that the flight starts on, +-1; 0 from its first step on
    flight_evaluations: int
    starts: int  # 1 where a flight starts, else 0
    stops: int  # 1 at a section and where the lane has LEFT, else 0
    renews: int  # 1 where the bounds are to be computed anew, else 0
    # the signal at ``time``
    forced: int  # its forced part, and the derivatives of that
    forced_rate: int
    forced_second: int
    forced_third: int
    y: int
    v: int
    a: int
    jerk: int
    scale: int  # sum of the moduli that add up to y, which its rounding error is measured in
    bound0: int  # bounds of |y| and of its second to fourth derivative, for all later times
    bound2: int
    bound3: int
    bound4: int
    # an impact
    kick: int  # change of velocity
    shift: int  # change of position, which takes off rounding
    # what is counted
    impacts_upper: int
    impacts_lower: int
    slowest_impact: int
    fastest_impact: int
    impact_speeds: int  # their sum
    impact_loss: int  # what they take off the square of y'
    evaluations: int
    period_cost: int  # evaluations of this period, each flight counted as one at least
    recorded: int
    cell: int  # the row of the batch that the lane works on
    # the tangent frame
    rank: int  # how many directions exist
    frame_spread: int  # see motion.SPREAD
    log_length: int  # of the first tangent vector, at the last section
    period_growth: int  # by how much that is less than now
    due: int  # 1 where the frame is to be made orthonormal, else 0
    flows: int  # 1 where a flight has ended that the frame goes through, else 0
    far: int  # 1 where the flight spreads the frame far, else 0
    loss: int  # 1 + R at an impact, else 0
    ratio: int  # a / v just before an impact, else 0
    # the search for the next step
    side: int  # the stop looked at, +-1
    gap: int  # distance from it
    contact_time: int  # after which the stop ahead is certain to be met; infinity where that is not known
    safe_time: int  # for which the gap certainly stays open
    limit: int  # of that time
    step: int
    searched: int  # 1 where a longer step is sought, else 0


FIELDS_OF_BLOCK = (
    *Block._fields[: COLUMN.cAA0],  # constants of the oscillator: the first columns of its blocks
    *("start0", "start1"),  # its state (h, h') at the flight's start
    *("h0", "h1"),  # its state at LANE.time
    *("f11", "f12", "f21", "f22"),  # the flow from the one to the other
)
"""Fields of one block of a lane."""

BlockFields: Any = namedtuple("BlockFields", FIELDS_OF_BLOCK)  # type: ignore[misc]


class HarmonicFields(NamedTuple):
    """Fields of one harmonic of a lane, from the second on."""

    sin_part: int
    cos_part: int


class GapFields(NamedTuple):
    """Fields of the gaps of some lanes, gathered one after another: how a gap closes, and bounds of a safe time."""

    gap: int
    v: int  # > 0 where it closes
    a: int
    jerk: int
    bound2: int
    bound3: int
    bound4: int
    low: int  # a safe time
    high: int  # a limit of it


LANE = LaneFields(*(k * STRIDE for k in range(len(LaneFields._fields))))
BLOCK: Any = BlockFields(*(k * STRIDE for k in range(len(BlockFields._fields))))
HARMONIC = HarmonicFields(*(k * STRIDE for k in range(len(HarmonicFields._fields))))
GAP = GapFields(*(k * STRIDE for k in range(len(GapFields._fields))))
named_constants(LaneFields, BlockFields, HarmonicFields, GapFields)


@register_jitable
def padded_blocks(n: int) -> int:
    """Blocks that there is room for where there are n: the passes over tangent vectors take two at a time."""
    return n + n % 2


LANE_SIZE = len(LaneFields._fields) * STRIDE
BLOCK_SIZE = len(BlockFields._fields) * STRIDE
HARMONIC_SIZE = len(HarmonicFields._fields) * STRIDE
GAP_SIZE = len(GapFields._fields) * STRIDE
"""Numbers that the fields of all lanes take, of one block of them, of one harmonic, and of the gathered gaps."""


@inline_always
def room_for_vectors(size):
    """Zeros (size,) that begin at a multiple of a vector register's size: a register across two lines is read twice."""
    room = np.zeros(size + VECTOR_WIDTH)
    first = (VECTOR_WIDTH - np.int64(room.ctypes.data) // 8 % VECTOR_WIDTH) % VECTOR_WIDTH
    return room[first : first + size]
