"""Motion of one mass that comes to rest on a stop: it depends only on the release from the stop, and so repeats."""

import numpy as np

from workers.kernel.borrow import borrow, row_of
from workers.kernel.by_reference import by_reference
from workers.kernel.cell_loops import scale_of
from workers.kernel.jit import inline_always, kernel
from workers.kernel.linalg import copy_into
from workers.kernel.motion import FLIGHT, LOST, RUNNING, STATUS, axes, motion_with
from workers.kernel.period import advance
from workers.model.hybrid_modes import ON
from workers.orbit.map import separation, squares

FOLLOWED = 1e10
"""Maximum growth of a disturbance from a release to the next rest, by the norm of all tangent vectors. Rounding is
still small compared with the motion then."""

SAME_RELEASE = 1e-6
"""Maximum distance, in units of the motion's scale, of two sections after the same release."""

RELEASES = 16
"""Maximum number of releases compared with a section: as many as phases at which the load on a stop ends."""


@inline_always
def pass_period(oscillator, motion, rests):
    """Advance a motion by a period, in place.

    Return two truth values. The first is True if the mass rests on the stop at the end of the period. The second is
    True if the mass was released, for the first time after a rest, in the period. ``rests`` is True if the motion
    rested before. After a release the tangent vectors are reset to unit vectors.
    """
    motion.tally[LOST] = 0.0
    advance(oscillator, motion)
    rests = rests or motion.tally[LOST] >= 2.0
    released = rests and abs(motion.mode[0] - FLIGHT) != ON
    if released:
        copy_into(motion.V, axes(motion.h.shape[0]))
    return rests and not released, released


@inline_always
def is_followed(oscillator, h, mode, periods):
    """Return True if doubles can follow an orbit that comes to rest on a stop from a release to the next rest.

    h, mode  (n, 2) state of the decoupled equations and number of the mode (set of linear equations) on the orbit
    periods  period of the orbit

    Disturbances at a release must grow less than FOLLOWED times until the next rest.
    """
    motion = motion_with(h, mode, axes(h.shape[0]), np.zeros(0), np.zeros((0, 0)))
    rests = begun = False
    for _ in range(2 * periods):
        rests, released = pass_period(oscillator, borrow(motion), rests)
        begun = begun or released
        if motion.tally[STATUS] != RUNNING or (begun and not squares(motion.V) < FOLLOWED**2):
            return False
    return True


@kernel
def rest_to_rest(oscillators, motions, cells, sections, counts):
    """Advance these motions of one mass, in place, until the mass is released from a stop as it was released before.

    oscillators  N machines
    motions      batch of their motions
    cells        rows of the motions to advance
    sections     (N, K, n, 2) written: states at t = k T between the two releases, at the end of each row
    counts       (N,) written: number of these states

    ``counts`` is 0 if a motion does not repeat a release in K - 1 periods. It is also 0 if a disturbance grows FOLLOWED
    times on the way, so that doubles cannot decide. Return the number of periods flown (N,).
    """
    oscillators, motions = by_reference(oscillators), by_reference(motions)
    flown = np.zeros(len(sections), dtype=np.int64)
    K = sections.shape[1]
    for r in cells:
        osc, row = row_of(oscillators, r), row_of(motions, r)
        n, counts[r] = row.h.shape[0], 0
        scale = scale_of(osc.gap.blocks, row.h)
        motion = motion_with(row.h, row.mode[0], axes(n), np.zeros(0), np.zeros((0, 0)))
        states, modes = np.empty((K, n, 2)), np.empty(K, dtype=np.int64)
        releases = np.empty(RELEASES, dtype=np.int64)
        known = count = 0
        rests = False
        while flown[r] < K - 1 and counts[r] == 0:
            rests, released = pass_period(osc, borrow(motion), rests)
            flown[r] += 1
            if motion.tally[STATUS] != RUNNING:
                break
            copy_into(states[count], motion.h)
            modes[count] = motion.mode[0]
            if released:
                for e in range(known):
                    k = releases[e]
                    near = separation(osc.gap.blocks, states[k], states[count]) < SAME_RELEASE * scale
                    if counts[r] == 0 and near and modes[k] == modes[count]:
                        counts[r] = count - k + 1
                if known < RELEASES:
                    releases[known] = count
                    known += 1
            elif not squares(motion.V) < FOLLOWED**2:
                known = count = 0
            count += int(known > 0)
        for k in range(counts[r]):
            copy_into(sections[r, K - counts[r] + k], states[count - counts[r] + k])
        copy_into(row.h, motion.h)
        row.mode[0] = motion.mode[0]
    return flown
