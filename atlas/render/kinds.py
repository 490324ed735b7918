"""The kinds of picture and the overlays: what each draws, which one fits an atlas, and what is said where none does."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from atlas.errors import InputError
from atlas.query.window import axis_names
from workers.results import ERROR, LABEL, LARGEST, REGIME, SETTLED, SPECTRUM

if TYPE_CHECKING:
    import xarray as xr

    from atlas.render.page import Page


@dataclass(frozen=True)
class _Kind:
    """How many axes and how many atlases a kind of picture draws, a variable that it cannot do without, and whether
    it draws numbers on a scale, which may be given ends; of maps, the ``others`` that they draw.
    """

    axes: int
    variable: str
    atlases: int = 1
    scale: bool = True
    others: tuple[str, ...] = ()


class OverlayError(InputError):
    """An overlay that an atlas does not allow for; ``overlay`` is its name. The map can be drawn without it."""

    def __init__(self, overlay: str, why: str) -> None:
        super().__init__(why)
        self.overlay = overlay


BASINS, LABELS = "basins", "labels"
"""The kinds that are drawn of planes of initial states, and of labelled attractors."""

# The first of each number of axes whose variable the atlas holds is the kind drawn unasked. Each is a module here,
# imported at first use: the command's help needs the names and neither matplotlib nor xarray.
_KINDS = {
    "exponent": _Kind(axes=2, variable=LARGEST.name),
    "period": _Kind(axes=2, variable="period", scale=False),
    "impacts": _Kind(axes=2, variable="impacts_upper", scale=False, others=("impacts_lower", "period")),
    "symmetry": _Kind(axes=2, variable="symmetric", scale=False, others=("impacts_upper", "impacts_lower")),
    "regions": _Kind(axes=2, variable="impacts_upper", scale=False, others=("impacts_lower", "period")),
    "combined": _Kind(axes=2, variable=LARGEST.name, others=("period",)),
    "error": _Kind(axes=2, variable=ERROR.name),
    "cost": _Kind(axes=2, variable="periods_used"),
    "sticking": _Kind(axes=2, variable="stuck_fraction"),
    "attractors": _Kind(axes=2, variable="attractors", scale=False),
    "share": _Kind(axes=2, variable="share"),
    LABELS: _Kind(axes=2, variable="share", scale=False, others=(LABEL.name,)),
    BASINS: _Kind(axes=2, variable=SETTLED.name, scale=False, others=(LABEL.name,)),
    "coexistence": _Kind(axes=1, variable="share"),
    "sweep": _Kind(axes=1, variable=REGIME.name),
    "spectrum": _Kind(axes=1, variable=SPECTRUM.name),
    "hysteresis": _Kind(axes=1, variable=REGIME.name, atlases=2),
}
AXES = {1: "one axis", 2: "two axes"}
"""How many axes in words."""

MOST_PANELS = 12
"""Planes of a stack that are drawn together."""

KINDS = tuple(_KINDS)
"""The kinds of picture: "exponent" to "basins" for two axes, the others for one; "hysteresis" takes two atlases."""

MAPS = tuple(name for name, kind in _KINDS.items() if kind.axes == 2 and name not in (BASINS, LABELS))
"""Those of them that are drawn over two axes of a parameter plane, of its cells alone."""

SCALAR = "scalar"
"""The kind that maps a variable that is named, any number that an atlas holds."""

_OVERLAYS = {"grazing": 2, "boundaries": 2, "isolines": 2, "curves": 2, "branches": 1}
"""How many axes an overlay is drawn over."""

OVERLAYS = tuple(_OVERLAYS)
"""Lines over a picture. On a map of two axes: |Y| = b, borders of regimes, lines of equal exponent, the curves that its
store keeps. On a sweep: the branches of its orbits.
"""

CURVES = (
    "fold", "symmetry_breaking", "period_doubling", "neimark_sacker", "graze", "impact_lost",
    "contact_lost", "lift_off", "stick_onset", "stick_end", "grazing_sliding", "adding_sliding", "codimension_two",
)  # fmt: skip
"""What of the curves of a store can be drawn alone: each kind, and the points of codimension two."""

MAP_OVERLAYS = tuple(name for name, axes in _OVERLAYS.items() if axes == 2)
"""Those of a map."""


def axes_of(kind: str) -> int:
    """How many axes a kind of picture draws."""
    return _KINDS[kind].axes


def needs(kind: str) -> list[str]:
    """The variables that a map of this kind draws, besides the regimes."""
    return [_KINDS[kind].variable, *_KINDS[kind].others]


def has_scale(kind: str) -> bool:
    """Whether pictures of this kind have a scale whose ends can be chosen."""
    return _KINDS[kind].scale


def chosen_kind(ds: "xr.Dataset", kind: str | None, against: "xr.Dataset | None", page: "Page") -> str:
    """The kind to draw: the one that is asked for, or the first that fits; InputError where it does not fit."""
    axes = axis_names(ds)
    atlases = 1 if against is None else 2
    fitting = [name for name, need in _KINDS.items() if need.axes == len(axes)]
    possible = [name for name in fitting if _KINDS[name].atlases == atlases]
    if not possible:
        raise InputError(f"two atlases are drawn together as sweeps, found {AXES[len(axes)]} ({', '.join(axes)})")
    held = [name for name in possible if _KINDS[name].variable in ds]
    held = [BASINS] if BASINS in held else held or possible
    chosen, listed = held[0] if kind is None else kind, ", ".join(held)
    if chosen not in _KINDS:
        raise InputError(f"unknown kind of picture {chosen!r}; possible here: {listed}")
    if chosen not in fitting:
        raise InputError(
            f"kind {chosen!r} draws {AXES[_KINDS[chosen].axes]}, found {AXES[len(axes)]} ({', '.join(axes)}); "
            f"possible here: {listed}"
        )
    if chosen not in possible:
        wanted = "a second atlas to draw against" if _KINDS[chosen].atlases == 2 else "one atlas, found two"
        raise InputError(f"kind {chosen!r} needs {wanted}; possible here: {listed}")
    if not _KINDS[chosen].scale:
        page.refuse_ends(f"kind {chosen!r} draws classes")
    return chosen


def scalar_variable(ds: "xr.Dataset", kind: str | None, name: str | None, against: "xr.Dataset | None") -> str:
    """The variable that a map of one draws; InputError where none can be drawn."""
    axes = axis_names(ds)
    if kind not in (None, SCALAR):
        raise InputError(f"a variable or a logarithmic scale goes with kind {SCALAR!r}, found {kind!r}")
    if name is None:
        raise InputError(f"kind {SCALAR!r} draws a variable, and none is named")
    if against is not None:
        raise InputError(f"kind {SCALAR!r} draws one atlas, found two")
    if len(axes) != 2:
        raise InputError(f"kind {SCALAR!r} draws two axes, found one ({axes[0]})")
    return name


def chosen_curves(curves: str | Sequence[str] | None) -> tuple[str, ...] | None:
    """The kinds of curves that are asked for, given as a list or with commas between; None for all."""
    if curves is None:
        return None
    wanted = tuple(curves.split(",") if isinstance(curves, str) else curves)
    for each in wanted:
        if each not in CURVES:
            raise InputError(f"unknown kind of curve {each!r}; possible: {', '.join(CURVES)}")
    return wanted


def check_overlays(ds: "xr.Dataset", overlays: tuple[str, ...]) -> None:
    """Raise InputError unless each of them is an overlay of as many axes."""
    axes = axis_names(ds)
    for overlay in overlays:
        if overlay not in OVERLAYS:
            raise InputError(f"unknown overlay {overlay!r}; possible: {', '.join(OVERLAYS)}")
        if _OVERLAYS[overlay] != len(axes):
            kind = {1: "a sweep", 2: "a map"}[_OVERLAYS[overlay]]
            raise InputError(f"overlay {overlay!r} is drawn over {kind}, found {AXES[len(axes)]} ({', '.join(axes)})")
