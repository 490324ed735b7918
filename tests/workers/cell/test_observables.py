"""Observables: closed forms, the oracle's orbits and chaos, dense samples, and what is refused."""

import math
from typing import Any

import numpy as np
import pytest

from atlas.cell.trajectory import cell_orbit
from tests.support.oracle.closed_form import one_sided_orbit
from tests.support.oracle.free_mass import impact_pair_orbits
from tests.support.oracle.machines import single_mass
from tests.support.oracle.simulate import simulate
from tests.support.solver_bridge import built
from tests.workers.cell.test_measures import ORBITS, readings_of
from tests.workers.kernel.test_hybrid_orbits import RECORDS, expected_events, machine_in, number_in
from workers import Settings, System, solve_tile
from workers.cell.observables import observe_orbits, record_observables
from workers.model.observables import Observable, observables_of
from workers.model.system import find_system
from workers.results import CHAOTIC, INVALID, PERIODIC

TWO_PI = 2.0 * math.pi
IMPACTS = "impact_phase:upper,impact_phase:lower,impact_speed"

SPRING: dict[str, Any] = {
    "name": "spring", "coordinates": ["x"], "mass": [[1.0]], "damping": [["c"]], "stiffness": [["k"]], "force": ["F"],
    "gap": [1.0], "upper": "stop", "restitution": "R",
    "parameters": {
        "omega": {"default": 2.0}, "c": {"default": 0.2}, "k": {"default": 1.0}, "F": {"default": 1.0},
        "stop": {"default": 100.0}, "R": {"default": 0.7},
    },
    "measures": {"push": {"acceleration": [2.0], "report": ["peak"]}},
}  # fmt: skip
"""A mass on a spring with one stop, which is far away."""


def seen(system: Any, params: Any, observe: str, values: int = 64, **more: Any) -> dict[str, Any]:
    return solve_tile(system, params, Settings(observe=observe, observe_values=values, **more))


def values_of(found: dict[str, Any], name: str, cell: Any = ()) -> Any:
    """The values of an observable in a cell, as many as it counts."""
    return found[name][cell][: int(found[f"{name}_number"][cell])]


def test_a_mass_between_two_walls_strikes_at_the_phase_and_speed_of_its_closed_form() -> None:
    orbit, *_ = impact_pair_orbits(3.0, 0.6)
    found = seen("impact-pair", {"v": 1.0}, IMPACTS)
    assert found["regime"] == PERIODIC
    assert values_of(found, "impact_phase_upper") == pytest.approx([float(orbit.phase) % TWO_PI], abs=1e-12)
    assert values_of(found, "impact_speed") == pytest.approx([float(orbit.before)] * 2, abs=1e-12)


def test_a_symmetric_orbit_strikes_below_half_a_turn_after_it_strikes_above() -> None:
    found = seen("two-mass", {"omega": 4.0, "b": [0.15, 0.14]}, IMPACTS)
    assert np.all(found["symmetric"])
    for cell in range(2):
        upper, lower = (values_of(found, f"impact_phase_{side}", cell) for side in ("upper", "lower"))
        assert len(upper) == len(lower) == 1
        assert (lower - upper) % TWO_PI == pytest.approx([math.pi], abs=1e-11)


def test_a_mass_with_one_stop_strikes_at_the_phase_and_speed_of_its_closed_form() -> None:
    numbers = {"omega": 2.0, "c": 0.2, "k": 1.0, "F": 1.0, "stop": 0.0, "R": 0.7}
    machine = single_mass(damping=0.2, stiffness=1, force_sin=1, omega=2.0, R=0.7, upper=0.0)
    found = seen(SPRING, numbers, "impact_phase:stop,impact_speed:stop:upper,energy_loss,maximum:x,minimum:x")
    assert (found["regime"], found["period"]) == (PERIODIC, 1)
    (speed,), (phase,) = values_of(found, "impact_speed_stop_upper"), values_of(found, "impact_phase_stop")
    known = [
        (float(impact.time) * 2.0 + float(machine.tau), float(impact.before[1])) for impact in one_sided_orbit(machine)
    ]
    phases = [(at - phase + math.pi) % TWO_PI - math.pi for at, _ in known]
    assert min(abs(at) + abs(v - speed) for at, (_, v) in zip(phases, known, strict=True)) < 1e-11
    assert values_of(found, "maximum_x") == pytest.approx([0.0], abs=1e-13)
    assert float(values_of(found, "minimum_x")[0]) == pytest.approx(-float(found["peak_to_peak"]), abs=1e-13)


