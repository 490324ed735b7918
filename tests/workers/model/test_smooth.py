"""Coefficients that vary smoothly with the phase: Mathieu's equation, a gear pair, a rigid stop; what is refused."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp
from scipy.special import mathieu_a, mathieu_b

from atlas.cell.law_check import check_law, finer
from atlas.cli.main import main
from atlas.spec.equation import equation_of
from atlas.spec.spec import Spec
from tests.project.test_docs import ROOT, files
from tests.refusals import refuse
from tests.support.solver_bridge import Array
from workers import Settings, solve_tile
from workers.model.machines import is_mirror_symmetric
from workers.model.system import System
from workers.results import FAILED, NO_IMPACT

MATHIEU: dict[str, Any] = {
    "name": "mathieu", "coordinates": ["x"], "mass": [[1.0]], "damping": [[0.1]],
    "stiffness": [["1 + e * cos(phase)"]], "within": 1e-3, "parameters": {"e": 0.5},
}  # fmt: skip
"""x'' + .1 x' + (1 + e cos t) x = 0 at omega 1."""

EXPONENTS = {
    0.5: (-0.17542051639538111, -0.452898014322577538),
    0.2: (-0.301596656060693872, -0.326721874657264776),
}
"""Exponents of Mathieu's equation per period by e, by Taylor series of degree 40 in 34 digits."""

STOP: dict[str, Any] = {"force": [0.5], "gap": [1.0], "upper": 0.4, "restitution": 0.8}
"""Entries of a forced machine with a rigid stop."""


def mathieu(**changes: Any) -> System:
    return System.from_mapping(MATHIEU | changes)


def at_defaults(system: System, **changes: float) -> dict[str, Array]:
    return {p.name: np.array([changes.get(p.name, p.default)]) for p in system.parameters}


def gears() -> System:
    return System.from_toml(files(ROOT / "docs" / "systems.md")["smooth-mesh.toml"])


@pytest.mark.parametrize(("steps", "largest"), [(4, -0.19298), (8, -0.17539757), (16, -0.17541929), (32, -0.17542044)])
def test_exponents_are_those_of_the_magnus_rule(steps: int, largest: float) -> None:
    found = solve_tile(mathieu(steps=steps), {"omega": [1.0]}, Settings(exponents="spectrum"))["spectrum"][0]
    assert found[0] == pytest.approx(largest, abs=5e-6 if steps == 4 else 6e-9)
    assert found.sum() == pytest.approx(-0.2 * math.pi, abs=1e-12)


@pytest.mark.parametrize("e", EXPONENTS)
def test_exponents_converge_with_the_fourth_power_of_the_step(e: float) -> None:
    off = [
        solve_tile(mathieu(steps=steps), {"e": [e]}, Settings(exponents="spectrum"))["spectrum"][0] - EXPONENTS[e]
        for steps in (16, 32)
    ]
    assert off[0] / off[1] == pytest.approx(16.0, abs=1.0)
    assert np.abs(off[1]).max() < 1e-7


def test_steps_are_the_fewest_even_number_within_the_bound() -> None:
    system = mathieu(within=1e-5)
    steps = system.definition.steps
    assert steps == 18
    assert system.step_errors().max() <= 1e-5
    assert mathieu(within=1e-5, steps=steps - 2).step_errors().max() > 1e-5


def test_the_bound_holds_at_the_ends_of_usual_axes() -> None:
    system = mathieu(axes={"omega": [0.5, 2.0], "e": [0.0, 0.6]})
    slow = at_defaults(system, omega=0.5, e=0.6)
    assert mathieu().step_errors(slow).max() > 1e-3 >= system.step_errors(slow).max()


