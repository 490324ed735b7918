"""Claims about limits of affine maps with a multiplier of one, against their closed forms."""

import math

import numpy as np
import pytest

from workers.orbit.linear import where_it_stays

ZERO = np.zeros((1, 2))


def test_a_sliding_mass_comes_to_rest_where_the_sum_of_its_steps_ends() -> None:
    J, h = np.array([[1.0, 0.3], [0.0, 0.8]]), np.array([[0.2, -0.5]])
    assert where_it_stays(J, ZERO, ZERO, h)[0] == pytest.approx([0.2 - 0.5 * 0.3 / (1.0 - 0.8), 0.0], abs=1e-12)


def test_a_free_mass_that_moves_has_no_limit() -> None:
    J = np.array([[1.0, 0.3], [0.0, 1.0]])
    assert np.isnan(where_it_stays(J, ZERO, ZERO, np.array([[0.0, 1.0]]))).all()


def test_an_undamped_oscillation_continues_from_its_own_state() -> None:
    c, s = math.cos(1.0), math.sin(1.0)
    h = np.array([[0.4, 0.1]])
    assert np.array_equal(where_it_stays(np.array([[c, s], [-s, c]]), ZERO, ZERO, h), h)
