"""Claims about where Newton's method ends, on problems whose rounding is made up."""

import numpy as np
import pytest

from workers.continuation.newton import UNCERTAIN, Solved, newton

EPS = float(np.finfo(np.float64).eps)


def rounded(condition: float, errors: float) -> Solved:
    """From near (1, 1), the solution of x = 1 and x + (y - 1) / condition = 1.

    The second is evaluated ``errors`` units in the last place too high, then as much too low, and so on.
    """
    J, calls = np.array([[[1.0, 0.0], [1.0, 1.0 / condition]]]), 0

    def values(X: np.ndarray, rows: np.ndarray) -> np.ndarray:
        nonlocal calls
        calls += 1
        x, y = X.T - 1.0
        return np.stack([x, x + y / condition - errors * EPS * (-1.0) ** calls], axis=1)

    start = np.array([[1.0, 1.0 + 1.5 * errors * EPS * condition]])
    return newton(values, lambda X, rows: (values(X, rows), J.copy()), start, np.ones((1, 2)))


@pytest.mark.parametrize("condition", [1e6, 1e7])
def test_an_ill_conditioned_problem_is_solved_to_its_rounding(condition: float) -> None:
    found = rounded(condition, 1.0)
    assert found.converged[0]
    assert found.X[0] == pytest.approx([1.0, 1.0], abs=2.0 * EPS * condition)


@pytest.mark.parametrize("condition", [1e9, 1e11, 1e13])
def test_a_solution_that_rounding_leaves_open_is_none(condition: float) -> None:
    """Its residual is rounding wherever the method goes; each step is longer than UNCERTAIN."""
    assert 2.0 * EPS * condition > UNCERTAIN
    assert not rounded(condition, 1.0).converged[0]


def test_a_residual_above_rounding_is_no_solution() -> None:
    assert not rounded(1e6, 100.0).converged[0]


def test_an_infinite_jacobian_is_none() -> None:
    """Warnings are errors."""
    J, known = np.array([[[np.inf, 1.0], [0.0, 1.0]]]), np.ones((1, 2))
    found = newton(lambda X, rows: known, lambda X, rows: (known, J.copy()), np.array([[0.0, 1.0]]), np.ones((1, 2)))
    assert not found.converged[0]