@pytest.mark.parametrize(("branch", "inward"), [(mathieu_b, 1.0), (mathieu_a, -1.0)])
def test_the_first_tongue_of_mathieus_equation_ends_at_its_characteristic_values(
    branch: Callable[[int, float], float], inward: float
) -> None:
    """Truth: x'' + (a - 2 q cos 2t) x = 0 is stable outside b_1 < a < a_1 (scipy); 32 steps reach them to 1e-6."""
    q, edge = 0.3, branch(1, 0.3)
    entries = {"damping": [[0.0]], "stiffness": [["a - 2 * q * cos(phase)"]], "parameters": {"a": 1.0, "q": q}}
    off = 1e-6 * inward * np.array([-1.0, 1.0])
    cells = {"omega": [2.0, 2.0], "a": edge + off, "x": [1.0, 1.0]}
    found = solve_tile(mathieu(**entries, steps=32), cells)
    assert found["regime"].tolist() == [NO_IMPACT, FAILED]


def passed(system: Callable[[float, Array], list[float]], y: Array, until: float) -> Array:
    """The state at the end of a smooth motion."""
    return np.asarray(solve_ivp(system, (0.0, until), y, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1])


def fixed_point(of: Callable[[Array], Array], y: Array) -> Array:
    """A fixed point of a map by Newton's method with differences."""
    for _ in range(6):
        J = np.array([(of(y + d) - of(y - d)) / 2e-6 for d in 1e-6 * np.eye(len(y))]).T
        y = y + np.linalg.solve(J - np.eye(len(y)), y - of(y))
    return y


def test_a_force_stays_exact_between_steps_of_fourth_order() -> None:
    """Truth: DOP853; a force of order 3 of the period and a load that varies with the phase."""
    entries = {"harmonics": [{"order": 3, "force": [0.4], "phase": [0.3]}], "load": ["0.2 * sin(phase)"]}

    def rate(t: float, y: Array) -> list[float]:
        push = 0.4 * math.sin(3.0 * t + 0.3) + 0.2 * math.sin(t)
        return [y[1], push - 0.1 * y[1] - (1.0 + 0.5 * math.cos(t)) * y[0]]

    truth = fixed_point(lambda y: passed(rate, y, 2.0 * math.pi), np.zeros(2))
    off = [
        np.abs(solve_tile(mathieu(**entries, steps=steps), {"omega": [1.0]})["state"][0] - truth).max()
        for steps in (16, 32)
    ]
    assert 14.0 < off[0] / off[1] < 18.0
    assert off[1] < 1e-5


def event_by_event(
    rate: Callable[[float, Array, float], list[float]], guard: Callable[[Array, float], float],
    after: Callable[[Array, float], tuple[Array, float]], y: Array, side: float, until: float,
) -> Array:  # fmt: skip
    """The state of a motion by DOP853, which begins anew wherever the guard of its side rises through 0."""
    t = 0.0
    while t < until:

        def rises(t: float, y: Array, side: float = side) -> float:
            return guard(y, side)

        rises.terminal, rises.direction = True, 1.0  # type: ignore[attr-defined]
        run = solve_ivp(
            lambda t, y, side=side: rate(t, y, side), (t, until), y, method="DOP853", rtol=1e-11, atol=1e-13,
            events=rises, max_step=0.5,
        )  # fmt: skip
        t, y = float(run.t[-1]), run.y[:, -1]
        if run.status == 1:
            y, side = after(y, side)
    return np.asarray(y)


def meshing(omega: float, eps: float) -> Callable[[Array], Array]:
    """The period map of the gear pair (Kahraman & Singh, J. Sound Vib. 146, 135), whose teeth touch on a side."""

    def rate(t: float, y: Array, side: float) -> list[float]:
        mesh = (1.0 + eps * math.cos(omega * t)) * (y[0] - side) if side else 0.0
        return [y[1], 0.1 + 0.05 * omega**2 * math.sin(omega * t) - 0.1 * y[1] - mesh]

    def guard(y: Array, side: float) -> float:
        return float(1.0 - side * y[0]) if side else float(abs(y[0]) - 1.0)

    def after(y: Array, side: float) -> tuple[Array, float]:
        return y, 0.0 if side else float(np.sign(y[0]))

    return lambda y: event_by_event(
        rate, guard, after, y, float(np.sign(y[0])) if abs(y[0]) > 1.0 else 0.0, 2.0 * math.pi / omega
    )


