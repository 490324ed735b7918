"""Branches of machines with modes: the exact parameters of tests/data/piecewise.json, and how orbits end and go on."""

import json
import math

import numpy as np
import pytest

import atlas
from tests.oscillators import cosine_mass
from tests.paths import DATA
from workers.continuation import BranchRun, Family, Itinerary, Orbit, branch, family_of, orbit_from_state
from workers.continuation.extended_system import ExtendedSystem
from workers.continuation.orbit_equality import begun_with, distance
from workers.continuation.pseudo_arclength import PseudoArclength
from workers.model.system import System

RECORDS = {
    record["name"]: record
    for record in json.loads((DATA / "piecewise.json").read_text())
}  # fmt: skip


def soft(release: str = "displacement") -> System:
    """S of piecewise.md."""
    contact = {"name": "stop", "gap": [1.0], "upper": 1.0, "stiffness": "k", "damping": "c", "preload": "p"}
    return cosine_mass(
        damping=[["d"]], force=["0.8 * omega**2 / 1.26"], contacts=[contact | {"release": release}],
        parameters={name: {"default": value, "low": 0.0}
                    for name, value in {"d": 0.02, "k": 29.0, "c": 0.0, "p": 0.0}.items()},
    )  # fmt: skip


def rubbing() -> System:
    """F of piecewise.md."""
    friction = [{"name": "ground", "row": [1.0], "kinetic": 1.0, "static": "s"}]
    return cosine_mass(friction=friction, parameters={"s": {"default": 1.2, "low": 1.0}})


TWO_STOPS = cosine_mass(contacts=[{"name": "stop", "gap": [1.0], "upper": 1.0, "lower": -1.0, "stiffness": 10.0}])


def run(system: System, name: str, window: tuple[float, float], certified: bool = True, **given: float) -> BranchRun:
    """The branch in omega through the orbit of a record."""
    values = {p.name: given.get(p.name, p.default) for p in system.parameters}
    orbit = orbit_from_state(system, values, np.array(RECORDS[name]["state"]), RECORDS[name]["periods"])
    family = family_of(system, values, ("omega",))._replace(certified=certified)
    return branch(family, orbit, values["omega"], window)


def places(found: BranchRun, kind: str) -> list[float]:
    return [float(event.point.values[0]) for event in found.events if event.kind == kind]


def test_a_soft_contact_doubles_where_the_oracle_has_it() -> None:
    found = run(soft(), "row 2", (0.9, 0.96), omega=0.95)
    assert places(found, "period_doubling") == pytest.approx([RECORDS["row 2, PD"]["bifurcation"]["value"]], abs=1e-12)
    point = next(event.point for event in found.events)
    assert point.multipliers[:2].real == pytest.approx([-1.0, -0.871772808002], abs=1e-10)


@pytest.mark.slow
def test_beyond_its_graze_only_the_equations_of_an_orbit_double_where_the_oracle_has_it() -> None:
    """There it is not admissible: the branch goes on with two contacts, to the doubling of the orbit of one period."""
    record = RECORDS["row 3, PD"]
    found = run(soft(), "row 3", (0.84, 0.93), certified=False, omega=0.86)
    assert not record["admissible"]
    assert places(found, "period_doubling") == pytest.approx([record["bifurcation"]["value"]], abs=1e-12)
    certain = run(soft(), "row 3", (0.84, 0.93), omega=0.86)
    assert [event.kind for event in certain.events] == ["graze", "period_doubling"]
    exact = RECORDS["row 2, PD"]["bifurcation"]["value"]
    assert places(certain, "period_doubling") == pytest.approx([exact], abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("release", "c"), [("displacement", 0.0), ("displacement", 0.5), ("force", 0.5)])
def test_a_contact_is_lost_where_the_linear_answer_grazes(release: str, c: float) -> None:
    """Whatever the contact does: with damping released by force the branch has a corner there. It goes on without."""
    found = run(soft(release), "row 5" if release == "force" else "row 2", (0.75, 0.96), omega=0.95, c=c)
    assert places(found, "contact_lost") == pytest.approx(
        [RECORDS["row 1, omega 0.782"]["machine"]["omega"]], abs=1e-12
    )
    assert found.ends[0] == "edge"
    assert found.points[0].orbit.itinerary.impacts(1) == 0


