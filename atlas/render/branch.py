"""Branches of periodic orbits as a picture: section values of the gap coordinate, solid where stable, else dashed."""

from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from atlas.branches.table import Branches
from atlas.render import style, words
from atlas.render.fit import TITLE
from atlas.render.page import STANDARD, Page

INK = "#1a1a1a"
"""The colour of branches."""
DASHES: dict[bool, Any] = {True: "solid", False: (0, (3.2, 1.4))}
"""Line styles of stable and of unstable parts."""
_WIDTHS = {True: 1.1, False: 0.6}
_MARKER = 3.6
"""Size of an event's marker in points."""


def figure(branches: Branches, page: Page = STANDARD) -> Figure:
    """Branches as a figure of their own, under the title line of the other parameters."""
    system, parameter = branches.system, branches.system.parameter(branches.along)
    with page.context():
        drawn, (ax,) = page.panels(1.2 + 0.45 * page.width, 1)
        entries = draw(ax, branches, page)
        symbol = words.shown_symbol(parameter.symbol, parameter.name)
        ax.set_xlabel(f"{parameter.meaning.split(':')[0]} ${symbol}${words.unit_ending(parameter.unit)}")
        ax.set_ylabel(words.gap_label(system))
        ax.set_xlim(*branches.window)
        ax.margins(y=0.06)
        if page.title:
            shown = {name: value for name, value in branches.parameters.items() if name not in system.states}
            ax.set_title(words.system_line(system, shown), loc="left", gid=TITLE)
        page.legend(drawn, entries)
    return drawn


def draw(ax: Axes, branches: Branches, page: Page) -> list[Artist]:
    """Draw branches, those of mirror images too, with their events, and return the legend entries of what is there."""
    lines: dict[bool, list[NDArray[np.float64]]] = {True: [], False: []}
    events: dict[str, list[NDArray[np.float64]]] = {}
    for branch in branches.traced:
        at = {id(point): k for k, point in enumerate(branch.run.points)}
        for values in branches.gap_values(branch):
            for stable, part in branch.parts:
                lines[stable] += [np.column_stack([branch.values[part], column]) for column in values[part].T]
            for event in branch.run.events:
                k = at[id(event.point)]
                places = np.column_stack([np.full(values.shape[1], branch.values[k]), values[k]])
                events.setdefault(event.kind, []).append(places)
    entries: list[Artist] = []
    for stable, label in ((True, "stable orbit"), (False, "unstable orbit")):
        if lines[stable]:
            width, dashes = _WIDTHS[stable] * page.scale, DASHES[stable]
            ax.add_collection(
                LineCollection(lines[stable], colors=INK, linewidths=width, linestyles=[dashes], zorder=4)
            )
            entries.append(Line2D([], [], color=INK, linewidth=width, linestyle=dashes, label=label))
    for kind in [kind for kind in style.LOOKS if kind in events]:
        look = style.event_look(kind, _MARKER * page.scale)
        ax.plot(*np.concatenate(events[kind]).T, zorder=5, **look)
        entries.append(Line2D([], [], **look))
    ax.autoscale_view()
    return entries
