"""Placement of labels in regions of a map, and detection of lines that run side by side. Lengths are in points."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from atlas.query.plane import Plane
from atlas.render.layers import Class
from atlas.render.looks import ink_on

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]

_REGIONS = 2
"""Maximum number of regions in which the same label is placed."""
_STEP = 2.0
"""Maximum distance, in points, between the places at which a line is examined for neighbours."""
_SHORTEST = 21
"""Number of consecutive examined places of a line, the majority of which decides whether the line is crowded.

Dashes start again with each part of a line, so parts must be long. Lines that cross stay in one part.
"""


class PlacedName(NamedTuple):
    """A name on a map: the position (x, y) of its centre, its text, angle in degrees, and colour."""

    x: float
    y: float
    text: str
    angle: float
    color: str


def place_names(
    named: Sequence[Class], plane: Plane, size: tuple[float, float], type_size: float
) -> Iterator[PlacedName]:
    """Yield the names of classes of cells that fit into their regions of a map, each in up to two largest regions.

    named      classes of cells (y, x) with their colour and name
    plane      plane of the map
    size       width and height of the map
    type_size  type size of the names, in the unit of ``size``
    """
    (x, columns), (y, rows) = plane.x.even(), plane.y.even()
    step, even_index = np.array(size[::-1]) / (rows.size, columns.size), np.ix_(rows, columns)
    for cells, name, under in named:
        regions, _ = ndimage.label(cells[even_index])
        areas = np.bincount(regions.ravel())[1:] * step.prod()
        boxes, half = ndimage.find_objects(regions), (0.29 * type_size * len(name), 0.62 * type_size)
        for number in np.argsort(-areas, kind="stable")[:_REGIONS]:
            box, region = boxes[number], regions[boxes[number]] == number + 1
            spot = label_spot(region, step, half) if areas[number] >= 4.0 * half[0] * half[1] else None
            if spot is not None:
                row, column = spot[0] + box[0].start, spot[1] + box[1].start
                yield PlacedName(float(x.values[column]), float(y.values[row]), name, spot[2], ink_on(under))


def label_spot(
    region: Cells, step: Sequence[float] | Array, half: tuple[float, float]
) -> tuple[int, int, float] | None:
    """Return row, column and angle, in degrees, of the centre of a label inside a region; None if it fits nowhere.

    region  (y, x) mask of the region
    step    points per cell (y, x)
    half    half length and half height of the label

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
    """Return the angle along which a region extends most around a cell, in radians from -pi/2 to pi/2.

    region  (y, x) mask of the region
    at      (row, column) of the cell
    step    height and width of a cell
    reach   radius of the part of the region that counts
    """
    points = (np.argwhere(region) - at) * step
    points = points[np.hypot(*points.T) <= reach]
    _, axes = np.linalg.eigh(points.T @ points)
    y, x = axes[:, -1]
    return float(np.arctan2(y, x) if x >= 0 else np.arctan2(-y, -x))


def densify_line(line: Array) -> tuple[Array, Array]:
    """Return points (M, 2) along a line (N, 2), at most _STEP apart, and the length of the line up to each point."""
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(line, axis=0).T)))
    at = np.linspace(0.0, along[-1], 2 + int(along[-1] / _STEP))
    return np.column_stack([np.interp(at, along, line[:, i]) for i in range(2)]), at


def crowded_parts(
    lines: Sequence[Array], places: Sequence[Array], distance: float
) -> Iterator[tuple[int, Array, bool]]:
    """Cut lines where other lines begin or cease to run beside them, and yield the parts.

    lines     (N, 2) points of each line
    places    (N, 2) the same points in points from the plot's corner
    distance  distance within which another line is beside a part

    Each item is the index of the line, the points of the part, and True if another line runs beside the part. Another
    part of the same line counts, too, if its distance along the line is more than three times ``distance``.
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
