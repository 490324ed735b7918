"""One mass that has rested: no direction is left, so that it is not chaotic and repeats where a rest comes back."""

import math

import numpy as np
import pytest

from tests import naive
from tests.support.oracle.machines import bouncing_ball
from tests.support.oracle.simulate import simulate
from tests.workers.cell.test_survival import cells_of
from workers import Settings, solve_tile
from workers.cell.averages import restart
from workers.cell.outcome import put_averaged
from workers.kernel.motion import LOST, MIN_SPEED, STUCK
from workers.results import CHAOTIC, LOCKING, PERIODIC, RESTED

RESTS_IN_THE_WATCH = {"A": 2.133705659525457, "R": 0.6482713451425055}
"""Twenty-four starts of this ball rest within 2,818 periods at the latest."""


def ball(settings: Settings | None = None, **params: float) -> dict[str, np.ndarray]:
    return solve_tile("bouncing-ball", {"omega": 1.0, **params}, settings)


@pytest.mark.parametrize("exponents", ["none", "largest", "spectrum"])
def test_one_mass_that_rests_while_it_is_watched_is_not_chaotic(exponents: str) -> None:
    """No direction is left to grow. What doubles cannot follow from a release to the next rest has no known period."""
    found = solve_tile("bouncing-ball", RESTS_IN_THE_WATCH, Settings(exponents=exponents, tolerance=0.02))
    assert (found["regime"], found["reason"], found["sticks"]) == (LOCKING, RESTED, True)
    assert 0.0 < found["stuck_fraction"] < 1e-2
    assert 0 < found["survived"] < 2818
    if exponents != "none":
        assert (found["largest"], found["error"]) == (-math.inf, 0.0)


def test_a_period_that_rounding_has_made_is_not_given_for_that_of_a_mass_that_rests() -> None:
    """Truth: in 360 digits this ball, released at its start, rests again after 758 periods only, in doubles after 89 or
    184, since disturbances grow 1e48 times until then."""
    found = ball(A=3.3, R=0.5)
    assert (found["regime"], found["reason"], found["period"]) == (LOCKING, RESTED, 0)


@pytest.mark.slow
def test_that_ball_does_not_rest_again_for_190_periods() -> None:
    orbit = simulate(bouncing_ball(3.3, 0.5), 190, digits=110, rest=1e-12)
    assert [float(stay.start) for stay in orbit.stuck] == [0.0]


def test_a_mass_that_rests_every_25_periods_is_found_on_an_orbit_longer_than_any_looked_for() -> None:
    """Truth: the multiprecision orbit rests once in 25 periods, and follows the same release again."""
    A, R = 2.172465413719363, 0.5440729833729444
    found = ball(Settings(max_period=5), A=A, R=R)
    assert (found["regime"], found["period"]) == (PERIODIC, 25)
    assert (found["largest"], found["error"]) == (-math.inf, 0.0)
    T = 2.0 * math.pi
    ends = [float(stay.end) / T for stay in simulate(bouncing_ball(A, R), 80, digits=40).stuck]
    last = [end for end in ends if end > 25.0]
    assert np.diff(last) == pytest.approx(np.round(np.diff(last)), abs=1e-9)
    assert sum(np.diff(last)) % 25 == pytest.approx(0.0, abs=1e-9) and len(last) >= 2


@pytest.mark.slow
def test_the_class_of_a_ball_does_not_depend_on_the_tolerance() -> None:
    rng = np.random.default_rng(2024)
    A, R = rng.uniform(0.5, 5.0, 100), rng.uniform(0.1, 0.95, 100)
    found = [
        solve_tile("bouncing-ball", {"A": A, "R": R, "omega": 1.0}, Settings(tolerance=tolerance))
        for tolerance in (0.05, 0.02, 0.01)
    ]
    for name in ("regime", "period", "sticks"):
        assert all(np.array_equal(other[name], found[0][name]) for other in found)
    assert not np.any(found[0]["sticks"] & (found[0]["regime"] == CHAOTIC))
    assert np.sum(found[0]["reason"] == RESTED) > 10


def test_a_rest_that_only_the_watch_has_seen_takes_two_directions_and_its_share_of_the_time() -> None:
    """Three units of time in 250 periods, of which the last 50 are averaged without one."""
    params = {name: np.array([value]) for name, value in naive.FIGURES[5].items()}
    cells, one = cells_of(params, Settings(exponents="spectrum")), np.arange(1)
    cells.periods_flown[0] = 200
    cells.batch.motions.tally[0, [LOST, STUCK, MIN_SPEED]] = 2.0, 3.0, 0.0
    restart(cells, one)
    cells.averaging[0] = True
    cells.set_interval(one, 50)
    cells.has_frame[0] = True
    cells.run(one, to_end=True)
    with np.errstate(all="ignore"):
        put_averaged(cells, one)
    found = {name: values[0] for name, values in cells.results.items()}
    assert found["sticks"] and math.isnan(found["impacts_per_period"]) and math.isnan(found["sum_law_defect"])
    assert found["stuck_fraction"] == pytest.approx(3.0 / (250.0 * cells.oscillators.period[0]), rel=1e-12)
    assert found["spectrum"][2:].tolist() == [-math.inf, -math.inf]
    assert found["largest"] == pytest.approx(found["spectrum"][0], rel=1e-12) and found["largest"] > 0.0


@pytest.mark.parametrize(
    ("system", "params"),
    [("two-mass", {"omega": 0.001, "b": 0.2}), ("chain-3", {"omega": 0.0005, "b": 0.5, "zeta": 0.1})],
)
def test_an_orbit_whose_multipliers_are_below_all_doubles_is_found_at_once(
    system: str, params: dict[str, float]
) -> None:
    """It repeats every period; its largest multiplier is e^-500 and less."""
    found = solve_tile(system, params)
    assert (found["regime"], found["period"]) == (PERIODIC, 1)
    assert found["largest"] < -500.0 and found["error"] < 1e-8
    assert found["periods_used"] < 100


def test_a_long_orbit_that_chaos_ends_in_is_found_though_the_average_is_still_positive() -> None:
    """It has 125 periods, and its largest exponent is -0.011."""
    params = {"omega": 1.24481, "b": 0.073804, "R": 0.90094, "zeta": 0.02, "mu_m": 3.485476, "mu_k": 1.062836}
    found = solve_tile("two-mass", params)
    assert (found["regime"], found["period"]) == (PERIODIC, 125)
