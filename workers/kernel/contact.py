"""Impacts: the restitution law and its saltation matrix, the end of chatter, motion on a stop, release."""

import numpy as np

from workers.kernel.borrow import borrowed
from workers.kernel.crossing import next_crossing
from workers.kernel.elementary import sin_cos
from workers.kernel.flow import flow, flow_with_tangent, guard_of, guard_rate_of
from workers.kernel.jit import inline_always, inlined, kernel
from workers.kernel.signal import all_forced
from workers.kernel.tangent import graded_flow
from workers.model.oscillator import COLUMN, HEAD, NUMBER

REBOUND, REST, LEAVE = range(3)
"""Outcomes of an impact: rebound; rest on the stop; v = 0 while the load pulls away (R = 0)."""

EPS = float(np.finfo(np.float64).eps)

ENDING, BRIEF = 1e-4, 1.0 / 64.0
"""Lanes leave the rest of a chatter to another kernel, which follows hops more exactly (chatter.hop), once the load
changes in that rest by this share of it, or the rest lasts this share of the period."""

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


@inlined
def wave(parts, phase):
    """sum_k sin_part_k sin(k phase) + cos_part_k cos(k phase) of parts (H, 2), and its rate per radian."""
    value, rate = 0.0, 0.0
    for k in range(len(parts)):
        sin, cos = sin_cos((k + 1.0) * phase)
        value += parts[k, 0] * sin + parts[k, 1] * cos
        rate += (k + 1.0) * (parts[k, 0] * cos - parts[k, 1] * sin)
    return value, rate


@inlined
def stop_index(side):
    """Index of a stop in arrays of both stops: 0 upper, 1 lower."""
    return 0 if side > 0 else 1


@kernel
def changed_blocks(matrix, side, source, source_response, phase, target, target_response):
    """Write the block coordinates of a state in other blocks, both without forced responses; see oscillator.Held.

    target + its response = shift + matrix (source + its response), for source (n, 2) and target (m, 2); the matrix (2m,
    2n + 2) has the shift of each stop in its last two columns.
    """
    shift = 2 * source.shape[0] + stop_index(side)
    for i in range(target.shape[0]):
        for k in range(2):
            target[i, k] = matrix[2 * i + k, shift] - wave(target_response[i, k], phase)[0]
    for j in range(source.shape[0]):
        for c in range(2):
            full = source[j, c] + wave(source_response[j, c], phase)[0]
            for i in range(target.shape[0]):
                for k in range(2):
                    target[i, k] += matrix[2 * i + k, 2 * j + c] * full


@inline_always
def to_held(osc, h, phase, side, u):
    """Write the held block coordinates u (n - 1, 2) of free block coordinates h at a stop."""
    changed_blocks(osc.held.down, side, h, osc.gap.forced, phase, u, osc.held.mode.forced)


@inline_always
def from_held(osc, u, phase, side, h):
    """Write the free block coordinates h (n, 2) of held coordinates u: y on the stop and v = 0."""
    changed_blocks(osc.held.up, side, u, osc.held.mode.forced, phase, h, osc.gap.forced)


@kernel
def transformed(matrix, V, U):
    """Write U = matrix V, for tangent vectors V (m, ., 2) and U (m, ., 2), one vector after the other."""
    for m in range(V.shape[0]):
        for i in range(U.shape[1]):
            for k in range(2):
                total = 0.0
                for j in range(V.shape[1]):
                    total += matrix[2 * i + k, 2 * j] * V[m, j, 0] + matrix[2 * i + k, 2 * j + 1] * V[m, j, 1]
                U[m, i, k] = total


@inline_always
def load_on_stop(osc, u, phase, side):
    """side * a: the free acceleration that presses the resting mass on the stop."""
    held = osc.held.mode
    load = all_forced(held.waves, held.numbers[NUMBER.omega], phase)[0]
    return side * (guard_of(held.blocks, u) + load + osc.held.push[stop_index(side)])


@inline_always
def stay_on_stop(osc, h, V, growth, triangle, phase, side, H):
    """Rest on a stop until the load on it falls to zero, or for H; moves h and V in place.

    Returns (time, released, evaluations); released is 2 if the march gave up.
    """
    h, V = borrowed(h), borrowed(V)
    held = osc.held.mode
    n = len(held.blocks)
    u, scratch = np.empty((n, 2)), np.empty((n, 2))
    U = np.empty((V.shape[0], n, 2))
    to_held(osc, h, phase, side, u)
    transformed(osc.held.down, V, U)
    upper, lower = (np.inf, 0.0) if side > 0 else (0.0, -np.inf)
    offset = osc.held.push[stop_index(side)]
    inside = np.int64(0)  # typed: a literal would compile the callees once more
    s, crossed, evaluations = next_crossing(held, u, phase, offset, upper, lower, inside, H, scratch)
    if growth.shape[0] > 0:
        flow(held.blocks, s, u)
        graded_flow(held.blocks, s, U, growth, triangle, 2 * n)
    else:
        flow_with_tangent(held.blocks, s, u, U)
    from_held(osc, u, phase + held.numbers[NUMBER.omega] * s, side, h)
    transformed(osc.held.up, U, V)
    return s, abs(crossed), evaluations
