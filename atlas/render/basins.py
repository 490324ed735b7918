"""Basins of attraction: which attractor each initial state of a plane reaches, and how long it takes."""

from functools import partial

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from atlas.query.basins import table
from atlas.render import maps, style
from atlas.render.classes import PALER, colored, colors_of
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
    colors, labels = (
        colors_of(known, COLORS, PALER, style.COLORS[NO_IMPACT]),
        np.rint(plane[LABEL.name]).astype(np.int64),
    )
    named = [(labels == k, color, name_of(known.isel({ATTRACTOR: k}), k)) for k, color in enumerate(colors)]
    there, settled = labels >= 0, plane[SETTLED.name]
    painted = colored(plane.regime, named)
    rgba, legend = painted.rgba, list(painted.legend)
    if there.any():
        soon, late = np.percentile(settled[there], [SOONEST, LATEST])
        slow = np.clip((settled - soon) / max(late - soon, 1.0), 0.0, 1.0)
        shade = 1.0 - (1.0 - SLOW) * slow[there]
        rgba[there, :3] = (rgba[there, :3] * shade[:, None]).astype(np.uint8)
        if late > soon:
            said = f"light to dark: settles in {soon:.0f} to {late:.0f} periods"
            at = sum(bool(cells.any()) for cells, _, _ in named)  # after the attractors, before the regimes
            legend.insert(at, style.Gradient("#c8c8c8", SLOW, said))
    return Painted(rgba, legend, over=partial(_draw_points, known=known, plane=plane, colors=colors))


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
