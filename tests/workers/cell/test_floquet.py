"""Claims about Floquet exponents of orbits on which directions are lost, and about averages beside masses that rest.

Numbers without a derivation come from increments of tangent vectors in an independent simulation.
"""

import functools
import math
from typing import Any

import numpy as np
import pytest

from tests.support.solver_bridge import follow
from workers import Settings, System, solve_tile
from workers.cell.cell_batch import Results
from workers.results import CHAOTIC, NO_REASON, PERIODIC

SPECTRUM = Settings(exponents="spectrum", survival=0, max_periods=3000)

CAPSULE: dict[str, Any] = {
    "name": "capsule2", "coordinates": ["r", "x2"], "mass": [[1, 1], [1, 6]], "damping": [[0.1, 0], [0, 0]],
    "stiffness": [[1, 0], [0, 0]], "force": [1.6, 1.6], "drift": "x2",
    "contacts": [{"name": "stop", "gap": [1, 0], "upper": 0.5, "lower": -0.85, "restitution": 0}],
    "friction": [{"name": "ground", "row": [0, 1], "kinetic": 0.4}],
}  # fmt: skip
AT_REST = {"omega": 0.9, "tau": 0.5 * math.pi}

PAIR: dict[str, Any] = {
    "name": "pair2", "coordinates": ["x1", "x2"], "mass": [[1, 0], [0, 1]], "damping": [[0.1, 0], [0, 0.1]],
    "stiffness": [[1, 0], [0, 1]], "force": [0.3, 0.3], "load": [1, 0],
    "contacts": [{"name": "stop", "gap": [1, 0], "upper": 0.2, "restitution": 0.3}],
}  # fmt: skip


def capsule(R: float, **changes: Any) -> System:
    (stop,) = CAPSULE["contacts"]
    return System.from_mapping(CAPSULE | {"contacts": [stop | {"restitution": R}]} | changes)


def pair(**changes: Any) -> System:
    return System.from_mapping(PAIR | changes)


@pytest.mark.parametrize(("R", "largest"), [(0.0, -0.512760952), (0.1, -1.32449), (0.3, -1.84603532)])
def test_a_drifting_machine_that_rests_at_the_section_has_the_exponent_of_its_tangent_vectors(
    R: float, largest: float
) -> None:
    found = solve_tile(capsule(R), AT_REST, SPECTRUM)
    assert (found["regime"], found["period"]) == (PERIODIC, 1)
    assert found["largest"] == pytest.approx(largest, abs=1e-8 if R == 0.0 else 1e-5)
    np.testing.assert_array_equal(found["spectrum"][1:], [-np.inf, -np.inf])


def multipliers(system: System, values: dict[str, float], cell: Results) -> np.ndarray:
    """Logs of the moduli per period, largest first, of the derivative of one turn without what drifts."""
    given = {p.name: np.array([values.get(p.name, p.default)]) for p in system.parameters}
    turn = follow(system.build_many(given)[0], cell["state"], periods=int(cell["period"]))
    drift = [system.states.index(system.definition.drift)] if system.definition.drift else []
    jacobian = np.delete(np.delete(turn.jacobian, drift, axis=0), drift, axis=1)
    with np.errstate(divide="ignore"):
        return np.asarray(np.sort(np.log(np.abs(np.linalg.eigvals(jacobian))))[::-1] / int(cell["period"]))


def test_drifting_machines_have_the_multipliers_of_the_derivative_of_a_turn() -> None:
    """Of random machines that stick or rest: eigenvalues of the product of all saltation matrices, formed at once."""
    rng, compared = np.random.default_rng(47), 0
    for _ in range(30):
        system = capsule(
            float(rng.choice([0.0, 0.1, 0.5])),
            mass=[[1.0, 1.0], [1.0, float(rng.uniform(2.0, 8.0))]],
            friction=[{"name": "ground", "row": [0, 1], "kinetic": float(rng.uniform(0.1, 0.8))}],
        )
        values = {"omega": float(rng.uniform(0.5, 1.5)), "tau": float(rng.uniform(0.0, 2.0 * math.pi))}
        cell = solve_tile(system, values, SPECTRUM)
        if cell["regime"] != PERIODIC or np.isneginf(cell["largest"]):
            continue
        finite = np.isfinite(cell["spectrum"])
        expected = multipliers(system, values, cell)
        np.testing.assert_allclose(cell["spectrum"][finite], expected[finite], rtol=0.0, atol=1e-7)
        assert np.all(expected[~finite] < -20.0 / cell["period"])
        compared += 1
    assert compared >= 15


