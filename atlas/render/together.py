"""Several atlases in one figure: what differs between two, and maps side by side on one scale."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.query.compare import Comparison, differences
from atlas.query.reads import counted
from atlas.query.resample import view
from atlas.query.window import Window, axis_names, within
from atlas.render import axes, exponent, maps, period, style
from workers.results import LARGEST, NO_IMPACT, PENDING, REGIME, REGIMES

KINDS = {"exponent": LARGEST.name, "period": "period"}
"""The kinds of map that are drawn side by side, and the variable that each takes."""
DIFFERENCE = colormaps["PuOr_r"]
SAME, WITHOUT = "#ffffff", "#9a9a9a"
"""Colours of cells that have the same regime in both atlases, and of those without an exponent in one of them."""

_SHARE = 2.0
"""Per cent of the differences that may lie beyond the ends of the scale."""


def difference(compared: Comparison) -> Figure:
    """Two maps: the difference of the exponents, there minus here, and where the regime is another there, which.

    Where there are no exponents, the second alone. InputError for atlases with one axis.
    """
    names = axis_names(compared.one)
    if len(names) != 2:
        raise InputError(f"a comparison is drawn as a map, found one axis ({names[0]}); sweeps: atlas render --against")
    columns = 2 if compared.has_exponents else 1
    with counted() as reads, rc_context(style.STYLE):
        here, there = _same_cells(compared, (maps.PIXELS[0] // columns, maps.PIXELS[1] // columns))
        drawn = style.new_figure(4.0 if columns == 2 else maps.HEIGHT)
        panels = drawn.subplots(1, columns, sharey=True, squeeze=False)[0].tolist()
        drawn.suptitle(_note(_title(compared), max(reads.block)), x=0.01, ha="left", fontsize=style.STYLE["font.size"])
        entries = _draw_difference(drawn, panels[0], here, there) if columns == 2 else []
        entries = [*_draw_changes(panels[-1], here, there), *entries]
        for ax in panels[1:]:
            ax.set_ylabel("")
        maps.legend_below(drawn, entries)
    return drawn


def side_by_side(
    atlases: Sequence[xr.Dataset], kind: str | None = None, window: Window | None = None, names: Sequence[str] = ()
) -> Figure:
    """Maps of several atlases in one figure, on one scale, each under the parameters in which they differ.

    ``kind`` is one of KINDS, by default the first that all of them hold; ``names`` stand over the maps where no
    parameter differs. Axes have the same limits.
    Raises InputError for fewer than two atlases, for another kind, and where axes or variables are not the same.
    """
    chosen = _check(atlases, kind)
    shown = [within(ds, window) for ds in atlases]
    columns = _columns(len(shown))
    rows = math.ceil(len(shown) / columns)
    variable = KINDS[chosen]
    with counted() as reads, rc_context(style.STYLE):
        pixels = (maps.PIXELS[0] // columns, maps.PIXELS[1] // columns)
        planes = [maps.read(ds, [variable], chosen, pixels) for ds in shown]
        drawn = style.new_figure(0.9 + 2.3 * rows if columns > 2 else 0.9 + 2.9 * rows)
        grid = drawn.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        panels = grid.ravel().tolist()
        for empty in panels[len(shown) :]:
            empty.remove()
        differing = _differing(shown)
        common = shown[0].drop_vars(differing)
        over = _note(style.title_line(common), max(reads.block))
        drawn.suptitle(over, x=0.01, ha="left", fontsize=style.STYLE["font.size"])
        titles = [_panel_title(ds, differing, names[k] if names else f"{k + 1}") for k, ds in enumerate(shown)]
        entries: dict[str, Patch] = {}
        norm = _common_norm(planes) if chosen == "exponent" else None
        for k, (ax, plane, title) in enumerate(zip(panels, planes, titles, strict=False)):
            _texture(ax)
            ax.set_title(title, loc="left")
            for entry in _draw_map(ax, plane, norm):
                entries.setdefault(str(entry.get_label()), entry)
            if k % columns:
                ax.set_ylabel("")
            if k + columns < len(shown):
                ax.set_xlabel("")
            else:
                ax.tick_params(labelbottom=True)  # where the place below is empty too
        for ax, which in ((panels[0], 0), (panels[0], 1)):
            sides = [(plane.x, plane.y)[which].edges for plane in planes]
            limits = min(side[0] for side in sides), max(side[-1] for side in sides)
            (ax.set_xlim, ax.set_ylim)[which](*limits)  # shared, so those of all
        if norm is not None:
            _scale(drawn, panels[: len(shown)], norm, np.concatenate([plane[variable].ravel() for plane in planes]))
        maps.legend_below(drawn, list(entries.values()))
    return drawn


def save(drawn: Figure, path: str | Path, atlases: Sequence[xr.Dataset]) -> Path:
    """Write a figure of several atlases to a file, whose metadata carry all their digests; InputError if it cannot."""
    target = Path(path)
    try:
        style.save(drawn, target, target.suffix.lower().removeprefix("."), style.provenance_of(*atlases))
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror or error}") from None
    return target


def _check(atlases: Sequence[xr.Dataset], kind: str | None) -> str:
    """The kind to draw."""
    if len(atlases) < 2:
        raise InputError(f"maps side by side need two atlases or more, found {len(atlases)}")
    first = axis_names(atlases[0])
    if len(first) != 2:
        raise InputError(f"maps have two axes, found one ({first[0]})")
    for k, ds in enumerate(atlases[1:], 2):
        if axis_names(ds) != first:
            raise InputError(
                f"the axes differ: {', '.join(first)} of atlas 1, {', '.join(axis_names(ds))} of atlas {k}"
            )
    if kind is not None and kind not in KINDS:
        raise InputError(f"kind {kind!r} is drawn of one atlas; side by side: {', '.join(KINDS)}")
    held = [name for name, variable in KINDS.items() if all(variable in ds for ds in atlases)]
    if not held or (kind is not None and kind not in held):
        lacking = next(k for k, ds in enumerate(atlases, 1) if KINDS[kind or "period"] not in ds)
        raise InputError(f"kind {kind or 'period'!r} draws {KINDS[kind or 'period']!r}, which atlas {lacking} lacks")
    return kind or held[0]


def _columns(count: int) -> int:
    return count if count <= 3 else 2 if count == 4 else 3


def _differing(atlases: Sequence[xr.Dataset]) -> list[str]:
    """The fixed parameters that are not the same in all of them."""
    fixed = [str(n) for n in atlases[0].coords if all(n in ds.coords and ds[n].ndim == 0 for ds in atlases)]
    return [n for n in fixed if len({str(ds[n].values) for ds in atlases}) > 1]


def _panel_title(ds: xr.Dataset, differing: Sequence[str], name: str) -> str:
    values = [(style.symbol(ds, each), float(ds[each])) for each in differing]
    return style.parameter_lines(values) if values else name


def _title(compared: Comparison) -> str:
    """The common parameters, and below them what is there and what is here."""
    common = style.title_line(compared.one.drop_vars(compared.differing))
    sides = [
        ",  ".join(f"${style.symbol(ds, n)} = {style.number(float(ds[n]))}$" for n in compared.differing)
        for ds in (compared.other, compared.one)
    ]
    return f"{common}\n{sides[0]}  compared with  {sides[1]}" if compared.differing else common


def _note(title: str, block: int) -> str:
    """The title with a word about cells that stand for several."""
    return f"{title}\none cell drawn for {block} × {block} computed" if block > 1 else title


def _same_cells(compared: Comparison, pixels: tuple[int, int]) -> tuple[maps.Plane, maps.Plane]:
    """Both planes, of the same cells: overviews where both have them, else the cells themselves."""
    names = [LARGEST.name] if compared.has_exponents else []
    both = [view(ds, names, pixels=pixels) for ds in (compared.one, compared.other)]
    if both[0][REGIME.name].shape != both[1][REGIME.name].shape:
        both = [view(ds, names) for ds in (compared.one, compared.other)]
    return _plane(both[0], names), _plane(both[1], names)


def _plane(ds: xr.Dataset, names: Sequence[str]) -> maps.Plane:
    ds, (x, y) = axes.rising(ds)
    values: Mapping[str, NDArray[np.float64]] = {name: ds[name].values for name in names}
    return maps.Plane(x, y, ds[REGIME.name].values, values)


def _texture(ax: Axes) -> None:
    """The texture of pending cells, which are drawn transparent."""
    ax.patch.set(facecolor="white", edgecolor=style.TEXTURE, hatch=style.HATCH[PENDING], linewidth=0.0)


def _draw_difference(drawn: Figure, ax: Axes, here: maps.Plane, there: maps.Plane) -> list[Patch]:
    """Draw the differences of exponents, with their scale; legend entries."""
    change = differences(here.regime, there.regime, here[LARGEST.name], there[LARGEST.name])
    known = ~np.isnan(change)
    end = float(np.percentile(np.abs(change[known]), 100.0 - _SHARE)) if known.any() else 0.0
    norm = Normalize(-(end or 1.0), end or 1.0)
    rgba = DIFFERENCE(norm(np.where(known, change, 0.0)), bytes=True)
    rgba[~known] = style.rgb(WITHOUT)
    _texture(ax)
    _hide_pending(rgba, here, there)
    axes.draw_cells(ax, here.x, here.y, rgba)
    ax.set_title("difference of exponents", loc="left")
    extend = style.beyond(change[known], float(norm.vmin or 0.0), float(norm.vmax or 0.0))
    bar = drawn.colorbar(ScalarMappable(norm, DIFFERENCE), ax=ax, location="bottom", extend=extend, aspect=28, pad=0.02)
    bar.set_label(r"change of $\lambda_1$ [per forcing period]")
    bar.outline.set_linewidth(0.6)
    grey = ~known & (here.regime != PENDING) & (there.regime != PENDING)
    return [style.swatch(WITHOUT, "without an exponent in one")] if grey.any() else []


def _draw_changes(ax: Axes, here: maps.Plane, there: maps.Plane) -> list[Patch]:
    """Draw the regimes there of cells that have another one here; legend entries."""
    rgba = np.zeros((*here.regime.shape, 4), np.uint8)
    rgba[...] = style.rgb(SAME)
    entries = [style.swatch(SAME, "same regime")]
    pending = (here.regime == PENDING) | (there.regime == PENDING)
    for each in REGIMES:
        cells = (there.regime == each.code) & (here.regime != each.code) & ~pending
        if cells.any():
            rgba[cells] = style.rgb(each.color)
            entries.append(style.swatch(each.color, f"{style.name_of(each.code)} instead"))
    _texture(ax)
    _hide_pending(rgba, here, there)
    axes.draw_cells(ax, here.x, here.y, rgba)
    ax.set_title("another regime", loc="left")
    if pending.any():
        entries.append(style.swatch("white", style.name_of(PENDING), style.HATCH[PENDING]))
    return entries


def _hide_pending(rgba: NDArray[np.uint8], here: maps.Plane, there: maps.Plane) -> None:
    rgba[(here.regime == PENDING) | (there.regime == PENDING)] = 0


def _common_norm(planes: Sequence[maps.Plane]) -> TwoSlopeNorm:
    """The scale of the exponents of all planes."""
    both = [np.where(maps.determined(plane.regime), plane[LARGEST.name], np.nan).ravel() for plane in planes]
    return TwoSlopeNorm(0.0, *exponent.scale_ends(np.concatenate(both)))


def _draw_map(ax: Axes, plane: maps.Plane, norm: TwoSlopeNorm | None) -> list[Patch]:
    """Draw one of several maps: exponents on this scale, or periods; legend entries."""
    if norm is None:
        rgba, entries = period.paint(plane.regime, plane["period"])
        maps.draw(ax, plane, rgba)
        return entries
    largest = np.where(maps.determined(plane.regime), plane[LARGEST.name], np.nan)
    rgba, entries = exponent.paint(plane.regime, largest, norm)
    maps.draw(ax, plane, rgba)
    quiet = (plane.regime == NO_IMPACT) & ~np.isnan(largest)
    if quiet.any():
        color = exponent.COLORMAP(norm(np.median(largest[quiet])))
        ink = style.ink_on(color)
        axes.hatch(ax, plane.x, plane.y, quiet, style.HATCH[NO_IMPACT], ink)
        entries.append(style.swatch(color, style.name_of(NO_IMPACT), style.HATCH[NO_IMPACT], ink))
    return entries


def _scale(drawn: Figure, panels: Sequence[Axes], norm: TwoSlopeNorm, values: NDArray[np.float64]) -> None:
    extend = style.beyond(values, float(norm.vmin or 0.0), float(norm.vmax or 0.0))
    bar = drawn.colorbar(ScalarMappable(norm, exponent.COLORMAP), ax=list(panels), extend=extend, aspect=28, pad=0.02)
    bar.set_label(r"$\lambda_1$ [per forcing period]")
    bar.outline.set_linewidth(0.6)
    bar.ax.axhline(0.0, color="black", linewidth=0.7)
