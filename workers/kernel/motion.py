"""The record of a motion in kernels: its state, its tangent vectors, its counts, and status codes."""

from typing import Any, NamedTuple

import numpy as np
from numba import typeof, types
from numba.extending import register_jitable, typeof_impl
from numpy.typing import NDArray

from workers.kernel.borrow import row_type
from workers.kernel.elementary import sin_cos
from workers.kernel.external import FLOATS, INTEGERS, load
from workers.kernel.jit import inline_always, kernel
from workers.model.hybrid_modes import FLYING, OF_PIECES
from workers.model.machines import Machines
from workers.model.mode_table import no_table
from workers.model.oscillator import GuardedFlow, Oscillator, empty, map_fields

FLIGHT = FLYING.number
"""Number of the flight mode of a machine with one rigid contact. The mode is FLIGHT +- ON while the gap coordinate
sticks on a stop. It is FLIGHT +- DETACHED if the motion is on a stop with v = 0, about to leave."""

BEYOND = -1
"""Value in place of a mode if the motion begins beyond a stop."""

(
    UPPER, LOWER, MIN_SPEED, MAX_SPEED, SPEEDS, LOSS, STUCK,
    EVALUATIONS, WORK, LOST, SPREAD, RECORDED, STATUS, CONTRACTION, PROGRESS, SLID, NEUTRAL, TALLIES,
) = range(18)  # fmt: skip
"""Columns of the tally of a motion.

UPPER, LOWER  number of impacts on the upper and on the lower stop
MIN_SPEED     speed of the slowest impact, 0 if the mass has stuck on a rigid stop
MAX_SPEED     speed of the fastest impact
SPEEDS        sum of the speeds of the impacts
LOSS          loss of the square of y' by impacts
STUCK         time spent sticking
EVALUATIONS   number of evaluations used
WORK          number of evaluations still allowed
LOST          number of directions lost
SPREAD        spread of the frame since it was last orthonormal
RECORDED      number of contacts recorded
STATUS        see RUNNING

Of machines with modes only:

CONTRACTION   log of the change of volume, if no direction is lost
PROGRESS      drift of a coordinate that is reset at each section, so that this direction is lost
SLID          frictions that have slid, one binary digit each
NEUTRAL       number of neutral directions of turns of an orbit, see hybrid.neutral.freeze

An impact that completes a chatter counts in MAX_SPEED and LOSS like any other. It counts neither at its stop nor in
SPEEDS, since infinitely many impacts end a chatter."""

NOTHING_COUNTED = np.where(np.arange(TALLIES) == MIN_SPEED, np.inf, 0.0)
"""Tally (TALLIES,) of a motion before its start, with no evaluations allowed."""

(
    RUNNING, MARCH_GAVE_UP, OUT_OF_WORK, NOT_FINITE, STARTED_BEYOND,
    MODE_MISSING, NO_MODE, ENDLESS_EVENTS, SIMULTANEOUS, RESONANT_MODE,
) = range(10)  # fmt: skip
"""Status of a motion: running, or why a cell cannot continue.

MARCH_GAVE_UP   the search for a crossing needs too many steps
OUT_OF_WORK     the allowed evaluations are used up
NOT_FINITE      a state is not finite
STARTED_BEYOND  the motion starts beyond a stop

Of machines with modes only:

MODE_MISSING    a mode is not built
NO_MODE         a mode has no valid flow
ENDLESS_EVENTS  an endless chain of events at one time
SIMULTANEOUS    two rigid contacts are reached at once
RESONANT_MODE   a mode resonates undamped"""

OVERDRAFT = 1_000_000
"""Maximum number of evaluations by which a period may exceed those allowed, so that motions can end at a section."""

WORK_OF_A_TRIAL = 1_000_000
"""Maximum number of evaluations of a short motion outside the periods of a cell: a turn of an orbit or a Newton
step."""


