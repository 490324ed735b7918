"""Pictures of an atlas: one file per kind, drawn from a dataset alone, without a display and without pyplot.

To add a kind: write ``figure(ds) -> Figure`` in a file of its own and name it in ``_KINDS``.
"""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from atlas.errors import InputError
from atlas.grid import Window, axis_names, within
from atlas.part import counted
from atlas.query import fractions
from workers.results import FAILED, INVALID, LARGEST, PENDING, REGIME, REGIMES, UNDETERMINED

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

# Kind: its module, the number of axes that it draws, and a variable that it cannot do without; the first of that
# number whose variable the atlas holds is the kind drawn unasked.
# Modules are imported at first use: the command's help needs the names and neither matplotlib nor xarray.
_KINDS = {
    "exponent": ("atlas.render.exponent", 2, LARGEST.name),
    "period": ("atlas.render.period", 2, "period"),
    "sweep": ("atlas.render.sweep", 1, REGIME.name),
}
_COUNT = {1: "one axis", 2: "two axes"}
KINDS = tuple(_KINDS)
"""The kinds of picture: "exponent" and "period" for two axes, "sweep" for one."""

FORMATS = ("png", "svg", "pdf")
"""What a picture can be written as, chosen by the file's suffix."""

__all__ = ["FORMATS", "KINDS", "figure", "render"]


def figure(ds: "xr.Dataset", kind: str | None = None, window: Window | None = None) -> "Figure":
    """A matplotlib Figure of an atlas, for notebooks; arguments and errors as in ``render``."""
    axes = axis_names(ds)
    possible = [name for name, (_, count, _) in _KINDS.items() if count == len(axes)]
    chosen = next((name for name in possible if _KINDS[name][2] in ds), possible[0]) if kind is None else kind
    if chosen not in _KINDS:
        raise InputError(f"unknown kind of picture {chosen!r}; possible here: {', '.join(possible)}")
    if chosen not in possible:
        raise InputError(
            f"kind {chosen!r} draws {_COUNT[_KINDS[chosen][1]]}, found {_COUNT[len(axes)]} ({', '.join(axes)}); "
            f"possible here: {', '.join(possible)}"
        )
    units = ds[LARGEST.name].attrs.get("units", LARGEST.units) if LARGEST.name in ds else LARGEST.units
    if units != LARGEST.units:
        raise InputError(f"pictures draw exponents per forcing period, found units {units}; draw the atlas as stored")
    part = within(ds, window)
    with counted() as reads:
        drawn: Figure = import_module(_KINDS[chosen][0]).figure(part)
    if max(reads.block) > 1:
        _tell_coarse(drawn, part, reads.block)
    return drawn


def _tell_coarse(drawn: "Figure", ds: "xr.Dataset", block: tuple[int, ...]) -> None:
    """Say above a map that it is coarser than its atlas, and the exact shares of doubtful cells, too few to be seen."""
    from matplotlib import rc_context

    from atlas.render.style import STYLE

    shares = fractions(ds)
    doubtful = [each.name for each in REGIMES if each.code in (PENDING, UNDETERMINED, INVALID, FAILED)]
    least = 1e-4  # less is not worth its digits, but that there is some is
    parts = {name: f"{100 * shares[name]:.2g} %" if shares[name] >= least else "< 0.01 %" for name in shares}
    told = "".join(f",  {name} {parts[name]}" for name in doubtful if name in parts)
    cells = " × ".join(map(str, block))
    ax = drawn.axes[0]
    with rc_context(STYLE):
        ax.set_title(f"{ax.get_title('left')}\none cell drawn for {cells} computed{told}".strip(), loc="left")


def render(ds: "xr.Dataset", path: str | Path, kind: str | None = None, window: Window | None = None) -> Path:
    """Draw an atlas to a file and return its path.

    Arguments: ``ds`` as ``atlas.open`` returns it, half done or whole; ``path`` ends in .png, .svg or .pdf;
    ``kind`` is one of KINDS, by default "exponent" for two axes, "period" where there are no exponents, and "sweep"
    for one axis; ``window`` gives, for any axis, the (low, high) ends of the part to draw.
    Raises InputError, in one line, for another suffix, for a kind that does not fit the number of axes, where the
    atlas does not hold what the kind draws, and for a path that cannot be written.
    Reads only the variables that the kind draws, of a map only the chunks in view, from the overview whose cells are
    as large as pixels. The file's metadata carry the atlas's digest; the same atlas
    gives the same bytes with the same software.
    """
    target = Path(path)
    suffix = target.suffix.lower().removeprefix(".")
    if suffix not in FORMATS:
        found = f"found {target.suffix!r}" if suffix else "found none"
        raise InputError(f"{target.name}: the suffix chooses the format, {found}; possible: .{', .'.join(FORMATS)}")
    drawn = figure(ds, kind, window)
    from atlas.render.style import save

    try:
        save(drawn, target, suffix, ds)
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror or error}") from None
    return target
