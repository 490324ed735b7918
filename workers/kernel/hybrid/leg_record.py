"""Record of the legs of a period; a leg is the motion between two events, in one set of linear equations.

The loop of ``hybrid/motion`` writes the records.
"""

from typing import NamedTuple

from workers.kernel.jit import inline_always, named_constants


class LegRecord(NamedTuple):
    """Columns of the record of one leg, the part of a motion in one mode (set of linear equations) between two events.

    The legs of a period are an array (K, LEG_STATE + 2n + G), with NaN after the last one.

    start            time since the section, the start of the period
    signal           signal at an end of its range at the start of the leg; -1 at the start of a motion or of a phase
    side             the end of its range, +-1; 0 at the start of a motion or of a phase
    rate             rate of that signal
    number           number of the mode, see hybrid_modes.ModeCode
    mode             index of the mode in the table of modes
    duration         time until the next leg
    chatter          first part of the duration, spent hopping, if the leg begins at the end of a chatter

    A phase is a part of the forcing period with constants of its own. The initial state (2n,) and the beginning of each
    of the G signals follow these columns, see ``events.py``.
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
    """Write the record of one leg, the motion between two events, to ``row``, a row of the records of legs.

    z (2n,)              state at the start of the leg
    signal_starts (G,)   for each signal, the end of its range at which it starts, see ``events.py``

    For the other arguments see LegRecord.
    """
    row[LEG.start], row[LEG.signal], row[LEG.side], row[LEG.rate] = t, signal, side, rate
    row[LEG.number], row[LEG.mode], row[LEG.duration], row[LEG.chatter] = number, mode, duration, chatter
    for i in range(len(z)):
        row[LEG_STATE + i] = z[i]
    for g in range(len(signal_starts)):
        row[LEG_STATE + len(z) + g] = signal_starts[g]
