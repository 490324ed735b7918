"""Whole cells: regimes, exponents, the fixed schedule, and what one cell may not depend on."""

import json
import math
import os
import subprocess
import sys

import numpy as np
import pytest

from tests import naive
from tests.paths import ROOT
from workers.cell.exponents import free_exponents
from workers.history import trace
from workers.results import (
    APERIODIC,
    CHAOTIC,
    FAILED,
    INVALID,
    NO_IMPACT,
    PERIODIC,
    QUASIPERIODIC,
    UNDETERMINED,
    reason_counts,
    result_variables,
)
from workers.settings import Settings
from workers.tile import solve_tile

SPECTRUM = Settings(exponents="spectrum")


def cell(params, settings: Settings | None = None) -> dict:
    return {name: value[()] for name, value in solve_tile("two-mass", params, settings).items()}


# The paper's schedule

EXACT = {
    3: [-0.235569640371152, -0.235569640371152, -0.524876727616246, -0.524876727616246],
    4: [-0.475914135412643, -2.614830482264854, -2.614830482264854, -7.598746373733903],
}
"""Floquet exponents from 40-digit arithmetic."""


@pytest.mark.parametrize("figure", [3, 4])
def test_the_fixed_schedule_gives_the_papers_stable_exponents(figure: int) -> None:
    """8000 periods, 2000 of them dropped. Truth: 40-digit Floquet exponents.

    A vector that a pair of multipliers turns moves on an ellipse: where it begins and ends there changes an average of
    6000 periods by up to ln(ratio of the axes) / 6000. In Fig. 3 the ratio is 1.10 for the first pair and 9.87 for the
    second (eigenvectors of the map's derivative by central differences, in the energy norm).
    """
    found = cell(naive.FIGURES[figure], Settings(exponents="spectrum", method="fixed"))
    assert found["average"] == pytest.approx(EXACT[figure], abs=math.log(10.0) / 6000)
    assert found["spectrum"] == pytest.approx(EXACT[figure], abs=1e-13)
    assert (found["regime"], found["period"]) == (PERIODIC, 1)
    assert found["impacts_upper"] == found["impacts_lower"] == {3: 1, 4: 2}[figure]
    assert abs(found["sum_law_defect"]) < 1e-11
    assert found["periods_used"] >= 8000


def test_the_fixed_schedule_gives_the_papers_chaotic_exponents() -> None:
    """Fig. 5: 1.123, -1.577, -1.582, -4.38, each known to 0.002, and 2.637 impacts a period."""
    settings = Settings(exponents="spectrum", method="fixed", transient_periods=2000, periods=40000)
    found = cell(naive.FIGURES[5], settings)
    assert found["regime"] == CHAOTIC
    assert found["error"] == pytest.approx(math.sqrt(0.594 * 1.05 / 40000), rel=0.3)
    assert np.max(np.abs(found["spectrum"] - [1.123, -1.577, -1.582, -4.38])) < 4 * found["error"] + 0.005
    assert found["spectrum"][0] == pytest.approx(found["largest"], abs=1e-10)
    assert found["impacts_per_period"] == pytest.approx(2.637, abs=0.01)
    assert abs(found["sum_law_defect"]) < 1e-11


def test_the_fixed_schedule_may_go_without_a_transient() -> None:
    found = cell(naive.FIGURES[3], Settings(method="fixed", transient_periods=0, periods=500))
    assert found["average"] == pytest.approx(EXACT[3][0], abs=0.02)


@pytest.mark.parametrize("exponents", ["largest", "spectrum"])
def test_a_chaotic_transient_inside_the_average_leaves_a_periodic_cell_its_exact_exponents(exponents: str) -> None:
    """Cells of a plane that settle while they are averaged. Truth: the adaptive method from their states on."""
    omega, R = np.meshgrid(np.linspace(1.5, 4.5, 20), np.linspace(0.9, 1.0, 20))
    params = {"omega": omega, "R": R, "zeta": 0.005, "b": 0.3, "mu_k": 5.0, "mu_m": 2.0}
    schedule = Settings(exponents=exponents, method="fixed", transient_periods=500, periods=4000)
    found = solve_tile("two-mass", params, schedule)
    late = np.isin(found["regime"], (NO_IMPACT, PERIODIC)) & (found["average"].reshape(20, 20, -1)[..., 0] > 0.1)
    assert late.sum() >= 5
    states = dict(zip(("x1", "x2", "v1", "v2"), found["state"][late].T, strict=True))
    exact = solve_tile(
        "two-mass", params | {"omega": omega[late], "R": R[late]} | states, Settings(exponents=exponents)
    )
    for name in ("regime", "period"):
        assert np.array_equal(found[name][late], exact[name])
    for name in set(exact) & {"largest", "spectrum"}:
        assert found[name][late] == pytest.approx(exact[name], abs=1e-9)
    assert np.max(found["error"][late]) < 1e-9


