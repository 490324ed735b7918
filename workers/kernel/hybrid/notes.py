"""What the one loop of motion.py writes down of a period: its legs, each with the event that it begins with."""

from typing import NamedTuple

from workers.kernel.jit import inline_always, named_constants


class LegRecord(NamedTuple):
    """What is written down of a motion in one mode, as columns of legs (K, LEG_STATE + 2n + G); NaN after the last one.

    start            time since the section
    signal, side     signal that has reached an end of its range then, and which: -1 and 0 at the start and where the
                     phase changes
    rate             of that signal
    number, mode     of the mode: see hybrid_modes.Code; its place in the table
    duration         until the next leg
    chatter          the first part of that which it spends hopping, where it begins at the end of a chatter
    The state (2n,) that it starts from follows, and how each of its G signals begins: see events.py.
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
"""Column of the first component of the state that a leg starts from."""


@inline_always
def note(row, t, signal, side, rate, number, mode, duration, chatter, z, begun):
    """Write a leg down, see Leg."""
    row[LEG.start], row[LEG.signal], row[LEG.side], row[LEG.rate] = t, signal, side, rate
    row[LEG.number], row[LEG.mode], row[LEG.duration], row[LEG.chatter] = number, mode, duration, chatter
    for i in range(len(z)):
        row[LEG_STATE + i] = z[i]
    for g in range(len(begun)):
        row[LEG_STATE + len(z) + g] = begun[g]
