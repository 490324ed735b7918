"""Measures of basins of attraction: the table of their attractors, their shares, entropy and uncertainty exponent.

Shares       Shares of the initial states of the plane that are not beyond a stop, with 95 % Wilson intervals.
Entropy      (Daza et al., Sci. Rep. 6 (2016) 31416) The plane is divided into boxes of BOX x BOX initial states. The
             Gibbs entropy of a box is S = -sum p ln p over the shares p of the labels in it. S_b is the mean over all
             boxes, S_bb the mean over the boxes with more than one label; their errors are the standard errors of these
             means. Unknown labels count as one label. S_bb > ln 2 shows that a boundary is fractal.
Uncertainty  (McDonald et al., Physica D 17 (1985) 125) An initial state is uncertain at distance e if an initial state
             e farther along an axis, in either direction, has another label. The share of uncertain initial states is
             f(e) ~ e^alpha. The dimension of the boundary is the dimension of the plane minus alpha; a smooth curve has
             alpha = 1 and dimension 1. alpha is the slope of ln f over ln e by least squares, weighted with the
             binomial errors of the shares. Its error is the error of the fit, times the root of chi^2 per degree of
             freedom if chi^2 per degree of freedom exceeds 1. Distances are counted in initial states along both axes.
             Where labels are mixed, f saturates: labels drawn at random with shares p have f = 1 - sum p^(1 + 2 axes).
             Distances at which f exceeds SATURATED times that value are left out. With fewer than MIN_DISTANCES
             distances there is no exponent: the boundary is finer than the initial states.
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
"""Number of initial states along each side of a box."""
DISTANCES = (1, 2, 3, 4, 6, 8, 12, 16)
"""Distances, in initial states, at which uncertainty is measured; at most an eighth of the shorter side is used."""
MIN_DISTANCES = 3
SATURATED = 0.25
"""Maximum share of uncertain initial states in a fit, relative to the share for labels drawn at random.

At this share the slope of the power law is an eighth too small.
"""

Labels = NDArray[np.int64]


def is_basin_atlas(ds: "xr.Dataset") -> bool:
    """Return True if a dataset is an atlas of basins: initial states, each with the attractor that it reaches."""
    return SETTLED.name in ds


def table(ds: "xr.Dataset") -> "xr.Dataset":
    """Return the attractors of an atlas of basins, by label, as a loaded dataset.

    Raise InputError if ``ds`` is not a complete atlas of basins.
    """
    if not is_basin_atlas(ds):
        raise InputError("not an atlas of basins: its axes must be initial states, and its spec must have [attractors]")
    handle = handle_of(ds)
    if group_attributes(handle, ATTRACTORS) is None:
        raise InputError(f"{handle.backend}: the table of attractors is missing; finish the run first")
    return open_table(handle, ATTRACTORS).load()


def basins(ds: "xr.Dataset", window: Window | None = None) -> dict[str, Any]:
    """Return measures of the basins in a plane of initial states, or in a window of it.

    Raise InputError as ``table`` does, and for an unknown axis. The keys are:

    starts              number of solved initial states
    unknown             share of initial states without a label
    entropy             S_b, the mean entropy of all boxes
    boundary_entropy    S_bb, the mean entropy of boxes with more than one label
    uncertainty         the exponent alpha
    uncertainty_reason  why there is no alpha; empty if there is
    boundary_dimension  dimension of the boundary
    attractors          a dict for each attractor: its label, its results, ``mirror``, and ``share`` with its interval
                        in the window

    Entropies, ``uncertainty`` and ``boundary_dimension`` have errors, under their keys with ``_error`` appended. Values
    are NaN if there are too few data. The header of this module defines all measures.
    """
    known, window_cells = table(ds), select_window(ds, window)
    labels, regime = window_cells[LABEL.name].values.astype(np.int64), window_cells[REGIME.name].values
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


def basin_measures(ds: "xr.Dataset", window: Window | None = None) -> "xr.Dataset":
    """Return the measures of ``basins`` as a dataset: numbers, and the results of the attractors along ``label``."""
    import pandas as pd
    import xarray

    measures = basins(ds, window)
    entries = [{k: v for k, v in entry.items() if not isinstance(v, list)} for entry in measures.pop("attractors")]
    attractors = pd.DataFrame(entries).set_index(LABEL.name).to_xarray() if entries else xarray.Dataset()
    return attractors.assign(measures)


def basin_entropy(
    labels: Labels, solved: NDArray[np.bool_], box: int = BOX
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the basin entropies (S_b, its error) and (S_bb, its error) of labels over a plane or a line.

    labels   labels of the attractors that initial states on a grid reach; negative if unknown
    solved   mask of the initial states that are solved
    box      number of initial states along each side of a box

    Boxes with unsolved initial states are left out. The header of this module defines the entropies.

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
    all_solved = solved[cut].reshape(split).transpose(order).reshape(len(boxes), -1).all(axis=1)
    boxes = boxes[all_solved]
    entropy = np.zeros(len(boxes))
    for label in np.unique(boxes):
        share = (boxes == label).mean(axis=1)
        entropy -= np.where(share > 0.0, share * np.log(np.where(share > 0.0, share, 1.0)), 0.0)
    entropy = np.abs(entropy)
    return _mean(entropy), _mean(entropy[entropy > 0.0])


def uncertainty_exponent(labels: Labels, solved: NDArray[np.bool_]) -> tuple[float, float, str]:
    """Return the uncertainty exponent alpha, its error, and the reason why there is none.

    labels   labels of the attractors that initial states on a grid reach; negative if unknown
    solved   mask of the initial states that are solved

    With a reason both numbers are NaN; otherwise the reason is empty. The header of this module defines alpha.
    """
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
    """Return the share of initial states with another label at distance ``e`` along an axis, and their number.

    The number counts all initial states that were compared.
    """
    uncertain, counted = np.zeros(labels.shape, dtype=bool), np.zeros(labels.shape, dtype=bool)
    for dim in range(labels.ndim):
        lower_slices = tuple(slice(None, -e) if k == dim else slice(None) for k in range(labels.ndim))
        upper_slices = tuple(slice(e, None) if k == dim else slice(None) for k in range(labels.ndim))
        both = solved[lower_slices] & solved[upper_slices]
        other = both & (labels[lower_slices] != labels[upper_slices])
        for part in (lower_slices, upper_slices):
            uncertain[part] |= other
            counted[part] |= both
    count = int(np.count_nonzero(counted))
    return int(np.count_nonzero(uncertain)) / max(count, 1), count


def _mean(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return the mean of values and its standard error; 0 and 0 without values."""
    if not values.size:
        return 0.0, 0.0
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(values.size)) if values.size > 1 else float("nan")
