"""Tables of the kinds of pictures, of the colours of variables, and of overlays, with the meaning of each.

This module imports neither matplotlib nor xarray, since the command's help lists the table.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from atlas.errors import InputError
from atlas.query.window import axis_names
from workers.results import ERROR, LABEL, LARGEST, REGIME, SETTLED, SPECTRUM

if TYPE_CHECKING:
    import xarray as xr

STABLE = ("#dcebf5", "#c9dff0", "#b3d2ea", "#9bc3e3", "#81b3db", "#64a1d2")
CHAOTIC = ("#dd6a10", "#c2481a", "#a32c1a", "#801a17", "#5c0c10", "#36040a")
"""Colours of exponents below and above zero, in increasing order.

They darken monotonically: every exponent has its own grey, also without red, green or blue receptors. No colour is as
pale as cells without data, which are white.
"""


@dataclass(frozen=True)
class ColorScale:
    """How the numbers of a variable, or of a kind of map, are coloured.

    label         label of the colorbar; empty for the meaning and unit of the variable
    colors        colours from the lower to the upper limit
    zero          colour and name of cells that are exactly 0
    log           True if the norm is logarithmic
    undetermined  True if cells whose regime could not be determined have the number, too
    hint          advice for an atlas without the variable
    """

    label: str = ""
    colors: tuple[str, ...] = ()
    zero: tuple[str, str] | None = None
    log: bool = False
    undetermined: bool = False
    hint: str = ""


CLASSES = ColorScale()
"""The colour scale of kinds of maps that show classes instead of numbers."""


@dataclass(frozen=True)
class PictureKind:
    """A kind of picture of an atlas.

    name         its name
    axes         number of axes that an atlas must have
    variables    variables that a map reads besides the regimes; the first one is required
    description  meaning in the words of the command's help
    scale        colours of its numbers; CLASSES if it shows no numbers
    atlases      number of atlases drawn
    hint         advice for an atlas without its variables
    """

    name: str
    axes: int
    variables: tuple[str, ...]
    description: str
    scale: ColorScale = CLASSES
    atlases: int = 1
    hint: str = ""

    def require(self, ds: "xr.Dataset", names: Sequence[str]) -> None:
        """Raise InputError, with the kind's hint, if the atlas ``ds`` lacks one of the variables ``names``."""
        for name in names:
            if name not in ds:
                hint = f"; {self.hint}" if self.hint else ""
                raise InputError(
                    f"kind {self.name!r} needs the variable {name!r}, which this atlas does not have{hint}"
                )


BASINS, LABELS, SCALAR = "basins", "labels", "scalar"
"""Names of the kinds of maps of basins, of labelled attractors, and of a variable that the user names."""

NUMBER, LOGARITHM = "number-", "-log"
"""Prefix of the name of a map of a variable, and suffix of that name for a logarithmic norm."""

_PER_PERIOD = "[per forcing period]"
_VIOLET = ("#f3eaf5", "#d9bfe0", "#b690c6", "#8d5fa6", "#633382", "#36134f")
_PALE_BLUE = ("#eef3f0", "#c4dcd9", "#93bfc4", "#5f9cad", "#356f8c", "#173f5f")
_DARK_FIRST = ("#5a1a26", "#96413c", "#c67a56", "#e3b07f", "#f1dcb4", "#f9f5e3")
"""Colours of a measure of safety from unsafe, which is dark, to safe; _PALE_BLUE and _VIOLET begin pale."""
_MEASURE = "measure its attractors by atlas attractors measure"

_EXPONENTS = ColorScale(rf"$\lambda_i$ {_PER_PERIOD}")
NUMBERS = ColorScale(colors=_VIOLET)
"""The colours of a variable that has no row in SCALES."""
SCALES: Mapping[str, ColorScale] = {
    ERROR.name: ColorScale(rf"error of $\lambda_1$ {_PER_PERIOD}",
        ("#e4eff0", "#b9d7de", "#8bb7cb", "#5f92b5", "#3c6a95", "#1d3d63"), log=True),
    "periods_used": ColorScale("", ("#fdf2e4", "#f8d3a4", "#ecab68", "#cf7f3a", "#9c5320", "#5a2a10"),
        ("#dddddd", "none needed"), log=True, undetermined=True),
    "stuck_fraction": ColorScale("share of the time at rest",
        ("#cfeee9", "#8fd3cb", "#4db0ab", "#1f8588", "#0d5a66", "#06323f"), ("#f3f1ea", "never at rest")),
    "share": ColorScale("share of the initial states",
        ("#4a1042", "#7d2f6b", "#ab5d8f", "#cf93b0", "#e8c8d2", "#f8f1ee")),
    "return_time": ColorScale("return time [forcing periods]", _PALE_BLUE, log=True, hint=_MEASURE),
    "reactivity": ColorScale("reactivity, log growth in a period", _VIOLET, hint=_MEASURE),
    "amplification": ColorScale("amplification of a deviation", _PALE_BLUE, log=True, hint=_MEASURE),
    "fatal_shock": ColorScale("minimal fatal shock", _DARK_FIRST, log=True, hint=f"{_MEASURE} --shocks"),
}  # fmt: skip
"""The colour scales of variables that do not use the scale NUMBERS."""

