"""Motion of one mass from rest to rest: it depends on the release alone, and so repeats."""

import numpy as np

from workers.kernel.borrow import borrowed, row_of
from workers.kernel.cells import scale_of
from workers.kernel.jit import inline_always, kernel
from workers.kernel.lend import lend
from workers.kernel.linalg import copy_into
from workers.kernel.motion import HELD, LOST, RUNNING, STATUS, axes, motion_with
from workers.kernel.period import advance
from workers.orbit.map import separation, squares

FOLLOWED = 1e10
"""How far a disturbance may grow from a release to the next rest, by the norm of all tangent vectors: rounding is still
small beside the motion then."""

SAME_RELEASE = 1e-6
"""Distance, relative to the motion's scale, of two sections that follow the same release."""

RELEASES = 16
"""Releases that a section is compared with: there are as many as the load on a stop has phases at which it ends."""


@inline_always
def pass_period(osc, motion, rests):
    """Take a motion on by a period: whether it rests at its end, and whether that is the first section after a rest.

    ``rests`` says whether it did before. From a section after a rest on tangent vectors are the block axes again.
    """
    motion.tally[LOST] = 0.0
    advance(osc, motion)
    rests = rests or motion.tally[LOST] >= 2.0
    released = rests and abs(motion.contact[0]) != HELD
    if released:
        copy_into(motion.V, axes(motion.h.shape[0]))
    return rests and not released, released


@inline_always
def is_followed(osc, h, contact, periods):
    """Whether disturbances grow less than FOLLOWED times between a release and the next rest of this orbit."""
    motion = motion_with(h, contact, axes(h.shape[0]), np.zeros(0), np.zeros((0, 0)))
    rests = begun = False
    for _ in range(2 * periods):
        rests, released = pass_period(osc, borrowed(motion), rests)
        begun = begun or released
        if motion.tally[STATUS] != RUNNING or (begun and not squares(motion.V) < FOLLOWED**2):
            return False
    return True


@kernel
def rest_to_rest(oscillators, motions, cells, sections, kept):
    """Take these motions of one mass, in place, to a section after a release that they have met before.

    sections (N, K, n, 2) keep the states from there to there, ``kept`` (N,) of them, the last ones of each row; 0 where
    a motion does not come to such a section in K - 1 periods, or a disturbance grows FOLLOWED times on the way, where
    doubles cannot tell whether it does. Returns the periods gone (N,).
    """
    oscillators, motions = lend(oscillators), lend(motions)
    gone = np.zeros(len(sections), dtype=np.int64)
    K = sections.shape[1]
    for r in cells:
        osc, moved = row_of(oscillators, r), row_of(motions, r)
        n, kept[r] = moved.h.shape[0], 0
        scale = scale_of(osc.gap.blocks, moved.h)
        motion = motion_with(moved.h, moved.contact[0], axes(n), np.zeros(0), np.zeros((0, 0)))
        states, contacts = np.empty((K, n, 2)), np.empty(K, dtype=np.int64)
        releases = np.empty(RELEASES, dtype=np.int64)
        known = count = 0
        rests = False
        while gone[r] < K - 1 and kept[r] == 0:
            rests, released = pass_period(osc, borrowed(motion), rests)
            gone[r] += 1
            if motion.tally[STATUS] != RUNNING:
                break
            copy_into(states[count], motion.h)
            contacts[count] = motion.contact[0]
            if released:
                for e in range(known):
                    k = releases[e]
                    near = separation(osc.gap.blocks, states[k], states[count]) < SAME_RELEASE * scale
                    if kept[r] == 0 and near and contacts[k] == contacts[count]:
                        kept[r] = count - k + 1
                if known < RELEASES:
                    releases[known] = count
                    known += 1
            elif not squares(motion.V) < FOLLOWED**2:
                known = count = 0
            count += int(known > 0)
        for k in range(kept[r]):
            copy_into(sections[r, K - kept[r] + k], states[count - kept[r] + k])
        copy_into(moved.h, motion.h)
        moved.contact[0] = motion.contact[0]
    return gone
