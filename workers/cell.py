"""What a solution says of one cell: the results of a proved orbit, of impact-free motion and of averages."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workers.exponents import free_exponents, impact_count, sum_law_holds, sum_of_exponents
from workers.kernel.averages import COUNT, MEAN, Averages, standard_error
from workers.kernel.stroboscopic import (
    LOWER,
    MIN_SPEED,
    RUNNING,
    STATUS,
    STUCK,
    UPPER,
    Motion,
    blocks_to_physical,
    motion_at,
    reset_frame,
)
from workers.model.oscillator import Oscillator
from workers.orbit.newton import PeriodicOrbit
from workers.results import (
    CHAOTIC,
    NO_IMPACT,
    NO_REASON,
    PERIODIC,
    QUASIPERIODIC,
    UNDETERMINED,
)
from workers.settings import Settings
from workers.stretch import run_periods

Array = NDArray[np.float64]

CLEAR = 4.0
"""Standard errors above zero from which an exponent is called positive."""

GROWN = 15.0
"""Total log-growth from which a positive exponent counts: a deviation of rounding has become visible."""


@dataclass
class Cell:
    """What is known of one cell: the result variables (see results.py)."""

    largest: float = math.nan
    error: float = math.nan
    spectrum: Array | None = None
    average: Array | float | None = None
    sum_law_defect: float = math.nan
    regime: int = UNDETERMINED
    period: int = 0
    impacts_upper: int = 0
    impacts_lower: int = 0
    impacts_per_period: float = math.nan
    symmetric: bool = False
    sticks: bool = False
    stuck_fraction: float = math.nan
    min_impact_speed: float = math.nan
    periods_used: int = 0
    state: Array | None = None
    section: Array | None = None
    reason: int = NO_REASON


def mean_growth(averages: Averages) -> tuple[float, float, int]:
    """Mean growth per period of the first vector, its standard error, periods averaged."""
    levels = averages.levels
    return float(levels[0, MEAN]), float(standard_error(levels)), int(levels[0, COUNT])


def clearly_positive(mean: float, error: float, count: int) -> bool:
    """Whether an averaged exponent is positive beyond its error, and a deviation has had the time to grow."""
    return mean > CLEAR * error and mean * count > GROWN


def no_impact_cell(osc: Oscillator, motion: Motion, settings: Settings, used: int) -> Cell:
    """Motion that is certain to stay free of impacts: its exponents are those of the linear oscillator."""
    exponents = free_exponents(osc)
    steady = motion_at(np.zeros_like(motion.h) if osc.trace > 0.0 else motion.h)
    return Cell(
        largest=float(exponents[0]),
        error=abs(float(exponents[0])) * 1e-15,
        spectrum=exponents,
        sum_law_defect=float(np.sum(exponents)) - sum_of_exponents(osc, 0.0),
        regime=NO_IMPACT,
        period=1,
        impacts_per_period=0.0,
        stuck_fraction=0.0,
        periods_used=used,
        state=blocks_to_physical(osc, steady),
        section=_sections(osc, steady, settings, 1),
    )


def periodic_cell(osc: Oscillator, orbit: PeriodicOrbit, settings: Settings, used: int) -> Cell:
    """A proved orbit: one turn of it counts impacts and rest; its exponents are the Floquet exponents."""
    turn = motion_at(orbit.h, orbit.contact)
    run_periods(osc, turn, orbit.period)
    sticks = bool(turn.tally[STUCK] > 0.0)
    hits = impact_count(turn) / orbit.period
    if not hits and not sticks:
        return no_impact_cell(osc, turn, settings, used + orbit.period)
    exponents = orbit.exponents
    holds = sum_law_holds(osc, turn)
    start = motion_at(orbit.h, orbit.contact)
    return Cell(
        largest=float(exponents[0]),
        error=orbit.error,
        spectrum=exponents,
        sum_law_defect=float(np.sum(exponents)) - sum_of_exponents(osc, hits) if holds else math.nan,
        regime=PERIODIC,
        period=orbit.period,
        impacts_upper=-1 if sticks else int(turn.tally[UPPER]),
        impacts_lower=-1 if sticks else int(turn.tally[LOWER]),
        impacts_per_period=math.nan if sticks else hits,
        symmetric=orbit.symmetric,
        sticks=sticks,
        stuck_fraction=float(turn.tally[STUCK]) / (orbit.period * osc.period),
        min_impact_speed=_slowest(turn),
        periods_used=used + orbit.period,
        state=blocks_to_physical(osc, start),
        section=_sections(osc, start, settings, orbit.period),
    )


def averaged_cell(osc: Oscillator, motion: Motion, settings: Settings, used: int, averages: Averages | None) -> Cell:
    """What averages show of a motion, its class left open. Counts and growth must span the same periods."""
    cell = Cell(periods_used=used, state=blocks_to_physical(osc, motion))
    count = 0
    if averages is not None and motion.growth.size and averages.levels[0, COUNT] > 0.0:
        cell.largest, cell.error, count = mean_growth(averages)
        reset_frame(osc, motion)
        cell.spectrum = np.sort(motion.growth / count)[::-1]
        cell.average = cell.spectrum.copy() if settings.exponents == "spectrum" else cell.largest
    elif settings.method == "fixed" and used > settings.transient_periods:
        count = used - settings.transient_periods
    if count:
        sticks = bool(motion.tally[STUCK] > 0.0)
        cell.sticks = sticks
        cell.stuck_fraction = float(motion.tally[STUCK]) / (count * osc.period)
        hits = impact_count(motion) / count
        cell.impacts_per_period = math.nan if sticks else hits
        cell.min_impact_speed = _slowest(motion)
        if motion.growth.size == motion.h.size and sum_law_holds(osc, motion):
            cell.sum_law_defect = float(np.sum(motion.growth)) / count - sum_of_exponents(osc, hits)
    cell.section = _sections(osc, motion, settings, 0)
    return cell


def chaotic_cell(osc: Oscillator, motion: Motion, settings: Settings, used: int, averages: Averages) -> Cell:
    """Averages whose exponent is clearly positive."""
    cell = averaged_cell(osc, motion, settings, used, averages)
    cell.regime = CHAOTIC
    return cell


def quasiperiodic_cell(
    osc: Oscillator, motion: Motion, settings: Settings, used: int, averages: Averages, weighted: float, spread: float
) -> Cell:
    """A torus: its exponent is the last stretch's weighted average, its error how much the one before differs."""
    cell = averaged_cell(osc, motion, settings, used, averages)
    cell.regime, cell.largest, cell.error = QUASIPERIODIC, weighted, spread
    if cell.spectrum is not None:
        cell.spectrum[0] = weighted
    return cell


