"""Pictures, drawn from results alone, without a display and without pyplot.

To add a kind of map: a row in ``kinds.py``, and its ``paint`` in ``classes.py`` or ``scales.py``. The tests take it up
from there; ``python -m tests.reference`` draws the reference picture that they ask for.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, Unpack

from atlas.cell.orbit import CellOrbit, cell_orbit
from atlas.errors import InputError
from atlas.query.attractors import leading
from atlas.query.compare import Comparison
from atlas.query.window import Window
from atlas.render.drawing import Wanted, check_units, draw
from atlas.render.files import FORMATS, check_path, save, target_of
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
    from atlas.render.page import Page

    Subject: TypeAlias = xr.Dataset | Sequence[xr.Dataset] | Comparison | CellOrbit | Branches

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
    "check_path",
    "figure",
    "has_scale",
    "needs",
    "portrait",
    "render",
]


def figure(
    subject: "Subject",
    kind: str | None = None,
    window: Window | None = None,
    *,
    path: str | Path | None = None,
    pixels: tuple[int, int] | None = None,
    titles: Sequence[str] = (),
    **options: "Unpack[MapLook]",
) -> Any:
    """A matplotlib Figure of a subject, which a notebook shows; written to ``path`` too (.png, .svg or .pdf) if given.

    One atlas as ``atlas.open`` returns it, half done or whole: ``kind`` is one of KINDS, by default "exponent" for two
    axes, "period" where there are no exponents, and "sweep" for one axis; a stack of up to MOST_PANELS planes is drawn
    as several atlases are.
    Several atlases: maps on one scale, of "exponent" or "period", by default the first that all of them hold;
    ``titles`` stand over them where no parameter differs.
    A comparison: the difference of the exponents, there minus here, where there are any, and where the regime is
    another there, which. The orbit of a cell: its portrait. Branches: section values over the parameter.

    ``window`` gives, for any axis, the (low, high) ends of the part to draw. ``pixels`` is the size, (x, y), of the
    plot area that a map's cells are to fill, where it is not that of a file. ``options`` as in ``options.MEANINGS``;
    with ``ax``, axes of yours to draw into, those are returned in place of a figure, and keep their size and type.
    Raises InputError, in one line, for another suffix and a path that cannot be written, for a kind that does not fit
    the number of axes, and where the atlas does not hold what the kind draws.
    Reads only the variables that the kind draws, of a map only the chunks in view, from the overview whose cells are
    as large as pixels. A file's metadata carry the atlas's digest; the same atlas gives the same bytes with the same
    software.
    """
    target = None if path is None else target_of(path)
    wanted = _wanted(kind, window, pixels, options)
    drawn = _drawn(subject, wanted, titles)
    if target is not None:
        from atlas.render.provenance import provenance_of

        save(drawn, *target, provenance_of(*_sources(subject, wanted)), wanted.page)
    return drawn if options.get("ax") is None else options["ax"]


def render(
    subject: "Subject", path: str | Path, kind: str | None = None, window: Window | None = None, **options: Any
) -> Path:
    """Draw a subject to a file and return its path; arguments and errors as in ``figure``."""
    figure(subject, kind, window, path=path, **options)
    return Path(path)


def _wanted(kind: str | None, window: Window | None, pixels: tuple[int, int] | None, options: "MapLook") -> Wanted:
    given: dict[str, Any] = dict(options)
    overlay, curves = given.pop("overlay", ()), chosen_curves(given.pop("curves", None))
    own = {name: given.pop(name) for name in ("names", "against", "variable", "log") if name in given}
    lines = (overlay,) if isinstance(overlay, str) else tuple(overlay)
    return Wanted(_page(given), kind, window, lines, curves, pixels=pixels, **own)


def _page(look: Mapping[str, Any]) -> "Page":
    from atlas.render.page import page  # with it matplotlib

    return page(**look)


def _drawn(subject: "Subject", wanted: Wanted, titles: Sequence[str]) -> "Figure":
    import xarray as xr

    if isinstance(subject, xr.Dataset):
        return draw(subject, wanted)
    page = wanted.page
    if isinstance(subject, CellOrbit):
        from atlas.render import orbit

        page.refuse_ends("a portrait")
        drawn = orbit.figure(subject, page)
    elif isinstance(subject, Comparison | Sequence):
        from atlas.render import together

        if page.given:
            raise InputError("ax: several maps make a figure of their own; draw them one by one into axes of yours")
        atlases = _sources(subject, wanted)
        for ds in atlases:
            check_units(ds)
        if isinstance(subject, Comparison):
            drawn = together.difference(subject, page)
        else:
            drawn = together.side_by_side(atlases, wanted.kind, wanted.window, titles, page)
    else:
        from atlas.render import branch

        page.refuse_ends("branches are lines")
        drawn = branch.figure(subject, page)
    page.fit(drawn)
    return drawn


def _sources(subject: "Subject", wanted: Wanted) -> list[Any]:
    """What the numbers of a picture are from: atlases, an orbit or branches."""
    if isinstance(subject, Comparison):
        return [subject.one, subject.other]
    if isinstance(subject, Sequence):
        return [leading(ds) for ds in subject]
    return [subject, *([] if wanted.against is None else [wanted.against])]


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
    is size, type and resolution.
    Raises InputError for bad parameters, for a cell without a motion to show and for a path that cannot be written.

    >>> import atlas
    >>> figure = atlas.portrait({"omega": 4.0, "b": 0.1}, path="cell.png", width="85mm")
    """
    if path is not None:
        check_path(path)
    _page(look).refuse_ends("a portrait")  # before the cell is solved
    drawn: Figure = figure(cell_orbit(given or {}, system, settings), path=path, **look)
    return drawn
