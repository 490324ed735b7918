"""The section of an orbit's proof: instants t = (k + shift) T, near which the motion meets no stop and leaves none.

Results refer to the section t = k T. An orbit may impact there, as many closed forms do. Rounding then decides, in each
turn, whether the impact comes before or after the section, and the map is not smooth. Period, impacts and multipliers
of an orbit are the same on every section.
"""

import math

from workers.kernel.by_reference import with_phase
from workers.kernel.jit import inline_always, kernel
from workers.kernel.motion import MAX_SPEED, RUNNING, STATUS, has_modes, motion_alone
from workers.kernel.period import propagate
from workers.model.oscillator import HEAD

SHIFT = 0.3819660112501051
"""Shift of the first section tried, by the golden ratio; the next ones are multiples of it modulo one period."""

MARGIN = 1.0 / 1024.0
"""Share of a period before and after a section that must be free of events."""

MAX_ATTEMPTS = 4
"""Maximum number of sections tried; the last one is taken in any case."""

PAST_SECTION = 1e-12
"""Share of a period after the section t = k T within which an impact counts as past."""


@inline_always
def seen_later(oscillator, shift):
    """Return the oscillator as seen from the instants t = (k + shift) T: its forcing phase is moved by shift.

    For machines whose law changes by more than one rigid contact ``shift`` is 0, see quiet_section.
    """
    return with_phase(oscillator, oscillator.tau + 2.0 * math.pi * shift)


@kernel
def motion_after(oscillator, h, mode, shift):
    """Return the motion after ``shift`` < 1 periods, from state h (n, 2) in the mode of this number.

    The mode is the set of linear equations of motion that holds, and h the state of its decoupled equations.
    """
    motion = motion_alone(h, mode)
    propagate(oscillator, motion, shift * oscillator.head[HEAD.period])
    return motion


@kernel
def quiet_section(oscillator, h, mode):
    """Return instants t = (k + shift) T near which the motion has no events, as (shift, h, mode, periods flown).

    The arguments h (n, 2) and mode are state of the decoupled equations and number of the mode (set of linear
    equations) at t = 0, the results those at t = shift T. For machines with modes the shift is 0.
    """
    if has_modes(oscillator):
        return 0.0, h.copy(), mode, 0
    shift, state, at, tries = 0.0, h.copy(), mode, 0
    for tries in range(1, MAX_ATTEMPTS + 1):
        shift = tries * SHIFT - math.floor(tries * SHIFT)
        motion = motion_after(oscillator, h, mode, shift - MARGIN)
        before = motion.mode[0]
        motion.tally[MAX_SPEED] = 0.0
        propagate(seen_later(oscillator, shift - MARGIN), motion, MARGIN * oscillator.head[HEAD.period])
        state, at = motion.h.copy(), motion.mode[0]
        propagate(seen_later(oscillator, shift), motion, MARGIN * oscillator.head[HEAD.period])
        same = before == at and at == motion.mode[0]
        if same and motion.tally[MAX_SPEED] == 0.0 and motion.tally[STATUS] == RUNNING:
            break
    return shift, state, at, tries


@inline_always
def back_at_section(oscillator, shift, h, mode):
    """Return the motion at the next instant t = k T, from state h (n, 2) at t = (k - 1 + shift) T.

    h is the state of the decoupled equations of motion, and ``mode`` the number of the set of equations that holds at
    the start. An impact at the end counts as past, also if rounding delays it by up to PAST_SECTION T.
    """
    motion = motion_after(seen_later(oscillator, shift), h, mode, 1.0 - shift)
    after = motion_after(oscillator, motion.h, motion.mode[0], PAST_SECTION)
    return after if after.tally[MAX_SPEED] > 0.0 else motion
