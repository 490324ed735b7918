"""The Kaplan-Yorke dimension, and the sum law where a rigid mode shears the frame."""

import math

import numpy as np
import pytest

from tests import naive
from workers import Settings, solve_tile
from workers.cell.exponents import kaplan_yorke
from workers.results import CHAOTIC

INF = math.inf


@pytest.mark.parametrize(
    ("spectrum", "dimension"),
    [
        ([-0.1, -0.2], 0.0),
        ([0.0, -0.2], 1.0),
        ([0.5, -1.0], 1.5),
        ([0.5, 0.1, -0.2, -3.0], 3.0 + 0.4 / 3.0),
        ([0.5, -INF], 1.0),
        ([-INF, -INF], 0.0),
        ([0.3, -0.1, -INF, -INF], 2.0),
        ([0.2, -0.2], 2.0),
        ([0.0, 0.0], 2.0),
    ],
)
def test_the_dimension_is_that_of_the_formula(spectrum: list[float], dimension: float) -> None:
    assert kaplan_yorke(np.array(spectrum)) == pytest.approx(dimension, rel=1e-15)


def test_a_spectrum_that_is_not_known_has_no_dimension() -> None:
    assert np.isnan(kaplan_yorke(np.array([[0.1, np.nan], [np.nan, np.nan]]))).all()


def test_a_cell_has_the_dimension_of_its_spectrum() -> None:
    found = solve_tile("two-mass", naive.FIGURES[5], Settings(exponents="spectrum", tolerance=0.05))
    assert found["regime"] == CHAOTIC
    first, second = found["spectrum"][:2]
    assert found["kaplan_yorke"] == pytest.approx(1.0 - first / second, rel=1e-14)
