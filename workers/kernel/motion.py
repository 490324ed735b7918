"""A motion as the kernels see it: its record, and what is counted on its way."""

from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import register_jitable, typeof_impl
from numpy.typing import NDArray

from workers.kernel.apart import FLOATS
from workers.kernel.elementary import sin_cos
from workers.kernel.jit import inline_always, kernel
from workers.model.hybrid_machines import HybridMachines
from workers.model.oscillator import Held, Mode, Oscillator, each

FREE, HELD, AT_REST, BEYOND = 0, 1, 2, 3
"""Contact at a section: none; held by a stop (+-1); on it with v = 0, about to leave (+-2); beyond it: no motion."""

(
    UPPER, LOWER, MIN_SPEED, MAX_SPEED, SPEEDS, LOSS, STUCK,
    EVALUATIONS, WORK, LOST, SPREAD, RECORDED, STATUS, CONTRACTION, PROGRESS, SLID, NEUTRAL, TALLIES,
) = range(18)  # fmt: skip
"""What is counted on the way: impacts per stop, slowest and fastest impact, the sum of their speeds, what they take off
the square of y', time at rest; evaluations, evaluations still allowed, directions lost, spread of the frame since it
was last orthonormal, impacts recorded, status; of machines with modes the log of how volume has changed, where no
direction is lost; how far a coordinate has drifted, which is reset at each section, so that this direction is lost;
which frictions have slid, a binary digit each; of turns of an orbit neutral directions, see hybrid.neutral.freeze. An
impact that completes a chatter to rest is the fastest and takes speed off like any other, but is neither counted at its
stop nor summed: their number is infinite. The slowest impact has speed 0 where a rigid stop has held the mass."""

NOTHING_COUNTED = np.where(np.arange(TALLIES) == MIN_SPEED, np.inf, 0.0)
"""The tally (TALLIES,) of a motion that has gone nowhere, and may cost nothing."""

(
    RUNNING, MARCH_GAVE_UP, OUT_OF_WORK, NOT_FINITE, STARTED_BEYOND,
    MODE_MISSING, NO_MODE, ENDLESS_EVENTS, SIMULTANEOUS, RESONANT_MODE,
) = range(10)  # fmt: skip
"""Status: fine, or why a cell cannot go on. Of machines with modes: one is not built, or cannot be; events follow each
other without end at one time; two rigid contacts are reached at once; a mode resonates undamped."""

OVERDRAFT = 1_000_000
"""Evaluations by which a period may exceed what is left, so that motions can end at a section."""

WORK_OF_A_TRIAL = 1_000_000
"""Evaluations allowed to a motion that tries something out: a turn of an orbit, a Newton step."""


class Motion(NamedTuple):
    """One cell on its way, everything that ``advance`` changes; of many cells each field has one more axis in front.

    h        (n, 2)     block coordinates, forced response taken off
    contact  (1,)       FREE, or +-HELD, +-AT_REST with the side's sign
    V        (m, n, 2)  tangent vectors, m = 0 for none
    growth   (m,)       log of the growth taken out of each so far
    triangle (m, m)     what orthonormalisation took out, see there; (0, 0) if not wanted
    tally    (TALLIES,) counts, see UPPER...
    impacts  (K, 3)     the first K impacts: time after the section, side, speed before it, which is 0 where a rest
                        begins, see write_down_rest; K = 0 for none
    extremes (2,)       the least and the greatest y - y0 so far; (0,) if not wanted
    scratch  (n, 2)
    """

    h: NDArray[np.float64]
    contact: NDArray[np.int64]
    V: NDArray[np.float64]
    growth: NDArray[np.float64]
    triangle: NDArray[np.float64]
    tally: NDArray[np.float64]
    impacts: NDArray[np.float64]
    extremes: NDArray[np.float64]
    scratch: NDArray[np.float64]


def _record(kind: type, *fields: int | types.Type) -> types.NamedTuple:
    """The type of a record in kernels; a number stands for a float64 array with that many axes."""
    return types.NamedTuple([FLOATS[field] if isinstance(field, int) else field for field in fields], kind)