@pytest.mark.parametrize(("omega", "eps"), [(0.5, 0.2), (0.8, 0.2), (1.0, 0.2)])
def test_a_gear_pair_with_a_smooth_mesh_stiffness_moves_as_by_dop853(omega: float, eps: float) -> None:
    """Teeth part at omega .8 and 1. The bound of 5e-3 holds by far: the worst speed within a step is not met."""
    found = solve_tile(gears(), {"omega": [omega], "eps": [eps]})
    assert (found["period"][0], found["impacts_upper"][0]) == (1, int(omega > 0.5))
    truth = fixed_point(meshing(omega, eps), found["state"][0])
    assert np.abs(found["state"][0] - truth).max() < 1e-5


def rebounding(omega: float) -> Callable[[Array], Array]:
    """The period map of Mathieu's equation with .5 sin(omega t) and the rigid stop."""

    def rate(t: float, y: Array, _: float) -> list[float]:
        return [y[1], 0.5 * math.sin(omega * t) - 0.1 * y[1] - (1.0 + 0.5 * math.cos(omega * t)) * y[0]]

    return lambda y: event_by_event(
        rate, lambda y, _: float(y[0] - 0.4), lambda y, _: (np.array([0.4, -0.8 * y[1]]), 0.0), y, 0.0,
        2.0 * math.pi / omega,
    )  # fmt: skip


@pytest.mark.parametrize("steps", [8, 16, 32])
def test_an_impact_within_a_step_is_off_by_no_more_than_the_error_that_is_named(steps: int) -> None:
    """Within a step speeds are of second order only, and a rebound keeps their error."""
    system = mathieu(**STOP, within=0.1, steps=steps)
    found = solve_tile(system, {"omega": [1.6]})["state"][0]
    truth = fixed_point(rebounding(1.6), found)
    assert np.abs(found - truth).max() < system.step_errors(at_defaults(system, omega=1.6))[0]


def test_a_jump_at_the_start_of_a_phase_is_exact() -> None:
    """The same stiffness with a jump at 0.3 of the period, in the same number of phases."""
    jump = "0.2 * (phase - 0.6 * pi) / abs(phase - 0.6 * pi)"
    smooth = mathieu(stiffness=[[f"1 + {jump} + e * cos(phase)"]], within=0.5, steps=12)
    phases = [{"start": 0.0}, {"start": 0.3, "stiffness": [["1.2 + e * cos(phase)"]]}]
    halves = mathieu(stiffness=[["0.8 + e * cos(phase)"]], phases=phases)
    assert halves.definition.steps == 6
    assert smooth.step_errors()[0] > 10.0 * halves.step_errors()[0]


def test_a_coefficient_that_does_not_change_is_that_of_a_machine_without_steps() -> None:
    (K,) = mathieu(stiffness=[["1.3 + 0 * cos(phase)"]]).definition.machines(at_defaults(mathieu())).stiffness
    assert (K == 1.3).all()


def test_a_shaft_whose_stiffness_turns_twice_in_a_period_keeps_its_mirror_symmetry() -> None:
    system = mathieu(**STOP | {"lower": -0.4}, stiffness=[["1 + e * cos(2 * phase)"]], within=5e-3)
    assert is_mirror_symmetric(system.definition.machines(at_defaults(system))).all()
    assert solve_tile(system, {"omega": [1.6], "e": [0.1]})["symmetric"][0]


def test_a_system_keeps_its_number_of_steps_in_its_table() -> None:
    system = mathieu(axes={"omega": [0.5, 2.0]})
    assert system.table()["steps"] == system.definition.steps
    assert System.from_mapping(system.table()) == system


