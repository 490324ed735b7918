"""Impacts: the restitution law and its saltation matrix, the end of chatter, motion on a stop, release."""

import numpy as np

from workers.kernel.borrow import borrowed
from workers.kernel.crossing import next_crossing
from workers.kernel.flow import flow, flow_with_tangent, guard_of, guard_rate_of
from workers.kernel.hybrid.state import enter, enter_frame, leave, leave_frame, product, turn_to, turned, wave
from workers.kernel.jit import inline_always, inlined, kernel
from workers.kernel.lend import lend
from workers.kernel.tangent import graded_flow
from workers.model.oscillator import COLUMN, HEAD, NUMBER, Mode

REBOUND, REST, LEAVE = range(3)
"""Outcomes of an impact: rebound; rest on the stop; v = 0 while the load pulls away (R = 0)."""

EPS = float(np.finfo(np.float64).eps)

ENDING, BRIEF = 1e-4, 1.0 / 64.0
"""Lanes leave the rest of a chatter to another kernel, which follows hops more exactly (chatter.hop), once the load
changes in that rest by this share of it, or the rest lasts this share of the period."""

ONLY = np.int64(0)
"""The place of the mode in which a stop holds among Oscillator.held."""

SHORTEST_HOP = 1e-11
"""Share of a forcing period below which a hop counts as rounding."""


@inlined
def load_at_rest(side, v, a, cA2k):
    """side * (a - cA^2k v): the acceleration that presses the mass on the stop once v is removed."""
    return side * (a - cA2k * v)


@inlined
def hop_is_rounding(load, w, scale, period):
    """Whether a hop at speed w under this load is too low, w^2 / (2 load) < 1e4 eps scale, or too short to be seen.

    Motion that decays to an equilibrium on a stop hops under a load of rounding size: it never rests, and its squares
    may underflow, where a comparison with zero fails.
    """
    return w * w < 2e4 * load * EPS * scale or 2.0 * w < SHORTEST_HOP * period * load


@inlined
def outcome(load, v, R, scale, period):
    """Outcome of an impact at velocity v under a load on the stop, see load_at_rest.

    R = 0: rest if the load presses, load > 0, else release. 0 < R < 1: chatter is followed hop by hop until hops are
    below rounding, where ``scale`` is the sum of moduli that add up to y; the remainder ends at chatter.chatter_end,
    with a third-order error of the state. R = 1 never completes.
    """
    if R == 0.0:
        return REST if load > 0.0 else LEAVE
    return REST if load > 0.0 and R < 1.0 and hop_is_rounding(load, R * abs(v), scale, period) else REBOUND


@inlined
def is_rebound(load, v, R, cA2k, scale, remaining, period):
    """Whether an impact at velocity v rebounds and ends no chatter."""
    w = R * abs(v)
    change, pressing = 2.0 * abs(cA2k * v), load * (1.0 - R)
    slow = (change > ENDING * load and 2.0 * w > BRIEF * period * pressing) or 2.0 * w > remaining * pressing
    return R > 0.0 and (load <= 0.0 or R == 1.0 or (slow and not hop_is_rounding(load, w, scale, period)))


@inlined
def kick(blocks, h, dv):
    """Change the velocity of the gap coordinate by dv: z + dv k, in place."""
    for j in range(len(blocks)):
        h[j, 0] += dv * blocks[j, COLUMN.k0]
        h[j, 1] += dv * blocks[j, COLUMN.k1]


@inlined
def shift(blocks, h, dy):
    """Move the gap coordinate by a rounding error dy: z + dy A k, in place; c.A k = 1."""
    for j in range(len(blocks)):
        h[j, 0] += dy * blocks[j, COLUMN.Ak0]
        h[j, 1] += dy * blocks[j, COLUMN.Ak1]


@inlined
def add_columns(blocks, u, along_k, along_Ak):
    """Add along_k k + along_Ak A k to a tangent vector u (n, 2), in place."""
    for j in range(len(blocks)):
        u[j, 0] += along_k * blocks[j, COLUMN.k0] + along_Ak * blocks[j, COLUMN.Ak0]
        u[j, 1] += along_k * blocks[j, COLUMN.k1] + along_Ak * blocks[j, COLUMN.Ak1]


@inline_always
def saltation(blocks, R, V, ratio):
    """Carry tangent vectors V (m, n, 2) through an impact with ratio = a / v just before it, in place.

    S = I - (1 + R) [k (cA) + (A k) c - (a / v) k c].
    """
    q = 1.0 + R
    for u in V:
        dy, dv = guard_of(blocks, u), guard_rate_of(blocks, u)
        add_columns(blocks, u, -q * (dv - ratio * dy), -q * dy)