def test_losses_of_a_period_are_those_of_its_impacts_where_nothing_else_takes_energy() -> None:
    orbit, *_ = impact_pair_orbits(3.0, 0.6)
    found = seen("impact-pair", {"v": 1.0}, "energy_loss")
    assert values_of(found, "energy_loss") == pytest.approx([(1.0 - 0.36) * float(orbit.before) ** 2], abs=1e-11)


def test_outputs_of_a_linear_machine_turn_once_a_period_at_their_amplitudes() -> None:
    """Also where the phase puts each turning point at the section itself."""
    response = 1.0 / complex(1.0 - 4.0, 0.4)
    size, lag = abs(response), math.atan2(response.imag, response.real)
    asked = "maximum:x,minimum:x,maximum:v,maximum:push,minimum:gap,section:x"
    quarters = math.pi / 2.0 * np.arange(4.0) - lag
    found = seen(SPRING, {"tau": np.concatenate([quarters, [0.3]])}, asked)
    for cell in range(5):
        for name, value in (
            ("maximum_x", size), ("minimum_x", -size), ("maximum_v", 2 * size), ("maximum_push", 8 * size),
            ("minimum_gap", -size),
        ):  # fmt: skip
            assert values_of(found, name, cell) == pytest.approx([value], rel=1e-12), (cell, name)
    assert found["section_x"][:4, 0] == pytest.approx([0.0, size, 0.0, -size], abs=1e-14)


@pytest.mark.parametrize("params", [{"omega": 2.3, "b": 0.15}, {"omega": 2.2, "b": 0.1}])
def test_impacts_of_chaos_are_those_of_the_oracle(params: dict[str, float]) -> None:
    """From the state on the attractor, for a few periods: rounding grows from impact to impact."""
    found = seen("two-mass", params, f"{IMPACTS},section:v2", values=6, exponents="largest", max_periods=2000)
    assert found["regime"] == CHAOTIC
    cell = {"mu_k": 5.0, "mu_m": 2.0, "zeta": 0.05, "f2": 0.0, "R": 0.8, "tau": math.pi} | params
    cell |= dict(zip(("x1", "x2", "v1", "v2"), map(float, found["state"]), strict=True))
    orbit = simulate(cell, 4, digits=40)
    count = len([impact for impact in orbit.impacts])
    assert count >= 4
    assert found["impact_speed"][: min(count, 6)] == pytest.approx(
        [float(impact.speed) for impact in orbit.impacts][:6], abs=1e-7
    )
    for side, name in ((1, "impact_phase_upper"), (-1, "impact_phase_lower")):
        known = [
            (params["omega"] * float(impact.t) + math.pi) % TWO_PI for impact in orbit.impacts if impact.side == side
        ]
        assert found[name][: min(len(known), 6)] == pytest.approx(known[:6], abs=1e-7)
    assert found["section_v2"][:4] == pytest.approx([float(section[3]) for section in orbit.sections[:4]], abs=1e-7)


def observed_on(name: str, asked: tuple[Observable, ...]) -> dict[str, Any]:
    """What observables of impacts and losses show of a turn of an orbit of the oracle."""
    record = RECORDS[name]
    hybrid = built(machine_in(record))
    n = hybrid.gap_row.shape[1]
    motions = (
        np.array([record["state"]]), np.array([[number_in(record)]]), np.array([record["periods"]]), np.array([True]),
    )  # fmt: skip
    outputs = np.zeros((1, len(asked), n)), np.zeros((1, len(asked)))
    found, whole = record_observables(hybrid, asked, outputs, motions, 64, 1)
    assert whole[0]
    return found


@pytest.mark.parametrize("name", ORBITS)
def test_contacts_of_the_oracles_orbits_are_seen_when_and_how_fast_they_are_reached(name: str) -> None:
    """Soft ones are reached at touch. Of a chatter, which has no end, the number is -1."""
    machine = machine_in(RECORDS[name])
    for c in range(len(machine.contacts)):
        asked = Observable("impact_phase", str(c), c), Observable("impact_speed", str(c), c)
        found = observed_on(name, asked)
        number = int(found[asked[0].number][0])
        events = [event for event in expected_events(RECORDS[name]) if event[1] in ("impact", "hit") and event[2] == c]
        chatters = any(kind == "rest" and index == c for _, kind, index, _ in expected_events(RECORDS[name]))
        if not chatters:
            assert number == len(events)
        tau = float(built(machine).table.tau[0])
        for k, (t, _, _, speed) in enumerate(events[:4] if chatters else events):
            phase = (machine.omega * t + tau - found[asked[0].variable][0, k] + math.pi) % TWO_PI
            assert phase == pytest.approx(math.pi, abs=1e-9)
            assert found[asked[1].variable][0, k] == pytest.approx(abs(speed), abs=1e-9)


