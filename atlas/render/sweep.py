"""Sweeps of one axis: section values of the gap coordinate over exponents; one sweep, or two together."""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.query import hysteresis, machine
from atlas.query.attractors import leading
from atlas.render import branch, maps, style, words
from atlas.render.fit import TITLE
from atlas.render.maps import DrawnAxis
from atlas.render.options import Wanted
from atlas.render.page import Page
from atlas.spec.system import stored_system
from workers.results import ERROR, LARGEST, NO_IMPACT, PENDING, PERIODIC, REGIME, REGIMES, SECTION, SPECTRUM

Panel: TypeAlias = Callable[[Axes, xr.Dataset, DrawnAxis, Page], None]
"""Draws one panel of a sweep from what was read of it."""

LARGEST_LABEL = "largest Lyapunov exponent\n$\\lambda_1$ [per forcing period]"
COLORS = ("#0a6ebd", "#e8701a")
"""Colours of two sweeps drawn together."""
SHADES = {hysteresis.MIRRORED: "#f0eedd", hysteresis.DIFFERENT: "#d6cdea"}
"""Colours of the ground where two sweeps end on mirror images, and on different motions."""
EXPONENTS = ("#b2182b", "#e08214", "#35978f", "#2c4f9e", "#762a83", "#8c6d31", "#e78ac3", "#525252")
"""The colour of each exponent, largest first; those of systems with more begin again."""
_HEIGHT = {1: (1.25, 0.25), 2: (1.7, 0.5)}
"""Height in inches of a figure with one panel, or two, less a share of its width; that share."""
_FEW, _MANY = 2.2, 1.5
"""Least diameter in points of the points of an orbit, and of a cloud such as chaos."""


def figure(ds: xr.Dataset, wanted: Wanted) -> Figure:
    """The sweep as a figure, each panel only if the atlas holds its variable; InputError if it holds neither."""
    panels: dict[str, Panel] = {SECTION.name: draw_section, LARGEST.name: _draw_largest}
    panels = {name: panel for name, panel in panels.items() if name in ds and ds[name].size}
    if not panels:
        raise InputError("kind 'sweep' draws 'section' or 'largest', and this atlas holds neither; see section_samples")
    # The error bars come with the exponents; an atlas of another origin may lack them.
    read = line(ds, [*panels, *([ERROR.name] if ERROR.name in ds else [])])
    return stack(ds, read, panels, regime_legend(read[0][REGIME.name].values), wanted)


def figure_of_all(ds: xr.Dataset, wanted: Wanted) -> Figure:
    """The sweep with all exponents as a figure; InputError where the atlas does not hold them."""
    if SPECTRUM.name not in ds:
        raise InputError(
            "kind 'spectrum' draws the variable 'spectrum', which this atlas does not hold; "
            'see [solve] exponents = "spectrum"'
        )
    has_section = SECTION.name in ds and ds[SECTION.name].size
    panels: dict[str, Panel] = {SECTION.name: draw_section} if has_section else {}
    panels[SPECTRUM.name] = _draw_spectrum
    read = line(ds, list(panels))
    legend = regime_legend(read[0][REGIME.name].values) if has_section else []
    for i in range(read[0][SPECTRUM.name].shape[-1]):
        legend.append(Line2D([], [], color=color_of(i), linewidth=1.5, label=rf"$\lambda_{{{i + 1}}}$"))
    return stack(ds, read, panels, legend, wanted)


