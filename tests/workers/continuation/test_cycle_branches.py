"""Claims about branches of cycles of machines without a force: their period, multipliers and events.

Truth: closed forms, and numbers that a program in 30 digits found: B1, B4 and B6, rows 17 and 18.
"""

import math
from typing import Any

import numpy as np
import pytest

from tests.unforced import machine
from tests.workers.continuation.test_equilibria import chords_of
from workers import Settings, System, solve_tile
from workers.continuation import BranchRun, Family, SolutionPoint, branch, family_of, orbit_from_state, switch_branch

pytestmark = pytest.mark.slow

QUICK = Settings(survival=0, max_periods=2000)


def belt() -> System:
    """x'' + c x' + x + friction = 0 on a belt of speed u, kinetic .4 and static 1."""
    friction = {"name": "belt", "row": [1.0], "kinetic": 0.4, "static": 1.0, "belt": "u"}
    return machine(damping=[["c"]], friction=[friction], parameters={"c": 0.1, "u": 0.5})


def flutter(**stop: Any) -> System:
    """Z(P, .1), two masses with a stiffness that is not symmetric, which flutter between soft stops."""
    stops = {"name": "rub", "gap": [0.0, 1.0], "upper": 0.5, "stiffness": 10.0, "damping": "d"} | stop
    return System.from_mapping({
        "name": "flutter", "coordinates": ["x1", "x2"], "mass": [[3.0, 1.0], [1.0, 1.0]],
        "damping": [[0.2, -0.1], [-0.1, 0.1]], "stiffness": [["2 - P", "P - 1"], [-1.0, 1.0]], "contacts": [stops],
        "parameters": {"P": 1.8, "d": 0.5, "x1": 0.1},
    })  # fmt: skip


def followed(system: System, along: str, window: tuple[float, float], **given: float) -> tuple[BranchRun, Family]:
    """The branch of the cycle that a cell falls into."""
    values = {parameter.name: parameter.default for parameter in system.parameters} | given
    cell = solve_tile(system, values, QUICK)
    turns, T = int(cell["period"]), float(cell["cycle_period"])
    orbit = orbit_from_state(system, values, cell["state"], turns, bool(cell["symmetric"]), T)
    family = family_of(system, values, (along,))
    return branch(family, orbit, values[along], window), family


def period_of(point: SolutionPoint) -> float:
    return float(point.orbit.length) / point.orbit.itinerary.turn


def at(run: BranchRun, value: float) -> SolutionPoint:
    """The point at a value of the parameter that the run was begun at."""
    return min(run.points, key=lambda point: abs(float(point.values[0]) - value))


def test_the_cycle_on_the_belt_ends_by_grazing_sliding_where_row_18_says() -> None:
    run, _ = followed(belt(), "u", (0.3, 1.2), x=1.5)
    assert run.ends == ("edge", "grazing_sliding")
    (event,) = run.events
    slip, stick = 5.52880489921522436, 0.910669990890019
    assert event.point.values[0] == pytest.approx(0.658855574469523615, abs=1e-12)
    assert event.point.orbit.length == pytest.approx(slip + stick, abs=1e-12)
    assert event.point.orbit.times == pytest.approx([0.0, stick], abs=1e-12)
    assert at(run, 0.5).orbit.length == pytest.approx(6.658484576038, abs=1e-12)  # row 17


def test_the_period_of_the_undamped_cycle_on_the_belt_is_the_closed_form_all_along_its_branch() -> None:
    """B1: T = 2 (Fs - Fk) / u + pi + 2 atan(u / (Fs - Fk)); its multipliers are the structural 1 and 0."""
    run, _ = followed(belt(), "u", (0.1, 2.0), c=0.0, u=0.2, x=1.6)
    assert (run.ends, run.events) == (("edge", "edge"), [])
    u = np.array([point.values[0] for point in run.points])
    T = 1.2 / u + math.pi + 2.0 * np.arctan(u / 0.6)
    assert [period_of(point) for point in run.points] == pytest.approx(T, rel=1e-12)
    assert period_of(at(run, 0.2)) == pytest.approx(9.78509376238307763, rel=1e-13)
    assert all(point.multipliers.tolist() == [0.0] and point.unstable == 0 for point in run.points)


def test_the_multiplier_of_a_cycle_that_an_impact_holds_is_its_closed_form_all_along_its_branch() -> None:
    """B4: mu = R^2 e^(c T). It is below 1 while R e^(c pi / 2 w) is, where the cycle goes to infinity."""
    stop = {"name": "stop", "gap": [1.0], "upper": 1.0, "restitution": "R"}
    driven = machine(damping=[[-0.1]], contacts=[stop], parameters={"R": {"default": 0.8, "low": 0.0}, "x": 0.1})
    run, _ = followed(driven, "R", (0.3, 0.84))
    R, T, mu = (np.array(column) for column in zip(
        *((point.values[0], period_of(point), point.multipliers[0].real) for point in run.points), strict=True
    ))  # fmt: skip
    assert (run.ends, run.events) == (("edge", "edge"), [])
    np.testing.assert_allclose(mu, R**2 * np.exp(0.1 * T), rtol=1e-11)
    known = at(run, 0.8)
    assert period_of(known) == pytest.approx(3.66749316841195374, rel=1e-13)
    assert known.multipliers[0] == pytest.approx(0.9235431225053772, rel=1e-12)
    assert np.all(mu < 1.0)


