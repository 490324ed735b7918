"""Claims about systems: those in the package are what their pages say, and a definition that is wrong gets one line."""

import math
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.oscillators import RIGID, rigid_numbers
from tests.refusals import refuse
from tests.support.oracle import two_mass
from workers import Settings, System, solve_tile
from workers.model.definition_checks import check_at_defaults
from workers.model.entries import DefinitionError
from workers.model.machines import Machines
from workers.model.system import find_system, identity, system_names
from workers.results import INVALID, NO_OSCILLATOR, NO_REASON, OUT_OF_DOUBLES, OUT_OF_RANGE, REASONS, RIGID_MODE

each_system = pytest.mark.parametrize("name", system_names())

MACHINE = """
[system]
name = "machine"
title = "two masses between stops"
coordinates = ["p", "q"]
velocities = ["u", "w"]
mass = [[1.0, 0.0], [0.0, "m"]]
damping = [["2 * z", "-2 * z"], ["-2 * z", "2 * z * (1 + k)"]]
stiffness = [[1.0, -1.0], [-1.0, "1 + k"]]
force = [1.0, 0.0]
gap = [1.0, 0.0]
upper = "d"
lower = "-d"
restitution = "r"
[system.parameters]
omega = { default = 4.0 }
d = { default = 0.15, low = 0.0, low_open = true, meaning = "clearance" }
r = { default = 0.8, low = 0.0, high = 1.0 }
z = { default = 0.05, low = 0.0, symbol = '\\zeta', unit = "1" }
m = { default = 2.0, low = 0.0, low_open = true }
k = { default = 5.0 }
"""


def table(**changes: Any) -> dict[str, Any]:
    """The table [system] of the machine above with other entries; None takes an entry out."""
    found = tomllib.loads(MACHINE)["system"] | changes
    return {key: value for key, value in found.items() if value is not None}


def values_of(system: System, **given: float | np.ndarray) -> dict[str, np.ndarray]:
    columns = [np.atleast_1d(given.get(p.name, p.default)) for p in system.parameters]
    return dict(zip([p.name for p in system.parameters], np.broadcast_arrays(*columns), strict=True))


def machine_of(name: str, **given: float) -> Machines:
    """The only machine of a packaged system at these parameters."""
    system = find_system(name)
    with np.errstate(all="ignore"):
        machines = system.definition.machines(values_of(system, **given))
    return Machines(*(field[0] for field in machines))


def test_the_two_mass_system_in_its_file_has_the_numbers_of_the_oracle() -> None:
    """Li & Tan (2011), each entry to one rounding."""
    rng = np.random.default_rng(3)
    for zero in ("", "zeta", "f2"):
        p = {name: float(np.exp(rng.normal())) for name in ("omega", "b", "mu_m", "mu_k", "zeta", "tau", "R", "f2")}
        p |= {zero: 0.0} if zero else {}
        system, wanted = find_system("two-mass"), two_mass(p)
        found = rigid_numbers(system.definition.machines(values_of(system, **p)))
        for name in RIGID:
            exact = np.array(getattr(wanted, name), dtype=np.float64)
            np.testing.assert_allclose(found[name][0], exact, rtol=4e-16, atol=0.0, err_msg=name)


def test_the_two_mass_system_has_the_parameters_that_it_always_had() -> None:
    """Names, symbols, units, meanings, defaults and ranges, and their order; stores and pictures have all of them."""
    described = [
        ("omega", r"\omega", "1", "forcing frequency", 4.0, "0 < omega"),
        ("b", "b", "1", "clearance: half the gap between the stops", 0.15, "0 < b"),
        ("R", "R", "1", "coefficient of restitution", 0.8, "0 <= R <= 1"),
        ("zeta", r"\zeta", "1", "damping ratio", 0.05, "0 <= zeta"),
        ("mu_m", r"\mu_m", "1", "mass ratio m2/m1", 2.0, "0 < mu_m"),
        ("mu_k", r"\mu_k", "1", "stiffness ratio k2/k1", 5.0, "0 < mu_k"),
        ("f2", "f_2", "1", "share of the force on mass 2", 0.0, "any finite number"),
        ("tau", r"\tau", "rad", "phase of the force at t = 0", math.pi, "any finite number"),
        ("x1", "x_1(0)", "1", "initial displacement of mass 1", 0.0, "any finite number"),
        ("x2", "x_2(0)", "1", "initial displacement of mass 2", 0.0, "any finite number"),
        ("v1", r"\dot x_1(0)", "1", "initial velocity of mass 1", 0.0, "any finite number"),
        ("v2", r"\dot x_2(0)", "1", "initial velocity of mass 2", 0.0, "any finite number"),
    ]
    system = find_system("two-mass")
    assert [(p.name, p.symbol, p.unit, p.meaning, p.default, p.range) for p in system.parameters] == described
    assert (system.states, system.version, system.packaged) == (("x1", "x2", "v1", "v2"), 1, True)


