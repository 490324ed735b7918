"""The record of a motion in kernels, and its counts."""

from typing import Any, NamedTuple

import numpy as np
from numba import typeof, types
from numba.extending import register_jitable, typeof_impl
from numpy.typing import NDArray

from workers.kernel.borrow import row_type
from workers.kernel.elementary import sin_cos
from workers.kernel.external import FLOATS, INTEGERS, load
from workers.kernel.jit import inline_always, kernel
from workers.model.hybrid_machines import HybridMachines
from workers.model.hybrid_modes import FLYING, OF_PIECES
from workers.model.mode_table import no_table
from workers.model.oscillator import GuardedFlow, Oscillator, empty, map_fields

FLIGHT = FLYING.number
"""The mode of a machine with one rigid contact is FLIGHT +- ON while a stop holds the gap coordinate, and FLIGHT +-
DETACHED where the motion is on a stop with v = 0, about to leave."""

BEYOND = -1
"""In place of a mode: the motion begins beyond a stop."""

(
    UPPER, LOWER, MIN_SPEED, MAX_SPEED, SPEEDS, LOSS, STUCK,
    EVALUATIONS, WORK, LOST, SPREAD, RECORDED, STATUS, CONTRACTION, PROGRESS, SLID, NEUTRAL, TALLIES,
) = range(18)  # fmt: skip
"""Counts of a motion: impacts per stop, slowest and fastest impact, sum of their speeds, loss of the square of y'; time
at rest; evaluations used and still allowed, directions lost, spread of the frame since it was last orthonormal, impacts
recorded, status. Of machines with modes: log of the change of volume, if no direction is lost; drift of a coordinate,
which is reset at each section, so that this direction is lost; frictions that have slid, a binary digit each; neutral
directions of turns of an orbit, see hybrid.neutral.freeze. An impact that completes a chatter counts as the fastest and
in the loss like any other, but neither at its stop nor in the sum: infinitely many end a chatter. The slowest impact
has speed 0 if a rigid stop has held the mass."""

NOTHING_COUNTED = np.where(np.arange(TALLIES) == MIN_SPEED, np.inf, 0.0)
"""The tally (TALLIES,) of a motion before its start, with no evaluations allowed."""

(
    RUNNING, MARCH_GAVE_UP, OUT_OF_WORK, NOT_FINITE, STARTED_BEYOND,
    MODE_MISSING, NO_MODE, ENDLESS_EVENTS, SIMULTANEOUS, RESONANT_MODE,
) = range(10)  # fmt: skip
"""Status: running, or why a cell cannot continue. Of machines with modes: a mode is not built, or has no valid flow; an
endless chain of events at one time; two rigid contacts reached at once; a mode that resonates undamped."""

OVERDRAFT = 1_000_000
"""Evaluations by which a period may exceed the allowance, so that motions can end at a section."""

WORK_OF_A_TRIAL = 1_000_000
"""Evaluations allowed to a trial: a turn of an orbit, a Newton step."""