def test_the_symmetric_cycle_of_flutter_has_the_multipliers_of_b6() -> None:
    run, _ = followed(flutter(lower=-0.5), "P", (1.7, 1.9))
    known = at(run, 1.8)
    assert known.orbit.itinerary.symmetric
    assert period_of(known) == pytest.approx(15.1055186924726138, rel=1e-13)
    squares = np.sort_complex(known.multipliers**2)  # those of a point are of half the cycle
    pair = complex(0.00089792497918, 0.00189567119235)
    assert squares == pytest.approx([pair.conjugate(), pair, 0.57873210266101], abs=1e-12)


def test_a_cycle_goes_on_with_other_contacts_and_turns_back_at_folds_where_a_multiplier_is_1() -> None:
    """Wherever it is stable a simulated motion that starts on it is on a cycle of that period."""
    system = flutter(lower=-0.5)
    run, family = followed(system, "P", (1.43, 2.0))
    kinds = [event.kind for event in run.events]
    assert kinds == ["fold", "contact_lost", "fold", "lift_off", "fold", "contact_lost", "fold", "lift_off"]
    for event in run.events:
        if event.kind == "fold":
            assert np.min(np.abs(event.point.multipliers - 1.0)) < 1e-9
    stable = [point for point in run.points if point.unstable == 0 and np.abs(point.multipliers).max() < 0.95][::9]
    assert {len(point.orbit.itinerary.sides) for point in stable} >= {4, 6}
    P = np.array([float(point.values[0]) for point in stable])
    states = np.stack([start_of(family, point) for point in stable])
    begun = dict(zip(system.states, states.T, strict=True))
    cells = solve_tile(system, {"P": P, "d": 0.5} | begun, QUICK)
    np.testing.assert_allclose(cells["cycle_period"], [period_of(point) for point in stable], rtol=1e-10)


@pytest.mark.parametrize(
    ("h", "end", "window"), [(0.5, 1.913340360550307, (1.69, 2.0)), (0.125, 1.842644692192405, (1.838, 1.845))]
)
def test_the_cycle_on_a_belt_with_a_law_in_segments_ends_by_grazing_sliding_where_c4_says(
    h: float, end: float, window: tuple[float, float]
) -> None:
    """Friction .5 + .5 e^(-2 v) in chords at multiples of h: its end tends to 1.836600972208 as h^2. The unstable cycle
    that slips only takes over there."""
    u = 0.75 * window[0] + 0.25 * window[1]
    system = machine(damping=[[0.1]], friction=[chords_of(h)], parameters={"u": u, "x": 0.9, "v": u})
    run, _ = followed(system, "u", window)
    (event,) = (event for event in run.events if event.kind == "grazing_sliding")
    assert event.point.values[0] == pytest.approx(end, abs=1e-9)
    assert abs(end - 1.836600972208) < 0.4 * h**2
    assert {event.kind for event in run.events} <= {"grazing_sliding", "vertex"}
    before, after = (run.points[k].unstable for k in (1, -1))
    assert {before, after} == {0, 1}


def start_of(family: Family, point: SolutionPoint) -> np.ndarray:
    """The state of a point just before its first event."""
    from workers.continuation.equations import motion_of
    from workers.continuation.itinerary import many_orbits

    found: np.ndarray = motion_of(family.model(point.values[None]), many_orbits([point.orbit])).start[0]
    return found


def test_a_cycle_doubles_and_beyond_the_doubling_cells_fall_into_the_branch_that_leaves() -> None:
    """Two masses, the first driven by negative damping against a rigid stop: a cycle of three impacts doubles."""
    stop = {"name": "stop", "gap": [1.0, 0.0], "upper": 1.0, "restitution": "R"}
    system = System.from_mapping({
        "name": "driven", "coordinates": ["x1", "x2"], "mass": [[1.0, 0.0], [0.0, 1.0019]],
        "damping": [[-0.0709, 0.0], [0.0, 0.0609]], "stiffness": [[2.3229, -1.3229], [-1.3229, 1.3229]],
        "contacts": [stop], "parameters": {"R": {"default": 0.5, "low": 0.0, "high": 1.0}, "x1": 0.1},
    })  # fmt: skip
    run, family = followed(system, "R", (0.4, 0.52))
    (doubling,) = (event for event in run.events if event.kind == "period_doubling")
    assert np.abs(doubling.point.multipliers + 1.0).min() < 1e-7
    start = switch_branch(family, doubling, 0.12, amplitude=0.01)
    doubled = branch(family, start.orbit, start.value, (0.4, 0.52))
    assert doubled.ends == ("edge", "period_doubling")
    assert doubled.events[0].point.values[0] == pytest.approx(doubling.point.values[0], abs=1e-9)
    edge, cell = at(doubled, 0.4), solve_tile(system, {"R": 0.4}, QUICK)
    assert (edge.values[0], edge.unstable, cell["impacts_upper"]) == (0.4, 0, 6)
    assert cell["cycle_period"] == pytest.approx(period_of(edge), rel=1e-11)
    assert cell["cycle_period"] == pytest.approx(2.0 * period_of(doubling.point), rel=0.01)