class Motion(NamedTuple):
    """State of the motion of one cell, changed in place by ``advance``. A batch has one more leading axis per field.

    h        (n, 2)     block state, (h, h') of each decoupled equation of motion, without the forced response
    mode     (1,)       number of the mode, a set of equations, see hybrid_modes.ModeCode and FLIGHT; or BEYOND
    V        (m, n, 2)  tangent vectors; m = 0 if none are followed
    growth   (m,)       log of the growth removed from each vector so far
    triangle (m, m)     factors of tangent.orthonormalise; (0, 0) if not wanted
    tally    (TALLIES,) counts, see UPPER
    impacts  (K, 3)     the first K impacts: time since the start of the period, side, and speed before the impact;
                        speed 0 where sticking begins, see write_down_rest; K = 0 if none are recorded
    extremes (2,)       the least and the greatest y - y0 so far; (0,) if not wanted
    scratch  (n, 2)     overwritten
    """

    h: NDArray[np.float64]
    mode: NDArray[np.int64]
    V: NDArray[np.float64]
    growth: NDArray[np.float64]
    triangle: NDArray[np.float64]
    tally: NDArray[np.float64]
    impacts: NDArray[np.float64]
    extremes: NDArray[np.float64]
    scratch: NDArray[np.float64]


def record_type(kind: type, *fields: int | types.Type) -> types.NamedTuple:
    """Return the Numba type of a record, a named tuple of class ``kind``, from the types of its ``fields``.

    An integer stands for a float64 array with that number of axes.
    """
    return types.NamedTuple([FLOATS[field] if isinstance(field, int) else field for field in fields], kind)


MODE = record_type(GuardedFlow, 2, 2, 1, 4)
MOTION = record_type(Motion, 2, INTEGERS[1], 3, 1, 2, 1, 2, 1, 2)
TABLES, _HELD = typeof(no_table(1)), typeof(empty(OF_PIECES, 1))
OSCILLATOR, RIGID = (
    record_type(Oscillator, MODE, 2, 2, 1, 1, types.float64, row_type(_HELD), table)
    for table in (row_type(TABLES), types.none)
)
"""Types of records in kernels. TABLES is the type of a batch, all others are types of one record. RIGID has no table of
modes."""


@typeof_impl.register(Machines)
def _(machines: Machines, context: Any) -> types.Type:
    """Hide Machines from kernels, where they are None.

    From these machines Python builds sets of linear equations.

    Also load the functions for machines whose law changes by more than one rigid contact.
    """
    load(modes=True)
    return types.none


@inline_always
def has_modes(oscillator):
    """Return True if the machine is one with modes: its law changes by more than one rigid contact."""
    return oscillator.table.codes.shape[0] > 0


@inline_always
def spend(tally, evaluations):
    """Subtract evaluations from the work that a motion may still do, and set its status if too much is spent.

    ``tally`` (TALLIES,) has the counts of the motion and changes in place. Every leg, the motion between two events,
    costs at least one evaluation. No chain of legs is therefore endless.
    """
    tally[EVALUATIONS] += evaluations
    tally[WORK] -= max(1, evaluations)
    if tally[WORK] < -OVERDRAFT:
        tally[STATUS] = OUT_OF_WORK


@inline_always
def count_contact(tally, contacts, t, stop, speed):
    """Add a contact with a stop at time t to the counts ``tally`` of a motion, and to its records ``contacts`` (K, 3).

    The contact is with an upper stop if ``stop`` > 0, else with a lower one. ``speed`` is the speed before it.
    """
    tally[UPPER if stop > 0 else LOWER] += 1.0
    tally[MIN_SPEED] = min(tally[MIN_SPEED], speed)
    tally[MAX_SPEED] = max(tally[MAX_SPEED], speed)
    tally[SPEEDS] += speed
    write_down(tally, contacts, t, stop, speed)


@inline_always
def write_down_rest(tally, contacts, t, stop, speed, chatter):
    """Record the last resolved impact on a stop before the mass sticks there, and the time at which it begins to stick.

    tally, contacts  counts of the motion, and records of its contacts (K, 3)
    t, stop, speed   time, stop and speed of the impact, as in ``write_down``
    chatter          duration of the remaining hops

    The second record has speed 0.
    """
    write_down(tally, contacts, t, stop, speed)
    write_down(tally, contacts, t + max(chatter, 0.0), stop, 0.0)


