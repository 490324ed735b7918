"""Machines that lose nothing: regular motion, whose exponents are 0, and chaos, with its exponent and error."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad

from tests.support.oracle.shaken_mass import follow
from workers import solve_tile
from workers.model.system import System
from workers.results import CHAOTIC, CONSERVATIVE, PERIODS_SPENT, REGULAR, UNDETERMINED
from workers.settings import Settings

SPECTRUM = Settings(exponents="spectrum")
BALL = {"coordinates": ["x"], "mass": [[1.0]], "load": [-1.0]}
SWING = {"coordinates": ["x"], "mass": [[1.0]], "stiffness": [[1.0]]}
ELASTIC = {"gap": [1.0], "restitution": 1.0}
PAIR = {"coordinates": ["x1", "x2"], "mass": [[1.0, 0.0], [0.0, 2.0]], "stiffness": [[2.0, -1.0], [-1.0, 1.5]]}
SPUN = {"damping": [[0.0, 0.7], [-0.7, 0.0]]}
"""Gyroscopic: it takes no energy."""
PAD = {"contacts": [{"name": "pad", "gap": [1.0, 0.0], "upper": 0.3, "lower": -0.3, "stiffness": 20.0}]}
GAP, AMPLITUDE, PERIODS = 3.0, 0.5, 1000
"""Clearance and amplitude of the shaken box, and how long its motions are followed."""


def machine(*parts: dict[str, Any], **more: Any) -> System:
    given: dict[str, Any] = {"name": "lossless"}
    for part in parts:
        given |= part
    return System.from_mapping(given | more)


@pytest.fixture(scope="module")
def box() -> dict[str, NDArray[Any]]:
    """Cells of the packaged impact pair without loss, and the ``growth`` of the same motions by another simulator."""
    rng = np.random.default_rng(0)
    y, v = rng.uniform(-1.4, 1.4, 48), rng.uniform(0.0, 6.0, 48)
    values = {"alpha": AMPLITUDE, "nu": GAP, "R": 1.0, "omega": 1.0, "tau": 0.0, "y": y, "v": v}
    shaken = {"load": 0.0, "force": AMPLITUDE, "omega": 1.0, "tau": 0.0, "lower": -GAP / 2, "upper": GAP / 2, "R": 1.0}
    runs = [follow(**shaken, start=start, periods=PERIODS) for start in zip(y.tolist(), v.tolist(), strict=True)]
    return solve_tile("impact-pair", values, SPECTRUM) | {"growth": np.array([run.stretch.sum() for run in runs])}


def test_the_sea_of_a_fermi_ulam_machine_is_chaotic_and_its_islands_are_regular(box: dict[str, Any]) -> None:
    """Truth: another simulator. Regular motion grows as the time, in 1000 periods to some e^10, chaos to e^200."""
    assert np.all((box["growth"] < 15.0) | (box["growth"] > 200.0))
    assert np.array_equal(box["regime"] == CHAOTIC, box["growth"] > 200.0)
    assert np.array_equal(box["regime"] == REGULAR, box["growth"] < 15.0)
    assert 10 < np.sum(box["regime"] == CHAOTIC) < 38


def test_the_exponent_of_the_sea_is_that_of_another_simulator_within_errors(box: dict[str, Any]) -> None:
    sea = box["regime"] == CHAOTIC
    rates = box["growth"][sea] / PERIODS
    error = np.std(rates) / math.sqrt(len(rates))
    mean, own = np.mean(box["largest"][sea]), np.mean(box["error"][sea]) / math.sqrt(len(rates))
    assert abs(mean - np.mean(rates)) < 4.0 * math.hypot(error, own)
    assert error < 0.04 and own < 0.01


def test_exponents_of_machines_that_lose_nothing_come_in_pairs_of_sum_0(box: dict[str, Any]) -> None:
    assert np.abs(box["spectrum"].sum(axis=1)).max() < 1e-12
    assert np.abs(box["sum_law_defect"]).max() < 1e-12
    found = solve_tile(machine(PAIR, PAD), {"v2": 1.3}, SPECTRUM)
    assert found["regime"] == CHAOTIC
    first, second, third, fourth = found["spectrum"]
    assert first + fourth == pytest.approx(0.0, abs=4.0 * found["error"]) and first > 10.0 * found["error"]
    assert max(abs(second), abs(third)) < 1e-4  # along the motion, and across energies
    assert abs(found["sum_law_defect"]) < 1e-12


def test_regular_motion_has_exponents_0_and_an_error_that_chaos_would_have_shown(box: dict[str, Any]) -> None:
    regular = box["regime"] == REGULAR
    assert not box["largest"][regular].any() and not box["spectrum"][regular].any()
    assert (box["error"][regular] > 0.0).all() and box["error"][regular].max() < 3.4e-4


@pytest.mark.parametrize("height", [0.125, 0.5, 2.0])
def test_a_ball_on_an_elastic_table_bounces_every_2_v_over_g(height: float) -> None:
    found = solve_tile(machine(BALL, ELASTIC, lower=0.0), {"x": height}, SPECTRUM)
    assert (found["regime"], found["reason"], found["period"], found["impacts_lower"]) == (REGULAR, 0, 1, 1)
    assert found["cycle_period"] == pytest.approx(2.0 * math.sqrt(2.0 * height), rel=1e-13)
    assert found["impacts_per_period"] == pytest.approx(1.0 / found["cycle_period"], rel=1e-13)
    assert (found["largest"], found["spectrum"].tolist()) == (0.0, [0.0, 0.0])
    assert found["energy_error"] < 1e-12


@pytest.mark.parametrize("stop", [0.3, -0.2])
def test_a_swing_against_an_elastic_stop_takes_half_a_period_and_two_arcs(stop: float) -> None:
    """x = sin t between its impacts at x = stop: from -pi - asin(stop) to asin(stop)."""
    found = solve_tile(machine(SWING, ELASTIC, upper=stop), {"x": -1.0}, SPECTRUM)
    assert (found["regime"], found["impacts_upper"]) == (REGULAR, 1)
    assert found["cycle_period"] == pytest.approx(math.pi + 2.0 * math.asin(stop), rel=1e-13)
    assert found["energy_error"] < 1e-12


def test_the_energy_of_soft_contacts_and_springs_with_laws_is_kept() -> None:
    """Truth: the period is the integral of dx / v over the energy, here by quadrature."""
    pad = {"name": "pad", "gap": [1.0], "lower": -0.1, "law": [[0.0, 0.0], [0.2, 0.3], [0.5, 3.0]]}
    spring = {"name": "spring", "row": [1.0], "law": [[-2.0, -9.0], [-1.0, -2.0], [0.0, 0.0], [1.0, 1.0], [2.0, 5.0]]}
    system = machine(SWING, mass=[[1.3]], load=[0.2], contacts=[pad], springs=[spring])
    found = solve_tile(system, {"x": 1.7}, SPECTRUM)

    def force(x: float) -> float:
        pushes = np.interp(-0.1 - x, [0.0, 0.2, 0.5], [0.0, 0.3, 3.0]) + 9.0 * max(-0.6 - x, 0.0)
        return float(0.2 - x - np.interp(x, [-2.0, -1.0, 0.0, 1.0, 2.0], [-9.0, -2.0, 0.0, 1.0, 5.0]) + pushes)

    def speed(x: float) -> float:
        kinks = [kink for kink in (-1.0, -0.6, -0.3, -0.1, 0.0, 1.0) if x < kink < 1.7]
        return math.sqrt(max(-2.0 / 1.3 * quad(force, x, 1.7, points=kinks or None, epsabs=1e-13)[0], 0.0))

    low, high = -1.7, 0.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if speed(middle) == 0.0 else (low, middle)
    half = 0.5 * (1.7 - high)
    turn, _ = quad(lambda a: half * math.sin(a) / speed(high + half * (1.0 - math.cos(a))), 0.0, math.pi, limit=200)
    assert found["cycle_period"] == pytest.approx(2.0 * turn, rel=1e-6)
    assert (found["regime"], found["largest"]) == (REGULAR, 0.0)
    assert found["energy_error"] < 1e-12


@pytest.mark.parametrize(
    ("system", "values"),
    [
        (machine(BALL, ELASTIC, lower=0.0, force=[0.02]), {"omega": 1.0, "x": 1.0}),
        (machine(SWING, ELASTIC, upper=0.3, force=[0.1]), {"omega": 1.7, "x": -0.5}),
        (machine(PAIR, PAD, force=[0.1, 0.0]), {"omega": 1.3, "v2": 0.7}),
        (machine(PAIR, PAD), {"v2": [0.2, 1.3]}),
        (machine(PAIR, ELASTIC, gap=[1.0, 0.0], upper=0.3, lower=-0.3), {"v2": [0.3, 1.5]}),
        (machine(PAIR, PAD), {"v2": 0.01}),
        (machine(PAIR, ELASTIC, SPUN, gap=[1.0, 0.0], upper=0.3, lower=-0.3, force=[0.1, 0.0]), {"v2": [0.3, 1.5]}),
        ("bouncing-ball", {"A": 0.0, "R": 1.0, "y": 1.0}),
    ],
)
@pytest.mark.parametrize("budget", [2000, pytest.param(20000, marks=pytest.mark.slow)])
def test_the_budget_is_never_the_reason_where_nothing_is_lost(system: Any, values: dict[str, Any], budget: int) -> None:
    found = solve_tile(system, values, Settings(max_periods=budget, survival=0))
    assert np.isin(found["regime"], (REGULAR, CHAOTIC, UNDETERMINED)).all()
    assert not (found["reason"] == PERIODS_SPENT).any()
    assert (found["reason"][found["regime"] == UNDETERMINED] == CONSERVATIVE).all()
    assert budget == 2000 or (found["regime"] != UNDETERMINED).all()


@pytest.mark.slow
def test_energy_has_no_error_to_tell_where_it_is_lost() -> None:
    system = machine(BALL, ELASTIC, lower=0.0, damping=[["c"]], parameters={"c": 0.0})
    found = solve_tile(system, {"c": [0.0, 0.1], "x": 1.0}, Settings(max_periods=2000))
    assert np.isfinite(found["energy_error"]).tolist() == [True, False]
    assert found["regime"][0] == REGULAR != found["regime"][1]