def test_the_average_of_a_chaotic_cell_is_its_exponent() -> None:
    found = cell(naive.FIGURES[5], Settings(method="fixed", transient_periods=100, periods=2000))
    assert found["regime"] == CHAOTIC
    assert found["average"] == found["largest"]


@pytest.mark.parametrize(
    ("settings", "dims"),
    [
        (Settings(), None),
        (Settings(method="fixed", exponents="none"), None),
        (Settings(method="fixed"), ()),
        (Settings(method="fixed", exponents="spectrum"), ("exponent",)),
    ],
)
def test_only_a_schedule_with_exponents_has_an_average(settings: Settings, dims: tuple[str, ...] | None) -> None:
    found = {variable.name: variable.extra_dims for variable in result_variables(settings)}
    assert found.get("average") == dims


# Adaptive


@pytest.mark.parametrize("figure", [3, 4])
def test_periodic_cells_have_exact_exponents_at_a_hundredth_of_the_work(figure: int) -> None:
    found = cell(naive.FIGURES[figure], SPECTRUM)
    assert found["spectrum"] == pytest.approx(EXACT[figure], abs=1e-13)
    assert found["periods_used"] < 80
    assert abs(found["sum_law_defect"]) < 1e-12


def test_a_chaotic_cell_stops_at_its_tolerance() -> None:
    """Fig. 5 at two tolerances; truth: 1.123, known to 0.002."""
    used = []
    for tolerance in (0.02, 0.008):
        found = cell(naive.FIGURES[5], Settings(tolerance=tolerance, survival=0))
        assert found["regime"] == CHAOTIC
        assert found["error"] <= tolerance
        assert abs(found["largest"] - 1.123) < 4 * found["error"]
        used.append(found["periods_used"])
    assert 2.0 < used[1] / used[0] < 12.0  # ideally 6.25


def test_error_bars_of_chaotic_cells_are_right_within_statistics() -> None:
    """Runs of Fig. 5 from 600 starts, against the exponent of a long one: physics of Li & Tan (2011), 1.123 +- .002."""
    starts = np.linspace(-0.15, 0.15, 600)
    found = solve_tile("two-mass", naive.FIGURES[5] | {"x1": starts}, Settings(tolerance=0.03))
    assert np.all(found["regime"] == CHAOTIC)
    z = (found["largest"] - 1.123) / np.hypot(found["error"], 0.002)
    assert 0.7 < math.sqrt(np.mean(z**2)) < 1.3
    assert np.mean(np.abs(z) < 2) >= 0.9


def test_a_chaotic_cell_short_of_its_tolerance_is_chaotic_with_its_true_error() -> None:
    found = cell(naive.FIGURES[5], Settings(tolerance=1e-4, max_periods=2000))
    assert found["regime"] == CHAOTIC
    assert found["error"] == pytest.approx(math.sqrt(0.594 * 1.05 / 1500), rel=0.5)


TORI = [
    {"mu_m": 0.321, "mu_k": 0.9674, "zeta": 0.0303, "omega": 5.4675, "R": 0.7889, "f2": 0.0, "b": 0.03536},
    {"mu_m": 1.4009, "mu_k": 1.7819, "zeta": 0.00999, "omega": 3.5401, "R": 0.5902, "f2": 0.5, "b": 0.03771},
    {"mu_m": 0.3401, "mu_k": 0.8662, "zeta": 0.00789, "omega": 5.5606, "R": 0.7306, "f2": 2.0, "b": 0.04355},
]


@pytest.mark.parametrize("params", TORI, ids=lambda p: f"omega={p['omega']}")
def test_a_torus_is_quasiperiodic_with_a_largest_exponent_of_zero(params: dict[str, float]) -> None:
    """Truth: a plain average over 50000 periods is zero to its own accuracy, and nothing closes up to period 64."""
    found = cell(params, SPECTRUM)
    assert found["regime"] == QUASIPERIODIC
    assert found["period"] == 0
    assert abs(found["largest"]) < 1e-5
    assert found["spectrum"][0] == found["largest"]
    assert found["spectrum"][1] < -1e-3
    assert found["kaplan_yorke"] == 1.0  # a closed curve of the map, whatever rounding has made of the zero
    long = cell(params, Settings(method="fixed", transient_periods=5000, periods=50000))
    assert abs(long["largest"]) < 1e-4
    assert long["regime"] not in (PERIODIC, NO_IMPACT)


