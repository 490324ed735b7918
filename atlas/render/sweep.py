"""Pictures of sweeps, atlases over one axis: bifurcation diagrams above exponents or shares; and branches of orbits.

A bifurcation diagram shows section values: the gap coordinate at t = k T, the start of each forcing period.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.query.attractors import branches as branches_of
from atlas.query.attractors import select_dominant
from atlas.query.compare import check_same_axis
from atlas.query.plane import CoordinateInfo, PlaneAxis, sort_axes
from atlas.query.window import spec_of_axis
from atlas.render import class_maps, looks, raster, style, text
from atlas.render.kinds import KIND_TABLE
from atlas.render.layout import STANDARD, FigureLayout
from atlas.render.looks import Entry, LineLook, MarkLook
from atlas.render.outlines import interleave_exponents
from atlas.render.plotted_values import PlottedValues, shown_label
from atlas.render.request import PictureRequest
from workers.results import ATTRACTOR, ERROR, LABEL, LARGEST, NO_IMPACT, PENDING, PER_PERIOD, PERIODIC, REGIME, SPECTRUM

if TYPE_CHECKING:
    from atlas.orbits.branches.table import BranchTable

Array = NDArray[np.float64]
Panel: TypeAlias = Callable[[Axes, xr.Dataset, PlaneAxis, FigureLayout], None]
"""A function that draws one plot of a sweep."""

LARGEST_LABEL = f"largest Lyapunov exponent\n$\\lambda_1$ [{PER_PERIOD}]"
COLORS = ("#0a6ebd", "#e8701a")
"""Colours of two sweeps in one picture."""
EXPONENTS = ("#b2182b", "#e08214", "#35978f", "#2c4f9e", "#762a83", "#8c6d31", "#e78ac3", "#525252")
"""Colour of each exponent, the largest first; repeated for systems with more."""
INTERVAL = ("share_low", "share_high")
"""Names of the variables with the limits of the 95 % interval of a share; a legend gives its largest width."""
_POINT = 2.0
"""Minimum diameter of a point, in points of the page: still visible on white."""
ORBITS = {
    True: LineLook("stable orbit", "#1a1a1a"),
    False: LineLook("unstable orbit", "#1a1a1a", (3.2, 1.4), 0.6),
}
"""Looks of the stable (True) and the unstable (False) parts of a branch."""
_MARKER = 3.6
"""Size of an event's marker in points."""
_HEIGHT = {1: (1.25, 0.25), 2: (1.7, 0.5)}
"""Height of a figure with one or two plots: a length in inches, and the share of the width that is added to it."""
_FEW, _MANY = 2.2, 1.5
"""Minimum diameter, in points, of the points of an orbit, and of a cloud such as chaos."""


def figure(ds: xr.Dataset, request: PictureRequest) -> Figure:
    """Return the bifurcation diagram of a sweep above its largest exponent, as a figure.

    The diagram shows the gap coordinate at t = k T, or an observable. Each plot is drawn if the atlas has its variable.
    Raise InputError if the atlas has neither.
    """
    return _of_one(ds, request, dict.fromkeys(names_with_values([LARGEST.name], ds), _draw_largest))


def figure_of_all(ds: xr.Dataset, request: PictureRequest) -> Figure:
    """Return the bifurcation diagram of a sweep above all its Lyapunov exponents, as a figure.

    The diagram shows the gap coordinate at t = k T, or an observable. Raise InputError if the atlas lacks the
    exponents.
    """
    KIND_TABLE["spectrum"].require(ds, [SPECTRUM.name])
    numbers = range(ds[SPECTRUM.name].shape[-1])
    entries = [LineLook(rf"$\lambda_{{{i + 1}}}$", color_of(i), width=1.5) for i in numbers]
    return _of_one(ds, request, {SPECTRUM.name: _draw_spectrum}, entries)


