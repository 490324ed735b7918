"""Basins of attraction: which attractor each initial state of a plane reaches, and how long it takes."""

from functools import partial

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from atlas.query.basins import table
from atlas.render import maps, style
from atlas.render.classes import PALER, colors_of
from atlas.render.maps import Painted, View
from workers.results import ATTRACTOR, LABEL, NO_IMPACT, PERIODIC, SETTLED

COLORS = ("#4477aa", "#e0a83a", "#5fa36a", "#b65c8f", "#7f6bb3", "#8fb8d8", "#c9703f", "#6d6d6d")
"""Colours of attractors by their labels; they begin anew where there are more."""
SLOW = 0.55
"""How dark the initial states are that take longest to settle, black 0."""
SOONEST, LATEST = 5.0, 95.0
"""Per cent of initial states that settle sooner than any that is shaded, and than those drawn darkest."""


def paint(view: View) -> Painted:
    """The colours of attractors, darker where motion takes longer to settle; their section points lie on top.

    A mirror image has a paler tone of its twin's hue.
    """
    known, plane = table(view.ds), view.plane
    colors = colors_of(known, COLORS, PALER, style.COLORS[NO_IMPACT])
    labels = np.rint(plane[LABEL.name]).astype(np.int64)
    painted = painted_basins(plane.regime, labels, plane[SETTLED.name], colors, known)
    points = partial(_draw_points, known=known, plane=plane, colors=colors)
    return Painted(painted.rgba, painted.legend, over=points)


def painted_basins(
    regime: NDArray[np.int8],
    labels: NDArray[np.int64],
    settled: NDArray[np.float64],
    colors: list[str],
    known: xr.Dataset,
) -> Painted:
    """The same of arrays (y, x), without the points."""
    rgba, legend, there = np.zeros((*labels.shape, 4), np.uint8), [], labels >= 0
    for k, color in enumerate(colors):
        cells = labels == k
        if cells.any():
            rgba[cells] = style.rgb(color)
            legend.append(style.swatch(color, name_of(known.isel({ATTRACTOR: k}), k)))
    if there.any():
        soon, late = np.percentile(settled[there], [SOONEST, LATEST])
        slow = np.clip((settled - soon) / max(late - soon, 1.0), 0.0, 1.0)
        shade = 1.0 - (1.0 - SLOW) * slow[there]
        rgba[there, :3] = (rgba[there, :3] * shade[:, None]).astype(np.uint8)
        if late > soon:
            said = f"light to dark: settles in {soon:.0f} to {late:.0f} periods"
            legend.append(style.Gradient("#c8c8c8", SLOW, said))
    return Painted(rgba, legend + maps.paint_regimes(rgba, regime, ~there))


def name_of(one: xr.Dataset, label: int) -> str:
    """An attractor in a few words: its regime or period, its label, its share."""
    regime, period = int(one["regime"]), int(one["period"])
    what = f"period {period}" if regime == PERIODIC else style.name_of(regime)
    return f"{label}: {what}, {100 * float(one['share']):.3g} %"


def _draw_points(ax: Axes, known: xr.Dataset, plane: maps.Plane, colors: list[str]) -> list[Artist]:
    """Draw the section points of the attractors on the plane of the initial states; the legend entry."""
    names = [str(name) for name in known["component"].values]
    x, y = names.index(plane.x.name), names.index(plane.y.name)
    for k, color in enumerate(colors):
        points = known["points"].isel({ATTRACTOR: k}).values
        marker, size, edge = ("o", 5.0, 0.8) if int(known["period"][k]) > 0 else (".", 2.0, 0.2)
        ax.plot(
            points[:, x], points[:, y], linestyle="", marker=marker, markersize=size, color=color,
            markeredgecolor="black", markeredgewidth=edge, zorder=4, scalex=False, scaley=False,
        )  # fmt: skip
    look = {"linestyle": "", "marker": "o", "markersize": 5, "color": "white", "markeredgecolor": "black"}
    return [Line2D([], [], label="section", **look)]  # type: ignore[arg-type]
