"""Records of a period by the one loop of motion.py: its legs, each with the event that begins it."""

from typing import NamedTuple

from workers.kernel.jit import inline_always, named_constants


class LegRecord(NamedTuple):
    """One leg of a motion, within one mode, as columns of legs (K, LEG_STATE + 2n + G); NaN after the last leg.

    start            time since the section
    signal, side     signal at an end of its range at the start of the leg, and which end; -1 and 0 at the start of a
                     motion or phase
    rate             of that signal
    number, mode     number of the mode, see hybrid_modes.Code, and its slot in the table
    duration         until the next leg
    chatter          the first part of the duration, spent hopping, if it begins at the end of a chatter
    Then follow the initial state (2n,) and the beginning of each of the G signals: see events.py.
    """

    start: int
    signal: int
    side: int
    rate: int
    number: int
    mode: int
    duration: int
    chatter: int


LEG = LegRecord(*range(len(LegRecord._fields)))
named_constants(LegRecord)
LEG_STATE = len(LEG)
"""Column of the first component of a leg's initial state."""


@inline_always
def write_leg(row, t, signal, side, rate, number, mode, duration, chatter, z, signal_starts):
    """Record a leg, see LegRecord."""
    row[LEG.start], row[LEG.signal], row[LEG.side], row[LEG.rate] = t, signal, side, rate
    row[LEG.number], row[LEG.mode], row[LEG.duration], row[LEG.chatter] = number, mode, duration, chatter
    for i in range(len(z)):
        row[LEG_STATE + i] = z[i]
    for g in range(len(signal_starts)):
        row[LEG_STATE + len(z) + g] = signal_starts[g]
