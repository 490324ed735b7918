"""Several atlases in one figure: the differences of two, or maps side by side with common colour limits."""

import math
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from atlas.errors import InputError
from atlas.query.compare import Comparison, differences, differing_parameters
from atlas.query.plane import Cells, Plane
from atlas.query.read_counter import count_chunk_reads
from atlas.query.window import axis_names, select_window
from atlas.render import colorbar, maps, scalar_maps, text
from atlas.render.kinds import KIND_TABLE, found_axes
from atlas.render.layers import MapLayers, MapView, ScalarLayer, build_layers
from atlas.render.layout import STANDARD, FigureLayout
from atlas.render.looks import Entry, LegendEntry, label_of
from atlas.render.painters import layers_of, with_legend_notes
from atlas.render.request import PictureRequest
from atlas.render.scales import TWO_SIDED, ColorMapping, color_table, scale_ends
from atlas.render.text_wrap import OWN_TITLE
from workers.results import LARGEST, PENDING, PER_PERIOD

KINDS = ("exponent", "period")
"""Kinds of maps that can be drawn side by side."""
DIFFERENCE = color_table((
    "#2d004b", "#542788", "#8073ac", "#b2abd2", "#d8daeb", "#f7f7f7", "#fee0b6", "#fdb863", "#e08214", "#b35806",
    "#7f3b08",
))  # fmt: skip
"""Colours of differences: ColorBrewer's PuOr, reversed."""
SAME, WITHOUT = "#ffffff", "#9a9a9a"
"""Colours of cells with the same regime in both atlases, and of cells without an exponent in one of them."""

_SHARE = 2.0
"""Percentage of the differences that may lie beyond the colour limits."""


def difference(compared: Comparison, layout: FigureLayout = STANDARD) -> Figure:
    """Return a figure of two maps that compare two atlases.

    One shows the exponents of the second atlas minus those of the first, the other the regimes of the second where the
    first has another regime. Without exponents there is only the second map. Raise InputError unless the atlases have
    two axes.
    """
    count = len(axis_names(compared.first))
    if count != 2:
        hint = "sweeps: atlas plot --against" if count == 1 else "pick a plane with .sel"
        raise InputError(f"a comparison is drawn as a map, {found_axes(compared.first)}; {hint}")
    if not compared.has_exponents:
        layout.check_no_limits("a comparison without exponents draws classes")
    count = 2 if compared.has_exponents else 1
    with count_chunk_reads() as reads, layout.context():
        drawn, panels, sheet_layout = _sheet(layout, count, limit=2)
        first, second = compared.planes(sheet_layout.map_pixels)
        layout.add_title(drawn, _title(compared) + _coarseness(max(reads.block)))
        pending = (first.regime == PENDING) | (second.regime == PENDING)
        titled_maps = [(second, "another regime", _changes(first, second, pending, compared.second))]
        if compared.has_exponents:
            label = text.in_its_unit(compared.first, rf"change of $\lambda_1$ [{PER_PERIOD}]")
            titled_maps.append((first, "difference of exponents", _difference(first, second, pending, layout, label)))
        entries: list[Entry] = []
        for ax, (plane, title, layers) in zip(reversed(panels), titled_maps, strict=True):
            entries += maps.lay(ax, plane, layers, sheet_layout)
            ax.set_title(title, loc="left")
            if layers.bar is not None:
                colorbar.draw_bar(drawn, [ax], layers.bar, below=True)
        _label_outside(panels)
        layout.legend(drawn, entries)
    return drawn


