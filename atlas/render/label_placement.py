"""Placement of labels in regions of cells, and detection of lines that run side by side. Lengths are in points."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]

_REGIONS = 2
"""Maximum number of regions with the same label."""
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
    angle   angle in degrees
    """

    number: int
    cell: tuple[int, int]
    angle: float


def places(named: Sequence[tuple[Cells, str]], step: Array, type_size: float) -> Iterator[LabelPlacement]:
    """Yield a LabelPlacement for each label that fits: its position in one of the two largest regions of its set.

    named      cells (y, x) and label of each set
    step       height and width of a cell
    type_size  type size of the labels
    """
    for k, (cells, name) in enumerate(named):
        regions, _ = ndimage.label(cells)
        areas = np.bincount(regions.ravel())[1:] * step.prod()
        boxes, half = ndimage.find_objects(regions), (0.29 * type_size * len(name), 0.62 * type_size)
        for number in np.argsort(-areas, kind="stable")[:_REGIONS]:
            region = regions[boxes[number]] == number + 1
            spot = label_spot(region, step, half) if areas[number] >= 4.0 * half[0] * half[1] else None
            if spot is not None:
                yield LabelPlacement(k, (spot[0] + boxes[number][0].start, spot[1] + boxes[number][1].start), spot[2])


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
    is_beside = (line[one] != line[two]) | (np.abs(length[one] - length[two]) > 3.0 * distance)
    near[one[is_beside]] = near[two[is_beside]] = True
    for k, (piece, page_points) in enumerate(zip(lines, places, strict=True)):
        smooth = ndimage.median_filter(near[line == k], _SHORTEST, mode="nearest")
        along = np.append(0.0, np.cumsum(np.hypot(*np.diff(page_points, axis=0).T)))
        crowded = smooth[np.searchsorted(lengths[k], along[:-1]).clip(max=len(smooth) - 1)]  # each step of the line
        for first, last in pairwise([0, *(np.flatnonzero(np.diff(crowded)) + 1), len(crowded)]):
            yield k, piece[first : last + 1], bool(crowded[first])
