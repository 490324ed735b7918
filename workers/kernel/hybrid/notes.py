"""What the one loop of motion.py writes down of a period: its events, and its legs from event to event."""

from typing import NamedTuple

from workers.kernel.jit import inline_always


class Leg(NamedTuple):
    """What is written down of a motion in one mode, as columns: when it starts and how long it lasts, which mode of the
    table it is in, and the signal that ends it, -1 for the time or a phase.
    """

    start: int
    duration: int
    mode: int
    signal: int


LEG = Leg(*range(len(Leg._fields)))
LEG_STATE = len(LEG)
"""Column of the first component of the state that a leg starts from."""

NOTED = 5
"""Numbers written of an event before the numbers of the signals."""


@inline_always
def note(row, t, signal, side, rate, number, begun):
    """Write down what has happened, see through_modes."""
    row[0], row[1], row[2], row[3], row[4] = t, signal, side, rate, number
    row[NOTED:] = begun


@inline_always
def note_leg(legs, place, t, s, k, hit, z):
    """Write a leg down while there is room in legs (K, LEG_STATE + 2n); the place of the next one."""
    if place < legs.shape[0]:
        legs[place, LEG.start], legs[place, LEG.duration] = t, s
        legs[place, LEG.mode], legs[place, LEG.signal] = k, hit
        for i in range(len(z)):
            legs[place, LEG_STATE + i] = z[i]
    return place + 1