def test_beside_a_mass_that_rests_and_is_not_coupled_a_mass_has_its_own_exponents() -> None:
    """-zeta T twice of the free one; both directions of the one on its stop are lost."""
    found = solve_tile(pair(), {"omega": 0.7, "tau": 1.0}, SPECTRUM)
    assert (found["regime"], found["period"]) == (PERIODIC, 1)
    free = -0.05 * 2.0 * math.pi / 0.7
    np.testing.assert_allclose(found["spectrum"], [free, free, -np.inf, -np.inf], rtol=0.0, atol=1e-12)


def test_two_masses_that_are_not_coupled_and_rest_in_turn_lose_all_directions() -> None:
    """Each in its own part of the period, so that one alone is at rest at any time."""
    stops = [
        {"name": "one", "gap": [1, 0], "upper": 0.2, "restitution": 0},
        {"name": "other", "gap": [0, 1], "lower": -0.2, "restitution": 0},
    ]
    found = solve_tile(pair(contacts=stops, force=[2.0, 2.0], load=[0, 0]), {"omega": 0.3}, SPECTRUM)
    assert (found["regime"], found["period"], found["reason"]) == (PERIODIC, 1, NO_REASON)
    assert 0.0 < found["stuck_fraction"] < 1.0
    np.testing.assert_array_equal(found["spectrum"], [-np.inf] * 4)


CHAOS = 0.5 + 8 * 3.5 / 59
"""A frequency at which one mass between spring and stop moves chaotically."""
UNSEEN: dict[str, Any] = {
    "coordinates": ["x1", "x2"], "mass": [[1, 0], [0, 1]], "damping": [[0.05, 0], [0, 0.04]],
    "stiffness": [[0.25, 0], [0, 1]], "force": [0.3, 0.4],
}  # fmt: skip
WALL = {"name": "wall", "gap": [0, 1], "upper": 1, "restitution": 0.9}
MACHINES = {
    "one rigid contact": {"gap": [0, 1], "upper": 1, "restitution": 0.9},
    "modes": {"contacts": [WALL]},
    "the other one rests": {
        "contacts": [WALL, {"name": "far", "gap": [1, 0], "upper": 0.1, "restitution": 0.3}],
        "load": [5, 0],
    },
}


@functools.cache
def alone(exponents: str) -> Results:
    settings = Settings(exponents=exponents, survival=0, max_periods=6000)
    return solve_tile("single-mass", {"omega": CHAOS, "A": 0.4, "b": 1.0, "zeta": 0.02, "R": 0.9}, settings)


@pytest.mark.parametrize("exponents", ["largest", "spectrum"])
@pytest.mark.parametrize("machine", MACHINES)
def test_chaos_is_seen_beside_a_slower_mass_that_it_does_not_move(machine: str, exponents: str) -> None:
    settings = Settings(exponents=exponents, survival=0, max_periods=6000)
    system = System.from_mapping(UNSEEN | MACHINES[machine] | {"name": "unseen"})
    found, known = solve_tile(system, {"omega": CHAOS}, settings), alone(exponents)
    assert (found["regime"], known["regime"]) == (CHAOTIC, CHAOTIC)
    assert found["largest"] == pytest.approx(known["largest"], abs=4.0 * math.hypot(found["error"], known["error"]))


def test_a_block_that_slides_to_and_fro_alike_is_symmetric_wherever_it_is() -> None:
    block = {
        "name": "block2", "coordinates": ["x"], "mass": [[1]], "force": [1], "drift": "x",
        "friction": [{"name": "ground", "row": [1], "kinetic": 0.3}],
    }  # fmt: skip
    found = solve_tile(System.from_mapping(block), {"omega": 1.0}, SPECTRUM)
    assert found["regime"] == PERIODIC and found["symmetric"]
    assert found["drift_per_period"] == pytest.approx(0.0, abs=1e-12)
    leaning = solve_tile(System.from_mapping(block | {"load": [0.1]}), {"omega": 1.0}, SPECTRUM)
    assert leaning["regime"] == PERIODIC and not leaning["symmetric"]
