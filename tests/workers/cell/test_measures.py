"""Measures and results of contacts one by one: the oracle's thirty rows, closed forms, and what definitions refuse."""

import functools
import math
from typing import Any

import numpy as np
import pytest
from mpmath import mp

from tests.refusals import refuse
from tests.support.oracle.piecewise import measures
from tests.support.solver_bridge import built, follow, shown
from tests.workers.kernel.test_hybrid_orbits import RECORDS, TOUCHES, machine_in, number_in
from tests.workers.kernel.test_hybrid_random import SENSITIVE, drawn
from workers import Settings, System, solve_tile, trace
from workers.cell.measures import follow_motions
from workers.kernel.hybrid.measures import LEGS, MeasurePlan, MeasureTotals
from workers.kernel.motion import RUNNING
from workers.model.entries import DefinitionError
from workers.model.oscillator import Oscillator
from workers.results import CHAOTIC, NO_IMPACT, PERIODIC, UNDETERMINED

ORBITS = [
    name for name, record in RECORDS.items() if record["periods"] and record["drift"] is None and name not in TOUCHES
]
each_orbit = pytest.mark.parametrize("name", ORBITS)

ONE_MASS: dict[str, Any] = {
    "name": "mass", "coordinates": ["x"], "mass": [["m"]], "damping": [["c"]], "stiffness": [["k"]], "force": ["F"],
    "load": ["L"], "gap": [1.0], "upper": "stop", "restitution": "R",
    "parameters": {
        "omega": {"default": 1.3}, "m": {"default": 2.0}, "c": {"default": 0.3}, "k": {"default": 5.0},
        "F": {"default": 1.7}, "L": {"default": 0.4}, "stop": {"default": 100.0}, "R": {"default": 0.7},
    },
    "measures": {
        "place": {"displacement": [1.0], "report": ["mean", "rms", "peak"]},
        "damper": {"velocity": [1.0], "weight": "c", "report": ["mean", "rms", "peak", "power"]},
        "push": {"acceleration": ["2 * m"], "report": ["mean", "rms", "peak"]},
    },
}  # fmt: skip
"""A mass on a spring under a force and a load, with one stop, which is far away."""


def meters_of(hybrid: Oscillator) -> MeasurePlan:
    """Each displacement, velocity and acceleration, all with their extremes."""
    own, n = hybrid.table.machines, hybrid.gap_row.shape[1]
    orders = np.repeat(np.arange(3.0), n)[None]
    rows, elements = (
        np.tile(np.eye(n), (3, 1))[None],
        (own.damping, own.contact_constants, own.friction_constants, own.contact_laws, own.friction_laws),
    )
    return MeasurePlan(rows, orders, np.ones((1, 3 * n)), *elements)


@functools.cache
def readings_of(name: str) -> tuple[Oscillator, MeasureTotals, float]:
    """What a turn of an orbit of the oracle shows, and its periods."""
    record = RECORDS[name]
    hybrid = built(machine_in(record))
    state, code, periods = np.array([record["state"]]), np.array([[number_in(record)]]), np.array([record["periods"]])
    readings, whole = follow_motions(hybrid, meters_of(hybrid), state, code, periods, np.array([True]))
    assert whole[0]
    return hybrid, readings, record["periods"]


def near(value: Any, size: float = 1.0) -> Any:
    """To rounding; a chatter is cut where the rest of it takes less than a ten-thousandth of its last rebound."""
    return pytest.approx(value, rel=2e-13, abs=2e-13 * size)


def told(hybrid: Oscillator, readings: MeasureTotals, periods: float) -> dict[str, Any]:
    """What the oracle measures of a motion, see ``measures``, as the solver shows it."""
    n, span = hybrid.gap_row.shape[1], periods * hybrid.period[0]
    return {
        "rms": np.sqrt(readings.square[0, :n] / span),
        "stop_loss": readings.stop.sum() / periods,
        "friction_loss": readings.rubbed.sum() / periods,
        "damper_loss": readings.damped.sum() / periods,
        "max_penetration": np.max(readings.depth, initial=0.0),
        "max_force": np.max(readings.force, initial=0.0),
        "contact_fraction": readings.touching[0] / span,
        "stick_fraction": readings.stuck[0] / span,
        "low": readings.low[0, :n],
        "high": readings.high[0, :n],
    }