def test_the_package_has_the_whole_family() -> None:
    chains = {f"chain-{n}" for n in range(3, 9)}
    assert {*system_names()} == {
        "two-mass", "single-mass", "bouncing-ball", "impact-pair", "impact-damper", "energy-sink", "energy-harvester",
        "soft-impact", "soft-suspension", "two-stops", "friction-oscillator", "stick-slip", "gear-mesh",
        "capsule", "bistable-harvester", "rotor-rub", "duffing-stop", "hertz-ball", "stribeck-belt", "belt", *chains,
    }  # fmt: skip
    assert system_names()[0] == "two-mass"


@each_system
def test_a_packaged_system_says_what_it_is(name: str) -> None:
    """Title, source, equation, picture, and two usual axes inside the ranges of their parameters."""
    system = find_system(name)
    assert system.title and system.source and system.equation and system.picture
    assert len(system.axes) == 2
    assert all(system.parameter(axis).admits(end) for axis, *ends in system.axes for end in ends)
    assert all(p.symbol and p.unit and p.meaning for p in system.parameters)


def test_a_ball_falls_onto_a_table_from_above() -> None:
    ball = machine_of("bouncing-ball", A=0.5, g=9.0, omega=2.0)
    assert (ball.load.tolist(), ball.force_sin.tolist(), ball.stiffness.tolist()) == ([[-9.0]], [[[2.0]]], [[[0.0]]])
    assert ball.stops.tolist() == [[0.0, math.inf]]


def test_an_impact_pair_has_half_its_clearance_on_each_side() -> None:
    pair = machine_of("impact-pair", alpha=0.5, omega=2.0, nu=3.0, delta=0.25, beta=0.1)
    assert (pair.force_sin.tolist(), pair.load.tolist(), pair.damping.tolist()) == ([[[2.0]]], [[-0.25]], [[[0.1]]])
    assert pair.stops.tolist() == [[-1.5, 1.5]]


def test_one_mass_has_one_stop_or_two_by_a_parameter() -> None:
    stops = [machine_of("single-mass", s=s, b=2.0).stops.tolist() for s in (0.0, 1.0, 4.0)]
    assert stops == [[[-math.inf, 2.0]], [[-2.0, 2.0]], [[-0.5, 2.0]]]


def test_an_impact_damper_is_damped_as_its_equation_says() -> None:
    """Its damping is not classical: C M^-1 K is not symmetric."""
    damper = machine_of("impact-damper", zeta=0.5, xi=0.25, mu=0.5, phi=2.0)
    assert damper.mass.tolist() == [[1.0, 0.0], [0.0, 0.5]]
    assert damper.damping.tolist() == [[[1.25, -0.25], [-0.25, 0.25]]]
    assert damper.stiffness.tolist() == [[[3.0, -2.0], [-2.0, 2.0]]]
    assert damper.row.tolist() == [[-1.0, 1.0]]
    product = damper.damping[0] @ np.linalg.inv(damper.mass) @ damper.stiffness[0]
    assert not np.allclose(product, product.T)


@pytest.mark.parametrize("n", range(3, 9))
def test_a_chain_has_the_modes_of_a_chain(n: int) -> None:
    """One end tied, the other free: omega_j = 2 sin((2 j - 1) pi / (2 (2 n + 1))), j = 1, ..., n."""
    chain = machine_of(f"chain-{n}", zeta=0.1)
    frequencies = 2.0 * np.sin((2 * np.arange(1, n + 1) - 1) * math.pi / (2 * (2 * n + 1)))
    assert np.linalg.eigvalsh(chain.stiffness[0]) == pytest.approx(frequencies**2, abs=1e-14)
    assert np.array_equal(chain.mass, np.eye(n))
    assert chain.damping == pytest.approx(0.2 * chain.stiffness, abs=1e-16)
    assert (np.flatnonzero(chain.row).tolist(), np.flatnonzero(chain.force_sin).tolist()) == ([n - 1], [0])