@inline_always
def write_down(tally, contacts, t, stop, speed):
    """Record time, stop and speed of a contact in the next row of ``contacts`` (K, 3), if there is room.

    ``tally`` has the number of rows written so far.
    """
    row = int(tally[RECORDED])
    if row < contacts.shape[0]:
        contacts[row, 0], contacts[row, 1], contacts[row, 2] = t, stop, speed
        tally[RECORDED] += 1.0


@kernel
def motion_with(h, mode, V, growth, triangle, record=0, watched=False):
    """Return a motion that starts at state h (n, 2) in the mode of this number, with these tangent vectors.

    V, growth, triangle  tangent vectors and their factors, see Motion
    record               number of impacts to record
    watched              whether to follow the extremes of the gap coordinate

    The mode is the set of linear equations of motion that holds at the start, and h the state of its decoupled
    equations.
    """
    tally = NOTHING_COUNTED.copy()
    tally[WORK] = WORK_OF_A_TRIAL
    modes, extremes = np.empty(1, dtype=np.int64), np.empty(2 if watched else 0)
    modes[0] = mode
    if watched:
        extremes[0], extremes[1] = np.inf, -np.inf
    return Motion(h.copy(), modes, V, growth, triangle, tally, np.zeros((record, 3)), extremes, np.zeros(h.shape))


@kernel
def motion_alone(h, mode):
    """Return a motion without tangent vectors that starts at state h (n, 2) in the mode of this number.

    The mode is the set of linear equations of motion that holds at the start, and h the state of its decoupled
    equations.
    """
    return motion_with(h, mode, np.zeros((0, h.shape[0], 2)), np.zeros(0), np.zeros((0, 0)))


@register_jitable
def axes(n: int) -> NDArray[np.float64]:
    """Return the unit vectors of coordinates of the decoupled equations as 2n tangent vectors (2n, n, 2)."""
    frame = np.zeros((2 * n, n, 2))
    for j in range(n):
        frame[2 * j, j, 0] = frame[2 * j + 1, j, 1] = 1.0
    return frame


@kernel
def cosine_vectors(n):
    """Return 2n orthogonal tangent vectors (2n, n, 2): cos(pi (2i + 1) (2k + 1) / 8n), the cosine transform of type IV.

    The first r vectors are independent in any r of the block coordinates (odd powers of r cosines, Vandermonde's
    determinant). A unit vector, in contrast, stays in one block (one decoupled equation) if blocks do not couple. It is
    lost where that block sticks on a stop.
    """
    frame = np.empty((2 * n, n, 2))
    for i in range(2 * n):
        for k in range(2 * n):
            _, frame[i, k // 2, k % 2] = sin_cos(np.pi * (2 * i + 1) * (2 * k + 1) / (8 * n))
    return frame


def motions_at(
    h: NDArray[np.float64], mode: NDArray[np.int64] | None = None, vectors: int = 0, record: int = 0
) -> Motion:
    """Return a batch of motions that start at states h (N, n, 2) of the decoupled equations, in these modes (N, 1).

    vectors  number of tangent vectors, the first unit vectors of the coordinates h
    record   number of impacts to record

    Modes, the sets of linear equations that hold, are given by number. By default all motions start in free flight.
    """
    N, n = h.shape[:2]
    one = motion_at(np.zeros((n, 2)), FLIGHT, vectors, record)
    many: Motion = map_fields(one, lambda field: field[None].repeat(N, axis=0))
    return many._replace(h=h.copy(), mode=many.mode if mode is None else mode.copy())


def motion_at(h: NDArray[np.float64], mode: int = FLIGHT, vectors: int = 0, record: int = 0) -> Motion:
    """Return a motion that starts at state h (n, 2) of the decoupled equations, in the mode of this number.

    vectors  number of tangent vectors, the first unit vectors of the coordinates h
    record   number of impacts to record

    The mode is the set of linear equations that holds, by default that of free flight.
    """
    V, growth, triangle = axes(len(h))[:vectors], np.zeros(vectors), np.zeros((0, 0))
    motion: Motion = motion_with.py_func(h, mode, V, growth, triangle, record)
    return motion
