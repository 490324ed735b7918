"""Newton's method on a stack of N problems of one kind; one problem is N = 1."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from workers.model.block_decomposition import apply_stacked
from workers.model.oscillator import Array, Rows

NEWTON_STEPS = 12

DONE, ROUNDING = 1e-14, 1e-10
"""Expected distance from the solution at which Newton's method ends; largest step that may be rounding. In units of the
scale, as all lengths here."""

BACKWARD = 16.0 * float(np.finfo(np.float64).eps)
"""Share of its terms' size below which a residual is rounding; steps of ill-conditioned problems are longer then."""

UNCERTAIN = 1e-7
"""Step from which on a solution is not known, even if residuals are rounding: other orbits may be as near."""
JACOBIAN_REUSE_STEP = 1e-4
"""Step after which the Jacobian is kept."""


class NewtonResult(NamedTuple):
    """Outcomes of Newton's method: unknowns (N, U), Jacobians near them (N, E, U), the number of steps, and a mask of
    problems that converged (N,). Of one problem without the first axis.
    """

    X: Array
    jacobian: Array
    steps: int
    converged: Any


def newton(
    values: Callable[[Array, Rows], Array],
    with_jacobian: Callable[[Array, Rows], tuple[Array, Array]],
    X: Array,
    scale: Array,
    row: Array | None = None,
    farthest: float = 1.0,
    sizes: Array | None = None,
) -> NewtonResult:
    """Newton's method from X (N, U).

    values, with_jacobian  residuals (B, E) at unknowns (B, U) of problems (B,), and their derivatives (B, E, U)
    scale (N, U)           of the unknowns
    row (U,)               a direction in which nothing changes, where there is one unknown more than equations
    farthest               first step from which on no solution is looked for: it would hardly be the one near X
    sizes (N, E)           of terms of the residuals that no unknown tells, whose rounding they have
    A Jacobian is kept for a step where the last one gained two digits. A problem ends where its next step would be
    below DONE, or where steps no longer shrink because steps or residuals are rounding. It fails where steps do
    not shrink otherwise or stay UNCERTAIN, and at a singular matrix.
    """
    X, last, converged = X.copy(), np.full(len(X), np.inf), np.zeros(len(X), dtype=np.bool_)
    rows, step = np.arange(len(X)), 0
    known, J = with_jacobian(X, rows)
    while len(rows) and step < NEWTON_STEPS:
        step += 1
        change = _solved(J[rows] * scale[rows, None], -known, row, scale[rows])
        size, before = np.max(np.abs(change), axis=1, initial=0.0), last[rows]
        with np.errstate(all="ignore"):  # J may be infinite
            terms = np.vecdot(np.abs(J[rows]), np.abs(X[rows, None]))
            terms = terms if sizes is None else terms + sizes[rows]
        exact = np.all(np.abs(known) <= BACKWARD * terms, axis=1) & (size < UNCERTAIN)
        good = size < np.minimum(farthest, 2.0 * before)
        X[rows[good]] += (change * scale[rows])[good]
        ratio = np.minimum(size / before if step > 1 else np.sqrt(size), 1.0)
        stalled = (step > 1) & (size > 0.3 * before)
        done = (good & (size * np.maximum(ratio, 1e-7) < DONE)) | (stalled & (exact | (good & (size < ROUNDING))))
        converged[rows[done]], last[rows] = True, size
        on = good & ~done
        stale = (size > JACOBIAN_REUSE_STEP) & ((step == 1) | (size > 1e-2 * before))
        rows = rows[on]
        if np.any(stale[on]):
            known, J[rows] = with_jacobian(X[rows], rows)
        elif len(rows):
            known = values(X[rows], rows)
    return NewtonResult(X, J, step, converged)


def _solved(J: Array, right: Array, row: Array | None, scale: Array) -> Array:
    """The steps (N, U) of each system, in units of the scale; NaN where it is singular."""
    if row is not None:
        J = np.concatenate([J, (row * scale)[:, None]], axis=1)
        right = np.concatenate([right, np.zeros((len(right), 1))], axis=1)
    return np.asarray(apply_stacked(np.linalg.solve, (*right.shape, 1), J, right[..., None])[..., 0])
