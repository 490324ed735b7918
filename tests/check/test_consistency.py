"""The rules on a tile's results, on cells solved by the paper's schedule."""

import numpy as np
import pytest

import atlas
from atlas.check.rules import broken_rules
from workers.results import CHAOTIC, NO_IMPACT, PERIODIC
from workers.tile import solve_tile

WHOLE = (slice(None), slice(None))
Solved = tuple[atlas.Spec, dict[str, np.ndarray]]


@pytest.fixture(scope="module", params=["largest", "spectrum"])
def solved(request: pytest.FixtureRequest) -> Solved:
    """Cells without impact, periodic and chaotic ones."""
    schedule = {"method": "fixed", "transient_periods": 100, "periods": 500, "exponents": request.param}
    axes = {"omega": [2.1, 2.4, 3.0, 4.0], "b": [0.1, 0.3, 0.5]}
    spec = atlas.Spec("two-mass", axes=axes, solve=schedule)
    return spec, solve_tile(spec.system, spec.cell_params(WHOLE), spec.settings)


def test_results_of_a_schedule_keep_all_rules(solved: Solved) -> None:
    spec, arrays = solved
    assert {NO_IMPACT, PERIODIC, CHAOTIC} <= set(arrays["regime"].ravel().tolist())
    assert broken_rules(spec, WHOLE, arrays) == {}


@pytest.mark.parametrize(
    ("name", "regime", "value", "rule"),
    [
        ("average", PERIODIC, np.nan, "average is NaN"),
        ("average", CHAOTIC, -1.0, "average is not the largest exponent of a chaotic cell"),
        ("largest", PERIODIC, 0.0, "largest is not below zero in a periodic cell"),
        ("largest", PERIODIC, 0.144, "largest is not below zero in a periodic cell"),
        ("largest", NO_IMPACT, 1e-9, "largest is above zero without impact"),
    ],
)
def test_an_exponent_that_cannot_be_is_found(solved: Solved, name: str, regime: int, value: float, rule: str) -> None:
    spec, arrays = solved
    wrong = arrays[name].copy()
    wrong[arrays["regime"] == regime] = value
    found = broken_rules(spec, WHOLE, arrays | {name: wrong})
    assert (found[rule] == (arrays["regime"] == regime)).all()


def test_an_orbit_without_any_spread_of_directions_may_lose_them_all(solved: Solved) -> None:
    """R = 0: an exponent of -infinity is below zero."""
    spec, arrays = solved
    lost = np.where(arrays["regime"] == PERIODIC, -np.inf, arrays["largest"])
    assert "largest is not below zero in a periodic cell" not in broken_rules(spec, WHOLE, arrays | {"largest": lost})
