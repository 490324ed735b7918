"""Claims about the state of a cell that sticks or is held at the section: it says so exactly, and goes on as it did."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from atlas.robustness.linear_measures import slips_at_a_push
from tests.support.solver_bridge import follow
from workers import Settings, System, solve_tile
from workers.kernel.hybrid.state import satisfy_rows
from workers.model.oscillator import Oscillator, take_one
from workers.results import PERIODIC

SETTINGS = Settings(exponents="none", survival=0, max_periods=3000)

STICKS: dict[str, Any] = {
    "name": "sticks", "coordinates": ["x1", "x2"], "mass": [[1, 0], [0, 2]], "damping": [[0.3, -0.1], [-0.1, 0.4]],
    "stiffness": [[3, -1], [-1, 2]], "force": [0.4, 2.0],
    "friction": [{"name": "ground", "row": [0, 1], "kinetic": 0.8, "static": 1.2}],
}  # fmt: skip
BETWEEN = {"friction": [{"name": "joint", "row": [-1, 1], "kinetic": 0.4, "static": 0.6}], "name": "between"}
HELD: dict[str, Any] = {
    "friction": [{"name": "guide", "row": [1, 0], "kinetic": 0.02}], "name": "held", "load": [0, 1.5],
    "contacts": [{"name": "stop", "gap": [-1, 1], "upper": 0.3, "restitution": 0.2}],
}  # fmt: skip


def machine(system: System, values: dict[str, float]) -> Oscillator:
    given = {p.name: np.array([values.get(p.name, p.default)]) for p in system.parameters}
    return system.build_many(given)[0]


@pytest.mark.parametrize("changes", [{}, BETWEEN, HELD], ids=["sticks", "sticks between masses", "held"])
def test_a_cell_goes_on_from_its_state_as_it_did(changes: dict[str, Any]) -> None:
    """Sections all over the period: at some of them what sticks would slide on if it slid at all."""
    system, at_rest, at_edge = System.from_mapping(STICKS | changes), 0, 0
    for tau in np.linspace(0.0, 2.0 * math.pi, 24, endpoint=False):
        values = {"omega": 0.3, "tau": float(tau)}
        cell = solve_tile(system, values, SETTINGS)
        assert cell["regime"] == PERIODIC
        built, state = machine(system, values), np.array(cell["state"])
        again = follow(built, state, periods=int(cell["period"]))
        np.testing.assert_allclose(again.state, state, rtol=0.0, atol=1e-11)
        elements = take_one(built, 0).table.elements
        row = elements.row[0] if "contacts" in changes else elements.friction_rows[0]
        at_rest += float(row @ state[2:]) == 0.0
        at_edge += slips_at_a_push(built, state[None])
    assert at_rest >= 3
    assert at_edge >= ("contacts" not in changes)


def test_a_cell_that_changes_its_mode_at_the_section_has_the_exponents_of_any_other_section() -> None:
    """It begins to stick there, or lets go, to within units in the last place of the phase on either side."""
    system, settings = System.from_mapping(STICKS), replace(SETTINGS, exponents="spectrum")
    known = solve_tile(system, {"omega": 0.5}, settings)
    assert (known["regime"], known["period"]) == (PERIODIC, 1)
    events = follow(machine(system, {"omega": 0.5}), np.array(known["state"])).events
    assert len(events) == 4
    for event in events:
        tau = 0.5 * event.t
        for phase in (np.nextafter(tau, 0.0), tau, np.nextafter(tau, 9.0), tau + 1e-10):
            found = solve_tile(system, {"omega": 0.5, "tau": float(phase)}, settings)
            assert (found["regime"], found["period"]) == (PERIODIC, 1), (event, phase)
            np.testing.assert_allclose(found["spectrum"], known["spectrum"], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("R", [0.0, 0.1])
def test_what_a_stop_holds_is_stored_on_it(R: float) -> None:
    stop = {"name": "stop", "gap": [1, 0], "upper": 0.5, "lower": -0.85, "restitution": R}
    found = solve_tile(
        System.from_mapping({
            "name": "capsule3", "coordinates": ["r", "x2"], "mass": [[1, 1], [1, 6]], "damping": [[0.1, 0], [0, 0]],
            "stiffness": [[1, 0], [0, 0]], "force": [1.6, 1.6], "drift": "x2", "contacts": [stop],
            "friction": [{"name": "ground", "row": [0, 1], "kinetic": 0.4}],
        }),
        {"omega": 0.9, "tau": 0.5 * math.pi},
        SETTINGS,
    )  # fmt: skip
    assert found["regime"] == PERIODIC
    assert (found["state"][0], found["state"][2]) == (0.5, 0.0)


def test_random_rows_show_what_was_put_on_them() -> None:
    """Stops and frictions of any rows at once: held and stuck as they were brought to be."""
    rng = np.random.default_rng(9)
    for _ in range(200):
        n = int(rng.integers(1, 5))
        count = int(rng.integers(1, n + 1))
        rows, values, x = rng.normal(size=(count, n)), rng.normal(size=count), rng.normal(size=n)
        satisfy_rows(rows, values, x)
        size = np.abs(rows) @ np.abs(x) + np.abs(values)
        assert np.all(np.abs(rows @ x - values) <= 1e-13 * size * np.linalg.cond(rows))


def test_rows_that_depend_on_each_other_are_met_once() -> None:
    x = np.array([0.3, 0.1, 0.7])
    satisfy_rows(np.array([[1.0, -1.0, 0.0], [-2.0, 2.0, 0.0], [0.0, 1.0, 0.0]]), np.array([0.5, -1.0, 0.2]), x)
    np.testing.assert_array_equal(x, [0.7, 0.2, 0.7])
