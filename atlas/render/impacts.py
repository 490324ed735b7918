"""The impact map: periodic motions by period and impacts at either stop, n-p-q, as this field names them."""

from collections.abc import Iterable
from typing import NamedTuple
from zlib import crc32

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from numpy.typing import NDArray
from scipy import ndimage

from atlas.render import maps, style
from workers.results import PERIODIC

VARIABLES = ("period", "impacts_upper", "impacts_lower")

HUES = {
    (1, 1, 1): ("#4477aa", "#73b9ff"),
    (1, 2, 2): ("#d9830a", "#433b2f"),
    (2, 4, 2): ("#8d3bf3", "#4f297f"),
    (2, 2, 2): ("#ffca97", "#9b8066"),
    (1, 2, 1): ("#ff25d2", "#51314b"),
    (2, 3, 2): ("#87cde4", "#186177"),
    (1, 3, 3): ("#dbbc50", "#625a3c"),
}
"""Colours of the motions n-p-q with p >= q that are the most frequent, and of their mirror images with p < q.

Mirror images are one motion seen from the other side, and which of the two is reached hangs on the start: they share
a hue. Chosen, with the colours of the regimes, for the greatest least difference between any two, also as seen without
red or without green receptors.
"""
UNLISTED = ("#d7ab9f", "#1d0335", "#0100f9", "#ffff8e")
"""Colours of all other motions, which share them by a hash of their name: a motion has one colour in every picture."""
STICKS, STICKS_HATCH = "#d5ece6", "----"
"""Colour and texture of periodic motions that rest on a stop: their impacts are infinitely many."""

LABEL_SIZE = 7.5
"""Points of the type of names on a map."""
_NAMED = 3
"""Motions that the legend names at most for a colour that several share."""


class ImpactPattern(NamedTuple):
    """What names a periodic motion: n forcing periods, p impacts at the upper stop and q at the lower.

    Both are -1 where it sticks.
    """

    n: int
    p: int
    q: int

    @property
    def label(self) -> str:
        """As a legend says it."""
        return f"{self.n}-{self.p}-{self.q}" if self.p >= 0 else "periodic, sticks"


def motions(view: maps.View) -> maps.Painted:
    """The periodic motions of a plane, the large ones with their names on them."""
    plane = view.plane
    regime, counts = plane.regime, tuple(plane[name] for name in VARIABLES)
    rgba, legend, colors = paint(regime, *counts)
    rests = maps.Texture((regime == PERIODIC) & (counts[1] < 0), STICKS_HATCH, style.TEXTURE)
    named = [(_cells_of(motion, regime, counts), motion.label, color) for motion, color in colors.items()]
    beside = "$n$-$p$-$q$: $n$ periods,\n$p$ impacts above, $q$ below"
    return maps.Painted(rgba, legend, textures=[rests], beside=beside, names=named)


def color_of(motion: ImpactPattern) -> str:
    """The colour of a motion, the same in every picture; mirror images have one hue."""
    if motion.p < 0:
        return STICKS
    group = (motion.n, max(motion.p, motion.q), min(motion.p, motion.q))
    if group in HUES:
        return HUES[group][motion.p < motion.q]
    return UNLISTED[crc32(repr(group).encode()) % len(UNLISTED)]


