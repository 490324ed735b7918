"""The motion of orbits as sums of the answers to their kicks, compiled: what their equations are made of.

Everywhere lin is a record of N oscillators, span (N,) the length of a turn, sign what kicks are multiplied by from turn
to turn, and t, v (N, m) the times and signed speeds of impacts.
"""

import math

import numpy as np

from workers.continuation.green import add_green, answer, is_balanced, repeated
from workers.continuation.linear import flow_entries, forced
from workers.kernel.jit import kernel


@kernel
def pair_answers(lin, span, zeta, t):
    """g, g', g'' (3, N, m, m) at impact i of the kicks at impact j, which are multiplied by zeta from turn to turn.

    Kicks are the latest before impact i, its own one turn ago. Impacts are ordered as in the itinerary, so that this is
    smooth in the times whatever they are.
    """
    N, m = t.shape
    found = np.full((3, N, m, m), 0.0 * zeta)
    total, since = np.full((4, m * m), 0.0 * zeta), np.empty(m * m)
    for r in range(N):
        for i in range(m):
            for j in range(m):
                since[i * m + j] = t[r, i] - t[r, j] + (span[r] if i <= j else 0.0)
        total[:] = 0.0
        add_green(lin, r, span[r], zeta, since, total)
        for i in range(m):
            for j in range(m):
                factor = 1.0 / zeta if i <= j else 1.0 + 0.0 * zeta
                for d in range(3):
                    found[d, r, i, j] = factor * total[d, i * m + j]
    return found


@kernel
def before_impacts(lin, span, sign, t, v, offset):
    """y, y' and y'' (3, N, m) just before each impact; offset (N,) of y is that of a rigid mode."""
    N, m = t.shape
    pairs = pair_answers(lin, span, sign, t)
    found = np.empty((3, N, m))
    for r in range(N):
        for i in range(m):
            y, speed, bend, _ = forced(lin, r, t[r, i])
            found[0, r, i], found[1, r, i], found[2, r, i] = y + offset[r], speed, bend
            for d in range(3):
                total = 0.0
                for j in range(m):
                    total += pairs[d, r, i, j] * v[r, j]
                found[d, r, i] -= (1.0 + lin.R[r]) * total
    return found


@kernel
def linearised_table(lin, span, sign, z, t, v, offset, rigid):
    """J_z (N, M, M) of ``equations.linearised``; rigid is the block of a rigid mode that borders it, -1 where none."""
    N, m = t.shape
    before = before_impacts(lin, span, sign, t, v, offset)
    pairs = pair_answers(lin, span, sign * z, t)
    size = 2 * m + (1 if rigid >= 0 else 0)
    J = np.full((N, size, size), 0.0 * z)
    for r in range(N):
        q = 1.0 + lin.R[r]
        for i in range(m):
            for j in range(m):
                J[r, i, j], J[r, i, m + j] = q * pairs[1, r, i, j] * v[r, j], -q * pairs[0, r, i, j]
                J[r, m + i, j], J[r, m + i, m + j] = q * pairs[2, r, i, j] * v[r, j], -q * pairs[1, r, i, j]
            J[r, i, i] += before[1, r, i]
            J[r, m + i, i] += before[2, r, i]
            J[r, m + i, m + i] -= 1.0
            if rigid >= 0:
                J[r, i, size - 1] = 1.0
                J[r, size - 1, m + i] = q * lin.k[r, rigid, 1]
    return J


@kernel
def latest_kick(span, sign, t, r, s, i):
    """Of impact i the time since its latest kick before time s and what that is multiplied by; and sign^turns of s."""
    turns = math.floor((s - t[r, 0]) / span)
    local = s - turns * span
    flip = 1.0 if turns % 2 == 0 else sign
    if local < t[r, i]:
        return local - t[r, i] + span, flip * sign, flip
    return local - t[r, i], flip, flip


@kernel
def between_impacts(lin, span, sign, t, v, offset, s):
    """y and its first three derivatives (4, N, K) at times s (N, K), any times but those of impacts."""
    N, m = t.shape
    found = np.empty((4, N, s.shape[1]))
    total, since = np.empty((4, 1)), np.empty(1)
    for r in range(N):
        for p in range(s.shape[1]):
            y, speed, bend, jerk = forced(lin, r, s[r, p])
            found[0, r, p], found[1, r, p], found[2, r, p], found[3, r, p] = y, speed, bend, jerk
            flip = 1.0
            for i in range(m):
                since[0], weight, flip = latest_kick(span[r], sign, t, r, s[r, p], i)
                total[:] = 0.0
                add_green(lin, r, span[r], sign, since, total)
                for d in range(4):
                    found[d, r, p] -= (1.0 + lin.R[r]) * weight * total[d, 0] * v[r, i]
            found[0, r, p] += offset[r] * flip
    return found


@kernel
def blocks_between(lin, span, sign, t, v, offset, s):
    """h and h' (2, N, n, K) of the blocks at times s (N, K), forced response and rest position taken off."""
    N, m = t.shape
    n, K = lin.eta.shape[1], s.shape[1]
    found = np.zeros((2, N, n, K))
    for r in range(N):
        for j in range(n):
            eta, lam, k1 = lin.eta[r, j], lin.lam[r, j], lin.k[r, j, 1]
            first, balanced = repeated(lin, r, j, span[r], sign), is_balanced(lin, r, j, sign)
            for p in range(K):
                flip = 1.0
                for i in range(m):
                    since, weight, flip = latest_kick(span[r], sign, t, r, s[r, p], i)
                    h, rate = answer(eta, lam, k1, span[r], balanced, first, since)
                    found[0, r, j, p] -= (1.0 + lin.R[r]) * weight * v[r, i] * h
                    found[1, r, j, p] -= (1.0 + lin.R[r]) * weight * v[r, i] * rate
                if lin.lam[r, j] == 0.0 and m > 0:
                    found[0, r, j, p] += offset[r] * flip / lin.c[r, j, 0]
    return found


@kernel
def flights(lin, s):
    """e^(A s) (N, K, 2n, 2n) of times s (N, K)."""
    N, K = s.shape
    n = lin.eta.shape[1]
    E = np.zeros((N, K, 2 * n, 2 * n))
    for r in range(N):
        for p in range(K):
            for j in range(n):
                f11, f12, f21, f22 = flow_entries(lin.eta[r, j], lin.lam[r, j], s[r, p])
                E[r, p, 2 * j, 2 * j], E[r, p, 2 * j, 2 * j + 1] = f11, f12
                E[r, p, 2 * j + 1, 2 * j], E[r, p, 2 * j + 1, 2 * j + 1] = f21, f22
    return E
