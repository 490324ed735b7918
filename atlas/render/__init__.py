"""Pictures: one file per kind, drawn from a dataset or an orbit alone, without a display and without pyplot.

To add a kind: write ``figure`` in a file of its own, for a map ``figure(ds, options) -> Figure`` with
``maps.Options``, for a sweep ``figure(ds, page, branches) -> Figure``, and name the file in ``_KINDS``. The tests take
it up from there; ``python -m tests.reference`` draws the reference picture that they ask for.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from atlas.cell.orbit import cell_orbit
from atlas.errors import InputError
from atlas.query.attractors import leading
from atlas.query.queries import fractions
from atlas.query.reads import counted
from atlas.query.window import Window, axis_names, within
from atlas.spec.spec import MOST_AXES
from workers import Settings
from workers.model.system import DEFAULT, System
from workers.results import (
    ATTRACTOR,
    ERROR,
    FAILED,
    INVALID,
    LARGEST,
    PENDING,
    REGIME,
    REGIMES,
    SECTION,
    SPECTRUM,
    UNDETERMINED,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from atlas.branches.table import Branches
    from atlas.cell.orbit import CellOrbit
    from atlas.query.compare import Comparison
    from atlas.render.page import Look, Page
    from atlas.render.style import Provenance


@dataclass(frozen=True)
class _Kind:
    """How many axes and how many atlases a kind of picture draws, a variable that it cannot do without, and whether
    it draws numbers on a scale, which may be given ends; of maps, the ``others`` that they draw.
    """

    axes: int
    variable: str
    atlases: int = 1
    scale: bool = True
    others: tuple[str, ...] = ()


BASINS = "basins"
"""The kind that is drawn of planes of initial states."""

# The first of each number of axes whose variable the atlas holds is the kind drawn unasked. Each is a module here,
# imported at first use: the command's help needs the names and neither matplotlib nor xarray.
_KINDS = {
    "exponent": _Kind(axes=2, variable=LARGEST.name),
    "period": _Kind(axes=2, variable="period", scale=False),
    "impacts": _Kind(axes=2, variable="impacts_upper", scale=False, others=("impacts_lower", "period")),
    "symmetry": _Kind(axes=2, variable="symmetric", scale=False, others=("impacts_upper", "impacts_lower")),
    "regions": _Kind(axes=2, variable="impacts_upper", scale=False),
    "combined": _Kind(axes=2, variable=LARGEST.name, others=("period",)),
    "error": _Kind(axes=2, variable=ERROR.name),
    "cost": _Kind(axes=2, variable="periods_used"),
    "sticking": _Kind(axes=2, variable="stuck_fraction"),
    "attractors": _Kind(axes=2, variable="attractors", scale=False),
    "share": _Kind(axes=2, variable="share"),
    BASINS: _Kind(axes=2, variable="label", scale=False),
    "coexistence": _Kind(axes=1, variable="share"),
    "sweep": _Kind(axes=1, variable=REGIME.name),
    "spectrum": _Kind(axes=1, variable=SPECTRUM.name),
    "hysteresis": _Kind(axes=1, variable=REGIME.name, atlases=2),
}
_AXES = {1: "one axis", 2: "two axes"}
MOST_PANELS = 12
"""Planes of a stack that are drawn together."""
KINDS = tuple(_KINDS)
"""The kinds of picture: "exponent" to "sticking" for two axes, the others for one; "hysteresis" takes two atlases."""

MAPS = tuple(name for name, kind in _KINDS.items() if kind.axes == 2 and name != BASINS)
"""Those of them that are drawn over two axes of a parameter plane, and take overlays."""

SCALAR = "scalar"
"""The kind that maps a variable that is named, any number that an atlas holds."""

_OVERLAYS = {"grazing": 2, "boundaries": 2, "isolines": 2, "curves": 2, "branches": 1}
"""How many axes an overlay is drawn over."""
OVERLAYS = tuple(_OVERLAYS)
"""Lines over a picture. On a map of two axes: |Y| = b, borders of regimes, lines of equal exponent, the curves that its
store keeps. On a sweep: the branches of its orbits.
"""

MAP_OVERLAYS = tuple(name for name, axes in _OVERLAYS.items() if axes == 2)
"""Those of a map."""

FORMATS = ("png", "svg", "pdf")
"""What a picture can be written as, chosen by the file's suffix."""

