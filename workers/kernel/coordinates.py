"""Conversion between physical states and states of the decoupled equations of motion, with the mode of a motion.

A physical state holds displacements and velocities; the other state holds (h, h') of each decoupled equation, or block.
A mode is one set of linear equations between two events, such as flight or rest on a stop. A motion carries its mode. A
physical state alone gets its mode from ``start_at``.
"""

import numpy as np
from numba import types
from numpy.typing import NDArray

from workers.kernel.by_reference import by_value
from workers.kernel.external import FLOATS, external
from workers.kernel.hybrid.state import (
    ROW_ROUNDING,
    enter_frame,
    harmonics_at,
    leave_frame,
    mode_number_of_state,
    snap_to_mode,
    wave,
)
from workers.kernel.jit import inline_always, kernel
from workers.kernel.motion import BEYOND, FLIGHT, OSCILLATOR, Motion, has_modes, motion_at
from workers.kernel.sticking import load_on_stop, to_sticking
from workers.model.hybrid_modes import DETACHED, ON
from workers.model.oscillator import COLUMN, HEAD, Oscillator
from workers.results import BEYOND_STOP, InvalidError


def motion_from(oscillator: Oscillator, state: NDArray[np.float64], vectors: int = 0, record: int = 0) -> Motion:
    """Return a motion that starts at a state (2n,) at a section: displacements x, then velocities v.

    vectors  number of tangent vectors to carry
    record   number of impacts to record

    A section is an instant of fixed phase of the force. The state decides the mode (set of linear equations): on a stop
    with v = 0 the mass sticks or is about to leave. Raise InvalidError if the state is beyond a stop.
    """
    h = np.zeros((len(oscillator.gap_row), 2))
    mode = start_at(oscillator, np.asarray(state, dtype=np.float64), h)
    if mode == BEYOND:
        raise InvalidError(BEYOND_STOP)
    return motion_at(h, mode, vectors, record)


@external(OSCILLATOR, FLOATS[1], FLOATS[2], result=types.int64, modes=True)
def start_hybrid(oscillator, state, h):
    """Convert a physical state to a state h (n, 2) of the decoupled equations of motion, and return its mode's number.

    This is ``start_at`` for machines with modes: sets of linear equations, each valid between two events.
    """
    state, h = by_value(state), by_value(h)
    enter_frame(oscillator.to_blocks, state.reshape((1, len(state))), h.reshape((1, len(h), 2)))
    return mode_number_of_state(oscillator.table.elements, state)


@kernel
def start_at(oscillator, state, h):
    """Convert a physical state to a state h (n, 2) of the decoupled equations of motion, and return its mode's number.

    The physical state (2n,) has displacements, then velocities, at an instant of fixed phase of the force. Row j of h
    is (h, h') of equation j, without the forced response. The mode is the set of linear equations that holds next. The
    number is BEYOND if the state is beyond a stop.
    """
    if has_modes(oscillator):
        return start_hybrid(oscillator, state, h)
    row, blocks, turn = (
        oscillator.gap_row,
        oscillator.gap.blocks,
        harmonics_at(oscillator.tau, oscillator.gap.waves.shape[0]),
    )
    n, y, v, y_sum, v_sum = h.shape[0], 0.0, 0.0, 0.0, 0.0
    for j in range(n):
        for k in range(2):
            full = 0.0
            for i in range(2 * n):
                full += oscillator.to_blocks[2 * j + k, i] * state[i]
            h[j, k] = full - wave(oscillator.gap.forced[j, k], turn)[0] - blocks[j, COLUMN.rest0 + k]
        coasts = blocks[j, COLUMN.lam] == 0.0 and blocks[j, COLUMN.eta] == 0.0
        if coasts and abs(h[j, 1]) <= ROW_ROUNDING * blocks[j, COLUMN.swing1]:
            h[j, 1] = 0.0  # otherwise rounding of h would drift for ever
        y += row[j] * state[j]
        v += row[j] * state[n + j]
        y_sum += abs(row[j] * state[j])
        v_sum += abs(row[j] * state[n + j])
    side = side_of(y, ROW_ROUNDING * y_sum, oscillator.head[HEAD.upper], oscillator.head[HEAD.lower])
    if side == 0:
        return BEYOND if y > oscillator.head[HEAD.upper] or y < oscillator.head[HEAD.lower] else FLIGHT
    return mode_at_rest(oscillator, side, h, turn) if abs(v) <= ROW_ROUNDING * v_sum else FLIGHT


