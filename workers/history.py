"""``trace``: one orbit's history: section states, every impact, exponents as they converge."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.cell.outcome import REASON_OF
from workers.cell.solve import work_allowed
from workers.cell.stretch import run_periods
from workers.kernel.cells import physical_states, reset_frames, start_motions
from workers.kernel.motion import BEYOND, RECORDED, RUNNING, STATUS, WORK, Motion, motions_at
from workers.kernel.stroboscopic import OVERDRAFT
from workers.model.oscillator import Oscillator, each, many_of
from workers.model.system import System, find_system
from workers.results import BEYOND_STOP, ENERGY_OUT_OF_DOUBLES, REASONS, WORK_SPENT, InvalidError
from workers.settings import Settings, check_whole

Array = NDArray[np.float64]

RECORD = 4096
"""Impacts of one period that there is room for; a period of more is gone through again with twice the room."""

LONGEST = 1_000_000
"""Periods of a history, which is kept in memory: 300 MB and more."""


class Trace(NamedTuple):
    """History of one cell over K periods.

    times      (K + 1,)     section times k T
    states     (K + 1, 2n)  physical section states, the initial one first
    impacts    (N, 3)       time, side (+1 upper, -1 lower) and speed before it, of every impact
    exponents  (K, m)       running means of the exponents per period; m = 0, 1 or 2n as settings.exponents asks
    """

    times: Array
    states: Array
    impacts: Array
    exponents: Array


def trace(system: str | System, params: Mapping[str, float], periods: int, settings: Settings | None = None) -> Trace:
    """The history of one cell from its initial state over so many forcing periods, 0 to a million, nothing dropped.

    Raises KeyError for unknown names and ValueError, in one line, for another number of periods, for parameters
    without a motion and where it costs more evaluations than a cell may at most that is solved over so many.
    """
    check_whole("periods", periods, 0, LONGEST)
    record = find_system(system)
    settings = settings or Settings()
    values = {p.name: p.default for p in record.parameters}
    for name, value in params.items():
        parameter = record.parameter(name)
        if not parameter.admits(float(value)):
            raise ValueError(f"{name} = {value}: must satisfy {parameter.range}")
        values[name] = float(value)
    osc = record.build(values)
    start = np.array([values[name] for name in record.states])
    vectors = {"none": 0, "largest": 1, "spectrum": start.size}[settings.exponents]
    oscillators, cell = many_of(osc), np.zeros(1, dtype=np.int64)  # the kernels for many cells serve one too
    motions = motions_at(np.zeros((1, *osc.gap.kick.shape)), vectors=vectors, record=RECORD)
    scale = start_motions(oscillators, motions, start[None], cell)
    motion = each(motions, lambda field: field[0])
    if motion.contact[0] == BEYOND:
        raise InvalidError(BEYOND_STOP)
    if not np.isfinite(scale).all():
        raise InvalidError(ENERGY_OUT_OF_DOUBLES)
    motion.tally[WORK] = work_allowed(periods) + OVERDRAFT
    states, impacts, exponents = [start], [np.empty((0, 3))], []
    for k in range(periods):
        motion = _through_a_period(osc, motion)
        status = int(motion.tally[STATUS])
        if status != RUNNING or motion.tally[WORK] < 0.0:
            reason = WORK_SPENT if status == RUNNING else REASON_OF[status]
            raise ValueError(f"period {k}: {REASONS[reason].text}")
        reset_frames(oscillators.gap.metric, motions, cell)
        found = motion.impacts[: int(motion.tally[RECORDED])].copy()
        found[:, 0] += k * osc.period
        motion.tally[RECORDED] = 0.0
        states.append(physical_states(oscillators, motions, cell)[0])
        impacts.append(found)
        exponents.append(motion.growth / (k + 1))
    return Trace(
        times=osc.period * np.arange(periods + 1.0),
        states=np.array(states),
        impacts=np.concatenate(impacts),
        exponents=np.array(exponents).reshape(periods, motion.growth.size),
    )


def _through_a_period(osc: Oscillator, motion: Motion) -> Motion:
    """The motion a period later, in place but for the record of impacts, which has room for all of them."""
    record = motion.impacts
    before = each(motion._replace(impacts=record[:0]), lambda field: field.copy())
    while True:
        run_periods(osc, motion, 1)
        if motion.tally[RECORDED] < len(record):
            return motion
        for field, old in zip(motion._replace(impacts=before.impacts), before, strict=True):
            field[...] = old
        record = np.empty((2 * len(record), 3))
        motion = motion._replace(impacts=record)