def _of_one(
    ds: xr.Dataset, request: PictureRequest, exponents: Mapping[str, Panel], entries: Sequence[Entry] = ()
) -> Figure:
    """Return the figure of one sweep: a bifurcation diagram above a plot of its exponents.

    ``exponents`` holds the function that draws this plot, by variable; ``entries`` are added to the legend. Raise
    InputError if there is nothing to draw.
    """
    plotted_values = PlottedValues.resolve(request.observe, ds)
    panels = {**({plotted_values.name: _panel_of_points(plotted_values.name)} if plotted_values else {}), **exponents}
    if not panels:
        raise InputError("kind 'sweep' needs 'section' or 'largest', and this atlas has neither; see section_samples")
    errors = names_with_values([ERROR.name], ds) if LARGEST.name in panels else []  # other atlases may lack error bars
    read = line(ds, [*panels, *errors], plotted_values)
    regimes = [] if [*panels] == [SPECTRUM.name] else regime_legend(read[0][REGIME.name].values, read[0])
    notes = [] if plotted_values is None else plotted_values.notes(read[0])
    return stack(ds, read, panels, [*regimes, *entries, *notes], request, plotted_values)


def figure_of_two(ds: xr.Dataset, request: PictureRequest) -> Figure:
    """Return two sweeps in one figure, in two colours; their points coincide where the motions are the same.

    Raise InputError unless the sweeps have the same axis and a common variable.
    """
    against = request.against
    assert against is not None
    check_same_axis(ds, against)
    atlases = (ds, against)
    plotted_values = PlottedValues.resolve(request.observe, *atlases)
    names = ([] if plotted_values is None else [plotted_values.name]) + names_with_values([LARGEST.name], *atlases)
    if not names:
        raise InputError("kind 'hysteresis' needs 'section' or 'largest' in both atlases; found neither in both")
    (first, x), (second, _) = (line(ds, names, plotted_values) for ds in atlases)

    def panel(ax: Axes, name: str) -> None:
        # The second sweep is smaller and on top, so that both are visible if they agree.
        for cells, color, larger, zorder in ((first, COLORS[0], 1.5, 2), (second, COLORS[1], 0.8, 3)):
            size = point_size(x, _FEW, request.page) * larger
            draw_points(ax, x, cells[name].values, color, size, zorder=zorder)
        if name == LARGEST.name:
            ax.axhline(0.0, color="black", linewidth=0.7, zorder=1)
            ax.set_ylabel(text.in_its_unit(ds, LARGEST_LABEL))

    panels: dict[str, Panel] = {name: lambda ax, *_, name=name: panel(ax, name) for name in names}
    sweeps = zip(COLORS, atlases, (6.0, 3.5), strict=True)
    legend: list[Entry] = [_dot(color, _direction(cells, x.name), size) for color, cells, size in sweeps]
    return stack(ds, (first, x), panels, legend, request, plotted_values)


def figure_of_attractors(ds: xr.Dataset, request: PictureRequest) -> Figure:
    """Return a figure of all attractors along one axis: a bifurcation diagram above their shares of the initial states.

    Without stored values at t = k T the exponents of the attractors are drawn. Attractors have the colours of their
    regimes, or if labelled, of their branches. Raise InputError if the atlas does not have all attractors.
    """
    if ATTRACTOR not in ds.dims:
        raise InputError("kind 'coexistence' needs all attractors, and this atlas has one per cell; see [attractors]")
    known = branches_of(ds) if LABEL.name in ds else None
    plotted_values = PlottedValues.resolve(request.observe, ds)
    names = names_with_values([LARGEST.name], ds) if plotted_values is None else [plotted_values.name]
    panels = {name: _panel_of_attractors(name, known) for name in names} | {"share": _panel_of_shares(known)}
    ends = [name for name in INTERVAL if name in ds]
    read = line(ds, [*panels, *ends, *([] if known is None else [LABEL.name])], plotted_values)
    regime, entries = read[0][REGIME.name].values, list[Entry]()
    if known is not None:
        label = read[0][LABEL.name].values
        entries, regime = [*class_maps.branch_entries(known, label, ink=True)], regime[label < 0]
    entries += regime_legend(regime, read[0])
    if ends:
        low, high = (read[0][end].values for end in ends)
        reach = float(np.nanmax(high - low, initial=0.0)) / 2.0
        entries.append(f"shares: 95 % interval\nwithin ± {reach:.2f}")
    return stack(ds, read, panels, entries, request, plotted_values)


