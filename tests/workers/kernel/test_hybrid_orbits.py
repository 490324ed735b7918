"""The thirty rows of tests/data/piecewise.json: what the solver says of the oracle's orbits, from their states on."""

import functools
import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.paths import DATA
from tests.support.oracle.piecewise import PiecewiseMachine, PiecewiseMode
from tests.support.solver_bridge import Array, SolverEvent, SolverMotion, built, code_in, follow
from workers.kernel.motion import CONTRACTION, LOST, RUNNING
from workers.model.hybrid_modes import code_of
from workers.model.oscillator import Oscillator

LATER = 1.0
"""An unforced cycle begins where it starts to slip: it is followed from this much later on, off its events."""

ON_THE_EDGE = ("row 18",)
"""At its grazing-sliding rounding decides whether there is a stick: both motions are right."""

TOUCHES = ("row 1, omega 0.782", "row 1, omega 1.655")
"""Orbits that graze a soft stop: rounding of 1e-16 in depth is one of 1e-8 in the time spent beyond it."""

FRICTION_KINDS = ("turn", "stick", "slip+", "slip-")

RECORDS: dict[str, dict[str, Any]] = {
    record["name"]: record
    for record in json.loads((DATA / "piecewise.json").read_text())
    if record.get("admissible", True) and record["name"] not in ON_THE_EDGE
}

each_orbit = pytest.mark.parametrize("name", RECORDS)
each_symmetric = pytest.mark.parametrize("name", [name for name, record in RECORDS.items() if record["symmetric"]])


def machine_in(record: dict[str, Any]) -> PiecewiseMachine:
    """The machine of a record. Unforced, it is given the frequency of its cycle; at the onset of stick, the lower
    static friction with which the orbit is the same and no rounding decides whether it sticks."""
    machine = PiecewiseMachine.of(record["machine"])
    if record["periods"] is None:
        machine = replace(machine, omega=2.0 * math.pi / record["cycle"])
    if record.get("bifurcation", {}).get("kind") == "onset of stick":
        machine = replace(machine, friction=tuple(replace(f, static=f.kinetic) for f in machine.friction))
    return machine


def number_in(record: dict[str, Any]) -> int:
    return code_in(PiecewiseMode(0, tuple(record["mode"]["contacts"]), tuple(record["mode"]["friction"]))).number


@functools.cache
def turn_of(name: str) -> tuple[Oscillator, Array, SolverMotion]:
    """The machine, the state where it is followed from, and the motion over one turn."""
    record = RECORDS[name]
    hybrid = built(machine_in(record))
    start, number = np.array(record["state"]), number_in(record)
    if record["periods"] is None:
        earlier = follow(hybrid, start, number, duration=LATER)
        start, number = earlier.state, earlier.number
    return hybrid, start, follow(hybrid, start, number, record["periods"] or 1)


def expected_events(record: dict[str, Any]) -> list[tuple[float, str, int, float]]:
    """Its events in the order of a turn; of unforced cycles from LATER on."""
    since = LATER if record["periods"] is None else 0.0
    length = (
        record["cycle"] if record["periods"] is None else record["periods"] * 2 * math.pi / machine_in(record).omega
    )
    return sorted(((t - since) % length, kind, index, value) for t, kind, index, value in record["events"])


def is_of(event: SolverEvent, kind: str, index: int) -> bool:
    return (event.element == "friction") == (kind in FRICTION_KINDS) and event.index == index


def nearest(name: str, t: float, kind: str, index: int) -> SolverEvent:
    """The event of that element next to a time."""
    return min((e for e in turn_of(name)[2].events if is_of(e, kind, index)), key=lambda e: abs(e.t - t))


def sorted_values(values: Array) -> Array:
    return values[np.lexsort((-values.imag, -np.abs(values).round(9)))]


def in_order(jacobian: Array) -> Array:
    """Eigenvalues as the records have them, largest modulus first."""
    return sorted_values(np.linalg.eigvals(jacobian).astype(complex))


