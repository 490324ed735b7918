"""Placement of labels in regions of cells, and detection of lines that run side by side. Lengths are in points."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]

_LEAST_AREA = 120.0
"""Minimum area, in square points, of a region that a label beside it may point to."""
_FARTHEST = 100.0
"""Maximum distance of a label from the region it points to."""
_STEP = 2.0
"""Maximum distance between the points at which a line is examined."""
_SHORTEST = 21
"""Number of such points over which the majority decides.

Dashes start again with each part, and lines that cross stay in one part.
"""


class LabelPlacement(NamedTuple):
    """The position of a label.

    number  index of the label among the given ones
    cell    (row, column) of the cell under its centre
    size    type size
    angle   angle in degrees
    region  cell of the region that a label beside its region points to; None for a label inside
    """

    number: int
    cell: tuple[int, int]
    size: float
    angle: float = 0.0
    region: tuple[int, int] | None = None


def places(
    named: Sequence[tuple[Cells, str]],
    step: Array,
    type_sizes: Sequence[float],
    limit: int = 2,
    free: Cells | None = None,
) -> Iterator[LabelPlacement]:
    """Yield the positions of labels in the largest connected regions of sets of cells, where the labels fit.

    named       cells (y, x) and label of each set
    step        height and width of a cell
    type_sizes  type sizes in order of preference; the first that fits is used
    limit       maximum number of regions labelled in each set
    free        mask of the cells that a label may cover

    A label that fits in none of its regions is placed on the nearest free cell, if ``free`` is given. Its ``region``
    then is its largest region.
    """
    narrow: list[tuple[int, tuple[int, int]]] = []
    for k, (cells, name) in enumerate(named):
        regions, _ = ndimage.label(cells)
        areas = np.bincount(regions.ravel())[1:] * step.prod()
        boxes, placed = ndimage.find_objects(regions), False
        largest = np.argsort(-areas, kind="stable")[:limit]
        for number in largest:
            region = regions[boxes[number]] == number + 1
            if free is not None:
                region &= free[boxes[number]]
            for size in type_sizes:
                half = 0.29 * size * len(name), 0.62 * size
                spot = label_spot(region, step, half) if areas[number] >= 4.0 * half[0] * half[1] else None
                if spot is None:
                    continue
                cell = spot[0] + boxes[number][0].start, spot[1] + boxes[number][1].start
                yield LabelPlacement(k, cell, size, spot[2])
                if free is not None:
                    free = free & (_distance(free.shape, cell, step) > np.hypot(*half))
                placed = True
                break
        if not placed and areas.size and areas[largest[0]] >= _LEAST_AREA:
            inside = ndimage.distance_transform_edt(np.pad(regions == largest[0] + 1, 1))[1:-1, 1:-1]
            narrow.append((k, _unravelled(np.argmax(inside), inside.shape)))
    if free is None:
        return
    size = type_sizes[min(1, len(type_sizes) - 1)]
    for k, region in narrow:
        tall, wide = 0.75 * size, 0.3 * size * (len(named[k][1]) + 1)
        room = ndimage.minimum_filter(free, 1 + 2 * (np.array([tall, wide]) / step).astype(int), mode="constant")
        far = _distance(free.shape, region, step)
        far = np.where(room & (far > wide), far, np.inf)
        cell = _unravelled(np.argmin(far), far.shape)
        if far[cell] <= _FARTHEST:
            free = free & (_distance(free.shape, cell, step) > np.hypot(tall, wide))
            yield LabelPlacement(k, cell, size, region=region)


def _distance(shape: tuple[int, ...], cell: tuple[int, int], step: Array) -> Array:
    """Return the distance of every cell (y, x) of a plane from ``cell``."""
    rows, columns = np.ogrid[: shape[0], : shape[1]]
    return np.asarray(np.hypot((rows - cell[0]) * step[0], (columns - cell[1]) * step[1]))


def _unravelled(index: np.intp, shape: tuple[int, ...]) -> tuple[int, int]:
    row, column = np.unravel_index(index, shape)
    return int(row), int(column)


def label_spot(
    region: Cells, step: Sequence[float] | Array, half: tuple[float, float]
) -> tuple[int, int, float] | None:
    """Return row, column and angle, in degrees, of a box inside a region; None if the box fits nowhere.

    step  points per cell (y, x)
    half  half sizes of the box (along, across)

    The angle follows the region, so that a label fits into a band. The widest spots are tried first.
    """
    # The padding keeps labels from crossing the edge of the picture.
    room = ndimage.distance_transform_edt(np.pad(region, 1), sampling=step)[1:-1, 1:-1]
    candidates = np.flatnonzero(room.ravel() >= half[1])
    candidates = candidates[np.argsort(-room.ravel()[candidates], kind="stable")]
    along, across = np.meshgrid(*(np.linspace(-h, h, 3 + int(2.0 * h / min(step))) for h in half))
    for flat in candidates[:: max(1, candidates.size // 60)]:
        row, column = (int(i) for i in np.unravel_index(flat, region.shape))
        angle = 0.0 if room[row, column] >= np.hypot(*half) else _direction(region, (row, column), step, half[0])
        # Rows count upward in the picture, like angles.
        rows = np.rint(row + (along * np.sin(angle) + across * np.cos(angle)) / step[0]).astype(int)
        columns = np.rint(column + (along * np.cos(angle) - across * np.sin(angle)) / step[1]).astype(int)
        inside = (rows >= 0) & (rows < region.shape[0]) & (columns >= 0) & (columns < region.shape[1])
        if inside.all() and region[rows, columns].all():
            return row, column, float(np.degrees(angle))
    return None


def _direction(region: Cells, at: tuple[int, int], step: Sequence[float] | Array, reach: float) -> float:
    """Return the angle, within 90 degrees either way, of the principal axis of a region around a cell."""
    points = (np.argwhere(region) - at) * step
    points = points[np.hypot(*points.T) <= reach]
    _, axes = np.linalg.eigh(points.T @ points)
    y, x = axes[:, -1]
    return float(np.arctan2(y, x) if x >= 0 else np.arctan2(-y, -x))


def densify_line(line: Array) -> tuple[Array, Array]:
    """Return points (M, 2) along a line, at most _STEP apart, and the length of the line up to each point."""
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(line, axis=0).T)))
    at = np.linspace(0.0, along[-1], 2 + int(along[-1] / _STEP))
    return np.column_stack([np.interp(at, along, line[:, i]) for i in range(2)]), at


def crossed_cells(places: Iterable[Array], size: tuple[float, float], cells: tuple[int, ...]) -> Cells:
    """Return the mask of cells (y, x) that contain a point of ``places`` (N, 2), or are next to such a cell.

    ``size`` is the (width, height) of the plane, ``cells`` the shape of the mask.
    """
    inside = np.zeros(cells, dtype=bool)
    for place in places:
        share = place / np.array(size)
        columns, rows = (share[np.all((share >= 0.0) & (share < 1.0), axis=1)] * cells[::-1]).astype(int).T
        inside[rows, columns] = True
    return np.asarray(ndimage.binary_dilation(inside, np.ones((3, 3))))


def crowded_parts(
    lines: Sequence[Array], places: Sequence[Array], distance: float
) -> Iterator[tuple[int, Array, bool]]:
    """Cut lines into parts, and yield (index of the line, part, True if another line runs beside the part).

    lines     (N, 2) points of each line
    places    (N, 2) the same points, in points of the page
    distance  distance within which another line is beside a part

    Another part of the same line counts if it is three times as far away along the line.
    """
    if not lines:
        return
    dense_lines, lengths = zip(*map(densify_line, places), strict=True)
    everywhere, length = np.concatenate(dense_lines), np.concatenate(lengths)
    line = np.repeat(np.arange(len(lines)), [len(points) for points in dense_lines])
    near = np.zeros(len(everywhere), dtype=bool)
    one, two = KDTree(everywhere).query_pairs(distance, output_type="ndarray").T
    beside = (line[one] != line[two]) | (np.abs(length[one] - length[two]) > 3.0 * distance)
    near[one[beside]] = near[two[beside]] = True
    for k, (piece, place) in enumerate(zip(lines, places, strict=True)):
        smooth = ndimage.median_filter(near[line == k], _SHORTEST, mode="nearest")
        along = np.append(0.0, np.cumsum(np.hypot(*np.diff(place, axis=0).T)))
        crowded = smooth[np.searchsorted(lengths[k], along[:-1]).clip(max=len(smooth) - 1)]  # each step of the line
        for first, last in pairwise([0, *(np.flatnonzero(np.diff(crowded)) + 1), len(crowded)]):
            yield k, piece[first : last + 1], bool(crowded[first])
