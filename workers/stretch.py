"""Motions along stretches of periods: one by one, or many in a batch with the same result."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.kernel.averages import Averages, average, no_averages
from workers.kernel.batch.layout import LANES
from workers.kernel.batch.run import Batch, constants, run_batch
from workers.kernel.stroboscopic import FREE, RUNNING, STATUS, WORK, Motion
from workers.model.oscillator import Oscillator

FEWEST = 4
"""Stretches that are worth a batch."""


class Stretch(NamedTuple):
    """Periods that a motion has to go through, in place.

    averages   takes the averages of the frame's growth; None for none
    sections   (K, n, 2) takes the last K block states
    """

    osc: Oscillator
    motion: Motion
    periods: int
    averages: Averages | None
    sections: NDArray[np.float64]


def run_periods(osc: Oscillator, motion: Motion, periods: int) -> int:
    """Take a motion through so many periods, in place; the periods completed."""
    return run_stretch(Stretch(osc, motion, periods, None, np.empty((0, *motion.h.shape))))


def run_stretch(stretch: Stretch, done: int = 0) -> int:
    """Go on from period ``done`` of a stretch; the periods completed, fewer where the motion ends or its work does."""
    osc, motion, periods, averages, sections = stretch
    return int(average(osc, motion, done, periods, averages or no_averages(), sections))


def ended(stretch: Stretch, done: int) -> bool:
    """Whether nothing of a stretch is left to do: it is complete, or its motion ends, or its work is spent."""
    tally = stretch.motion.tally
    return done == stretch.periods or bool(tally[STATUS] != RUNNING or tally[WORK] < 0.0)


def run_stretches(
    stretches: list[Stretch], done: list[int], *, to_end: bool = True, lanes: int = LANES, fewest: int = FEWEST
) -> list[int]:
    """As run_stretch, for each of many stretches: ``fewest`` or more of one shape in a batch of ``lanes`` <= LANES.

    Each has the same bits as alone. Unless it is to run to the end, it returns once half of a batch is through, so that
    others can take their place; the rest has not ended.
    """
    done = list(done)
    groups: dict[tuple[int, ...], list[int]] = {}
    for k, stretch in enumerate(stretches):
        if stretch.motion.contact[0] == FREE and not ended(stretch, done[k]):
            groups.setdefault(stretch.motion.V.shape, []).append(k)
    alone = set(range(len(stretches)))
    for members in groups.values():
        if len(members) < fewest:
            continue
        enough = 0 if to_end else min(lanes, len(members)) // 2
        counts, left = _run_in_batch([stretches[k] for k in members], [done[k] for k in members], enough, lanes)
        for k, count in zip(members, counts, strict=True):
            done[k] = count
        alone -= {k for k, out in zip(members, left, strict=True) if not out}
    for k in alone:
        if not ended(stretches[k], done[k]):
            done[k] = run_stretch(stretches[k], done[k])
    return done


def _run_in_batch(stretches: list[Stretch], done: list[int], enough: int, lanes: int) -> tuple[list[int], list[bool]]:
    """The periods that run_batch has completed of each, and whether it leaves the rest to run_stretch."""
    motions = [stretch.motion for stretch in stretches]
    averages = [stretch.averages or no_averages() for stretch in stretches]
    heads, blocks = zip(*(constants(stretch.osc) for stretch in stretches), strict=True)
    longest = max(len(stretch.sections) for stretch in stretches)
    batch = Batch(
        head=np.array(heads),
        blocks=np.array(blocks),
        periods=np.array([stretch.periods for stretch in stretches]),
        done=np.array(done),
        left=np.zeros(len(stretches), dtype=np.bool_),
        h=np.array([motion.h for motion in motions]),
        V=np.array([motion.V for motion in motions]),
        growth=np.array([motion.growth for motion in motions]),
        tally=np.array([motion.tally for motion in motions]),
        levels=np.array([average.levels for average in averages]),
        weighted=np.array([average.weighted for average in averages]),
        sections=np.zeros((len(stretches), longest, *motions[0].h.shape)),
    )
    for k, stretch in enumerate(stretches):
        batch.sections[k, longest - len(stretch.sections) :] = stretch.sections
    run_batch(batch, enough, lanes)
    for k, stretch in enumerate(stretches):
        motion = stretch.motion
        motion.h[:], motion.V[:], motion.growth[:], motion.tally[:] = (
            batch.h[k], batch.V[k], batch.growth[k], batch.tally[k]
        )  # fmt: skip
        if stretch.averages is not None:
            stretch.averages.levels[:], stretch.averages.weighted[:] = batch.levels[k], batch.weighted[k]
        stretch.sections[:] = batch.sections[k, longest - len(stretch.sections) :]
    return batch.done.tolist(), batch.left.tolist()
