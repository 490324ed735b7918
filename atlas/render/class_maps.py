"""Maps of classes of cells, each with a colour and a legend entry: periods, motions, attractors, basins.

The functions return layers: codes of cells with their colours, hatches and legend, from which a figure is drawn.
"""

from collections.abc import Sequence
from dataclasses import replace
from zlib import crc32

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from atlas.query import basins as reached
from atlas.query.attractors import branches
from atlas.query.motions import VARIABLES, MotionName
from atlas.query.motions import motions as motions_of
from atlas.query.plane import Plane
from atlas.render import looks, text
from atlas.render.layers import (
    Class,
    HatchLayer,
    MapLayers,
    MapView,
    PointLayer,
    ShadingLayer,
    build_layers,
)
from atlas.render.looks import LegendEntry, MarkLook
from atlas.store.schema import REGIME_COLORS
from workers.results import ATTRACTOR, CYCLE_PERIOD, LABEL, NO_IMPACT, PERIODIC, REGIME, SETTLED, Variable

PERIODS: tuple[tuple[int, int, str], ...] = (
    (1, 1, "#013365"),
    (2, 2, "#434944"),
    (3, 3, "#6a516d"),
    (4, 4, "#6e5dd1"),
    (5, 5, "#588c5c"),
    (6, 6, "#c879cb"),
    (7, 8, "#aba9b3"),
    (9, 16, "#a6c5a9"),
    (17, np.iinfo(np.int32).max, "#9ae2ff"),
)
"""First and last period of each class of the period map, and its colour.

Colours are cool, since chaos is warm. Lightness rises from class to class in even steps, so that neighbours differ in
grey too, by luminance as by the weights of Rec. 601. The smallest difference (CIEDE2000) between any two is above 20,
and above 12 as seen without red, green or blue receptors. One of the first eight periods is blue.
"""

HUES = {
    (1, 1, 1): ("#4477aa", "#73b9ff"),
    (1, 2, 2): ("#d9830a", "#433b2f"),
    (2, 4, 2): ("#8d3bf3", "#4f297f"),
    (2, 2, 2): ("#ffca97", "#9b8066"),
    (1, 2, 1): ("#ff25d2", "#51314b"),
    (2, 3, 2): ("#87cde4", "#186177"),
    (1, 3, 3): ("#dbbc50", "#625a3c"),
}
"""Colours of the most frequent motions n-p-q with p >= q, and of their mirror images with p < q, in the same hue.

The colours, with those of the regimes, maximize the smallest difference between any two, also as seen without red or
without green receptors.
"""
UNLISTED = ("#d7ab9f", "#1d0335", "#0100f9", "#ffff8e")
"""Colours of all other motions, selected by a hash of their name: a motion has the same colour in every picture."""
_NAMED = 3
"""Maximum number of motions named in the legend for a shared colour."""
STICKS, STICKS_HATCH = "#d5ece6", "----"
"""Colour and hatch of sticking periodic motions."""

COUNTS = {1: "#eff3f5", 2: "#bcd3e8", 3: "#d9a63a", 4: "#c8662a", 5: "#963050", 6: "#40103c"}
"""Colours by number of attractors, ever darker; the last is for all larger numbers."""

PALETTE = ("#4477aa", "#e0a83a", "#5fa36a", "#b65c8f", "#7f6bb3", "#c9703f", "#3aa6a6", "#8c7a2e")
"""Colours of the branches with the largest shares.

Mirror images have a darker tone of the same hue, since paler points would be invisible on white.
"""
REST = "#4d4d4d"
"""Colour of the branches beyond those of PALETTE."""
BASINS = ("#4477aa", "#e0a83a", "#5fa36a", "#b65c8f", "#7f6bb3", "#8fb8d8", "#c9703f", "#6d6d6d")
"""Colours of the attractors of a plane of initial states, repeated if there are more."""
PALER, DARKER = 0.8, 0.25
"""Lightness of the colour of a mirror image, in the hue of its twin, on basin and on branch maps; 0 is black."""
SLOW = 0.55
"""Share of the brightness that is left to the initial states that settle slowest; 0 is black."""
SOONEST, LATEST = 5.0, 95.0
"""Percentiles of the settling times between which a basin map darkens."""


def period(view: MapView) -> MapLayers:
    """Return the layers of the period map: cells by the period of their orbit, or by their regime if not periodic."""
    return build_layers(view.plane.regime, by_period(view.plane), side_legend_title="")