@each_orbit
def test_an_orbit_of_the_oracle_closes_to_rounding(name: str) -> None:
    _, start, turn = turn_of(name)
    assert turn.status == RUNNING
    moved = np.abs(turn.state - start)
    if RECORDS[name]["drift"] is not None:
        moved[RECORDS[name]["drift"]] = 0.0
    assert moved.max() < 2e-14 * max(1.0, np.abs(turn.jacobian).max())


@each_orbit
def test_an_orbit_ends_in_the_mode_that_it_began_in(name: str) -> None:
    hybrid, _, turn = turn_of(name)
    first, last = (code_of(number, *hybrid.table.machines.sizes[1:]) for number in (turn.numbers[0], turn.numbers[-1]))
    assert (last.contacts, last.slips) == (first.contacts, first.slips)


@each_orbit
def test_events_are_where_the_oracle_has_them_and_contacts_are_reached_at_its_speeds(name: str) -> None:
    for t, kind, index, value in expected_events(RECORDS[name]):
        if kind != "rest":  # the solver rests from where a chatter is certain to end
            event = nearest(name, t, kind, index)
            assert event.t == pytest.approx(t, abs=1e-11), (t, kind)
            assert kind not in ("impact", "hit", "open") or event.rate == pytest.approx(value, abs=1e-11), (t, kind)


@each_orbit
def test_there_are_no_other_events(name: str) -> None:
    """But for impacts of a chatter, of which the oracle lists the fast ones, and grazes that rounding makes of one."""
    known = expected_events(RECORDS[name])
    for event in turn_of(name)[2].events:
        slow = event.element == "contact" and abs(event.rate) < (1e-6 if name in TOUCHES else 1e-3)
        assert slow or any(abs(event.t - t) < 1e-9 and is_of(event, kind, i) for t, kind, i, _ in known), event


@each_orbit
def test_friction_turns_and_sticks_where_the_oracle_says(name: str) -> None:
    record = RECORDS[name]
    hybrid, start, turn = turn_of(name)
    if record["periods"] not in (None, 1):
        assert not any(kind in FRICTION_KINDS for _, kind, *_ in record["events"])
        return
    machine = machine_in(record)
    for t, kind, index, value in expected_events(record):
        if kind in (*FRICTION_KINDS, "detach", "engage", "leave"):
            there = follow(hybrid, start, turn.numbers[0], duration=t).state
            rows = machine.friction if kind in FRICTION_KINDS else machine.contacts
            assert np.dot(rows[index].row, there[: machine.n]) == pytest.approx(value, abs=1e-11), (t, kind)


@each_orbit
def test_multipliers_are_those_of_the_oracle(name: str) -> None:
    record = RECORDS[name]
    expected = sorted_values(np.array([complex(*pair) for pair in record["multipliers"]]))
    tolerance = 1e-5 if name in TOUCHES else 1e-7 if "bifurcation" in record else 1e-12
    np.testing.assert_allclose(in_order(turn_of(name)[2].jacobian), expected, rtol=0.0, atol=tolerance)


@each_symmetric
def test_half_a_turn_of_a_symmetric_orbit_is_its_mirror_image(name: str) -> None:
    record = RECORDS[name]
    hybrid, start, turn = turn_of(name)
    half = follow(hybrid, start, turn.numbers[0], duration=math.pi / hybrid.table.machines.omega[0])
    np.testing.assert_allclose(half.state, -start, rtol=0.0, atol=1e-13)
    expected = sorted_values(np.array([complex(*pair) for pair in record["half_multipliers"]]))
    tolerance = 1e-7 if "bifurcation" in record else 1e-12
    np.testing.assert_allclose(in_order(-half.jacobian), expected, rtol=0.0, atol=tolerance)


@each_orbit
def test_volumes_change_by_the_sum_law(name: str) -> None:
    record, turn = RECORDS[name], turn_of(name)[2]
    if "sum" in record:
        assert turn.tally[LOST] == 0.0
        assert turn.tally[CONTRACTION] == pytest.approx(record["sum"] * record["periods"], abs=1e-12)
        assert turn.tally[CONTRACTION] == pytest.approx(math.log(abs(np.linalg.det(turn.jacobian))), abs=1e-12)
    else:
        lost = sum(abs(complex(*pair)) == 0.0 for pair in record["multipliers"])
        assert turn.tally[LOST] == lost