def side_by_side(atlases: Sequence[xr.Dataset], request: PictureRequest, names: Sequence[str] = ()) -> Figure:
    """Return a figure with a map of each atlas, with common colour limits.

    atlases   the atlases, of the same two axes
    request   the requested picture; its kind is one of KINDS, by default the first that all atlases have
    names     titles of the maps if no parameter differs; otherwise the titles are the parameters that differ

    All maps have the same axis limits. Raise InputError for fewer than two atlases, for another kind, and for different
    axes or variables.
    """
    kind, page = KIND_TABLE[_check(atlases, request.kind)], request.page
    if kind.name == "period":
        page.check_no_limits("kind 'period' draws classes")
    parts = [select_window(ds, request.window) for ds in atlases]
    changed = differing_parameters(parts)
    with count_chunk_reads() as reads, page.context():
        drawn, panels, sheet_layout = _sheet(page, len(parts), limit=3)
        views = [MapView.read(kind, ds, PictureRequest(sheet_layout)) for ds in parts]
        page.add_title(drawn, text.title_line(parts[0].drop_vars(changed)) + _coarseness(max(reads.block)))
        bars = []
        if kind.name == "exponent":
            known = np.concatenate([view.plane.known_values(LARGEST.name).ravel() for view in views])
            scale = scalar_maps.exponent_scale(*page.ends(*scale_ends(known)))
            bars = [ScalarLayer(scale, known, text.in_its_unit(parts[0], rf"$\lambda_1$ [{PER_PERIOD}]"))]
        entries: dict[str, Entry] = {}
        # number of letters in a line as wide as a map
        letters = max(4, int(sheet_layout.map_size[0] / (0.6 * page.font)))
        for ax, view, name in zip(panels, views, names or map(str, range(1, len(views) + 1)), strict=True):
            title = _values(view.ds, changed) if changed else textwrap.fill(name, letters)
            ax.set_title(title, loc="left", gid=OWN_TITLE)
            layers = layers_of(view, **({"ends": bars[0].ends} if bars else {}))
            for entry in maps.lay(ax, view.plane, layers, sheet_layout):
                entries.setdefault(label_of(entry), entry)
        _label_outside(panels)
        # The axes are shared, so these limits apply to all.
        planes = [view.plane for view in views]
        panels[0].set_xlim(min(plane.x.edges[0] for plane in planes), max(plane.x.edges[-1] for plane in planes))
        panels[0].set_ylim(min(plane.y.edges[0] for plane in planes), max(plane.y.edges[-1] for plane in planes))
        for bar in bars:
            colorbar.draw_bar(drawn, panels, bar, below=not page.has_side_legend)
        page.legend(drawn, list(entries.values()))
    return drawn


def _sheet(layout: FigureLayout, count: int, limit: int) -> tuple[Figure, list[Axes], FigureLayout]:
    """Return a figure of ``count`` plots in rows, with common axes, its plots, and the layout of one plot.

    Rows have at most ``limit`` plots in a wide figure, one less in a narrow figure.
    """
    limit = limit if layout.has_side_legend else limit - 1
    columns = count if count <= limit else 2 if count == 4 else limit
    rows = math.ceil(count / columns)
    under = 0.9 if layout.has_side_legend else 1.5  # with a colorbar
    # The height of a row grows with the width of its maps.
    height = layout.scale * (under + 1.1 * rows) + 0.51 * layout.width / columns * rows
    drawn = layout.figure(height)
    plots = drawn.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel().tolist()
    for empty in plots[count:]:
        empty.remove()
    return drawn, plots[:count], replace(layout, width=layout.width / columns, height=(layout.height or height) / rows)


def _label_outside(plots: Sequence[Axes]) -> None:
    """Remove the axis labels of plots in a grid, except on the left and at the bottom."""
    grid: Any = plots[0].get_gridspec()
    for k, ax in enumerate(plots):
        if k % grid.ncols:
            ax.set_ylabel("")
        if k + grid.ncols < len(plots):
            ax.set_xlabel("")
        else:
            ax.tick_params(labelbottom=True)  # also if the place below is empty