class Motion(NamedTuple):
    """State of one cell, everything that ``advance`` changes; records of many have one more leading axis per field.

    h        (n, 2)     block coordinates, forced response taken off
    mode     (1,)       its number, see hybrid_modes.Code and FLIGHT; or BEYOND
    V        (m, n, 2)  tangent vectors, m = 0 for none
    growth   (m,)       log of the growth removed from each vector so far
    triangle (m, m)     factors of tangent.orthonormalise; (0, 0) if not wanted
    tally    (TALLIES,) counts, see UPPER...
    impacts  (K, 3)     the first K impacts: time after the section, side, speed before it, which is 0 where a rest
                        begins, see write_down_rest; K = 0 for none
    extremes (2,)       the least and the greatest y - y0 so far; (0,) if not wanted
    scratch  (n, 2)
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
    """The type of a record in kernels; an integer stands for a float64 array with that many axes."""
    return types.NamedTuple([FLOATS[field] if isinstance(field, int) else field for field in fields], kind)


MODE = record_type(GuardedFlow, 2, 2, 1, 4)
MOTION = record_type(Motion, 2, INTEGERS[1], 3, 1, 2, 1, 2, 1, 2)
TABLES, _HELD = typeof(no_table(1)), typeof(empty(OF_PIECES, 1))
OSCILLATOR, RIGID = (
    record_type(Oscillator, MODE, 2, 2, 1, 1, types.float64, row_type(_HELD), table)
    for table in (row_type(TABLES), types.none)
)
"""Types of records in kernels; TABLES of many, all others of one; RIGID without a table of modes."""


@typeof_impl.register(HybridMachines)
def _(machines: HybridMachines, context: Any) -> types.Type:
    """Hide from kernels the machines from which Python builds modes, and load their functions called by symbol."""
    load(modes=True)
    return types.none


@inline_always
def has_modes(oscillator):
    """Whether a machine has modes: see Oscillator.has_modes."""
    return oscillator.table.codes.shape[0] > 0


@inline_always
def spend(tally, evaluations):
    """Count evaluations; every piece of motion costs at least one, so that no chain of pieces is endless."""
    tally[EVALUATIONS] += evaluations
    tally[WORK] -= max(1, evaluations)
    if tally[WORK] < -OVERDRAFT:
        tally[STATUS] = OUT_OF_WORK


@inline_always
def count_contact(tally, contacts, t, stop, speed):
    """Count and record contact with a stop, the upper one for stop > 0."""
    tally[UPPER if stop > 0 else LOWER] += 1.0
    tally[MIN_SPEED] = min(tally[MIN_SPEED], speed)
    tally[MAX_SPEED] = max(tally[MAX_SPEED], speed)
    tally[SPEEDS] += speed
    write_down(tally, contacts, t, stop, speed)


@inline_always
def write_down_rest(tally, contacts, t, stop, speed, chatter):
    """Record the last impact before a rest and, with speed 0, the start of the rest after the remaining hops."""
    write_down(tally, contacts, t, stop, speed)
    write_down(tally, contacts, t + max(chatter, 0.0), stop, 0.0)


@inline_always
def write_down(tally, contacts, t, stop, speed):
    """Record contact with a stop while contacts (K, 3) has room."""
    row = int(tally[RECORDED])
    if row < contacts.shape[0]:
        contacts[row, 0], contacts[row, 1], contacts[row, 2] = t, stop, speed
        tally[RECORDED] += 1.0


@kernel
def motion_with(h, mode, V, growth, triangle, record=0, watched=False):
    """A motion that starts at block state h (n, 2) in this mode, with these tangent vectors; see Motion."""
    tally = NOTHING_COUNTED.copy()
    tally[WORK] = WORK_OF_A_TRIAL
    modes, extremes = np.empty(1, dtype=np.int64), np.empty(2 if watched else 0)
    modes[0] = mode
    if watched:
        extremes[0], extremes[1] = np.inf, -np.inf
    return Motion(h.copy(), modes, V, growth, triangle, tally, np.zeros((record, 3)), extremes, np.zeros(h.shape))


@kernel
def motion_alone(h, mode):
    """A motion without tangent vectors."""
    return motion_with(h, mode, np.zeros((0, h.shape[0], 2)), np.zeros(0), np.zeros((0, 0)))


@register_jitable
def axes(n: int) -> NDArray[np.float64]:
    """The 2n tangent vectors (2n, n, 2) along the block axes."""
    frame = np.zeros((2 * n, n, 2))
    for j in range(n):
        frame[2 * j, j, 0] = frame[2 * j + 1, j, 1] = 1.0
    return frame


@kernel
def cosine_vectors(n):
    """2n orthogonal tangent vectors (2n, n, 2): cos(pi (2i + 1) (2k + 1) / 8n), the cosine transform of type IV.

    The first r of them are independent in any r of the block axes (odd powers of r cosines, Vandermonde's determinant).
    Where blocks do not couple, an axis sees its own block alone and is lost where a stop holds that one.
    """
    frame = np.empty((2 * n, n, 2))
    for i in range(2 * n):
        for k in range(2 * n):
            _, frame[i, k // 2, k % 2] = sin_cos(np.pi * (2 * i + 1) * (2 * k + 1) / (8 * n))
    return frame


def motions_at(
    h: NDArray[np.float64], mode: NDArray[np.int64] | None = None, vectors: int = 0, record: int = 0
) -> Motion:
    """Motions that start at block states h (N, n, 2) in modes (N, 1); tangent vectors are the block axes."""
    N, n = h.shape[:2]
    one = motion_at(np.zeros((n, 2)), FLIGHT, vectors, record)
    many: Motion = map_fields(one, lambda field: field[None].repeat(N, axis=0))
    return many._replace(h=h.copy(), mode=many.mode if mode is None else mode.copy())


def motion_at(h: NDArray[np.float64], mode: int = FLIGHT, vectors: int = 0, record: int = 0) -> Motion:
    """A motion that starts at block state h (n, 2) in this mode; its tangent vectors are the block axes."""
    V, growth, triangle = axes(len(h))[:vectors], np.zeros(vectors), np.zeros((0, 0))
    motion: Motion = motion_with.py_func(h, mode, V, growth, triangle, record)
    return motion
