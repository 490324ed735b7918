"""Claims about the attractors of machines whose law changes: each is what its own state leads to."""

import numpy as np
import pytest

from workers import Settings, System, solve_tile
from workers.attractors.basins import solve_basins
from workers.attractors.coexistence import solve_attractors
from workers.attractors.initial_states import AttractorSettings
from workers.model.system import find_system
from workers.results import CHAOTIC, PERIODIC

SETTINGS = Settings(max_periods=3000, survival=300, tolerance=0.05)

CELLS = {
    "soft-impact": {"omega": [0.78, 0.86, 0.9], "a": [0.5, 0.63, 0.7]},
    "stick-slip": {"omega": [0.9, 1.6], "u": [0.3, 0.4]},
    "two-stops": {"omega": [2.0, 3.0]},
    "gear-mesh": {"omega": [0.9, 1.1], "eps": [0.3, 0.4]},
    "capsule": {"omega": [0.4, 1.02], "alpha": [1.2, 1.4]},
}
"""Cells of packaged systems, some of them with several attractors."""


@pytest.fixture(scope="module", params=list(CELLS))
def found(request: pytest.FixtureRequest) -> tuple[str, dict[str, list[float]], dict[str, np.ndarray]]:
    name = request.param
    return name, CELLS[name], solve_attractors(name, CELLS[name], SETTINGS, AttractorSettings(12))


def test_every_start_is_put_to_an_attractor_or_counted_as_undecided(
    found: tuple[str, dict[str, list[float]], dict[str, np.ndarray]],
) -> None:
    _, _, result = found
    kept = np.nansum(result["share"], axis=-1) * result["starts"]
    assert np.allclose(kept + result["starts_unstored"] + result["undecided"], result["starts"])
    assert (result["attractors"] >= 1).all()


def test_the_state_of_an_orbit_leads_to_that_orbit(
    found: tuple[str, dict[str, list[float]], dict[str, np.ndarray]],
) -> None:
    name, params, result = found
    for c, k in np.argwhere(result["regime"] == PERIODIC).tolist():
        state = {
            f"{component}": float(value)
            for component, value in zip(states_of(name), result["state"][c, k], strict=True)
        }
        here = {key: values[c] for key, values in params.items()} | state
        alone = solve_tile(name, here, SETTINGS)
        assert alone["regime"] == PERIODIC and alone["period"] == result["period"][c, k]
        assert alone["largest"] == pytest.approx(result["largest"][c, k], abs=1e-9)


def test_no_two_orbits_of_a_cell_are_one(found: tuple[str, dict[str, list[float]], dict[str, np.ndarray]]) -> None:
    _, _, result = found
    for c in range(len(result["regime"])):
        orbits = np.flatnonzero(result["regime"][c] == PERIODIC)
        same = {(int(result["period"][c, k]), round(float(result["largest"][c, k]), 7)) for k in orbits}
        assert len(same) == len(orbits) or result["symmetric"][c].any()


def test_labels_of_basins_are_those_of_attractors() -> None:
    values = {"omega": 0.86, "a": 0.63}
    table = solve_attractors("soft-impact", values, SETTINGS, AttractorSettings(12))
    x = np.linspace(-0.5, 0.5, 5)
    basins = solve_basins("soft-impact", values | {"x": x}, SETTINGS, AttractorSettings(12))
    assert set(basins["label"].tolist()) <= set(range(-2, int(table["attractors"])))
    known = basins["label"] >= 0
    assert known.any() and (basins["regime"][known] != CHAOTIC).any()


def states_of(name: str) -> tuple[str, ...]:
    return find_system(name).states


# Mirror images


def test_twin_orbits_in_two_soft_stops_are_mirror_images() -> None:
    """A mass that falls from 3 to either side: on a stop x'' + .3 x' + 19 (x -+ 1/19 - 4 or 2) = .05 sin t, exactly."""
    stops = {"name": "stops", "gap": [1.0], "upper": 4.0, "lower": 2.0, "stiffness": 20.0}
    wells = System.from_mapping({
        "name": "wells", "coordinates": ["x"], "mass": [[1.0]], "damping": [[0.3]], "stiffness": [[-1.0]],
        "load": [-3.0], "force": [0.05], "contacts": [stops],
    })  # fmt: skip
    found = solve_attractors(wells, {"omega": 1.0, "x": 4.1}, Settings(), AttractorSettings(8, box=(("x", 0.0, 6.0),)))
    steady = 0.05 / (18.0 + 0.3j)
    upper = np.array([3.0 + 20.0 / 19.0 + steady.imag, steady.real])
    lower = np.array([3.0 - 20.0 / 19.0 + steady.imag, steady.real])
    assert found["attractors"] == 2 and found["mirror"].tolist() == [1, 0, -1, -1]
    states = sorted(found["state"][:2].tolist())
    assert np.array(states) == pytest.approx(np.array([lower, upper]), abs=1e-12)


def test_twin_cycles_in_two_wells_are_mirror_images() -> None:
    """Negative damping drives the mass onto a rigid stop in either well; none has the energy to cross between."""
    soft = {"name": "soft", "gap": [1.0], "upper": 4.0, "lower": 2.0, "stiffness": 20.0}
    hard = {"name": "hard", "gap": [1.0], "upper": 4.2, "lower": 1.8, "restitution": 0.6}
    wells = System.from_mapping({
        "name": "wells", "coordinates": ["x"], "mass": [[1.0]], "damping": [[-0.05]], "stiffness": [[-1.0]],
        "load": [-3.0], "contacts": [soft, hard],
    })  # fmt: skip
    box = (("x", 1.85, 4.15), ("v", -0.1, 0.1))
    found = solve_attractors(wells, {"x": 4.1}, Settings(), AttractorSettings(8, box=box))
    assert found["attractors"] == 2 and found["mirror"].tolist() == [1, 0, -1, -1]
    assert not found["symmetric"].any()
    assert found["cycle_period"][0] == pytest.approx(found["cycle_period"][1], rel=1e-12)
