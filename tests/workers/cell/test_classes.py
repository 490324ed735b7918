"""Claims about classes of motion where little happens: no force, phases alone, rest, growth and decay."""

import math
from typing import Any

import numpy as np
import pytest

from atlas import Spec
from atlas.check.rules import broken_rules
from workers import Settings, System, solve_tile
from workers.cell.averages import shears
from workers.results import (
    CONSERVATIVE,
    DIES_AWAY,
    FAILED,
    FLIES_OFF,
    INVALID,
    NEVER_RECURS,
    NO_IMPACT,
    NO_REASON,
    PERIODIC,
    PERIODS_SPENT,
    REGULAR,
    RESONANCE,
    RUNS_AWAY,
    UNDETERMINED,
)

SPECTRUM = Settings(exponents="spectrum", survival=2000)


def solved(system: Any, settings: Settings = SPECTRUM, /, **params: float) -> Any:
    return solve_tile(system, params, settings)


def machine(**entries: Any) -> System:
    """A mass of 1 with damping .1."""
    return System.from_mapping({"name": "mass", "coordinates": ["x"], "mass": [[1.0]], "damping": [[0.1]]} | entries)


# No force

UNFORCED = {
    "soft-impact": ("a", [-0.02 * math.pi / 0.8] * 2),
    "soft-suspension": ("a", [-0.1 * math.pi / 1.5] * 2),
    "single-mass": ("A", None),
}


@pytest.mark.parametrize("system", UNFORCED)
def test_without_a_force_a_damped_mass_comes_to_rest_without_impact(system: str) -> None:
    """Truth: x'' + 2 zeta x' + x = 0 has the exponents -zeta T, twice."""
    name, exponents = UNFORCED[system]
    for start in (0.0, 0.05):
        found = solved(system, **{name: 0.0, "x": start})
        assert (found["regime"], found["period"]) == (NO_IMPACT, 1)
        if exponents:
            assert found["spectrum"] == pytest.approx(exponents, rel=1e-12)


def test_without_forces_the_masses_between_two_stops_come_to_rest() -> None:
    """Truth: the same cell under a force of 1e-160, whose exponents the solver has always found."""
    still, shaken = (solved("two-stops", A1=force, A2=force) for force in (0.0, 1e-160))
    assert still["regime"] == shaken["regime"] == NO_IMPACT
    assert still["spectrum"] == pytest.approx(shaken["spectrum"], rel=1e-12)


@pytest.mark.parametrize(
    ("system", "force", "exponents"),
    [
        ("bouncing-ball", "A", [-math.inf, -math.inf]),
        ("friction-oscillator", "A", [0.0, -math.inf]),
        ("capsule", "alpha", [-0.1 * math.pi / 0.9] * 2 + [-math.inf]),
    ],
)
def test_what_lies_still_without_a_force_is_periodic(system: str, force: str, exponents: list[float]) -> None:
    found = solved(system, **{force: 0.0})
    assert (found["regime"], found["period"], found["sticks"]) == (PERIODIC, 1, True)
    assert found["spectrum"] == pytest.approx(exponents, rel=1e-12)


def test_a_capsule_whose_inner_mass_swings_to_rest_is_periodic() -> None:
    """Its swing dies away for ever: it is measured against what friction holds."""
    found = solved("capsule", alpha=0.0, r=-0.5)
    assert (found["regime"], found["period"]) == (PERIODIC, 1)
    assert found["periods_used"] < 100


def test_an_undamped_mass_that_stands_still_between_its_walls_stays_there() -> None:
    found = solved("impact-pair", alpha=0.0, y=0.1)
    assert (found["regime"], found["spectrum"].tolist()) == (NO_IMPACT, [0.0, 0.0])
    assert found["state"].tolist() == [0.1, 0.0]


@pytest.mark.parametrize("clearance", [0.42, 0.6])
def test_a_free_mass_that_shakes_about_one_place_within_its_walls_has_no_impact(clearance: float) -> None:
    """Truth: z = (1 - cos omega t) / omega^2, at most 2 / pi^2 = 0.2026 away, which is less than half of the clearance.

    The phase pi / 2 of the force is known to rounding: by as much it could drift.
    """
    found = solved("energy-harvester", beta=0.0, d=clearance)
    assert (found["regime"], found["spectrum"].tolist()) == (NO_IMPACT, [0.0, 0.0])
    assert found["peak_to_peak"] == pytest.approx(2.0 / math.pi**2, rel=1e-12)


