"""Pictures, drawn from a dataset or an orbit alone, without a display and without pyplot.

To add a kind of map: a row in ``kinds.py``, and its ``paint`` in ``classes.py`` or ``scales.py``. The tests take it up
from there; ``python -m tests.reference`` draws the reference picture that they ask for.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from atlas.cell.orbit import cell_orbit
from atlas.errors import InputError
from atlas.query.attractors import leading
from atlas.query.window import Window
from atlas.render.drawing import Wanted, check_units, draw
from atlas.render.files import FORMATS, check_path, target_of, write
from atlas.render.kinds import (
    BASINS,
    CURVES,
    KINDS,
    MAP_OVERLAYS,
    MAPS,
    OVERLAYS,
    SCALAR,
    chosen_curves,
    has_scale,
    needs,
)
from atlas.render.options import Look, MapLook, Sheet, takes
from workers import Settings
from workers.model.system import DEFAULT, System

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

    from atlas.branches.table import Branches
    from atlas.cell.orbit import CellOrbit
    from atlas.query.compare import Comparison
    from atlas.render.page import Page
    from atlas.render.provenance import Provenance

LOOK = tuple(Look.__annotations__)
"""The options of every picture that has a scale."""

__all__ = [
    "BASINS",
    "CURVES",
    "FORMATS",
    "KINDS",
    "LOOK",
    "MAPS",
    "MAP_OVERLAYS",
    "OVERLAYS",
    "SCALAR",
    "branch_figure",
    "check_path",
    "compared_figure",
    "figure",
    "has_scale",
    "needs",
    "orbit_figure",
    "portrait",
    "render",
    "render_orbit",
    "side_by_side",
]


def figure(
    ds: "xr.Dataset",
    kind: str | None = None,
    window: Window | None = None,
    *,
    pixels: tuple[int, int] | None = None,
    **options: "Unpack[MapLook]",
) -> Any:
    """A matplotlib Figure of an atlas, which a notebook shows; arguments and errors as in ``render``.

    ``pixels`` is the size, (x, y), of the plot area that a map's cells are to fill, where it is not that of a file.
    ``ax`` are axes of yours to draw into, for a sweep one for each of its plots; they are returned in place of a
    figure, and keep their own size and type.
    """
    drawn = draw(ds, _wanted(kind, window, pixels, options))
    return drawn if options.get("ax") is None else options["ax"]


def render(
    ds: "xr.Dataset",
    path: str | Path,
    kind: str | None = None,
    window: Window | None = None,
    **options: "Unpack[MapLook]",
) -> Path:
    """Draw an atlas to a file and return its path.

    Arguments: ``ds`` as ``atlas.open`` returns it, half done or whole; ``path`` ends in .png, .svg or .pdf;
    ``kind`` is one of KINDS, by default "exponent" for two axes, "period" where there are no exponents, and "sweep"
    for one axis; a stack of up to MOST_PANELS planes is drawn as maps on one scale, of "exponent" or "period";
    ``window`` gives, for any axis, the (low, high) ends of the part to draw; ``options`` as in ``options.MEANINGS``:
    overlays, a variable for the kind "scalar", the sweep the other way for "hysteresis", size, type and scale.
    Raises InputError, in one line, for another suffix, for a kind that does not fit the number of axes, where the
    atlas does not hold what the kind draws, and for a path that cannot be written.
    Reads only the variables that the kind draws, of a map only the chunks in view, from the overview whose cells are
    as large as pixels. The file's metadata carry the atlas's digest; the same atlas gives the same bytes with the
    same software.
    """
    target, suffix = target_of(path)
    from atlas.render.provenance import provenance_of

    wanted = _wanted(kind, window, None, options)
    provenance = provenance_of(ds, *([] if wanted.against is None else [wanted.against]))
    return write(draw(ds, wanted), target, suffix, provenance, wanted.page)


def _wanted(kind: str | None, window: Window | None, pixels: tuple[int, int] | None, options: "MapLook") -> Wanted:
    given: dict[str, Any] = dict(options)
    overlay, curves = given.pop("overlay", ()), chosen_curves(given.pop("curves", None))
    own = {name: given.pop(name) for name in ("names", "against", "variable", "log") if name in given}
    lines = (overlay,) if isinstance(overlay, str) else tuple(overlay)
    return Wanted(_page(given), kind, window, lines, curves, pixels=pixels, **own)


def _page(look: Mapping[str, Any]) -> "Page":
    from atlas.render.page import page  # with it matplotlib

    return page(**look)


def _finished(
    make: "Callable[[Page], Figure]", page: "Page", path: str | Path | None, provenance: "Callable[[], Provenance]"
) -> "Figure":
    """Draw a figure, and write it too where a path is given, which is refused before anything is drawn."""
    target = None if path is None else target_of(path)
    drawn = make(page)
    page.fit(drawn)
    if target is not None:
        write(drawn, *target, provenance(), page)
    return drawn


def side_by_side(
    atlases: "Sequence[xr.Dataset]",
    kind: str | None = None,
    window: Window | None = None,
    *,
    names: Sequence[str] = (),
    path: str | Path | None = None,
    **look: "Unpack[Look]",
) -> "Figure":
    """Maps of several atlases in one matplotlib Figure, on one scale; written to ``path`` too if given.

    ``kind`` is "exponent" or "period", by default the first that all of them hold; ``names`` stand over the maps where
    no parameter differs; ``window`` and ``look`` as in ``render``.
    Raises InputError for fewer than two atlases, for another kind, where axes or variables are not the same, and for a
    path that cannot be written.
    """
    shown = [leading(ds) for ds in atlases]

    def make(page: "Page") -> "Figure":
        from atlas.render import together

        return together.side_by_side(shown, kind, window, names, page)

    return _several(make, shown, path, look)


def compared_figure(compared: "Comparison", path: str | Path | None = None, **look: "Unpack[Look]") -> "Figure":
    """A matplotlib Figure of how two atlases differ; written to ``path`` too if given; ``look`` as in ``render``.

    Two maps: the difference of the exponents, there minus here, and where the regime is another there, which. Where
    there are no exponents, the second alone.
    Raises InputError for atlases with one axis and for a path that cannot be written.
    """

    def make(page: "Page") -> "Figure":
        from atlas.render import together

        return together.difference(compared, page)

    return _several(make, (compared.one, compared.other), path, look)


def _several(
    make: "Callable[[Page], Figure]", atlases: "Sequence[xr.Dataset]", path: str | Path | None, look: "Look"
) -> "Figure":
    if "ax" in look:
        raise InputError("ax: several maps make a figure of their own; draw them one by one into axes of yours")
    for ds in atlases:
        check_units(ds)
    from atlas.render.provenance import provenance_of

    return _finished(make, _page(look), path, lambda: provenance_of(*atlases))


def orbit_figure(orbit: "CellOrbit", path: str | Path | None = None, **look: "Unpack[Look]") -> "Figure":
    """A matplotlib Figure of one cell's orbit; written to ``path`` too if given; ``look`` as in ``render``, less the
    ends of a scale.
    """
    from atlas.render import orbit as picture
    from atlas.render.provenance import provenance_of

    page = _orbit_page(look)
    return _finished(lambda page: picture.figure(orbit, page), page, path, lambda: provenance_of(orbit))


def render_orbit(orbit: "CellOrbit", path: str | Path, **look: "Unpack[Look]") -> Path:
    """Draw one cell's orbit to a file and return its path; suffixes, metadata and errors as in ``render``."""
    orbit_figure(orbit, path, **look)
    return Path(path)


