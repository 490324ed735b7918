"""Basins of attraction: the table of their attractors, their shares, and how mixed and how rough they are.

Shares        of the initial states of the plane that are not beyond a stop, with 95 % Wilson intervals.
Entropy       (Daza et al., Sci. Rep. 6 (2016) 31416) the plane is cut into boxes of BOX x BOX initial states; a box has
              the Gibbs entropy S = -sum p ln p over the shares p of the labels in it. S_b is the mean over all boxes,
              S_bb that over the boxes with more than one label; their errors are standard errors of these means.
              Labels not known count as a label of their own. S_bb > ln 2 shows that a boundary is fractal.
Uncertainty   (McDonald et al., Physica D 17 (1985) 125) an initial state is uncertain at distance e where the one e
              farther along an axis, either way, has another label. Their share f(e) falls as e^alpha; the dimension of
              the boundary is the plane's less alpha: 1 for a smooth curve, alpha = 1. alpha is the slope of ln f over
              ln e by least squares, its error that of the fit; both axes count in initial states.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from atlas.cell.attractors import in_words
from atlas.errors import InputError
from atlas.query.open import open_table
from atlas.query.window import Window, axis_names, within
from atlas.store.groups import group_attributes
from atlas.store.store import read_header
from atlas.store.tables import ATTRACTORS
from workers.results import ATTRACTOR, INVALID, LABEL, PENDING, REGIME, SETTLED
from workers.starts import wilson

if TYPE_CHECKING:
    import xarray as xr

BOX = 5
"""Initial states along each side of a box."""
DISTANCES = (1, 2, 3, 4, 6, 8, 12, 16)
"""Distances, in initial states, at which uncertainty is measured; up to an eighth of the shorter side."""
LEAST_DISTANCES = 3

Labels = NDArray[np.int64]


def of_basins(ds: "xr.Dataset") -> bool:
    """Whether a dataset says which attractor each initial state of a plane reaches."""
    return SETTLED.name in ds


def table(ds: "xr.Dataset") -> "xr.Dataset":
    """The attractors of an atlas of basins by their labels, as a dataset, read.

    InputError where it is no such atlas, or not complete.
    """
    source = ds.encoding.get("source")
    if not of_basins(ds) or not isinstance(source, str):
        raise InputError("this is no atlas of basins: its axes must be initial states, and its spec have [attractors]")
    header = read_header(source)
    if group_attributes(header, ATTRACTORS) is None:
        raise InputError(f"{header.place}: has no table of attractors yet; run it to its end")
    return open_table(header, ATTRACTORS).load()


def basins(ds: "xr.Dataset", window: Window | None = None) -> dict[str, Any]:
    """What a plane of initial states, or a window of it, says of its basins.

    ``attractors``: an entry for each by its label with its results, ``share`` and its interval in the window, and
    ``mirror``; ``unknown``: the share without a label; ``entropy`` and ``boundary_entropy``, ``uncertainty`` (alpha)
    and ``boundary_dimension``, each with ``_error``, NaN where there is too little to tell. See the module's text.
    Raises InputError as ``table`` and for an unknown axis.
    """
    known, shown = table(ds), within(ds, window)
    labels, regime = shown[LABEL.name].values.astype(np.int64), shown[REGIME.name].values
    solved = ~np.isin(regime, (INVALID, PENDING))
    count = int(solved.sum())
    found: list[dict[str, Any]] = []
    for k in range(known.sizes[ATTRACTOR]):
        one = known.isel({ATTRACTOR: k})
        names = [name for name in one.data_vars if name not in ("points", "section", "cells")]
        hits = int(np.count_nonzero(labels == k))
        low, high = wilson(hits, max(count, 1))
        values = {str(name): one[name].values.tolist() for name in names}
        values |= {"share": hits / max(count, 1), "share_low": float(low), "share_high": float(high)}
        found.append({LABEL.name: k} | in_words(values))
    unknown = float(np.count_nonzero(solved & (labels < 0)) / max(count, 1))
    answer: dict[str, Any] = {"starts": count, "unknown": unknown}
    for name, pair in zip(("entropy", "boundary_entropy"), basin_entropy(labels, solved), strict=True):
        answer |= {name: pair[0], f"{name}_error": pair[1]}
    alpha, error = uncertainty_exponent(labels, solved)
    dimension = len(axis_names(ds)) - alpha
    answer |= {"uncertainty": alpha, "uncertainty_error": error}
    return answer | {"boundary_dimension": dimension, "boundary_dimension_error": error, "attractors": found}


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


def uncertainty_exponent(labels: Labels, solved: NDArray[np.bool_]) -> tuple[float, float]:
    """alpha and its error; NaN where too few distances have uncertain starts. See the module's text."""
    farthest = min(labels.shape) // 8
    logs = []
    for e in (e for e in DISTANCES if e <= farthest):
        uncertain, counted = np.zeros(labels.shape, dtype=bool), np.zeros(labels.shape, dtype=bool)
        for dim in range(labels.ndim):
            here = tuple(slice(None, -e) if k == dim else slice(None) for k in range(labels.ndim))
            there = tuple(slice(e, None) if k == dim else slice(None) for k in range(labels.ndim))
            both = solved[here] & solved[there]
            other = both & (labels[here] != labels[there])
            for part in (here, there):
                uncertain[part] |= other
                counted[part] |= both
        share = int(np.count_nonzero(uncertain)) / max(int(np.count_nonzero(counted)), 1)
        if share > 0.0:
            logs.append((np.log(e), np.log(share)))
    if len(logs) < LEAST_DISTANCES:
        return float("nan"), float("nan")
    x, y = np.array(logs).T
    x = x - x.mean()
    alpha = float((x * y).sum() / (x * x).sum())
    rest = y - y.mean() - alpha * x
    return alpha, float(np.sqrt((rest**2).sum() / (len(x) - 2) / (x * x).sum()))


def _mean(values: NDArray[np.float64]) -> tuple[float, float]:
    """A mean and its standard error."""
    if not values.size:
        return 0.0, 0.0
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(values.size)) if values.size > 1 else float("nan")