def figure_of_two(ds: xr.Dataset, wanted: Wanted) -> Figure:
    """Two sweeps as one figure, shaded where they end on different motions; paler where those are mirror images.

    The rule is ``atlas.query.hysteresis.compare``. InputError unless they have the same axis and share something to
    draw.
    """
    against = wanted.against
    assert against is not None
    hysteresis.check_same_axis(ds, against)
    atlases = (ds, against)
    names = [name for name in (SECTION.name, LARGEST.name) if all(name in each and each[name].size for each in atlases)]
    if not names:
        raise InputError("kind 'hysteresis' draws 'section' or 'largest', and the two atlases do not both hold either")
    optional = [name for name in hysteresis.COMPARED if all(name in each for each in atlases)]
    (first, x), (second, _) = (line(each, [*names, *optional]) for each in atlases)
    found = hysteresis.compare(first, second)

    def panel(ax: Axes, name: str) -> None:
        for what, color in SHADES.items():
            change = np.diff(np.pad(found == what, 1).astype(np.int8))
            for low, high in zip(np.flatnonzero(change == 1), np.flatnonzero(change == -1), strict=True):
                ax.axvspan(x.edges[low], x.edges[high], color=color, linewidth=0, zorder=0)
        for number, each in enumerate((first, second)):
            values = machine.gap_values(each, x.name, each[name]) if name == SECTION.name else each[name].values
            # The second on top and smaller, so that both are seen where they agree.
            size = point_size(x, _FEW, wanted.page) * (1.5, 0.8)[number]
            draw_points(ax, x, values, COLORS[number], size, zorder=2 + number)
        if name == LARGEST.name:
            ax.axhline(0.0, color="black", linewidth=0.7, zorder=1)
        ax.set_ylabel(words.gap_label(stored_system(ds.attrs)) if name == SECTION.name else LARGEST_LABEL)

    panels: dict[str, Panel] = {name: lambda ax, *_, name=name: panel(ax, name) for name in names}
    sweeps = zip(COLORS, atlases, (6.0, 3.5), strict=True)
    legend: list[Artist] = [_dot(color, _direction(each, x.name), size) for color, each, size in sweeps]
    meanings = {hysteresis.MIRRORED: "mirror images", hysteresis.DIFFERENT: "different motions"}
    legend += [
        Patch(facecolor=SHADES[what], edgecolor="#a9a4b8", linewidth=0.4, label=meaning)
        for what, meaning in meanings.items()
        if np.any(found == what)
    ]
    return stack(ds, (first, x), panels, legend, wanted)


def line(ds: xr.Dataset, variables: Sequence[str]) -> tuple[xr.Dataset, DrawnAxis]:
    """These variables and the regimes along the axis of a sweep in rising order, and that axis.

    The only place where the pictures of sweeps choose what they read.
    """
    read, (x,) = maps.rising(ds[[*dict.fromkeys(variables), REGIME.name]])
    return read, x


def stack(
    ds: xr.Dataset,
    read: tuple[xr.Dataset, DrawnAxis],
    panels: Mapping[str, Panel],
    legend: Sequence[Artist],
    wanted: Wanted,
) -> Figure:
    """Panels over one shared axis, under the title line of the fixed parameters; branches over the section."""
    page, (cells, x), (least, share) = wanted.page, read, _HEIGHT[len(panels)]
    branches = None
    if "branches" in wanted.overlays:
        sweeps = [leading(ds), *([] if wanted.against is None else [wanted.against])]
        if any(SECTION.name not in each for each in sweeps):
            raise InputError(
                "overlay 'branches' is drawn over section values, and this atlas holds none; see section_samples"
            )
        from atlas.branches.sweep import tree_through  # with it Numba
        from atlas.branches.table import Branches

        branches = Branches.of(tree_through(sweeps))
    with page.context():
        drawn, plots = page.panels(least + share * page.width, len(panels))
        for ax, (name, panel) in zip(plots, panels.items(), strict=True):
            panel(ax, cells, x, page)
            if name != SECTION.name:
                ax.set_ylim(page.vmin, page.vmax)
            elif branches is not None:
                legend = [*legend, *branch.draw(ax, branches, page)]
            maps.scale_x(ax, x, label=ax is plots[-1])
        drawn.align_ylabels(plots)
        if page.title:
            plots[0].set_title(words.title_line(ds), loc="left", gid=TITLE)
        page.legend(drawn, legend, handlelength=0.8)
    return drawn


def draw_section(ax: Axes, ds: xr.Dataset, x: DrawnAxis, page: Page) -> None:
    """The bifurcation diagram: section values of the gap coordinate in the colours of their regimes."""
    regime = ds[REGIME.name].values
    section = machine.gap_values(ds, x.name, ds[SECTION.name])
    for code in np.unique(regime[regime != PENDING]):
        least = _FEW if code in (PERIODIC, NO_IMPACT) else _MANY
        shown = np.where((regime == code)[:, None], section, np.nan)
        draw_points(ax, x, shown, style.INK[int(code)], point_size(x, least, page))
    ax.set_ylabel(words.gap_label(stored_system(ds.attrs)))


def _draw_largest(ax: Axes, ds: xr.Dataset, x: DrawnAxis, page: Page) -> None:
    regime, largest = ds[REGIME.name].values, ds[LARGEST.name].values
    finite = np.where(np.isfinite(largest), largest, np.nan)
    ax.axhline(0.0, color="black", linewidth=0.7, zorder=1)
    if ERROR.name in ds:
        error = np.nan_to_num(ds[ERROR.name].values)
        ax.fill_between(x.values, finite - error, finite + error, color="#b0b0b0", linewidth=0, zorder=1.5)
    ax.plot(x.values, finite, color="#a6a6a6", linewidth=0.5, zorder=2)
    for code in np.unique(regime[regime != PENDING]):
        draw_points(ax, x, np.where(regime == code, finite, np.nan), style.INK[int(code)], point_size(x, _FEW, page))
    _mark_lost(ax, x, np.isneginf(largest), LARGEST_LABEL, r"(▾: $-\infty$)")