WEAKLY_DAMPED = [
    {"mu_m": 4.31, "mu_k": 68.6, "omega": 6.05, "zeta": 0.0, "R": 0.372, "f2": -3.23, "tau": 3.53, "b": 0.0054},
    {"mu_m": 0.324, "mu_k": 858.0, "omega": 16.5, "zeta": 0.0, "R": 0.154, "f2": 2.12, "tau": 6.24, "b": 0.000127},
]


@pytest.mark.parametrize("params", WEAKLY_DAMPED, ids=lambda p: f"omega={p['omega']}")
def test_a_small_exponent_that_is_clearly_not_zero_is_no_torus(params: dict[str, float]) -> None:
    """Truth: 100000 periods average to -7.02e-6 and -6.7e-7. The motion settles, in a million periods."""
    assert cell(params, SPECTRUM)["regime"] != QUASIPERIODIC


@pytest.mark.parametrize("max_periods", [1, 10, 40, 100, 300, 1000])
def test_a_cell_never_costs_more_than_its_budget(max_periods: int) -> None:
    omega, b = np.meshgrid(np.linspace(0.9, 2.0, 6), [0.06, 0.12, 0.28])
    found = solve_tile("two-mass", {"omega": omega, "b": b}, Settings(max_periods=max_periods, survival=0))
    assert found["periods_used"].max() <= max_periods


# No impact


@pytest.mark.parametrize("zeta", [0.0, 0.05, 5.0])
def test_a_gap_that_is_never_reached_needs_no_simulation(zeta: float) -> None:
    params = naive.FIGURES[3] | {"zeta": zeta, "b": 50.0}
    found = cell(params, SPECTRUM)
    assert found["regime"] == NO_IMPACT
    assert found["periods_used"] == 0
    assert found["period"] == 1
    assert found["spectrum"] == pytest.approx(free_exponents(naive.two_mass(**params)[0]), abs=0)
    assert found["error"] == pytest.approx(1e-15 * abs(found["largest"]), rel=1e-12, abs=0.0)  # rounding
    assert found["sum_law_defect"] == pytest.approx(0.0, abs=1e-14 * abs(found["spectrum"].sum()))
    assert found["impacts_per_period"] == 0.0
    assert math.isnan(found["min_impact_speed"])


def test_impacts_of_the_transient_alone_end_without_impact() -> None:
    """A fast start hits the stops; what is left in the end does not reach them."""
    params = naive.FIGURES[3] | {"zeta": 0.5, "R": 0.3, "v1": 2.0}
    params["b"] = 2.0 * naive.two_mass(**params)[0].gap.amplitude
    found = cell(params, SPECTRUM)
    assert len(trace("two-mass", params, 5).impacts) > 0
    assert found["regime"] == NO_IMPACT
    assert 0 < found["periods_used"] < 300


def test_the_state_without_impact_is_the_forced_response() -> None:
    """Truth: (K - omega^2 M + i omega C) x = f, written out."""
    p = naive.FIGURES[3] | {"b": 50.0, "tau": 0.3}
    mass, K = np.diag([1.0, p["mu_m"]]), np.array([[1.0, -1.0], [-1.0, 1 + p["mu_k"]]])
    w = p["omega"]
    x = np.linalg.solve(K - w**2 * mass + 2j * w * p["zeta"] * K, [1 - p["f2"], p["f2"]]) * np.exp(1j * p["tau"])
    assert cell(p)["state"] == pytest.approx(np.concatenate([x.imag, (1j * w * x).imag]), abs=1e-15)


# States on and beyond a stop, extremes