def of_soft_contacts(hybrid: Oscillator, found: dict[str, Any]) -> dict[str, Any]:
    soft = hybrid.table.machines.soft[0] > 0.0
    return found | {"contact_fraction": np.array(found["contact_fraction"])[soft]}


@pytest.mark.parametrize(
    "measure",
    ["rms", "stop_loss", "friction_loss", "damper_loss", "max_penetration", "max_force", "contact_fraction",
     "stick_fraction"],
)  # fmt: skip
@each_orbit
def test_an_orbit_shows_what_the_oracle_integrates_of_it(name: str, measure: str) -> None:
    hybrid, readings, periods = readings_of(name)
    found, wanted = (
        of_soft_contacts(hybrid, of) for of in (told(hybrid, readings, periods), RECORDS[name]["measures"])
    )
    assert found[measure] == near(wanted[measure])


@each_orbit
def test_contacts_are_counted_one_by_one_and_by_side(name: str) -> None:
    _, readings, _ = readings_of(name)
    counted = np.zeros_like(readings.hits[0])
    rests = set()
    for _, kind, index, value in RECORDS[name]["events"]:
        if kind in ("impact", "hit"):
            counted[index, 1 if value > 0.0 else 0] += 1.0
        elif kind == "rest":
            rests.add(index)
    for c, endless in enumerate(readings.endless[0] > 0.0):
        assert endless == (c in rests)
        assert endless or readings.hits[0, c].tolist() == counted[c].tolist()


@each_orbit
def test_half_a_turn_later_a_symmetric_orbit_is_its_mirror_image_and_no_other_one_is(name: str) -> None:
    _, readings, _ = readings_of(name)
    away = np.abs(readings.halves[0].sum(axis=0)).max()
    assert (away < 1e-12) == RECORDS[name]["symmetric"] or not RECORDS[name]["periods"] % 2


QUICK = (0, 1, 2, 3, 4, 5, 6, 15, 16, 22, 23, 26, 34, 38, 39)
"""Random machines of which the oracle is done soon."""


@pytest.mark.parametrize("seed", [*QUICK, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(40, 80))])
def test_random_motions_show_what_the_oracle_integrates_of_them(seed: int) -> None:
    """Over two periods from a state on no orbit. A chatter with friction ends to 1e-6, where hops are rounding."""
    hybrid, machine, start = drawn(seed)
    motion = follow(hybrid, start, periods=2)
    growth = max(1.0, float(np.abs(motion.jacobian).max()))
    if motion.status != RUNNING or growth > SENSITIVE:
        pytest.skip("more modes than there is room for, or errors grow too far")
    code, turns = np.array([[shown(hybrid, start)]]), np.array([2])
    readings, whole = follow_motions(hybrid, meters_of(hybrid), np.array([start]), code, turns, np.array([False]))
    assert whole[0]
    found = of_soft_contacts(hybrid, told(hybrid, readings, 2.0))
    wanted = of_soft_contacts(hybrid, measures(machine, start, 2, digits=30))
    for key, value in found.items():
        scale = max(1.0, float(np.max(np.abs(wanted[key]), initial=0.0)))
        error = 1e-6 * growth if key == "stick_fraction" else 1e-10 * growth * scale
        np.testing.assert_allclose(value, wanted[key], rtol=0.0, atol=error, err_msg=key)


def cell_of(definition: dict[str, Any], settings: Settings | None = None, **params: float) -> dict[str, float]:
    found = solve_tile(System.from_mapping(definition), params, settings or Settings(exponents="none"))
    return {name: value.tolist() for name, value in found.items()}