def figure_of_branches(branches: "BranchTable", layout: FigureLayout = STANDARD) -> Figure:
    """Return a figure of branches of orbits over their parameter, titled by the other parameters."""
    system, parameter = branches.system, branches.system.parameter(branches.along)
    meaning = CoordinateInfo(parameter.meaning, parameter.symbol, parameter.unit)
    parameters = {name: value for name, value in branches.parameters.items() if name not in system.states}
    with layout.context():
        drawn, (ax,) = layout.panels(1.2 + 0.45 * layout.width, 1, text.system_line(system, parameters))
        entries = draw_branches(ax, branches, layout)
        label = shown_label(branches.observable, system)
        ax.set(xlabel=text.axis_label(parameter.name, meaning), ylabel=label, xlim=branches.window)
        ax.margins(y=0.06)
        layout.legend(drawn, entries)
    return drawn


def names_with_values(names: Iterable[str], *atlases: xr.Dataset) -> list[str]:
    """Return the names of the variables that all of the atlases have, with values."""
    return [name for name in names if all(name in atlas and atlas[name].size for atlas in atlases)]


def line(ds: xr.Dataset, variables: Iterable[str], plotted: PlottedValues | None) -> tuple[xr.Dataset, PlaneAxis]:
    """Return the named variables, the plotted values and the regimes of a sweep, sorted along its axis, and the axis.

    The plotted values have the name of their variable. Pictures of sweeps read an atlas only here.
    """
    more = () if plotted is None else plotted.reads
    read, (x,) = sort_axes(ds[[*dict.fromkeys([*variables, *more, REGIME.name])]])
    if plotted is not None:
        values = plotted.values(read, x)
        read = read.assign({plotted.name: (read[plotted.name].dims[: values.ndim], values)})
    return read, x


def stack(
    ds: xr.Dataset,
    read: tuple[xr.Dataset, PlaneAxis],
    panels: Mapping[str, Panel],
    legend: Sequence[Entry],
    request: PictureRequest,
    plotted_values: PlottedValues | None = None,
) -> Figure:
    """Return a figure with panels over one shared axis, titled by the fixed parameters.

    ds               the atlas
    read             the cells of the sweep and its axis, from ``line``
    panels           functions that draw the panels, by the variable that each shows
    legend           entries of the legend
    request          the requested picture
    plotted_values   the values of the first panel; over them the overlay of branches is drawn
    """
    page, (cells, x), (least, share) = request.page, read, _HEIGHT[len(panels)]
    branches = None
    if "branches" in request.overlays:
        sweeps = [select_dominant(ds), *([] if request.against is None else [request.against])]
        if plotted_values is None:
            raise InputError("overlay 'branches' needs section values, and this atlas has none; see section_samples")
        from atlas.orbits.branches.from_sweep import tree_through  # imports Numba, which is slow
        from atlas.orbits.branches.table import BranchTable

        branches = BranchTable.from_tree(tree_through(sweeps), plotted_values.observable)
    with page.context():
        drawn, plots = page.panels(least + share * page.width, len(panels), text.title_line(ds))
        for ax, (name, panel) in zip(plots, panels.items(), strict=True):
            panel(ax, cells, x, page)
            if plotted_values is None or name != plotted_values.name:
                ax.set_ylim(page.vmin, page.vmax)
            else:
                ax.set_ylabel(plotted_values.label(ds))
                legend = [*legend, *(draw_branches(ax, branches, page) if branches else [])]
            raster.scale_axes(ax, ax is plots[-1], x=x)
        drawn.align_ylabels(plots)
        page.legend(drawn, legend, handlelength=0.8)
    return drawn


def _panel_of_points(name: str) -> Panel:
    """Return the function that draws a bifurcation diagram of the plotted values ``name``."""

    def draw(ax: Axes, ds: xr.Dataset, x: PlaneAxis, layout: FigureLayout) -> None:
        regime, values = ds[REGIME.name].values, ds[name].values
        for code in np.unique(regime[regime != PENDING]):
            least = _FEW if code in (PERIODIC, NO_IMPACT) else _MANY
            draw_points(ax, x, values, looks.INK[int(code)], point_size(x, least, layout), cells=regime == code)

    return draw