def test_a_velocity_without_a_name_has_v_and_the_number_of_its_coordinate() -> None:
    system = System.from_mapping(table(coordinates=["x1", "theta22"], velocities=None))
    assert system.states == ("x1", "theta22", "v1", "v22")


def test_parameters_come_as_omega_then_those_of_the_table_then_tau_then_the_initial_state() -> None:
    names = [p.name for p in System.from_toml(MACHINE).parameters]
    assert names == ["omega", "d", "r", "z", "m", "k", "tau", "p", "q", "u", "w"]


def test_symbols_that_are_not_given_are_made_of_names() -> None:
    given = {"mu_m": {"default": 1.0}, "gain": {"default": 1.0}, "a2": {"default": 1.0}}
    system = System.from_mapping(table(parameters=table()["parameters"] | given))
    assert [system.parameter(name).symbol for name in given] == [r"\mu_{m}", r"\mathit{gain}", "a_{2}"]
    assert (system.parameter("p").symbol, system.parameter("u").symbol) == ("p(0)", r"\dot p(0)")


def test_a_phase_turns_sine_into_cosine() -> None:
    """a sin(phi + c) = a cos(c) sin(phi) + a sin(c) cos(phi)."""
    system = System.from_mapping(table(force=[2.0, 3.0], phase=["pi / 2", 0.25]))
    machines = system.definition.machines(values_of(system))
    assert machines.force_sin[0, 0, 0] == pytest.approx([0.0, 3.0 * math.cos(0.25)], abs=1e-15)
    assert machines.force_cos[0, 0, 0] == pytest.approx([2.0, 3.0 * math.sin(0.25)], abs=1e-15)


def test_harmonics_stand_at_their_order() -> None:
    system = System.from_mapping(table(harmonics=[{"order": 3, "force": [0.0, "m"]}]))
    force = system.definition.machines(values_of(system)).force_sin[0, 0]
    assert force.tolist() == [[1.0, 0.0], [0.0, 0.0], [0.0, 2.0]]


def test_a_force_may_consist_of_a_higher_harmonic_alone() -> None:
    system = System.from_mapping(table(force=None, harmonics=[{"order": 2, "force": [1.0, 0.0]}]))
    assert system.definition.machines(values_of(system)).force_sin[0, 0].tolist() == [[0.0, 0.0], [1.0, 0.0]]


def test_names_in_let_may_use_each_other_in_any_order() -> None:
    entries = {"stiff": "soft + k", "soft": "one", "one": 1.0}
    system = System.from_mapping(table(let=entries, stiffness=[["soft", "-soft"], ["-soft", "stiff"]]))
    machines = system.definition.machines(values_of(system, k=3.0))
    assert machines.stiffness[0, 0].tolist() == [[1.0, -1.0], [-1.0, 4.0]]


def test_a_stop_at_infinity_is_no_stop() -> None:
    absent, infinite = System.from_mapping(table(lower=None)), System.from_mapping(table(lower=-math.inf))
    assert absent == infinite
    machines = absent.definition.machines(values_of(absent))
    assert machines.stops[0, 0].tolist() == [-math.inf, 0.15]


def test_words_do_not_enter_the_identity_of_a_system_and_numbers_do() -> None:
    other_words = table(title="another", source="s", equation="e", picture="p", axes={"omega": [1, 2]})
    other_words["parameters"] = {**other_words["parameters"], "k": {"default": 3.0, "symbol": "K", "meaning": "stiff"}}
    spelt = table(damping=[["2.0*z", "-2*z"], ["-2*z", "2*z*(1+k)"]])
    other = table(stiffness=[[1.0, -1.0], [-1.0, "2 + k"]])
    one, words, spelling, numbers = (
        identity(System.from_mapping(table_of).to_resolved()) for table_of in (table(), other_words, spelt, other)
    )
    assert one == words == spelling
    assert one != numbers


def test_a_file_is_read_as_its_text_is(tmp_path: Path) -> None:
    (tmp_path / "machine.toml").write_text(MACHINE)
    assert System.from_toml(tmp_path / "machine.toml") == System.from_toml(MACHINE)
    assert find_system(str(tmp_path / "machine.toml")) == System.from_toml(MACHINE)


