"""Orbits of machines with modes as equations of state and times: the oracle's orbits, derivatives, what is refused."""

import functools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.solver_bridge import machines_of
from tests.workers.kernel.test_hybrid_orbits import RECORDS, TOUCHES, machine_in
from workers import Settings
from workers.continuation.admissibility import first_fault
from workers.continuation.equations import motion_of, motion_of_unknowns
from workers.continuation.families import Family, family_of
from workers.continuation.floquet import multipliers
from workers.continuation.itinerary import Orbit, many_orbits
from workers.continuation.orbit_from_motion import record_orbit
from workers.continuation.orbits import orbit_from_state, refine_orbit
from workers.continuation.shooting import OrbitMotion
from workers.model.family import with_modes
from workers.model.hybrid_modes import code_of
from workers.model.machines import Machines
from workers.model.system import find_system
from workers.results import NO_IMPACT, PERIODIC
from workers.tile import solve_tile

SINGULAR = ("row 1, omega 0.782", "row 10, fold")
"""A graze that rounding makes a contact, or none, and a fold: there Newton's method alone finds no orbit."""

FORCED = [
    name
    for name, record in RECORDS.items()
    if record["periods"] and record["drift"] is None and name not in SINGULAR
]  # fmt: skip

each_forced = pytest.mark.parametrize("name", FORCED)


def always(machines: Machines) -> Family:
    """One machine, whatever is asked for."""
    return Family((), lambda rows: with_modes(machines).at_rows(np.zeros(len(rows), dtype=np.int64)))


@functools.cache
def solved(name: str) -> OrbitMotion:
    """The orbit of a record by the equations, from times that are all a little late."""
    record = RECORDS[name]
    machines = machines_of([machine_in(record)])
    orbit = record_orbit(with_modes(machines), np.array(record["state"]), record["periods"])
    found = refine_orbit(always(machines), orbit._replace(times=orbit.times + 1e-4), np.zeros(0))
    motion = motion_of(with_modes(machines), many_orbits([found]))
    return motion


def whole_times(motion: OrbitMotion) -> np.ndarray:
    """Times of all events within the turn before, this one and the next."""
    span = float(motion.span[0])
    return np.concatenate([motion.times[0] + k * span for k in (-2, -1, 0, 1, 2)])


@each_forced
def test_the_equations_have_the_times_of_the_oracle_to_rounding(name: str) -> None:
    """Truth: Newton's method in 28 digits. A rest is where a chatter is certain to end, not where the oracle has it."""
    times, events = whole_times(solved(name)), RECORDS[name]["events"]
    error = 1e-10 if any(kind == "rest" for _, kind, _, _ in events) else 1e-13
    for t, kind, _, _ in events:
        if kind != "rest":
            assert np.min(np.abs(times - t)) < error if len(times) else name in TOUCHES, (t, kind)


@each_forced
def test_the_schur_complement_has_the_multipliers_of_the_oracle(name: str) -> None:
    motion, record = solved(name), RECORDS[name]
    found = multipliers(motion)[0] ** (2 if motion.itinerary.symmetric else 1)
    for pair in record["multipliers"]:
        assert np.min(np.abs(found - complex(*pair))) < 2e-13
    lost = sum(pair == [0.0, 0.0] for pair in record["multipliers"])
    assert np.sum(found == 0.0) == lost


@each_forced
def test_an_orbit_of_the_oracle_is_admissible(name: str) -> None:
    assert first_fault(solved(name)) is None


@each_forced
def test_symmetric_orbits_are_recognised(name: str) -> None:
    """A machine that is its own mirror image has no other orbit among the records."""
    motion, record = solved(name), RECORDS[name]
    assert motion.itinerary.symmetric == bool(record["symmetric"])


@pytest.mark.parametrize("name", ["row 5", "row 11", "row 22", "row 25", "row 27, omega 1", "row 30"])
def test_tangents_are_the_derivatives_of_the_residuals(name: str) -> None:
    """Off the orbit too. Truth: central differences."""
    motion = solved(name)
    X = motion.unknowns[0] * (1.0 + 1e-3 * np.cos(np.arange(motion.unknowns.shape[1])))
    steps = 1e-6 * np.eye(len(X))
    rows = np.concatenate([X[None], X + steps, X - steps])
    lin = motion.lin.at_rows(np.zeros(len(rows), dtype=np.int64))
    moved = motion_of_unknowns(lin, motion.itinerary, rows)
    ahead, behind = np.split(moved.turn.residuals[1:], 2)
    found = moved.linearised()[0]
    size = max(1.0, float(np.abs(found).max()))
    assert pytest.approx(found, abs=2e-8 * size) == ((ahead - behind) / 2e-6).T