@pytest.mark.parametrize(
    "changes",
    [
        {"x1": 0.1, "v1": 0.5}, {"x1": 0.1, "v1": -0.5}, {"x1": 0.1, "x2": 1.0}, {"x1": 0.1, "x2": -1.0},
        {"x1": 0.1}, {"x1": -0.1}, {"R": 0.0}, {"zeta": 5.0}, {"zeta": 1.0 / math.sqrt(2.0 - math.sqrt(1.5))},
    ],
    ids=str,
)  # fmt: skip
def test_unusual_starts_and_parameters_have_a_regime_and_finite_exponents(changes: dict[str, float]) -> None:
    found = cell(naive.FIGURES[3] | changes, SPECTRUM)
    assert found["regime"] in (NO_IMPACT, PERIODIC)
    assert found["largest"] < 0
    assert not np.any(np.isnan(found["spectrum"]))


@pytest.mark.parametrize("changes", [{"R": 1.0}, {"zeta": 0.0}], ids=str)
def test_without_one_kind_of_loss_the_other_alone_sets_the_sum(changes: dict[str, float]) -> None:
    found = cell(naive.FIGURES[3] | changes, SPECTRUM)
    assert found["regime"] not in (FAILED, INVALID, UNDETERMINED)
    assert abs(found["sum_law_defect"]) < 1e-9


@pytest.mark.parametrize(
    "changes",
    [
        {"R": 1.2}, {"R": -0.1}, {"b": 0.0}, {"b": -1.0}, {"omega": 0.0}, {"mu_m": -1.0}, {"mu_k": 0.0},
        {"zeta": -0.1}, {"omega": math.nan}, {"b": math.inf}, {"x1": 0.11}, {"x1": -0.1000001}, {"v1": math.nan},
    ],
    ids=str,
)  # fmt: skip
def test_senseless_parameters_are_invalid_with_a_reason_and_raise_nothing(changes: dict[str, float]) -> None:
    solution = solve_tile("two-mass", naive.FIGURES[3] | changes, SPECTRUM)
    assert solution["regime"] == INVALID
    assert math.isnan(solution["largest"])
    assert sum(reason_counts(solution["reason"]).values()) == 1


def test_undamped_resonance_has_a_reason() -> None:
    """mu_k = 1.5, mu_m = 1: the squared frequencies are 1/2 and 3, up to rounding."""
    params = naive.FIGURES[3] | {"zeta": 0.0, "mu_k": 1.5, "mu_m": 1.0, "omega": math.sqrt(0.5)}
    solution = solve_tile("two-mass", params, SPECTRUM)
    assert solution["regime"] in (INVALID, FAILED)
    assert sum(reason_counts(solution["reason"]).values()) == 1


def test_unknown_names_are_errors_that_name_the_nearest() -> None:
    with pytest.raises(KeyError, match="did you mean 'omega'"):
        solve_tile("two-mass", {"omga": 1.0})
    with pytest.raises(KeyError, match="did you mean 'two-mass'"):
        solve_tile("two-masses", {})


def test_a_cell_that_sticks_only_on_the_way_has_a_full_spectrum() -> None:
    """Directions lost in the transient say nothing of the attractor. Truth: the same cell from another start."""
    osc_params = naive.FIGURES[5]
    pressed = {"x1": 0.2, "v1": 0.0, "x2": 3.0}
    settings = Settings(exponents="spectrum", tolerance=0.05)
    found = cell(osc_params | pressed, settings)
    assert found["regime"] == CHAOTIC
    assert not found["sticks"]
    assert np.all(np.isfinite(found["spectrum"]))
    assert found["spectrum"] == pytest.approx([1.123, -1.577, -1.582, -4.38], abs=0.3)
    assert abs(found["sum_law_defect"]) < 1e-11


# What a cell may depend on

PLANE = {
    "omega": np.array([[1.2, 1.7, 2.3, 2.9], [3.1, 3.5, 3.9, 0.9], [1.0, 1.5, 2.0, 4.0]]),
    "b": np.array([[0.06, 0.1, 0.15, 0.2], [0.3, 0.6, 0.02, 0.25], [0.11, 0.17, 0.23, 0.05]]),
}


def same(one: np.ndarray, other: np.ndarray) -> bool:
    return one.dtype == other.dtype and one.tobytes() == other.tobytes()


def test_results_have_the_broadcast_shape_of_the_parameters() -> None:
    settings = Settings(exponents="spectrum", section_samples=5)
    found = solve_tile("two-mass", {"omega": np.array([3.0, 4.0, 5.0]), "b": np.array([[9.0], [8.0]])}, settings)
    for variable in result_variables(settings):
        extra = {"exponent": 4, "state": 4, "sample": 5}
        assert found[variable.name].shape == (2, 3, *(extra[name] for name in variable.extra_dims))
        assert found[variable.name].dtype == variable.dtype