def _draw_largest(ax: Axes, ds: xr.Dataset, x: PlaneAxis, layout: FigureLayout) -> None:
    largest = ds[LARGEST.name].values
    finite = np.where(np.isfinite(largest), largest, np.nan)
    ax.axhline(0.0, color="black", linewidth=0.7, zorder=1)
    if ERROR.name in ds:
        error = np.nan_to_num(ds[ERROR.name].values)
        ax.fill_between(x.values, finite - error, finite + error, color="#b0b0b0", linewidth=0, zorder=1.5)
    ax.plot(x.values, finite, color="#a6a6a6", linewidth=0.5, zorder=2)
    for cells, color in _groups(ds, None):
        draw_points(ax, x, finite, color, point_size(x, _FEW, layout), cells=cells)
    _mark_lost(ax, x, np.isneginf(largest), text.in_its_unit(ds, LARGEST_LABEL), r"(▾: $-\infty$)")


def _draw_spectrum(ax: Axes, ds: xr.Dataset, x: PlaneAxis, layout: FigureLayout) -> None:
    spectrum = ds[SPECTRUM.name].values
    ax.axhline(0.0, color="black", linewidth=0.7, zorder=1)
    finite = np.where(np.isfinite(spectrum), spectrum, np.nan)
    visible = interleave_exponents(
        finite, 0.005 * float(np.nanmax(finite) - np.nanmin(finite)) if np.isfinite(finite).any() else 0.0
    )
    for i in range(spectrum.shape[-1]):
        ax.plot(x.values, finite[:, i], "-", color=color_of(i), linewidth=0.4, zorder=1.5)
        marked, size = np.where(visible[:, i], finite[:, i], np.nan), point_size(x, 1.4, layout)
        ax.plot(x.values, marked, ".", color=color_of(i), markersize=size, markeredgewidth=0, zorder=2)
    label = text.in_its_unit(ds, f"Lyapunov exponents\n$\\lambda_i$ [{PER_PERIOD}]")
    _mark_lost(ax, x, np.any(np.isneginf(spectrum), axis=1), label, r"(▾: some $-\infty$)")


def _panel_of_attractors(name: str, known: xr.Dataset | None) -> Panel:
    """Return the function that draws a variable of every attractor along a sweep; larger shares lie on top.

    The variable ``name`` is that of the plotted values, or the largest exponent. ``known`` is the table of branches.
    """

    def draw(ax: Axes, ds: xr.Dataset, x: PlaneAxis, layout: FigureLayout) -> None:
        for k in reversed(range(ds.sizes[ATTRACTOR])):
            attractor = ds.isel({ATTRACTOR: k})
            size = point_size(x, (1.0 if name == LARGEST.name else 0.6) * _POINT, layout)
            for cells, color in _groups(attractor, known):
                draw_points(ax, x, attractor[name].values, color, size, "o", cells=cells)
        ax.set_ylabel(text.in_its_unit(ds, LARGEST_LABEL))

    return draw


def _panel_of_shares(known: xr.Dataset | None) -> Panel:
    """Return the function that draws the shares of all attractors, stacked, with white lines between.

    The rest up to 1 is the share of the undecided initial states. ``known`` is the table of branches.
    """

    def draw(ax: Axes, ds: xr.Dataset, x: PlaneAxis, layout: FigureLayout) -> None:
        bands: list[tuple[str, Array]] = []
        for k in range(ds.sizes[ATTRACTOR]):
            attractor = ds.isel({ATTRACTOR: k})
            share = np.nan_to_num(attractor["share"].values)
            bands += [(color, np.where(cells, share, 0.0)) for cells, color in _groups(attractor, known)]
        ink = [] if known is None else [str(color) for color in class_maps.branch_colors(known, ink=True)]
        order = [*ink, *(color for color, _ in bands)]
        foot, ends = np.zeros(x.values.size), np.repeat(x.edges, 2)[1:-1]
        for color, height in sorted(bands, key=lambda band: order.index(band[0])):
            top = foot + height
            ax.fill_between(ends, np.repeat(foot, 2), np.repeat(top, 2), color=color, linewidth=0, rasterized=True)
            ax.stairs(np.where(height > 0.0, foot, np.nan), x.edges, baseline=None, color="white", linewidth=0.5)
            foot = top
        ax.set(ylabel="share of the\ninitial states", ylim=(0.0, 1.0))

    return draw


