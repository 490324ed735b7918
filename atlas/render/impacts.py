"""The impact map: periodic motions by period and impacts at either stop, n-p-q, as this field names them."""

from typing import NamedTuple
from zlib import crc32

import numpy as np
from matplotlib.patches import Patch
from numpy.typing import NDArray

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
    for color, labels in shared.items():
        if labels:
            more = ", …" if len(labels) > _NAMED else ""
            legend.append(style.swatch(color, ", ".join(labels[:_NAMED]) + more))
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
