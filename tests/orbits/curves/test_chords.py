"""Claims about chords of curves: the way from a chord to a point, and passages of a curve by a point."""

import numpy as np
import pytest

from atlas.orbits.curves.chords import find_passages, project_onto_chords


def test_the_way_from_a_chord_is_square_to_it_between_its_ends_and_ends_at_an_end_beyond() -> None:
    share, way = project_onto_chords(
        np.array([[[0.25, 1.0]], [[3.0, 1.0]]]), np.array([[0.0, 0.0]]), np.array([[1.0, 0.0]])
    )
    assert share.tolist() == [[0.25], [1.0]]
    assert way.tolist() == [[[0.0, 1.0]], [[2.0, 1.0]]]


def test_a_chord_of_length_0_is_its_point() -> None:
    _, way = project_onto_chords(np.array([[3.0, 4.0]]), np.zeros((1, 2)), np.zeros((1, 2)))
    assert way.tolist() == [[3.0, 4.0]]
    assert find_passages(np.zeros((3, 2)), np.zeros(2), 1.0) == []


def test_a_curve_that_comes_back_passes_a_point_once_each_time() -> None:
    """There along y = 0 and back along y = 0.1: between the two lines the point is near one chord of either."""
    along = np.linspace(0.0, 1.0, 11)
    there, back = np.stack([along, 0.0 * along], axis=1), np.stack([along[::-1], 0.0 * along + 0.1], axis=1)
    found = find_passages(np.concatenate([there, back]), np.array([0.52, 0.05]), 0.06)
    assert [place for place, _ in found] == [5, 15]
    assert [share for _, share in found] == pytest.approx([0.2, 0.8])
