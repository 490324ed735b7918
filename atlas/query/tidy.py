"""Cells as lines around and along them show them: without clouds of small regions, without dust, without noise."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from workers.results import PENDING

Array = NDArray[np.float64]

LEAST_REGION = 2e-4
"""Share of the plane below which a connected region is a small one."""
_SEEN = 5.0
"""Width of a cell in points from which its outline leaves its colour to be seen, however many there are."""
_CLOUD, _DENSE = 12.0, 0.2
"""Small regions are a cloud, which outlines would turn black, where they cover more than this share of the area within
this many points.
"""


def outlined(regime: NDArray[np.int8], size: tuple[float, float]) -> tuple[NDArray[np.int16], bool]:
    """Every cell's regime as boundaries show it on a map of a size (width, height) in points, and whether they leave
    something out: clouds of small regions, which take on the regime that is nearest. Isolated cells stay.
    """
    points = np.array(size[::-1]) / regime.shape  # of a cell
    small = np.zeros(regime.shape, dtype=bool)
    for code in np.unique(regime) if points.min() < _SEEN else ():
        regions, _ = ndimage.label(regime == code)
        least = max(2, int(LEAST_REGION * regime.size))
        small |= (np.bincount(regions.ravel()) < least)[regions] & (regions > 0)
    near = np.maximum(3, np.rint(_CLOUD / points).astype(int))
    cloud = small & (ndimage.uniform_filter(small.astype(float), near) > _DENSE)
    if not cloud.any():
        return regime.astype(np.int16), False
    if cloud.all():
        return np.full(regime.shape, PENDING, dtype=np.int16), True
    nearest = ndimage.distance_transform_edt(cloud, return_distances=False, return_indices=True)
    return regime[tuple(nearest)].astype(np.int16), True


def without_dust(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The cells less what is thinner than the eye separates, as between basins: outlined, that would turn black."""
    thin = min(cells.shape) // 150
    if thin == 0:
        return cells
    padded = np.pad(cells, 2 * thin, mode="symmetric")  # or the picture's frame would eat into them
    wide = ndimage.binary_opening(padded, structure=np.ones((3, 3)), iterations=thin)
    wide = ndimage.binary_closing(wide, structure=np.ones((3, 3)), iterations=thin)
    return np.asarray(wide[2 * thin : -2 * thin, 2 * thin : -2 * thin] & cells)


def smooth(values: Array, width: float) -> Array:
    """A Gaussian mean over neighbours that have a value, for the error bars of neighbouring cells not to wrinkle lines.

    Cells with few such neighbours are left out: what is chopped up has no isolines.
    """
    known = np.isfinite(values)
    weight = ndimage.gaussian_filter(known.astype(float), width, mode="nearest")
    total = ndimage.gaussian_filter(np.where(known, values, 0.0), width, mode="nearest")
    return np.where(known & (weight > 0.8), total / np.maximum(weight, 1e-12), np.nan)