@pytest.mark.slow
def test_symmetric_orbits_break_their_symmetry_and_fold_where_the_oracle_has_it() -> None:
    found = run(TWO_STOPS, "row 9", (0.9, 3.5), omega=1.4)
    exact = [RECORDS[name]["bifurcation"]["value"] for name in ("row 10, SB", "row 10, fold")]
    assert places(found, "symmetry_breaking") == pytest.approx(exact[:1], abs=1e-12)
    assert places(found, "fold")[0] == pytest.approx(exact[1], abs=1e-12)
    assert found.ends == ("edge", "edge")
    assert found.events[-1].kind == "contact_lost"


def test_sliding_becomes_sticking_at_its_onset() -> None:
    found = run(rubbing(), "row 12", (0.5, 0.95), omega=0.9)
    assert places(found, "stick_onset") == pytest.approx([RECORDS["row 14"]["bifurcation"]["value"]], abs=1e-12)
    assert found.ends == ("edge", "edge")
    assert [len(point.orbit.times) for point in (found.points[0], found.points[-1])] == [2, 1]


def test_stick_begins_and_ends_at_one_frequency_where_static_is_kinetic() -> None:
    """The orbit that slides and the one that sticks are one there."""
    sliding, sticking = (run(rubbing(), name, (0.35, 0.95), omega=omega, s=1.0)
                         for name, omega in (("row 12", 0.9), ("row 16", 0.4)))  # fmt: skip
    assert places(sliding, "stick_onset") == pytest.approx(places(sticking, "stick_end"), abs=1e-12)


def test_multipliers_of_orbits_that_stick_are_zero_exactly() -> None:
    found = run(rubbing(), "row 16", (0.38, 0.42), omega=0.4, s=1.0)
    assert all(point.multipliers[-1] == 0.0 for point in found.points)
    assert all(point.unstable == 0 for point in found.points)


@pytest.mark.slow
def test_a_branch_goes_on_where_contacts_are_lost_and_another_where_it_doubles() -> None:
    """Between its two doublings an orbit of one contact a period is doubled, and loses every second contact."""
    found = atlas.branch(
        {"omega": 0.95, "tau": 0.5 * math.pi}, along="omega", window=(0.7, 1.2), switch_branches=True, system=soft()
    )
    table, points = found.branches, found.points
    assert sorted(zip(table.period, table.impacts_upper, strict=True)) == [(1, 1), (2, 2)]
    kinds = {number: set(zip(of.period, of.impacts_upper, strict=True)) for number, of in points.groupby("branch")}
    assert sorted(map(sorted, kinds.values())) == [[(1, 0), (1, 1)], [(2, 1), (2, 2)]]
    assert set(table.first_end) | set(table.last_end) == {"edge", "period_doubling"}
    assert not found.untried


@pytest.mark.slow
def test_a_stick_that_begins_at_no_rate_ends_its_branch_without_events_that_are_none() -> None:
    """The equations are singular there, and no multiplier is 1 or -1: it goes on as before up to the end."""
    found = atlas.branch({"omega": 1.0}, along="omega", window=(0.3, 3.0), system="stick-slip").traced[0].run
    assert found.ends == ("grazing_sliding", "grazing_sliding")
    assert {event.kind for event in found.events} == {"grazing_sliding", "fold"}
    for event in found.events:
        near = 1.0 if event.kind == "fold" else event.point.multipliers[0]
        assert event.point.multipliers[0] == pytest.approx(near, abs=1e-8)
        assert event.point.multipliers[1] == 0.0
    last = [point.multipliers[0].real for point in found.points[-3:]]
    assert last[2] == pytest.approx(2.0 * last[1] - last[0], abs=0.02)


@pytest.mark.slow
def test_a_cell_that_sticks_is_followed() -> None:
    found = atlas.branch({"omega": 0.4}, along="omega", window=(0.35, 0.45), system="friction-oscillator")
    assert found.branches.symmetric.tolist() == [True]
    assert (found.points.unstable == 0).all()


def test_an_orbit_of_two_periods_loses_its_only_impact_where_the_linear_answer_grazes() -> None:
    """That answer has one period, and touches twice in two."""
    found = atlas.branch({"omega": 2.4, "b2": 0.0}, along="b2", window=(0.0, 0.1), system="two-stops")
    assert (found.branches.period[0], found.branches.last_end[0]) == (2, "impact_lost")
    w, zeta = 2.4, 0.05
    K = np.array([[2.0, -1.0], [-1.0, 1.0]])
    answer = np.linalg.solve((1.0 + 2j * zeta * w) * K - w**2 * np.eye(2), [0.5, 0.5])
    assert found.events.b2.iloc[-1] == pytest.approx(abs(answer[1]), abs=1e-12)