def reasons(system: System, **given: float | np.ndarray) -> list[int]:
    return system.build_many(values_of(system, **given))[1].tolist()


def test_cells_whose_expressions_have_no_finite_value_are_invalid_and_no_others() -> None:
    system = System.from_mapping(table(mass=[[1.0, 0.0], [0.0, "1 / k"]]))
    assert reasons(system, k=np.array([5.0, 0.0, 2.0])) == [NO_REASON, OUT_OF_DOUBLES, NO_REASON]
    root = System.from_mapping(table(upper="sqrt(k)"))
    assert reasons(root, k=np.array([4.0, -1.0])) == [NO_REASON, OUT_OF_DOUBLES]


def test_cells_whose_stops_or_restitution_make_no_sense_are_out_of_range() -> None:
    stops = System.from_mapping(table(lower="k - 6"))
    assert reasons(stops, k=np.array([5.0, 7.0])) == [NO_REASON, OUT_OF_RANGE]
    restitution = System.from_mapping(table(restitution="r * k / 5"))
    assert reasons(restitution, k=np.array([5.0, 50.0, -5.0])) == [NO_REASON, OUT_OF_RANGE, OUT_OF_RANGE]


def test_cells_whose_matrices_are_not_symmetric_make_oscillators() -> None:
    system = System.from_mapping(table(stiffness=[[1.0, "-k / 5"], [-1.0, "1 + k"]]))
    assert reasons(system, k=np.array([5.0, 4.0])) == [NO_REASON, NO_REASON]


def test_cells_whose_gap_a_push_at_the_stop_does_not_open_make_no_oscillator() -> None:
    system = System.from_mapping(table(mass=[["k - 4.5", 0.0], [0.0, 1.0]]))
    assert reasons(system, k=np.array([5.0, 4.0])) == [NO_REASON, NO_OSCILLATOR]


def test_a_cell_that_drifts_in_two_ways_is_invalid_as_the_table_of_reasons_says() -> None:
    system = System.from_mapping(table(stiffness=[["k", 0.0], [0.0, "k"]], damping=[[0.0, 0.0], [0.0, 0.0]]))
    assert reasons(system, k=np.array([5.0, 0.0])) == [NO_REASON, RIGID_MODE]
    free = solve_tile(system, {"k": 0.0})
    assert (free["regime"], free["reason"]) == (INVALID, RIGID_MODE)
    assert REASONS[RIGID_MODE].regime == INVALID


def test_only_a_machine_with_one_rigid_contact_and_nothing_else_is_solved_without_modes() -> None:
    rigid = {"bouncing-ball", "chain-3", "impact-damper", "impact-pair", "single-mass", "two-mass"}
    assert {name for name in system_names() if not find_system(name).has_modes} >= rigid
    for name in ("belt", "soft-impact", "stick-slip", "two-stops", "gear-mesh"):
        assert find_system(name).has_modes


FREE = "leaves a free motion that the gap does not see"
PARAMETERS = tomllib.loads(MACHINE)["system"]["parameters"]


def with_parameter(name: str, entry: Any) -> dict[str, Any]:
    return {"parameters": PARAMETERS | {name: entry}}


