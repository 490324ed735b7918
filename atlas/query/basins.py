"""Basins of attraction: the table of their attractors, shares, entropy and uncertainty.

Shares        of the initial states of the plane that are not beyond a stop, with 95 % Wilson intervals.
Entropy       (Daza et al., Sci. Rep. 6 (2016) 31416) the plane is cut into boxes of BOX x BOX initial states; a box has
              the Gibbs entropy S = -sum p ln p over the shares p of the labels in it. S_b is the mean over all boxes,
              S_bb that over the boxes with more than one label; their errors are standard errors of these means.
              Labels not known count as a label of their own. S_bb > ln 2 shows that a boundary is fractal.
Uncertainty   (McDonald et al., Physica D 17 (1985) 125) an initial state is uncertain at distance e where the one e
              farther along an axis, either way, has another label. Their share f(e) falls as e^alpha; the dimension of
              the boundary is the plane's less alpha: 1 for a smooth curve, alpha = 1. alpha is the slope of ln f over
              ln e by least squares, with the binomial errors of the shares; its error is that of the fit, times the
              root of chi^2 per degree of freedom where that is above 1. Both axes count in initial states.
              Where labels are mixed, f cannot grow any more: of labels of shares p drawn at random it is
              1 - sum p^(1 + 2 axes). Distances where f is above a SATURATED part of that are left out, and where fewer
              than LEAST_DISTANCES are left there is no exponent: the boundary is finer than the initial states.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.query.attractors import attractor_in_words
from atlas.query.open import handle_of, open_table
from atlas.query.window import Window, axis_names, select_window
from atlas.store.groups import ATTRACTORS, group_attributes
from workers.attractors.initial_states import wilson
from workers.results import ATTRACTOR, INVALID, LABEL, PENDING, REGIME, SETTLED

if TYPE_CHECKING:
    import xarray as xr

BOX = 5
"""Initial states along each side of a box."""
DISTANCES = (1, 2, 3, 4, 6, 8, 12, 16)
"""Distances, in initial states, at which uncertainty is measured; up to an eighth of the shorter side."""
MIN_DISTANCES = 3
SATURATED = 0.25
"""Uncertain share, of that of labels at random, above which the power law bends; its slope is an eighth less there."""

Labels = NDArray[np.int64]


def is_basin_atlas(ds: "xr.Dataset") -> bool:
    """Whether a dataset says which attractor each initial state of a plane reaches."""
    return SETTLED.name in ds


def table(ds: "xr.Dataset") -> "xr.Dataset":
    """The attractors of an atlas of basins by their labels, as a dataset, read.

    InputError where it is no such atlas, or not complete.
    """
    if not is_basin_atlas(ds):
        raise InputError("not an atlas of basins: its axes must be initial states, and its spec must have [attractors]")
    handle = handle_of(ds)
    if group_attributes(handle, ATTRACTORS) is None:
        raise InputError(f"{handle.backend}: has no table of attractors yet; run it to its end")
    return open_table(handle, ATTRACTORS).load()


def basins(ds: "xr.Dataset", window: Window | None = None) -> dict[str, Any]:
    """Measures of the basins in a plane of initial states, or in a window of it.

    ``attractors``: an entry for each by its label with its results, ``share`` and its interval in the window, and
    ``mirror``; ``unknown``: the share without a label; ``entropy`` and ``boundary_entropy``, ``uncertainty`` (alpha)
    and ``boundary_dimension``, each with ``_error``, NaN where there is too little to tell: ``uncertainty_reason`` says
    why there is no alpha. See the module's text.
    Raises InputError as ``table`` and for an unknown axis.
    """
    known, shown = table(ds), select_window(ds, window)
    labels, regime = shown[LABEL.name].values.astype(np.int64), shown[REGIME.name].values
    solved = ~np.isin(regime, (INVALID, PENDING))
    count = int(solved.sum())
    entries: list[dict[str, Any]] = []
    for k in range(known.sizes[ATTRACTOR]):
        one = known.isel({ATTRACTOR: k})
        names = [name for name in one.data_vars if name not in ("points", "section", "cells")]
        hits = int(np.count_nonzero(labels == k))
        low, high = wilson(hits, max(count, 1))
        values = {str(name): one[name].values.tolist() for name in names}
        values |= {"share": hits / max(count, 1), "share_low": float(low), "share_high": float(high)}
        entries.append({LABEL.name: k} | attractor_in_words(values))
    unknown = float(np.count_nonzero(solved & (labels < 0)) / max(count, 1))
    answer: dict[str, Any] = {"starts": count, "unknown": unknown}
    for name, pair in zip(("entropy", "boundary_entropy"), basin_entropy(labels, solved), strict=True):
        answer |= {name: pair[0], f"{name}_error": pair[1]}
    alpha, error, reason = uncertainty_exponent(labels, solved)
    dimension = len(axis_names(ds)) - alpha
    answer |= {"uncertainty": alpha, "uncertainty_error": error, "uncertainty_reason": reason}
    return answer | {"boundary_dimension": dimension, "boundary_dimension_error": error, "attractors": entries}


def basin_entropy(
    labels: Labels, solved: NDArray[np.bool_], box: int = BOX
) -> tuple[tuple[float, float], tuple[float, float]]:
    """(S_b, its error) and (S_bb, its error) of labels over a plane or a line; boxes with unsolved starts are left out.

    >>> stripes = np.repeat([0, 1], 10)[None, :].repeat(20, axis=0)
    >>> basin_entropy(stripes, stripes >= 0)[0]
    (0.0, 0.0)
    """
    sides = [n // box for n in labels.shape]
    if min(sides) < 1:
        return (np.nan, np.nan), (np.nan, np.nan)
    cut = tuple(slice(0, n * box) for n in sides)
    split = [part for n in sides for part in (n, box)]
    order = [*range(0, 2 * labels.ndim, 2), *range(1, 2 * labels.ndim, 2)]
    boxes = labels[cut].reshape(split).transpose(order).reshape(int(np.prod(sides)), -1)
    whole = solved[cut].reshape(split).transpose(order).reshape(len(boxes), -1).all(axis=1)
    boxes = boxes[whole]
    entropy = np.zeros(len(boxes))
    for label in np.unique(boxes):
        share = (boxes == label).mean(axis=1)
        entropy -= np.where(share > 0.0, share * np.log(np.where(share > 0.0, share, 1.0)), 0.0)
    entropy = np.abs(entropy)
    return _mean(entropy), _mean(entropy[entropy > 0.0])


def uncertainty_exponent(labels: Labels, solved: NDArray[np.bool_]) -> tuple[float, float, str]:
    """alpha, its error, and why there is none, NaN; an empty reason where there is one. See the module's text."""
    shares = np.unique(labels[solved], return_counts=True)[1] / max(int(np.count_nonzero(solved)), 1)
    limit = SATURATED * (1.0 - float(np.sum(shares ** (1 + 2 * labels.ndim))))
    rows = [(e, *_uncertain(labels, solved, e)) for e in DISTANCES if e <= min(labels.shape) // 8]
    distance, part, counted = np.array(rows, dtype=np.float64).reshape(-1, 3).T
    if not np.any(part > 0.0):
        return float("nan"), float("nan"), "no initial state is uncertain"
    fitted = (part > 0.0) & (part <= limit)
    if np.count_nonzero(fitted) < MIN_DISTANCES:
        reason = (
            f"{100 * part[0]:.3g} % of the initial states are uncertain at distance 1, and a power law needs "
            f"{MIN_DISTANCES} distances with at most {100 * limit:.3g} %; take a finer or a smaller plane"
        )
        return float("nan"), float("nan"), reason
    x, f = np.log(distance[fitted]), part[fitted]
    weights = counted[fitted] * f / (1.0 - f)  # of ln f
    x, y = (values - np.average(values, weights=weights) for values in (x, np.log(f)))
    spread = float((weights * x * x).sum())
    alpha = float((weights * x * y).sum()) / spread
    misfit = float((weights * (y - alpha * x) ** 2).sum()) / (len(x) - 2)
    return alpha, float(np.sqrt(max(1.0, misfit) / spread)), ""


def _uncertain(labels: Labels, solved: NDArray[np.bool_], e: int) -> tuple[float, int]:
    """The share of initial states that are uncertain at distance e, and of how many."""
    uncertain, counted = np.zeros(labels.shape, dtype=bool), np.zeros(labels.shape, dtype=bool)
    for dim in range(labels.ndim):
        here = tuple(slice(None, -e) if k == dim else slice(None) for k in range(labels.ndim))
        there = tuple(slice(e, None) if k == dim else slice(None) for k in range(labels.ndim))
        both = solved[here] & solved[there]
        other = both & (labels[here] != labels[there])
        for part in (here, there):
            uncertain[part] |= other
            counted[part] |= both
    count = int(np.count_nonzero(counted))
    return int(np.count_nonzero(uncertain)) / max(count, 1), count


def _mean(values: NDArray[np.float64]) -> tuple[float, float]:
    """A mean and its standard error."""
    if not values.size:
        return 0.0, 0.0
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(values.size)) if values.size > 1 else float("nan")
