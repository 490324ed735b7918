"""The request for a picture of an atlas: its validated arguments, and the choice of a kind and overlays that fit."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Unpack

from atlas.argument_checks import Window, check_name, validate_atlas, validate_flag, validate_pixels, validate_window
from atlas.errors import InputError, check_names
from atlas.query.extremes import check_number
from atlas.query.window import axis_names
from atlas.render.kinds import (
    AXES,
    BASINS,
    CLASSES,
    CURVES,
    KIND_TABLE,
    KINDS,
    NUMBERS,
    OVERLAYS,
    SCALAR,
    SCALES,
    PictureKind,
    found_axes,
)
from atlas.render.options import AtlasFigureOptions, names_in

if TYPE_CHECKING:
    import xarray as xr

    from atlas.render.layout import FigureLayout


@dataclass(frozen=True)
class PictureRequest:
    """The validated arguments of ``atlas.render.figure`` for an atlas.

    page      layout of the figure
    kind      name of the kind; None for the default
    window    (low, high) limits by axis
    overlays  names of overlays
    curves    kinds of exact curves; None for all
    names     True for labels of points, motions and lines on a map
    against   dataset of a second sweep, drawn over the first
    pixels    size (x, y) of the plot area
    variable  variable to map
    log       True for a logarithmic norm
    observe   observable that a sweep shows
    """

    page: "FigureLayout"
    kind: str | None = None
    window: Window | None = None
    overlays: tuple[str, ...] = ()
    curves: tuple[str, ...] | None = None
    names: bool = True
    against: "xr.Dataset | None" = None
    pixels: tuple[int, int] | None = None
    variable: str | None = None
    log: bool = False
    observe: str | None = None

    @classmethod
    def from_arguments(
        cls,
        kind: str | None = None,
        window: Window | None = None,
        pixels: tuple[int, int] | None = None,
        **options: Unpack[AtlasFigureOptions],
    ) -> "PictureRequest":
        """Return the validated request for arguments of ``figure``. Raise InputError for an invalid argument."""
        from atlas.render.layout import page  # imports matplotlib

        look: dict[str, Any] = dict(options)
        lines, curves = names_in("overlay", look.pop("overlay", ())), chosen_curves(look.pop("curves", None))
        options_of = "names", "against", "variable", "log", "observe"
        request_options: dict[str, Any] = {name: look.pop(name) for name in options_of if name in look}
        for name, value in (
            ("kind", kind),
            *((option, request_options.get(option)) for option in ("variable", "observe")),
        ):
            if value is not None:
                check_name(name, value)
        check_names("kind of picture", [] if kind is None else [kind], KIND_TABLE)
        for name in ("names", "log"):
            validate_flag(name, request_options.get(name, False))
        if request_options.get("against") is not None:
            validate_atlas(request_options["against"], "against")
        return cls(
            page(**look),
            kind,
            validate_window(window),
            lines,
            curves,
            pixels=validate_pixels(pixels),
            **request_options,
        )


def resolve_kind(ds: "xr.Dataset", request: PictureRequest) -> PictureKind:
    """Return the kind of picture to draw: the requested one, or the first that fits the atlas.

    Raise InputError if the requested kind does not fit.
    """
    axes, atlases, axes_found = len(axis_names(ds)), 1 if request.against is None else 2, found_axes(ds)
    if request.kind == SCALAR or request.variable is not None or request.log:
        _check_scalar(ds, request)
        return KIND_TABLE[SCALAR]
    fitting = [name for name in KINDS if KIND_TABLE[name].axes == axes]
    possible = [name for name in fitting if KIND_TABLE[name].atlases == atlases]
    if not possible:
        raise InputError(f"two atlases are drawn together as sweeps, {axes_found}")
    available = [name for name in possible if KIND_TABLE[name].variables[0] in ds]
    available = [BASINS] if BASINS in available else available or possible
    kind_name, hint = available[0] if request.kind is None else request.kind, f"; possible here: {', '.join(available)}"
    kind = KIND_TABLE[kind_name]
    if kind_name not in fitting:
        raise InputError(f"kind {kind_name!r} draws {AXES[kind.axes]}, {axes_found}{hint}")
    if kind_name not in possible:
        needed = "a second atlas to draw against" if kind.atlases == 2 else "one atlas, found two"
        raise InputError(f"kind {kind_name!r} needs {needed}{hint}")
    if kind.scale is CLASSES:
        request.page.check_no_limits(f"kind {kind_name!r} draws classes")
    return kind


def _check_scalar(ds: "xr.Dataset", request: PictureRequest) -> None:
    """Raise InputError unless the requested variable can be mapped: one number per cell of an atlas with two axes."""
    name = request.variable
    if request.kind not in (None, SCALAR):
        raise InputError(f"a variable or a logarithmic norm needs kind {SCALAR!r}, found {request.kind!r}")
    if name is None:
        raise InputError(f"kind {SCALAR!r} needs the name of a variable")
    if request.against is not None:
        raise InputError(f"kind {SCALAR!r} draws one atlas, found two")
    if len(axis_names(ds)) != 2:
        raise InputError(f"kind {SCALAR!r} draws two axes, {found_axes(ds)}")
    hint = SCALES.get(name, NUMBERS).hint
    if hint and name not in ds:
        raise InputError(f"this atlas has no variable {name!r}; {hint}")
    check_number(ds, name)


def chosen_curves(curves: str | Sequence[str] | None) -> tuple[str, ...] | None:
    """Return the kinds of curves that an option names, from a list, a text with commas, or "all"; None if not given."""
    if curves is None:
        return None
    if isinstance(curves, str) and curves == "all":
        return CURVES
    names = names_in("curves", curves)
    check_names("kind of curve", names, CURVES)
    return names


def check_overlays(ds: "xr.Dataset", overlays: tuple[str, ...]) -> None:
    """Raise InputError unless all names are overlays that an atlas with this number of axes can have."""
    for overlay in overlays:
        if overlay not in OVERLAYS:
            raise InputError(f"unknown overlay {overlay!r}; possible: {', '.join(OVERLAYS)}")
        axes, kind = (1, "a sweep") if overlay == "branches" else (2, "a map")
        if len(axis_names(ds)) != axes:
            raise InputError(f"overlay {overlay!r} is drawn over {kind}, {found_axes(ds)}")