WRONG = [
    ({"mas": 1}, "unknown key in system 'mas'; did you mean 'mass'?"),
    ({"name": None}, "system.name: found None, must be text"),
    ({"name": "a b"}, "system.name: found 'a b', must be letters, digits and hyphens"),
    ({"version": 0}, "system.version: found 0, must be a whole number, 1 or more"),
    ({"version": 10**5000}, "system.version: found a whole number of thousands of digits, must be at most 1000000"),
    ({"title": 3}, "system.title: found 3, must be text in quotes"),
    ({"coordinates": None}, "system: coordinates missing"),
    ({"coordinates": []}, "system.coordinates: found 0, must be 1 to 8"),
    ({"coordinates": "pq"}, "system.coordinates: found 'pq', must be a list of names"),
    ({"coordinates": [f"x{i}" for i in range(9)], "velocities": None}, "system.coordinates: found 9, must be 1 to 8"),
    ({"coordinates": ["p", "p"]}, "found p twice in p, p, u, w"),
    ({"velocities": None}, "found v twice in p, q, v, v; give velocities = [...] too"),
    ({"velocities": ["u"]}, "system.velocities: found 1 entries, must be 2, one per coordinate"),
    ({"coordinates": ["omega", "q"]}, "system.coordinates: omega is a parameter of the force"),
    ({"coordinates": ["p-1", "q"]}, "system.coordinates[0]: found 'p-1', must be a name of letters, digits"),
    ({"coordinates": ["state", "q"]}, "system.coordinates[0]: 'state' has another meaning already"),
    ({"mass": None}, "system: mass missing"),
    ({"mass": 1.0}, "system.mass: found 1.0, must be a list of 2 rows, one per coordinate"),
    ({"mass": [[1.0, 0.0]]}, "system.mass: found 1 rows, must be 2, one per coordinate"),
    ({"mass": [[1.0, 0.0], [1.0]]}, "system.mass[1]: found 1 entries, must be 2, one per coordinate"),
    ({"mass": [[1.0, 0.0], 1.0]}, "system.mass[1]: found 1.0, must be a list of 2 entries"),
    ({"mass": [[1.0, 0.0], [0.0, 0.0]]}, "system.mass: found [[1.0, 0.0], [0.0, 0.0]] at the defaults, is singular"),
    ({"mass": [[1.0, 2.0], [2.0, 4.0]]}, "system.mass: found [[1.0, 2.0], [2.0, 4.0]] at the defaults, is singular"),
    ({"mass": [[-1.0, 0.0], [0.0, 1.0]]}, "found [1.0, 0.0] at the defaults, g.M^-1 g = -1; must be above 0"),
    ({"mass": [[1.0, 0.0], [0.0, "mm"]]}, "system.mass[1][1]: unknown name 'mm'; did you mean 'm'?"),
    ({"mass": [[1.0, 0.0], [0.0, "p"]]}, "system.mass[1][1]: unknown name 'p'"),
    ({"mass": [[1.0, 0.0], [0.0, True]]}, "system.mass[1][1]: found True, must be a number or an expression in quotes"),
    ({"mass": [[1.0, 0.0], [0.0, math.nan]]}, "system.mass[1][1]: found nan, must be a finite number"),
    ({"mass": [[1.0, 0.0], [0.0, 10**400]]}, "must be a finite number"),
    ({"mass": [[1.0, 0.0], [0.0, "9**9**9"]]}, "system.mass: found [[1.0, 0.0], [0.0, inf]] at the defaults"),
    ({"mass": [[1.0, 0.0], [0.0, "__import__('os')"]]}, "system.mass[1][1]: found \"'\""),
    ({"stiffness": None}, FREE),
    ({"stiffness": [[1.0, 0.0], [0.0, 0.0]]}, FREE),
    ({"stiffness": [[1.0, -1.0], [-1.0, 1.0]], "gap": [1.0, -1.0]}, FREE),
    ({"force": None, "phase": [0, 0]}, "system.phase: found without a force"),
    ({"force": 1.0}, "system.force: found 1.0, must be a list of 2 entries"),
    ({"force": [1.0]}, "system.force: found 1 entries, must be 2, one per coordinate"),
    ({"phase": [0.0]}, "system.phase: found 1 entries, must be 2"),
    ({"harmonics": {}}, "system.harmonics: found {}, must be tables [[system.harmonics]]"),
    ({"harmonics": [{"order": 33, "force": [1, 0]}]}, "system.harmonics[0].order: found 33, must be at most 32"),
    ({"harmonics": [{"order": 2}]}, "system.harmonics[0]: force missing"),
    ({"harmonics": [{"ordr": 2}]}, "unknown key in system.harmonics[0] 'ordr'; did you mean 'order'?"),
    ({"load": [1.0]}, "system.load: found 1 entries, must be 2"),
    ({"gap": None}, "system: gap missing"),
    ({"gap": [0.0, 0.0]}, "system.gap: found zeros only"),
    ({"gap": [[1.0, 0.0], [0.0, 1.0]]}, "several gaps at once are not supported; give one row"),
    ({"upper": None, "lower": None}, "system: upper and lower missing; give one stop or both"),
    ({"upper": [1.0, 2.0]}, "system.upper: found [1.0, 2.0], must be a number or an expression in quotes"),
    ({"upper": "-2 * d"}, "system.upper: found -0.3, lower -0.15 at the defaults, must be above lower"),
    ({"upper": -math.inf}, "system.upper: found -inf, must be a finite number"),
    ({"restitution": None}, "system: restitution missing"),
    ({"restitution": 2.001}, "system.restitution: found 2.001 at the defaults, must be 0 to 2"),
    ({"restitution": -0.001}, "system.restitution: found -0.001 at the defaults, must be 0 to 2"),
    ({"let": {"a": "b", "b": "c + 1", "c": "a"}}, "system.let: found the circle a uses b uses c uses a"),
    ({"let": {"a": "a"}}, "system.let: found the circle a uses a"),
    ({"let": {"k": 1.0}}, "system.let.k: k is a parameter already"),
    ({"let": {"sin": 1.0}}, "system.let.sin: 'sin' has another meaning already"),
    ({"let": []}, "system.let: found [], must be a table"),
    ({"parameters": []}, "system.parameters: found [], must be a table"),
    (with_parameter("g", []), "system.parameters.g: found [], must be a table"),
    (with_parameter("g", True), "system.parameters.g.default: found True, must be a number"),
    (with_parameter("g", {}), "system.parameters.g: default missing; give a number"),
    (with_parameter("g", {"default": "k"}), "system.parameters.g.default: unknown name 'k'; an entry knows neither"),
    (with_parameter("g", {"defualt": 1.0}), "unknown key in system.parameters.g 'defualt'; did you mean 'default'?"),
    (with_parameter("g", {"default": 2.0, "high": 1.0}), "system.parameters.g.default: found 2, must satisfy g <= 1"),
    (with_parameter("g", {"default": 2.0, "low": 1.001, "high": 1.0}), "system.parameters.g: found low 1.001 above"),
    (with_parameter("g", {"default": 2.0, "low_open": 1}), "system.parameters.g.low_open: found 1, must be true"),
    (with_parameter("g", {"default": 2.0, "unit": 1}), "system.parameters.g.unit: found 1, must be text in quotes"),
    (with_parameter("g", {"default": 2.0, "symbol": "$g$"}), "system.parameters.g.symbol: found '$g$', must be"),
    (with_parameter("g", {"default": 2.0, "meaning": "a\nb"}), "system.parameters.g.meaning: found 'a\\nb', must be"),
    (with_parameter("p", {"low": 0.0}), "system.parameters.p.low: an initial value has no range"),
    (with_parameter("regime", {"default": 2.0}), "system.parameters.regime: 'regime' has another meaning already"),
    (with_parameter("pi", {"default": 2.0}), "system.parameters.pi: 'pi' has another meaning already"),
    (with_parameter("omega", {"low": -1.0}), "system.parameters.omega.low: found -1, must be 0 with low_open = true"),
    (with_parameter("omega", {"default": 0.0}), "system.parameters.omega.default: found 0, must satisfy 0 < omega"),
    ({"axes": {"omga": [1, 2]}}, "unknown parameter in system.axes 'omga'; did you mean 'omega'?"),
    ({"axes": {"omega": [2, 1]}}, "system.axes.omega: found 2 and 1, must rise"),
    ({"axes": {"omega": [1]}}, "system.axes.omega: found 1 numbers, must be 2"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "message"), WRONG, ids=[message for _, message in WRONG])
