"""Claims about forces: sine and cosine parts, many orders, commensurate frequencies."""

import json
import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import xarray as xr

from atlas import Spec, branch
from atlas.cell.trajectory import samples_of
from atlas.query.queries import per_unit_time
from atlas.render.grazing import grazing_ratio
from atlas.robustness.norm import weights_of
from atlas.spec.equation import equation_of
from tests.refusals import refuse
from tests.support.oracle import OracleMachine
from tests.support.oracle.machines import random_machine
from tests.support.oracle.piecewise import HarmonicForce
from tests.support.oracle.piecewise.random_machines import random_machine as pieces_at_random
from tests.workers.cell.test_family import assert_jacobians_agree, assert_sections_agree, solver_jacobian
from tests.workers.kernel.test_hybrid_random import SENSITIVE, Drawn, assert_few_stop, compare
from tests.workers.kernel.test_hybrid_random import drawn as pieces_of
from workers import Settings, System, solve_tile
from workers.attractors.initial_states import REACH, AttractorSettings, boxes
from workers.model.parse_force import HARMONICS, HIGHEST
from workers.results import PERIODIC

OWN: dict[str, Any] = {
    "name": "own", "coordinates": ["x"], "mass": [["m"]], "damping": [["c"]], "stiffness": [["k"]], "gap": [1.0],
    "upper": "b", "restitution": 0.7,
    "parameters": {"m": 1.3, "c": 0.3, "k": 2.0, "b": 100.0, "A": 0.8, "B": 0.5},
}  # fmt: skip


def machine(**entries: Any) -> System:
    return System.from_mapping(OWN | entries)


def solved(system: System, **values: Any) -> dict[str, Any]:
    return dict(solve_tile(system, values, Settings(exponents="spectrum", section_samples=4)))


def force_at(system: System, angles: np.ndarray, **values: float) -> np.ndarray:
    """The force and the load on the first coordinate at these values of omega t + tau."""
    known = {p.name: np.array([values.get(p.name, p.default)]) for p in system.parameters}
    many = system.definition.machines(known)
    orders = np.arange(1, many.force_sin.shape[2] + 1) / system.definition.turns
    turned = np.multiply.outer(angles, orders)
    parts = np.sin(turned) @ many.force_sin[0, 0, :, 0] + np.cos(turned) @ many.force_cos[0, 0, :, 0]
    return np.asarray(parts + many.load[0, 0, 0])


# Sine and cosine parts


def test_a_base_that_shakes_spring_and_damper_moves_the_mass_by_the_closed_form() -> None:
    """m x'' + c (x' - y') + k (x - y) = 0 with y = A sin(omega t): |x| / A = |k + i c w| / |k - m w^2 + i c w|."""
    base = machine(force=["k * A"], cosine=["c * omega * A"])
    omega = np.array([0.3, 1.1, 1.24, 4.0])
    found = solved(base, omega=omega)["peak_to_peak"]
    stiff = 2.0 + 0.3j * omega
    assert found == pytest.approx(2 * 0.8 * np.abs(stiff / (stiff - 1.3 * omega**2)), rel=1e-12)


def test_the_packaged_example_grazes_its_stop_at_the_transmissibility() -> None:
    system = Spec.from_toml("shaken-base").system_def
    omega = np.array([0.3, 0.9, 1.6, 3.0])
    ratio = grazing_ratio(
        system, {p.name: p.default for p in system.parameters}, ("omega", omega), ("b", np.array([1.0]))
    )[0]
    stiff = 1.0 + 0.2j * omega
    assert np.exp(ratio) == pytest.approx(np.abs(stiff / (stiff - omega**2)), rel=1e-12)


def test_a_phase_turns_sine_and_cosine_together() -> None:
    system = machine(harmonics=[{"order": 2, "force": ["A"], "cosine": ["B"], "phase": [0.4]}])
    angles = np.linspace(-3.0, 9.0, 40)
    expected = 0.8 * np.sin(2 * angles + 0.4) + 0.5 * np.cos(2 * angles + 0.4)
    assert force_at(system, angles) == pytest.approx(expected, abs=1e-14)


def test_parts_of_one_order_add_up() -> None:
    """Spring and damper of a shaken base as one part with a cosine, and as two with a phase of their own."""
    one = machine(force=["k * A"], cosine=["c * omega * A"])
    two = machine(force=["k * A"], harmonics=[{"order": 1, "force": ["c * omega * A"], "phase": ["pi / 2"]}])
    angles = np.linspace(0.0, 6.0, 20)
    assert force_at(two, angles) == pytest.approx(force_at(one, angles), abs=1e-15)