def by_period(plane: Plane) -> list[Class]:
    """Return the classes of a plane's periodic cells by ranges of the period, each with its colour and name."""
    periodic, period = plane.regime == PERIODIC, plane["period"]
    classes = []
    for first, last, color in PERIODS:
        name = f"period {first}" if first == last else f"period {first}–{last}"
        name = f"period ≥ {first}" if last == PERIODS[-1][1] else name
        classes.append((periodic & (period >= first) & (period <= last), color, name))
    return classes


def motions(view: MapView) -> MapLayers:
    """Return the layers of the motion map: periodic motions by name, with labels on large regions.

    The name n-p-q gives the periods and the numbers of impacts on the upper and on the lower stop.
    """
    regime, counts = view.plane.regime, [view.plane[name] for name in VARIABLES]
    names, number = motions_of(regime, *counts)
    colors = [color_of(motion) for motion in names]
    listed_motions = [
        (color, motion.label) for motion, color in zip(names, colors, strict=True) if color not in UNLISTED
    ]
    legend = [LegendEntry(color, label) for color, label in listed_motions if color != STICKS]
    by_area = np.argsort(-np.bincount(number[number >= 0], minlength=len(names)), kind="stable")
    for color in UNLISTED:
        shared = [names[k].label for k in by_area if colors[k] == color]
        more = ", …" if len(shared) > _NAMED else ""
        legend += [LegendEntry(color, ", ".join(shared[:_NAMED]) + more)] if shared else []
    legend += [LegendEntry(STICKS, label, STICKS_HATCH) for color, label in listed_motions if color == STICKS]
    rests = HatchLayer((regime == PERIODIC) & (counts[1] < 0), STICKS_HATCH, looks.TEXTURE)
    named = [(number == k, motion.label, colors[k]) for k, motion in enumerate(names) if motion.p >= 0]
    key = text.motion_key(view.ds)
    return build_layers(
        regime, numbered=(number, colors), legend=legend, textures=[rests], side_legend_title=key, names=named
    )


def color_of(motion: MotionName) -> str:
    """Return the colour of a periodic motion n-p-q, the same in every picture; a mirror image has the same hue."""
    if motion.p < 0:
        return STICKS
    group = (motion.n, max(motion.p, motion.q), min(motion.p, motion.q))
    if group in HUES:
        return HUES[group][motion.p < motion.q]
    return UNLISTED[crc32(repr(group).encode()) % len(UNLISTED)]


def attractors(view: MapView) -> MapLayers:
    """Return the layers of the map of the number of attractors that the initial states of each cell reach.

    A cell with undecided initial states may have more attractors; the map shows the number of those known.
    """
    most = max(COUNTS)
    count = np.minimum(np.nan_to_num(view.plane.known_values("attractors")).round(), most)
    names = {1: "1 attractor", most: f"{most} or more"}
    classes = [(count == n, color, names.get(n, f"{n} attractors")) for n, color in COUNTS.items()]
    return build_layers(view.plane.regime, classes, side_legend_title="")


def labels(view: MapView) -> MapLayers:
    """Return the layers of the branch map: each cell by the labelled branch of orbits to which its attractor belongs.

    Of several attractors the one with the largest share of the initial states counts by default. A mirror image has a
    darker tone of its twin's hue. Chaos and tori have no label, and the colour of their regime.
    """
    known, label = branches(view.ds), np.rint(view.plane[LABEL.name]).astype(np.int64)
    numbered, entries = (label, branch_colors(known)), branch_entries(known, label)
    return build_layers(view.plane.regime, numbered=numbered, legend=entries, side_legend_title="")


def colors_of(
    known: xr.Dataset, palette: Sequence[str], mirrored: float, quiet: str, rest: str | None = None
) -> list[str]:
    """Return the colour of every attractor of the table ``known``, in the order of the table.

    known     table of attractors, with their regimes and the index of each one's mirror image
    palette   colours in order of label, repeated if there are more attractors and ``rest`` is None
    mirrored  lightness of a mirror image, in its twin's hue
    quiet     colour of motion without impact
    rest      colour of all attractors beyond the palette
    """
    colors: list[str] = []
    used = 0
    for k, (regime, mirror) in enumerate(zip(known["regime"].values, known["mirror"].values, strict=True)):
        if regime == NO_IMPACT:
            colors.append(quiet)
        elif 0 <= mirror < k and colors[mirror] == rest:
            colors.append(colors[mirror])
        elif 0 <= mirror < k:
            colors.append(looks.with_lightness(colors[mirror], mirrored))
        elif rest is not None and used >= len(palette):
            colors.append(rest)
        else:
            colors.append(palette[used % len(palette)])
            used += 1
    return colors


def branch_colors(known: xr.Dataset, ink: bool = False) -> list[str]:
    """Return the colour of every branch of the table ``known``, in order of label; small branches share one colour.

    With ``ink`` the colours suit points on white.
    """
    quiet = looks.INK[NO_IMPACT] if ink else REGIME_COLORS[NO_IMPACT]
    return colors_of(known, PALETTE, DARKER, quiet, REST)