def test_a_linear_mass_has_the_mean_rms_peak_and_power_of_a_sinusoid() -> None:
    cell = cell_of(ONE_MASS)
    m, c, k, F, L, w = 2.0, 0.3, 5.0, 1.7, 0.4, 1.3
    A = F / abs(complex(k - m * w * w, c * w))
    assert cell["regime"] == NO_IMPACT
    root = math.sqrt(0.5)
    assert cell["place_mean"] == near(L / k)
    assert cell["place_rms"] == near(math.hypot(L / k, A * root))
    assert cell["place_peak"] == near(L / k + A)
    assert cell["damper_mean"] == near(0.0)
    assert cell["damper_rms"] == near(A * w * root)
    assert cell["damper_peak"] == near(A * w)
    assert cell["damper_power"] == near(c * (A * w) ** 2 / 2.0)
    assert cell["push_mean"] == near(0.0)
    assert cell["push_rms"] == near(2.0 * m * A * w * w * root)
    assert cell["push_peak"] == near(2.0 * m * A * w * w)


@pytest.mark.parametrize(("A", "regime"), [(1.0, PERIODIC), (3.0, CHAOTIC)])
def test_a_ball_in_flight_has_the_acceleration_of_its_weight_and_of_the_table(A: float, regime: int) -> None:
    """Impacts take no time: whatever the motion that never rests, y'' = A sin t - 1 while it is measured."""
    ball = {
        "name": "ball", "coordinates": ["y"], "mass": [[1.0]], "force": ["A"], "load": [-1.0], "gap": [1.0],
        "lower": 0.0, "restitution": 0.9, "parameters": {"A": {"default": A}, "y": {"default": 3.0}},
        "measures": {"g": {"acceleration": [1.0], "report": ["mean", "rms", "peak"]}},
    }  # fmt: skip
    cell = cell_of(ball, Settings(max_periods=4000, survival=1000))
    assert (cell["regime"], cell["stuck_fraction"]) == (regime, 0.0)
    assert cell["g_mean"] == pytest.approx(-1.0, abs=1e-12)
    assert cell["g_rms"] == pytest.approx(math.hypot(1.0, A * math.sqrt(0.5)), rel=1e-12)
    assert cell["g_peak"] == pytest.approx(1.0 + A, rel=1e-12)


def test_a_chatter_of_more_legs_than_there_is_room_for_at_first_is_measured_whole() -> None:
    """Over a turn of an orbit, rests included, a velocity has the mean zero."""
    ball = {
        "name": "ball", "coordinates": ["y"], "mass": [[1.0]], "force": [1.1], "load": [-1.0], "gap": [1.0],
        "lower": 0.0, "restitution": 0.9, "parameters": {},
        "measures": {"v": {"velocity": [1.0], "report": ["mean", "rms"]}},
    }  # fmt: skip
    cell = cell_of(ball, Settings(max_periods=4000, survival=1000))
    assert cell["regime"] == PERIODIC and cell["sticks"] and cell["v_rms"] > 0.01
    y, v = cell["state"]  # type: ignore[misc]
    impacts = trace(System.from_mapping(ball), {"y": y, "v": v}, 1).impacts
    assert len(impacts) > LEGS
    assert abs(cell["v_mean"]) < 1e-12


def square_wave(c: float, k: float, T: float) -> tuple[Any, Any, Any]:
    """x(t) over half a period, of x'' + c x' + k x = 1, then -1: antiperiodic; x, x' and the mean squares of both."""
    root = mp.sqrt(mp.mpf(c) ** 2 / 4 - mp.mpf(k) + mp.mpf(10) ** -40)
    rates, half = (-mp.mpf(c) / 2 + root, -mp.mpf(c) / 2 - root), mp.mpf(T) / 2
    matrix = mp.matrix([[1 + mp.exp(r * half) for r in rates], [r * (1 + mp.exp(r * half)) for r in rates]])
    a = mp.lu_solve(matrix, mp.matrix([-2 / mp.mpf(k), 0]))
    terms = [(1 / mp.mpf(k), mp.mpf(0)), (a[0], rates[0]), (a[1], rates[1])]

    def square(parts: list[tuple[Any, Any]]) -> Any:
        total = mp.mpf(0)
        for p, r in parts:
            for q, s in parts:
                total += p * q * (half if r + s == 0 else mp.expm1((r + s) * half) / (r + s))
        return mp.re(total) / half

    start = [mp.re(sum(p for p, _ in terms)), mp.re(sum(p * r for p, r in terms))]
    return start, square(terms), square([(p * r, r) for p, r in terms])