def test_a_definition_that_is_wrong_gets_one_line(changes: dict[str, Any], message: str) -> None:
    refuse(table(**changes), message)


BAD_FILES = [
    ("not toml = ", "not a TOML file"),
    ("a = 1\n[system]", "found a, system, must be one table [system]"),
    ('name = "machine"\n', "found name, must be one table [system]"),
    ("system = 1\n", "system: found 1, must be a table"),
    ("a = " + "[" * 5000, "nested too deeply"),
    ("#" * 1_000_001, "too large: more than 1000000 bytes"),
]


@pytest.mark.parametrize(("text", "message"), BAD_FILES, ids=[message for _, message in BAD_FILES])
def test_a_bad_file_is_reported_with_its_name(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "bad.toml").write_text(text)
    with pytest.raises(DefinitionError, match=r"bad\.toml: ") as caught:
        System.from_toml(tmp_path / "bad.toml")
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_a_file_that_is_not_there_is_reported_with_its_name(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"none\.toml: cannot be read: No such file or directory"):
        System.from_toml(tmp_path / "none.toml")


def test_an_unknown_name_names_the_nearest_system() -> None:
    with pytest.raises(KeyError, match="unknown system 'chain-33'; did you mean 'chain-3'"):
        find_system("chain-33")


def test_free_motions_that_the_gap_sees_are_machines() -> None:
    """A ball, a free mass in a box, and two free masses that hit each other while one is tied: none is refused."""
    for name in ("bouncing-ball", "impact-pair"):
        system = find_system(name)
        check_at_defaults(system.definition, system.parameters)
    System.from_mapping(table(stiffness=[[0.0, 0.0], [0.0, "k"]]))


