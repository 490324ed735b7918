"""One figure for atlases, comparisons, orbits of cells and branches, and its file."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, Unpack

from atlas.argument_checks import validate_atlas, validate_path
from atlas.cell.trajectory import CellTrajectory, cell_orbit
from atlas.errors import InputError, check_names
from atlas.query.attractors import select_dominant
from atlas.query.compare import Comparison
from atlas.query.queries import fractions, rate_of
from atlas.query.read_counter import counted
from atlas.query.window import Window, axis_names, select_window
from atlas.render.kinds import AXES, KIND_TABLE, KINDS, MAX_PANELS
from atlas.render.options import AtlasFigureOptions, FigureOptions, accepts_options, names_in, split_look
from atlas.render.provenance import check_path, provenance_of, save
from atlas.render.request import PictureRequest, check_overlays, resolve_kind
from atlas.spec.spec import MAX_AXES, given_values
from atlas.spec.system import parse_system
from workers import Settings
from workers.model.system import DEFAULT, System
from workers.results import FAILED, INVALID, LARGEST, PENDING, PER_PERIOD, PER_TIME, REGIMES, UNDETERMINED

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from atlas.orbits.branches.table import BranchTable
    from atlas.render.layout import FigureLayout

    Subject: TypeAlias = xr.Dataset | Sequence[xr.Dataset] | Comparison | CellTrajectory | BranchTable


def figure(
    subject: "Subject",
    kind: str | None = None,
    window: Window | None = None,
    *,
    path: str | Path | None = None,
    pixels: tuple[int, int] | None = None,
    titles: Sequence[str] = (),
    **options: "Unpack[AtlasFigureOptions]",
) -> Any:
    """A matplotlib Figure of a subject, shown by notebooks; also written to ``path`` (.png, .svg or .pdf) if given.

    One atlas as ``atlas.open`` returns it, partly done or complete: ``kind`` is one of KINDS, by default "exponent" for
    two axes, "period" without exponents, and "sweep" for one axis; a stack of up to MOST_PANELS planes is drawn like
    several atlases.
    Several atlases: maps on one scale, of "exponent" or "period", by default the first that all of them hold, under
    ``titles`` if no parameter differs.
    A comparison: the difference of the exponents, there minus here, if there are any, and the regimes there of cells
    whose regime differs. The orbit of a cell: its portrait. Branches: section values over the parameter.

    ``window`` gives, for any axis, the (low, high) ends of the part to draw. ``pixels`` is the size, (x, y), of the
    plot area to be filled by a map's cells, if it is not that of a file. ``options`` as in ``options.MapLook``; axes
    given as ``ax`` keep their size and type, and are returned in place of a figure.
    Raises InputError, in one line, for another suffix and a path that cannot be written, for a kind that does not fit
    the number of axes, and if the atlas lacks the variables of the kind.
    Reads only the variables of the kind, of a map only the chunks in view, from the overview whose cells are as large
    as pixels. A file's metadata carry the atlas's digest; the same atlas gives the same bytes with the same software.
    """
    if path is not None:
        check_path(path)
    wanted = PictureRequest.from_arguments(kind, window, pixels, **options)
    drawn = _drawn(subject, wanted, [titles] if isinstance(titles, str) else names_in("titles", titles))
    if path is not None:
        save(drawn, Path(path), provenance_of(*_sources(subject, wanted)), wanted.page)
    return drawn if options.get("ax") is None else options["ax"]


def render(
    subject: "Subject", path: str | Path, kind: str | None = None, window: Window | None = None, **options: Any
) -> Path:
    """Draw a subject to a file and return its path; arguments and errors as in ``figure``."""
    target = validate_path(path)
    figure(subject, kind, window, path=target, **options)
    return target


@accepts_options(FigureOptions, others=True)
def portrait(
    given: Mapping[str, Any] | None = None,
    /,
    *,
    system: str | Mapping[str, Any] | System = DEFAULT,
    settings: Settings | None = None,
    path: str | Path | None = None,
    **named: Any,
) -> "Figure":
    """The portrait of one cell as a matplotlib Figure; also written to ``path`` (.png, .svg or .pdf) if given.

    Time histories with impacts marked, phase planes, the plane of both displacements, the Poincare section, and the
    exponents as they converge, with their exact values where the motion is periodic. ``omega=4.0`` or
    a mapping gives the parameters that differ from the defaults, initial state included: with several attractors it
    decides which is shown.
    Raises InputError for bad parameters, for a cell without a motion to show and for a path that cannot be written.

    >>> import atlas
    >>> figure = atlas.portrait(omega=4.0, b=0.1, path="cell.png", width="85mm")
    """
    from atlas.render.layout import page

    if path is not None:
        check_path(path)
    record = parse_system(system)
    check_names(
        "parameter or option",
        named,
        [*(parameter.name for parameter in record.parameters), *FigureOptions.__annotations__],
    )
    look, values = split_look(named)
    page(**look).check_no_limits("a portrait")  # before the cell is solved
    drawn: Figure = figure(cell_orbit(given_values(given, values), record, settings), path=path, **look)
    return drawn


def _drawn(subject: "Subject", request: PictureRequest, titles: Sequence[str]) -> "Figure":
    import xarray as xr

    from atlas.orbits.branches.table import BranchTable
    from atlas.render import portrait_figure, side_by_side, sweep

    page = request.page
    if isinstance(subject, xr.Dataset):
        drawn = _of_atlas(subject, request)
    elif isinstance(subject, CellTrajectory):
        page.check_no_limits("a portrait")
        drawn = portrait_figure.figure(subject, page)
    elif isinstance(subject, Comparison | Sequence) and not isinstance(subject, str | bytes):
        if page.given:
            raise InputError("ax: several maps make a figure of their own; draw them one by one into axes of yours")
        atlases = [validate_atlas(source, "atlases") for source in _sources(subject, request)]
        if titles and len(titles) != len(atlases):
            raise InputError(f"titles: found {len(titles)}, must be one for each of {len(atlases)} atlases")
        check_units(*atlases)
        if isinstance(subject, Comparison):
            drawn = side_by_side.difference(subject, page)
        else:
            drawn = side_by_side.side_by_side(atlases, request, titles)
    elif isinstance(subject, BranchTable):
        page.check_no_limits("branches are lines")
        drawn = sweep.figure_of_branches(subject, page)
    else:
        validate_atlas(subject, "subject")
        raise InputError("subject: found no dataset of xarray, must be an atlas as atlas.open returns it")
    page.wrap_texts(drawn)
    return drawn


def _sources(subject: "Subject", request: PictureRequest) -> list[Any]:
    """The sources of the numbers of a picture: atlases, an orbit or branches."""
    if isinstance(subject, Comparison):
        return [subject.first, subject.second]
    if isinstance(subject, Sequence):
        return [select_dominant(ds) for ds in subject]
    return [subject, *([] if request.against is None else [request.against])]


def _of_atlas(every: "xr.Dataset", request: PictureRequest) -> "Figure":
    """The figure of one atlas; InputError in one line if it cannot be drawn."""
    ds, page, against = select_dominant(every), request.page, request.against
    if len(axis_names(ds)) == MAX_AXES:
        return _of_stack(ds, request)
    kind, lines = resolve_kind(ds, request), request.overlays
    if request.observe is not None and kind.axes != 1:
        raise InputError(f"observe: goes with a sweep of one axis, found {AXES[kind.axes]}")
    if request.curves is not None and "curves" not in lines and kind.name != "regions":
        lines = (*lines, "curves")
    check_overlays(ds, lines)
    check_units(ds)
    shown = select_window(every if kind.name == "coexistence" else ds, request.window)
    request = replace(
        request, overlays=lines, against=None if against is None else select_window(against, request.window)
    )
    from atlas.render.painters import draw  # imports matplotlib

    with counted() as reads:
        drawn = draw(kind, shown, request)
    if max(reads.block) > 1 and page.title:
        _note_coarseness(page.given[0] if page.given else drawn.axes[0], shown, reads.block, page)
    return drawn


def _of_stack(ds: "xr.Dataset", request: PictureRequest) -> "Figure":
    """The planes of a stack as maps on one scale, each under its value of the third axis; a single plane as a map."""
    kind, page, name, shown = request.kind, request.page, axis_names(ds)[-1], select_window(ds, request.window)
    rest = {axis: ends for axis, ends in (request.window or {}).items() if axis != name}
    count = shown.sizes[name]
    if count == 1:
        return _of_atlas(shown.isel({name: 0}), replace(request, window=rest))
    first = f"--select {name}={float(shown[name][0]):g}"
    if count > MAX_PANELS:
        raise InputError(f"a stack of {count} planes: at most {MAX_PANELS} are drawn together; pick one by {first}")
    alone = {
        "overlay": request.overlays, "curves": request.curves is not None, "against": request.against is not None,
        "ax": page.given, "variable": request.variable, "log": request.log, "observe": request.observe,
    }  # fmt: skip
    for option in [option for option, given in alone.items() if given]:
        raise InputError(f"{option}: goes with one plane, found a stack of {count}; pick one by {first}")
    if kind in KINDS and KIND_TABLE[kind].axes != 2:
        raise InputError(f"kind {kind!r} draws {AXES[KIND_TABLE[kind].axes]}, found a stack of {count} planes")
    from atlas.render import side_by_side

    check_units(ds)
    return side_by_side.side_by_side([shown.isel({name: k}) for k in range(count)], replace(request, window=rest))


def check_units(*atlases: "xr.Dataset") -> None:
    """Raise InputError if exponents have another unit than their machine's: pictures support no other."""
    from atlas.render import text

    for ds in atlases:
        if LARGEST.name in ds and text.in_its_unit(ds, PER_PERIOD) != rate_of(ds[LARGEST.name]) == PER_TIME:
            raise InputError(f"pictures draw exponents {PER_PERIOD}, found {PER_TIME}; draw it as stored")


def _note_coarseness(ax: "Axes", ds: "xr.Dataset", block: tuple[int, ...], layout: "FigureLayout") -> None:
    """Note above a map that it is coarser than its atlas, with the exact shares of doubtful cells."""
    shares = fractions(ds)
    names = [regime.name for regime in REGIMES if regime.code in (PENDING, UNDETERMINED, INVALID, FAILED)]
    doubtful = {name: shares[name] for name in names if name in shares}
    # A share below 0.01 % is shown as such.
    listed = [f"{name} {100 * part:.2g} %" if part >= 1e-4 else f"{name} < 0.01 %" for name, part in doubtful.items()]
    text = ",  ".join([f"one cell drawn for {' × '.join(map(str, block))} computed", *listed])
    with layout.context():
        ax.set_title(f"{ax.get_title('left')}\n{text}".strip(), loc="left")