@pytest.mark.parametrize("c", [0.0, 0.02, 1.0, 1.999, 2.0, 2.001, 5.0, 80.0, 5000.0])
@pytest.mark.parametrize("omega", [0.05, 1.37, 40.0])
def test_integrals_over_a_leg_are_exact_to_rounding_from_no_damping_to_stiff(c: float, omega: float) -> None:
    T = 2.0 * math.pi / omega
    with mp.workdps(60):
        start, square, speed = square_wave(c, 1.0, T)
    machine = System.from_mapping({
        "name": "wave", "coordinates": ["x"], "mass": [[1.0]], "damping": [["c"]], "stiffness": [[1.0]],
        "phases": [{"start": 0.0, "load": [1.0]}, {"start": 0.5, "load": [-1.0]}], "parameters": {"c": {"default": c}},
    })  # fmt: skip
    values = {p.name: p.default for p in machine.parameters} | {"omega": omega, "c": c}
    hybrid, _ = machine.build_many({name: np.array([value]) for name, value in values.items()})
    states = np.array([[float(component) for component in start]])
    readings, whole = follow_motions(
        hybrid,
        meters_of(hybrid),
        states,
        np.zeros((1, 1), dtype=np.int64),
        np.ones(1, dtype=np.int64),
        np.zeros(1, bool),
    )
    assert whole[0]
    assert readings.square[0, 0] / T == pytest.approx(float(square), rel=2e-12)
    assert readings.square[0, 1] / T == pytest.approx(float(speed), rel=2e-12)
    assert readings.damped[0, 0] == pytest.approx(c * T * float(speed), rel=2e-12)
    assert readings.high[0, 0] == pytest.approx(-readings.low[0, 0], rel=1e-12)


SOFT: dict[str, Any] = {
    "name": "soft", "coordinates": ["x"], "mass": [[1.0]], "damping": [[0.1]], "stiffness": [[1.0]], "force": [2.0],
    "contacts": [{"name": "wall", "gap": [1.0], "upper": 1.0, "lower": -1.0, "stiffness": 10.0}],
    "parameters": {"omega": {"default": 1.4}},
}  # fmt: skip
"""Row 9 of piecewise.md, but for the phase of its force."""


def test_a_cell_of_a_machine_with_modes_tells_contacts_losses_range_and_symmetry() -> None:
    cell = cell_of(SOFT)
    assert cell["regime"] == PERIODIC and cell["symmetric"]
    wanted = RECORDS["row 9"]["measures"]
    assert (cell["wall_upper"], cell["wall_lower"]) == (1, 1)
    assert cell["wall_penetration"] == near(wanted["max_penetration"], 100.0)
    assert cell["wall_force"] == near(wanted["max_force"], 100.0)
    assert cell["wall_fraction"] == near(wanted["contact_fraction"][0], 100.0)
    assert cell["wall_loss"] == pytest.approx(0.0, abs=1e-12)
    assert cell["damper_loss"] == near(wanted["damper_loss"], 100.0)
    assert cell["peak_to_peak"] == near(2.0 * (1.0 + wanted["max_penetration"]), 100.0)


@pytest.mark.parametrize("law", [{"stiffness": 10.0}, {"restitution": 0.6}], ids=["soft", "rigid"])
@pytest.mark.parametrize("late", [1e-12, -1e-12, 1e-10, -1e-10, 1e-9, -1e-9])
def test_a_contact_at_the_section_counts_once_in_a_turn(law: dict[str, float], late: float) -> None:
    """The same orbit with its section at the upper contact, a little more than rounding off it."""
    wall = {"name": "wall", "gap": [1.0], "upper": 1.0, "lower": -1.0, **law}
    rub = {"name": "ground", "row": [1.0], "kinetic": 0.01}
    definition = SOFT | {"contacts": [wall], "friction": [rub]}
    cell = cell_of(definition)
    x, v = cell["state"]  # type: ignore[misc]
    impacts = trace(System.from_mapping(definition), {"x": x, "v": v}, 1).impacts
    hit = impacts[impacts[:, 1] > 0.0][0, 0]
    there = cell_of(definition, tau=1.4 * hit + late)
    for name in ("regime", "period", "wall_upper", "wall_lower", "symmetric"):
        assert there[name] == cell[name], name
    assert (cell["wall_upper"], cell["wall_lower"], cell["symmetric"]) == (1, 1, True)
    for name in ("wall_loss", "wall_fraction", "ground_loss", "damper_loss", "peak_to_peak"):
        assert there[name] == pytest.approx(cell[name], rel=1e-11, abs=1e-12), name