@pytest.mark.parametrize("name", ["row 5", "row 9", "row 22", "row 24"])
@pytest.mark.parametrize("z", [1.0, -1.0, 0.3 + 0.7j])
def test_the_determinant_is_that_of_the_map_times_the_rates(name: str, z: complex) -> None:
    """det J_z = det(DP - z I) prod r'_i."""
    motion = solved(name)
    DP, J = motion.turn.maps[0], motion.linearised(z)[0]
    expected = np.linalg.det(DP - z * np.eye(len(DP))) * np.prod(motion.turn.signals[0, 1])
    assert np.linalg.det(J) == pytest.approx(expected, rel=1e-10)


def test_states_between_events_are_those_of_the_motion() -> None:
    """Truth: the oracle's state at the section of an orbit that sticks and impacts."""
    motion, record = solved("row 22"), RECORDS["row 22"]
    period = float(motion.span[0])
    states, _ = motion.states_at(np.array([[0.0, period, -3.0 * period]]))
    assert states[0] == pytest.approx(np.tile(record["state"], (3, 1)), abs=1e-13)


def without(name: str, count: int, **change: Any) -> Orbit:
    """An orbit with all its events ``count`` places later, and other fields."""
    orbit = solved(name).orbits.at_rows(0)
    return orbit._replace(times=np.roll(orbit.times, count), **change)


def test_events_out_of_order_are_no_orbit() -> None:
    motion = motion_of(solved("row 4").lin, many_orbits([without("row 4", 1)]))
    fault = first_fault(motion)
    assert fault is not None


def test_an_orbit_through_a_stop_is_no_orbit() -> None:
    """The linear answer above its graze, followed as if there were no contact."""
    record = RECORDS["row 1, omega 0.782"]
    machines = machines_of([replace(machine_in(record), omega=0.7825)])
    still = record_orbit(with_modes(machines_of([replace(machine_in(record), omega=0.5)])), np.array([0.1, 0.0]), 1)
    assert not still.itinerary.sides
    orbit = refine_orbit(always(machines), still, np.zeros(0))
    motion = motion_of(with_modes(machines), many_orbits([orbit]))
    fault = first_fault(motion)
    assert fault is not None
    assert (fault.signal, fault.side) == (0, 1)


def test_an_itinerary_repeated_is_that_of_two_turns() -> None:
    itinerary = solved("row 15").itinerary
    assert itinerary.symmetric
    whole = itinerary.twice
    assert whole.repeats(len(itinerary.sides), -1)
    assert not whole.repeats(len(itinerary.sides), 1)
    assert whole.periods == itinerary.periods


def test_a_mode_and_its_mirror_image_are_each_others() -> None:
    legs = [leg for chain in solved("row 9").itinerary.legs for leg in chain]
    assert [leg.mirrored.mirrored for leg in legs] == legs
    assert any(leg.code != leg.mirrored.code for leg in legs)
    assert code_of(legs[1].code.number, 1, 0) == legs[1].code


def test_the_state_at_a_section_is_on_the_orbit_whatever_its_first_event() -> None:
    motion = solved("row 3")
    states, _ = motion.states_at(2.0 * math.pi / motion.lin.omega[:, None] * np.arange(2.0))
    assert states[0, 0] == pytest.approx(RECORDS["row 3"]["state"], abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["gear-mesh", "soft-suspension", "two-stops", "stick-slip", "soft-impact", "friction-oscillator"]
)
def test_orbits_of_cells_are_admissible_and_have_the_exponents_of_the_cells(name: str) -> None:
    """Truth: the kernel's own Floquet exponents, of frames carried through the motion."""
    system, rng, found = find_system(name), np.random.default_rng(1), 0
    values = {p.name: np.full(12, p.default) for p in system.parameters}
    values |= {axis: rng.uniform(low, high, 12) for axis, low, high in system.axes}
    cells = solve_tile(system, values, Settings(exponents="spectrum", survival=0))
    for k in np.flatnonzero(np.isin(cells["regime"], (PERIODIC, NO_IMPACT))):
        given = {name: float(column[k]) for name, column in values.items()}
        orbit = orbit_from_state(system, given, cells["state"][k], max(1, int(cells["period"][k])))
        motion = motion_of(family_of(system, given, ()).model(np.zeros((1, 0))), many_orbits([orbit]))
        assert first_fault(motion) is None
        turn = orbit.itinerary.periods * (0.5 if orbit.itinerary.symmetric else 1.0)
        with np.errstate(divide="ignore"):
            exponents = np.log(np.abs(multipliers(motion)[0])) / turn
        np.testing.assert_allclose(exponents, cells["spectrum"][k], rtol=0.0, atol=1e-8)
        found += 1
    assert found >= 8