def test_a_phase_of_the_period_changes_sine_and_cosine_of_the_force() -> None:
    phases = [{"start": 0.0}, {"start": 0.5, "cosine": [2.0]}, {"start": 0.7, "force": [3.0], "cosine": [0.0]}]
    system = machine(force=["A"], cosine=["B"], phases=phases, harmonics=[{"order": 3, "force": [0.1]}])
    many = system.definition.machines({p.name: np.array([p.default]) for p in system.parameters})
    assert many.force_sin[0, :, :, 0].tolist() == [[0.8, 0.0, 0.1], [0.8, 0.0, 0.1], [3.0, 0.0, 0.1]]
    assert many.force_cos[0, :, :, 0].tolist() == [[0.5, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 0.0]]


def test_the_equation_has_both_parts_and_orders_that_are_ratios() -> None:
    system = machine(force=["A"], cosine=["-B"], harmonics=[{"order": "3/2", "cosine": [1.0], "phase": ["pi / 3"]}])
    right = "A * sin(omega t + tau) - B * cos(omega t + tau) + cos(3/2 (omega t + tau) + pi / 3)"
    lines = [f"m * x'' + c * x' + k * x = {right}", "forcing period 4 pi / omega"]
    assert equation_of(system).splitlines()[:2] == lines


# Commensurate frequencies

RATIO: dict[str, Any] = {
    "b": 0.9, "tau": 0.7, "A": 0.8, "omega": np.array([1.0, 1.37, 1.9, 2.5]),
}  # fmt: skip


def two_frequencies(ratio: str, phase: float = 0.3) -> System:
    return machine(force=["A"], harmonics=[{"order": ratio, "force": ["B"], "phase": [phase]}])


def test_a_ratio_makes_the_machine_of_whole_orders_of_the_lower_frequency() -> None:
    """Orders 1 and 3/2 of omega are 2 and 3 of omega / 2: the same machine, to the bit."""
    whole = machine(harmonics=[{"order": 2, "force": ["A"]}, {"order": 3, "force": ["B"], "phase": [0.3]}])
    given, halved = RATIO, RATIO | {"omega": RATIO["omega"] / 2, "tau": 0.35}
    one, other = solved(two_frequencies("3/2"), **given), solved(whole, **halved)
    assert np.any(one["impacts_per_period"] > 0)
    for name, found in one.items():
        assert np.array_equal(found, other[name], equal_nan=found.dtype.kind == "f"), name


def test_the_phase_of_an_impact_is_that_of_omega_where_the_force_repeats_later() -> None:
    whole = machine(harmonics=[{"order": 2, "force": ["A"]}, {"order": 3, "force": ["B"], "phase": [0.3]}])
    settings = Settings(observe="impact_phase", observe_values=16)
    one = solve_tile(two_frequencies("3/2"), RATIO, settings)
    other = solve_tile(whole, RATIO | {"omega": RATIO["omega"] / 2, "tau": 0.35}, settings)
    assert np.any(one["impact_phase_number"] > 0)
    turned = np.mod(2.0 * other["impact_phase"], 2 * math.pi)
    assert one["impact_phase"] == pytest.approx(turned, abs=1e-12, nan_ok=True)


def test_a_ratio_in_lower_terms_is_the_same_machine() -> None:
    assert two_frequencies("6/4") == two_frequencies("3/2")
    assert two_frequencies("4/2").table()["harmonics"][1]["order"] == 2
    assert two_frequencies("3/2").table()["harmonics"][1]["order"] == "3/2"


@pytest.mark.parametrize("ratio", ["3/2", "4/3", "9/8", "1/5", "29/30"])
def test_the_force_repeats_after_the_turns_of_its_definition_and_not_before(ratio: str) -> None:
    system = two_frequencies(ratio)
    angles, turn = np.linspace(0.0, 1.0, 7), 2 * math.pi
    turns = system.definition.turns
    assert turns == int(ratio.split("/")[1])
    assert force_at(system, angles + turns * turn) == pytest.approx(force_at(system, angles), abs=1e-12)
    for fewer in range(1, turns):
        assert np.abs(force_at(system, angles + fewer * turn) - force_at(system, angles)).max() > 1e-3