MODE = _record(Mode, 2, 2, 1, 4)
HELD_MOTION = _record(Held, MODE, 2, 2, 1)
OSCILLATOR = _record(Oscillator, MODE, 2, 2, 1, 1, types.float64, HELD_MOTION, types.none)
MOTION = _record(Motion, 2, types.Array(types.int64, 1, "C"), 3, 1, 2, 1, 2, 1, 2)
"""Types of records in kernels."""


@typeof_impl.register(HybridMachines)
def _(machines: HybridMachines, context: Any) -> types.Type:
    """What Python alone builds modes from is nothing to kernels."""
    return types.none


@inline_always
def spend(tally, evaluations):
    """Count evaluations; every piece of motion costs one at least, so that no chain of them is endless."""
    tally[EVALUATIONS] += evaluations
    tally[WORK] -= max(1, evaluations)
    if tally[WORK] < -OVERDRAFT:
        tally[STATUS] = OUT_OF_WORK


@inline_always
def count_contact(tally, contacts, t, which, speed):
    """Count that a stop is reached, an upper one for which > 0, and write it down."""
    tally[UPPER if which > 0 else LOWER] += 1.0
    tally[MIN_SPEED] = min(tally[MIN_SPEED], speed)
    tally[MAX_SPEED] = max(tally[MAX_SPEED], speed)
    tally[SPEEDS] += speed
    write_down(tally, contacts, t, which, speed)


@inline_always
def write_down_rest(tally, contacts, t, which, speed, chatter):
    """Write down the last impact before a rest and, with speed 0, when the rest begins: after what is left to hop."""
    write_down(tally, contacts, t, which, speed)
    write_down(tally, contacts, t + max(chatter, 0.0), which, 0.0)


@inline_always
def write_down(tally, contacts, t, which, speed):
    """Write down that a stop is reached while contacts (K, 3) have room."""
    row = int(tally[RECORDED])
    if row < contacts.shape[0]:
        contacts[row, 0], contacts[row, 1], contacts[row, 2] = t, which, speed
        tally[RECORDED] += 1.0


@kernel
def motion_with(h, contact, V, growth, triangle, record=0, watched=False):
    """A motion that starts at block state h (n, 2) with this contact and these tangent vectors; see Motion."""
    tally = NOTHING_COUNTED.copy()
    tally[WORK] = WORK_OF_A_TRIAL
    contacts, extremes = np.empty(1, dtype=np.int64), np.empty(2 if watched else 0)
    contacts[0] = contact
    if watched:
        extremes[0], extremes[1] = np.inf, -np.inf
    return Motion(h.copy(), contacts, V, growth, triangle, tally, np.zeros((record, 3)), extremes, np.zeros(h.shape))


@kernel
def motion_alone(h, contact):
    """A motion without tangent vectors."""
    return motion_with(h, contact, np.zeros((0, h.shape[0], 2)), np.zeros(0), np.zeros((0, 0)))


@register_jitable
def axes(n: int) -> NDArray[np.float64]:
    """The 2n tangent vectors (2n, n, 2) along the block axes."""
    frame = np.zeros((2 * n, n, 2))
    for j in range(n):
        frame[2 * j, j, 0] = frame[2 * j + 1, j, 1] = 1.0
    return frame


@kernel
def slanted(n):
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
    h: NDArray[np.float64], contact: NDArray[np.int64] | None = None, vectors: int = 0, record: int = 0
) -> Motion:
    """Motions that start at block states h (N, n, 2) with contacts (N, 1); tangent vectors are the block axes."""
    N, n = h.shape[:2]
    one = motion_at(np.zeros((n, 2)), FREE, vectors, record)
    many: Motion = each(one, lambda field: field[None].repeat(N, axis=0))
    return many._replace(h=h.copy(), contact=many.contact if contact is None else contact.copy())


def motion_at(h: NDArray[np.float64], contact: int = FREE, vectors: int = 0, record: int = 0) -> Motion:
    """A motion that starts at block state h (n, 2) with this contact; its tangent vectors are the block axes."""
    found: Motion = motion_with.py_func(h, contact, axes(len(h))[:vectors], np.zeros(vectors), np.zeros((0, 0)), record)
    return found
