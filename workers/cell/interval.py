"""Simulation of many motions over intervals of periods: how they begin, continue and fail."""

from typing import Any

import numpy as np

from workers import results
from workers.kernel.averages import LEVELS
from workers.kernel.cell_loops import physical_states, start_motions
from workers.kernel.lanes.layout import LANES
from workers.kernel.lanes.modes import run_through_modes
from workers.kernel.lanes.run import MotionBatch, run_alone, run_batch
from workers.kernel.motion import BEYOND, RUNNING, STATUS, WORK, WORK_OF_A_TRIAL, Motion, cosine_vectors, motions_at
from workers.model.oscillator import COLUMN, Array, Mask, Oscillator, Reasons, Rows, many_of, map_fields

REASON_OF = np.array(
    [
        results.NO_REASON, results.GAVE_UP, results.COSTLY_PERIOD, results.NOT_FINITE, results.BEYOND_STOP,
        results.MANY_MODES, results.NO_MODE, results.ENDLESS_EVENTS, results.TWO_IMPACTS,
        results.RESONANCE,
    ],
    dtype=np.int8,
)  # fmt: skip
"""Code of the reason why a motion cannot continue, by the status that the kernel gave it."""


def begin(
    oscillators: Oscillator,
    reasons: Reasons,
    states: Array,
    mode: Rows | None = None,
    vectors: int = 0,
    record: int = 0,
) -> tuple[Motion, Reasons]:
    """Return N motions from physical states at a section t = k T, and codes (N,) of why a motion is impossible.

    oscillators  N machines
    reasons      (N,) codes of why the machines are invalid, NO_REASON if they are valid
    states       (N, 2n) physical section states
    mode         (N,) numbers of the modes, sets of linear equations, of motions that continue from these states;
                 None if the state decides
    vectors      number of tangent vectors
    record       maximum number of impacts to store
    """
    N, size = states.shape
    motions = motions_at(np.zeros((N, size // 2, 2)), vectors=vectors, record=record)
    motions.V[:] = cosine_vectors(size // 2)[:vectors]
    scales = start_motions(oscillators, motions, states, np.flatnonzero(reasons == results.NO_REASON))
    if mode is not None:
        motions.mode[:, 0] = mode
    causes = np.where(np.isfinite(scales), reasons, np.int8(results.ENERGY_OUT_OF_DOUBLES))
    return motions, np.where(motions.mode[:, 0] == BEYOND, np.int8(results.BEYOND_STOP), causes)


def stop_reasons(motions: Motion, cells: Rows) -> Reasons:
    """Return the code of the reason why each of these motions cannot continue, NO_REASON if it can."""
    tally = motions.tally[cells]
    stopped = REASON_OF[tally[:, STATUS].astype(np.int64)]
    runs, finite = tally[:, STATUS] == RUNNING, np.isfinite(motions.h[cells]).all(axis=(1, 2))
    stopped[runs & (tally[:, WORK] < 0.0)] = results.WORK_SPENT
    stopped[runs & ~finite] = results.NOT_FINITE
    return stopped


def batch_of(oscillators: Any, motions: Motion, n_sections: int = 0) -> MotionBatch:
    """Return a batch of motions with no periods to simulate yet, and room for their last states at sections t = k T.

    ``n_sections`` is the number of section states for which each motion has room.
    """
    N, n = motions.h.shape[:2]
    return MotionBatch(
        oscillators,
        motions,
        periods=np.zeros(N, dtype=np.int64),
        completed=np.zeros(N, dtype=np.int64),
        levels=np.zeros((N, LEVELS, 4)),
        weighted=np.zeros((N, 2)),
        sections=np.zeros((N, n_sections, n, 2)),
    )


def has_ended(batch: MotionBatch) -> Mask:
    """Return the mask of cells that are finished: their periods are over, their motion failed, or it cost too much."""
    tally = batch.motions.tally
    return (batch.completed >= batch.periods) | (tally[:, STATUS] != RUNNING) | (tally[:, WORK] < 0.0)


def run(batch: MotionBatch, cells: Rows, *, to_end: bool = True, lanes: int = LANES) -> None:
    """Simulate these cells of a batch, in place, until each has ended; at most ``lanes`` <= LANES cells at a time.

    Without ``to_end`` return once half of these places are idle, so that other cells can take them. Cells with only
    underdamped modes of vibration need less arithmetic and run separately. Cells whose free flight may grow run one
    after the other.
    """
    if batch.oscillators.has_modes:
        signals, enough = batch.oscillators.table.machines.signals, 0 if to_end else min(lanes, len(cells)) // 2
        batch.oscillators.with_modes(lambda some: run_through_modes(batch, some, signals, enough, lanes), cells)
        return
    grows = batch.oscillators.growth[cells] > 0.0
    if np.any(grows):
        run_alone(batch, cells[grows])
        cells = cells[~grows]
    underdamped = np.all(batch.oscillators.gap.blocks[cells, :, COLUMN.d] > 0.0, axis=1)
    for oscillates in (True, False):
        some = cells[underdamped == oscillates]
        if len(some):
            run_batch(batch, some, 0 if to_end else min(lanes, len(some)) // 2, lanes, oscillates)


def sections_from(oscillators: Oscillator, motions: Motion, counts: Rows) -> Array:
    """Return the physical states (N, K, 2n) of motions at the sections t = k T, beginning with the present ones.

    Row r has the first ``counts[r]`` <= K sections, and NaN beyond. Sections are NaN after a motion cannot be followed.
    The motions are advanced to the last section in place.
    """
    N, n = motions.h.shape[:2]
    batch, every = batch_of(oscillators, motions), np.arange(N)
    states = np.full((N, int(np.max(counts, initial=0)), 2 * n), np.nan)
    for k in range(states.shape[1]):
        going = every[(k < counts) & (motions.tally[:, STATUS] == RUNNING)]
        states[going, k] = physical_states(oscillators, motions, going)
        batch.periods[:], batch.completed[:], motions.tally[:, WORK] = 1, 0, WORK_OF_A_TRIAL
        if len(rest := going[counts[going] > k + 1]):
            run(batch, rest)
    return states


def run_periods(oscillator: Oscillator, motion: Motion, periods: int) -> int:
    """Simulate a motion for ``periods`` periods, in place.

    Return the number of periods completed, which is smaller if the motion fails or its allowed evaluations are spent.
    """
    batch = batch_of(many_of(oscillator), map_fields(motion, lambda field: field[None]))
    batch.periods[0] = periods
    run(batch, np.zeros(1, dtype=np.int64))
    return int(batch.completed[0])