def test_tau_shifts_the_whole_force_in_time() -> None:
    """All sections move, and no attractor: also by more than one period 2 pi / omega."""
    system, settings = two_frequencies("3/2"), Settings(exponents="spectrum")
    values = {key: RATIO[key] for key in ("b", "A", "omega")}
    one, later = (solve_tile(system, values | {"tau": tau}, settings) for tau in (0.0, 0.7 + 2 * math.pi))
    closed = (one["regime"] == PERIODIC) & (later["regime"] == PERIODIC) & (one["period"] == 1) & (later["period"] == 1)
    assert closed.sum() >= 2
    assert later["largest"][closed] == pytest.approx(one["largest"][closed], abs=1e-9)


def test_exponents_per_unit_time_know_the_longer_period() -> None:
    """The sum of all exponents per unit time of a motion without impacts is -c / m, whatever the period."""
    system = two_frequencies("3/2")
    spectrum = solved(system, omega=1.4)["spectrum"]
    ds = xr.Dataset(
        {"spectrum": ("exponent", spectrum)},
        coords={"omega": 1.4},
        attrs={"spec": json.dumps(system.to_resolved())},
    )
    assert per_unit_time(ds)["spectrum"].values.sum() == pytest.approx(-0.3 / 1.3, rel=1e-12)


def test_units_of_velocity_are_those_of_omega_and_not_of_the_longer_period() -> None:
    """Of initial states, which reach omega times as far as half of a wide gap, and of the norm of deviations."""
    system = System.from_mapping(two_frequencies("3/2").table() | {"lower": "-b"})
    values = {p.name: np.array([p.default]) for p in system.parameters} | {"omega": np.array([1.4])}
    oscillators, _ = system.build_many(values)
    low, high = boxes(AttractorSettings(), oscillators, system)
    assert high[0].tolist() == pytest.approx([100.0, REACH * 1.4 * 100.0])
    assert low == pytest.approx(-high)
    assert weights_of({}, system, float(oscillators.period[0])) == pytest.approx([1.0, 1 / 1.4])


@pytest.mark.slow
def test_events_of_a_branch_of_a_ratio_are_those_of_whole_orders() -> None:
    whole = machine(harmonics=[{"order": 2, "force": ["A"]}, {"order": 3, "force": ["B"], "phase": [0.3]}])
    events = []
    for system, scale in ((two_frequencies("3/2"), 1.0), (whole, 0.5)):
        found = branch(
            {"omega": 1.5 * scale, "b": 0.5}, along="omega", window=(scale, 2.2 * scale), system=system,
            settings=Settings(max_periods=3000, survival=0),
        ).events  # fmt: skip
        events.append((found["kind"].tolist(), (found["omega"] / scale).to_numpy()))
    assert set(events[0][0]) == {"impact_lost", "fold"}
    assert events[0][0] == events[1][0]
    assert events[0][1] == pytest.approx(events[1][1], rel=1e-9)


def test_a_machine_is_symmetric_where_all_orders_are_odd_multiples_of_the_lowest() -> None:
    symmetric = {ratio: bool(built(ratio).symmetric) for ratio in ("1/3", "5/3", "3/2", "2", "3")}
    assert symmetric == {"1/3": True, "5/3": True, "3/2": False, "2": False, "3": True}


def built(ratio: str) -> Any:
    system = two_frequencies(ratio)
    both = System.from_mapping(system.table() | {"lower": "-b"})
    return both.build({p.name: p.default for p in both.parameters})


def test_a_path_has_points_for_the_fastest_harmonic() -> None:
    assert samples_of(machine(force=["A"])) == 400
    assert samples_of(two_frequencies("32")) == 50 * 32


# Many orders


def with_orders(drawn: OracleMachine, rng: np.random.Generator) -> OracleMachine:
    """A machine with up to HARMONICS orders up to HIGHEST, the response to each of about the same size or less."""
    n, orders = len(drawn.gap_row), rng.choice(HIGHEST, int(rng.integers(1, HARMONICS + 1)), replace=False) + 1
    force = np.zeros((2, int(orders.max()), n))
    force[:, orders - 1] = rng.normal(size=(2, len(orders), n)) * rng.uniform(1.0, orders)[:, None]
    slow = float(rng.choice([1.0, 0.3]))
    return replace(drawn, force_sin=force[0], force_cos=force[1], omega=float(drawn.omega) * slow)