# Phases alone

SWITCHED = {"stiffness": [[0.35]], "phases": [{"start": 0.0}, {"start": 0.5, "stiffness": [[0.15]]}]}


def multipliers(omega: float) -> np.ndarray:
    """Of x'' + .1 x' + k x = 0 with k = .35 and .15, each for half a period, by matrix exponentials in closed form."""
    turn = np.eye(2)
    for k in (0.35, 0.15):
        w, t = math.sqrt(k - 0.05**2), math.pi / omega
        c, s = math.cos(w * t), math.sin(w * t) / w
        turn = math.exp(-0.05 * t) * np.array([[c + 0.05 * s, s], [-k * s, c - 0.05 * s]]) @ turn
    return np.linalg.eigvals(turn)


@pytest.mark.parametrize("omega", [0.5, 1.2, 2.3])
@pytest.mark.parametrize("start", [0.0, 0.1])
def test_a_machine_of_phases_alone_has_the_exponents_of_its_linear_map(omega: float, start: float) -> None:
    found = solved(machine(**SWITCHED), omega=omega, x=start)
    exact = np.sort(np.log(np.abs(multipliers(omega))))[::-1]
    assert (found["regime"], found["period"], found["reason"]) == (NO_IMPACT, 1, NO_REASON)
    assert found["spectrum"] == pytest.approx(exact, rel=1e-13)
    assert found["state"].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("method", ["adaptive", "fixed"])
@pytest.mark.parametrize("start", [0.0, 0.1])
def test_a_machine_of_phases_alone_that_grows_runs_away(start: float, method: str) -> None:
    """The multiplier that is largest is -1.0873689: no chaos, though its logarithm is positive."""
    assert np.max(np.abs(multipliers(1.0))) == pytest.approx(1.0873689, rel=1e-7)
    found = solved(machine(**SWITCHED), Settings(method=method), omega=1.0, x=start)
    assert (found["regime"], found["reason"]) == (FAILED, RUNS_AWAY)


def test_loads_that_phases_switch_move_a_linear_machine_to_its_one_orbit() -> None:
    """Truth: a period of its map, applied to the state that is given."""
    loaded = machine(stiffness=[[0.35]], phases=[{"start": 0.0, "load": [1.0]}, {"start": 0.5, "load": [-0.4]}])
    found = solved(loaded, omega=1.3, x=5.0)
    w, t = math.sqrt(0.35 - 0.05**2), math.pi / 1.3
    c, s = math.cos(w * t), math.sin(w * t) / w
    half = math.exp(-0.05 * t) * np.array([[c + 0.05 * s, s], [-0.35 * s, c - 0.05 * s]])
    state = found["state"]
    for load in (1.0, -0.4):
        rest = np.array([load / 0.35, 0.0])
        state = rest + half @ (state - rest)
    assert found["regime"] == NO_IMPACT
    assert state == pytest.approx(found["state"], rel=1e-13)


def test_an_undamped_machine_of_phases_alone_swings_for_ever_where_its_multipliers_are_on_the_unit_circle() -> None:
    """Truth: the trace of its map, of determinant 1, is less than 2. Without phases it has no impact, exponents 0."""
    swings = machine(damping=[[0.0]], **SWITCHED)
    found = solved(swings, omega=2.3, x=0.1)
    half = [
        np.array([[math.cos(w * t), math.sin(w * t) / w], [-w * math.sin(w * t), math.cos(w * t)]])
        for w, t in ((math.sqrt(k), math.pi / 2.3) for k in (0.35, 0.15))
    ]
    assert abs(np.trace(half[1] @ half[0])) < 2.0
    assert (found["regime"], found["period"], found["spectrum"].tolist()) == (NO_IMPACT, 1, [0.0, 0.0])
    assert found["state"] == pytest.approx([0.1, 0.0], abs=1e-15)


