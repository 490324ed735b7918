"""Motions along stretches of periods, any number of them side by side: each as if it were alone."""

import numpy as np
from numpy.typing import NDArray

from workers.kernel.averages import LEVELS, Averages, no_averages
from workers.kernel.lanes.layout import LANES
from workers.kernel.lanes.run import Batch, run_batch
from workers.kernel.motion import RUNNING, STATUS, WORK, Motion
from workers.model.oscillator import COLUMN, Oscillator, each, many_of

Array = NDArray[np.float64]


def batch_of(oscillators: Oscillator, motions: Motion, kept: int = 0) -> Batch:
    """A batch of many motions that have nowhere to go yet, with room for the last ``kept`` sections of each."""
    N, n = motions.h.shape[:2]
    return Batch(
        oscillators=oscillators,
        motions=motions,
        periods=np.zeros(N, dtype=np.int64),
        done=np.zeros(N, dtype=np.int64),
        levels=np.zeros((N, LEVELS, 4)),
        weighted=np.zeros((N, 2)),
        sections=np.zeros((N, kept, n, 2)),
    )


def without_frames(batch: Batch) -> Batch:
    """The same batch without tangent vectors."""
    N, _, n, _ = batch.motions.V.shape
    return batch._replace(motions=batch.motions._replace(V=np.zeros((N, 0, n, 2)), growth=np.zeros((N, 0))))


def ended(batch: Batch) -> NDArray[np.bool_]:
    """Of which cells nothing is left to do: their periods are complete, or their motion or their work ends."""
    tally = batch.motions.tally
    return (batch.done >= batch.periods) | (tally[:, STATUS] != RUNNING) | (tally[:, WORK] < 0.0)


def run(batch: Batch, cells: NDArray[np.int64], *, to_end: bool = True, lanes: int = LANES) -> None:
    """Take these cells of a batch on, in place, until each has ended; at most ``lanes`` <= LANES at a time.

    Unless it is to run to the end, it returns once half of the lanes have nothing to do, so that others can take their
    place. Cells of underdamped modes alone need less arithmetic and are taken apart from the others.
    """
    underdamped = np.all(batch.oscillators.gap.blocks[cells, :, COLUMN.d] > 0.0, axis=1)
    for oscillates in (True, False):
        some = cells[underdamped == oscillates]
        if len(some):
            run_batch(batch, some, 0 if to_end else min(lanes, len(some)) // 2, lanes, oscillates)


def run_periods(
    osc: Oscillator,
    motion: Motion,
    periods: int,
    averages: Averages | None = None,
    sections: Array | None = None,
) -> int:
    """Take a motion through so many periods, in place; the periods completed, fewer where it or its work ends.

    averages take the growth of its first tangent vector, sections (K, n, 2) its last K block states.
    """
    batch = batch_of(many_of(osc), each(motion, lambda field: field[None]))
    levels, weighted = averages or no_averages()
    sections = np.zeros((0, *motion.h.shape)) if sections is None else sections
    batch = batch._replace(levels=levels[None], weighted=weighted[None], sections=sections[None])
    batch.periods[0] = periods
    run(batch, np.zeros(1, dtype=np.int64))
    return int(batch.done[0])