def test_beyond_its_symmetry_breaking_an_orbit_is_not_marked_symmetric() -> None:
    cell = cell_of(SOFT, omega=1.03)
    assert cell["regime"] == PERIODIC and not cell["symmetric"]


SQUARE = {"force": [0.0], "phases": [{"start": 0.0, "load": [2.0]}, {"start": 0.5, "load": [-2.0]}]}

UNEVEN: dict[str, dict[str, Any]] = {
    "phases that are not halves": {"phases": [{"start": 0.0, "load": [2.0]}, {"start": 0.45, "load": [-2.0]}]},
    "a load": {"phases": [{"start": 0.0, "load": [2.0]}, {"start": 0.5, "load": [-1.9]}]},
    "damping of one half": {
        "phases": [{"start": 0.0, "load": [2.0]}, {"start": 0.5, "load": [-2.0], "damping": [[0.11]]}]
    },
    "a stop farther away": {"contacts": [SOFT["contacts"][0] | {"lower": -1.01}]},
    "an even harmonic": {"harmonics": [{"order": 2, "force": [0.01]}]},
    "a belt": {"friction": [{"name": "belt", "row": [1.0], "kinetic": 0.01, "belt": 9.0}]},
}


def test_under_a_square_wave_an_orbit_between_equal_stops_is_symmetric() -> None:
    cell = cell_of(SOFT | SQUARE)
    assert (cell["regime"], cell["period"], cell["symmetric"]) == (PERIODIC, 1, True)


@pytest.mark.parametrize("change", UNEVEN.values(), ids=UNEVEN)
def test_a_machine_that_is_not_its_own_mirror_image_has_no_symmetric_orbit(change: dict[str, Any]) -> None:
    cell = cell_of(SOFT | SQUARE | change)
    assert cell["regime"] == PERIODIC and not cell["symmetric"]


def test_a_machine_with_measures_keeps_the_bits_of_the_one_without() -> None:
    plain = {key: value for key, value in ONE_MASS.items() if key != "measures"}
    params = {"stop": [0.2, 0.5, 3.0], "omega": 1.9}
    settings = Settings(exponents="spectrum", max_periods=2000, survival=0)
    measured, bare = (solve_tile(System.from_mapping(machine), params, settings) for machine in (ONE_MASS, plain))
    for name, values in bare.items():
        np.testing.assert_array_equal(measured[name], values)
    assert set(measured) - set(bare) == {
        f"{name}_{report}" for name, measure in ONE_MASS["measures"].items() for report in measure["report"]
    }


def test_the_means_of_a_rigid_orbit_balance_its_impulses() -> None:
    """Over a turn of one impact: m <x''> T = m (1 + R) v, which the stop takes off, and m <x''> + k <x> = L."""
    cell = cell_of(ONE_MASS, stop=0.5, omega=1.9)
    T = 2.0 * math.pi / 1.9
    assert (cell["regime"], cell["period"], cell["impacts_upper"]) == (PERIODIC, 1, 1)
    assert cell["push_mean"] / 4.0 == pytest.approx(1.7 * cell["max_impact_speed"] / T, rel=1e-12)
    assert cell["place_mean"] == pytest.approx((0.4 - cell["push_mean"] / 2.0) / 5.0, rel=1e-12)
    assert cell["damper_mean"] == pytest.approx(0.0, abs=1e-12)
    assert cell["damper_peak"] >= cell["max_impact_speed"] * (1.0 - 1e-12)


