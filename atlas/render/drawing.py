"""Drawing a subject as a figure or a file: one or several atlases, a comparison, the orbit of a cell, branches."""

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
from atlas.query.read_counter import count_chunk_reads
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
    """Return a matplotlib Figure of a subject, which notebooks show; with ``path`` (.png, .svg or .pdf) also write it.

    subject  what to draw, see below
    kind     one of KINDS; for one atlas the default is "exponent" for two axes, "period" without exponents, "sweep" for
             one axis
    window   (low, high) limits for any axis of the part to draw
    path     file to write
    pixels   size (x, y) of the plot area that a map's cells fill, if it is not that of a file
    titles   titles of several atlases, used if no parameter differs
    options  as in ``options.AtlasFigureOptions``; axes given as ``ax`` keep their size and type, and are returned
             instead of a figure

    One atlas, as ``atlas.open`` returns it, may be unfinished. A stack of up to MAX_PANELS planes is drawn like several
    atlases. Several atlases are maps with common colour limits, of kind "exponent" or "period", by default the first
    that all of them have. A comparison shows the difference of the exponents, second minus first, if there are
    exponents, and the regimes of the second atlas where they differ from those of the first. The orbit of a cell is
    drawn as its portrait. Branches are drawn as the gap coordinate at t = k T, the start of each forcing period, over
    the parameter.

    Only the variables of the kind are read; of a map only the visible chunks, from the overview whose cells are as
    large as pixels. The metadata of a file contain the digest of the atlas. The same atlas gives the same bytes with
    the same software. Raise InputError for another suffix, and for a path that cannot be written. Raise InputError also
    if the kind does not fit the number of axes, and if the atlas lacks variables of the kind.
    """
    if path is not None:
        check_path(path)
    request = PictureRequest.from_arguments(kind, window, pixels, **options)
    drawn = _drawn(subject, request, [titles] if isinstance(titles, str) else names_in("titles", titles))
    if path is not None:
        save(drawn, Path(path), provenance_of(*_sources(subject, request)), request.page)
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
    """Return the portrait of one cell as a matplotlib Figure; with ``path`` (.png, .svg or .pdf) also write it.

    The portrait has time histories with impacts marked, phase planes, the plane of both displacements, the Poincare
    section, and the convergence of the exponents, with their exact values if the motion is periodic. ``omega=4.0`` or a
    mapping gives the parameters that differ from the defaults. Among several attractors the initial state decides which
    one is drawn. Raise InputError for invalid parameters, for a cell without a motion to draw, and for a path that
    cannot be written.

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
    page(**look).check_no_limits("a portrait")  # checked before the cell is solved
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
        if page.axes:
            raise InputError("ax: several maps need a figure of their own; to use ax, draw the maps one by one")
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
    """Return the objects whose numbers a picture shows, for its provenance: atlases, an orbit or branches."""
    if isinstance(subject, Comparison):
        return [subject.first, subject.second]
    if isinstance(subject, Sequence):
        return [select_dominant(ds) for ds in subject]
    return [subject, *([] if request.against is None else [request.against])]


def _of_atlas(every: "xr.Dataset", request: PictureRequest) -> "Figure":
    """Return the figure of one atlas. Raise InputError if it cannot be drawn."""
    ds, page, against = select_dominant(every), request.page, request.against
    if len(axis_names(ds)) == MAX_AXES:
        return _of_stack(ds, request)
    kind, lines = resolve_kind(ds, request), request.overlays
    if request.observe is not None and kind.axes != 1:
        raise InputError(f"observe: goes with a sweep of one axis, found {AXES[kind.axes]}")
    if request.curves is not None and "curves" not in lines:
        lines = (*lines, "curves")
    check_overlays(ds, lines)
    check_units(ds)
    part = select_window(every if kind.name == "coexistence" else ds, request.window)
    request = replace(
        request, overlays=lines, against=None if against is None else select_window(against, request.window)
    )
    from atlas.render.maps import draw  # imports matplotlib

    with count_chunk_reads() as reads:
        drawn = draw(kind, part, request)
    if max(reads.block) > 1 and page.title:
        _note_coarseness(page.axes[0] if page.axes else drawn.axes[0], part, reads.block, page)
    return drawn


def _of_stack(ds: "xr.Dataset", request: PictureRequest) -> "Figure":
    """Return the planes of a stack as maps with common colour limits, each titled by its value of the third axis.

    A single plane is drawn as a map.
    """
    kind, page, name, part = request.kind, request.page, axis_names(ds)[-1], select_window(ds, request.window)
    rest = {axis: ends for axis, ends in (request.window or {}).items() if axis != name}
    count = part.sizes[name]
    if count == 1:
        return _of_atlas(part.isel({name: 0}), replace(request, window=rest))
    first = f"--select {name}={float(part[name][0]):g}"
    if count > MAX_PANELS:
        raise InputError(f"a stack of {count} planes: at most {MAX_PANELS} are drawn together; pick one by {first}")
    alone = {
        "overlay": request.overlays, "curves": request.curves is not None, "against": request.against is not None,
        "ax": page.axes, "variable": request.variable, "log": request.log, "observe": request.observe,
    }  # fmt: skip
    for option in [option for option, is_given in alone.items() if is_given]:
        raise InputError(f"{option}: goes with one plane, found a stack of {count}; pick one by {first}")
    if kind in KINDS and KIND_TABLE[kind].axes != 2:
        raise InputError(f"kind {kind!r} draws {AXES[KIND_TABLE[kind].axes]}, found a stack of {count} planes")
    from atlas.render import side_by_side

    check_units(ds)
    return side_by_side.side_by_side([part.isel({name: k}) for k in range(count)], replace(request, window=rest))


def check_units(*atlases: "xr.Dataset") -> None:
    """Raise InputError if an atlas's exponents were converted to another unit than the stored one.

    Pictures support no other unit.
    """
    from atlas.render import text

    for ds in atlases:
        if LARGEST.name in ds and text.in_its_unit(ds, PER_PERIOD) != rate_of(ds[LARGEST.name]) == PER_TIME:
            raise InputError(f"pictures need exponents {PER_PERIOD}, found {PER_TIME}; draw the atlas as stored")


def _note_coarseness(ax: "Axes", ds: "xr.Dataset", block: tuple[int, ...], layout: "FigureLayout") -> None:
    """Note above a map that one drawn cell stands for several, with the exact fractions of cells without a sure result.

    ax       the plot of the map
    ds       the atlas
    block    number of cells of the atlas along each axis for which one drawn cell stands
    layout   layout of the figure
    """
    shares = fractions(ds)
    names = [regime.name for regime in REGIMES if regime.code in (PENDING, UNDETERMINED, INVALID, FAILED)]
    doubtful = {name: shares[name] for name in names if name in shares}
    # A fraction below 0.01 % is shown as such.
    listed = [f"{name} {100 * part:.2g} %" if part >= 1e-4 else f"{name} < 0.01 %" for name, part in doubtful.items()]
    text = ",  ".join([f"one cell drawn for {' × '.join(map(str, block))} computed", *listed])
    with layout.context():
        ax.set_title(f"{ax.get_title('left')}\n{text}".strip(), loc="left")
