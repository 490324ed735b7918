"""One turn of an orbit over its legs and events, with its tangents: what single shooting takes.

A turn begins just before its first event, and each leg ends at one. Today's only event is a rigid impact: its guard is
the gap signal y(t) - stop, its reset h -> h - (1 + R) v k. States are block coordinates h (n, 2), forced response taken
off, so that legs flow by h' = B h + load alone.

Everywhere N orbits of m events in one turn, span (N,).
"""

import math

import numpy as np

from workers.kernel.borrow import borrowed
from workers.kernel.contact import add_columns, kick
from workers.kernel.flow import flow, flow_with_tangent, guard_of, guard_rate_of
from workers.kernel.fma import fma
from workers.kernel.jit import inline_always, kernel
from workers.kernel.motion import axes
from workers.kernel.signal import evaluate
from workers.model.oscillator import COLUMN, NUMBER


@kernel
def turns(gap, tau, q, sign, span, stops, t, start):
    """Turns from ``start`` (N, n, 2) over events at times t (N, m): signals, states, residuals, tangents, shifts.

    signals (N, 3, m)    y and its first two derivatives just before each event
    states (N, m, n, 2)  just after each event
    residuals (N, M)     sign h(end) - start and y(t_i) - stop_i, M = 2n + m
    tangents (N, M, M)   their derivatives [[sign V, sign U], [Hz, Ht]] by start and times, but for what a later end and
                         the start itself add to the first rows: -shifts (N, M, M)
    A turn begins and ends with its first event, later if that is later. q is 1 + R, and sign -1 for symmetric orbits.
    """
    (N, m), n = t.shape, start.shape[1]
    size = 2 * n + m
    signals, states = np.empty((N, 3, m)), np.empty((N, m, n, 2))
    residuals, tangents, shifts = np.empty((N, size)), np.zeros((N, size, size)), np.zeros((N, size, size))
    for r in range(N):
        blocks, omega, h = gap.blocks[r], gap.numbers[r, NUMBER.omega], start[r].copy()
        V = np.zeros((size, n, 2))
        V[: 2 * n] = axes(n)
        begin = now = t[r, 0] if m > 0 else 0.0
        if m > 0:
            V[2 * n] = rate_of(blocks, h, -1.0)
        for i in range(m):
            own = 2 * n + i
            flow_with_tangent(blocks, t[r, i] - now, h, V[: own + 1])
            now = t[r, i]
            y, v, a, _, _ = evaluate(blocks, gap.waves[r], omega, h, 0.0, fma(omega, now, tau[r]), 0.0)
            signals[r, 0, i], signals[r, 1, i], signals[r, 2, i] = y, v, a
            residuals[r, own] = y - stops[r, i]
            for k in range(own + 1):
                tangents[r, own, k] = guard_of(blocks, V[k])
            tangents[r, own, own] += v
            impact(blocks, q[r], v, a, h, V[: own + 1])
            states[r, i] = h
        flow_with_tangent(blocks, span[r] - (now - begin), h, V)
        late = rate_of(blocks, h, sign)
        for j, d in np.ndindex(n, 2):
            row = 2 * j + d
            residuals[r, row], shifts[r, row, row] = sign * h[j, d] - start[r, j, d], 1.0
            if m > 0:
                shifts[r, row, 2 * n] = -late[j, d]
            for k in range(size):
                tangents[r, row, k] = sign * V[k, j, d]
    return signals, states, residuals, tangents, shifts


@inline_always
def rate_of(blocks, h, factor):
    """The derivative (n, 2) of a state in flight, times a factor."""
    found = np.empty(h.shape)
    for j in range(len(blocks)):
        h0, h1, block = h[j, 0], h[j, 1], blocks[j]
        found[j, 0] = factor * h1
        found[j, 1] = factor * (block[COLUMN.load] - 2.0 * block[COLUMN.eta] * h1 - block[COLUMN.lam] * h0)
    return found


@inline_always
def impact(blocks, q, v, a, h, V):
    """Carry a state h (n, 2) and tangents V (K, n, 2) through an impact, in place; the last is that of its own time.

    A time later by dt: the state comes by f- dt, is reset, and goes back by f+ dt, (1 + R) (v A k - a k) dt in all.
    """
    for u in V:
        kick(blocks, u, -q * guard_rate_of(blocks, u))
    add_columns(blocks, V[-1], -q * a, q * v)
    kick(blocks, h, -q * v)


@kernel
def between(gap, tau, sign, span, t, start, states, s):
    """Motions at times s (N, K): states (N, K, n, 2), and the signals y, y', y'' (3, N, K).

    ``start`` and ``states`` as in ``turns``; an event at such a time counts as past.
    """
    blocks, waves, numbers = borrowed(gap.blocks), borrowed(gap.waves), borrowed(gap.numbers)
    (N, K), m = s.shape, t.shape[1]
    found, signals = np.empty((N, K, start.shape[1], 2)), np.empty((3, N, K))
    for r, i in np.ndindex(N, K):
        begin, omega = t[r, 0] if m > 0 else 0.0, numbers[r, NUMBER.omega]
        turn = math.floor((s[r, i] - begin) / span[r])
        since, h = s[r, i] - begin - turn * span[r], start[r].copy()
        event = 0
        while event < m and t[r, event] - begin <= since:
            event += 1
        if event > 0:
            since, h = since - (t[r, event - 1] - begin), states[r, event - 1].copy()
        flow(blocks[r], since, h)
        if turn % 2 != 0:
            h *= sign
        found[r, i] = h
        y, v, a, _, _ = evaluate(blocks[r], waves[r], omega, h, 0.0, fma(omega, s[r, i], tau[r]), 0.0)
        signals[0, r, i], signals[1, r, i], signals[2, r, i] = y, v, a
    return found, signals
