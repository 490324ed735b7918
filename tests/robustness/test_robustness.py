"""Claims about return time, reactivity and amplification of attractors, and about the norm they are measured in."""

import json
import math

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.linalg import expm

import atlas
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.robustness.linear_measures import (
    DRIFTS,
    JUMPS,
    NO_ORBIT,
    STICKS,
    TOUCHES,
    amplification,
    phases_of,
    reactivity,
    touches_a_stop,
)
from atlas.robustness.norm import weight_matrices
from workers import Settings, trace
from workers.attractors.basins import AttractorTable
from workers.attractors.initial_states import AttractorSettings
from workers.model.system import find_system

FIG3 = {"omega": 4.0, "b": 0.1}
"""Period 1, period 3 and motion without impact, of two masses."""
FREE = {"omega": 1.5, "A": 0.1, "b": 50.0, "zeta": 0.05}
"""One mass that does not reach its stop."""


def table_of(system: str, given: dict[str, float], starts: int = 4, settings: Settings | None = None) -> AttractorTable:
    record = find_system(system)
    values = {p.name: given.get(p.name, p.default) for p in record.parameters}
    return AttractorTable(record, values, settings or Settings(), AttractorSettings(starts))


def cycled(matrices: np.ndarray, first: int, count: int) -> np.ndarray:
    """The product of ``count`` matrices in turn, the one in place ``first`` first: a naive twin."""
    product = np.eye(matrices.shape[1])
    for k in range(first, first + count):
        product = matrices[k % len(matrices)] @ product
    return product


def test_a_linear_machine_has_the_measures_of_its_matrix_exponential() -> None:
    weights = {"x": 1.0, "v": 3.0}
    (found,) = atlas.stability(FREE, system="single-mass", starts=2, norm=weights)["coexisting"]
    T = 2.0 * math.pi / FREE["omega"]
    W = np.diag([1.0, 3.0])
    A = np.array([[0.0, 1.0], [-1.0, -2.0 * FREE["zeta"]]])
    norms = [np.linalg.norm(W @ expm(A * T * k) @ np.linalg.inv(W), 2) for k in range(200)]
    assert found["return_time"] == pytest.approx(1.0 / (FREE["zeta"] * T), rel=1e-12)
    assert found["reactivity"] == pytest.approx(math.log(norms[1]), rel=1e-9)
    assert found["amplification"] == pytest.approx(max(norms), rel=1e-9)
    assert found["amplified_after"] == int(np.argmax(norms)) > 0


@pytest.mark.parametrize(("a", "b", "d"), [(0.9, 5.0, 0.7), (0.5, 0.1, -0.4), (0.95, 2.0, 0.2)])
def test_a_triangular_matrix_has_the_norms_of_the_closed_form(a: float, b: float, d: float) -> None:
    """M^k = [[a^k, b (a^k - d^k)/(a - d)], [0, d^k]]; |M|^2 = (F + sqrt(F^2 - 4 det^2))/2, F = the sum of squares."""

    def norm(k: int) -> float:
        entries = (a**k, b * (a**k - d**k) / (a - d), d**k)
        F, det = sum(entry * entry for entry in entries), entries[0] * entries[2]
        return math.sqrt(0.5 * (F + math.sqrt(max(F * F - 4.0 * det * det, 0.0))))

    matrix = np.array([[[a, b], [0.0, d]]])
    sizes = [norm(k) for k in range(400)]
    assert reactivity(matrix) == pytest.approx(math.log(sizes[1]), rel=1e-12)
    growth = amplification(matrix)
    assert growth is not None
    assert growth[0] == pytest.approx(max(sizes), rel=1e-12)
    assert growth[1] == int(np.argmax(sizes))


@pytest.mark.parametrize("seed", range(6))
def test_the_amplification_of_a_cycle_is_that_of_all_products_far_beyond_its_end(seed: int) -> None:
    rng = np.random.default_rng(seed)
    matrices = rng.standard_normal((3, 4, 4))
    matrices *= (0.8 / np.abs(np.linalg.eigvals(cycled(matrices, 0, 3))).max()) ** (1.0 / 3.0)
    naive = max(np.linalg.norm(cycled(matrices, first, m), 2) for first in range(3) for m in range(400))
    growth = amplification(matrices)
    assert growth is not None
    assert growth[0] == pytest.approx(naive, rel=1e-12)
    assert growth[0] >= math.exp(reactivity(matrices))


def test_growth_that_never_ends_is_not_called_bounded() -> None:
    assert amplification(np.array([[[1.0, 1.0], [0.0, 1.0]]]), limit=1000) is None


def test_a_contraction_has_no_amplification_and_negative_reactivity() -> None:
    matrix = 0.5 * np.eye(3)[None]
    assert amplification(matrix) == (1.0, 0)
    assert reactivity(matrix) == pytest.approx(math.log(0.5))


