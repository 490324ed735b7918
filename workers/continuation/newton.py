"""Newton's method for N systems of equations of one kind at once; a single system is N = 1."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from workers.model.block_decomposition import apply_stacked
from workers.model.oscillator import Array, Rows

NEWTON_STEPS = 12

DONE, ROUNDING_STEP = 1e-14, 1e-10
"""Expected distance from the solution at which Newton's method ends; longest step that may be rounding. Both are in
units of the scale, as all lengths in this module."""

BACKWARD = 16.0 * float(np.finfo(np.float64).eps)
"""Share of the size of its terms below which a residual is rounding; steps of ill-conditioned problems are longer then.
"""

UNCERTAIN = 1e-7
"""Length of a step from which on a solution is not certain, even if residuals are rounding: other orbits may be as
near."""
JACOBIAN_REUSE_STEP = 1e-4
"""Length of a step up to which the Jacobian is kept."""


class NewtonResult(NamedTuple):
    """The result of Newton's method; for one problem without the first axis.

    X          (N, U) unknowns
    jacobian   (N, E, U) Jacobians near them
    steps      number of steps
    converged  (N,) mask of problems that converged
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
    """Return the result of Newton's method from X (N, U).

    values         function: residuals (B, E) at unknowns (B, U) of the problems (B,)
    with_jacobian  function: residuals, and their derivatives (B, E, U)
    scale          (N, U) scale of the unknowns
    row            (U,) weights of a sum of unknowns that stays constant, if there is one unknown more than equations
    farthest       length of the first step from which on the search fails: a solution would hardly be the one near X
    sizes          (N, E) sizes of terms of the residuals that depend on no unknown, for the rounding of residuals

    A Jacobian is kept for a step if the last step gained two digits. A problem ends if its next step would be below
    DONE, or if steps no longer shrink because steps or residuals are rounding. It fails if steps do not shrink for
    another reason or stay UNCERTAIN, and at a singular matrix.
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
        finished = (good & (size * np.maximum(ratio, 1e-7) < DONE)) | (
            stalled & (exact | (good & (size < ROUNDING_STEP)))
        )
        converged[rows[finished]], last[rows] = True, size
        on = good & ~finished
        stale = (size > JACOBIAN_REUSE_STEP) & ((step == 1) | (size > 1e-2 * before))
        rows = rows[on]
        if np.any(stale[on]):
            known, J[rows] = with_jacobian(X[rows], rows)
        elif len(rows):
            known = values(X[rows], rows)
    return NewtonResult(X, J, step, converged)


def _solved(J: Array, right: Array, row: Array | None, scale: Array) -> Array:
    """Return the steps (N, U) of each system, in units of the scale; NaN for a singular system."""
    if row is not None:
        J = np.concatenate([J, (row * scale)[:, None]], axis=1)
        right = np.concatenate([right, np.zeros((len(right), 1))], axis=1)
    return np.asarray(apply_stacked(np.linalg.solve, (*right.shape, 1), J, right[..., None])[..., 0])
