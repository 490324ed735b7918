"""Pictures: one file per kind, drawn from a dataset or an orbit alone, without a display and without pyplot.

To add a kind: write ``figure(ds) -> Figure`` in a file of its own and name it in ``_KINDS``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from atlas.errors import InputError
from atlas.query import axis_names

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

    from atlas.orbit import Orbit
    from atlas.render.style import Origin


@dataclass(frozen=True)
class _Kind:
    """How many axes and how many atlases a kind of picture draws."""

    axes: int
    atlases: int = 1


# The first of each number of axes is the kind drawn unasked. Each is a module here, imported at first use: the
# command's help needs the names and neither matplotlib nor xarray.
_KINDS = {
    "exponent": _Kind(axes=2),
    "period": _Kind(axes=2),
    "impacts": _Kind(axes=2),
    "combined": _Kind(axes=2),
    "error": _Kind(axes=2),
    "cost": _Kind(axes=2),
    "sticking": _Kind(axes=2),
    "sweep": _Kind(axes=1),
    "spectrum": _Kind(axes=1),
    "hysteresis": _Kind(axes=1, atlases=2),
}
_COUNT = {1: "one axis", 2: "two axes"}
KINDS = tuple(_KINDS)
"""The kinds of picture: "exponent" to "sticking" for two axes, the others for one; "hysteresis" takes two atlases."""

OVERLAYS = ("grazing", "boundaries", "isolines")
"""Lines that any map of two axes can carry: |Y| = b, borders of regimes, lines of equal exponent."""

FORMATS = ("png", "svg", "pdf")
"""What a picture can be written as, chosen by the file's suffix."""

__all__ = ["FORMATS", "KINDS", "OVERLAYS", "figure", "orbit_figure", "render", "render_orbit"]


def figure(
    ds: "xr.Dataset", kind: str | None = None, *, overlays: Sequence[str] = (), against: "xr.Dataset | None" = None
) -> "Figure":
    """A matplotlib Figure of an atlas, for notebooks; arguments and errors as in ``render``."""
    axes = axis_names(ds)
    atlases = 1 if against is None else 2
    fitting = [name for name, need in _KINDS.items() if need.axes == len(axes)]
    possible = [name for name in fitting if _KINDS[name].atlases == atlases]
    if not possible:
        raise InputError(f"two atlases are drawn together as sweeps, found {_COUNT[len(axes)]} ({', '.join(axes)})")
    chosen = possible[0] if kind is None else kind
    if chosen not in _KINDS:
        raise InputError(f"unknown kind of picture {chosen!r}; possible here: {', '.join(possible)}")
    if chosen not in fitting:
        raise InputError(
            f"kind {chosen!r} draws {_COUNT[_KINDS[chosen].axes]}, found {_COUNT[len(axes)]} ({', '.join(axes)}); "
            f"possible here: {', '.join(possible)}"
        )
    if chosen not in possible:
        wanted = "a second atlas to draw against" if _KINDS[chosen].atlases == 2 else "one atlas, found two"
        raise InputError(f"kind {chosen!r} needs {wanted}; possible here: {', '.join(possible)}")
    for overlay in overlays:
        if overlay not in OVERLAYS:
            raise InputError(f"unknown overlay {overlay!r}; possible: {', '.join(OVERLAYS)}")
    if overlays and len(axes) != 2:
        raise InputError(f"overlay {overlays[0]!r} is drawn over a map, found {_COUNT[len(axes)]} ({', '.join(axes)})")
    module = import_module(f"atlas.render.{chosen}")
    drawn: Figure
    if against is not None:
        drawn = module.figure(ds, against)
    elif len(axes) == 2:
        drawn = module.figure(ds, overlays)
    else:
        drawn = module.figure(ds)
    return drawn


def render(
    ds: "xr.Dataset",
    path: str | Path,
    kind: str | None = None,
    *,
    overlays: Sequence[str] = (),
    against: "xr.Dataset | None" = None,
) -> Path:
    """Draw an atlas to a file and return its path.

    Arguments: ``ds`` as ``atlas.open`` returns it, half done or whole; ``path`` ends in .png, .svg or .pdf;
    ``kind`` is one of KINDS, by default "exponent" for two axes and "sweep" for one; ``overlays`` are of OVERLAYS;
    ``against`` is the sweep the other way, which makes the kind "hysteresis".
    Raises InputError, in one line, for another suffix, for a kind that does not fit the number of axes, where the
    atlas does not hold what the kind draws, and for a path that cannot be written.
    Reads only the variables that the kind draws. The file's metadata carry the atlas's digest; the same atlas
    gives the same bytes with the same software.
    """
    target, suffix = _target(path)
    drawn = figure(ds, kind, overlays=overlays, against=against)
    from atlas.render.style import origin_of

    return _write(drawn, target, suffix, origin_of(ds, *([] if against is None else [against])))


def orbit_figure(orbit: "Orbit") -> "Figure":
    """A matplotlib Figure of one cell's orbit."""
    from atlas.render import portrait

    return portrait.figure(orbit)


def render_orbit(orbit: "Orbit", path: str | Path, drawn: "Figure | None" = None) -> Path:
    """Draw one cell's orbit to a file and return its path; suffixes, metadata and errors as in ``render``.

    ``drawn`` is the orbit's figure where there is one already.
    """
    target, suffix = _target(path)
    from atlas.render import portrait

    return _write(drawn or portrait.figure(orbit), target, suffix, portrait.origin(orbit))


def check_path(path: str | Path) -> None:
    """InputError unless the suffix is that of a picture: to be asked before long work."""
    _target(path)


def _target(path: str | Path) -> tuple[Path, str]:
    target = Path(path)
    suffix = target.suffix.lower().removeprefix(".")
    if suffix not in FORMATS:
        found = f"found {target.suffix!r}" if suffix else "found none"
        raise InputError(f"{target.name}: the suffix chooses the format, {found}; possible: .{', .'.join(FORMATS)}")
    return target, suffix


def _write(drawn: "Figure", target: Path, suffix: str, origin: "Origin") -> Path:
    from atlas.render.style import save

    try:
        save(drawn, target, suffix, origin)
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror or error}") from None
    return target
