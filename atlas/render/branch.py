"""Branches of periodic orbits as a picture: section values of the gap coordinate, solid where stable, else dashed."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from atlas.branches.table import Branches
from atlas.branches.tree import Branch
from atlas.query import machine
from atlas.render import gap, style
from atlas.render.events import LOOKS, marker_look
from atlas.render.fit import TITLE
from atlas.render.page import STANDARD, Page

Array = NDArray[np.float64]

INK = "#1a1a1a"
"""The colour of branches."""
DASHES: dict[bool, Any] = {True: "solid", False: (0, (3.2, 1.4))}
"""Those of stable and of unstable parts."""
_WIDTHS = {True: 1.1, False: 0.6}
_MARKER = 3.6
"""Size of an event's marker in points."""


def figure(branches: Branches, page: Page = STANDARD) -> Figure:
    """Branches as a figure of their own, under the title line of the other parameters."""
    with page.context():
        drawn, (ax,) = page.panels(1.2 + 0.45 * page.width, 1)
        entries = draw(ax, branches, page)
        parameter = branches.system.parameter(branches.along)
        symbol = style.shown_symbol(parameter.symbol, parameter.name)
        ax.set_xlabel(f"{parameter.meaning.split(':')[0]} ${symbol}${gap.unit_of({parameter.unit})}")
        ax.set_ylabel(gap.gap_label_of(branches.system))
        ax.set_xlim(*branches.window)
        ax.margins(y=0.06)
        if page.title:
            shown = [p for p in branches.system.parameters if p.name not in (*branches.system.states, branches.along)]
            signs = [(style.shown_symbol(p.symbol, p.name), branches.parameters[p.name]) for p in shown]
            ax.set_title(style.parameter_line(signs), loc="left", gid=TITLE)
        page.legend(drawn, entries)
    return drawn


def draw(ax: Axes, branches: Branches, page: Page) -> list[Artist]:
    """Draw branches, those of mirror images too, with their events, and return the legend entries of what is there."""
    lines: dict[bool, list[Array]] = {True: [], False: []}
    events: dict[str, list[Array]] = {}
    for branch in branches.traced:
        for values in section_values(branches, branch):
            for stable, part in parts(branch):
                lines[stable] += [np.column_stack([branch.values[part], column]) for column in values[part].T]
            at = {id(point): k for k, point in enumerate(branch.run.points)}
            for event in branch.run.events:
                k = at[id(event.point)]
                events.setdefault(event.kind, []).append(
                    np.column_stack([np.full(values.shape[1], branch.values[k]), values[k]])
                )
    entries: list[Artist] = []
    for stable, label in ((True, "stable orbit"), (False, "unstable orbit")):
        if lines[stable]:
            width, dashes = _WIDTHS[stable] * page.scale, DASHES[stable]
            drawn = LineCollection(lines[stable], colors=INK, linewidths=width, linestyles=[dashes], zorder=4)
            ax.add_collection(drawn)
            entries.append(Line2D([], [], color=INK, linewidth=width, linestyle=dashes, label=label))
    for kind in LOOKS:
        if kind in events:
            look = marker_look(kind, _MARKER * page.scale)
            ax.plot(*np.concatenate(events[kind]).T, zorder=5, **look)
            entries.append(Line2D([], [], label=LOOKS[kind].label, **look))
    ax.autoscale_view()
    return entries


def section_values(branches: Branches, branch: Branch) -> Iterator[Array]:
    """The gap coordinate (N, n) at the sections of a branch, and of its mirror image where there is one."""
    rows = machine.gap_rows(branches.system, {**branches.parameters, branches.along: branch.values})
    for states in (branch.sections, branch.mirrored):
        if states is not None:
            yield np.einsum("ni,nki->nk", rows, states[..., : rows.shape[1]])


def parts(branch: Branch) -> Iterator[tuple[bool, slice]]:
    """Stretches of points that are all stable, or all unstable, each joined to the next at the point between them."""
    unstable = np.array([point.unstable for point in branch.run.points]) > 0
    steps = unstable[1:] | unstable[:-1]
    ends = [0, *(np.flatnonzero(steps[1:] != steps[:-1]) + 1).tolist(), len(steps)]
    for first, last in pairwise(ends):
        if last > first:
            yield not steps[first], slice(first, last + 1)
