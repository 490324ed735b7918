"""Claims about the minimal fatal shock, against a disc whose exact distance is known and a dense scan of a basin."""

import numpy as np
import pytest

import atlas
from atlas.robustness.fatal_shock import minimal_fatal_shock
from workers import solve_tile
from workers.results import REGIMES


def lens(states: np.ndarray) -> np.ndarray:
    """Label 1 within 0.5 of (2, 1, 0, ...), else 0."""
    middle = np.zeros(states.shape[1])
    middle[:2] = 2.0, 1.0
    return (np.linalg.norm(states - middle, axis=1) < 0.5).astype(np.int64)


@pytest.mark.parametrize("size", [2, 4, 6])
def test_the_shock_into_a_ball_is_its_distance(size: int) -> None:
    known = np.zeros((1, size))
    known[0, :2] = 2.2, 1.2
    found = minimal_fatal_shock(lens, 0, np.zeros((1, size)), np.ones(size), known)
    assert found is not None
    assert found.size == pytest.approx(np.sqrt(5.0) - 0.5, rel=1e-5)
    assert found.size >= np.sqrt(5.0) - 0.5 - 1e-12
    assert (found.reached, found.tried) == (1, 256)


def test_a_nearer_part_that_no_known_state_lies_in_is_found() -> None:
    def two(states: np.ndarray) -> np.ndarray:
        return np.where(states[:, 0] < -0.6, 2, lens(states))

    found = minimal_fatal_shock(two, 0, np.zeros((1, 2)), np.ones(2), np.array([[2.0, 1.0]]))
    assert found is not None
    assert (found.reached, found.size) == (2, pytest.approx(0.6, rel=1e-6))


def test_weights_choose_the_direction() -> None:
    def walls(states: np.ndarray) -> np.ndarray:
        return ((states[:, 0] > 1.0) | (states[:, 1] > 1.5)).astype(np.int64)

    known = np.array([[1.1, 0.0], [0.0, 1.6]])
    found = minimal_fatal_shock(walls, 0, np.zeros((1, 2)), np.array([2.0, 1.0]), known)
    assert found is not None and found.size == pytest.approx(1.5, rel=1e-6)


def test_without_another_attractor_there_is_a_reason() -> None:
    given = {"omega": 1.5, "A": 0.1, "b": 50.0, "zeta": 0.05}
    (found,) = atlas.stability(given, system="single-mass", starts=2, shocks=True)["coexisting"]
    assert np.isnan(found["fatal_shock"]) and found["shock_reason"] == "no other attractor is known"


def test_no_state_of_a_dense_scan_is_a_smaller_fatal_shock() -> None:
    """Truth: 4000 states about the attractor of a gear mesh, each solved alone."""
    found = atlas.stability(system="gear-mesh", shocks=True)
    first, second = found["coexisting"]
    names = list(found["norm"])
    w = np.array([found["norm"][name] for name in names])
    codes = {regime.name: regime.code for regime in REGIMES}

    def reach(states: np.ndarray) -> np.ndarray:
        return np.asarray(solve_tile("gear-mesh", dict(zip(names, states.T, strict=True)))["regime"])

    angle = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    for own, other in ((first, second), (second, first)):
        size = own["fatal_shock"]
        radii = size * np.append(np.linspace(0.1, 0.999, 19), 1.02)
        rays = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        states = np.array(own["state"]) + radii[:, None, None] * rays / w
        regimes = reach(states.reshape(-1, 2)).reshape(states.shape[:2])
        assert not np.any(regimes[:-1] == codes[other["regime"]])
        assert np.any(regimes[-1] == codes[other["regime"]])
        assert reach(np.array([own["shock_state"]])) == codes[other["regime"]]
        away = np.linalg.norm(w * (np.array(own["shock_state"]) - own["state"]))
        assert away == pytest.approx(size, rel=1e-9)