LOOK = ("width", "height", "font_size", "dpi", "vmin", "vmax", "title", "style")
"""What else can be chosen of every picture: see ``page.Look``."""

__all__ = [
    "FORMATS",
    "KINDS",
    "LOOK",
    "MAPS",
    "MAP_OVERLAYS",
    "OVERLAYS",
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


def needs(kind: str) -> list[str]:
    """The variables that a map of this kind draws, besides the regimes."""
    return [_KINDS[kind].variable, *_KINDS[kind].others]


def has_scale(kind: str) -> bool:
    """Whether pictures of this kind have a scale whose ends can be chosen."""
    return _KINDS[kind].scale


def figure(
    ds: "xr.Dataset",
    kind: str | None = None,
    window: Window | None = None,
    *,
    overlays: str | Sequence[str] = (),
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

    page = page_of(ax, **look)
    drawn = _drawn(
        ds,
        kind,
        window,
        (overlays,) if isinstance(overlays, str) else tuple(overlays),
        against,
        pixels,
        page,
        variable,
        log,
    )
    return drawn if ax is None else ax


def _drawn(
    ds: "xr.Dataset",
    kind: str | None,
    window: Window | None,
    overlays: tuple[str, ...],
    against: "xr.Dataset | None",
    pixels: tuple[int, int] | None,
    page: "Page",
    variable: str | None = None,
    log: bool = False,
) -> "Figure":
    every, ds = ds, leading(ds)
    if len(axis_names(ds)) == MOST_AXES:
        return _drawn_stack(ds, kind, window, overlays, against, pixels, page, variable, log)
    wanted = _scalar(ds, kind, variable, against) if kind == SCALAR or variable is not None or log else None
    chosen = "variable" if wanted is not None else _chosen(ds, kind, against, page)
    _check_overlays(ds, overlays)
    _check_units(ds)
    module, shown = import_module(f"atlas.render.{chosen}"), within(every if chosen == "coexistence" else ds, window)
    drawn: Figure
    with counted() as reads:
        if len(axis_names(ds)) == 1:
            sweeps = [shown] if against is None else [shown, within(against, window)]
            through = [within(ds, window), *sweeps[1:]]
            drawn = module.figure(*sweeps, page, _branches(through) if "branches" in overlays else None)
        else:
            from atlas.render import maps

            options = maps.Options(overlays, page, pixels)
            drawn = module.figure(shown, options) if wanted is None else module.figure(shown, wanted, log, options)
    if ds.attrs.get(ATTRACTOR, 0):
        _say_fewer(drawn, ds.attrs[ATTRACTOR])
    if max(reads.block) > 1 and page.title:
        _note_coarseness(page.given[0] if page.given else drawn.axes[0], shown, reads.block, page)
    page.fit(drawn)
    return drawn


def _say_fewer(drawn: "Figure", place: int) -> None:
    """Say in the legends that cells without a result may have too few attractors for this place."""
    for legend in [*drawn.legends, *(ax.get_legend() for ax in drawn.axes)]:
        for label in legend.get_texts() if legend is not None else ():
            if label.get_text() == "pending":
                label.set_text(f"not more than {place}")


def _chosen(ds: "xr.Dataset", kind: str | None, against: "xr.Dataset | None", page: "Page") -> str:
    """The kind to draw: the one that is asked for, or the first that fits; InputError where it does not fit."""
    axes = axis_names(ds)
    atlases = 1 if against is None else 2
    fitting = [name for name, need in _KINDS.items() if need.axes == len(axes)]
    possible = [name for name in fitting if _KINDS[name].atlases == atlases]
    if not possible:
        raise InputError(f"two atlases are drawn together as sweeps, found {_AXES[len(axes)]} ({', '.join(axes)})")
    held = [name for name in possible if _KINDS[name].variable in ds]
    held = [BASINS] if BASINS in held else held
    chosen = (held or possible)[0] if kind is None else kind
    if chosen not in _KINDS:
        raise InputError(f"unknown kind of picture {chosen!r}; possible here: {', '.join(possible)}")
    if chosen not in fitting:
        raise InputError(
            f"kind {chosen!r} draws {_AXES[_KINDS[chosen].axes]}, found {_AXES[len(axes)]} ({', '.join(axes)}); "
            f"possible here: {', '.join(possible)}"
        )
    if chosen not in possible:
        wanted = "a second atlas to draw against" if _KINDS[chosen].atlases == 2 else "one atlas, found two"
        raise InputError(f"kind {chosen!r} needs {wanted}; possible here: {', '.join(possible)}")
    if not _KINDS[chosen].scale:
        page.refuse_ends(f"kind {chosen!r} draws classes")
    return chosen


def _scalar(ds: "xr.Dataset", kind: str | None, name: str | None, against: "xr.Dataset | None") -> str:
    """The variable that a map of one draws; InputError where none can be drawn."""
    axes = axis_names(ds)
    if kind not in (None, SCALAR):
        raise InputError(f"a variable or a logarithmic scale goes with kind {SCALAR!r}, found {kind!r}")
    if name is None:
        raise InputError(f"kind {SCALAR!r} draws a variable, and none is named")
    if against is not None:
        raise InputError(f"kind {SCALAR!r} draws one atlas, found two")
    if len(axes) != 2:
        raise InputError(f"kind {SCALAR!r} draws two axes, found one ({axes[0]})")
    return name


def _check_overlays(ds: "xr.Dataset", overlays: tuple[str, ...]) -> None:
    axes = axis_names(ds)
    for overlay in overlays:
        if overlay not in OVERLAYS:
            raise InputError(f"unknown overlay {overlay!r}; possible: {', '.join(OVERLAYS)}")
        if _OVERLAYS[overlay] != len(axes):
            kind = {1: "a sweep", 2: "a map"}[_OVERLAYS[overlay]]
            raise InputError(f"overlay {overlay!r} is drawn over {kind}, found {_AXES[len(axes)]} ({', '.join(axes)})")


def _branches(sweeps: "Sequence[xr.Dataset]") -> "Branches":
    """The branches through sweeps, of an atlas of which sections are drawn."""
    from atlas.branches.sweep import tree_through  # with it Numba
    from atlas.branches.table import Branches

    if any(SECTION.name not in each for each in sweeps):
        raise InputError(
            "overlay 'branches' is drawn over section values, and this atlas holds none; see section_samples"
        )
    return Branches.of(tree_through(sweeps))


def _drawn_stack(
    ds: "xr.Dataset",
    kind: str | None,
    window: Window | None,
    overlays: tuple[str, ...],
    against: "xr.Dataset | None",
    pixels: tuple[int, int] | None,
    page: "Page",
    variable: str | None,
    log: bool,
) -> "Figure":
    """The planes of a stack as maps on one scale, each under its value of the third axis; a lone plane as it is."""
    name, shown = axis_names(ds)[-1], within(ds, window)
    rest = {axis: ends for axis, ends in (window or {}).items() if axis != name}
    count = shown.sizes[name]
    if count == 1:
        return _drawn(shown.isel({name: 0}), kind, rest, overlays, against, pixels, page, variable, log)
    first = f"--select {name}={float(shown[name][0]):g}"
    if count > MOST_PANELS:
        raise InputError(f"a stack of {count} planes: at most {MOST_PANELS} are drawn together; pick one by {first}")
    alone = {"overlays": overlays, "against": against is not None, "ax": page.given, "variable": variable, "log": log}
    for what, given in alone.items():
        if given:
            raise InputError(f"{what}: goes with one plane, found a stack of {count}; pick one by {first}")
    if kind is not None and kind in _KINDS and _KINDS[kind].axes != 2:
        raise InputError(f"kind {kind!r} draws {_AXES[_KINDS[kind].axes]}, found a stack of {count} planes")
    from atlas.render import together

    _check_units(ds)
    drawn = together.side_by_side([shown.isel({name: k}) for k in range(count)], kind, rest, page=page)
    page.fit(drawn)
    return drawn


def _check_units(ds: "xr.Dataset") -> None:
    units = ds[LARGEST.name].attrs.get("units", LARGEST.units) if LARGEST.name in ds else LARGEST.units
    if units != LARGEST.units:
        raise InputError(f"pictures draw exponents per forcing period, found units {units}; draw the atlas as stored")


def _note_coarseness(ax: "Axes", ds: "xr.Dataset", block: tuple[int, ...], page: "Page") -> None:
    """Say above a map that it is coarser than its atlas, and the exact shares of doubtful cells, too few to be seen."""
    shares = fractions(ds)
    doubtful = [each.name for each in REGIMES if each.code in (PENDING, UNDETERMINED, INVALID, FAILED)]
    least = 1e-4  # less is not worth its digits, but that there is some is
    percent = {name: f"{100 * shares[name]:.2g} %" if shares[name] >= least else "< 0.01 %" for name in shares}
    listed = "".join(f",  {name} {percent[name]}" for name in doubtful if name in percent)
    cells = " × ".join(map(str, block))
    with page.context():
        ax.set_title(f"{ax.get_title('left')}\none cell drawn for {cells} computed{listed}".strip(), loc="left")


def render(
    ds: "xr.Dataset",
    path: str | Path,
    kind: str | None = None,
    window: Window | None = None,
    *,
    overlays: str | Sequence[str] = (),
    against: "xr.Dataset | None" = None,
    variable: str | None = None,
    log: bool = False,
    **look: "Unpack[Look]",
) -> Path:
    """Draw an atlas to a file and return its path.

    Arguments: ``ds`` as ``atlas.open`` returns it, half done or whole; ``path`` ends in .png, .svg or .pdf;
    ``kind`` is one of KINDS, by default "exponent" for two axes, "period" where there are no exponents, and "sweep"
    for one axis; a stack of up to MOST_PANELS planes is drawn as maps on one scale, of "exponent" or "period";
    ``window`` gives, for any axis, the (low, high) ends of the part to draw; ``overlays`` are of OVERLAYS, one or
    several; ``against`` is the sweep the other way, which makes the kind "hysteresis"; ``variable`` names a number of
    each cell to map, the kind "scalar", by its logarithm if ``log``; ``look`` is
    size, type, resolution and scale: width, height, font_size, dpi, vmin, vmax, title, style, see ``page.Look``.
    Raises InputError, in one line, for another suffix, for a kind that does not fit the number of axes, where the
    atlas does not hold what the kind draws, and for a path that cannot be written.
    Reads only the variables that the kind draws, of a map only the chunks in view, from the overview whose cells are
    as large as pixels. The file's metadata carry the atlas's digest; the same atlas gives the same bytes with the
    same software.
    """
    target, suffix = _target(path)
    from atlas.render.page import page as page_of
    from atlas.render.style import provenance_of

    page = page_of(**look)
    drawn = _drawn(
        ds,
        kind,
        window,
        (overlays,) if isinstance(overlays, str) else tuple(overlays),
        against,
        None,
        page,
        variable,
        log,
    )
    return _write(drawn, target, suffix, provenance_of(ds, *([] if against is None else [against])), page)


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
    target = None if path is None else _target(path)
    from atlas.render import together

    page, atlases = _several_page(look), [leading(ds) for ds in atlases]
    for ds in atlases:
        _check_units(ds)
    return _several(together.side_by_side(atlases, kind, window, names, page), page, target, atlases)


def compared_figure(compared: "Comparison", path: str | Path | None = None, **look: "Unpack[Look]") -> "Figure":
    """A matplotlib Figure of how two atlases differ; written to ``path`` too if given; ``look`` as in ``render``.

    Two maps: the difference of the exponents, there minus here, and where the regime is another there, which. Where
    there are no exponents, the second alone.
    Raises InputError for atlases with one axis and for a path that cannot be written.
    """
    target = None if path is None else _target(path)
    from atlas.render import together

    page, both = _several_page(look), (compared.one, compared.other)
    for ds in both:
        _check_units(ds)
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
        from atlas.render.style import provenance_of

        _write(drawn, *target, provenance_of(*atlases), page)
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
    target, suffix = _target(path)
    from atlas.render import orbit as picture

    page = _orbit_page(look)
    return _write(drawn or orbit_figure(orbit, **look), target, suffix, picture.provenance(orbit), page)


def _orbit_page(look: "Look") -> "Page":
    from atlas.render.page import page as page_of

    if look.get("vmin") is not None or look.get("vmax") is not None:
        raise InputError("a portrait has no scale that vmin and vmax could end")
    return page_of(**look)


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
    target = None if path is None else _target(path)
    from atlas.render import branch as picture
    from atlas.render.page import page as page_of

    page = page_of(**look)
    page.refuse_ends("branches are lines")
    drawn: Figure = picture.figure(branches, page)
    page.fit(drawn)
    if target is not None:
        _write(drawn, *target, picture.provenance(branches), page)
    return drawn


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


def _write(drawn: "Figure", target: Path, suffix: str, provenance: "Provenance", page: "Page") -> Path:
    from atlas.render.style import save

    try:
        with page.context():
            save(drawn, target, suffix, provenance)
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror or error}") from None
    return target