def test_cells_of_no_known_class_have_no_measures() -> None:
    definition = SOFT | {"measures": {"place": {"displacement": [1.0], "report": ["mean", "rms", "peak"]}}}
    cell = cell_of(definition, Settings(max_periods=1, survival=0))
    assert cell["regime"] == UNDETERMINED
    assert all(math.isnan(cell[name]) for name in ("place_mean", "place_rms", "place_peak", "wall_force"))


MEASURES: dict[str, tuple[Any, str]] = {
    "no table": ({"base": 3}, "system.measures.base: found 3, must be a table"),
    "no row": ({"base": {"report": ["rms"]}},
               "system.measures.base: found none, must be one row: displacement, velocity or acceleration"),
    "two rows": ({"base": {"displacement": [1], "velocity": [1], "report": ["rms"]}},
                 "system.measures.base: found displacement and velocity, must be one row: displacement, velocity or"),
    "short row": ({"base": {"velocity": [1, 2], "report": ["rms"]}},
                  "system.measures.base.velocity: found 2 entries, must be 1, one per coordinate"),
    "unknown key": ({"base": {"velocity": [1], "reports": ["rms"]}}, "unknown key in system.measures.base 'reports'"),
    "no report": ({"base": {"velocity": [1]}}, "system.measures.base.report: found None, must be a list of some"),
    "unknown report": ({"base": {"velocity": [1], "report": ["max"]}},
                       "system.measures.base.report: found ['max'], must be a list of some of mean, rms, peak, power"),
    "power without weight": ({"base": {"velocity": [1], "report": ["power"]}},
                             "system.measures.base: weight and the report 'power' go together"),
    "weight without power": ({"base": {"velocity": [1], "weight": 2, "report": ["rms"]}},
                             "system.measures.base: weight and the report 'power' go together"),
    "unknown name": ({"base": {"velocity": ["q"], "report": ["rms"]}}, "system.measures.base.velocity[0]: "),
    "no name": ({"2nd": {"velocity": [1], "report": ["rms"]}}, "system.measures.2nd: found '2nd', must be a name of"),
    "too many": ({f"m{k}": {"velocity": [1], "report": ["rms"]} for k in range(9)},
                 "system.measures: found 9, must be at most 8"),
    "zeros": ({"base": {"velocity": [0], "report": ["rms"]}}, "system.measures.base.velocity: found zeros only"),
    "not finite": ({"base": {"velocity": ["1 / (c - 0.3)"], "report": ["rms"]}},
                   "system.measures.base.velocity: found [inf] at the defaults, must be finite numbers"),
}  # fmt: skip


@pytest.mark.parametrize("given, line", MEASURES.values(), ids=MEASURES)
def test_a_wrong_measure_is_refused_in_one_line_that_names_it(given: Any, line: str) -> None:
    refuse(ONE_MASS | {"measures": given}, line, begins=True)


def test_a_measure_whose_variable_has_another_meaning_is_refused() -> None:
    given = {"wall": {"velocity": [1.0], "report": ["peak"]}}
    taken = SOFT["parameters"] | {"wall_peak": {"default": 1.0}}
    with pytest.raises(DefinitionError, match=r"^system\.measures\.wall: 'wall_peak' has another meaning already"):
        System.from_mapping(SOFT | {"measures": given, "parameters": taken})


def test_two_elements_of_one_name_are_refused_where_their_results_would_be_one() -> None:
    rubs = [{"name": "wall", "row": [1.0], "kinetic": 0.1}]
    with pytest.raises(DefinitionError, match=r"^system\.friction\[0\]\.name: 'wall_loss' has another meaning already"):
        System.from_mapping(SOFT | {"friction": rubs})


def test_measures_are_written_back_as_they_were_read() -> None:
    system = System.from_mapping(ONE_MASS)
    assert System.from_mapping(system.table()) == system
    assert system.table()["measures"]["damper"] == {
        "velocity": [1.0], "weight": "c", "report": ["mean", "rms", "peak", "power"],
    }  # fmt: skip
    assert "measures" not in System.from_mapping(SOFT).table()
