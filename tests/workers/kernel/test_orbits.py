"""Periodic orbits: found with their period, impacts, symmetry and all exponents."""

import json
import math
from typing import Any

import numpy as np
import pytest

from tests import naive
from tests.paths import DATA
from tests.support.oracle.closed_form import symmetric_orbit
from tests.support.oracle.simulate import simulate
from workers.cell.interval import run_periods
from workers.history import trace
from workers.kernel.coordinates import motion_from
from workers.kernel.linalg import moduli, solution, spectral_radius
from workers.kernel.motion import motion_at
from workers.kernel.period import propagate
from workers.kernel.tangent import reset_frame
from workers.orbit.newton import newton_step, recurrence
from workers.results import PERIODIC
from workers.settings import Settings
from workers.tile import solve_tile

REFERENCE: list[dict[str, Any]] = json.loads((DATA / "periodic_orbits.json").read_text())
"""Stable orbits reached from rest with tau = 0, from a plain simulation refined in 40-digit arithmetic."""

SPECTRUM = Settings(exponents="spectrum")


def parameters(record: dict[str, Any]) -> dict[str, float]:
    return {"R" if k == "restitution" else k: float(v) for k, v in record["params"].items()} | {"tau": 0.0}


def mirrored(record: dict[str, Any]) -> bool:
    """The one orbit that is reached through a chaotic transient, see the test that says so."""
    return record["params"]["omega"] == 1.7539


def name(record: dict[str, Any]) -> str:
    return f"omega={record['params']['omega']}"


@pytest.mark.parametrize("record", REFERENCE, ids=name)
def test_a_reference_orbit_has_its_period_impacts_and_exponents(record: dict[str, Any]) -> None:
    found = solve_tile("two-mass", parameters(record), SPECTRUM)
    exact = np.array([float(value) for value in record["exponents"]])
    impacts = (int(found["impacts_upper"]), int(found["impacts_lower"]))
    expected = (record["impacts_upper"], record["impacts_lower"])
    if record["impacts_upper"]:
        assert found["regime"] == PERIODIC
        assert found["min_impact_speed"] == pytest.approx(float(record["min_speed"]), rel=1e-8)
        assert bool(found["symmetric"]) == (expected[0] == expected[1])
    assert found["period"] == record["period"]
    assert (sorted(impacts) if mirrored(record) else list(impacts)) == (
        sorted(expected) if mirrored(record) else list(expected)
    )
    assert found["spectrum"] == pytest.approx(exact, abs=1e-10)
    assert abs(found["largest"] - exact[0]) <= max(30 * found["error"], 2e-13)


def test_the_mirrored_orbit_lies_behind_a_chaotic_transient() -> None:
    """At omega = 1.7539, b = 0.2107 two mirror images attract, and which one is reached is decided by rounding.

    Two multiprecision runs, 30 digits and a start moved by 1e-15 (the rounding of one period in double precision),
    differ by order one after 44 periods. So (3, 2) and (2, 3) impacts are both right answers in double precision.
    """
    params = parameters(next(r for r in REFERENCE if mirrored(r)))
    ends = [simulate(params | {"x1": x1}, 44, digits=30).sections for x1 in (0.0, 1e-15)]
    differences = [max(abs(float(a - b)) for a, b in zip(*states, strict=True)) for states in zip(*ends, strict=True)]
    assert differences[4] < 1e-13
    assert max(differences[36:]) > 1e-3


CLOSED = [
    naive.FIGURES[3],
    naive.FIGURES[3] | {"omega": 4.4, "b": 0.12},
    {"mu_k": 4.01, "mu_m": 2.633, "zeta": 0.0907, "f2": 0.019, "omega": 2.6138, "R": 0.628, "b": 0.3455, "tau": 0.0},
    {"mu_k": 0.768, "mu_m": 4.265, "zeta": 0.8594, "f2": 4.42, "omega": 3.4057, "R": 0.634, "b": 0.3132, "tau": 1.0},
    {"mu_k": 3.291, "mu_m": 0.534, "zeta": 0.0456, "f2": 2.869, "omega": 3.5284, "R": 0.578, "b": 0.3285, "tau": 0.0},
]


@pytest.mark.parametrize("params", CLOSED, ids=lambda p: f"omega={p['omega']}")
def test_symmetric_orbits_with_one_impact_a_side_are_the_closed_form(params: dict[str, float]) -> None:
    """Truth: linear algebra in 40 digits for the state after the impact, the phase and the multipliers."""
    found = solve_tile("two-mass", params, SPECTRUM)
    assert (found["period"], found["impacts_upper"], found["impacts_lower"]) == (1, 1, 1)
    assert found["symmetric"]
    stable = [o for o in symmetric_orbit(params) if o.exponents[0] < 0]
    assert len(stable) == 1
    assert found["spectrum"] == pytest.approx([float(v) for v in stable[0].exponents], abs=1e-12)
    assert found["min_impact_speed"] == pytest.approx(float(stable[0].before[2]), rel=1e-12)


