"""The orbit of machines with phases alone: their map is affine, z -> J z + c, so that it is known for all states."""

import numpy as np

from workers.kernel.borrow import row_of
from workers.kernel.jit import kernel
from workers.kernel.lend import lend
from workers.kernel.linalg import highest, sort_down
from workers.kernel.motion import RUNNING, STATUS
from workers.model.hybrid import FIRST_NUMBER
from workers.orbit.floquet import floquet
from workers.orbit.map import FixedPoint, copy_into, map_with_jacobian
from workers.orbit.newton import CYCLES, corrected

UNKNOWN, ATTRACTS, REPELS = range(3)
"""What is known of the one orbit of such a machine: nothing, that all motion falls into it, or that almost none stays
near it."""


@kernel
def linear_orbits(oscillators, cells, orbits, spent):
    """Whether the orbit z = (I - J)^-1 c of each of these machines without contacts and friction attracts or repels.

    It is written into the rows of ``orbits`` of these cells, and the periods that this took into spent (N,). UNKNOWN
    where its largest multiplier is one to rounding.
    """
    oscillators, orbits = lend(oscillators), lend(orbits)
    found = np.empty(len(cells), dtype=np.int64)
    contact, steps, half = np.int64(FIRST_NUMBER), np.int64(1), np.bool_(False)  # no literals, as in run_batch
    for e in range(len(cells)):
        r = cells[e]
        osc = row_of(oscillators, r)
        found[e] = UNKNOWN
        start = np.zeros(orbits.h[r].shape)
        first, J = map_with_jacobian(osc, start, contact, steps, half)
        h = corrected(start, first.h, J)
        if first.tally[STATUS] != RUNNING or not np.all(np.isfinite(h)):
            continue
        turn, J = map_with_jacobian(osc, h, contact, steps, half)
        point = FixedPoint(h, turn.h, turn.contact[0], J, 0.0)
        logs, rounding, turns = floquet(osc, point, steps, half, CYCLES)
        spent[r] = 2 + turns
        largest = highest(logs, 0, len(logs))
        if turns == 0 or not abs(largest) > rounding:
            continue
        found[e] = ATTRACTS if largest < 0.0 else REPELS
        sort_down(logs)
        orbits.contact[r, 0], orbits.period[r], orbits.error[r] = contact, 1, rounding
        copy_into(orbits.h[r], h)
        copy_into(orbits.tally[r], turn.tally)
        copy_into(orbits.exponents[r], logs)
    return found