@pytest.mark.parametrize(
    ("system", "given"), [("two-mass", FIG3), ("soft-impact", {}), ("single-mass", {"omega": 0.8, "A": 0.6})]
)
def test_jacobians_of_the_phases_are_finite_differences_of_the_simulated_map(
    system: str, given: dict[str, float]
) -> None:
    table = table_of(system, given, 12)
    seen = 0
    for attractor in table.attractors:
        phases = phases_of(table.cell.oscillator, attractor)
        if isinstance(phases, str):
            continue
        for state, jacobian in zip(phases.states, phases.jacobians, strict=True):
            assert jacobian == pytest.approx(differences(table, state), abs=2e-5 * np.abs(jacobian).max())
            seen += 1
    assert seen > 0


def differences(table: AttractorTable, state: np.ndarray, step: float = 1e-7) -> np.ndarray:
    """Central differences (2n, 2n) of the map of one period, simulated from physical states."""
    fixed = {name: float(values[0]) for name, values in table.params.items()}

    def image(at: np.ndarray) -> np.ndarray:
        return trace(table.record, fixed | dict(zip(table.record.states, at, strict=True)), 1).states[-1]

    columns = [(image(state + step * e) - image(state - step * e)) / (2.0 * step) for e in np.eye(len(state))]
    return np.array(columns).T


def test_the_jacobians_of_all_phases_make_the_multipliers_of_the_orbit() -> None:
    table = table_of("two-mass", FIG3, 16)
    (triple,) = [attractor for attractor in table.attractors if attractor.period == 3]
    phases = phases_of(table.cell.oscillator, triple)
    assert not isinstance(phases, str)
    radius = np.abs(np.linalg.eigvals(cycled(phases.jacobians, 0, 3))).max()
    assert math.log(radius) / 3.0 == pytest.approx(float(triple.result["largest"]), rel=1e-9)


def test_each_phase_leads_to_the_next_one() -> None:
    table = table_of("two-mass", FIG3, 16)
    (triple,) = [attractor for attractor in table.attractors if attractor.period == 3]
    phases = phases_of(table.cell.oscillator, triple)
    assert not isinstance(phases, str)
    fixed = {name: float(values[0]) for name, values in table.params.items()}
    start = dict(zip(table.record.states, phases.states[0], strict=True))
    states = trace("two-mass", fixed | start, 3).states
    assert states == pytest.approx(np.vstack([phases.states, phases.states[:1]]), abs=1e-12)


def test_chaos_has_no_measure_and_a_reason() -> None:
    brief = Settings(max_periods=4000, survival=8000, tolerance=0.05)
    (found,) = atlas.stability({"omega": 1.409, "b": 0.267}, starts=2, settings=brief)["coexisting"]
    assert found["reason"] == NO_ORBIT
    assert np.isnan([found["return_time"], found["reactivity"], found["amplification"]]).all()
    assert found["amplified_after"] == -1


def test_undamped_motion_without_impact_never_returns() -> None:
    (found,) = atlas.stability(FREE | {"zeta": 0.0}, system="single-mass", starts=1)["coexisting"]
    assert found["return_time"] == math.inf
    assert math.isnan(found["amplification"]) and "does not decay" in found["reason"]


@pytest.mark.parametrize(("v", "away", "touches"), [(1.0, 0.0, True), (1.0, 1e-10, True), (1.0, 1e-3, False)])
def test_a_state_on_a_stop_has_no_smooth_map(v: float, away: float, touches: bool) -> None:
    table = table_of("single-mass", FREE, 1)
    assert touches_a_stop(table.cell.oscillator, np.array([[FREE["b"] - away, v]])) is touches


def test_a_ball_that_rests_on_its_table_at_the_section_is_not_linearised() -> None:
    (found,) = atlas.stability({"R": 0.5}, system="bouncing-ball", starts=3)["coexisting"]
    assert (found["reason"], found["return_time"]) == (TOUCHES, 0.0)
    assert math.isnan(found["reactivity"]) and math.isnan(found["amplification"])


STICKS_ON = {"omega": 0.25, "A": 1.6}
"""Friction sticks at the section under a force between the kinetic and the static one."""


@pytest.mark.parametrize(
    ("system", "given", "period"),
    [("friction-oscillator", STICKS_ON, 1), ("stick-slip", {"omega": 1.4, "u": 0.25}, 2)],
)
def test_friction_that_sticks_under_a_force_above_the_kinetic_one_has_no_reactivity(
    system: str, given: dict[str, float], period: int
) -> None:
    """At one of the sections of an orbit is enough."""
    several = atlas.stability(given, system=system, starts=3)["coexisting"]
    (found,) = [row for row in several if row["period"] == period]
    assert found["reason"] == JUMPS
    assert 0.0 < found["return_time"] < math.inf
    assert math.isnan(found["reactivity"]) and math.isnan(found["amplification"])


