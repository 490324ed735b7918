"""Motion of one mass from rest to rest: what it does after a rest depends on its release alone, so that it repeats."""

import math

import numpy as np

from workers.kernel.borrow import borrowed
from workers.kernel.cells import scale_of
from workers.kernel.jit import inline_always, kernel, kernel_within
from workers.kernel.motion import HELD, LOST, RUNNING, STATUS, axes, motion_of, motion_with, oscillator_of
from workers.kernel.period import advance
from workers.orbit.map import separation

FOLLOWED = 1e10
"""How far a disturbance may grow from a release to the next rest: rounding is still small beside the motion then."""

SAME_RELEASE = 1e-6
"""Distance, relative to the motion's scale, of two sections that follow the same release."""

RELEASES = 16
"""Releases that a section is compared with: there are as many as the load on a stop has phases at which it ends."""


@kernel
def growth_of(V):
    """The norm of the tangent vectors (2n, n, 2): the largest factor by which a disturbance may have grown."""
    square = 0.0
    for vector in V:
        for block in vector:
            square += block[0] * block[0] + block[1] * block[1]
    return math.sqrt(square)


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
        fresh = axes(motion.h.shape[0])
        for i in range(fresh.shape[0]):
            for j in range(fresh.shape[1]):
                motion.V[i, j, 0], motion.V[i, j, 1] = fresh[i, j, 0], fresh[i, j, 1]
    return rests and not released, released


@kernel_within
def is_followed(osc, h, contact, periods):
    """Whether disturbances grow less than FOLLOWED times between a release and the next rest of this orbit."""
    osc = borrowed(osc)
    motion = motion_with(h, contact, axes(h.shape[0]), np.zeros(0), np.zeros((0, 0)))
    rests = begun = False
    for _ in range(2 * periods):
        rests, released = pass_period(osc, borrowed(motion), rests)
        begun = begun or released
        if motion.tally[STATUS] != RUNNING or (begun and not growth_of(motion.V) < FOLLOWED):
            return False
    return True


@kernel
def rest_to_rest(oscillators, motions, cells, sections, kept):
    """Take these motions of one mass, in place, to a section after a release that they have met before.

    sections (N, K, n, 2) keep the states from there to there, ``kept`` (N,) of them, the last ones of each row; 0 where
    a motion does not come to such a section in K - 1 periods, or a disturbance grows FOLLOWED times on the way, where
    doubles cannot tell whether it does. Returns the periods gone (N,).
    """
    gone = np.zeros(len(oscillators.tau), dtype=np.int64)
    K = sections.shape[1]
    for r in cells:
        osc, moved = borrowed(oscillator_of(oscillators, r)), motion_of(motions, r)
        n, kept[r] = moved.h.shape[0], 0
        scale = scale_of(osc, moved.h)
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
            for j in range(n):
                states[count, j, 0], states[count, j, 1] = motion.h[j, 0], motion.h[j, 1]
            contacts[count] = motion.contact[0]
            if released:
                for e in range(known):
                    k = releases[e]
                    near = separation(osc.gap.metric, states[k], states[count]) < SAME_RELEASE * scale
                    if kept[r] == 0 and near and contacts[k] == contacts[count]:
                        kept[r] = count - k + 1
                if known < RELEASES:
                    releases[known] = count
                    known += 1
            elif not growth_of(motion.V) < FOLLOWED:
                known = count = 0
            count += int(known > 0)
        for k in range(kept[r]):
            for j in range(n):
                state = states[count - kept[r] + k]
                sections[r, K - kept[r] + k, j, 0], sections[r, K - kept[r] + k, j, 1] = state[j, 0], state[j, 1]
        moved.contact[0] = motion.contact[0]
        for j in range(n):
            moved.h[j, 0], moved.h[j, 1] = motion.h[j, 0], motion.h[j, 1]
    return gone
