"""Pictures: one file per kind, drawn from a dataset or an orbit alone, without a display and without pyplot.

To add a kind: write ``figure`` in a file of its own, for a map ``figure(ds, options) -> Figure`` with
``maps.Options``, for a sweep ``figure(ds, page, branches) -> Figure``, and name the file in ``kinds.py``. The tests
take it up from there; ``python -m tests.reference`` draws the reference picture that they ask for.
"""

from collections.abc import Mapping, Sequence
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
from atlas.render.options import Look, Sheet, takes
from workers import Settings
from workers.model.system import DEFAULT, System

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from atlas.branches.table import Branches
    from atlas.cell.orbit import CellOrbit
    from atlas.query.compare import Comparison
    from atlas.render.page import Page

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
    overlay: str | Sequence[str] = (),
    curves: str | Sequence[str] | None = None,
    names: bool = True,
    against: "xr.Dataset | None" = None,
    pixels: tuple[int, int] | None = None,
    variable: str | None = None,
    log: bool = False,
    ax: "Axes | Sequence[Axes] | None" = None,
    **look: "Unpack[Look]",
) -> Any:
    """A matplotlib Figure of an atlas, which a notebook shows; arguments and errors as in ``render``.

    ``pixels`` is the size, (x, y), of the plot area that a map's cells are to fill, where it is not that of a file.
    ``ax`` are axes of yours to draw into, for a sweep one for each of its plots; they are returned in place of a
    figure, and keep their own size and type.
    """
    from atlas.render.page import page as page_of  # with it matplotlib

    lines, kinds = _as_tuple(overlay), chosen_curves(curves)
    wanted = Wanted(page_of(ax, **look), kind, window, lines, kinds, names, against, pixels, variable, log)
    drawn = draw(ds, wanted)
    return drawn if ax is None else ax


def render(
    ds: "xr.Dataset",
    path: str | Path,
    kind: str | None = None,
    window: Window | None = None,
    *,
    overlay: str | Sequence[str] = (),
    curves: str | Sequence[str] | None = None,
    names: bool = True,
    against: "xr.Dataset | None" = None,
    variable: str | None = None,
    log: bool = False,
    **look: "Unpack[Look]",
) -> Path:
    """Draw an atlas to a file and return its path.

    Arguments: ``ds`` as ``atlas.open`` returns it, half done or whole; ``path`` ends in .png, .svg or .pdf;
    ``kind`` is one of KINDS, by default "exponent" for two axes, "period" where there are no exponents, and "sweep"
    for one axis; a stack of up to MOST_PANELS planes is drawn as maps on one scale, of "exponent" or "period";
    ``window`` gives, for any axis, the (low, high) ends of the part to draw; ``overlay`` is of OVERLAYS, one or
    several; ``curves`` are kinds of exact curves, of CURVES, by default all; without ``names`` none stand on a map;
    ``against`` is the sweep the other way, which makes the kind "hysteresis"; ``variable`` names a number of
    each cell to map, the kind "scalar", by its logarithm if ``log``; ``look`` is size, type, resolution and scale, see
    ``options.MEANINGS``.
    Raises InputError, in one line, for another suffix, for a kind that does not fit the number of axes, where the
    atlas does not hold what the kind draws, and for a path that cannot be written.
    Reads only the variables that the kind draws, of a map only the chunks in view, from the overview whose cells are
    as large as pixels. The file's metadata carry the atlas's digest; the same atlas gives the same bytes with the
    same software.
    """
    target, suffix = target_of(path)
    from atlas.render.page import page as page_of
    from atlas.render.provenance import provenance_of

    page = page_of(**look)
    lines, kinds = _as_tuple(overlay), chosen_curves(curves)
    wanted = Wanted(page, kind, window, lines, kinds, names, against, None, variable, log)
    provenance = provenance_of(ds, *([] if against is None else [against]))
    return write(draw(ds, wanted), target, suffix, provenance, page)


def _as_tuple(names: str | Sequence[str]) -> tuple[str, ...]:
    return (names,) if isinstance(names, str) else tuple(names)


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
    target = None if path is None else target_of(path)
    from atlas.render import together

    page, atlases = _several_page(look), [leading(ds) for ds in atlases]
    for ds in atlases:
        check_units(ds)
    return _several(together.side_by_side(atlases, kind, window, names, page), page, target, atlases)


def compared_figure(compared: "Comparison", path: str | Path | None = None, **look: "Unpack[Look]") -> "Figure":
    """A matplotlib Figure of how two atlases differ; written to ``path`` too if given; ``look`` as in ``render``.

    Two maps: the difference of the exponents, there minus here, and where the regime is another there, which. Where
    there are no exponents, the second alone.
    Raises InputError for atlases with one axis and for a path that cannot be written.
    """
    target = None if path is None else target_of(path)
    from atlas.render import together

    page, both = _several_page(look), (compared.one, compared.other)
    for ds in both:
        check_units(ds)
    return _several(together.difference(compared, page), page, target, both)


def _several_page(look: "Look") -> "Page":
    from atlas.render.page import page as page_of

    if "ax" in look:
        raise InputError("ax: several maps make a figure of their own; draw them one by one into axes of yours")
    return page_of(**look)


def _several(
    drawn: "Figure", page: "Page", target: tuple[Path, str] | None, atlases: "Sequence[xr.Dataset]"
) -> "Figure":
    page.fit(drawn)
    if target is not None:
        from atlas.render.provenance import provenance_of

        write(drawn, *target, provenance_of(*atlases), page)
    return drawn


def orbit_figure(orbit: "CellOrbit", **look: "Unpack[Look]") -> "Figure":
    """A matplotlib Figure of one cell's orbit; ``look`` as in ``render``, less the ends of a scale."""
    from atlas.render import orbit as picture

    page = _orbit_page(look)
    drawn: Figure = picture.figure(orbit, page)
    page.fit(drawn)
    return drawn


def render_orbit(orbit: "CellOrbit", path: str | Path, drawn: "Figure | None" = None, **look: "Unpack[Look]") -> Path:
    """Draw one cell's orbit to a file and return its path; suffixes, metadata and errors as in ``render``.

    ``drawn`` is the orbit's figure where there is one already.
    """
    target, suffix = target_of(path)
    from atlas.render.provenance import provenance_of

    page = _orbit_page(look)
    return write(drawn or orbit_figure(orbit, **look), target, suffix, provenance_of(orbit), page)


def _orbit_page(look: "Look") -> "Page":
    from atlas.render.page import page as page_of

    if look.get("vmin") is not None or look.get("vmax") is not None:
        raise InputError("a portrait has no scale that vmin and vmax could end")
    return page_of(**look)


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
    orbit = cell_orbit(given or {}, system, settings)
    drawn = orbit_figure(orbit, **look)
    if path is not None:
        render_orbit(orbit, path, drawn, **look)
    return drawn


def branch_figure(branches: "Branches", path: str | Path | None = None, **look: "Unpack[Look]") -> "Figure":
    """A matplotlib Figure of branches, section values over the parameter; written to ``path`` too if given.

    ``look`` is size, type and resolution, as in ``render``, without the ends of a scale. Raises InputError for a path
    that cannot be written.
    """
    target = None if path is None else target_of(path)
    from atlas.render import branch as picture
    from atlas.render.page import page as page_of
    from atlas.render.provenance import provenance_of

    page = page_of(**look)
    page.refuse_ends("branches are lines")
    drawn: Figure = picture.figure(branches, page)
    page.fit(drawn)
    if target is not None:
        write(drawn, *target, provenance_of(branches), page)
    return drawn