@pytest.mark.parametrize("exponents", ["none", "largest", "spectrum"])
def test_period_and_impacts_do_not_depend_on_the_exponents_asked_for(exponents: str) -> None:
    found = cell(naive.FIGURES[4], Settings(exponents=exponents))
    assert (found["regime"], found["period"], found["impacts_upper"], found["impacts_lower"]) == (PERIODIC, 1, 2, 2)
    assert ("largest" in found) == (exponents != "none")
    assert ("spectrum" in found) == (exponents == "spectrum")


def test_without_exponents_chaos_is_aperiodic() -> None:
    assert cell(naive.FIGURES[5], Settings(exponents="none", max_periods=2000))["regime"] == APERIODIC


def test_without_exponents_impacts_are_counted_from_the_end_of_the_transient() -> None:
    """Fig. 5: 2.637 impacts a period, over the thousand periods that it is watched."""
    found = cell(naive.FIGURES[5], Settings(exponents="none", survival=32_000))
    assert 1000 <= found["survived"] < 1500
    assert found["impacts_per_period"] == pytest.approx(2.637, abs=0.1)


def test_section_samples_of_an_orbit_repeat_with_its_period() -> None:
    params = {"omega": 1.8488, "b": 0.2084, "tau": 0.0}
    found = cell(params, Settings(section_samples=6))
    assert found["period"] == 2
    assert same(found["section"][0], found["section"][2])
    assert same(found["section"][1], found["section"][5])
    assert np.max(np.abs(found["section"][0] - found["section"][1])) > 1e-3
    assert same(found["section"][0], found["state"])


def test_no_section_lies_beyond_a_stop() -> None:
    found = solve_tile("two-mass", PLANE, Settings(max_periods=500, section_samples=50))
    assert np.all(np.abs(found["section"][..., 0]) <= PLANE["b"][..., None])


def test_a_cell_whose_work_is_spent_before_its_first_average_has_none() -> None:
    """Hundreds of impacts a period, R = 1: the work allowed ends while the tangent frame is still turning."""
    slow = {
        "omega": 0.004918953065571135, "mu_m": 117.30934236447666, "mu_k": 3.5639738775729684, "R": 1.0,
        "zeta": 0.001674529202922787, "f2": 0.4554438739540293, "tau": 2.77759314200008, "b": 0.696687572463249,
    }  # fmt: skip
    found = solve_tile("two-mass", slow, Settings(exponents="spectrum", max_periods=400, survival=0))
    assert found["regime"] == 4
    assert 256 < found["periods_used"] < 400
    assert np.isnan(found["largest"])
    assert np.all(np.isnan(found["spectrum"]))


# The kernels are plain Python

LIGHT = """
import json, sys
import numpy as np
from workers.settings import Settings
from workers.tile import solve_tile
np.seterr(all="ignore")  # branch-free code computes both sides of a choice, also the one that divides by zero
cells = json.loads(sys.argv[1])
out = []
for params in cells:
    found = solve_tile("two-mass", params, Settings(exponents="spectrum", max_periods=60))
    out.append({k: np.asarray(v, dtype=float).ravel().tolist() for k, v in found.items()})
print(json.dumps(out))
"""


@pytest.mark.slow
def test_kernels_run_as_plain_python_give_the_same_results() -> None:
    """NUMBA_DISABLE_JIT=1, warnings are errors: periodic, sticking, impact-free and inelastic cells."""
    cells = [
        naive.FIGURES[3], naive.FIGURES[4], naive.STICKING, naive.FIGURES[3] | {"b": 9.0},
        naive.FIGURES[3] | {"R": 0.0, "omega": 1.93, "b": 0.52}, naive.FIGURES[3] | {"x1": 0.1, "x2": 1.5},
    ]  # fmt: skip
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", LIGHT, json.dumps(cells)],
        env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for params, plain in zip(cells, json.loads(done.stdout), strict=True):
        compiled = solve_tile("two-mass", params, Settings(exponents="spectrum", max_periods=60))
        assert set(plain) == set(compiled)
        for name, value in compiled.items():
            if name in ("error", "sum_law_defect"):
                continue
            # Rounding decides the last step of Newton's method, and the hop after which chatter counts as complete.
            near = {"periods_used": 2.0, "stuck_fraction": 1e-9}.get(name, 1e-12)
            assert np.asarray(plain[name]) == pytest.approx(value.ravel().astype(float), abs=near, nan_ok=True), name
