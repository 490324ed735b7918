"""The course of a cell from stage to stage, led to where it decides: its averages are put there by hand."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests import naive
from tests.workers.cell.test_solve import TORI
from tests.workers.cell.test_survival import cells_of, relaxation
from workers import Settings, solve_tile
from workers.cell.averages import combined_average, current_average
from workers.cell.interval import Mask, Rows
from workers.cell.schedule import AVERAGING, RELAXATIONS, WARM_UP, AdaptiveSchedule
from workers.kernel.averages import MEAN
from workers.results import (
    CHAOTIC,
    NO_IMPACT,
    NO_REASON,
    NOT_RELAXED,
    NOT_STATIONARY,
    PENDING,
    PERIODIC,
    QUASIPERIODIC,
    UNDETERMINED,
)

TORUS = TORI[0]

FIRST_AVERAGED = 256 + WARM_UP + 192
"""Periods after which the first average is looked at."""


class Led:
    """A cell led through its course, which found, when its first average was looked at, what was put there."""

    def __init__(self, params: dict[str, float], settings: Settings, put: Callable[[AdaptiveSchedule], None]) -> None:
        self.cells = cells_of({name: np.array([value]) for name, value in params.items()}, settings)
        self.course, self.put, self.flown_then = AdaptiveSchedule(self.cells, is_known=self.nothing_known), put, 0
        with np.errstate(all="ignore"):
            self.course.run()
        self.found: dict[str, Any] = {name: values[0] for name, values in self.cells.results.items()}

    def nothing_known(self, rows: Rows) -> Mask:
        if len(rows) and not self.flown_then and self.course.stage[0] == AVERAGING:
            self.flown_then = int(self.cells.periods_flown[0])
            self.put(self.course)
        return np.zeros(len(rows), dtype=np.bool_)


def earlier(mean: float) -> Callable[[AdaptiveSchedule], None]:
    """An average of a thousand periods, closed before."""

    def put(course: AdaptiveSchedule) -> None:
        average = course.cells.previous_average
        average.mean[0], average.error[0], average.periods[0] = mean, 1e-3, 1000.0

    return put


# Averages that differ


def test_motion_that_has_changed_from_chaos_to_a_torus_is_a_torus() -> None:
    course = Led(TORUS, Settings(tolerance=1.0, survival=0), earlier(0.3))
    assert course.found["regime"] == QUASIPERIODIC
    assert abs(course.found["largest"]) < 1e-5
    assert course.flown_then == FIRST_AVERAGED


def test_motion_that_has_changed_to_another_chaos_counts_from_there() -> None:
    """Fig. 5, 1.123; the chaos before it is said to have had an exponent of 3."""
    course = Led(naive.FIGURES[5], Settings(tolerance=0.05, survival=0), earlier(3.0))
    found = course.found
    assert (found["regime"], found["reason"]) == (CHAOTIC, NO_REASON)
    assert found["error"] <= 0.05
    assert abs(found["largest"] - 1.123) < 4.0 * found["error"]
    assert found["survived"] == course.cells.periods_flown[0] - (course.flown_then - 192)


def test_the_memory_of_motion_that_has_changed_counts_from_the_change() -> None:
    """Said to have begun to average too early, before it changed."""

    def put(course: AdaptiveSchedule) -> None:
        earlier(3.0)(course)
        course.cells.first[0], course.transient_periods[0] = 100, 200.0

    found = Led(naive.FIGURES[5], Settings(tolerance=0.05, survival=0), put).found
    assert (found["regime"], found["reason"]) == (CHAOTIC, NO_REASON)


def test_motion_that_ends_without_impact_has_no_impact_speeds_of_the_chaos_before() -> None:
    """Put where it meets no stop any more, when its average is no longer that of chaos."""

    def put(course: AdaptiveSchedule) -> None:
        earlier(3.0)(course)
        course.cells.batch.levels[0, 0, MEAN] = -0.01
        course.cells.batch.motions.h[0] = 0.0

    params = {"omega": 3.28, "R": 0.905, "zeta": 0.005, "b": 0.3}
    found = Led(params, Settings(tolerance=1.0, survival=0), put).found
    assert found["regime"] == NO_IMPACT
    assert all(math.isnan(found[f"{which}_impact_speed"]) for which in ("min", "mean", "max"))


def test_averages_that_agree_are_one() -> None:
    """The thousand periods known to a thousandth outweigh those that are averaged beside them."""
    course = Led(naive.FIGURES[5], Settings(tolerance=0.2, survival=0), earlier(1.123))
    found = course.found
    now = current_average(course.cells, np.arange(1))
    assert (found["regime"], found["reason"]) == (CHAOTIC, NO_REASON)
    apart = abs(now.mean[0] - 1.123) * math.sqrt(1000.0 * now.periods[0])
    wanted = max(math.hypot(1.0, now.error[0] * now.periods[0]), apart) / (1000.0 + now.periods[0])
    assert found["error"] == pytest.approx(wanted, rel=1e-12)
    assert found["survived"] == course.cells.periods_flown[0] - 256


NO_MORE = Settings(tolerance=1.0, survival=0, max_periods=568)
"""Its deciding periods, nine tenths, are spent when the first average is looked at."""


def test_where_averages_differ_and_the_budget_is_spent_the_error_is_their_difference() -> None:
    course = Led(naive.FIGURES[5], NO_MORE, earlier(3.0))
    found = course.found
    assert course.cells.periods_flown[0] == course.flown_then
    assert (found["regime"], found["reason"]) == (CHAOTIC, NOT_STATIONARY)
    assert found["error"] == pytest.approx(3.0 - found["largest"], rel=1e-12)


def test_where_chaos_has_ended_and_the_budget_is_spent_the_class_is_open() -> None:
    found = Led(TORUS, NO_MORE, earlier(0.3)).found
    assert found["regime"] == UNDETERMINED
    assert math.isnan(found["error"])


# Tori


@pytest.mark.parametrize(
    ("before", "now", "flat"),
    [
        (-0.89e-6, -1e-6, True),  # nine spreads
        (-0.9e-6, -0.99e-6, False),  # eleven spreads: a small exponent that is clearly negative
        (-0.8e-6, -0.98e-6, True),  # five and a half
        (9.9e-6, -9.9e-6, True),
        (1.1e-5, 1e-9, False),
        (1e-9, 1.1e-5, False),
        (0.9e-6, 0.99e-6, True),
    ],
)
def test_an_exponent_is_zero_where_two_averages_are_and_do_not_agree_that_it_is_negative(
    before: float, now: float, flat: bool
) -> None:
    def put(course: AdaptiveSchedule) -> None:
        course.weighted[0] = before
        course.cells.batch.weighted[0] = now, 1.0

    course = Led(TORUS, Settings(), put)
    assert course.found["regime"] == QUASIPERIODIC  # it is, and is seen to be later where not now
    assert (course.found["largest"] == now) == flat
    if flat:
        assert course.found["error"] == abs(now - before)
        assert course.cells.periods_flown[0] == course.flown_then


def test_what_may_be_an_orbit_that_closes_slowly_is_no_torus_yet() -> None:
    """Averages as of a torus, and a section that is met again."""

    def put(course: AdaptiveSchedule) -> None:
        course.weighted[0] = 1e-7
        course.cells.batch.weighted[0] = 1e-7, 1.0
        sections = course.cells.batch.sections
        sections[0, -7] = sections[0, -1]

    course = Led(TORUS, Settings(), put)
    assert course.found["regime"] == QUASIPERIODIC  # for the section was put there
    assert course.cells.periods_flown[0] > course.flown_then


# Counts


def test_no_period_is_averaged_twice() -> None:
    """The second average begins where the first ends, or later."""
    cells = cells_of(naive.FIGURES[5] | {"tau": np.linspace(0.0, 1.0, 4)}, Settings(tolerance=0.03, survival=0))
    course, ready, second = AdaptiveSchedule(cells), np.arange(4), False
    with np.errstate(all="ignore"):
        while len(ready):
            course.begin(ready)
            course.judge(cells.run(cells.unfinished, to_end=True))
            ready = cells.unfinished
            average, _ = combined_average(cells, ready)
            since = cells.periods_flown[ready] - cells.since[ready] - WARM_UP
            assert not np.any(average.periods > np.maximum(since, 0))
            second |= bool(np.any(cells.previous_average.periods[ready] > 0.0))
    assert second
    assert np.all(cells.results["regime"] == CHAOTIC)


@pytest.mark.parametrize("exponents", ["none", "largest"])
@pytest.mark.parametrize("max_periods", [1, 40, 300, 500, 1000])
def test_no_cell_is_left_without_a_regime_by_any_budget(max_periods: int, exponents: str) -> None:
    omega, b = np.meshgrid(np.linspace(0.9, 2.0, 6), [0.06, 0.12, 0.28])
    settings = Settings(exponents=exponents, max_periods=max_periods, survival=0)
    found = solve_tile("two-mass", {"omega": omega, "b": b}, settings)
    assert np.all(found["regime"] != PENDING)
    assert np.all(found["periods_used"] > 0)


@pytest.mark.parametrize(("memory", "reason"), [(4000.0, NO_REASON), (9000.0, NOT_RELAXED)])
def test_what_began_before_the_motion_had_forgotten_its_start_says_so_however_long_it_was_watched(
    memory: float, reason: int
) -> None:
    """R = 1. The transient takes 5000 periods at most; the second average begins after 30,000."""
    params = {"b": 0.1, "mu_k": 5.0, "mu_m": 2.0, "omega": 1.6, "R": 1.0, "zeta": 1e-4}
    cells = cells_of({name: np.array([value]) for name, value in params.items()})
    zeta = params["zeta"] * RELAXATIONS * relaxation(cells)[0] / memory
    found = solve_tile("two-mass", params | {"zeta": zeta}, Settings(tolerance=0.05, survival=200_000))
    assert found["regime"] == CHAOTIC
    assert found["survived"] >= 25_000
    assert found["reason"] == reason


@pytest.mark.parametrize(("max_periods", "regime"), [(1200, UNDETERMINED), (20_000, PERIODIC)])
def test_a_long_orbit_is_looked_for_only_where_the_budget_allows_for_it(max_periods: int, regime: int) -> None:
    """Period 32, where orbits of up to 4 are looked for first; a motion is followed for a thousand more to see one."""
    params = {"omega": 1.918644, "b": 0.191026, "R": 0.8}
    found = solve_tile("two-mass", params, Settings(max_periods=max_periods, survival=0, max_period=4))
    assert found["regime"] == regime
    assert 704 <= found["periods_used"] <= max_periods
    assert found["period"] == (32 if regime == PERIODIC else 0)
