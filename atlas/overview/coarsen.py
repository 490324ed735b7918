"""Coarsening by two: from the arrays of cells to the arrays of an overview, whose cells cover two cells per dimension.

regime             the class with the largest area; a tie goes to the later one in the table of regimes, towards doubt
regime_shown       the class in pictures: failed if any cell below is, else pending if any is, else undetermined if at
                   least UNDETERMINED_SHARE of the area is (always true up to 4 x 4 cells), else ``regime``
regime_share       share of the area of every class
largest_positive   share of the finite largest exponents that are positive
cells              number of solved cells

Other variables of a level, that is of one overview:

- Measured numbers (exponents, errors, speeds) are means over the finite values, and ``<name>_count`` is their number.
  The mean is -inf if no value is finite and some are -inf.
- ``period``, ``impacts_upper`` and ``impacts_lower`` are the triple most frequent among the periodic cells, found in
  rounds of 2 x 2. ``period_count`` is the number of cells with this triple. A tie goes to the smallest triple. Every
  triple exists in a cell. The triple is 0 if no cell is periodic.
- Other numbers (costs) are means over the solved cells, and flags are shares of the solved cells.

Means, counts and shares are exact at every level, for the cells of the atlas.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.results import (
    APERIODIC,
    CHAOTIC,
    FAILED,
    LABEL,
    LARGEST,
    LOCKING,
    PENDING,
    PERIODIC,
    QUASIPERIODIC,
    REASON,
    REGIME,
    REGIMES,
    REGULAR,
    UNDETERMINED,
    Variable,
    of_one,
)

UNDETERMINED_SHARE = 1 / 16
"""Minimum share of undetermined cells below a coarse cell at which pictures show it as undetermined."""

CLASSES = ("period", "impacts_upper", "impacts_lower")
SHARE = Variable("regime_share", "float64", 0.0, "share of the area of each regime", "1", ("class",))
REGIME_SHOWN = Variable("regime_shown", "int8", PENDING, "regime of motion as pictures show it, doubt first", "1")
CELLS = Variable("cells", "int32", 0, "solved cells behind a coarse cell", "1")
POSITIVE = Variable("largest_positive", "float64", np.nan, "share of positive values among the finite ones", "1")
PERIOD_COUNT = Variable("period_count", "int32", 0, "cells behind period and impacts", "1")
CODES = np.array([regime.code for regime in REGIMES], dtype=np.int8)
"""Code of the regime at each position along the dimension "class"."""
_PLACES = {APERIODIC: CHAOTIC + 0.5, LOCKING: PERIODIC + 0.5, REGULAR: QUASIPERIODIC + 0.5}
_TOWARDS_DOUBT = np.array(sorted(range(CODES.size), key=lambda i: _PLACES.get(int(CODES[i]), float(CODES[i]))))
"""Positions along the dimension "class" in the order in which ties are decided, the later one winning.

It is the order of the table of regimes, but ``aperiodic`` follows ``chaotic``, ``locking`` follows ``periodic``, and
``regular`` follows ``quasiperiodic``.
"""

WITHOUT_MEAN = (REASON.name, REGIME.name, LABEL.name, "own_attractor", "mirror")
"""Names of the results that are codes or indices, so that a mean over cells has no meaning."""

Cells = dict[str, NDArray[Any]]
Widths = tuple[NDArray[np.float64], ...]


def level_variables(results: Iterable[Variable]) -> tuple[Variable, ...]:
    """Return the variables of every overview of an atlas whose cells have these results.

    ``regime`` comes last, since it is written last. Codes of names, such as a reason, and variables with several values
    per cell have no mean and are omitted.
    """
    variables: list[Variable] = []
    for variable in map(of_one, results):
        if variable.extra_dims or variable.name in WITHOUT_MEAN:
            continue
        if variable.name in CLASSES:
            variables.append(variable)
        else:
            name = "share of cells" if variable.dtype == "bool" else "mean"
            variables.append(replace(variable, dtype="float64", fill=np.nan, long_name=f"{variable.long_name}: {name}"))
        if variable.dtype == "float64":
            counted = f"finite values of {variable.name}"
            variables.append(Variable(count_of(variable.name), "int32", 0, counted, "1"))
        if variable.name == LARGEST.name:
            variables.append(POSITIVE)
    return (*variables, PERIOD_COUNT, CELLS, SHARE, REGIME_SHOWN, REGIME)


def count_of(name: str) -> str:
    """Return the name of the variable that counts the finite values of a measured number."""
    return f"{name}_count"


def required_variables(variables: Iterable[Variable], names: Iterable[str]) -> list[str]:
    """Return the names of all variables of an overview that are needed to coarsen the named ones, in their order."""
    required = {*names, SHARE.name, REGIME.name}
    if required & {*CLASSES, PERIOD_COUNT.name}:
        required |= {*CLASSES, PERIOD_COUNT.name}
    if POSITIVE.name in required:
        required.add(LARGEST.name)
    required |= {name.removesuffix("_count") for name in required}
    required |= {count_of(name) for name in required} | {CELLS.name}
    return [variable.name for variable in variables if variable.name in required]


def from_cells(arrays: Mapping[str, NDArray[Any]], names: Iterable[str]) -> Cells:
    """Convert results of the atlas's cells to the variables of an overview: means of one value, shares of 0 and 1.

    ``names`` are the variables to convert. A cell without a regime has no result yet, even if a worker has written
    other variables.
    """
    codes = arrays[REGIME.name]
    solved, periodic = codes != PENDING, codes == PERIODIC
    level: Cells = {REGIME.name: codes, REGIME_SHOWN.name: codes}
    for name in set(names) - level.keys():
        if name == SHARE.name:
            level[name] = (codes[..., None] == CODES).astype(np.float64)
        elif name == CELLS.name:
            level[name] = solved.astype(np.int32)
        elif name == PERIOD_COUNT.name:
            level[name] = periodic.astype(np.int32)
        elif name == POSITIVE.name:
            largest = arrays[LARGEST.name]
            level[name] = np.where(solved & np.isfinite(largest), (largest > 0).astype(np.float64), np.nan)
        elif name in CLASSES:
            level[name] = np.where(periodic, arrays[name], 0).astype(np.int32)
        elif name in arrays:
            level[name] = np.where(solved, arrays[name], np.nan).astype(np.float64)
        else:
            level[name] = (solved & np.isfinite(arrays[name.removesuffix("_count")])).astype(np.int32)
    return level


def coarsen(cells: Cells, widths: Widths, along: Sequence[int] = (0, 1)) -> Cells:
    """Return the variables of the next coarser level of a block: half as many cells along some dimensions, rounded up.

    cells    arrays of the cells, with all variables of ``required_variables``
    widths   widths of the cells, one array per dimension, in any unit; only their ratios count
    along    dimensions to coarsen
    """
    area = np.ones(())
    for width in widths:
        area = area[..., None] * width
    dims = [dim for dim in along if dim < area.ndim]
    areas = _below(area, dims, 0.0)
    share = _below(cells[SHARE.name], dims, 0.0)
    solved = _below(cells[CELLS.name], dims, 0)
    level: Cells = {
        SHARE.name: (share * areas[..., None]).sum(0) / areas.sum(0)[..., None],
        CELLS.name: solved.sum(0, dtype=np.int32),
    }
    if PERIOD_COUNT.name in cells:
        level |= _most_frequent(cells, dims)
    for name in cells.keys() - level.keys() - {REGIME.name, REGIME_SHOWN.name}:
        if name.endswith("_count"):
            level[name] = _below(cells[name], dims, 0).sum(0, dtype=np.int32)
            continue
        counted = LARGEST.name if name == POSITIVE.name else name
        counts = _below(cells[count_of(counted)], dims, 0) if count_of(counted) in cells else solved
        level[name] = _mean(_below(cells[name], dims, np.nan), counts)
    level[REGIME.name] = _largest_class(level[SHARE.name])
    level[REGIME_SHOWN.name] = _shown(level[SHARE.name], level[REGIME.name])
    return level


def halve_widths(width: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the widths of the next coarser level's cells along a dimension: sums of two widths."""
    return np.add.reduceat(width, np.arange(0, width.size, 2))