def test_two_undamped_masses_of_phases_alone_swing_for_ever() -> None:
    """Truth: eigenvalues of the product of the halves' matrix exponentials, by modes, all have modulus 1."""
    stiffness = [[[3.0, -1.0], [-1.0, 2.0]], [[2.5, -1.0], [-1.0, 2.2]]]
    turn = np.eye(4)
    for K in stiffness:
        lam, U = np.linalg.eigh(np.array(K))
        w, t = np.sqrt(lam), math.pi / 1.1
        c, s = U @ np.diag(np.cos(w * t)) @ U.T, U @ np.diag(np.sin(w * t) / w) @ U.T
        turn = np.block([[c, s], [-np.array(K) @ s, c]]) @ turn
    assert np.abs(np.linalg.eigvals(turn)) == pytest.approx(1.0, abs=1e-12)
    two = System.from_mapping({
        "name": "two", "coordinates": ["x1", "x2"], "mass": [[1.0, 0.0], [0.0, 1.0]], "stiffness": stiffness[0],
        "phases": [{"start": 0.0}, {"start": 0.5, "stiffness": stiffness[1]}],
    })  # fmt: skip
    found = solved(two, omega=1.1, x1=0.1)
    assert (found["regime"], found["spectrum"].tolist()) == (NO_IMPACT, [0.0] * 4)


def test_where_multipliers_meet_on_the_unit_circle_nothing_is_said_to_swing_for_ever() -> None:
    """Truth: at a trace of -2 a motion grows in proportion to the time. It is met by bisection."""

    def trace_of(omega: float) -> float:
        a, b = math.sqrt(0.35), math.sqrt(0.15)
        s, t = a * math.pi / omega, b * math.pi / omega
        return 2.0 * math.cos(s) * math.cos(t) - (a / b + b / a) * math.sin(s) * math.sin(t)

    low, high = 1.0, 2.3
    assert trace_of(low) < -2.0 < trace_of(high)
    while low < 0.5 * (low + high) < high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if trace_of(middle) < -2.0 else (low, middle)
    found = solved(machine(damping=[[0.0]], **SWITCHED), Settings(max_periods=300, survival=0), omega=high, x=0.1)
    assert found["regime"] != NO_IMPACT


def test_gears_without_a_load_coast_to_rest_within_their_backlash() -> None:
    """Truth: x'' + 2 zeta x' = E omega^2 sin(omega t): the place of rest is neutral, and the speed decays."""
    found = solved("gear-mesh", F=0.0)
    T = 2.0 * math.pi / 0.8
    assert (found["regime"], found["period"], found["reason"]) == (NO_IMPACT, 1, NO_REASON)
    assert found["spectrum"] == pytest.approx([0.0, -2.0 * 0.05 * T], rel=1e-12) and found["largest"] == 0.0
    answer = 0.05 * 0.8**2 / complex(-(0.8**2), 2.0 * 0.05 * 0.8)
    x, v = found["state"]
    assert v == pytest.approx(0.8 * answer.real, rel=1e-12)
    assert abs(x - answer.imag) + abs(answer) < 1.0


# Resonance


@pytest.mark.parametrize("phases", [{}, {"phases": [{"start": 0.0}, {"start": 0.5}]}], ids=["plain", "with modes"])
def test_undamped_resonance_is_invalid_in_every_machine(phases: dict[str, Any]) -> None:
    stopped = {"stiffness": [[1.0]], "force": [0.1], "gap": [1.0], "upper": 5.0, "restitution": 0.5}
    found = solved(machine(damping=[[0.0]], **stopped, **phases), omega=1.0)
    assert (found["regime"], found["reason"]) == (INVALID, RESONANCE)


@pytest.mark.parametrize("A", [0.3, 0.9])
def test_a_mass_that_friction_holds_for_ever_is_periodic_where_it_would_resonate_if_it_slid(A: float) -> None:
    """As at any other frequency: its place is neutral, its speed is lost."""
    for omega in (0.7, 1.0):
        found = solved("friction-oscillator", omega=omega, zeta=0.0, A=A)
        assert (found["regime"], found["period"], found["stuck_fraction"]) == (PERIODIC, 1, 1.0)
        assert found["spectrum"].tolist() == [0.0, -math.inf]


# Growth and decay

RESONANT = {"omega": 2.0, "A": 0.1, "b": 0.001, "R": 1.0, "zeta": 0.0}