def test_a_sticking_orbit_has_its_two_finite_exponents_and_loses_two() -> None:
    """Multipliers -0.0786795 +- 0.3589800 i, 0, 0."""
    found = solve_tile("two-mass", naive.STICKING, SPECTRUM)
    expected = math.log(abs(complex(-0.0786795, 0.3589800)))
    assert found["regime"] == PERIODIC
    assert found["sticks"]
    assert found["spectrum"][:2] == pytest.approx([expected, expected], abs=2e-7)
    assert np.all(found["spectrum"][2:] == -np.inf)
    assert (found["impacts_upper"], found["impacts_lower"]) == (-1, -1)
    assert math.isnan(found["impacts_per_period"])
    assert math.isnan(found["sum_law_defect"])
    assert found["min_impact_speed"] == 0.0
    assert 0.0 < found["stuck_fraction"] < 1.0


def test_exponents_do_not_depend_on_the_phase_of_the_section() -> None:
    """The same orbit looked at elsewhere, sticking across the section included."""
    for params in (naive.FIGURES[4], naive.STICKING):
        spectra = []
        for shift in (0.0, 0.7, 2.2):
            found = solve_tile("two-mass", params | {"tau": params["tau"] + shift}, SPECTRUM)
            spectra.append(np.sort(np.where(np.isfinite(found["spectrum"]), found["spectrum"], -99.0)))
        assert spectra[1] == pytest.approx(spectra[0], abs=1e-8)
        assert spectra[2] == pytest.approx(spectra[0], abs=1e-8)


def test_force_and_gap_enter_the_exponents_through_their_ratio_alone() -> None:
    """Stops see the gap coordinate only: f2 = 2 and f2 = 0.2 at equal b / |Y| have one spectrum."""
    spectra = []
    for f2 in (2.0, 0.2):
        reference = naive.two_mass(**naive.FIGURES[4])[0].gap.amplitude
        params = naive.FIGURES[4] | {"f2": f2}
        params["b"] = naive.FIGURES[4]["b"] * naive.two_mass(**params)[0].gap.amplitude / reference
        found = solve_tile("two-mass", params, SPECTRUM)
        assert (found["period"], found["impacts_upper"], found["impacts_lower"]) == (1, 2, 2)
        spectra.append(found["spectrum"])
    assert spectra[0] == pytest.approx(spectra[1], abs=1e-12)


LONG = [
    # omega, b, R, period: shorter returns come within a hundredth of the orbit's size, but do not close
    (1.084746, 0.069231, 0.8, 8),
    (1.918644, 0.191026, 0.8, 32),
    (0.962712, 0.280769, 0.8, 4),
    (2.322034, 0.05541, 0.5, 24),
    (1.918591, 0.191026, 0.8, 64),
]


@pytest.mark.parametrize(("omega", "b", "R", "period"), LONG)
def test_the_period_is_the_one_that_closes_not_a_near_return(omega: float, b: float, R: float, period: int) -> None:
    found = solve_tile("two-mass", {"omega": omega, "b": b, "R": R})
    assert (found["regime"], found["period"]) == (PERIODIC, period)


@pytest.mark.parametrize(("omega", "b", "R", "period"), LONG)
def test_a_long_orbit_returns_after_its_period_and_not_halfway(omega: float, b: float, R: float, period: int) -> None:
    """Truth: the section states of the cell followed from the state that was found."""
    params = {"omega": omega, "b": b, "R": R}
    state = solve_tile("two-mass", params)["state"]
    states = trace("two-mass", params | dict(zip(("x1", "x2", "v1", "v2"), state, strict=True)), period).states
    assert states[period] == pytest.approx(states[0], abs=1e-9)
    assert all(np.max(np.abs(states[k] - states[0])) > 1e-6 for k in range(1, period))


def test_recurrence_puts_the_lag_that_closes_first() -> None:
    osc, _ = naive.two_mass(**naive.FIGURES[3])
    sections = np.zeros((20, 2, 2))
    sections[:, 0, 0] = np.arange(20) % 4 * 1e-3
    assert recurrence(osc.gap.blocks, sections, 1.0, 10)[0] == 4


def test_a_newton_step_without_an_answer_is_not_finite() -> None:
    """J = I: every point is fixed, or none."""
    h = np.ones((2, 2))
    assert not np.any(np.isfinite(newton_step(h, 2.0 * h, np.eye(4))))


@pytest.mark.parametrize("size", [1, 2, 4, 6])
def test_moduli_of_eigenvalues_are_those_of_lapack_in_any_units(size: int) -> None:
    rng = np.random.default_rng(size)
    for _ in range(100):
        units = 10.0 ** rng.uniform(-3, 3, size)
        matrix = rng.normal(size=(size, size)) * units[:, None] / units
        expected = np.sort(np.abs(np.linalg.eigvals(matrix)))
        assert np.sort(moduli(matrix)) == pytest.approx(expected, abs=1e-12 * expected[-1])


