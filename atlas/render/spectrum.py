"""The sweep with the whole spectrum: the bifurcation diagram over all Lyapunov exponents, on one axis."""

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from atlas.branches.table import Branches
from atlas.errors import InputError
from atlas.render import axes, style, sweep
from atlas.render.page import STANDARD, Page
from workers.results import REGIME, SECTION, SPECTRUM

COLORS = ("#b2182b", "#e08214", "#35978f", "#2c4f9e", "#762a83", "#8c6d31", "#e78ac3", "#525252")
"""The colour of each exponent, largest first; those of systems with more begin again."""


def figure(ds: xr.Dataset, page: Page = STANDARD, branches: Branches | None = None) -> Figure:
    """The sweep with all exponents as a figure; InputError where the atlas does not hold them."""
    if SPECTRUM.name not in ds:
        raise InputError(
            "kind 'spectrum' draws the variable 'spectrum', which this atlas does not hold; "
            'see [solve] exponents = "spectrum"'
        )
    panels: dict[str, sweep.Panel] = (
        {SECTION.name: sweep.draw_section} if ds.get(SECTION.name, np.empty(0)).size else {}
    )
    panels[SPECTRUM.name] = _draw_spectrum
    read, x = sweep.line(ds, list(panels))
    with page.context():
        legend: list[Artist] = list(sweep.regime_legend(read[REGIME.name].values)) if len(panels) > 1 else []
        for i in range(read[SPECTRUM.name].shape[-1]):
            legend.append(Line2D([], [], color=color(i), linewidth=1.5, label=rf"$\lambda_{{{i + 1}}}$"))
        return sweep.stack(ds, read, x, panels, legend, page, branches)


def color(i: int) -> str:
    """The colour of an exponent by its number, the largest being 0."""
    return COLORS[i % len(COLORS)]


def turns(spectrum: NDArray[np.float64], width: float) -> NDArray[np.bool_]:
    """Which exponents (n, m) are drawn on top along a sweep: all that stand alone, and of equal ones, within a width,
    each in turn, so that their points alternate like the strands of a braid.
    """
    n, m = spectrum.shape
    stretch = np.arange(n) // max(1, n // 60)
    close = np.abs(np.diff(spectrum, axis=1)) <= width
    group = np.concatenate([np.zeros((n, 1), int), np.cumsum(~close, axis=1)], axis=1)
    shown = np.empty((n, m), dtype=bool)
    for i in range(m):
        mine = group == group[:, i : i + 1]
        rank = mine[:, :i].sum(axis=1)
        shown[:, i] = stretch % mine.sum(axis=1) == rank
    return shown


def _draw_spectrum(ax: Axes, ds: xr.Dataset, x: axes.DrawnAxis, page: Page) -> None:
    spectrum = ds[SPECTRUM.name].values
    ax.axhline(0.0, color="black", linewidth=0.7, zorder=1)
    size = sweep.point_size(x, 1.4, page)
    finite = np.where(np.isfinite(spectrum), spectrum, np.nan)
    shown = turns(finite, 0.005 * float(np.nanmax(finite) - np.nanmin(finite)) if np.isfinite(finite).any() else 0.0)
    for i in range(spectrum.shape[-1]):
        values = finite[:, i]
        ax.plot(x.values, values, "-", color=color(i), linewidth=0.4, zorder=1.5)
        marked = np.where(shown[:, i], values, np.nan)
        ax.plot(x.values, marked, ".", color=color(i), markersize=size, markeredgewidth=0, zorder=2)
    lost = np.isneginf(spectrum).any(axis=1)
    sweep.mark_lost(ax, x, lost)
    ax.set_ylabel(
        f"Lyapunov exponents\n$\\lambda_i${style.unit_ending(SPECTRUM.units)}"
        + ("\n(▾: some $-\\infty$)" if lost.any() else "")
    )
