"""How events and curves of orbits look: each kind has a colour, a line style and a marker, the same in every picture.

The colours are told apart without red or green receptors, and line styles and markers without any colour.
"""

from typing import Any, NamedTuple

from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke


class Look(NamedTuple):
    """Of one kind of event: its name in a legend, its colour, the dashes of curves and the marker of points."""

    label: str
    color: str
    dashes: Any
    marker: str


LOOKS = {
    "fold": Look("fold", "#000000", "solid", "D"),
    "symmetry_breaking": Look("symmetry breaking", "#0060a8", (0, (7, 2, 1.5, 2)), "s"),
    "period_doubling": Look("period doubling", "#c44601", (0, (5, 1.8)), "^"),
    "neimark_sacker": Look("Neimark–Sacker", "#00785a", (0, (4, 1.5, 1.2, 1.5, 1.2, 1.5)), "o"),
    "graze": Look("graze", "#8a1c7c", (0, (1.3, 1.5)), "v"),
    "impact_lost": Look("impact lost", "#e09000", (0, (1.3, 3.0)), "<"),
    "contact_lost": Look("contact lost", "#e09000", (0, (1.3, 4.5)), "p"),
    "lift_off": Look("lift-off", "#e09000", (0, (3.0, 1.3)), ">"),
    "stick_onset": Look("onset of stick", "#642810", (0, (5, 1.5, 1.2, 1.5)), "P"),
    "stick_end": Look("end of stick", "#642810", (0, (2.5, 2.5)), "X"),
    "grazing_sliding": Look("grazing–sliding", "#642810", (0, (1, 1, 1, 4)), "d"),
    "adding_sliding": Look("adding–sliding", "#642810", (0, (6, 4)), "h"),
}
"""The kinds with one condition, in the order of legends."""

CORNERS = {
    "cusp": "cusp",
    "fold_flip": "fold–flip",
    "resonance_1_1": "1:1",
    "resonance_1_2": "1:2",
    "resonance_1_3": "1:3",
    "resonance_1_4": "1:4",
    "double_graze": "double graze",
}
"""Points of codimension two as pictures name them; others by their parts."""


def corner_name(kind: str) -> str:
    """A point of codimension two as pictures name it: ``graze_fold`` is graze–fold."""
    if kind in CORNERS:
        return CORNERS[kind]
    for name, look in LOOKS.items():
        if kind.endswith(f"_{name}"):
            return f"{corner_name(kind.removesuffix(f'_{name}'))}–{look.label}"
    return LOOKS[kind].label if kind in LOOKS else kind.replace("_", " ")


def marker_look(kind: str, size: float) -> dict[str, Any]:
    """How points of a kind of event are drawn, as arguments of ``Axes.plot``."""
    look = LOOKS[kind]
    return {
        "linestyle": "", "marker": look.marker, "markersize": size, "color": look.color,
        "markeredgecolor": "white", "markeredgewidth": 0.5,
    }  # fmt: skip


def line_entry(kind: str, width: float) -> Line2D:
    """The legend entry of curves of a kind, on a white halo as over a map."""
    look = LOOKS[kind]
    halo = [withStroke(linewidth=width + 1.4, foreground="white")]
    return Line2D([], [], color=look.color, linewidth=width, linestyle=look.dashes, path_effects=halo, label=look.label)
