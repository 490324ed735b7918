"""What becomes of cells: results written of motions that are put in the state that decides them."""

import math

import numpy as np
import pytest

from tests import naive
from tests.workers.cell.test_survival import cells_of
from workers import Settings
from workers.cell.cell_batch import CellBatch
from workers.cell.outcome import end_stopped, put_averaged, put_periodic
from workers.kernel.averages import COUNT, add_to_blocks
from workers.kernel.motion import MARCH_GAVE_UP, MIN_SPEED, NOT_FINITE, OUT_OF_WORK, RUNNING, STATUS, STUCK, UPPER, WORK
from workers.results import CHAOTIC, COSTLY_PERIOD, FAILED, GAVE_UP, NO_REASON, PENDING, UNDETERMINED, WORK_SPENT
from workers.results import NOT_FINITE as NO_LONGER_FINITE

ONE = np.arange(1)


def one_cell(**settings: str) -> CellBatch:
    return cells_of({name: np.array([value]) for name, value in naive.FIGURES[5].items()}, Settings(**settings))


@pytest.mark.parametrize(
    ("status", "h", "work", "regime", "reason"),
    [
        (MARCH_GAVE_UP, 0.1, 1.0, FAILED, GAVE_UP),
        (OUT_OF_WORK, 0.1, 1.0, UNDETERMINED, COSTLY_PERIOD),
        (NOT_FINITE, 0.1, 1.0, FAILED, NO_LONGER_FINITE),
        (RUNNING, math.nan, 1.0, FAILED, NO_LONGER_FINITE),
        (RUNNING, math.inf, -1.0, FAILED, NO_LONGER_FINITE),
        (OUT_OF_WORK, math.nan, 1.0, UNDETERMINED, COSTLY_PERIOD),
        (RUNNING, 0.1, -1.0, UNDETERMINED, WORK_SPENT),
    ],
)
def test_a_motion_that_cannot_go_on_has_a_regime_and_a_reason(
    status: int, h: float, work: float, regime: int, reason: int
) -> None:
    cells = one_cell()
    motions = cells.batch.motions
    motions.h[0, 0, 0], motions.tally[0, STATUS], motions.tally[0, WORK] = h, status, work
    cells.periods_used[0] = 17
    with np.errstate(all="ignore"):
        assert end_stopped(cells, ONE).tolist() == []
    assert (cells.results["regime"][0], cells.results["reason"][0]) == (regime, reason)
    assert cells.results["periods_used"][0] == 17


def test_a_motion_whose_work_is_just_spent_goes_on() -> None:
    cells = one_cell()
    cells.batch.motions.tally[0, WORK] = 0.0
    assert end_stopped(cells, ONE).tolist() == [0]
    assert cells.results["regime"][0] == PENDING


@pytest.mark.parametrize(("exponent", "regime", "reason"), [(1.0, CHAOTIC, NO_REASON), (0.0, UNDETERMINED, WORK_SPENT)])
def test_a_motion_whose_work_is_spent_is_chaotic_where_its_average_is_clearly_positive(
    exponent: float, regime: int, reason: int
) -> None:
    """A thousand periods of noise about an exponent."""
    cells = one_cell()
    for growth in exponent + np.random.default_rng(0).normal(size=1000):
        add_to_blocks(cells.batch.levels[0], growth)
    cells.averaging[0], cells.batch.motions.tally[0, WORK] = True, -1.0
    with np.errstate(all="ignore"):
        assert end_stopped(cells, ONE).tolist() == []
    assert (cells.results["regime"][0], cells.results["reason"][0]) == (regime, reason)
    assert math.isnan(cells.results["error"][0]) == (regime == UNDETERMINED)


def test_the_share_of_the_time_at_rest_is_that_of_the_periods_averaged() -> None:
    """Three units of time in ten periods of 2 pi / omega; what rests on a stop has its slowest impact at speed 0."""
    cells = one_cell()
    cells.averaging[0], cells.periods_flown[0] = True, 10
    cells.batch.levels[0, 0, COUNT] = 10.0
    cells.batch.motions.tally[0, [STUCK, MIN_SPEED]] = 3.0, 0.0
    with np.errstate(all="ignore"):
        put_averaged(cells, ONE)
    found = {name: values[0] for name, values in cells.results.items()}
    assert found["sticks"]
    assert found["stuck_fraction"] == pytest.approx(3.0 * naive.FIGURES[5]["omega"] / (2.0 * math.pi * 10.0), rel=1e-14)
    assert math.isnan(found["impacts_per_period"]) and math.isnan(found["mean_impact_speed"])


def test_the_turn_that_counts_the_impacts_of_an_orbit_is_counted_too() -> None:
    """Three periods of an orbit beside twenty that its proof has cost."""
    cells = one_cell()
    cells.periods_used[0], cells.orbits.period[0], cells.orbits.tally[0, [UPPER, MIN_SPEED]] = 20, 3, (6.0, 0.1)
    put_periodic(cells, ONE)
    assert cells.results["periods_used"][0] == 23
    assert cells.results["impacts_per_period"][0] == 2.0


@pytest.mark.parametrize("missed", [-1e-6, 1e-6])
def test_the_error_of_an_orbit_is_at_least_what_its_exponents_miss_of_the_sum_law(missed: float) -> None:
    """Two impacts in a period; the sum is -trace(M^-1 C) T + 4 ln R."""
    cells = one_cell()
    osc = cells.oscillators
    exact = float(-osc.trace[0] * osc.period[0] + 4.0 * math.log(osc.R[0]))
    cells.orbits.tally[0, UPPER], cells.orbits.error[0] = 2.0, 1e-13
    cells.orbits.exponents[0] = 0.25 * (exact + missed)
    put_periodic(cells, ONE)
    assert cells.results["error"][0] == pytest.approx(1e-6, rel=1e-6)
