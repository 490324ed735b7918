"""Saddles and their stable manifolds over the basins of one mass."""

from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from atlas.curves.asking import header_of
from atlas.errors import InputError
from atlas.query.basins import of_basins
from atlas.query.plane import Axis
from atlas.render import style
from atlas.render.maps import View
from atlas.robustness.saddles import saddles_between
from workers.attractors.basins import fixed_values

BEYOND = 0.5
"""How far beyond the picture manifolds are grown, in parts of its sides."""


def draw(ax: Axes, view: View) -> list[Artist]:
    """Draw the saddles between the basins of a plane and their stable manifolds; the legend entries."""
    spec, names = header_of(view.ds).spec, (view.plane.x.name, view.plane.y.name)
    record = spec.record
    if not of_basins(view.ds) or len(record.states) != 2 or spec.attractors is None:
        raise InputError("overlay 'saddles' is drawn over basins of one mass")
    values = fixed_values(record, spec.parameters)
    box = {axis.name: _around(axis) for axis in (view.plane.x, view.plane.y)}
    found = saddles_between(record, values, spec.settings, spec.attractors, manifolds=True, box=box)["saddles"]
    order = [record.states.index(name) for name in names]
    lines = [np.array(line)[:, order] for each in found for line in each["manifold"] if len(line) > 1]
    for color, width in (("white", 2.2), ("black", 0.9)):
        ax.add_collection(LineCollection(lines, colors=color, linewidths=width, zorder=3.2), autolim=False)
    look: dict[str, Any] = style.mark("X", 7.0, "black", "white", 0.8)
    for each in found:
        ax.plot(*np.array(each["states"])[:, order].T, zorder=4.2, scalex=False, scaley=False, gid="saddle", **look)
    if not found:
        return [Line2D([], [], linestyle="", label="no saddle found between basins")]
    manifold = Line2D([], [], color="black", linewidth=0.9, label="stable manifold of a saddle")
    return [Line2D([], [], label="saddle: unstable orbit", **look), manifold]


def _around(axis: Axis) -> tuple[float, float]:
    """The ends between which manifolds are grown: they leave the picture and come back."""
    low, high = float(axis.edges[0]), float(axis.edges[-1])
    return low - BEYOND * (high - low), high + BEYOND * (high - low)
