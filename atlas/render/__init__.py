"""Pictures of an atlas: one file per kind, drawn from a dataset alone, without a display and without pyplot.

To add a kind: write ``figure(ds) -> Figure`` in a file of its own and name it in ``_KINDS``.
"""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from atlas.errors import InputError
from atlas.query import axis_names

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

# Kind: its module and the number of axes that it draws; the first of that number is the kind drawn unasked.
# Modules are imported at first use: the command's help needs the names and neither matplotlib nor xarray.
_KINDS = {
    "exponent": ("atlas.render.exponent", 2),
    "period": ("atlas.render.period", 2),
    "sweep": ("atlas.render.sweep", 1),
}
_COUNT = {1: "one axis", 2: "two axes"}
KINDS = tuple(_KINDS)
"""The kinds of picture: "exponent" and "period" for two axes, "sweep" for one."""

FORMATS = ("png", "svg", "pdf")
"""What a picture can be written as, chosen by the file's suffix."""

__all__ = ["FORMATS", "KINDS", "figure", "render"]


def figure(ds: "xr.Dataset", kind: str | None = None) -> "Figure":
    """A matplotlib Figure of an atlas, for notebooks; arguments and errors as in ``render``."""
    axes = axis_names(ds)
    possible = [name for name, (_, count) in _KINDS.items() if count == len(axes)]
    chosen = possible[0] if kind is None else kind
    if chosen not in _KINDS:
        raise InputError(f"unknown kind of picture {chosen!r}; possible here: {', '.join(possible)}")
    if chosen not in possible:
        raise InputError(
            f"kind {chosen!r} draws {_COUNT[_KINDS[chosen][1]]}, found {_COUNT[len(axes)]} ({', '.join(axes)}); "
            f"possible here: {', '.join(possible)}"
        )
    drawn: Figure = import_module(_KINDS[chosen][0]).figure(ds)
    return drawn


def render(ds: "xr.Dataset", path: str | Path, kind: str | None = None) -> Path:
    """Draw an atlas to a file and return its path.

    Arguments: ``ds`` as ``atlas.open`` returns it, half done or whole; ``path`` ends in .png, .svg or .pdf;
    ``kind`` is one of KINDS, by default "exponent" for two axes and "sweep" for one.
    Raises InputError, in one line, for another suffix, for a kind that does not fit the number of axes, where the
    atlas does not hold what the kind draws, and for a path that cannot be written.
    Reads only the variables that the kind draws. The file's metadata carry the atlas's digest; the same atlas
    gives the same bytes with the same software.
    """
    target = Path(path)
    suffix = target.suffix.lower().removeprefix(".")
    if suffix not in FORMATS:
        found = f"found {target.suffix!r}" if suffix else "found none"
        raise InputError(f"{target.name}: the suffix chooses the format, {found}; possible: .{', .'.join(FORMATS)}")
    drawn = figure(ds, kind)
    from atlas.render.style import save

    try:
        save(drawn, target, suffix, ds)
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror or error}") from None
    return target
