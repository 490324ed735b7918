"""Cells whose parameters floats can hold, and whose numbers they cannot: a value in the atlas, never a crash."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests import naive
from tests.fuzzing import fuzz
from workers import Settings, solve_tile, trace
from workers.model.system import find_system
from workers.results import ARITHMETIC, CHAOTIC, INVALID, reason_counts

TWO_MASS = find_system("two-mass")

QUICK = Settings(exponents="none", max_periods=20)
WAYS = [
    QUICK,
    Settings(exponents="spectrum", max_periods=400, section_samples=3),
    Settings(exponents="spectrum", method="fixed", transient_periods=0, periods=40),
]
SIZES = [0.0, 5e-324, 1e-310, 1e-300, 1e-160, 1e-20, 1.0, 1e20, 1e100, 1e154, 1e160, 1e300, 1.7976931348623157e308]

OVERFLOWING = [
    {"omega": 1e300},
    {"mu_m": 1e-160},
    {"mu_m": 1e-300, "zeta": 1e300},
    {"mu_k": 1e300},
    {"mu_k": 1e20, "zeta": 1e300},
    {"zeta": 1e154},
    {"zeta": 1e308},
    {"f2": 1.7e308},
    {"f2": -1e160},
    {"x2": 1.7e308},
    {"x2": -1e300, "b": 1.7e308},
    {"v1": 1e300},
    {"v2": -1.7e308},
]


@pytest.mark.parametrize("params", OVERFLOWING, ids=str)
def test_a_cell_whose_numbers_overflow_is_invalid(params: dict[str, float]) -> None:
    solved = solve_tile("two-mass", params, QUICK)
    assert solved["regime"] == INVALID
    (reason,) = reason_counts(solved["reason"])
    assert reason.endswith("beyond the range of double precision")


@pytest.mark.parametrize("params", OVERFLOWING, ids=str)
def test_the_history_of_such_a_cell_is_refused(params: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="beyond the range of double precision"):
        trace("two-mass", params, 2, QUICK)


@pytest.mark.parametrize("name", [parameter.name for parameter in TWO_MASS.parameters])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_parameter_that_is_not_finite_makes_an_invalid_cell(name: str, value: float) -> None:
    assert solve_tile("two-mass", {name: value}, QUICK)["regime"] == INVALID


def _extreme(name: str) -> st.SearchStrategy[float]:
    signed = [sign * size for size in SIZES for sign in (1.0, -1.0)]
    return st.sampled_from([value for value in signed if TWO_MASS.parameter(name).admits(value)])


@fuzz(examples=40)
@given(
    st.fixed_dictionaries({}, optional={p.name: _extreme(p.name) for p in TWO_MASS.parameters}), st.sampled_from(WAYS)
)
def test_no_finite_parameters_make_a_cell_raise_or_warn(params: dict[str, float], settings: Settings) -> None:
    """What cannot be followed has one of the solver's own reasons: no exception was caught on the way."""
    arrays = solve_tile("two-mass", params, settings)
    assert arrays["reason"] != ARITHMETIC
    assert np.all(np.isfinite(arrays["state"])) or np.all(np.isnan(arrays["state"]))


def test_a_tolerance_out_of_reach_costs_a_chaotic_cell_its_budget_and_not_its_class() -> None:
    settings = Settings(tolerance=1e-200, max_periods=3000)
    assert solve_tile("two-mass", naive.FIGURES[5], settings)["regime"] == CHAOTIC
