"""Exponents known without averaging: the law of their sum, and those of motion without impact."""

import math

import numpy as np
import pytest
from scipy.linalg import eigvals

from tests import naive
from workers import Settings, solve_tile
from workers.cell.exponents import free_exponents, impact_count, sum_law_holds, sum_of_exponents
from workers.cell.interval import run_periods
from workers.kernel.coordinates import motion_from
from workers.kernel.motion import WORK, WORK_OF_A_TRIAL
from workers.kernel.tangent import reset_frame
from workers.results import CHAOTIC


@pytest.mark.parametrize("figure", [3, 4, 5])
def test_independent_exponents_add_up_to_the_exact_sum(figure: int) -> None:
    """sum = -trace(M^-1 C) T + 2 ln R (impacts per period), with M and C written out."""
    p = naive.FIGURES[figure]
    osc, start = naive.two_mass(**p)
    motion = motion_from(osc, start, vectors=4)
    run_periods(osc, motion, 200)
    motion.tally[:] = 0.0
    motion.tally[WORK] = WORK_OF_A_TRIAL
    reset_frame(osc.gap.blocks, motion)
    motion.growth[:] = 0.0
    run_periods(osc, motion, 2000)
    reset_frame(osc.gap.blocks, motion)
    trace = 2 * p["zeta"] * (1 + (1 + p["mu_k"]) / p["mu_m"])
    exact = -trace * 2 * math.pi / p["omega"] + 2 * math.log(p["R"]) * impact_count(motion.tally) / 2000
    assert bool(sum_law_holds(motion.tally))
    assert sum_of_exponents(osc, impact_count(motion.tally) / 2000) == pytest.approx(exact, rel=1e-13)
    assert abs(motion.growth.sum() / 2000 - exact) < 1e-11


def test_the_sum_law_is_not_claimed_where_a_direction_is_lost() -> None:
    for params in (naive.STICKING, naive.FIGURES[3] | {"R": 0.0, "omega": 1.93, "b": 0.52}):
        osc, start = naive.two_mass(**params)
        motion = motion_from(osc, start, vectors=4)
        run_periods(osc, motion, 20)
        assert not bool(sum_law_holds(motion.tally))


@pytest.mark.parametrize("zeta", [0.0, 0.05, 0.5, 1.0 / math.sqrt(2.0 - math.sqrt(1.5)), 5.0, 50.0])
def test_exponents_without_impact_are_the_real_parts_of_the_eigenvalues(zeta: float) -> None:
    """Truth: the eigenvalues of the first-order matrix; at critical damping they are known to 1e-8 only."""
    p = naive.FIGURES[3] | {"zeta": zeta}
    osc, _ = naive.two_mass(**p)
    rates = np.sort(eigvals(naive.first_order(p)[:4, :4]).real)[::-1]
    exact = rates * 2 * math.pi / p["omega"]
    assert free_exponents(osc) == pytest.approx(exact, rel=1e-9, abs=3e-7)
    assert np.all(np.diff(free_exponents(osc)) <= 0)
    assert free_exponents(osc).sum() == pytest.approx(sum_of_exponents(osc, 0.0), rel=1e-12, abs=1e-15)


def test_the_sum_law_holds_for_averages_of_a_free_mass_between_stops() -> None:
    """A rigid mode's flight is a shear: it spreads the tangent vectors too, which must not drown in one another."""
    pair = {
        "name": "pair", "coordinates": ["x"], "mass": [[1.0]], "force": [1.0], "gap": [1.0], "upper": 1.0,
        "lower": -1.0, "restitution": 0.7,
    }  # fmt: skip
    settings = Settings(exponents="spectrum", max_periods=400, survival=0, tolerance=0.05)
    found = solve_tile(pair, {"omega": np.linspace(0.3, 3.0, 100), "v": 0.3}, settings)
    chaotic = found["regime"] == CHAOTIC
    assert np.sum(chaotic) > 10
    assert np.nanmax(np.abs(found["sum_law_defect"][chaotic])) < 1e-13
