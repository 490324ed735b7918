"""The style of all pictures: type, colours, hatches, legend entries, and lines and markers of bifurcations."""

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.legend import Legend
from matplotlib.legend_handler import HandlerPatch
from matplotlib.patches import Patch, Rectangle
from matplotlib.typing import ColorType

from atlas.store.schema import REGIME_COLORS
from workers.results import APERIODIC, FAILED, INVALID, NO_IMPACT, PENDING, QUASIPERIODIC, REGULAR

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


TEXTURE = "#8c8c8c"
"""Grey of hatches."""

INK = {**REGIME_COLORS, NO_IMPACT: "#8c8c8c", APERIODIC: "#986020", REGULAR: "#c8a000"}
"""Colour of each regime for points and lines on white, where pale colours of areas are invisible."""

HATCH = {PENDING: "////", NO_IMPACT: "...", QUASIPERIODIC: "++", INVALID: "\\\\\\\\", FAILED: "xxxx"}
"""Hatch of each regime that colour alone does not distinguish.

White may mean no value, and impact-free cells may be coloured by their exponents. Grey and black may be colours at a
limit, and green looks like a shade of chaos without red receptors.
"""

HATCH_INK = {PENDING: TEXTURE, QUASIPERIODIC: "#a9dcb1", INVALID: "#f0f0f0", FAILED: "#ffffff"}
"""Colour of the hatches of regimes; a hatch without an entry has a colour that is visible on its cells."""

LOST_HATCH = "||"
"""Hatch of exponents that are -inf: rest on a stop erases disturbances."""


def rgb(color: str, alpha: int = 255) -> tuple[int, int, int, int]:
    """Return red, green, blue and ``alpha`` of a Matplotlib colour, each from 0 to 255."""
    red, green, blue = (round(255 * channel) for channel in to_rgb(color))
    return red, green, blue, alpha


def swatch(color: ColorType, label: str, hatch: str | None = None, ink: str = TEXTURE) -> Patch:
    """Return a legend entry: a framed box of a colour, with a hatch of the colour ``ink`` if one is given."""
    edge = ink if hatch else "#404040"
    return Patch(facecolor=color, edgecolor=edge, linewidth=0.5, hatch=hatch and 2 * hatch, label=label)


class GradientPatch(Patch):
    """A legend entry: a box of a colour that darkens from left to right, down to ``dark`` times its brightness."""

    def __init__(self, color: ColorType, dark: float, label: str) -> None:
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


def ink_on(color: ColorType) -> str:
    """Return a dark or a light colour for text, whichever is visible on the given colour."""
    red, green, blue = to_rgb(color)
    return "#1a2433" if 0.3 * red + 0.59 * green + 0.11 * blue > 0.45 else "#f4f7fb"


class EventStyle(NamedTuple):
    """How events of one kind, bifurcations or grazes, are drawn.

    label   name in a legend
    color   colour
    dashes  dashes of curves
    marker  marker of points

    Colours differ without red or green receptors, dashes and markers without any colour.
    """

    label: str
    color: str
    dashes: Any
    marker: str


EVENT_STYLES = {
    "fold": EventStyle("fold", "#000000", "solid", "D"),
    "symmetry_breaking": EventStyle("symmetry breaking", "#0060a8", (0, (7, 2, 1.5, 2)), "s"),
    "period_doubling": EventStyle("period doubling", "#c44601", (0, (5, 1.8)), "^"),
    "neimark_sacker": EventStyle("Neimark–Sacker", "#00785a", (0, (4, 1.5, 1.2, 1.5, 1.2, 1.5)), "o"),
    "graze": EventStyle("graze", "#8a1c7c", (0, (1.3, 1.5)), "v"),
    "impact_lost": EventStyle("impact lost", "#e09000", (0, (1.3, 3.0)), "<"),
    "contact_lost": EventStyle("contact lost", "#e09000", (0, (1.3, 4.5)), "p"),
    "lift_off": EventStyle("lift-off", "#e09000", (0, (3.0, 1.3)), ">"),
    "stick_onset": EventStyle("onset of stick", "#642810", (0, (5, 1.5, 1.2, 1.5)), "P"),
    "stick_end": EventStyle("end of stick", "#642810", (0, (2.5, 2.5)), "X"),
    "grazing_sliding": EventStyle("grazing–sliding", "#642810", (0, (1, 1, 1, 4)), "d"),
    "adding_sliding": EventStyle("adding–sliding", "#642810", (0, (6, 4)), "h"),
    "vertex": EventStyle("vertex of a law", "#8a1c7c", (0, (2, 1, 2, 3)), "8"),
    "exchange": EventStyle("exchange of two events", "#8a1c7c", (0, (4, 1, 2, 1)), "|"),
    "hopf": EventStyle("Hopf", "#00785a", (0, (4, 1, 1, 3)), "*"),
    "border": EventStyle("end of an equilibrium", "#000000", (0, (8, 3)), "H"),
}
"""Styles of the events with one condition, whose curves lie in a plane of two parameters, in the order of legends."""

CORNERS = {
    "cusp": ("cusp", "^"),
    "fold_flip": ("fold–flip", "s"),
    "resonance_1_1": ("1:1 resonance", "o"),
    "resonance_1_2": ("1:2 resonance", "D"),
    "resonance_1_3": ("1:3 resonance", "<"),
    "resonance_1_4": ("1:4 resonance", ">"),
    "double_graze": ("double graze", "X"),
    "graze_fold": ("graze–fold", "v"),
    "graze_period_doubling": ("graze–period doubling", "p"),
    "graze_symmetry_breaking": ("graze–symmetry breaking", "P"),
    "graze_neimark_sacker": ("graze–Neimark–Sacker", "h"),
}
"""Points of codimension two, by kind: name in a legend, and shape of the marker, which is white with a black edge."""


def corner_look(kind: str, size: float) -> dict[str, Any]:
    """Return marker and legend name for a kind of point of codimension two, as arguments of ``Axes.plot``."""
    label, marker = CORNERS.get(kind, ("", "*"))
    for name, look in EVENT_STYLES.items():
        if not label and kind.endswith(f"_{name}"):
            first = corner_look(kind.removesuffix(f"_{name}"), size)["label"]
            label = f"{first}–{look.label}"
    label = label or (EVENT_STYLES[kind].label if kind in EVENT_STYLES else kind.replace("_", " "))
    return mark(marker, size, "white", "black", 0.8) | {"label": label}


def mark(marker: str, size: float, color: str, edge: str, width: float) -> dict[str, Any]:
    """Return arguments of ``Axes.plot`` that draw points with a marker; its size and edge width are in points."""
    return {
        "linestyle": "", "marker": marker, "markersize": size, "color": color, "markeredgecolor": edge,
        "markeredgewidth": width,
    }  # fmt: skip
