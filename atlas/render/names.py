"""Where names stand: inside regions of cells, and beside marks. Lengths are in points."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray
from scipy import ndimage

from atlas.render import maps, style

Array = NDArray[np.float64]

_AROUND = ((1, 0), (-1, 0), (1, 1), (-1, 1), (1, -1), (-1, -1), (0, 1), (0, -1))
"""Where a name may stand beside its mark: to the right and left, above and below."""


def beside_marks(
    ax: Axes,
    marked: Sequence[tuple[str, Array]],
    lines: Array,
    mark: float,
    type_size: float,
    size: tuple[float, float],
) -> None:
    """Write names beside marks, each where it covers no other and no mark, and the fewest points of the lines.

    ``marked``: names and places (2,); ``lines`` (N, 2); both from the lower left corner of a plot of ``size``. A name
    without room is left out.
    """
    taken = [np.concatenate([at - 0.6 * mark, at + 0.6 * mark]) for _, at in marked]
    for name, at in marked:
        half = np.array([0.25 * type_size * len(name), 0.575 * type_size])
        best: tuple[int, int, int, Array] | None = None
        for across, up in _AROUND:
            middle = at + np.array([across, up]) * (0.8 * mark + half)
            box = np.concatenate([middle - half, middle + half])
            if np.any(box[:2] < 0.0) or np.any(box[2:] > size) or any(_overlap(box, each) for each in taken):
                continue
            covered = int(np.sum(np.all((lines > box[:2]) & (lines < box[2:]), axis=1)))
            if best is None or covered < best[0]:
                best = covered, across, up, box
        if best is None:
            continue
        _, across, up, box = best
        taken.append(box)
        place = ax.transData.inverted().transform(ax.transAxes.transform(at / size))
        ax.annotate(
            name, (float(place[0]), float(place[1])), xytext=(0.8 * mark * across, 0.8 * mark * up),
            textcoords="offset points", ha={1: "left", 0: "center", -1: "right"}[across],
            va={1: "bottom", 0: "center", -1: "top"}[up], fontsize=type_size, zorder=4.3,
            path_effects=[withStroke(linewidth=1.4, foreground="white")], gid="corner name",
        )  # fmt: skip


def in_regions(
    ax: Axes,
    plane: maps.Plane,
    named: Iterable[tuple[NDArray[np.bool_], str, str]],
    type_sizes: Sequence[float],
    most: int = 2,
    free: NDArray[np.bool_] | None = None,
) -> None:
    """Write names into the largest connected regions, at most ``most``, of sets of cells (y, x), where they fit.

    ``named``: cells, name, and the colour that the name is seen on. A name takes the first of ``type_sizes`` that
    fits. Where one fits nowhere and ``free`` says which cells (y, x) a name may cover, it stands beside its largest
    region, on a line that ends there. The plot must have its size already.
    """
    if not ((plane.x.uniform or plane.x.log) and (plane.y.uniform or plane.y.log)):
        return  # cells differ in size, and distances in cells mean nothing
    extent, dots = ax.get_window_extent(), ax.figure.dpi / 72.0
    rows, columns = plane.regime.shape
    step = float(extent.height) / dots / rows, float(extent.width) / dots / columns  # points per cell
    narrow: list[tuple[str, tuple[int, int]]] = []
    for cells, name, color in named:
        regions, _ = ndimage.label(cells)
        sizes, boxes = np.bincount(regions.ravel()), ndimage.find_objects(regions)
        largest, placed = np.argsort(-sizes[1:], kind="stable")[:most] + 1, False
        for number in largest:
            corner = [part.start for part in boxes[number - 1]]
            region = regions[boxes[number - 1]] == number
            if free is not None:
                region &= free[boxes[number - 1]]
            for type_size in type_sizes:
                half = 0.62 * type_size, 0.29 * type_size * len(name)
                big_enough = sizes[number] * step[0] * step[1] >= 4.0 * half[0] * half[1]
                spot = label_spot(region, step, half[::-1]) if big_enough else None
                if spot is not None:
                    row, column, angle = corner[0] + spot[0], corner[1] + spot[1], spot[2]
                    look: Any = {"color": style.ink_on(color), "rotation": angle, "zorder": 4}
                    place = plane.x.values[column], plane.y.values[row]
                    ax.text(*place, name, fontsize=type_size, ha="center", va="center_baseline", **look)
                    if free is not None:
                        free = _without(free, (row, column), float(np.hypot(*half)), step)
                    placed = True
                    break
        if not placed and len(largest) and sizes[largest[0]] * step[0] * step[1] >= _LEAST_AREA:
            inside = ndimage.distance_transform_edt(np.pad(regions == largest[0], 1))[1:-1, 1:-1]
            narrow.append((name, np.unravel_index(int(np.argmax(inside)), inside.shape)))  # type: ignore[arg-type]
    if free is not None:
        _lead(ax, plane, narrow, type_sizes[min(1, len(type_sizes) - 1)], step, free)


_LEAST_AREA = 120.0
"""Square points of a region that a name beside it may point to."""
_FARTHEST = 100.0
"""Length of the line to such a name, at most."""


def _lead(
    ax: Axes,
    plane: maps.Plane,
    narrow: Sequence[tuple[str, tuple[int, int]]],
    type_size: float,
    step: tuple[float, float],
    free: NDArray[np.bool_],
) -> None:
    """Write names, each on the nearest free cells (y, x), with a line to a cell of their region."""
    at = np.indices(free.shape)
    for name, (row, column) in narrow:
        half = 0.75 * type_size, 0.3 * type_size * (len(name) + 1)
        box = [1 + 2 * int(h / s) for h, s in zip(half, step, strict=True)]
        room = ndimage.minimum_filter(free, box, mode="constant", cval=False)
        far = np.hypot((at[0] - row) * step[0], (at[1] - column) * step[1])
        far = np.where(room & (far > max(half)), far, np.inf)
        spot = np.unravel_index(int(np.argmin(far)), far.shape)
        if far[spot] > _FARTHEST:
            continue
        free = _without(free, spot, float(np.hypot(*half)), step)  # type: ignore[arg-type]
        ax.annotate(
            name, (plane.x.values[column], plane.y.values[row]), (plane.x.values[spot[1]], plane.y.values[spot[0]]),
            fontsize=type_size, ha="center", va="center", zorder=4, color=style.ink_on("white"),
            arrowprops={"arrowstyle": "-|>,head_length=0.25,head_width=0.1", "linewidth": 0.5, "shrinkA": 0.5,
                        "shrinkB": 0.0, "color": "#555555"},
        )  # fmt: skip


def _without(
    free: NDArray[np.bool_], at: tuple[int, int], reach: float, step: tuple[float, float]
) -> NDArray[np.bool_]:
    """The free cells less those around a name."""
    rows, columns = np.indices(free.shape)
    return free & (np.hypot((rows - at[0]) * step[0], (columns - at[1]) * step[1]) > reach)


def label_spot(
    region: NDArray[np.bool_], step: tuple[float, float], half: tuple[float, float]
) -> tuple[int, int, float] | None:
    """Row, column and angle in degrees where a box of half sizes (along, across) lies inside a region.

    ``step`` are the points per cell (y, x). The angle follows the region, so that a name fits in a band; the widest
    spots are tried first. None where none will do.
    """
    # A frame of cells that do not belong: a name must not run over the picture's edge.
    room = ndimage.distance_transform_edt(np.pad(region, 1), sampling=step)[1:-1, 1:-1]
    candidates = np.flatnonzero(room.ravel() >= half[1])
    candidates = candidates[np.argsort(-room.ravel()[candidates], kind="stable")]
    along, across = np.meshgrid(*(np.linspace(-h, h, 3 + int(2.0 * h / min(step))) for h in half))
    for flat in candidates[:: max(1, candidates.size // 60)]:
        row, column = (int(i) for i in np.unravel_index(flat, region.shape))
        angle = 0.0 if room[row, column] >= np.hypot(*half) else _direction(region, (row, column), step, half[0])
        # Rows count upward in the picture, as angles do.
        rows = np.rint(row + (along * np.sin(angle) + across * np.cos(angle)) / step[0]).astype(int)
        columns = np.rint(column + (along * np.cos(angle) - across * np.sin(angle)) / step[1]).astype(int)
        inside = (rows >= 0) & (rows < region.shape[0]) & (columns >= 0) & (columns < region.shape[1])
        if inside.all() and region[rows, columns].all():
            return row, column, float(np.degrees(angle))
    return None


def _direction(region: NDArray[np.bool_], at: tuple[int, int], step: tuple[float, float], reach: float) -> float:
    """The angle, within 90 degrees either way, in which a region extends around a cell: its principal axis there."""
    span = [int(np.ceil(reach / each)) for each in step]
    low = [max(0, i - n) for i, n in zip(at, span, strict=True)]
    rows, columns = np.nonzero(region[low[0] : at[0] + span[0] + 1, low[1] : at[1] + span[1] + 1])
    points = np.stack([(columns + low[1] - at[1]) * step[1], (rows + low[0] - at[0]) * step[0]])
    points = points[:, np.hypot(*points) <= reach]
    _, axes = np.linalg.eigh(points @ points.T)
    x, y = axes[:, -1]
    return float(np.arctan2(y, x) if x >= 0 else np.arctan2(-y, -x))


def _overlap(one: Array, other: Array) -> bool:
    """Whether two boxes (left, low, right, high) meet."""
    return bool(np.all(one[:2] < other[2:]) and np.all(other[:2] < one[2:]))