def _orbit_page(look: "Look") -> "Page":
    if look.get("vmin") is not None or look.get("vmax") is not None:
        raise InputError("a portrait has no scale that vmin and vmax could end")
    return _page(look)


@takes(Sheet)
def portrait(
    given: Mapping[str, Any] | None = None,
    *,
    system: str | Mapping[str, Any] | System = DEFAULT,
    settings: Settings | None = None,
    path: str | Path | None = None,
    **look: "Unpack[Look]",
) -> "Figure":
    """The portrait of one cell as a matplotlib Figure, which a notebook shows; written to ``path`` too (.png, .svg or
    .pdf) if given.

    Time histories with impacts marked, phase planes, the plane of both displacements, the Poincare section, and the
    exponents as they converge, with their exact values where the motion is periodic. ``given`` are the parameters
    that differ from the defaults, initial state included: with several attractors it decides which is shown. ``look``
    is size, type and resolution, as in ``render``.
    Raises InputError for bad parameters, for a cell without a motion to show and for a path that cannot be written.
    """
    if path is not None:
        check_path(path)
    _orbit_page(look)  # refuses what is wrong before the cell is solved
    return orbit_figure(cell_orbit(given or {}, system, settings), path, **look)


def branch_figure(branches: "Branches", path: str | Path | None = None, **look: "Unpack[Look]") -> "Figure":
    """A matplotlib Figure of branches, section values over the parameter; written to ``path`` too if given.

    ``look`` is size, type and resolution, as in ``render``, without the ends of a scale. Raises InputError for a path
    that cannot be written.
    """
    from atlas.render import branch as picture
    from atlas.render.provenance import provenance_of

    page = _page(look)
    page.refuse_ends("branches are lines")
    return _finished(lambda page: picture.figure(branches, page), page, path, lambda: provenance_of(branches))
