"""Taking motions along a stretch of periods: one by one, or many side by side with the same result."""

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
    """Periods that a motion is to be taken along, in place.

    averages   takes the averages of the frame's growth; None for none
    sections   (K, n, 2) takes the last K block states
    """

    osc: Oscillator
    motion: Motion
    periods: int
    averages: Averages | None
    sections: NDArray[np.float64]


def follow(stretch: Stretch, done: int = 0) -> int:
    """Go on from period ``done`` of a stretch; the periods completed, fewer where the motion ends or its work does."""
    osc, motion, periods, averages, sections = stretch
    return int(average(osc, motion, done, periods, averages or no_averages(), sections))


def ended(stretch: Stretch, done: int) -> bool:
    """Whether nothing of a stretch is left to do: it is complete, or its motion ends, or its work is spent."""
    tally = stretch.motion.tally
    return done == stretch.periods or bool(tally[STATUS] != RUNNING or tally[WORK] < 0.0)


def follow_together(stretches: list[Stretch], done: list[int], *, all_the_way: bool = True) -> list[int]:
    """As follow, for each of many stretches: side by side as far as that goes, the same bits in any company.

    Not all the way, it returns once half of those side by side are through, for others to take their place; the rest
    has not ended.
    """
    done = list(done)
    groups: dict[tuple[int, ...], list[int]] = {}
    for k, stretch in enumerate(stretches):
        if stretch.motion.contact[0] == FREE and not ended(stretch, done[k]):
            groups.setdefault(stretch.motion.V.shape, []).append(k)
    alone = set(range(len(stretches)))
    for members in groups.values():
        if len(members) < FEWEST:
            continue
        enough = 0 if all_the_way else min(LANES, len(members)) // 2
        counts, left = _side_by_side([stretches[k] for k in members], [done[k] for k in members], enough)
        for k, count in zip(members, counts, strict=True):
            done[k] = count
        alone -= {k for k, out in zip(members, left, strict=True) if not out}
    for k in alone:
        if not ended(stretches[k], done[k]):
            done[k] = follow(stretches[k], done[k])
    return done


def _side_by_side(stretches: list[Stretch], done: list[int], enough: int) -> tuple[list[int], list[bool]]:
    """The periods that run_lanes has completed of each, and whether it leaves the rest to ``follow``."""
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
    run_batch(batch, enough)
    for k, stretch in enumerate(stretches):
        motion = stretch.motion
        motion.h[:], motion.V[:], motion.growth[:], motion.tally[:] = (
            batch.h[k], batch.V[k], batch.growth[k], batch.tally[k]
        )  # fmt: skip
        if stretch.averages is not None:
            stretch.averages.levels[:], stretch.averages.weighted[:] = batch.levels[k], batch.weighted[k]
        stretch.sections[:] = batch.sections[k, longest - len(stretch.sections) :]
    return batch.done.tolist(), batch.left.tolist()
