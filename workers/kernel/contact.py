"""Impacts: the restitution law with its saltation matrix, and the end of chatter."""

import numpy as np

from workers.kernel.flow import guard_of, guard_rate_of
from workers.kernel.jit import inline_always, inlined
from workers.model.oscillator import COLUMN, HEAD

REBOUND, REST, LEAVE = range(3)
"""Outcomes of an impact. REBOUND: the mass rebounds. REST: the mass sticks on the stop. LEAVE: v = 0 while the load
pulls away (R = 0)."""

EPS = float(np.finfo(np.float64).eps)

ENDING, BRIEF = 1e-4, 1.0 / 64.0
"""Limits beyond which lanes leave the end of a chatter to another kernel, which follows hops more exactly
(chatter.hop). ENDING is the change of the load until the end, as a share of the load. BRIEF is the time until the end,
as a share of the period."""

SHORTEST_HOP = 1e-11
"""Share of a forcing period below which the length of a hop counts as rounding."""


@inlined
def load_at_rest(side, v, a, cA2k):
    """Return the acceleration that presses a mass on a stop once its velocity v is removed: side * (a - cA^2k v).

    side   side of the stop, +-1
    v, a   velocity and acceleration of the gap coordinate just before the impact
    cA2k   cA^2k: a decrease of the velocity by v changes the acceleration by -cA^2k v
    """
    return side * (a - cA2k * v)


@inlined
def hop_is_rounding(load, w, scale, period):
    """Return True if a hop that begins at speed w under this load is too low or too short to be resolved.

    load    acceleration toward the stop
    scale   sum of moduli of the terms of the gap coordinate y, the unit of its rounding
    period  forcing period

    Too low means w^2 / (2 load) < 1e4 eps scale. Motion that decays to an equilibrium on a stop hops under a load of
    rounding size. Such a motion never comes to rest, and its squares may underflow, where a comparison with zero fails.
    """
    return w * w < 2e4 * load * EPS * scale or 2.0 * w < SHORTEST_HOP * period * load


@inlined
def outcome(load, v, R, scale, period):
    """Return the outcome of an impact at velocity v: REBOUND, REST or LEAVE.

    load    acceleration toward the stop, see ``load_at_rest``
    R       coefficient of restitution
    scale   sum of moduli of the terms of the gap coordinate y
    period  forcing period

    With R = 0 the mass sticks if the load presses, load > 0, and else leaves. With 0 < R < 1 chatter is followed hop by
    hop until hops are below rounding. The remainder ends at chatter.chatter_end, with a third-order error of the state.
    With R >= 1 chatter never completes.
    """
    if R == 0.0:
        return REST if load > 0.0 else LEAVE
    return REST if load > 0.0 and R < 1.0 and hop_is_rounding(load, R * abs(v), scale, period) else REBOUND


@inlined
def is_rebound(load, v, R, cA2k, scale, remaining, period):
    """Return True if an impact at velocity v is an ordinary rebound, which vectorised loops over cells can compute.

    load, scale, period  see ``outcome``
    R, cA2k              coefficient of restitution; cA^2k, see ``load_at_rest``
    remaining            time until the end of the period

    Otherwise the impact ends a chatter or comes close to it, see ENDING.
    """
    w = R * abs(v)
    change, pressing = 2.0 * abs(cA2k * v), load * (1.0 - R)
    slow = (change > ENDING * load and 2.0 * w > BRIEF * period * pressing) or 2.0 * w > remaining * pressing
    return R > 0.0 and (load <= 0.0 or R >= 1.0 or (slow and not hop_is_rounding(load, w, scale, period)))


@inlined
def kick(blocks, h, dv):
    """Change the velocity of the gap coordinate by dv, in place, by adding dv k to a state h (n, 2).

    h is the state of the decoupled equations of motion. The column k of ``blocks`` is the direction of an impact.
    """
    for j in range(len(blocks)):
        h[j, 0] += dv * blocks[j, COLUMN.k0]
        h[j, 1] += dv * blocks[j, COLUMN.k1]


@inlined
def shift(blocks, h, dy):
    """Move the gap coordinate y = c . z by a rounding error dy, in place, by adding dy A k to a state h (n, 2).

    h is the state of the decoupled equations of motion, z the same as a vector. A is the matrix of the flight and k the
    direction of an impact; c . A k = 1.
    """
    for j in range(len(blocks)):
        h[j, 0] += dy * blocks[j, COLUMN.Ak0]
        h[j, 1] += dy * blocks[j, COLUMN.Ak1]


@inlined
def add_columns(blocks, u, along_k, along_Ak):
    """Add along_k k + along_Ak A k to a tangent vector u (n, 2) in coordinates of the decoupled equations, in place.

    k is the direction of an impact, and A k its derivative by the matrix A of the flight; both are columns of
    ``blocks``.
    """
    for j in range(len(blocks)):
        u[j, 0] += along_k * blocks[j, COLUMN.k0] + along_Ak * blocks[j, COLUMN.Ak0]
        u[j, 1] += along_k * blocks[j, COLUMN.k1] + along_Ak * blocks[j, COLUMN.Ak1]


@inline_always
def saltation(blocks, R, V, ratio):
    """Carry tangent vectors V (m, n, 2) through an impact with restitution R, in place, by its saltation matrix S.

    ``ratio`` is a / v, acceleration by velocity of the gap coordinate just before the impact. With c the row of the gap
    coordinate, A the matrix of the flight and k the direction of an impact,

        S = I - (1 + R) [k (cA) + (A k) c - (a / v) k c].
    """
    q = 1.0 + R
    for u in V:
        dy, dv = guard_of(blocks, u), guard_rate_of(blocks, u)
        add_columns(blocks, u, -q * (dv - ratio * dy), -q * dy)


@inline_always
def rest_projection(blocks, cA2k, V):
    """Carry tangent vectors V (m, n, 2) through a chatter until the mass rests on the stop, in place.

    With c the row of the gap coordinate, A the matrix of the flight and k the direction of an impact, they are
    multiplied by P = I - (A k) c - k (cA - (cA^2k) c), to leading order in the chatter's duration; c P = cA P = 0.
    """
    for u in V:
        dy, dv = guard_of(blocks, u), guard_rate_of(blocks, u)
        add_columns(blocks, u, -(dv - cA2k * dy), -dy)


@inline_always
def stop_position(oscillator, side):
    """Return the position of the stop on side +-1 relative to the gap coordinate at rest, y0: +b_upper or -b_lower."""
    return oscillator.head[HEAD.top] if side > 0 else oscillator.head[HEAD.bottom]