def test_names_in_let_may_use_the_phase() -> None:
    named = mathieu(let={"k": "1 + e * cos(phase)"}, stiffness=[["k"]])
    (K,), (plain,) = (system.definition.machines(at_defaults(system)).stiffness for system in (named, mathieu()))
    assert np.array_equal(K, plain)


REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"within": None}, "system.stiffness[0][0]: unknown name 'phase'; only stiffness, damping, load"),
    ({"stiffness": [["1 + fase"]]}, "system.stiffness[0][0]: unknown name 'fase'; did you mean 'phase'?"),
    ({"mass": [["1 + 0.1 * cos(phase)"]]}, "system.mass[0][0]: unknown name 'phase'; only stiffness, damping, load"),
    ({"stiffness": [["sqrt(cos(phase))"]]}, "system.stiffness: found [[nan]] at the defaults, must be finite numbers"),
    ({"stiffness": [[1.0]]}, "system.within: found without an entry that is an expression of phase; leave it out"),
    ({"within": 0.0}, "system.within: found 0.0, must be above 0"),
    ({"within": 1e-9}, "system.within: found 1e-09, takes more than 64 phases; 32 steps, two phases each, are off by"),
    ({"steps": 5}, "system.steps: found 5, must be an even number from 2 to 32, or left out"),
    ({"within": None, "steps": 4, "stiffness": [[1.0]]}, "system.steps: found without within"),
    ({"parameters": {"e": 0.5, "phase": 1.0}}, "system.parameters.phase: found beside within"),
]


@pytest.mark.parametrize(("changes", "line"), REFUSED)
def test_wrong_smooth_coefficients_are_refused_in_one_line(changes: dict[str, Any], line: str) -> None:
    refuse({key: value for key, value in (MATHIEU | changes).items() if value is not None}, line)


def test_systems_prints_the_steps_and_their_error(tmp_path: Path) -> None:
    (tmp_path / "gears.toml").write_text(files(ROOT / "docs" / "systems.md")["smooth-mesh.toml"])
    ended = CliRunner().invoke(main, ["systems", str(tmp_path / "gears.toml")])
    assert "from the section on: 16 steps, within 0.005" in ended.stdout
    assert "\nsmooth coefficients: 16 steps, 32 phases; off by 0.0045 on the usual axes, bound 0.005\n" in ended.stdout
    assert "(1 + eps * cos(phase)) * d" in equation_of(gears())


def plane(start: float) -> Spec:
    axes = {"omega": {"start": start, "stop": 1.2, "num": 3}, "eps": {"start": 0.1, "stop": 0.2, "num": 2}}
    return Spec(gears(), axes, solve={"tolerance": 0.1, "survival": 0})


def test_a_run_refuses_a_plane_beyond_the_bound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("smooth-mesh.toml").write_text(files(ROOT / "docs" / "systems.md")["smooth-mesh.toml"])
    axis = "[axes.omega]\nstart = 0.1\nstop = 1.2\nnum = 3\n"
    Path("slow.toml").write_text(f'system = "smooth-mesh.toml"\n{axis}')
    ended = CliRunner().invoke(main, ["run", "slow.toml", "-o", "slow.zarr"])
    assert (ended.exit_code, ended.stdout) == (2, "")
    assert ended.stderr.startswith("Error: system.within: found 0.005, but 16 steps are off by ")
    assert "at omega = 0.1;" in ended.stderr and ended.stderr.count("\n") == 1
    planned = CliRunner().invoke(main, ["plan", "slow.toml", "--no-probe"])
    assert "atlas run will refuse this: system.within" in planned.stderr


def test_a_check_of_laws_compares_the_steps_of_a_quarter_of_the_bound() -> None:
    spec = plane(0.8)
    found = check_law(spec, finer(spec), cells=2)
    assert found.segments == {"system.within": (16, 30)}
    assert str(found).startswith("system.within: 16 steps, compared with 30\n")
    assert found.changed == []
    assert found.state is not None and 0.0 < found.state[1] < 5e-3