def _groups(attractor: xr.Dataset, known: xr.Dataset | None) -> Iterator[tuple[NDArray[np.bool_], str]]:
    """Yield a mask of cells and their colour, for each colour that one attractor per cell has along a sweep.

    ``attractor`` is the dataset of the attractor in each cell. ``known`` is the table of branches if attractors are
    labelled, else None.
    """
    regime = attractor[REGIME.name].values
    label = attractor[LABEL.name].values if known is not None else np.full(regime.shape, -1)
    for code in np.unique(regime[(regime != PENDING) & (label < 0)]):
        yield (regime == code) & (label < 0), looks.INK[int(code)]
    colors = np.array(class_maps.branch_colors(known, ink=True) if known is not None else [], dtype=str)
    for color in np.unique(colors[label[label >= 0]]):
        yield (label >= 0) & (colors[np.maximum(label, 0)] == color), str(color)


def _mark_lost(ax: Axes, x: PlaneAxis, lost: Any, label: str, note: str) -> None:
    """Mark cells with an exponent of -inf at the bottom of a plot, and label its vertical axis.

    ``lost`` is the mask of these cells; ``note`` explains the marks in the label if there are any.
    """
    if lost.any():
        foot = np.full(lost.sum(), 0.015)
        ax.plot(x.values[lost], foot, "v", color="black", markersize=2.5, transform=ax.get_xaxis_transform())
    ax.set_ylabel(f"{label}\n{note}" if lost.any() else label)


def draw_branches(ax: Axes, branches: "BranchTable", layout: FigureLayout) -> list[Entry]:
    """Draw branches of orbits and their mirror images, with their events, and return the legend entries."""
    lines, places, entries = list(branches.lines()), list(branches.event_places()), list[Entry]()
    for stable, usual in ORBITS.items():
        look = usual._replace(width=usual.width * layout.scale)
        segments = [one for holds, one in lines if holds is stable]
        if segments:
            ax.add_collection(LineCollection(segments, zorder=4, **style.line(look)))
            entries.append(look)
    for kind, event in looks.EVENT_STYLES.items():
        at = [point for mark, point in places if mark == kind]
        if at:
            mark = MarkLook(event.label, event.marker, _MARKER * layout.scale, event.color, "white", 0.5)
            ax.plot(*np.concatenate(at).T, zorder=5, **style.mark(mark))
            entries.append(mark)
    ax.autoscale_view()
    return entries


def color_of(i: int) -> str:
    """Return the colour of the Lyapunov exponent number ``i``; number 0 is the largest."""
    return EXPONENTS[i % len(EXPONENTS)]


def point_size(x: PlaneAxis, minimum: float, layout: FigureLayout) -> float:
    """Return the diameter of a point in points: wider than a cell, but at least ``minimum`` and at most 4."""
    return float(np.clip(1.6 * layout.plot_size(1.0)[0] / x.values.size, minimum, 4.0))


def draw_points(
    ax: Axes,
    x: PlaneAxis,
    values: Array,
    color: str,
    size: float,
    marker: str = ".",
    zorder: float = 3,
    cells: Any = True,
) -> None:
    """Draw the finite values (N,) or (N, n) of the cells of a sweep as points with a diameter of ``size`` points.

    ``cells`` (N,) is the mask of the cells that are drawn, by default all.
    """
    at, mask = np.broadcast_to(x.values, values.T.shape).T, (np.isfinite(values).T & cells).T
    look: Any = {"color": color, "markersize": size, "markeredgewidth": 0, "zorder": zorder, "rasterized": True}
    ax.plot(at[mask], values[mask], marker, **look)


def regime_legend(regime: NDArray[np.int8], ds: xr.Dataset) -> list[Entry]:
    """Return legend entries for the regimes that occur among the points of a sweep."""
    regimes = text.regime(ds)
    codes = np.unique(regime[regime != PENDING]).tolist()
    return [_dot(looks.INK[code], regimes.meaning(code).text, 4.0) for code in codes]


def _dot(color: str, label: str, size: float) -> MarkLook:
    return MarkLook(label, "o", size, color, color, 1.0)


def _direction(ds: xr.Dataset, name: str) -> str:
    direction = {"forward": "rising", "backward": "falling"}.get(str(spec_of_axis(ds, name).get("continuation")))
    return f"{direction} ${text.symbol(ds, name)}$" if direction else "each cell from its own start"