@pytest.mark.parametrize(
    ("system", "params"),
    [
        ("impact-pair", {"alpha": 0.0, "v": 0.5}),
        ("impact-pair", {"alpha": 0.0, "v": 0.5, "R": 0.99}),
        ("impact-pair", {"alpha": 0.0, "v": 0.5, "R": 0.1}),
        ("single-mass", RESONANT),
    ],
)
def test_what_dies_away_or_grows_for_ever_is_no_torus(system: str, params: dict[str, float]) -> None:
    """Its exponents go to zero, as those of a torus do, but it never comes back: speeds fall as R^n, or grow with n."""
    found = solved(system, **params)
    assert found["regime"] == UNDETERMINED
    assert found["reason"] == (DIES_AWAY if system == "impact-pair" else NEVER_RECURS)


@pytest.mark.parametrize("method", ["adaptive", "fixed"])
def test_growth_without_end_is_the_reason_that_a_resonant_mass_gives(method: str) -> None:
    found = solved("single-mass", Settings(method=method, survival=2000), **RESONANT)
    assert (found["regime"], found["reason"]) == (UNDETERMINED, NEVER_RECURS)


FREE = {"name": "free", "coordinates": ["x"], "mass": [[1.0]]}
STOP = {"gap": [1.0], "lower": 0.0}


def reason_of(given: dict[str, Any], values: dict[str, float], **settings: Any) -> tuple[int, int]:
    system = System.from_mapping(FREE | given)
    found = solve_tile(system, values, Settings(max_periods=2000, survival=0, **settings))
    return int(found["regime"]), int(found["reason"])


@pytest.mark.parametrize("method", ["adaptive", "fixed"])
@pytest.mark.parametrize("stop", [STOP | {"restitution": 0.7},
                                  {"contacts": [{"name": "stop", "stiffness": 3.0, **STOP}]}])  # fmt: skip
def test_a_mass_that_moves_off_at_a_constant_speed_never_comes_back(stop: dict[str, Any], method: str) -> None:
    """x'' = sin t, so x = 1 + t - sin t: no stop is above."""
    values = {"omega": 1.0, "tau": 0.0, "x": 1.0}
    assert reason_of({"force": [1.0]} | stop, values, method=method) == (UNDETERMINED, FLIES_OFF)


def test_a_mass_between_walls_that_nothing_drives_dies_away() -> None:
    """Speeds fall as .6^n, and the times between impacts grow as much: it never rests."""
    walls = {"gap": [1.0], "lower": -1.0, "upper": 1.0, "restitution": 0.6}
    assert reason_of(walls, {"v": 1.0}) == (UNDETERMINED, DIES_AWAY)


@pytest.mark.parametrize("method", ["adaptive", "fixed"])
@pytest.mark.parametrize("stop", [STOP | {"restitution": 1.0},
                                  {"contacts": [{"name": "stop", "stiffness": 5.0, **STOP}]}])  # fmt: skip
def test_a_machine_that_loses_nothing_has_no_attractor(stop: dict[str, Any], method: str) -> None:
    """A ball on an elastic table that shakes: the map keeps areas. With the least loss something attracts."""
    ball, values = {"load": [-1.0], "force": [0.02]} | stop, {"omega": 1.0, "x": 1.0}
    regime, reason = reason_of(ball, values, method=method)
    assert (regime, reason) == (UNDETERMINED, CONSERVATIVE)
    regime, reason = reason_of(ball | {"damping": [[1e-6]]}, values, method=method)
    assert (regime, reason) == (UNDETERMINED, PERIODS_SPENT)


def test_a_mass_that_flies_from_wall_to_wall_without_loss_is_regular() -> None:
    """Truth: faster masses strike earlier by more and more, in proportion to the time: exponents are zero."""
    spec = Spec("impact-pair", {"v": [0.5, 0.77]}, parameters={"alpha": 0.0, "R": 1.0}, solve={"exponents": "spectrum"})
    arrays = solve_tile(spec.system_def, spec.cell_params((slice(0, 2),)), spec.settings)
    assert (arrays["regime"] == REGULAR).all()
    assert not arrays["spectrum"].any() and (arrays["error"] < 3e-4).all()
    assert broken_rules(spec, (slice(0, 2),), arrays) == {}