def drawn(seed: int) -> OracleMachine:
    rng = np.random.default_rng([51, seed])
    return with_orders(random_machine(rng, int(rng.choice([1, 2, 3])), damping="general", rigid=False), rng)


def periods_as_simulated(seed: int, periods: int) -> int:
    """The phase of the force is rounded at each impact, and the highest harmonic turns by its order times as much."""
    machine = drawn(seed)
    return assert_sections_agree(machine, periods, 1e-12 * max(1.0, len(machine.force_sin) / 4), SENSITIVE)


def test_machines_of_high_orders_move_as_simulated() -> None:
    assert sum(periods_as_simulated(seed, 2) for seed in range(4)) > 0


@pytest.mark.slow
@pytest.mark.parametrize("block", range(4))
def test_many_machines_of_high_orders_move_as_simulated(block: int) -> None:
    assert sum(periods_as_simulated(seed, 4) for seed in range(4 + 25 * block, 29 + 25 * block)) > 40


@pytest.mark.slow
def test_jacobians_of_machines_of_high_orders_are_those_of_simulated_orbits() -> None:
    """Where they are not so large that the rounding of a state changes their digits."""
    machines = [drawn(seed) for seed in range(16)]
    found = [machine for machine in machines if np.abs(solver_jacobian(machine, np.asarray(machine.start))).max() < 1e3]
    assert len(found) >= 5
    for orbit in found:
        assert_jacobians_agree(orbit)


def of_many_modes(seed: int) -> Drawn:
    """A machine with soft and rigid contacts, friction and phases, with forces of high orders."""
    rng = np.random.default_rng([53, seed])
    made = pieces_at_random(seed, switched_elements=seed % 2 == 1)
    orders = sorted(rng.choice(HIGHEST, int(rng.integers(1, HARMONICS + 1)), replace=False).tolist())
    parts = rng.normal(size=(len(orders), 2, made.n)) * rng.uniform(0.2, 0.6)
    forces = (
        HarmonicForce(k + 1, *(part * (k + 1) * made.omega).tolist()) for k, part in zip(orders, parts, strict=True)
    )
    return pieces_of(seed, replace(made, forces=tuple(forces)))


def test_machines_of_many_modes_and_high_orders_go_where_the_oracle_takes_them() -> None:
    assert_few_stop([compare(seed, 1, of_many_modes) for seed in range(6)])


@pytest.mark.slow
@pytest.mark.parametrize("block", range(4))
def test_many_machines_of_many_modes_and_high_orders_go_where_the_oracle_takes_them(block: int) -> None:
    assert_few_stop([compare(seed, 2, of_many_modes) for seed in range(10 + 25 * block, 35 + 25 * block)])


LINES: list[tuple[dict[str, Any], str]] = [
    (
        {"force": [1], "harmonics": [{"order": "23/22", "force": [1]}, {"order": "3/2", "force": [1]}]},
        "system.harmonics[1].order: found 33 times omega / 22, the frequency at which the force repeats, must be",
    ),
    ({"harmonics": [{"order": 1.5, "force": [1]}]}, "found 1.5, must be a whole number, 1 to 32, or a ratio of two"),
    ({"harmonics": [{"order": "2/0", "force": [1]}]}, "found '2/0', must be a whole number"),
    ({"harmonics": [{"order": 0, "force": [1]}]}, "found 0, must be a whole number"),
    ({"harmonics": [{"order": True, "force": [1]}]}, "found True, must be a whole number"),
    (
        {"harmonics": [{"order": k, "force": [1]} for k in range(1, 12)]},
        "system.harmonics: found 11 orders, must be at most 8; leave out 3",
    ),
    (
        {"harmonics": [{"order": 1, "force": [1], "waveform": "triangle"}]},
        "unknown key in system.harmonics[0] 'waveform'; known: order, force, phase, cosine",
    ),
    ({"harmonics": [{"order": 1, "force": [1], "within": 0.1}]}, "unknown key in system.harmonics[0] 'within'"),
]  # fmt: skip


def names(lines: Iterable[tuple[dict[str, Any], str]]) -> list[str]:
    return [message[:50] for _, message in lines]


@pytest.mark.parametrize(("entries", "message"), LINES, ids=names(LINES))
def test_a_force_that_is_wrong_gets_its_line(entries: dict[str, Any], message: str) -> None:
    refuse(OWN | entries, message)
