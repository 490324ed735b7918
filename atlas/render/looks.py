"""Colours, hatches, lines, marks and legend entries of pictures, as plain data that figures and pages draw alike."""

import colorsys
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

from atlas.store.schema import REGIME_COLORS
from workers.results import APERIODIC, FAILED, INVALID, NO_IMPACT, PENDING, QUASIPERIODIC, REGIME, REGULAR

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


def rgb(color: str) -> tuple[int, int, int]:
    """Return red, green and blue of a colour "#rrggbb", each from 0 to 255."""
    red, green, blue = bytes.fromhex(color.removeprefix("#"))
    return red, green, blue


def ink_on(color: str) -> str:
    """Return a dark or a light colour for text, whichever is visible on the given colour."""
    red, green, blue = rgb(color)
    return "#1a2433" if 0.3 * red + 0.59 * green + 0.11 * blue > 0.45 * 255 else "#f4f7fb"


def with_lightness(color: str, lightness: float) -> str:
    """Return the colour of the same hue and saturation with another lightness, from 0 to 1."""
    hue, _, saturation = colorsys.rgb_to_hls(*(channel / 255 for channel in rgb(color)))
    return "#" + bytes(round(255 * channel) for channel in colorsys.hls_to_rgb(hue, lightness, saturation)).hex()


@dataclass(frozen=True)
class LegendEntry:
    """An entry of a legend: a box of a colour, optionally hatched or darkened.

    color           colour of the box
    label           text of the entry
    hatch           pattern over the colour, None for none
    hatch_color     colour of the hatch
    min_brightness  brightness at the dark end of a darkened entry
    regime          code of the regime that the entry explains, None for other entries
    """

    color: str
    label: str
    hatch: str | None = None
    hatch_color: str = TEXTURE
    min_brightness: float = 1.0
    regime: int | None = None

    @classmethod
    def from_regime(cls, code: int) -> "LegendEntry":
        """Return the legend entry of cells that have the colour of a regime, with the regime's hatch if it has one.

        The dots of impact-free cells are left out, since they mark only cells that have another colour.
        """
        hatch = None if code == NO_IMPACT else HATCH.get(code)
        ink = HATCH_INK.get(code, TEXTURE)
        return cls(REGIME_COLORS[code], REGIME.meaning(code).text, hatch, ink, regime=code)


class LineLook(NamedTuple):
    """How lines of one kind are drawn, and their entry in a legend.

    label   text of the entry
    color   colour
    dashes  lengths of dashes and gaps in turn, in points; empty for a solid line
    width   width in points
    edge    colour of an edge on both sides; empty for none
    joins   True if lines that run side by side are solid: their dashes would look like a bar code
    """

    label: str
    color: str
    dashes: tuple[float, ...] = ()
    width: float = 1.1
    edge: str = ""
    joins: bool = False


class MarkLook(NamedTuple):
    """How marks of one kind are drawn, and their entry in a legend.

    label   text of the entry
    marker  shape by its name in Matplotlib
    size    size in points
    color   colour
    edge    colour of the edge
    width   width of the edge in points
    """

    label: str
    marker: str
    size: float
    color: str
    edge: str
    width: float


Entry: TypeAlias = LegendEntry | LineLook | MarkLook | str
"""An entry of a legend: a box, a line, a mark, or a note without a symbol."""


def label_of(entry: Entry) -> str:
    """Return the text of a legend entry."""
    return entry if isinstance(entry, str) else entry.label


class EventStyle(NamedTuple):
    """How events of one kind, bifurcations or grazes, are drawn.

    label   name in a legend
    color   colour
    dashes  dashes of curves, as in ``LineLook``
    marker  marker of points

    Colours differ without red or green receptors, dashes and markers without any colour.
    """

    label: str
    color: str
    dashes: tuple[float, ...]
    marker: str


EVENT_STYLES = {
    "fold": EventStyle("fold", "#000000", (), "D"),
    "symmetry_breaking": EventStyle("symmetry breaking", "#0060a8", (7, 2, 1.5, 2), "s"),
    "period_doubling": EventStyle("period doubling", "#c44601", (5, 1.8), "^"),
    "neimark_sacker": EventStyle("Neimark–Sacker", "#00785a", (4, 1.5, 1.2, 1.5, 1.2, 1.5), "o"),
    "graze": EventStyle("graze", "#8a1c7c", (1.3, 1.5), "v"),
    "impact_lost": EventStyle("impact lost", "#e09000", (1.3, 3.0), "<"),
    "contact_lost": EventStyle("contact lost", "#e09000", (1.3, 4.5), "p"),
    "lift_off": EventStyle("lift-off", "#e09000", (3.0, 1.3), ">"),
    "stick_onset": EventStyle("onset of stick", "#642810", (5, 1.5, 1.2, 1.5), "P"),
    "stick_end": EventStyle("end of stick", "#642810", (2.5, 2.5), "X"),
    "grazing_sliding": EventStyle("grazing–sliding", "#642810", (1, 1, 1, 4), "d"),
    "adding_sliding": EventStyle("adding–sliding", "#642810", (6, 4), "h"),
    "vertex": EventStyle("vertex of a law", "#8a1c7c", (2, 1, 2, 3), "8"),
    "exchange": EventStyle("exchange of two events", "#8a1c7c", (4, 1, 2, 1), "|"),
    "hopf": EventStyle("Hopf", "#00785a", (4, 1, 1, 3), "*"),
    "border": EventStyle("end of an equilibrium", "#000000", (8, 3), "H"),
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


def corner_look(kind: str) -> MarkLook:
    """Return the mark of a kind of point of codimension two."""
    label, marker = CORNERS.get(kind, ("", "*"))
    for name, look in EVENT_STYLES.items():
        if not label and kind.endswith(f"_{name}"):
            label = f"{corner_look(kind.removesuffix(f'_{name}')).label}–{look.label}"
    label = label or (EVENT_STYLES[kind].label if kind in EVENT_STYLES else kind.replace("_", " "))
    return MarkLook(label, marker, 4.6, "white", "black", 0.8)