@pytest.mark.parametrize("name", ORBITS)
def test_losses_of_the_periods_of_a_turn_add_up_to_what_its_elements_take(name: str) -> None:
    _, readings, periods = readings_of(name)
    taken = float(np.sum(readings.stop) + np.sum(readings.rubbed) + np.sum(readings.damped))
    found = observed_on(name, (Observable("energy_loss"),))
    assert found["energy_loss_number"][0] == periods
    size = max(1e-3, abs(taken))
    assert np.nansum(found["energy_loss"]) == pytest.approx(taken, abs=1e-11 * size)


@pytest.mark.parametrize("system", ["two-mass", "soft-impact", "stick-slip"])
def test_turning_points_are_those_of_dense_samples(system: str) -> None:
    """Of orbits, by the path of a portrait: what is greater than both its neighbours."""
    record = find_system(system)
    names = [name for name in record.definition.coordinates if name != record.definition.drift]
    found = seen(record, {}, ",".join(f"{kind}:{name}" for kind in ("maximum", "minimum") for name in names))
    path = cell_orbit({}, record)
    assert found["period"] == path.cell["period"] > 0
    for name in names:
        x = path.states[:-1, record.states.index(name)]
        x = x[np.append(True, np.diff(x) != 0.0)]
        for kind, sign in (("maximum", 1.0), ("minimum", -1.0)):
            peaks = (sign * x > np.roll(sign * x, 1)) & (sign * x > np.roll(sign * x, -1))
            known = values_of(found, f"{kind}_{name}")
            assert sorted(x[peaks]) == pytest.approx(sorted(known), abs=2e-3 * np.ptp(x)), (name, kind)


def test_more_values_than_are_kept_are_counted_all_the_same() -> None:
    few, all_of_them = (seen("two-mass", {"omega": 4.0, "b": 0.1}, "impact_phase", values) for values in (1, 64))
    assert few["impact_phase"].shape == (1,)
    assert few["impact_phase_number"] == all_of_them["impact_phase_number"] > 1
    assert few["impact_phase"][0] == all_of_them["impact_phase"][0]


def test_a_chatter_that_comes_to_rest_has_no_number_of_impacts() -> None:
    found = seen("two-mass", {"omega": 1.0, "R": 0.3, "b": 0.15}, IMPACTS)
    assert found["sticks"]
    assert (found["impact_speed_number"], found["impact_phase_upper_number"]) == (-1, -1)
    assert np.all(np.diff(found["impact_speed"][:3]) < 0.0) or found["impact_speed"][0] > 0.0


def test_impacts_are_counted_where_friction_sticks() -> None:
    """A capsule that sticks for part of each period and strikes its stop once."""
    found = seen("capsule", {}, "impact_speed")
    assert found["sticks"]
    assert found["stuck_fraction"] > 0.1
    assert (found["impacts_upper"], found["impacts_lower"], found["impact_speed_number"]) == (1, 0, 1)


def test_what_is_observed_changes_no_other_result_and_depends_on_no_neighbour() -> None:
    params = {"omega": np.array([2.3, 3.0, 4.0]), "b": 0.15}
    plain = solve_tile("two-mass", params, Settings(max_periods=2000))
    with_more = seen("two-mass", params, IMPACTS, max_periods=2000)
    for name, values in plain.items():
        np.testing.assert_array_equal(with_more[name], values)
    alone = seen("two-mass", {"omega": 2.3, "b": 0.15}, f"energy_loss,{IMPACTS}", max_periods=2000)
    np.testing.assert_array_equal(alone["impact_speed"], with_more["impact_speed"][0])


@pytest.mark.parametrize("system", ["two-mass", "soft-impact"])
def test_cells_without_a_class_show_nothing(system: str) -> None:
    found = seen(system, {"omega": [-1.0, -2.0]}, "impact_phase,maximum:gap")
    assert np.all(found["regime"] == INVALID)
    assert np.all(np.isnan(found["impact_phase"]))
    assert found["maximum_gap_number"].tolist() == [0, 0]