def _check(atlases: Sequence[xr.Dataset], kind: str | None) -> str:
    """Return the kind of map to draw: ``kind``, or the first that all atlases have.

    Raise InputError if the atlases cannot be drawn side by side.
    """
    if len(atlases) < 2:
        raise InputError(f"maps side by side need two atlases or more, found {len(atlases)}")
    first = axis_names(atlases[0])
    if len(first) != 2:
        count = "one" if len(first) == 1 else f"{len(first)}"
        raise InputError(f"maps have two axes, found {count} ({', '.join(first)})")
    for k, ds in enumerate(atlases[1:], 2):
        if axis_names(ds) != first:
            raise InputError(
                f"the axes differ: {', '.join(first)} of atlas 1, {', '.join(axis_names(ds))} of atlas {k}"
            )
    if kind is not None and kind not in KINDS:
        raise InputError(f"kind {kind!r} is drawn of one atlas; side by side: {', '.join(KINDS)}")
    for name in KINDS if kind is None else [kind]:
        variable = KIND_TABLE[name].variables[0]
        lacking = [k for k, ds in enumerate(atlases, 1) if variable not in ds]
        if not lacking:
            return name
    raise InputError(f"kind {name!r} draws {variable!r}, which atlas {lacking[0]} lacks")


def _values(ds: xr.Dataset, names: Iterable[str]) -> str:
    return text.parameter_line([(text.symbol(ds, name), float(ds[name])) for name in names])


def _title(compared: Comparison) -> str:
    """Return the title of a comparison: the common parameters, and below them the differing ones.

    The values of the second atlas come before those of the first.
    """
    common = text.title_line(compared.first.drop_vars(compared.differing))
    sides = [_values(ds, compared.differing) for ds in (compared.second, compared.first)]
    return f"{common}\n{sides[0]}  compared with  {sides[1]}" if compared.differing else common


def _coarseness(block: int) -> str:
    """Return a line of the title that says for how many cells a drawn cell stands; empty if for one."""
    return f"\none cell drawn for {block} × {block} computed" if block > 1 else ""


def _difference(first: Plane, second: Plane, pending: Cells, layout: FigureLayout, label: str) -> MapLayers:
    """Return the layers of a map of the differences of exponents, second atlas minus first.

    first, second   the planes of both atlases
    pending         mask (y, x) of cells that one of the atlases has not solved yet
    layout          layout of the figure, which may set the colour limits
    label           label of the colorbar
    """
    change = differences(first.regime, second.regime, first[LARGEST.name], second[LARGEST.name])
    known = change[~np.isnan(change)]
    most = float(np.percentile(np.abs(known), 100.0 - _SHARE)) if known.size else 0.0
    # The limits are symmetric: one given limit decides the other.
    limits = [end for end in (layout.vmax, layout.vmin) if end is not None]
    end = abs(limits[0]) if limits else most or 1.0
    scale = ColorMapping(TWO_SIDED, scalar_maps.exponent_scale(*layout.ends(-end, end)).ends, DIFFERENCE)
    change = np.where(pending, np.nan, change)
    unknown = np.isnan(change) & ~pending, WITHOUT, "without an exponent in one"
    layers = build_layers(
        np.where(pending, np.int8(PENDING), first.regime), [unknown], ScalarLayer(scale, change, label)
    )
    return replace(layers, legend=[entry for entry in layers.legend if entry.color == WITHOUT])


def _changes(first: Plane, second: Plane, pending: Cells, ds: xr.Dataset) -> MapLayers:
    """Return the layers of a map of the second atlas's regimes where the first atlas has another regime.

    ``pending`` (y, x) is the mask of cells that one of the atlases has not solved yet. ``ds`` is the second atlas, in
    whose words the regimes are named.
    """
    same = (first.regime == second.regime) & ~pending, SAME, "same regime"
    layers = with_legend_notes(build_layers(np.where(pending, np.int8(PENDING), second.regime), [same]), ds)
    same_entry = LegendEntry(*same[1:])
    others = [entry for entry in layers.legend if entry != same_entry]
    named = [e if e.regime == PENDING else replace(e, label=f"{e.label} instead") for e in others]
    return replace(layers, legend=[same_entry, *named])