def undecided_cell(osc: Oscillator, motion: Motion, settings: Settings, used: int, averages: Averages | None) -> Cell:
    """The budget is spent: chaotic with its true error if that is clear, else undetermined."""
    cell = averaged_cell(osc, motion, settings, used, averages)
    if averages is not None and clearly_positive(*mean_growth(averages)):
        cell.regime = CHAOTIC
    else:
        cell.error = math.nan
    return cell


def _slowest(motion: Motion) -> float:
    """Slowest impact counted; NaN without impacts, 0 where the mass came to rest."""
    slowest = float(motion.tally[MIN_SPEED])
    return slowest if math.isfinite(slowest) else math.nan


def _sections(osc: Oscillator, motion: Motion, settings: Settings, period: int) -> Array | None:
    """The next K physical section states (K, 2n) of a motion; an orbit of known period is repeated.

    NaN from where the motion cannot be followed to the next section.
    """
    K = settings.section_samples
    if K == 0:
        return None
    ahead = motion_at(motion.h, int(motion.contact[0]))
    states = []
    for _ in range(min(K, period) if period else K):
        reached = ahead.tally[STATUS] == RUNNING
        states.append(blocks_to_physical(osc, ahead) if reached else np.full(ahead.h.size, math.nan))
        if reached:
            run_periods(osc, ahead, 1)
    return np.array([states[k % len(states)] for k in range(K)])