def _below(values: NDArray[Any], dims: Sequence[int], fill: float) -> NDArray[Any]:
    """Return the values of the cells that each coarse cell covers, along a new first axis: 2 per coarsened dimension.

    Cells missing at the far end have the value ``fill``.
    """
    odd = [(0, n % 2 if dim in dims else 0) for dim, n in enumerate(values.shape)]
    below = [np.pad(values, odd, constant_values=fill) if any(after for _, after in odd) else values]
    for dim in dims:
        before = (slice(None),) * dim
        below = [block[(*before, slice(start, None, 2))] for block in below for start in (0, 1)]
    return np.stack(below)


def _mean(values: NDArray[Any], counts: NDArray[Any]) -> NDArray[np.float64]:
    total = counts.sum(0)
    mean = np.where(counts > 0, values, 0.0)
    mean = (mean * counts).sum(0) / np.maximum(total, 1)
    none = np.where((values == -np.inf).any(0), -np.inf, np.nan)
    return np.where(total > 0, mean, none)


def _most_frequent(cells: Cells, dims: Sequence[int]) -> Cells:
    """Return the triple of period and impacts that most cells have below each coarse cell, and the number of these
    cells.
    """
    counts = _below(cells[PERIOD_COUNT.name], dims, 0)
    triples = np.stack([_below(cells[name], dims, 0) for name in CLASSES])
    same = (triples[:, :, None] == triples[:, None, :]).all(0)
    votes = (same * counts[None]).sum(1) * (counts > 0)
    most = votes == votes.max(0)
    # Ties go to the smallest: first by period, then by impacts.
    for values in triples:
        least = np.where(most, values, np.iinfo(np.int32).max).min(0)
        most &= values == least
    winner = most.argmax(0)[None]
    frequent: Cells = {
        name: np.take_along_axis(values, winner, 0)[0] for name, values in zip(CLASSES, triples, strict=True)
    }
    return frequent | {PERIOD_COUNT.name: np.take_along_axis(votes, winner, 0)[0].astype(np.int32)}


def _largest_class(share: NDArray[np.float64]) -> NDArray[np.int8]:
    # Shares that differ by rounding are equal; the last of the largest wins.
    tied = share >= share.max(-1, keepdims=True) - 1e-9
    last_first = _TOWARDS_DOUBT[::-1]
    return CODES[last_first[tied[..., last_first].argmax(-1)]]


def _shown(share: NDArray[np.float64], regime: NDArray[np.int8]) -> NDArray[np.int8]:
    of = {code: share[..., i] for i, code in enumerate(CODES.tolist())}
    shown_regime = np.where(of[UNDETERMINED] >= UNDETERMINED_SHARE - 1e-9, UNDETERMINED, regime)
    shown_regime = np.where(of[PENDING] > 0, PENDING, shown_regime)
    return np.where(of[FAILED] > 0, FAILED, shown_regime).astype(np.int8)
