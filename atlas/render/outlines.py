"""Finding the borders between regions of cells that a map can show, without small regions that would turn it black."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from workers.results import PENDING

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]

MIN_REGION_SHARE = 2e-4
"""Share of the cells of a plane below which a connected region of cells counts as small."""
_SEEN = 5.0
"""Width of a cell, in points, above which its colour is visible inside an outline, even among many outlines."""
_CLOUD, _DENSE = 12.0, 0.2
"""Radius in points, and maximum fraction of the area within it that small regions may cover.

Denser small regions are a cloud, which their outlines would turn black.
"""


def simplify_regimes(regime: NDArray[np.int8], size: tuple[float, float]) -> tuple[NDArray[np.int16], bool]:
    """Return the regimes (y, x) between which borders are drawn, and True if some were changed.

    regime  (y, x) codes of the regimes
    size    width and height of the map in points

    Clouds of small regions, whose borders would turn black, take the nearest regime outside. Isolated cells stay.
    """
    points = np.array(size[::-1]) / regime.shape  # height and width of a cell
    small = np.zeros(regime.shape, dtype=bool)
    for code in np.unique(regime) if points.min() < _SEEN else ():
        regions, _ = ndimage.label(regime == code)
        least = max(2, int(MIN_REGION_SHARE * regime.size))
        small |= (np.bincount(regions.ravel()) < least)[regions] & (regions > 0)
    near = np.maximum(3, np.rint(_CLOUD / points).astype(int))
    cloud = small & (ndimage.uniform_filter(small.astype(float), near) > _DENSE)
    if not cloud.any():
        return regime.astype(np.int16), False
    if cloud.all():
        return np.full(regime.shape, PENDING, dtype=np.int16), True
    nearest = ndimage.distance_transform_edt(cloud, return_distances=False, return_indices=True)
    return regime[tuple(nearest)].astype(np.int16), True


def without_dust(cells: Cells) -> Cells:
    """Return a mask of cells without its parts that are too thin to see, which an outline would turn black.

    Such parts lie, for example, between basins.
    """
    thin = min(cells.shape) // 150
    if thin == 0:
        return cells
    padded = np.pad(cells, 2 * thin, mode="symmetric")  # so that the picture's frame removes nothing
    wide = ndimage.binary_opening(padded, structure=np.ones((3, 3)), iterations=thin)
    wide = ndimage.binary_closing(wide, structure=np.ones((3, 3)), iterations=thin)
    return np.asarray(wide[2 * thin : -2 * thin, 2 * thin : -2 * thin] & cells)


def row_rectangles(cells: Cells, x: Array, y: Array) -> Array:
    """Return the runs of cells in each row of a mask as closed rectangles (N, 5, 2).

    ``x`` and ``y`` are the cell edges.
    """
    change = np.diff(np.pad(cells, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    rows, first = np.nonzero(change == 1)
    _, last = np.nonzero(change == -1)
    left, right, low, high = x[first], x[last], y[rows], y[rows + 1]
    return np.stack([left, low, right, low, right, high, left, high, left, low], axis=1).reshape(-1, 5, 2)


def borders(cells: NDArray[Any], x: Array, y: Array) -> Array:
    """Return the borders between cells of different values, or of a mask, as segments (N, 2, 2) along cell edges.

    The frame of the plane is left out.

    ``x`` and ``y`` are the cell edges.
    """
    rows, columns = np.nonzero(cells[:, 1:] != cells[:, :-1])
    upright = np.stack([x[columns + 1], y[rows], x[columns + 1], y[rows + 1]], axis=1)
    rows, columns = np.nonzero(cells[1:] != cells[:-1])
    level = np.stack([x[columns], y[rows + 1], x[columns + 1], y[rows + 1]], axis=1)
    return np.concatenate([upright, level]).reshape(-1, 2, 2)


def small_regions(cells: Cells, x: Array, y: Array, step: Array, limit: float) -> Array:
    """Return the centres (N, 2) of the connected regions of a mask whose width and height are both below ``limit``.

    ``x`` and ``y`` are the cell edges, ``step`` the height and width of a cell in the unit of ``limit``.
    """
    boxes = ndimage.find_objects(ndimage.label(cells)[0])
    small = [(r, c) for r, c in boxes if max((r.stop - r.start) * step[0], (c.stop - c.start) * step[1]) < limit]
    return np.array([(x[[c.start, c.stop]].mean(), y[[r.start, r.stop]].mean()) for r, c in small]).reshape(-1, 2)


def interleave_exponents(spectrum: Array, width: float) -> NDArray[np.bool_]:
    """Return which Lyapunov exponents are drawn on top along a sweep, as a mask (n, m).

    ``spectrum`` (n, m) are the m exponents of n cells. An exponent is on top if no other lies within ``width`` of it.
    Exponents closer than ``width`` take turns along the sweep, so that their points alternate like the strands of a
    braid.
    """
    n, m = spectrum.shape
    stretch = np.arange(n) // max(1, n // 60)
    apart = np.abs(np.diff(spectrum, axis=1)) > width
    group = np.concatenate([np.zeros((n, 1), int), np.cumsum(apart, axis=1)], axis=1)
    on_top = np.empty((n, m), dtype=bool)
    for i in range(m):
        mine = group == group[:, i : i + 1]
        on_top[:, i] = stretch % mine.sum(axis=1) == mine[:, :i].sum(axis=1)
    return on_top