@inline_always
def rest_projection(blocks, cA2k, V):
    """Carry tangent vectors V (m, n, 2) through complete chatter to rest, in place.

    P = I - (A k) c - k (cA - (cA^2k) c), to leading order in the chatter's duration; c P = cA P = 0.
    """
    for u in V:
        dy, dv = guard_of(blocks, u), guard_rate_of(blocks, u)
        add_columns(blocks, u, -(dv - cA2k * dy), -dy)


@inline_always
def stop_position(osc, side):
    """Position of a stop: +b_upper or -b_lower."""
    return osc.head[HEAD.top] if side > 0 else osc.head[HEAD.bottom]


@kernel
def to_held(osc, h, V, turn, u, U):
    """Write the block state u (n, 2) and tangent vectors U (m, n, 2) of motion held on a stop, from those of flight.

    The last block is y; its constant state, the stop, is left out of u: see load_on_stop.
    """
    held, n = osc.held, h.shape[0]
    z, W = np.empty(2 * n), np.empty((V.shape[0], 2 * n))
    leave_flight(osc, h, turn, z)
    leave_frame(osc.to_physical, V, W)
    enter(held, ONLY, z, W, turn, u, U)
    u[n - 1, 0] = u[n - 1, 1] = 0.0
    for e in range(len(U)):
        U[e, n - 1, 0] = U[e, n - 1, 1] = 0.0


@kernel
def from_held(osc, u, U, turn, side, h, V):
    """Write the block state h (n, 2) and tangent vectors V (m, n, 2) in flight of a motion held on a stop."""
    held, n = osc.held, h.shape[0]
    z, W = np.empty(2 * n), np.empty((U.shape[0], 2 * n))
    u[n - 1, 0] = stop_position(osc, side)
    leave(held, ONLY, u, U, turn, z, W)
    for i in range(2 * n):
        h[i // 2, i % 2] = product(osc.to_blocks[i], z, 0) - wave(osc.gap.forced[i // 2, i % 2], turn)[0]
    enter_frame(osc.to_blocks, W, V)


@inlined
def leave_flight(osc, h, turn, z):
    """Write the physical state z (2n,), counted from rest, of a block state h (n, 2) in flight; see state.turned."""
    z[:] = 0.0
    for j in range(len(z)):
        full = h[j // 2, j % 2] + wave(osc.gap.forced[j // 2, j % 2], turn)[0]
        for i in range(len(z)):
            z[i] += osc.to_physical[i, j] * full


@inlined
def level_on_stop(osc, side):
    """Constant part of the signal of held motion: the force by which a stop holds y, without motion of the others."""
    last = osc.held.blocks.shape[2] - 1
    return osc.held.offset[0, 0] + osc.held.blocks[0, 0, last, COLUMN.c0] * stop_position(osc, side)


@kernel
def load_on_stop(osc, u, turn, side):
    """The force that presses the resting mass on the stop, from its block state u (n, 2)."""
    held = osc.held
    return -side * (guard_of(held.blocks[0, 0], u) + wave(held.waves[0, 0], turn)[0] + level_on_stop(osc, side))


@inline_always
def stay_on_stop(osc, h, V, growth, triangle, phase, side, H):
    """Rest on a stop until the load on it falls to zero, or for H; moves h and V in place.

    Returns (time, released, evaluations); released is 2 if the march gave up.
    """
    h, V = borrowed(h), borrowed(V)
    held, n = osc.held, h.shape[0]
    blocks, numbers = held.blocks[0, 0], held.numbers[0, 0]
    u, U, scratch = np.empty((n, 2)), np.empty((V.shape[0], n, 2)), np.empty((n - 1, 2))
    turn = turned(phase, held.waves.shape[2])
    to_held(osc, h, V, turn, u, U)
    upper, lower = (0.0, -np.inf) if side > 0 else (np.inf, 0.0)
    mode = lend(Mode(blocks[: n - 1], held.waves[0, 0], numbers, held.forced[0]))
    inside = np.int64(0)  # typed: a literal would compile the callees once more
    s, crossed, evaluations = next_crossing(
        mode, u[: n - 1], phase, level_on_stop(osc, side), upper, lower, inside, H, scratch
    )  # fmt: skip
    if growth.shape[0] > 0:
        flow(blocks, s, u)
        graded_flow(blocks, s, U, growth, triangle, 2 * n - 2)
    else:
        flow_with_tangent(blocks, s, u, U)
    turn_to(phase + numbers[NUMBER.omega] * s, turn)
    from_held(osc, u, U, turn, side, h, V)
    return s, abs(crossed), evaluations
