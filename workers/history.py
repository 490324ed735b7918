"""``trace``: the motion of one machine, with its state once a period, every impact, and running means of exponents."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.cell.cell_batch import work_allowed
from workers.cell.interval import batch_of, begin, run, stop_reasons
from workers.kernel.cell_loops import physical_states, reset_frames, states_within
from workers.kernel.lanes.run import MotionBatch
from workers.kernel.motion import OVERDRAFT, PROGRESS, RECORDED, WORK
from workers.model.oscillator import Array, Oscillator, map_fields
from workers.model.system import System, find_system
from workers.results import NO_REASON, REASONS, InvalidError
from workers.settings import Settings, check_whole
from workers.tile import initial_state

RECORD = 4096
"""Initial room, in impacts, for one period; a period with more impacts is repeated with twice the room."""

MAX_TRACE_PERIODS = 1_000_000
"""Maximum number of periods of a history. A history is held in memory, 300 MB and more at this length."""


class Trace(NamedTuple):
    """The motion of one machine over K forcing periods.

    times      (K + 1,) times k T of the sections, the instants at which the force has one fixed phase
    states     (K + 1, 2n) displacements, then velocities, at the sections; the initial state first
    impacts    (N, 3) time, side and speed before the impact, of every impact. The side is +1 for the upper and -1 for
               the lower stop. For contact c of a machine whose law changes by more than one rigid contact it is
               +-(1 + c). Of the infinitely many impacts of a chatter, those above rounding are listed. A row of speed 0
               marks the end of the chatter, where the mass comes to rest on the stop
    exponents  (K, m) running means of the Lyapunov exponents per period. m is 0, 1 or the number of all exponents, as
               ``settings.exponents`` asks; all are 2n, or 2n - 1 if a coordinate drifts
    """

    times: Array
    states: Array
    impacts: Array
    exponents: Array


def trace(
    system: str | System,
    params: Mapping[str, float],
    periods: int,
    settings: Settings | None = None,
    cycle: float | None = None,
) -> Trace:
    """Return the motion of one machine over ``periods`` forcing periods from its initial state, transient included.

    system    name of a packaged system, or a System
    params    parameter name -> value; all others have their defaults
    periods   number of periods, 0 to 1,000,000
    settings  see Settings
    cycle     length of a period of a machine without a force; natural periods if None

    The exponents of a machine without a force are per unit time. Raise KeyError for an unknown name. Raise ValueError,
    in one line, if ``cycle`` is given for a machine with a force, ``periods`` is out of range, or the parameters have
    no motion. Also raise ValueError if the motion costs more evaluations than a cell may spend on this number of
    periods.

    >>> from workers import trace
    >>> history = trace("two-mass", {"omega": 4.0, "b": 0.1}, periods=3)
    >>> history.states.shape, history.impacts.shape
    ((4, 4), (6, 3))
    """
    check_whole("periods", periods, 0, MAX_TRACE_PERIODS)
    record = find_system(system)
    settings = settings or Settings()
    parameters = record.complete({name: float(value) for name, value in params.items()})
    for parameter in record.parameters:
        if not parameter.admits(parameters[parameter.name]):
            raise ValueError(f"{parameter.name} = {parameters[parameter.name]}: must satisfy {parameter.range}")
    values = {name: value.reshape(1) for name, value in parameters.items()}  # the kernels for many cells serve one too
    oscillators, reasons = record.build_many(record.with_cycle(values, cycle))
    starts, cell = initial_state(record, values), np.zeros(1, dtype=np.int64)
    vectors = {"none": 0, "largest": 1, "spectrum": record.exponents}[settings.exponents]
    motions, (reason,) = begin(oscillators, reasons, starts, vectors=vectors, record=RECORD)
    if reason != NO_REASON:
        raise InvalidError(int(reason))
    motions.tally[:, WORK] = work_allowed(periods) + OVERDRAFT
    batch = batch_of(oscillators, motions)
    batch.periods[:] = 1
    period, states, impacts, exponents = oscillators.period[0], [starts[0]], [np.empty((0, 3))], []
    for k in range(periods):
        batch = _a_period_later(batch, cell)
        motions = batch.motions
        (reason,) = stop_reasons(motions, cell)
        if reason != NO_REASON:
            raise ValueError(f"period {k}: {REASONS[reason].text}")
        reset_frames(oscillators.gap.blocks, motions, cell)
        listed = motions.impacts[0, : int(motions.tally[0, RECORDED])] + [k * period, 0.0, 0.0]
        motions.tally[0, RECORDED] = 0.0
        states.append(physical_states(oscillators, motions, cell)[0])
        if record.definition.drift:  # the drift is counted from each section
            drifting = record.states.index(record.definition.drift)
            states[-1][drifting] = starts[0, drifting] + motions.tally[0, PROGRESS]
        impacts.append(listed)
        exponents.append(motions.growth[0] / ((k + 1) * (period if record.definition.unforced else 1)))
    return Trace(
        times=period * np.arange(periods + 1.0),
        states=np.array(states),
        impacts=np.concatenate(impacts),
        exponents=np.array(exponents).reshape(periods, vectors),
    )


def _a_period_later(batch: MotionBatch, cell: NDArray[np.int64]) -> MotionBatch:
    """Return a batch of one motion after one more forcing period.

    If the motion fills its record of impacts, the period is repeated with twice the room. ``cell`` is the row of the
    motion in the batch, as an array.
    """
    before = map_fields(batch.motions._replace(impacts=batch.motions.impacts[:, :0]), np.copy)
    while True:
        batch.completed[:] = 0
        run(batch, cell)
        room = batch.motions.impacts.shape[1]
        if batch.motions.tally[0, RECORDED] < room:
            return batch
        batch = batch._replace(motions=map_fields(before, np.copy)._replace(impacts=np.empty((1, 2 * room, 3))))


def within_periods(oscillators: Oscillator, states: Array, times: Array) -> Array:
    """Return the states (S, K, 2n) of one machine at times (K,) within the period after each of S states.

    oscillators  record of the machine, a batch of one
    states       (S, 2n) displacements, then velocities, at a section, an instant t = k T of fixed phase of the force
    times        (K,) times after the section
    """
    reached: Array = oscillators.with_modes(lambda _: states_within(oscillators, 0, states, times), np.array([0]))
    return reached