@pytest.mark.parametrize("power", [-1000, -600, 600, 1000])
def test_moduli_of_tiny_and_of_huge_matrices_are_those_of_the_matrix_in_the_range_of_one(power: int) -> None:
    """To the bit: a power of two changes no digit."""
    matrix = np.random.default_rng(1).normal(size=(4, 4))
    assert moduli(np.ldexp(matrix, power)).tolist() == np.ldexp(moduli(matrix), power).tolist()


def test_moduli_of_special_matrices_are_exact() -> None:
    """Rotations, shifts and defective matrices, on which a QR method without care goes round in circles."""
    cycle = np.roll(np.eye(5), 1, axis=0)
    assert moduli(cycle) == pytest.approx(np.ones(5), abs=1e-14)
    assert moduli(np.array([[0.0, 1.0], [-1.0, 0.0]])) == pytest.approx([1.0, 1.0], abs=1e-15)
    assert moduli(np.diag([1.0, 1.0], 1)).tolist() == [0.0, 0.0, 0.0]


def test_linear_equations_are_solved_with_pivots() -> None:
    rng = np.random.default_rng(4)
    for size in (1, 2, 4, 6):
        matrix, right = rng.normal(size=(size, size)), rng.normal(size=size)
        matrix[0, 0] = 0.0 if size > 1 else 1.0
        assert solution(matrix.copy(), right.copy()) == pytest.approx(np.linalg.solve(matrix, right), rel=1e-10)


def test_a_matrix_that_is_not_finite_has_an_infinite_spectral_radius() -> None:
    assert spectral_radius(np.full((4, 4), np.nan)) == math.inf


def test_the_error_of_a_periodic_orbit_covers_what_its_section_leaves_open() -> None:
    """The exponents of one orbit, seen from several sections, differ by no more than they say."""
    params = {"omega": 1.2067796610169492, "b": 0.28717948717948716}
    state = {"x1": 0.2619022434388998, "x2": 0.05503292883412669, "v1": -0.1271880049395846, "v2": -0.06694213527131512}
    found = solve_tile("two-mass", params | state, SPECTRUM)
    assert found["period"] == 7
    values, errors = [float(found["largest"])], [float(found["error"])]
    for periods in (1, 2, 3):
        section = solve_tile(
            "two-mass", params | state, Settings(method="fixed", transient_periods=0, periods=periods)
        )["state"]
        moved = params | dict(zip(("x1", "x2", "v1", "v2"), section.tolist(), strict=True))
        again = solve_tile("two-mass", moved, SPECTRUM)
        assert again["period"] == 7
        values.append(float(again["largest"]))
        errors.append(float(again["error"]))
    assert max(values) - min(values) <= 20 * max(errors)


def sliced_exponents(params: dict[str, float], slices: int) -> np.ndarray:
    """Exponents of a settled period-1 motion from a frame made orthonormal after each slice of the period."""
    osc, start = naive.two_mass(**params)
    motion = motion_from(osc, start)
    run_periods(osc, motion, 50)
    motion = motion_at(motion.h, int(motion.mode[0]), vectors=4)
    for _ in range(3):
        motion.growth[np.isfinite(motion.growth)] = 0.0
        for k in range(slices):
            propagate(osc._replace(tau=osc.tau + 2 * math.pi * k / slices), motion, osc.period / slices)
            reset_frame(osc.gap.blocks, motion)
    return np.sort(motion.growth)[::-1]


@pytest.mark.parametrize(("zeta", "omega"), [(5.0, 1.0), (1.0, 0.2)])
def test_a_long_overdamped_rest_keeps_the_small_exponent(zeta: float, omega: float) -> None:
    """While it is held the multipliers spread by far more than the 16 digits of double precision.

    Truth: the same motion in slices of the period that are too short for that.
    """
    params = naive.STICKING | {"zeta": zeta, "omega": omega}
    params["b"] = 0.3 * naive.two_mass(**params)[0].gap.amplitude
    found = solve_tile("two-mass", params, SPECTRUM)
    assert (found["regime"], found["period"]) == (PERIODIC, 1)
    assert found["sticks"]
    assert found["spectrum"][:2] == pytest.approx(sliced_exponents(params, 400)[:2], rel=1e-6)


def test_the_longest_overdamped_rest_has_finite_exponents() -> None:
    params = naive.STICKING | {"zeta": 50.0, "omega": 0.1}
    params["b"] = 0.3 * naive.two_mass(**params)[0].gap.amplitude
    found = solve_tile("two-mass", params, Settings(exponents="spectrum", max_periods=500))
    assert found["regime"] == PERIODIC
    assert np.all(np.isfinite(found["spectrum"][:2]))
