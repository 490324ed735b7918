"""Kernels over many cells, for the work between two runs of simulation: starts, states, tests and standard errors.

Records of many cells are batches, with one row for each cell. ``cells`` are the row numbers to process.
"""

import math

import numpy as np

from workers.kernel.averages import standard_error
from workers.kernel.borrow import borrow, row_of
from workers.kernel.by_reference import by_reference, with_phase
from workers.kernel.coordinates import leave_blocks, put_on_stop, start_at
from workers.kernel.jit import kernel
from workers.kernel.motion import FLIGHT, OVERDRAFT, RUNNING, STATUS, WORK, motion_alone, motion_with
from workers.kernel.period import advance, propagate
from workers.kernel.signal import derivative_bounds
from workers.kernel.tangent import reset_frame
from workers.model.oscillator import COLUMN, HEAD, NUMBER


@kernel
def energy_norm(blocks, h):
    """Return sqrt(sum_j metric_j h_j^2 + h_j'^2), the size of block states h (n, 2).

    A block is one decoupled equation of the motion; row j of h is (h_j, h_j') of block j.
    """
    total = 0.0
    for j in range(len(blocks)):
        total += blocks[j, COLUMN.metric] * h[j, 0] ** 2 + h[j, 1] ** 2
    return math.sqrt(total)


@kernel
def scale_of(blocks, h):
    """Return the size of a motion, to which deviations of the motion are compared.

    The size is the energy norm of h plus that of Y. h (n, 2) is the state of the decoupled equations of motion. The
    swing columns of ``blocks`` bound their forced response Y.
    """
    swing = 0.0
    for j in range(len(blocks)):
        swing += blocks[j, COLUMN.metric] * blocks[j, COLUMN.swing0] ** 2 + blocks[j, COLUMN.swing1] ** 2
    return energy_norm(blocks, h) + math.sqrt(swing)


@kernel
def start_motions(oscillators, motions, states, cells):
    """Start motions at given states, in place, and return the sizes (N,) of the motions, see ``scale_of``.

    oscillators  batch of N machines
    motions      batch of motions, whose states and modes (the sets of linear equations that hold) are written
    states       (N, 2n) displacements, then velocities, at a section, an instant t = k T of fixed phase of the force
    cells        rows to process
    """
    oscillators, motions = by_reference(oscillators), by_reference(motions)
    scales = np.zeros(len(states))
    for r in cells:
        osc, h = row_of(oscillators, r), motions.h[r]
        motions.mode[r, 0] = start_at(osc, states[r], h)
        scales[r] = scale_of(osc.gap.blocks, h)
    return scales


@kernel
def clamp_to_stops(row, upper, lower, states):
    """Move states (N, 2n) that lie beyond a stop onto the stop, in place; the move is along the gap row.

    row           (N, n)  gap row g: the gap coordinate is y = g . x, x the displacements
    upper, lower  (N,)    positions of the stops
    """
    n = row.shape[1]
    for r in range(len(states)):
        y, square = 0.0, 0.0
        for i in range(n):
            y += row[r, i] * states[r, i]
            square += row[r, i] * row[r, i]
        stop = min(max(y, lower[r]), upper[r])
        if y != stop:
            for i in range(n):
                states[r, i] += row[r, i] / square * (stop - y)
            put_on_stop(row[r], stop, states[r])


@kernel
def impact_free(oscillators, motions, cells):
    """Return the mask of the cells that certainly never impact from this section on.

    Such a cell is in flight, and the bound of |y| for all later times stays inside both stops. A section is an instant
    t = k T of fixed phase of the force.
    """
    gap, head, motions = by_reference(oscillators).gap, oscillators.head, by_reference(motions)
    free = np.empty(len(cells), dtype=np.bool_)
    for e in range(len(cells)):
        r = cells[e]
        reach = derivative_bounds(gap.blocks[r], gap.numbers[r], motions.h[r], np.inf)[0] * (1.0 + 1e-12)
        inside = reach < head[r, HEAD.top] and -reach > head[r, HEAD.bottom]
        free[e] = motions.mode[r, 0] == FLIGHT and inside
    return free


@kernel
def reset_frames(blocks, motions, cells):
    """Make the tangent frames of these cells orthonormal, and add the logarithms of their lengths to their growth.

    The frame of a cell is the set of tangent vectors carried along with its motion. All changes are in place.
    """
    motions = by_reference(motions)
    for r in cells:
        reset_frame(blocks[r], row_of(motions, r))


@kernel
def physical_states(oscillators, motions, cells):
    """Return the states (len(cells), 2n) of these cells at a section: n displacements, then n velocities.

    A section is an instant t = k T of fixed phase of the force.
    """
    oscillators, motions = by_reference(oscillators), by_reference(motions)
    states = np.zeros((len(cells), 2 * motions.h.shape[1]))
    for e in range(len(cells)):
        r = cells[e]
        leave_blocks(row_of(oscillators, r), motions.h[r], motions.mode[r, 0], states[e])
    return states


@kernel
def standard_errors(levels, cells):
    """Return the standard error (len(cells),) of the mean tangent growth of each of these cells.

    levels (N, LEVELS, 4)  blocking analysis of each cell, see averages.add_to_blocks
    """
    error = np.empty(len(cells))
    for e in range(len(cells)):
        error[e] = standard_error(levels[cells[e]])
    return error


@kernel
def excursions(oscillators, h, mode, periods, allowance, cells):
    """Return the least and the greatest distance (N, 2) of the gap coordinate y from its rest position y0.

    h         (N, n, 2)  block states at a section t = k T: (h, h') of each decoupled equation of motion
    mode      (N, 1)     numbers of the modes, the sets of linear equations that hold there
    periods   (N,)       numbers of periods to follow
    allowance (N,)       maximum numbers of evaluations of the motion
    cells                rows to compute

    The result is NaN for other cells, and for motions that cannot be followed within ``allowance``.
    """
    ranges = np.full((len(periods), 2), np.nan)
    oscillators, n = by_reference(oscillators), h.shape[1]
    for r in cells:
        osc = row_of(oscillators, r)
        motion = motion_with(h[r], mode[r, 0], np.zeros((0, n, 2)), np.zeros(0), np.zeros((0, 0)), 0, True)
        motion.tally[WORK] = allowance[r] - OVERDRAFT
        for _ in range(periods[r]):
            if motion.tally[STATUS] == RUNNING:
                advance(osc, borrow(motion))
        if motion.tally[STATUS] == RUNNING:
            ranges[r, 0], ranges[r, 1] = motion.extremes[0], motion.extremes[1]
    return ranges


@kernel
def states_within(oscillators, r, states, times):
    """Return the states (S, K, 2n) of cell r at K times after each of S states: displacements, then velocities.

    states (S, 2n)  states at a section, an instant t = k T of fixed phase of the force
    times  (K,)     times since the section, at most a period

    The states of a motion that cannot be followed are NaN.
    """
    reached = np.full((len(states), len(times), states.shape[1]), np.nan)
    osc = row_of(by_reference(oscillators), r)
    for i in range(len(states)):
        h = np.zeros((states.shape[1] // 2, 2))
        mode = start_at(osc, states[i], h)
        for k in range(len(times)):
            motion = motion_alone(h, mode)
            propagate(osc, borrow(motion), times[k])
            if motion.tally[STATUS] == RUNNING:
                reached[i, k] = 0.0
                then = with_phase(osc, osc.tau + osc.gap.numbers[NUMBER.omega] * times[k])
                leave_blocks(then, motion.h, motion.mode[0], reached[i, k])
    return reached
