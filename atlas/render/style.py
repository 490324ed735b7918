"""Matplotlib's side of all pictures: its settings, and the artists of lines, marks and legend entries."""

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.colors import to_rgb
from matplotlib.legend import Legend
from matplotlib.legend_handler import HandlerPatch
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.patheffects import withStroke

from atlas.render.looks import Entry, LineLook, MarkLook

DPI = 300.0
"""Default dots per inch of a file."""


def rc_params(scale: float) -> dict[str, Any]:
    """Return Matplotlib's settings for our pictures, with type sizes ``scale`` times those of the standard layout."""
    return {
        "font.family": "STIXGeneral",
        "mathtext.fontset": "stix",
        "font.size": 10.0 * scale,
        "axes.titlesize": 10.0 * scale,
        "axes.labelsize": 11.0 * scale,
        "axes.linewidth": 0.7,
        "xtick.labelsize": 9.5 * scale,
        "ytick.labelsize": 9.5 * scale,
        "xtick.direction": "out",
        "ytick.direction": "out",
        "xtick.major.width": 0.7,
        "ytick.major.width": 0.7,
        "legend.fontsize": 9.0 * scale,
        "legend.title_fontsize": 9.0 * scale,
        "legend.frameon": False,
        "legend.handlelength": 1.3,
        "legend.handleheight": 0.95,
        "hatch.linewidth": 0.5,
        "savefig.dpi": DPI,
        "savefig.bbox": None,  # keeps the given size of the figure
        "pdf.fonttype": 42,
        "svg.hashsalt": "impact-atlas",
    }


_OF_LOOKS = {
    "axes", "figure", "font", "grid", "hatch", "image", "legend", "lines", "markers", "mathtext", "patch", "path",
    "savefig", "text", "xtick", "ytick",
}  # fmt: skip
"""Groups of Matplotlib's settings that decide how a figure looks."""


def defaults() -> dict[str, Any]:
    """Return Matplotlib's own default settings for the appearance of figures.

    A layout begins with them, so that a user's settings for other figures have no effect.
    """
    return {name: value for name, value in mpl.rcParamsDefault.items() if name.partition(".")[0] in _OF_LOOKS}


_alone = threading.RLock()


@contextmanager
def drawing_context(settings: Mapping[str, Any] | None = None) -> Iterator[None]:
    """Draw in one thread at a time, with the given settings of Matplotlib; the former settings are restored.

    Settings belong to the whole process, and drawing of text is not thread-safe. The explorer's renderers, its
    portraits and files, and its user's drawings in a notebook therefore take turns. Other settings, which another
    thread of the user may change meanwhile, keep their changes.
    """
    of_all: Any = mpl.rcParams
    with _alone:
        before = {name: of_all[name] for name in settings or {}}
        try:
            of_all.update(settings or {})
            yield
        finally:
            of_all.update(before)


class GradientPatch(Patch):
    """A legend entry: a box of a colour that darkens from left to right, down to ``dark`` times its brightness."""

    def __init__(self, color: str, dark: float, label: str) -> None:
        super().__init__(facecolor=color, edgecolor="#404040", linewidth=0.5, label=label)
        self.dark = dark


class _GradientHandler(HandlerPatch):
    """Draws the box of a ``GradientPatch`` in stripes."""

    def create_artists(self, legend, orig_handle, xdescent, ydescent, width, height, fontsize, trans):  # type: ignore[no-untyped-def]
        color, shades = np.array(to_rgb(orig_handle.get_facecolor())), np.linspace(1.0, orig_handle.dark, 16)
        step, look = width / shades.size, {"transform": trans}
        stripes = [
            Rectangle((k * step - xdescent, -ydescent), 1.02 * step, height, color=shade * color, linewidth=0, **look)
            for k, shade in enumerate(shades)
        ]
        frame = Rectangle((-xdescent, -ydescent), width, height, **look, fill=False, edgecolor="#404040", linewidth=0.5)
        return [*stripes, frame]


Legend.update_default_handler_map({GradientPatch: _GradientHandler()})


EDGE = 1.5
"""Extra width, in points, of the edge of a line, both sides together."""


def dashes_of(dashes: tuple[float, ...]) -> Any:
    """Return dashes and gaps as Matplotlib's line style."""
    return (0, dashes) if dashes else "solid"


def line(look: LineLook) -> dict[str, Any]:
    """Return arguments of ``Axes.plot`` that draw a line, without its edge."""
    return {"color": look.color, "linewidth": look.width, "linestyle": dashes_of(look.dashes)}


def mark(look: MarkLook) -> dict[str, Any]:
    """Return arguments of ``Axes.plot`` that draw points with a mark."""
    return {
        "linestyle": "", "marker": look.marker, "markersize": look.size, "color": look.color,
        "markeredgecolor": look.edge, "markeredgewidth": look.width,
    }  # fmt: skip


def artist(entry: Entry) -> Artist:
    """Return a legend entry as an artist of Matplotlib."""
    if isinstance(entry, str):
        return Line2D([], [], linestyle="", label=entry)
    if isinstance(entry, MarkLook):
        return Line2D([], [], label=entry.label, **mark(entry))
    if isinstance(entry, LineLook):
        drawn = Line2D([], [], label=entry.label, **line(entry))
        if entry.edge:
            drawn.set_path_effects([withStroke(linewidth=entry.width + EDGE, foreground=entry.edge)])
        return drawn
    if entry.min_brightness < 1.0:
        return GradientPatch(entry.color, entry.min_brightness, entry.label)
    edge, hatch = entry.hatch_color if entry.hatch else "#404040", entry.hatch and 2 * entry.hatch
    return Patch(facecolor=entry.color, edgecolor=edge, linewidth=0.5, hatch=hatch, label=entry.label)
