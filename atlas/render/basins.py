"""Basins of attraction: which attractor each initial state of a plane reaches, and how long it takes."""

import colorsys
from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.query.basins import of_basins, table
from atlas.render import maps, overlays, style
from workers.results import ATTRACTOR, LABEL, REGIME

COLORS = ("#4477aa", "#e0a83a", "#5fa36a", "#b65c8f", "#7f6bb3", "#8fb8d8", "#c9703f", "#6d6d6d")
"""Colours of attractors by their labels; they begin anew where there are more."""
NO_IMPACT_COLOR = style.COLORS[0]
MIRROR_LIGHTNESS = 0.8
"""Lightness of a mirror image's colour, whose hue is that of its twin, on the way to white 1."""
SLOW = 0.55
"""How dark the initial states are that take longest to settle, black 0."""
SOONEST, LATEST = 5.0, 95.0
"""Per cent of initial states that settle sooner than any that is shaded, and than those drawn darkest."""


def figure(ds: xr.Dataset, options: maps.Options = maps.PLAIN) -> Figure:
    """The basins as a figure: colours are attractors, darker where motion takes longer to settle.

    Their section points lie on top. A mirror image has a paler tone of its twin's hue. InputError where the atlas is
    not one of basins.
    """
    if not of_basins(ds):
        raise InputError("kind 'basins' draws labels: both axes must be initial states, and the spec have [attractors]")
    return picture(ds, table(ds), options)


def picture(ds: xr.Dataset, known: xr.Dataset, options: maps.Options = maps.PLAIN) -> Figure:
    """As ``figure``, with the table of the attractors given."""
    plane = overlays.read(ds, [LABEL.name, "settled"], "basins", options)
    labels = np.rint(plane[LABEL.name]).astype(np.int64)
    colors = colors_of(known)
    with options.page.context():
        drawn, ax = maps.frame(ds, options.page)
        rgba, legend = paint(plane.regime, labels, plane["settled"], colors, known)
        maps.draw(ax, plane, rgba, options)
        entries: list[Artist] = [*legend, *_draw_points(ax, known, plane, colors)]
        entries += overlays.draw(ax, ds, plane, options)
        options.page.legend(drawn, entries)
    return drawn


def colors_of(known: xr.Dataset, palette: Sequence[str] = COLORS, rest: str | None = None) -> list[str]:
    """The colour of every attractor: that of a mirror image is a paler tone of its twin's.

    Where the palette is used up it begins anew, or ``rest`` is the colour of all others.
    """
    found: list[str] = []
    used = 0
    for k, (regime, mirror) in enumerate(zip(known[REGIME.name].values, known["mirror"].values, strict=True)):
        if regime == 0:
            found.append(NO_IMPACT_COLOR)
        elif 0 <= mirror < k:
            found.append(found[mirror] if found[mirror] == rest else _paler(found[mirror]))
        elif rest is not None and used >= len(palette):
            found.append(rest)
        else:
            found.append(palette[used % len(palette)])
            used += 1
    return found


def paint(
    regime: NDArray[np.int8],
    labels: NDArray[np.int64],
    settled: NDArray[np.float64],
    colors: list[str],
    known: xr.Dataset,
) -> tuple[NDArray[np.uint8], list[Patch]]:
    """The colour of every initial state, (y, x, 4) in bytes, and legend entries for the attractors present."""
    rgba = np.zeros((*labels.shape, 4), dtype=np.uint8)
    there = labels >= 0
    shade = np.ones(labels.shape)
    soon = late = 0.0
    if there.any():
        soon, late = np.percentile(settled[there], [SOONEST, LATEST])
        slow = np.clip((settled - soon) / max(late - soon, 1.0), 0.0, 1.0)
        shade = 1.0 - (1.0 - SLOW) * slow
    legend = []
    for k, color in enumerate(colors):
        cells = labels == k
        if cells.any():
            rgba[cells] = style.rgb(color)
            legend.append(style.swatch(color, name_of(known.isel({ATTRACTOR: k}), k)))
    if late > soon:
        legend.append(style.swatch("#808080", f"from pale to dark: settles in {soon:.0f} to {late:.0f} periods"))
    rgba[there, :3] = (rgba[there, :3] * shade[there][:, None]).astype(np.uint8)
    return rgba, legend + maps.paint_regimes(rgba, regime, ~there)


def name_of(one: xr.Dataset, label: int) -> str:
    """An attractor in a few words: its regime or period, its label, its share."""
    regime, period = int(one[REGIME.name]), int(one["period"])
    what = f"period {period}" if regime == 1 else style.name_of(regime)
    return f"{label}: {what}, {100 * float(one['share']):.3g} %"


def _draw_points(ax: Axes, known: xr.Dataset, plane: maps.Plane, colors: list[str]) -> list[Artist]:
    """The section points of the attractors on the plane of the initial states."""
    names = [str(name) for name in known["component"].values]
    x, y = names.index(plane.x.name), names.index(plane.y.name)
    for k, color in enumerate(colors):
        points = known["points"].isel({ATTRACTOR: k}).values
        orbit = int(known["period"][k]) > 0
        ax.plot(
            points[:, x],
            points[:, y],
            linestyle="",
            marker="o" if orbit else ".",
            markersize=5.0 if orbit else 2.0,
            color=color,
            markeredgecolor="black",
            markeredgewidth=0.8 if orbit else 0.2,
            zorder=4,
            scalex=False,
            scaley=False,
        )
    return [
        Line2D([], [], linestyle="", marker="o", markersize=5, color="white", markeredgecolor="black", label="section")
    ]


def _paler(color: str) -> str:
    hue, lightness, saturation = colorsys.rgb_to_hls(*to_rgb(color))
    red, green, blue = colorsys.hls_to_rgb(hue, max(MIRROR_LIGHTNESS, lightness), saturation)
    return f"#{round(255 * red):02x}{round(255 * green):02x}{round(255 * blue):02x}"
