"""Taking motions along a stretch of periods: one by one, or many side by side with the same result."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.lanes import Batch, constants, run_lanes
from workers.lyapunov import Averages, average, no_averages
from workers.oscillator import Oscillator
from workers.section import FREE, RUNNING, STATUS, WORK, Motion, run

FEWEST = 4
"""Stretches that are worth a batch."""


class Stretch(NamedTuple):
    """Periods that a motion is to be taken along, in place.

    averages   takes the averages of the frame's growth, every period ending with an orthonormal frame; None for none
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
    if averages is None:
        return int(run(osc, motion, done, periods, sections))
    return int(average(osc, motion, done, periods, averages, sections))


def follow_together(stretches: list[Stretch]) -> list[int]:
    """As follow, for each of many stretches: side by side as far as that goes, the same bits in any company."""
    done = [0] * len(stretches)
    groups: dict[tuple[int, ...], list[int]] = {}
    for k, stretch in enumerate(stretches):
        motion = stretch.motion
        if motion.contact[0] == FREE and motion.tally[STATUS] == RUNNING and stretch.periods > 0:
            groups.setdefault(motion.V.shape, []).append(k)
    for members in groups.values():
        if len(members) >= FEWEST:
            for k, count in zip(members, _side_by_side([stretches[k] for k in members]), strict=True):
                done[k] = count
    return [
        follow(stretch, count) if count < stretch.periods and stretch.motion.tally[WORK] >= 0.0 else count
        for stretch, count in zip(stretches, done, strict=True)
    ]


def _side_by_side(stretches: list[Stretch]) -> list[int]:
    """The periods that run_lanes completes of each; what is left over is not begun."""
    motions = [stretch.motion for stretch in stretches]
    averages = [stretch.averages or no_averages() for stretch in stretches]
    heads, blocks = zip(*(constants(stretch.osc) for stretch in stretches), strict=True)
    longest = max(len(stretch.sections) for stretch in stretches)
    batch = Batch(
        head=np.array(heads),
        blocks=np.array(blocks),
        periods=np.array([stretch.periods for stretch in stretches]),
        done=np.zeros(len(stretches), dtype=np.int64),
        h=np.array([motion.h for motion in motions]),
        V=np.array([motion.V for motion in motions]),
        growth=np.array([motion.growth for motion in motions]),
        tally=np.array([motion.tally for motion in motions]),
        levels=np.array([average.levels for average in averages]),
        weighted=np.array([average.weighted for average in averages]),
        sections=np.empty((len(stretches), longest, *motions[0].h.shape)),
    )
    run_lanes(batch)
    for k, stretch in enumerate(stretches):
        motion = stretch.motion
        motion.h[:], motion.V[:], motion.growth[:], motion.tally[:] = (
            batch.h[k], batch.V[k], batch.growth[k], batch.tally[k]
        )  # fmt: skip
        if stretch.averages is not None:
            stretch.averages.levels[:], stretch.averages.weighted[:] = batch.levels[k], batch.weighted[k]
        stretch.sections[:] = batch.sections[k, longest - len(stretch.sections) :]
    return batch.done.tolist()