@inline_always
def mode_at_rest(oscillator, side, h, turn):
    """Return the number of the mode of a motion that is on a stop with v = 0.

    side  side of the stop, +-1
    h     (n, 2) state of the decoupled equations
    turn  (H, 2) sine and cosine of the harmonics of the force, see state.harmonics_at

    The mode, the set of equations that holds next, is sticking if the load presses, else the mass is about to leave.
    """
    n = h.shape[0]
    u, nothing = np.empty((n, 2)), np.empty((0, n, 2))
    to_sticking(oscillator, h, nothing, turn, np.empty(2 * n), np.empty((0, 2 * n)), u, nothing)
    return FLIGHT + side * (ON if load_on_stop(oscillator, u, turn, side) > 0.0 else DETACHED)


@inline_always
def side_of(y, error, upper, lower):
    """Return the side, +-1, of the stop on which the gap coordinate y is, up to its rounding ``error``; else 0."""
    on_lower = -1 if abs(y - lower) <= error else 0
    return 1 if abs(y - upper) <= error else on_lower


@kernel
def put_on_stop(row, stop, x):
    """Set one coordinate of a state x, in place, so that the gap coordinate g . x is exactly on a stop.

    row  (n,)          row g
    stop               position of the stop
    x    (n or more,)  a state, of which only the first n numbers count

    The coordinate is the one with the largest weight in g. g . x then equals the stop to rounding, see ROW_ROUNDING. It
    equals the stop exactly if it is one coordinate with weight +-1.
    """
    k, others = 0, 0.0
    for i in range(len(row)):
        if abs(row[i]) > abs(row[k]):
            k = i
    for i in range(len(row)):
        if i != k:
            others += row[i] * x[i]
    x[k] = (stop - others) / row[k]


@external(OSCILLATOR, FLOATS[2], types.int64, FLOATS[1], modes=True)
def leave_hybrid(oscillator, h, mode, state):
    """Convert a state h (n, 2) of the decoupled equations to a physical one; add it to ``state`` (2n,), which is zero.

    This is ``leave_blocks`` for machines with modes. ``mode`` is the number of the mode, the set of linear equations
    that holds.
    """
    h, state = by_value(h), by_value(state)
    leave_frame(oscillator.to_physical, h.reshape((1, len(h), 2)), state.reshape((1, len(state))))
    snap_to_mode(oscillator.table.elements, mode, state)


@kernel
def leave_blocks(oscillator, h, mode, state):
    """Convert a state h (n, 2) of the decoupled equations to a physical one: add it to ``state`` (2n,), which is zero.

    The result has displacements, then velocities. ``mode`` is the number of the mode, the set of linear equations that
    holds. A sticking mass is put on its stop exactly, see ``blocks_to_physical``.
    """
    if has_modes(oscillator):
        leave_hybrid(oscillator, h, mode, state)
        return
    row, blocks, upper, lower = (
        oscillator.gap_row,
        oscillator.gap.blocks,
        oscillator.head[HEAD.upper],
        oscillator.head[HEAD.lower],
    )
    n, turn = h.shape[0], harmonics_at(oscillator.tau, oscillator.gap.waves.shape[0])
    terms = np.zeros(n)
    for j in range(n):
        for k in range(2):
            full = h[j, k] + wave(oscillator.gap.forced[j, k], turn)[0] + blocks[j, COLUMN.rest0 + k]
            for i in range(2 * n):
                state[i] += oscillator.to_physical[i, 2 * j + k] * full
            for i in range(n):
                terms[i] += abs(oscillator.to_physical[i, 2 * j + k]) * (abs(full) + abs(h[j, k]))
    y, size = 0.0, 0.0
    for i in range(n):
        y += row[i] * state[i]
        size += abs(row[i]) * terms[i]
    if mode != FLIGHT:
        put_on_stop(row, upper if mode > FLIGHT else lower, state)
        put_on_stop(row, 0.0, state[n:])
    else:
        stop = min(max(y, lower), upper)
        if y != stop and abs(y - stop) <= 1e-12 * size:
            put_on_stop(row, stop, state)


@kernel
def blocks_to_physical(oscillator, motion):
    """Return the state (2n,) of a motion at a section: displacements, then velocities.

    A section is an instant of fixed phase of the force. A sticking mass is exactly on the stop with v = 0. A motion is
    never beyond a stop: overshoot by rounding is removed.
    """
    state = np.zeros(2 * motion.h.shape[0])
    leave_blocks(oscillator, motion.h, motion.mode[0], state)
    return state
