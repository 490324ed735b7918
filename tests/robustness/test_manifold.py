"""Claims about stable manifolds of maps of the plane, against manifolds that are known in closed form."""

import numpy as np
import pytest

from atlas.robustness import manifold
from atlas.robustness.manifold import LENGTH, OUTSIDE, grow_manifold

BOX = np.array([-2.0, -4.0]), np.array([2.0, 4.0])


def never(point: np.ndarray, step: np.ndarray) -> None:
    """No stop."""


def bent(inner: float, outer: float):  # type: ignore[no-untyped-def]
    """A map whose saddle at 0 has the stable manifold y = x^2, with these multipliers."""

    def image(states: np.ndarray) -> np.ndarray:
        x, y = states.T
        return np.stack([inner * x, outer * (y - x * x) + (inner * x) ** 2], axis=1)

    return image


@pytest.mark.parametrize(("inner", "outer"), [(0.5, 2.0), (0.2, 30.0), (0.45, 1.05), (0.01, 5.0)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_bent_manifold_is_that_of_the_closed_form(inner: float, outer: float, sign: float) -> None:
    branch = grow_manifold(bent(inner, outer), np.zeros(2), np.array([sign, 0.0]), BOX, 100.0, never)
    x, y = np.array(branch.points).T
    assert branch.end == OUTSIDE and not branch.breaks
    assert sign * x[-1] == pytest.approx(2.0, abs=0.1)
    assert np.all(np.diff(sign * x) > 0.0)
    chord = manifold.SAGITTA * np.linalg.norm(BOX[1] - BOX[0]) / 8.0
    assert np.abs(y - x * x).max() < 2.0 * chord * outer / (outer - 1.0)  # every preimage divides it by outer


def test_finer_steps_give_a_more_exact_manifold(monkeypatch: pytest.MonkeyPatch) -> None:
    def error() -> float:
        x, y = np.array(grow_manifold(bent(0.5, 2.0), np.zeros(2), np.array([1.0, 0.0]), BOX, 100.0, never).points).T
        return float(np.abs(y - x * x).max())

    coarse = error()
    monkeypatch.setattr(manifold, "MAX_STEP", manifold.MAX_STEP / 4.0)
    monkeypatch.setattr(manifold, "SAGITTA", manifold.SAGITTA / 16.0)
    assert error() < 0.2 * coarse


def test_a_rotated_linear_saddle_has_a_straight_manifold() -> None:
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array([[c, -s], [s, c]])
    matrix = turn @ np.diag([0.3, 1.7]) @ turn.T
    branch = grow_manifold(lambda z: z @ matrix.T, np.zeros(2), turn[:, 0], BOX, 1.0, never)
    points = np.array(branch.points)
    assert branch.end == LENGTH
    assert np.linalg.norm(points[-1]) == pytest.approx(1.0, abs=0.1)
    assert np.abs(points @ turn[:, 1]).max() < 1e-7


def test_the_manifold_of_henons_map_folds_as_its_inverse_says() -> None:
    """Truth: points near the saddle on its eigenvector, taken back by the inverse of the map in closed form.

    These lie far apart at folds; there images tell, which come near the saddle from the manifold alone.
    """
    a, b = 1.4, 0.3

    def image(z: np.ndarray) -> np.ndarray:
        return np.stack([1.0 - a * z[:, 0] ** 2 + z[:, 1], b * z[:, 0]], axis=1)

    x = (b - 1.0 + np.sqrt((1.0 - b) ** 2 + 4.0 * a)) / (2.0 * a)
    saddle = np.array([x, b * x])
    values, vectors = (np.real(part) for part in np.linalg.eig(np.array([[-2.0 * a * x, 1.0], [b, 0.0]])))
    inner = int(np.argmin(np.abs(values)))
    direction = vectors[:, inner]
    low, high = np.array([-2.5, -8.0]), np.array([2.5, 8.0])
    branch = grow_manifold(image, saddle, direction, (low, high), 30.0, never)
    points = np.array(branch.points)
    back = saddle + np.linspace(1e-6, 1e-6 / values[inner], 4000)[:, None] * direction * np.sign(values[inner])
    images = []
    for _ in range(14):
        back = np.stack([back[:, 1] / b, back[:, 0] - 1.0 + a * (back[:, 1] / b) ** 2], axis=1)
        images.append(back)
    known = np.concatenate(images)
    known = known[np.all((known > low) & (known < high), axis=1)]
    from scipy.spatial import cKDTree

    away, _ = cKDTree(known).query(points[10:])
    assert len(points) > 100 and np.abs(points[:, 1]).max() > 1.0
    assert np.median(away) < 5e-3
    near = np.full(len(points), np.inf)
    for _ in range(12):
        points = image(points)
        near = np.minimum(near, np.linalg.norm(points - saddle, axis=1))
    assert near.max() < 1e-3