# For each number of axes the default is the first kind whose variable the atlas has.
KIND_TABLE = {
    kind.name: kind
    for kind in (
        PictureKind("exponent", 2, (LARGEST.name,), "the largest exponent, with colours around zero",
             ColorScale(rf"largest Lyapunov exponent $\lambda_1$ {_PER_PERIOD}", (*STABLE, *CHAOTIC))),
        PictureKind("period", 2, ("period",), "one colour for each period"),
        PictureKind("impacts", 2, ("impacts_upper", "impacts_lower", "period"),
        "motions by name, n-p-q: periods, impacts at the upper and the lower stop"),
        PictureKind("combined", 2, (LARGEST.name, "period"),
             "the period where motion is periodic, the exponent where it is chaotic",
             ColorScale(rf"chaotic: $\lambda_1$ {_PER_PERIOD}", CHAOTIC)),
        PictureKind("attractors", 2, ("attractors",), "how many attractors a cell has"),
        PictureKind(LABELS, 2, (LABEL.name,),
             "the branch of the attractor shown, in lasting colours, from atlas attractors label",
             hint="label its attractors by atlas attractors label"),
        PictureKind(BASINS, 2, (SETTLED.name, LABEL.name),
        "of a plane of initial states: the attractor that each of these reaches",
             hint="both axes must be initial states, and the spec must have [attractors]"),
        PictureKind(SCALAR, 2, (), "a variable with one number per cell, see --variable", NUMBERS),
        PictureKind("coexistence", 1, ("share",),
        "of one axis: bifurcation diagram of all attractors above their shares",
             _EXPONENTS),
        PictureKind("sweep", 1, (REGIME.name,), "of one axis: bifurcation diagram above the largest exponent",
        _EXPONENTS),
        PictureKind("spectrum", 1, (SPECTRUM.name,), "of one axis: bifurcation diagram above all exponents",
             _EXPONENTS, hint='see [solve] exponents = "spectrum"'),
        PictureKind("hysteresis", 1, (REGIME.name,), "of one axis: two sweeps together, the other with --against",
             _EXPONENTS, atlases=2),
    )
}  # fmt: skip

KINDS = tuple(name for name in KIND_TABLE if name != SCALAR)
"""The kinds of an atlas: "exponent" to "basins" for two axes, the others for one; "hysteresis" takes two atlases."""

MAPS = tuple(name for name in KINDS if KIND_TABLE[name].axes == 2 and name not in (BASINS, LABELS))
"""Kinds of maps that need nothing but the cells of a plane of parameters."""

KIND_MEANINGS = {name: kind.description for name, kind in KIND_TABLE.items()}
"""Meaning of each kind of picture, in the words of the command's help."""

AXES = {1: "one axis", 2: "two axes"}
"""Numbers of axes in words."""

MAX_PANELS = 12
"""Maximum number of planes of a stack that are drawn together."""

OVERLAY_MEANINGS = {
    "grazing": "where motion without impact would just touch a stop",
    "boundaries": "borders between regimes",
    "curves": "the exact bifurcations and grazes that atlas find curves has found in the store",
    "saddles": "on basins of one mass: the unstable orbits on the boundaries between them",
    "branches": "on a sweep: its orbits, stable and unstable, with their bifurcations",
}
"""Meaning of each overlay, in the words of the command's help."""

OVERLAYS = tuple(OVERLAY_MEANINGS)
MAP_OVERLAYS = OVERLAYS[:3]
"""All overlays, and the overlays of any map."""

CURVES = (
    "fold", "symmetry_breaking", "period_doubling", "neimark_sacker", "graze", "impact_lost",
    "contact_lost", "lift_off", "stick_onset", "stick_end", "grazing_sliding", "adding_sliding",
    "vertex", "exchange", "hopf", "border",
    "codimension_two",
)  # fmt: skip
"""Curves of a store that can be drawn separately: each kind, and the points of codimension two."""


class OverlayError(InputError):
    """Raised if an atlas does not support an overlay, whose name is ``overlay``. The map can be drawn without it."""

    def __init__(self, overlay: str, reason: str) -> None:
        super().__init__(reason)
        self.overlay = overlay


def required_variables(kind: str) -> list[str]:
    """Return the names of the variables that a map of this kind reads, besides the regimes."""
    return list(KIND_TABLE[kind].variables)


def has_scale(kind: str) -> bool:
    """Return True if pictures of this kind have colour limits that can be set."""
    return KIND_TABLE[kind].scale is not CLASSES


def found_axes(ds: "xr.Dataset") -> str:
    """Return a text for error messages that counts and names the axes of an atlas."""
    axes = axis_names(ds)
    return f"found {AXES.get(len(axes), f'{len(axes)} axes')} ({', '.join(axes)})"