@pytest.mark.parametrize("begun", [-50.0, 0.0, 200.0])
def test_growth_in_proportion_to_the_time_is_that_of_shear_whenever_it_began(begun: float) -> None:
    """Growth of t - begun over two stretches, beside a small exponent that is not zero and one that falls faster."""

    def weighted(growth: Any, start: float, periods: int) -> float:
        u = (np.arange(periods) + 0.5) / periods
        return float(np.average(growth(start + periods * u), weights=np.exp(-1.0 / (u * (1.0 - u)))))

    laws = [
        lambda t: 1.0 / (t - begun),
        lambda t: 1e-4 + 0.0 * t,
        lambda t: 2.0 / (t - begun),
        lambda t: -1.0 / (t - begun),
    ]
    previous, now = (np.array([weighted(law, t, n) for law in laws]) for t, n in ((2000.0, 2000), (4000.0, 4000)))
    assert shears(previous, now, np.full(4, 3000.0)).tolist() == [True, False, False, False]


# Rest

STOP = {"name": "stop", "gap": [1.0], "lower": 0.0, "restitution": 0.5}
LOADS = [{"start": 0.0, "load": [-1.0]}, {"start": 0.3, "load": [0.1]}, {"start": 0.6, "load": [-3.0]}]
PRESSED = [{"start": 0.0, "load": [-1.0]}, {"start": 0.3, "load": [-0.1]}, {"start": 0.6, "load": [-3.0]}]


@pytest.mark.parametrize("start", [0.0, 1.0])
@pytest.mark.parametrize("phases", [LOADS, PRESSED], ids=["leaves", "stays"])
@pytest.mark.parametrize("friction", [0.0, 0.01])
def test_a_mass_that_loads_press_on_a_stop_each_period_is_periodic(start: float, phases: Any, friction: float) -> None:
    """It lies on its stop at each section: every disturbance is gone."""
    rub = {"friction": [{"name": "rail", "row": [1.0], "kinetic": friction}]} if friction else {}
    found = solved(machine(contacts=[STOP], phases=phases, **rub), omega=1.0, x=start)
    assert (found["regime"], found["period"]) == (PERIODIC, 1)
    assert found["spectrum"].tolist() == [-math.inf, -math.inf]
    assert found["periods_used"] < 100


@pytest.mark.parametrize("R", [0.3, 0.7])
def test_a_mass_that_dies_away_at_an_equilibrium_on_its_stop_never_locks(R: float) -> None:
    """Truth: it is scale-free, each half turn takes off the share R e^(-zeta pi / w), so that it strikes for ever."""
    still = machine(stiffness=[[1.0]], force=[0.0], gap=[1.0], upper=0.0, restitution=R)
    found = solved(still, omega=0.8, x=-0.3)
    assert found["regime"] == UNDETERMINED
    assert not found["sticks"]


def test_a_force_so_near_undamped_resonance_that_growth_seems_to_close_has_no_class() -> None:
    """Truth: its own history moves on by .084 a period, for thousands of periods."""
    for omega in (1.0 + 1e-9, 1.0 - 1e-12):
        found = solved("friction-oscillator", omega=omega, zeta=0.0, A=1.3, s=1.0)
        assert (found["regime"], found["reason"]) == (INVALID, RESONANCE)


@pytest.mark.parametrize("load", [0.999, 1.0])
def test_a_load_up_to_static_friction_leaves_an_unforced_mass_where_it_is(load: float) -> None:
    held = {"friction": [{"name": "rail", "row": [1.0], "kinetic": 0.5, "static": 1.0}]}
    found = solved(machine(contacts=[STOP | {"lower": -1.0}], load=[load], **held))
    assert (found["regime"], found["period"]) == (NO_IMPACT, 1)
    assert found["spectrum"].tolist() == [0.0, -math.inf]
    assert found["state"].tolist() == [0.0, 0.0]


# Reasons


def test_every_cell_without_a_class_says_why() -> None:
    rng = np.random.default_rng(5)
    params = {"omega": rng.uniform(1.0, 4.0, 60), "b": rng.uniform(0.0, 0.5, 60)}
    for settings in (Settings(max_periods=300), Settings(max_periods=300, exponents="none"),
                     Settings(method="fixed", transient_periods=20, periods=50)):  # fmt: skip
        found = solve_tile("two-mass", params, settings)
        unknown = found["regime"] == UNDETERMINED
        assert unknown.any()
        assert np.all(found["reason"][unknown] == PERIODS_SPENT)