def test_there_the_smallest_push_along_the_force_makes_it_slide_and_one_against_it_does_not() -> None:
    table = table_of("friction-oscillator", STICKS_ON, 1)
    state = table.attractors[0].result["state"]
    assert state[1] == 0.0

    def moved(push: float) -> float:
        return float(trace("friction-oscillator", STICKS_ON | {"x": state[0], "v": push}, 1).states[-1, 0] - state[0])

    assert [moved(push) for push in (1e-9, 1e-6)] == pytest.approx([-0.0139932] * 2, abs=1e-6)
    assert [moved(push) for push in (-1e-9, 0.0)] == pytest.approx([0.0, 0.0], abs=1e-9)


def test_friction_that_sticks_under_a_force_below_the_kinetic_one_has_a_jacobian() -> None:
    given = STICKS_ON | {"tau": 0.25 * 9.0}
    table = table_of("friction-oscillator", given, 1)
    phases = phases_of(table.cell.oscillator, table.attractors[0])
    assert not isinstance(phases, str)
    assert phases.states[0, 1] == 0.0
    assert phases.jacobians[0] == pytest.approx(differences(table, phases.states[0]), abs=1e-6)


def test_friction_that_holds_a_mass_at_rest_is_a_reason() -> None:
    found = atlas.stability({"A": 0.5, "s": 1.2}, system="friction-oscillator", starts=3)["coexisting"]
    assert {(row["reason"], row["return_time"]) for row in found} == {(STICKS, math.inf)}


def test_a_coordinate_that_drifts_is_a_reason() -> None:
    table = table_of("capsule", {}, 2)
    periodic = [attractor for attractor in table.attractors if attractor.period]
    assert periodic and all(phases_of(table.cell.oscillator, orbit) == DRIFTS for orbit in periodic)


def test_one_factor_for_all_weights_changes_nothing() -> None:
    J = np.random.default_rng(1).standard_normal((2, 4, 4))
    w = np.array([1.0, 2.0, 0.5, 3.0])
    assert weight_matrices(J, 7.0 * w) == pytest.approx(weight_matrices(J, w), rel=1e-14)


def test_the_default_norm_weighs_velocities_by_the_time_of_a_radian() -> None:
    found = atlas.stability(FIG3, starts=1, norm={"x2": 2})
    assert found["norm"] == pytest.approx({"x1": 1.0, "x2": 2.0, "v1": 0.25, "v2": 0.25})


def test_shares_are_those_of_all_attractors() -> None:
    found, plain = atlas.stability(FIG3, starts=8), atlas.attractors(FIG3, starts=8)
    names = ("regime", "share", "share_low", "share_high", "period", "largest", "state")
    assert [[row[name] for name in names] for row in found["coexisting"]] == [
        [row[name] for name in names] for row in plain["coexisting"]
    ]
    for name in ("attractors", "starts", "undecided", "unseen_share", "periods_used", "parameters", "solve", "search"):
        assert found[name] == plain[name]


def test_a_cell_without_an_attractor_says_why() -> None:
    found = atlas.stability({"b": 0.1, "x1": 0.5}, starts=1)
    assert (found["attractors"], found["coexisting"], found["regime"]) == (0, [], "invalid")
    assert found["reason"]


@pytest.mark.parametrize(
    ("norm", "message"),
    [
        ({"x3": 1.0}, "unknown component of the state in norm 'x3'"),
        ({"x1": 0.0}, "norm.x1: found 0, must be above 0"),
        ({"x1": -2.0}, "norm.x1: found -2, must be above 0"),
        ({"x1": math.inf}, "norm.x1 = inf: must be a finite number"),
        ({"x1": "1"}, "norm.x1: found '1', must be a number"),
    ],
)
def test_a_bad_norm_is_one_line(norm: dict[str, object], message: str) -> None:
    with pytest.raises(InputError) as error:
        atlas.stability(FIG3, norm=norm)
    assert str(error.value).startswith(message) and "\n" not in str(error.value)


def test_the_command_prints_what_the_function_gives() -> None:
    words = ["attractors", "stability", "--set", "omega=4", "--set", "b=0.1", "--starts", "8", "--norm", "v1=0.5"]
    shown = CliRunner().invoke(main, [*words, "--json"])
    assert shown.exit_code == 0, shown.output
    assert json.loads(shown.stdout) == atlas.stability(FIG3, starts=8, norm={"v1": 0.5})
    table = CliRunner().invoke(main, words)
    assert all(name in table.stdout for name in ("return_time", "reactivity", "amplification", "share"))


def test_without_exponents_there_are_no_measures() -> None:
    shown = CliRunner().invoke(main, ["attractors", "stability", "--exponents", "none"])
    assert (shown.exit_code, shown.stdout) == (2, "")
    assert "exponents: found 'none'; stability measures need the largest one" in shown.stderr


def test_a_bad_weight_on_the_command_line_ends_in_one_line() -> None:
    shown = CliRunner().invoke(main, ["attractors", "stability", "--norm", "x1=0"])
    assert (shown.exit_code, shown.stdout) == (2, "")
    assert shown.stderr == "Error: norm.x1: found 0, must be above 0\n"
