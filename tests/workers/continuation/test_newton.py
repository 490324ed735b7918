"""Claims about where Newton's method of orbits and curves ends, on problems whose rounding is known or made up."""

import numpy as np
import pytest

from workers.continuation.newton import UNCERTAIN, NewtonResult, newton
from workers.model.oscillator import Array, Rows

EPS = float(np.finfo(np.float64).eps)
RNG = np.random.default_rng(3)
SIZE = 5


def solved(A: Array, root: Array, start: Array) -> NewtonResult:
    """Newton's method on A (sin x - sin root) = 0, N problems of five unknowns."""

    def values(X: Array, rows: Rows) -> Array:
        return np.asarray((A[rows] @ np.sin(X)[..., None])[..., 0] - (A[rows] @ np.sin(root[rows])[..., None])[..., 0])

    def with_jacobian(X: Array, rows: Rows) -> tuple[Array, Array]:
        return values(X, rows), A[rows] * np.cos(X)[:, None]

    return newton(values, with_jacobian, start, np.ones_like(root))


def matrices(count: int, condition: float) -> Array:
    """Random matrices (count, 5, 5) of a condition number."""
    left, right = (np.linalg.qr(RNG.normal(size=(count, SIZE, SIZE)))[0] for _ in range(2))
    return np.asarray(left * np.geomspace(1.0, 1.0 / condition, SIZE) @ right)


def test_ill_conditioned_problems_end_where_what_is_to_vanish_is_rounding() -> None:
    """Their steps stay above what a step that is rounding may have."""
    root = RNG.uniform(0.3, 1.0, (200, SIZE))
    found = solved(matrices(200, 1e7), root, root + RNG.uniform(-1e-3, 1e-3, root.shape))
    assert found.converged.all()
    error = np.max(np.abs(found.X - root), axis=1)
    assert 1e-11 < np.median(error) < 1e-8


def test_well_conditioned_problems_end_at_rounding() -> None:
    root = RNG.uniform(0.3, 1.0, (200, SIZE))
    found = solved(matrices(200, 10.0), root, root + RNG.uniform(-1e-2, 1e-2, root.shape))
    assert found.converged.all()
    assert np.max(np.abs(found.X - root)) < 1e-13


def test_a_least_value_that_is_no_solution_does_not_converge() -> None:
    """x^2 + c, of which c is small: steps cease to shrink, and what is to vanish is not rounding of its terms."""
    c = np.geomspace(1e-12, 1e-2, 50)[:, None]
    start = np.full_like(c, 0.5)
    found = newton(
        lambda X, rows: X**2 + c[rows],
        lambda X, rows: (X**2 + c[rows], 2.0 * X[..., None]),
        start,
        np.ones_like(start),
    )
    assert not found.converged.any()


@pytest.mark.parametrize("slope", [1e-4, 1e-250, 5e-324])
def test_a_first_step_of_any_length_ends_the_method_without_a_warning(slope: float) -> None:
    """slope x = 1 from x = 0: its only root is farther than roots are looked for, at last beyond all doubles."""

    def values(X: Array, rows: Rows) -> Array:
        return slope * X - 1.0

    start = np.zeros((1, 1))
    found = newton(values, lambda X, rows: (values(X, rows), np.full((1, 1, 1), slope)), start, np.ones((1, 1)))
    assert not found.converged[0]
    assert found.steps == 1
    assert found.X[0, 0] == 0.0


def test_a_root_at_which_the_jacobian_is_singular_does_not_converge_where_its_steps_are_long() -> None:
    """A condition number of 1e12: what is to vanish is rounding within a thousandth of the root."""
    root = RNG.uniform(0.3, 1.0, (50, SIZE))
    found = solved(matrices(50, 1e12), root, root + RNG.uniform(-1e-2, 1e-2, root.shape))
    error = np.max(np.abs(found.X - root), axis=1)
    assert np.max(error[found.converged], initial=0.0) < 1e-4
    assert not found.converged.all()


def rounded(condition: float, errors: float) -> NewtonResult:
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
