"""Cells prepared for lines around and along them: without clouds of small regions, dust and noise."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from workers.results import PENDING

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]

MIN_REGION_SHARE = 2e-4
"""Share of the plane below which a connected region is a small one."""
_SEEN = 5.0
"""Width of a cell in points from which its outline leaves its colour to be seen, however many there are."""
_CLOUD, _DENSE = 12.0, 0.2
"""Small regions are a cloud, which outlines would turn black, where they cover more than this share of the area within
this many points.
"""


def simplify_regimes(regime: NDArray[np.int8], size: tuple[float, float]) -> tuple[NDArray[np.int16], bool]:
    """Every cell's regime as boundaries show it on a map of a size (width, height) in points, and whether they leave
    something out: clouds of small regions, which take on the regime that is nearest. Isolated cells stay.
    """
    points = np.array(size[::-1]) / regime.shape  # of a cell
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
    """The cells without parts too thin for the eye, as between basins: outlined, that would turn black."""
    thin = min(cells.shape) // 150
    if thin == 0:
        return cells
    padded = np.pad(cells, 2 * thin, mode="symmetric")  # or the picture's frame would eat into them
    wide = ndimage.binary_opening(padded, structure=np.ones((3, 3)), iterations=thin)
    wide = ndimage.binary_closing(wide, structure=np.ones((3, 3)), iterations=thin)
    return np.asarray(wide[2 * thin : -2 * thin, 2 * thin : -2 * thin] & cells)


def smooth(values: Array, width: float) -> Array:
    """A Gaussian mean over neighbours that have a value, for the error bars of neighbouring cells not to wrinkle lines.

    Cells with few such neighbours are left out: fragments have no isolines.
    """
    known = np.isfinite(values)
    weight = ndimage.gaussian_filter(known.astype(float), width, mode="nearest")
    total = ndimage.gaussian_filter(np.where(known, values, 0.0), width, mode="nearest")
    return np.where(known & (weight > 0.8), total / np.maximum(weight, 1e-12), np.nan)


def isolines(
    x: Array, y: Array, values: Array, ticks: Callable[[float, float], Sequence[float]]
) -> Iterator[tuple[float, Array]]:
    """Lines (N, 2) of equal values (y, x) in rising order, each after its level; ``ticks`` gives levels between two
    ends.

    Each sign on its own: between them exponents jump, and lines there would show the jump and nothing else.
    """
    from contourpy import contour_generator

    if min(values.shape) < 2:
        return
    shown, levels = np.full(values.shape, np.nan), set()
    for sign, width in ((-1.0, 1.5), (1.0, 2.5)):
        size = np.where(np.isfinite(values) & (sign * values > 0.0), np.abs(values), np.nan)
        even = smooth(size, width)
        if np.isfinite(even).sum() >= 4:
            shown = np.where(np.isfinite(even), sign * even, shown)
            steps = np.asarray(ticks(0.0, float(np.nanpercentile(size, 98))))
            levels |= {sign * level for level in steps[(steps > np.nanmin(even)) & (steps < np.nanmax(even))]}
    lines = contour_generator(x, y, np.ma.masked_invalid(shown))
    for level in sorted(levels):
        yield from ((level, np.asarray(line)) for line in lines.lines(level))


def fill_holes(cells: Cells, times: int) -> Cells:
    """The cells and the holes between them that are at most ``2 * times`` cells wide: one odd cell is no region."""
    wide = 2 * times + 1  # filters, since the memory of a binary closing grows with the fourth power of it
    grown = ndimage.maximum_filter(np.pad(cells, times, "edge"), wide, mode="constant")
    return np.asarray(ndimage.minimum_filter(grown, wide, mode="constant")[times:-times, times:-times])


def row_rectangles(cells: Cells, x: Array, y: Array) -> Array:
    """The runs of cells in each row as closed rectangles (N, 5, 2); ``x`` and ``y`` are the edges of the cells."""
    change = np.diff(np.pad(cells, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    rows, first = np.nonzero(change == 1)
    _, last = np.nonzero(change == -1)
    left, right, low, high = x[first], x[last], y[rows], y[rows + 1]
    return np.stack([left, low, right, low, right, high, left, high, left, low], axis=1).reshape(-1, 5, 2)


def borders(cells: Cells, x: Array, y: Array) -> Array:
    """The border of a set of cells as segments (N, 2, 2) along the cells' edges, without the frame of the plane."""
    rows, columns = np.nonzero(cells[:, 1:] != cells[:, :-1])
    upright = np.stack([x[columns + 1], y[rows], x[columns + 1], y[rows + 1]], axis=1)
    rows, columns = np.nonzero(cells[1:] != cells[:-1])
    level = np.stack([x[columns], y[rows + 1], x[columns + 1], y[rows + 1]], axis=1)
    return np.concatenate([upright, level]).reshape(-1, 2, 2)


def small_regions(cells: Cells, x: Array, y: Array, step: Array, limit: float) -> Array:
    """The middles (N, 2) of connected regions whose width and height are both below ``limit``.

    ``x`` and ``y`` are the edges of the cells, ``step`` the height and the width of a cell in the unit of ``limit``.
    """
    boxes = ndimage.find_objects(ndimage.label(cells)[0])
    small = [(r, c) for r, c in boxes if max((r.stop - r.start) * step[0], (c.stop - c.start) * step[1]) < limit]
    return np.array([(x[[c.start, c.stop]].mean(), y[[r.start, r.stop]].mean()) for r, c in small]).reshape(-1, 2)


def interleave_exponents(spectrum: Array, width: float) -> NDArray[np.bool_]:
    """Which exponents (n, m) are drawn on top along a sweep: all that stand alone, and of equal ones, within a width,
    each in turn, so that their points alternate like the strands of a braid.
    """
    n, m = spectrum.shape
    stretch = np.arange(n) // max(1, n // 60)
    apart = np.abs(np.diff(spectrum, axis=1)) > width
    group = np.concatenate([np.zeros((n, 1), int), np.cumsum(apart, axis=1)], axis=1)
    shown = np.empty((n, m), dtype=bool)
    for i in range(m):
        mine = group == group[:, i : i + 1]
        shown[:, i] = stretch % mine.sum(axis=1) == mine[:, :i].sum(axis=1)
    return shown
