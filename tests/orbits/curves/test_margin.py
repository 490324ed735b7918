"""Claims about the distance of points to curves: closed forms of a line, a polygon and a circle, and a naive twin."""

import numpy as np
import pytest

from atlas.orbits.curves.chords import (
    Chords,
    chords_of,
    distances,
    find_passages,
    margins,
    project_onto_chords,
    sagittas,
)

RNG = np.random.default_rng(3)


def every(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A curve all of whose points count."""
    return points, np.ones(len(points), dtype=np.bool_)


def circle(count: int, radius: float = 1.0) -> np.ndarray:
    angle = np.linspace(0.0, 2.0 * np.pi, count + 1)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def naive(points: np.ndarray, chords: Chords) -> tuple[np.ndarray, np.ndarray]:
    """The distance to each chord in turn, and which is the nearest."""
    away = np.array([distances(points, a[None], b[None]) for a, b in zip(chords.first, chords.last, strict=True)])
    return away.min(axis=0), away.argmin(axis=0)


def test_the_margin_to_a_straight_curve_is_that_of_the_closed_form() -> None:
    line = np.stack([np.linspace(-5.0, 5.0, 37), 2.0 * np.linspace(-5.0, 5.0, 37) + 1.0], axis=1)
    points = RNG.uniform(-1.0, 1.0, (500, 2))
    found = margins(points, chords_of([every(line)]))
    assert found.distance == pytest.approx(np.abs(2.0 * points[:, 0] - points[:, 1] + 1.0) / np.sqrt(5.0), abs=1e-14)
    assert found.error == pytest.approx(0.0, abs=1e-13)


def test_beyond_its_ends_the_margin_to_a_segment_is_that_to_an_end() -> None:
    chords = chords_of([every(np.array([[0.0, 0.0], [1.0, 0.0]]))])
    assert margins(np.array([[4.0, 4.0], [-3.0, 4.0], [0.5, 2.0]]), chords).distance == pytest.approx([5.0, 5.0, 2.0])


@pytest.mark.parametrize("count", [7, 40, 500])
def test_the_margin_to_a_circle_is_off_by_its_sagitta_and_no_more(count: int) -> None:
    """The chords of a regular polygon lie within 1 - cos(pi/N) of its circle, inside."""
    radius, angle = RNG.uniform(0.0, 3.0, 2000), RNG.uniform(0.0, 2.0 * np.pi, 2000)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    found, sagitta = margins(points, chords_of([every(circle(count))])), 1.0 - np.cos(np.pi / count)
    assert np.abs(found.distance - np.abs(1.0 - radius)).max() <= sagitta * (1.0 + 1e-9)
    estimate = np.pi**2 / count**2 / 2.0 * np.sinc(1.0 / count) ** 2
    assert found.error == pytest.approx(estimate, rel=1e-9)
    assert sagitta <= found.error.min() * (1.0 + 1.0 / count)


def test_the_estimate_of_a_sagitta_falls_with_the_square_of_the_step() -> None:
    coarse, fine = (sagittas(circle(count)).max() for count in (100, 200))
    assert coarse / fine == pytest.approx(4.0, rel=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_margins_are_those_of_a_naive_twin(seed: int) -> None:
    """Truth: every chord in turn. Lengths differ by four decades, and points lie near and far."""
    rng = np.random.default_rng(seed)
    curves = [np.cumsum(rng.standard_normal((n, 2)) * 10.0 ** rng.uniform(-4, 0), axis=0) for n in (2, 3, 50, 200, 1)]
    chords = chords_of([every(points) for points in curves])
    points = np.concatenate([rng.standard_normal((300, 2)) * 10.0 ** rng.uniform(-3, 3), curves[2][:10]])
    found, (away, nearest) = margins(points, chords), naive(points, chords)
    assert found.distance == pytest.approx(away, rel=1e-13, abs=1e-300)
    other = found.curve != chords.curve[nearest]
    assert naive(points[other], chords)[0] == pytest.approx(found.distance[other], rel=1e-13)


def test_only_parts_that_count_are_near() -> None:
    points = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0], [4.0, 0.0]])
    counts = np.array([True, True, False, True, False])
    chords = chords_of([(points, counts)])
    assert margins(np.array([[1.4, 0.0], [2.5, 0.0], [9.0, 0.0]]), chords).distance == pytest.approx([0.4, 0.5, 6.0])


def test_the_curve_of_a_margin_is_the_nearest_one() -> None:
    chords = chords_of([every(circle(300)), every(circle(300, 2.0)), every(np.array([[0.0, 0.0]]))])
    found = margins(np.array([[0.2, 0.0], [0.9, 0.0], [0.0, 5.0]]), chords)
    assert found.curve.tolist() == [2, 0, 1]


def test_the_way_from_a_chord_is_square_to_it_between_its_ends_and_ends_at_an_end_beyond() -> None:
    share, way = project_onto_chords(
        np.array([[[0.25, 1.0]], [[3.0, 1.0]]]), np.array([[0.0, 0.0]]), np.array([[1.0, 0.0]])
    )
    assert share.tolist() == [[0.25], [1.0]]
    assert way.tolist() == [[[0.0, 1.0]], [[2.0, 1.0]]]


def test_a_chord_of_length_0_is_its_point() -> None:
    assert distances(np.array([[3.0, 4.0]]), np.zeros((1, 2)), np.zeros((1, 2))).tolist() == [5.0]
    assert find_passages(np.zeros((3, 2)), np.zeros(2), 1.0) == []


def test_a_curve_that_comes_back_passes_a_point_once_each_time() -> None:
    """There along y = 0 and back along y = 0.1: between the two lines the point is near one chord of either."""
    along = np.linspace(0.0, 1.0, 11)
    there, back = np.stack([along, 0.0 * along], axis=1), np.stack([along[::-1], 0.0 * along + 0.1], axis=1)
    found = find_passages(np.concatenate([there, back]), np.array([0.52, 0.05]), 0.06)
    assert [place for place, _ in found] == [5, 15]
    assert [share for _, share in found] == pytest.approx([0.2, 0.8])
