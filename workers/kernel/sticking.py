"""Motion in which the gap coordinate y sticks on a stop, until the load on the stop falls to zero."""

import numpy as np

from workers.kernel.borrow import borrow
from workers.kernel.by_reference import by_reference
from workers.kernel.contact import stop_position
from workers.kernel.crossing import next_crossing
from workers.kernel.flow import flow, flow_with_tangent, guard_of
from workers.kernel.hybrid.state import (
    enter,
    enter_frame,
    harmonics_at,
    leave,
    leave_frame,
    product,
    wave,
    write_harmonics,
)
from workers.kernel.jit import inline_always, inlined, kernel
from workers.kernel.tangent import graded_flow
from workers.model.oscillator import COLUMN, NUMBER, GuardedFlow

ONLY = np.int64(0)
"""Index of the only mode in Oscillator.sticking, the mode in which the mass sticks on a stop."""


@kernel
def to_sticking(oscillator, h, V, harmonics, z, W, u, U):
    """Write block state u (n, 2) and tangent vectors U (m, n, 2) of a mass that sticks, from h and V in flight.

    harmonics (H, 2)   sine and cosine of the harmonics of the force, see state.harmonics_at
    z (2n,), W (m, 2n) work arrays, overwritten

    A block is one decoupled equation of motion, with other coordinates in flight than while the mass sticks. The last
    block is y, the gap coordinate. Its constant state, the stop, is left out of u, see ``load_on_stop``.
    """
    sticking, n = oscillator.sticking, h.shape[0]
    leave_flight(oscillator, h, harmonics, z)
    leave_frame(oscillator.to_physical, V, W)
    enter(sticking, ONLY, z, W, harmonics, u, U)
    u[n - 1, 0] = u[n - 1, 1] = 0.0
    for e in range(len(U)):
        U[e, n - 1, 0] = U[e, n - 1, 1] = 0.0


@kernel
def from_sticking(oscillator, u, U, harmonics, side, z, W, h, V):
    """Write state h (n, 2) and tangent vectors V (m, n, 2) in flight, from u and U of a mass that sticks.

    All are in coordinates of the decoupled equations: h and V of those in flight, u and U of those while the mass
    sticks. This is the inverse of ``to_sticking``.
    """
    sticking, n = oscillator.sticking, h.shape[0]
    u[n - 1, 0] = stop_position(oscillator, side)
    leave(sticking, ONLY, u, U, harmonics, z, W)
    for i in range(2 * n):
        h[i // 2, i % 2] = (
            product(oscillator.to_blocks[i], z, 0) - wave(oscillator.gap.forced[i // 2, i % 2], harmonics)[0]
        )
    enter_frame(oscillator.to_blocks, W, V)


@inlined
def leave_flight(oscillator, h, harmonics, z):
    """Write the state z (2n,), displacements and velocities relative to equilibrium, of a block state h (n, 2).

    The block state is (h, h') of each decoupled equation in free flight.

    harmonics (H, 2)  sine and cosine of the harmonics of the force, see state.harmonics_at
    """
    z[:] = 0.0
    for j in range(len(z)):
        full = h[j // 2, j % 2] + wave(oscillator.gap.forced[j // 2, j % 2], harmonics)[0]
        for i in range(len(z)):
            z[i] += oscillator.to_physical[i, j] * full


@inlined
def level_on_stop(oscillator, side):
    """Return the constant part of the force by which a stop holds the mass on it, which acts without motion.

    The force is the signal of sticking motion; at its zero the mass is released. ``side`` is the side of the stop, +-1.
    """
    last = oscillator.sticking.blocks.shape[2] - 1
    return oscillator.sticking.offset[0, 0] + oscillator.sticking.blocks[0, 0, last, COLUMN.c0] * stop_position(
        oscillator, side
    )


@kernel
def load_on_stop(oscillator, u, harmonics, side):
    """Return the force that presses the sticking mass on the stop of this side, +-1.

    u (n, 2)          state of the decoupled equations that hold while the mass sticks
    harmonics (H, 2)  sine and cosine of the harmonics of the force, see state.harmonics_at
    """
    sticking = oscillator.sticking
    return -side * (
        guard_of(sticking.blocks[0, 0], u) + wave(sticking.waves[0, 0], harmonics)[0] + level_on_stop(oscillator, side)
    )


@inline_always
def stay_on_stop(oscillator, h, V, growth, triangle, phase, side, H):
    """Advance a mass that sticks on a stop until the load falls to zero, at most for the time H.

    h (n, 2), V       state of the decoupled equations, and tangent vectors, changed in place
    growth, triangle  see tangent.orthonormalise; empty if the vectors stay as they are
    phase             forcing phase at the start
    side              side of the stop, +-1

    Return (time, released, evaluations); ``released`` is 1 if the load falls to zero, else 0, and 2 if the search gave
    up.
    """
    h, V = borrow(h), borrow(V)
    sticking, n = oscillator.sticking, h.shape[0]
    blocks, numbers = sticking.blocks[0, 0], sticking.numbers[0, 0]
    u, U, scratch = np.empty((n, 2)), np.empty((V.shape[0], n, 2)), np.empty((n - 1, 2))
    turn = harmonics_at(phase, sticking.waves.shape[2])
    z, W = np.empty(2 * n), np.empty((V.shape[0], 2 * n))
    to_sticking(oscillator, h, V, turn, z, W, u, U)
    upper, lower = (0.0, -np.inf) if side > 0 else (np.inf, 0.0)
    mode = by_reference(GuardedFlow(blocks[: n - 1], sticking.waves[0, 0], numbers, sticking.forced[0]))
    inside = np.int64(0)  # typed: a literal would compile the callees once more
    s, crossed, evaluations = next_crossing(
        mode, u[: n - 1], phase, level_on_stop(oscillator, side), upper, lower, inside, H, scratch
    )  # fmt: skip
    if growth.shape[0] > 0:
        flow(blocks, s, u)
        graded_flow(blocks, s, U, growth, triangle, 2 * n - 2)
    else:
        flow_with_tangent(blocks, s, u, U)
    write_harmonics(phase + numbers[NUMBER.omega] * s, turn)
    from_sticking(oscillator, u, U, turn, side, z, W, h, V)
    return s, abs(crossed), evaluations