def _draw_spectrum(ax: Axes, ds: xr.Dataset, x: DrawnAxis, page: Page) -> None:
    spectrum = ds[SPECTRUM.name].values
    ax.axhline(0.0, color="black", linewidth=0.7, zorder=1)
    finite = np.where(np.isfinite(spectrum), spectrum, np.nan)
    shown = turns(finite, 0.005 * float(np.nanmax(finite) - np.nanmin(finite)) if np.isfinite(finite).any() else 0.0)
    for i in range(spectrum.shape[-1]):
        ax.plot(x.values, finite[:, i], "-", color=color_of(i), linewidth=0.4, zorder=1.5)
        marked, size = np.where(shown[:, i], finite[:, i], np.nan), point_size(x, 1.4, page)
        ax.plot(x.values, marked, ".", color=color_of(i), markersize=size, markeredgewidth=0, zorder=2)
    label = f"Lyapunov exponents\n$\\lambda_i${words.unit_ending(SPECTRUM.units)}"
    _mark_lost(ax, x, np.any(np.isneginf(spectrum), axis=1), label, r"(▾: some $-\infty$)")


def _mark_lost(ax: Axes, x: DrawnAxis, lost: Any, label: str, note: str) -> None:
    """Mark cells with an exponent of -inf, which has no place on the axis, at its foot, and label the axis."""
    if lost.any():
        foot = np.full(lost.sum(), 0.015)
        ax.plot(x.values[lost], foot, "v", color="black", markersize=2.5, transform=ax.get_xaxis_transform())
    ax.set_ylabel(f"{label}\n{note}" if lost.any() else label)


def color_of(i: int) -> str:
    """The colour of an exponent by its number, the largest being 0."""
    return EXPONENTS[i % len(EXPONENTS)]


def turns(spectrum: NDArray[np.float64], width: float) -> NDArray[np.bool_]:
    """Which exponents (n, m) are drawn on top along a sweep: all that stand alone, and of equal ones, within a width,
    each in turn, so that their points alternate like the strands of a braid.
    """
    n, m = spectrum.shape
    stretch = np.arange(n) // max(1, n // 60)
    apart = np.abs(np.diff(spectrum, axis=1)) > width
    group = np.concatenate([np.zeros((n, 1), int), np.cumsum(apart, axis=1)], axis=1)
    shown = np.empty((n, m), dtype=bool)
    for i in range(m):
        mine = group == group[:, i : i + 1]
        shown[:, i] = stretch % mine.sum(axis=1) == mine[:, :i].sum(axis=1)
    return shown


def point_size(x: DrawnAxis, least: float, page: Page) -> float:
    """The diameter of a point in points: wider than a cell, but within what is seen and what tells points apart."""
    return float(np.clip(1.6 * page.plot_size(1.0)[0] / x.values.size, least, 4.0))


def draw_points(
    ax: Axes, x: DrawnAxis, values: NDArray[np.float64], color: str, size: float, marker: str = ".", zorder: float = 3
) -> None:
    """Draw the values of cells (N,) or (N, n) that are finite as points, ``size`` in points."""
    at = np.broadcast_to(x.values if values.ndim == 1 else x.values[:, None], values.shape)
    shown = np.isfinite(values)
    look: Any = {"color": color, "markersize": size, "markeredgewidth": 0, "zorder": zorder, "rasterized": True}
    ax.plot(at[shown], values[shown], marker, **look)


def regime_legend(regime: NDArray[np.int8]) -> list[Artist]:
    """Legend entries for the regimes of points."""
    codes = [each.code for each in REGIMES if each.code != PENDING and np.any(regime == each.code)]
    return [_dot(style.INK[code], words.name_of(code), 4.0) for code in codes]


def _dot(color: str, label: str, size: float) -> Line2D:
    return Line2D([], [], linestyle="", marker="o", markersize=size, color=color, label=label)


def _direction(ds: xr.Dataset, name: str) -> str:
    try:
        (found,) = (axis.get("continuation") for axis in json.loads(ds.attrs["spec"])["axes"] if axis["name"] == name)
    except (KeyError, TypeError, ValueError):
        found = None
    direction = {"forward": "rising", "backward": "falling"}.get(str(found))
    return f"{direction} ${words.symbol(ds, name)}$" if direction else "each cell from its own start"
