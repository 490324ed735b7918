"""Axes to scale: where the cells of an axis lie, how the axis is drawn, and cells as coloured areas."""

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.axis import XAxis, YAxis
from matplotlib.collections import LineCollection
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator
from numpy.typing import NDArray

from atlas.query.window import LOG_SPAN, axis_names, cell_edges, is_log
from atlas.render.style import axis_label
from atlas.spec.cells import is_uniform


@dataclass(frozen=True)
class DrawnAxis:
    """One axis of a picture: its points in rising order, their cells' edges, its scale and its label."""

    name: str
    values: NDArray[np.float64]
    edges: NDArray[np.float64]
    log: bool
    label: str

    @property
    def uniform(self) -> bool:
        """Whether all cells are drawn equally wide on a linear scale."""
        return not self.log and is_uniform(self.values)


def rising(ds: xr.Dataset) -> tuple[xr.Dataset, tuple[DrawnAxis, ...]]:
    """The dataset with every axis in rising order, and its axes, x first."""
    names = axis_names(ds)
    for name in names:
        if np.any(np.diff(ds[name].values) <= 0):
            ds = ds.sortby(name)
    return ds, tuple(_axis(ds, name) for name in names)


def _axis(ds: xr.Dataset, name: str) -> DrawnAxis:
    values = np.asarray(ds[name].values, dtype=np.float64)
    log = is_log(ds, name) and values[-1] / values[0] >= LOG_SPAN
    return DrawnAxis(name, values, cell_edges(ds, name), log, axis_label(ds, name))


def scale_x(ax: Axes, x: DrawnAxis, label: bool = True) -> None:
    """Give the horizontal axis its scale, limits and ticks, and its label if asked."""
    if x.log:
        ax.set_xscale("log")
        _log_ticks(ax.xaxis, x)
    ax.set_xlim(x.edges[0], x.edges[-1])
    if label:
        ax.set_xlabel(x.label)


def scale_y(ax: Axes, y: DrawnAxis) -> None:
    """Give the vertical axis its scale, limits, ticks and label."""
    if y.log:
        ax.set_yscale("log")
        _log_ticks(ax.yaxis, y)
    ax.set_ylim(y.edges[0], y.edges[-1])
    ax.set_ylabel(y.label)


def draw_cells(ax: Axes, x: DrawnAxis, y: DrawnAxis, rgba: NDArray[np.uint8]) -> None:
    """Draw an array (y, x, 4) of colours, each cell from edge to edge, as pixels in vector files too.

    An image where all cells are equal; quadrilaterals otherwise. Colours are never blended between cells.
    """
    if x.uniform and y.uniform:
        extent = (x.edges[0], x.edges[-1], y.edges[0], y.edges[-1])
        ax.imshow(rgba, origin="lower", extent=extent, aspect="auto", interpolation="nearest")
    else:
        ax.pcolormesh(x.edges, y.edges, rgba, rasterized=True)
    scale_x(ax, x)
    scale_y(ax, y)


def in_points(ax: Axes, at: NDArray[np.float64], size: tuple[float, float]) -> NDArray[np.float64]:
    """Data coordinates in points from the lower left corner of the plot, by its nominal size: as a layout that
    is not made yet will have them, nearly.
    """
    return np.asarray(ax.transAxes.inverted().transform(ax.transData.transform(at)) * np.array(size))


def outline(ax: Axes, x: DrawnAxis, y: DrawnAxis, inside: NDArray[np.bool_], color: str, width: float) -> None:
    """Draw the boundary of a set of cells along the cells' edges; the picture's own frame is left out."""
    rows, columns = np.nonzero(inside[:, 1:] != inside[:, :-1])
    at = x.edges[columns + 1]
    upright = np.stack([at, y.edges[rows], at, y.edges[rows + 1]], axis=1)
    rows, columns = np.nonzero(inside[1:] != inside[:-1])
    at = y.edges[rows + 1]
    level = np.stack([x.edges[columns], at, x.edges[columns + 1], at], axis=1)
    ends = np.concatenate([upright, level]).reshape(-1, 2, 2)
    lines = LineCollection(list(ends), colors=color, linewidths=width, capstyle="projecting", rasterized=True)
    ax.add_collection(lines, autolim=False)


def hatch(ax: Axes, x: DrawnAxis, y: DrawnAxis, inside: NDArray[np.bool_], pattern: str, color: str) -> None:
    """Cover a set of cells with a texture that lets their colours through."""
    padded = np.pad(inside, ((0, 0), (1, 1))).astype(np.int8)
    change = np.diff(padded, axis=1)
    # Runs of cells in a row are one rectangle each, and all rectangles one path, so that the texture has no seams.
    rows, first = np.nonzero(change == 1)
    _, last = np.nonzero(change == -1)
    left, right, low, high = x.edges[first], x.edges[last], y.edges[rows], y.edges[rows + 1]
    corners = np.stack([left, low, right, low, right, high, left, high, left, low], axis=1).reshape(-1, 2)
    codes = np.tile([Path.MOVETO, Path.LINETO, Path.LINETO, Path.LINETO, Path.CLOSEPOLY], rows.size)
    if rows.size:
        path = Path(corners, codes)
        ax.add_patch(PathPatch(path, fill=False, hatch=pattern, edgecolor=color, linewidth=0, rasterized=True))


def _log_ticks(axis: XAxis | YAxis, scale: DrawnAxis) -> None:
    if math.log10(scale.values[-1] / scale.values[0]) > 3.0:
        return
    # Over few decades the default labels one or two powers of ten; 1, 2, 5 in plain numbers read better.
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())