def test_a_parameter_may_be_its_default_alone() -> None:
    short, long = (System.from_mapping(table(**with_parameter("m", given))) for given in (1.5, {"default": 1.5}))
    assert short.parameter("m").default == 1.5
    assert short.table() == long.table()


def test_a_parameter_that_no_entry_uses_is_told() -> None:
    unused = System.from_mapping(table(**with_parameter("idle", 1.0)))
    assert unused.unused_parameters == ("idle",)
    by_names = table(**with_parameter("idle", 1.0)) | {"let": {"half": "idle / 2"}}
    assert System.from_mapping(by_names).unused_parameters == ("idle",)
    assert System.from_mapping(by_names | {"load": ["half", 0.0]}).unused_parameters == ()


@pytest.mark.parametrize("name", system_names())
def test_every_parameter_of_a_packaged_system_is_used(name: str) -> None:
    assert find_system(name).unused_parameters == ()


@pytest.mark.parametrize("size", [1e-200, 1e200])
def test_rows_whose_squares_are_beyond_double_precision_are_rows_like_others(size: float) -> None:
    """Truth: a row and its multiple are the same contact; numpy printed an overflow, and warnings are errors here."""
    two = {"coordinates": ["x1", "x2"], "mass": [[1, 0], [0, 1]], "stiffness": [[1, -1], [-1, 1]], "force": [1, 0]}
    given = {
        "name": "rows",
        "damping": [[0.1, 0], [0, 0.1]],
        **two,
        "gap": [size, 0],
        "upper": size,
        "restitution": 0.5,
    }
    System.from_mapping(given)
    contacts = [{"name": "a", "gap": [size, 0], "upper": size, "restitution": 0.5}]
    contacts += [{"name": "b", "gap": [2 * size, 0], "upper": size, "restitution": 0.5}]
    longer = {name: value for name, value in given.items() if name not in ("gap", "upper", "restitution")}
    with pytest.raises(DefinitionError, match="depend"):
        System.from_mapping(longer | {"contacts": contacts})


def test_a_path_with_an_equals_sign_is_a_path(tmp_path: Path) -> None:
    file = tmp_path / "a=1.toml"
    file.write_text(MACHINE)
    assert System.from_toml(str(file)) == System.from_toml(file) == System.from_toml(MACHINE)
    with pytest.raises(DefinitionError, match=re.escape(f"{tmp_path / 'b=2.toml'}")):
        System.from_toml(str(tmp_path / "b=2.toml"))
    with pytest.raises(DefinitionError, match="must be one table"):
        System.from_toml("a = 1")


RUBBED_STOP: dict[str, Any] = {
    "name": "rubbed", "coordinates": ["x"], "mass": [[1.0]], "stiffness": [[1.0]], "force": [1.0],
    "contacts": [{"name": "wall", "gap": [1.0], "upper": 1.0, "restitution": 0.5}],
    "friction": [{"name": "rub", "row": [1.0], "kinetic": 0.1}],
}  # fmt: skip


@pytest.mark.parametrize(
    ("system", "rests", "label"),
    [
        (find_system("two-mass"), "the mass rests on a stop", "rests on a stop"),
        (find_system("friction-oscillator"), "friction sticks", "sticks"),
        (System.from_mapping(RUBBED_STOP), "the mass rests on a stop or sticks", "rests or sticks"),
    ],
)
def test_sticking_is_told_in_the_words_of_its_machine(system: System, rests: str, label: str) -> None:
    sticks, share = (v for v in system.variables(Settings()) if v.name in ("sticks", "stuck_fraction"))
    assert (sticks.long_name, sticks.words) == (f"{rests} for part of the time; false unless known", label)
    assert ("stop" in share.long_name) == ("stop" in rests) and ("stick" in share.long_name) == ("stick" in rests)