def branch_entries(known: xr.Dataset, label: NDArray[np.int64], ink: bool = False) -> list[LegendEntry]:
    """Return the legend entries of the branches whose labels occur in ``label``.

    known   table of branches
    label   labels of cells; negative for cells without a label
    ink     True for colours that suit points on white
    """
    numbers, colors = np.unique(label[label >= 0]), branch_colors(known, ink)
    named = [k for k in numbers.tolist() if colors[k] != REST]
    entries = [LegendEntry(colors[k], f"{k}: {_name_of_branch(known, k)}") for k in named]
    return entries + ([LegendEntry(REST, f"{len(numbers) - len(named)} others")] if len(numbers) > len(named) else [])


def _name_of_branch(known: xr.Dataset, label: int) -> str:
    """Return the name of a branch: n-p-q (periods, impacts at each stop), and the branch that it mirrors, if any."""
    one = known.isel(branch=label)
    if int(one["regime"]) == NO_IMPACT:
        return REGIME.meaning(NO_IMPACT).text
    name = MotionName(*(int(one[variable]) for variable in VARIABLES)).label
    return name + (f", mirrors {int(one['mirror'])}" if 0 <= int(one["mirror"]) < label else "")


def basins(view: MapView) -> MapLayers:
    """Return the layers of the basin map: initial states by the attractor that they reach, darker for slow settling.

    A mirror image has a paler tone of its twin's hue. The states of the attractors at t = k T, the start of each
    forcing period, are points over the map. A cycle of a machine without a force is drawn with many points along it.
    """
    known, plane, unforced = reached.table(view.ds), view.plane, text.is_unforced(view.ds)
    colors = colors_of(known, BASINS, PALER, REGIME_COLORS[NO_IMPACT])
    label, settled = np.rint(plane[LABEL.name]).astype(np.int64), plane[SETTLED.name]
    regimes = text.regime(view.ds)
    named = [(label == k, color, _name_of_attractor(known, k, regimes)) for k, color in enumerate(colors)]
    layers, labelled_mask = build_layers(plane.regime, named), label >= 0
    points, shade, legend = _points(known, plane, colors), None, list(layers.legend)
    if labelled_mask.any():
        soon, late = np.percentile(settled[labelled_mask], [SOONEST, LATEST]).tolist()
        shade = ShadingLayer(np.where(labelled_mask, settled, np.nan), soon, late, SLOW)
        if late > soon:
            periods = "natural periods" if unforced else "periods"
            meaning = f"light to dark: settles in {soon:.0f} to {late:.0f} {periods}"
            at = sum(bool(cells.any()) for cells, _, _ in named)  # entries go after the attractors, before the regimes
            legend.insert(at, LegendEntry("#c8c8c8", meaning, min_brightness=SLOW))
    entry = MarkLook("attractor" if unforced else "attractor at $t = kT$", "o", 5.0, "white", "black", 1.0)
    return replace(layers, legend=legend, shade=shade, points=points, point_entry=entry)


def _name_of_attractor(known: xr.Dataset, label: int, regimes: Variable) -> str:
    """Return the name of an attractor for the legend: label, period or regime, and share of the initial states."""
    one = known.isel({ATTRACTOR: label})
    regime = int(one["regime"])
    what = f"period {int(one['period'])}" if regime == PERIODIC else regimes.meaning(regime).text
    if is_cycle(one):
        what = f"cycle of {float(one[CYCLE_PERIOD.name]):.4g}"
    return f"{label}: {what}, {100 * float(one['share']):.3g} %"


def is_cycle(one: xr.Dataset) -> bool:
    """Return True if the attractor ``one`` is a limit cycle of a machine without a force.

    The points of such a cycle lie all along it.
    """
    return CYCLE_PERIOD.name in one and bool(np.isfinite(one[CYCLE_PERIOD.name]))


def _points(known: xr.Dataset, plane: Plane, colors: list[str]) -> list[PointLayer]:
    """Return the states of the attractors at t = k T as points over a plane of initial states, by attractor."""
    names = [str(name) for name in known["component"].values]
    at = [names.index(axis.name) for axis in (plane.x, plane.y)]
    points = []
    for k, color in enumerate(colors):
        one = known.isel({ATTRACTOR: k})
        single = int(one["period"]) > 0 and not is_cycle(one)
        look = MarkLook("", *(("o", 5.0, color, "black", 0.8) if single else (".", 2.0, color, "black", 0.2)))
        points.append(PointLayer(one["points"].values[:, at], look))
    return points