def paint(
    regime: NDArray[np.int8], period: NDArray[np.int32], upper: NDArray[np.int32], lower: NDArray[np.int32]
) -> tuple[NDArray[np.uint8], list[Patch], dict[ImpactPattern, str]]:
    """The colour of every cell, (y, x, 4) in bytes, legend entries, and the colour of each motion."""
    rgba = np.zeros((*regime.shape, 4), dtype=np.uint8)
    counted = (regime == PERIODIC) & (period >= 1)
    # Where it sticks the counts are formally infinite: one class, whatever the period.
    rests = counted & (upper < 0)
    triples = np.stack([np.where(rests, 0, period), np.where(rests, -1, upper), np.where(rests, -1, lower)], axis=-1)
    kinds, which, cells = np.unique(triples[counted], axis=0, return_inverse=True, return_counts=True)
    motions = [ImpactPattern(*map(int, kind)) for kind in kinds]
    colors = {motion: color_of(motion) for motion in motions}
    if motions:
        rgba[counted] = np.array([style.rgb(colors[motion]) for motion in motions], np.uint8)[which.ravel()]
    by_area = [motions[i] for i in np.argsort(-cells, kind="stable")]
    shared = {color: [motion.label for motion in by_area if colors[motion] == color] for color in UNLISTED}
    legend = [
        style.swatch(colors[motion], motion.label) for motion in motions if colors[motion] not in (*UNLISTED, STICKS)
    ]
    for color, names in shared.items():
        if names:
            more = ", …" if len(names) > _NAMED else ""
            legend.append(style.swatch(color, ", ".join(names[:_NAMED]) + more))
    if STICKS in colors.values():
        legend.append(style.swatch(STICKS, "periodic, sticks", STICKS_HATCH))
    return rgba, legend + maps.paint_regimes(rgba, regime, ~counted), colors


def _cells_of(
    motion: ImpactPattern, regime: NDArray[np.int8], counts: tuple[NDArray[np.int32], ...]
) -> NDArray[np.bool_]:
    """The cells of a motion; none for one that sticks, whose counts say nothing."""
    cells = (regime == PERIODIC) & (motion.p >= 0)
    for count, wanted in zip(counts, motion, strict=True):
        cells = cells & (count == wanted)
    return cells


def name_regions(
    ax: Axes,
    plane: maps.Plane,
    named: Iterable[tuple[NDArray[np.bool_], str, str]],
    type_size: float,
    most: int = 2,
) -> None:
    """Write names into the largest connected regions, at most ``most``, of sets of cells (y, x), where they fit.

    ``named``: cells, name, and the colour that the name is seen on. The plot must have its size already.
    """
    if not ((plane.x.uniform or plane.x.log) and (plane.y.uniform or plane.y.log)):
        return  # cells differ in size, and distances in cells mean nothing
    extent, drawn_dpi = ax.get_window_extent(), ax.figure.dpi
    width, height = (float(size) / drawn_dpi * 72.0 for size in (extent.width, extent.height))
    step = height / plane.regime.shape[0], width / plane.regime.shape[1]  # points per cell
    for cells, name, color in named:
        half = 0.29 * type_size * len(name), 0.62 * type_size
        least = 4.0 * half[0] * half[1] / (step[0] * step[1])  # cells that the name takes
        if np.count_nonzero(cells) < least:
            continue
        regions, _ = ndimage.label(cells)
        sizes = np.bincount(regions.ravel())
        boxes = ndimage.find_objects(regions)
        for number in np.argsort(-sizes[1:], kind="stable")[:most] + 1:
            box = boxes[number - 1]
            spot = label_spot(regions[box] == number, step, half) if sizes[number] >= least else None
            if spot is not None:
                row, column, angle = spot
                ax.text(
                    plane.x.values[box[1].start + column],
                    plane.y.values[box[0].start + row],
                    name,
                    color=style.ink_on(color),
                    fontsize=type_size,
                    rotation=angle,
                    ha="center",
                    va="center_baseline",
                    zorder=4,
                )


def label_spot(
    region: NDArray[np.bool_], step: tuple[float, float], half: tuple[float, float]
) -> tuple[int, int, float] | None:
    """Row, column and angle in degrees where a box of half sizes (along, across) in points lies inside a region.

    ``step`` are the points per cell (y, x). The angle follows the region, so that a name fits in a band; the widest
    spots are tried first. None where none will do.
    """
    # A frame of cells that do not belong: a name must not run over the picture's edge.
    room = ndimage.distance_transform_edt(np.pad(region, 1), sampling=step)[1:-1, 1:-1]
    candidates = np.flatnonzero(room.ravel() >= half[1])
    candidates = candidates[np.argsort(-room.ravel()[candidates], kind="stable")]
    along, across = np.meshgrid(np.linspace(-half[0], half[0], 13), np.linspace(-half[1], half[1], 5))
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