def pushed_by_damping() -> tuple[Family, Orbit]:
    """x'' - .2 x' + f(x') + x = .1 cos omega t, f from 0 at speed 1 to .8 at 2, and its orbit at omega = .994272244."""
    law = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.8]]
    system = cosine_mass(damping=[[-0.2]], friction=[{"name": "ground", "row": [1.0], "law": law}])
    values = {"A": 0.1, "omega": 0.994272244}
    state = np.asarray(atlas.point(values, system=system)["state"])
    orbit = orbit_from_state(system, values, state, 1, symmetric=True)
    return family_of(system, {"A": 0.1}, ("omega",)), orbit


def test_a_branch_whose_events_come_back_periods_later_is_closed() -> None:
    family, orbit = pushed_by_damping()
    found = branch(family, orbit, 0.994272244, (0.3, 2.5), resolution=0.1, budget=200)
    assert found.ends == ("closed", "closed")
    assert sorted(places(found, "fold")) == pytest.approx([0.962938714011, 1.02700475495], abs=1e-11)
    first, last = found.points[0], found.points[-1]
    shift, period = last.orbit.times - first.orbit.times, 2.0 * math.pi / 0.994272244
    assert shift == pytest.approx([round(shift[0] / period) * period] * 3, abs=1e-9)
    assert round(shift[0] / period) != 0
    # a closed walk visits no place twice
    assert sum(abs(point.values[0] - 0.994272244) < 1e-9 for point in found.points) == 2


@pytest.mark.parametrize("first", [0, 1, 4])
def test_a_walk_closes_at_its_start_as_told_from_any_event(first: int) -> None:
    """As a start that has been recorded beyond changes of contacts; events from the third on are of the other half."""
    family, orbit = pushed_by_damping()
    value, width = np.array([0.994272244]), np.array([2.2])
    equations = ExtendedSystem(family, orbit, (), value, width)
    walk = PseudoArclength(equations, equations.pack(orbit, np.zeros(0), value), 0.2, np.eye(6)[5])
    (sides, periods, _, legs), whole = orbit.itinerary, orbit.itinerary.twice
    turned = Itinerary(
        tuple((2 * whole.sides)[first : first + len(sides)]), periods, True,
        tuple((2 * whole.legs)[first : first + len(legs)]),
    )  # fmt: skip
    other = begun_with(orbit, first, turned, orbit.span(equations.model(value)))
    told = ExtendedSystem(family, other, (), value, width)
    walk.start = told, told.pack(other, np.zeros(0), value)
    steps, closed = 0, None
    while closed is None and steps < 100:
        assert walk.advance()
        closed, steps = (walk.closes() if steps else None), steps + 1
    assert closed is not None
    assert equations.values(closed) == pytest.approx(value, abs=1e-12)
    assert distance(equations.orbit(closed), orbit, 0.994272244) < 1e-9
    assert 10 < steps < 60


@pytest.mark.slow
def test_two_events_that_exchange_their_order_end_no_sticking() -> None:
    """A belt under a mass with a soft stop: at u = .3817 the stop opens as the sliding speed passes a vertex.

    The force that holds the mass is .257 of .9 there; the cycle goes on, as simulated motion has it.
    """
    law = [[0.0, 0.5], [0.3, 0.25], [0.8, 0.2], [2.0, 0.5]]
    stop = {"name": "stop", "gap": [1.0], "upper": 0.7, "stiffness": 6.0, "damping": 0.2, "release": "force"}
    system = System.from_mapping({
        "name": "belt", "coordinates": ["x"], "mass": [[1.0]], "damping": [[0.03]], "stiffness": [[1.0]],
        "friction": [{"name": "belt", "row": [1.0], "law": law, "static": 0.9, "belt": "u"}], "contacts": [stop],
        "parameters": {"u": {"default": 0.376}},
    })  # fmt: skip
    found = atlas.branch({"x": 0.3}, along="u", window=(0.376, 0.386), system=system)
    assert found.branches.last_end.tolist() == ["edge"]
    (event,) = found.events.to_dict("records")
    assert (event["kind"], event["u"]) == ("exchange", pytest.approx(0.381704884, abs=1e-9))
    before, after = (
        atlas.point({"x": 0.3, "u": event["u"] + off}, system=system)["cycle_period"] for off in (-1e-5, 1e-5)
    )
    along = found.points[["u", "cycle_period"]].to_numpy()
    assert before > event["cycle_period"] > after
    for off, period in ((-1e-5, before), (1e-5, after)):
        near = np.interp(event["u"] + off, along[:, 0], along[:, 1])
        assert near == pytest.approx(period, abs=1e-6)
