"""Orbits that impact, come to rest or leave a stop at the section t = k T, exactly and but for rounding.

Truth: the same orbit, seen from a section where nothing happens: with tau + omega t the section is t later. Of the ball
a closed form too.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import pytest

from atlas.orbits.branches.seed import seed_of_point
from workers import Settings
from workers.attractors.coexistence import solve_attractors
from workers.attractors.initial_states import AttractorSettings
from workers.continuation import section_state
from workers.kernel.coordinates import blocks_to_physical, motion_from
from workers.kernel.motion import FLIGHT, RECORDED, Motion
from workers.kernel.period import propagate
from workers.model.hybrid_modes import ON
from workers.model.oscillator import Oscillator
from workers.model.system import System, find_system
from workers.results import PERIODIC
from workers.tile import solve_tile

pytestmark = pytest.mark.slow

SPECTRUM = Settings(exponents="spectrum", max_periods=4000, survival=2000, tolerance=0.1)

BEFORE_AND_AFTER = (0.0, 1e-9, -1e-9, 1e-10, -1e-10, 1e-12, -1e-12, 1e-14, -1e-14)
"""Times of the section after what happens, in periods."""

BALL = {"A": 0.7, "R": 0.8, "tau": math.acos(math.pi / 9.0 / 0.7), "v": math.pi - math.pi / 9.0}
"""Hits the table at t = k T, where (1 + R) |v| = 2 pi and the table moves at A cos tau = (1 - R) |v| / 2."""

STICKING = {"nu": 0.3154823432570447, "R": 0.13639192455018725}
"""A free mass that leaves a wall at the phases 0 and pi, where the acceleration of the box changes its sign."""

PAIR = {"nu": 2.2738, "R": 0.3591, "beta": 0.1}
"""A symmetric orbit with an impact a side."""


class Seen(NamedTuple):
    """An orbit as its cell was solved, with its machine."""

    system: System
    values: dict[str, float]
    osc: Oscillator
    cell: dict[str, Any]

    def at(self, t: float, record: int = 0) -> Motion:
        """The motion at time t >= 0 after the section, with the impacts of the period that it is in."""
        motion = motion_from(self.osc, self.cell["state"], record=record)
        whole = int(t // self.osc.period)
        for _ in range(whole):
            propagate(self.osc, motion, self.osc.period)
        motion.tally[RECORDED] = 0.0
        propagate(self.osc, motion, t - whole * self.osc.period)
        return motion

    def begun_at(self, t: float, faster: float) -> dict[str, float]:
        """The parameters of the same machine seen from time t, its motion there by so much faster than on the orbit."""
        phase = 2.0 * math.pi * t / self.osc.period
        state = blocks_to_physical(self.osc._replace(tau=self.osc.tau + phase), self.at(t))
        state[len(state) // 2 :] *= 1.0 + faster
        start = {name: float(x) for name, x in zip(self.system.states, state, strict=True)}
        return self.values | start | {"tau": self.values["tau"] + math.remainder(phase, 2.0 * math.pi)}


def seen(name: str, given: dict[str, float]) -> Seen:
    system = find_system(name)
    values = {p.name: float(given.get(p.name, p.default)) for p in system.parameters}
    arrays = solve_tile(system, values, SPECTRUM)
    return Seen(system, values, system.build(values), {key: array[()] for key, array in arrays.items()})


def impacts_in_a_turn(orbit: Seen) -> list[float]:
    period = orbit.osc.period
    found = []
    for k in range(int(orbit.cell["period"])):
        motion = orbit.at((k + 1.0 - 1e-9) * period, record=64)
        found += [k * period + t for t in motion.impacts[: int(motion.tally[RECORDED]), 0]]
    return found


def change_of_rest(orbit: Seen, comes: bool) -> float:
    """When the mass comes to rest, or leaves, by bisection between 400 times of a period."""

    def held(t: float) -> bool:
        return abs(int(orbit.at(t).mode[0]) - FLIGHT) == ON

    times = orbit.osc.period * np.linspace(0.0, 1.0, 401)[1:-1]
    at = [held(t) for t in times]
    place = next(k for k in range(len(at) - 1) if at[k + 1] == comes and at[k] != comes)
    low, high = times[place], times[place + 1]
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if held(middle) == comes else (middle, high)
    return float(high)


def wrong(orbit: Seen, event: float) -> list[str]:
    """What is not as it should be of the orbit, seen from sections at what happens and beside it."""
    turn = orbit.osc.period * int(orbit.cell["period"])
    begun = [
        orbit.begun_at((event + away * orbit.osc.period) % turn, faster)
        for away in BEFORE_AND_AFTER
        for faster in (0.0, 1e-3)
    ]
    given = {name: np.array([one[name] for one in begun]) for name in orbit.values}
    found = solve_tile(orbit.system, given, SPECTRUM)
    faults = []
    for name in ("regime", "period", "impacts_upper", "impacts_lower", "symmetric", "sticks"):
        faults += [f"{name} {value} for {orbit.cell[name]}" for value in found[name] if value != orbit.cell[name]]
    for spectrum in found["spectrum"]:
        if not np.allclose(spectrum, orbit.cell["spectrum"], rtol=1e-7, atol=1e-7):
            faults.append(f"spectrum {spectrum} for {orbit.cell['spectrum']}")
    return faults


MACHINES: dict[str, tuple[str, dict[str, float]]] = {
    "ball": ("bouncing-ball", BALL | {"tau": BALL["tau"] + 0.5}),
    "symmetric pair": ("impact-pair", PAIR),
    "period 2 of three masses": ("chain-3", {"omega": 1.7942, "b": 0.3661, "s": 0.0, "R": 0.5095, "tau": 0.3}),
    "one mass": ("single-mass", {"omega": 0.8, "A": 0.7, "R": 0.6, "zeta": 0.05, "tau": 0.4}),
    "two masses": ("two-mass", {"omega": 4.0, "b": 0.1, "tau": 1.0}),
}


@pytest.mark.parametrize("name", MACHINES)
def test_an_orbit_that_impacts_at_the_section_is_what_it_is_seen_from_elsewhere(name: str) -> None:
    orbit = seen(*MACHINES[name])
    assert orbit.cell["regime"] == PERIODIC
    events = impacts_in_a_turn(orbit)
    assert len(events) == orbit.cell["impacts_upper"] + orbit.cell["impacts_lower"]
    assert wrong(orbit, events[0]) == []


@pytest.mark.parametrize("comes", [True, False], ids=["rest", "release"])
@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("impact-pair", STICKING | {"tau": 0.5}),
        ("bouncing-ball", {"A": 1.3572513109603541, "R": 0.6484335875845557, "tau": 2.0}),
        ("single-mass", {"omega": 0.4, "A": 1.5, "R": 0.3, "zeta": 0.05, "tau": 0.4}),
    ],
    ids=["pair", "ball", "one mass"],
)
def test_an_orbit_that_comes_to_rest_or_leaves_at_the_section_is_what_it_is_elsewhere(
    name: str, given: dict[str, float], comes: bool
) -> None:
    orbit = seen(name, given)
    assert orbit.cell["sticks"]
    assert wrong(orbit, change_of_rest(orbit, comes)) == []


@pytest.mark.parametrize("tau", [0.0, math.pi])
def test_a_mass_that_leaves_its_wall_at_the_section_is_periodic_and_sticks(tau: float) -> None:
    cell = solve_tile("impact-pair", STICKING | {"tau": tau}, SPECTRUM)
    assert (cell["regime"], cell["period"], cell["sticks"], cell["symmetric"]) == (PERIODIC, 1, True, True)
    assert np.isneginf(cell["spectrum"]).all()


@pytest.mark.parametrize(
    ("name", "given", "counts"),
    [
        ("chain-3", MACHINES["period 2 of three masses"][1] | {"tau": 1.952494741686909}, (2, 1, 0)),
        ("impact-pair", PAIR | {"tau": 2.294862545447291}, (1, 1, 1)),
    ],
    ids=["period 2 of three masses", "symmetric pair"],
)
def test_orbits_found_by_random_search_to_impact_at_the_section_have_their_own_counts(
    name: str, given: dict[str, float], counts: tuple[int, int, int]
) -> None:
    cell = solve_tile(name, given, SPECTRUM)
    assert (cell["period"], cell["impacts_upper"], cell["impacts_lower"]) == counts
    assert cell["symmetric"] == (name == "impact-pair")


@pytest.mark.parametrize("away", [0.0, 1e-13, -1e-13])
def test_an_impact_at_the_section_counts_as_past(away: float) -> None:
    """Truth: the closed form; after the impact the ball goes up at R |v|, 2 pi = (1 + R) |v|."""
    cell = solve_tile("bouncing-ball", BALL | {"tau": BALL["tau"] + 2.0 * math.pi * away}, SPECTRUM)
    assert (cell["regime"], cell["period"], cell["impacts_lower"]) == (PERIODIC, 1, 1)
    assert cell["spectrum"] == pytest.approx(math.log(0.8), abs=1e-12)
    assert cell["state"] == pytest.approx([0.0, 0.8 * 2.0 * math.pi / 1.8], abs=3e-11)


@pytest.mark.parametrize("away", BEFORE_AND_AFTER)
def test_a_branch_starts_from_an_orbit_that_impacts_at_the_section(away: float) -> None:
    """Truth: the closed form, one impact at v = -2 pi / (1 + R), at the section."""
    seed = seed_of_point(BALL | {"tau": BALL["tau"] + 2.0 * math.pi * away}, "bouncing-ball")
    assert seed.orbit.itinerary.sides == (-1,)
    assert seed.orbit.speeds == pytest.approx([-2.0 * math.pi / 1.8], abs=1e-12)
    assert math.remainder(seed.orbit.times[0], 2.0 * math.pi) == pytest.approx(-2.0 * math.pi * away, abs=1e-12)


def test_a_branch_has_the_section_state_of_its_cell_where_an_impact_is_at_the_section() -> None:
    seed = seed_of_point(BALL, "bouncing-ball")
    expected = [0.0, 0.8 * 2.0 * math.pi / 1.8]
    assert section_state(seed.system, seed.values, seed.orbit) == pytest.approx(expected, abs=1e-10)
    early, late = (seed.orbit._replace(times=np.array([t])) for t in (-1e-14, 1e-14))
    for orbit in (early, late):
        assert section_state(seed.system, seed.values, orbit) == pytest.approx(expected, abs=1e-10)


def test_a_symmetric_orbit_that_impacts_at_the_section_starts_a_branch_as_one() -> None:
    seed = seed_of_point(PAIR | {"tau": 2.294862545447291}, "impact-pair")
    assert seed.orbit.itinerary.symmetric and len(seed.orbit.itinerary.sides) == 1


def test_motions_that_reach_an_orbit_on_either_side_of_its_impact_reach_one_attractor() -> None:
    """Truth: the attractors of the same ball and the same initial states, seen from half a radian later."""
    starts, settings = AttractorSettings(16), Settings(exponents="largest", max_periods=2000, survival=1000)
    found = [
        solve_attractors("bouncing-ball", BALL | {"tau": BALL["tau"] + late}, settings, starts)
        for late in (0.0, 1e-14, 0.5)
    ]
    assert [int(cell["attractors"]) for cell in found] == [2, 2, 2]
    assert all(cell["regime"][:2].tolist() == [PERIODIC, PERIODIC] for cell in found)
    assert all(cell["sticks"][:2].tolist() == [True, False] for cell in found)


@pytest.mark.parametrize("name", MACHINES)
def test_orbits_of_random_machines_are_what_they_are_from_whatever_section(name: str) -> None:
    rng = np.random.default_rng(len(name))
    system, given = MACHINES[name]
    checked = 0
    for _ in range(30):
        values = {key: value * rng.uniform(0.8, 1.25) for key, value in given.items()}
        orbit = seen(system, values)
        if orbit.cell["regime"] != PERIODIC or orbit.cell["sticks"]:
            continue
        for event in impacts_in_a_turn(orbit)[:4]:
            assert wrong(orbit, event) == []
            checked += 1
    assert checked >= 15