def test_orbits_are_observed_from_their_states_as_cells_are() -> None:
    record = find_system("two-mass")
    found = seen("two-mass", {"omega": [4.0, 3.5], "b": 0.15}, "impact_phase,maximum:x1")
    assert np.all(found["period"] > 0)
    values = {p.name: np.full(2, p.default) for p in record.parameters} | {"omega": np.array([4.0, 3.5])}
    values["b"][:] = 0.15
    again = observe_orbits(record.definition, values, found["state"], found["period"], "impact_phase,maximum:x1", 64)
    for name, known in again.items():
        assert known == pytest.approx(found[name], abs=1e-12, nan_ok=True)


def test_a_contact_may_be_called_upper() -> None:
    contacts = [{"name": "upper", "gap": [1.0], "upper": 1.0, "lower": -1.0, "restitution": 0.5}]
    given = {key: value for key, value in SPRING.items() if key not in ("gap", "upper", "restitution", "measures")}
    definition = System.from_mapping(given | {"contacts": contacts}).definition
    assert Observable.parse("impact_phase:upper", definition).side == 0
    assert Observable.parse("impact_phase:upper:lower", definition).side == -1
    for text in ("impact_phase:upper", "impact_phase:upper:lower", "maximum:gap", "energy_loss", "impact_speed"):
        assert Observable.parse(text, definition).name == text


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("phase:stop", "unknown observable 'phase:stop'; possible: impact_phase[:CONTACT]"),
        ("impact_phase:wall", "unknown contact 'wall'; possible: stop, upper, lower"),
        ("impact_phase:lower", "impact_phase:lower: there is no lower stop"),
        ("maximum:z", "unknown output 'z', must be maximum: and one of gap, x, v, push"),
        ("minimum", "minimum: no output, must be minimum: and one of gap, x, v, push"),
        ("energy_loss:stop", "energy_loss belongs to the whole machine"),
        ("maximum:x,maximum:x", "must name each observable once"),
    ],
)
def test_an_observable_that_a_machine_does_not_have_is_refused_in_one_line(text: str, says: str) -> None:
    definition = System.from_mapping(SPRING).definition
    with pytest.raises(ValueError, match=r"observable|contact|stop|output|machine|once") as refused:
        observables_of(text, definition)
    assert says in str(refused.value)
    assert "\n" not in str(refused.value)


def test_an_acceleration_is_greatest_at_the_end_of_a_chatter() -> None:
    """The supremum over all hops, summed with 40 digits: the load still rises while the mass comes to rest."""
    stop = {"gap": [1.0], "upper": 0.3, "restitution": 0.5}
    system = System.from_mapping({
        "name": "chatter", "coordinates": ["x"], "mass": [[1.0]], "damping": [[0.1]], "stiffness": [[1.0]],
        "force": [0.8], "load": [0.9], "measures": {"a": {"acceleration": [1.0], "report": ["peak"]}}, **stop,
    })  # fmt: skip
    found = solve_tile(system, {"omega": 0.5, "tau": 0.0})
    assert found["sticks"] and found["a_peak"] == pytest.approx(1.01083377429590057, rel=1e-13)


def test_a_plateau_at_the_section_is_one_turning_point_of_its_kind() -> None:
    """Dry friction holds the mass twice per period, at +-2.55; the phase shifts the section all along the orbit."""
    block = {
        "name": "block", "coordinates": ["x"], "mass": [[1.0]], "damping": [[0.04]], "stiffness": [[1.0]],
        "force": [2.0], "friction": [{"name": "ground", "row": [1.0], "kinetic": 1.0, "static": 1.2}],
        "measures": {"w": {"velocity": [1.0], "report": ["peak"]}},
    }  # fmt: skip
    kinds = ("maximum_x", "minimum_x", "maximum_w", "minimum_w")
    tau = np.linspace(0.0, 6.0, 25)
    found = seen(System.from_mapping(block), {"omega": 0.5, "tau": tau}, ",".join(k.replace("_", ":") for k in kinds))
    assert np.all(found["ground_stuck"] > 0.2)
    for kind in kinds:
        assert np.all(found[f"{kind}_number"] == 1)
        assert np.ptp(found[kind][:, 0]) < 1e-12
    assert found["maximum_x"][0, 0] == pytest.approx(-found["minimum_x"][0, 0], rel=1e-12)
