"""Lines over a map: where the impact-free motion would graze, where regimes meet, where exponents are equal."""

from collections.abc import Callable, Sequence

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from scipy import ndimage

from atlas.errors import InputError
from atlas.render import axes, maps, style
from workers.results import LARGEST, PENDING
from workers.system import System

NAMES = ("grazing", "boundaries", "isolines")

LEAST_REGION = 2e-4
"""Share of the plane below which a connected region is not outlined: dust would turn into a black cloud."""

POINTS = 400
"""Points along an axis at which the grazing line is computed, where it takes one axis at a time."""
POINTS_BOTH = 60
"""The same where every pair of both axes has to be computed."""


def variables(chosen: Sequence[str]) -> tuple[str, ...]:
    """The variables that these overlays need, besides the regimes."""
    return (LARGEST.name,) if "isolines" in chosen else ()


def draw(ax: Axes, ds: xr.Dataset, plane: maps.Plane, chosen: Sequence[str]) -> list[Artist]:
    """Draw overlays over a map and return their legend entries."""
    entries: list[Artist] = []
    for name in NAMES:
        if name in chosen:
            entries += _DRAW[name](ax, ds, plane)
    return entries


def grazing_ratio(
    system: System, fixed: dict[str, float], x: tuple[str, NDArray[np.float64]], y: tuple[str, NDArray[np.float64]]
) -> NDArray[np.float64]:
    """log(|Y| / b) over points of two parameters, (y, x): |Y| the amplitude of the impact-free response, b the
    narrower gap. Zero on the grazing line; NaN where there is no such response.
    """

    def at(xv: float, yv: float) -> float:
        try:
            osc = system.build(fixed | {x[0]: xv, y[0]: yv})
        except (ValueError, ArithmeticError):
            return np.nan
        gap = min(osc.b_upper, osc.b_lower)
        return float(np.log(osc.gap.amplitude / gap)) if osc.gap.amplitude > 0.0 and gap > 0.0 else np.nan

    return np.array([[at(float(xv), float(yv)) for xv in x[1]] for yv in y[1]])


def grazing_grid(
    system: System, fixed: dict[str, float], x: axes.Axis, y: axes.Axis
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Points along x, points along y and ``grazing_ratio`` over them, from edge to edge of the map."""
    xs, ys = _points(system, x, POINTS), _points(system, y, POINTS)
    few = [values[[0, POINTS // 3, POINTS // 2, -1]] for values in (xs, ys)]
    probe = grazing_ratio(system, fixed, (x.name, few[0]), (y.name, few[1]))
    if np.allclose(probe, probe[:1] + probe[:, :1] - probe[0, 0], rtol=0, atol=1e-9):
        # Mostly one axis is the clearance: then log(|Y| / b) is a sum of a part of x and a part of y.
        row = grazing_ratio(system, fixed, (x.name, xs), (y.name, ys[:1]))
        column = grazing_ratio(system, fixed, (x.name, xs[:1]), (y.name, ys))
        return xs, ys, row + column - row[0, 0]
    xs, ys = _points(system, x, POINTS_BOTH), _points(system, y, POINTS_BOTH)
    return xs, ys, grazing_ratio(system, fixed, (x.name, xs), (y.name, ys))


def large_regions(regime: NDArray[np.int8]) -> NDArray[np.int16]:
    """Every cell's regime where its connected region is large enough to be outlined; the regime around it elsewhere."""
    least = max(2, int(LEAST_REGION * regime.size))
    small = np.zeros(regime.shape, dtype=bool)
    for code in np.unique(regime):
        regions, _ = ndimage.label(regime == code)
        sizes = np.bincount(regions.ravel())
        small |= (sizes < least)[regions] & (regions > 0)
    if small.all():
        return np.full(regime.shape, PENDING, dtype=np.int16)
    nearest = ndimage.distance_transform_edt(small, return_distances=False, return_indices=True)
    return regime[tuple(nearest)].astype(np.int16)


def _grazing(ax: Axes, ds: xr.Dataset, plane: maps.Plane) -> list[Artist]:
    system = style.system_of(ds)
    if system is None:
        raise InputError("overlay 'grazing': the atlas does not name a system that is known here")
    fixed = {p.name: float(ds[p.name]) for p in system.parameters if p.name in ds.coords and ds[p.name].ndim == 0}
    xs, ys, ratio = grazing_grid(system, fixed, plane.x, plane.y)
    dashes, halo = (0, (5, 2)), [withStroke(linewidth=2.8, foreground="white")]
    label = r"grazing, $|Y| = b$"
    if np.nanmin(ratio) < 0.0 < np.nanmax(ratio):
        lines = ax.contour(xs, ys, ratio, levels=[0.0], colors="black", linewidths=1.3, linestyles=[dashes], zorder=3)
        lines.set_path_effects([*halo])
    else:
        label += ": not in this window"
    return [Line2D([], [], color="black", linewidth=1.3, linestyle=dashes, path_effects=halo, label=label)]


def _boundaries(ax: Axes, ds: xr.Dataset, plane: maps.Plane) -> list[Artist]:
    regions = large_regions(plane.regime)
    for code in np.unique(regions):
        axes.outline(ax, plane.x, plane.y, regions == code, "#101418", 0.5)
    return [Line2D([], [], color="#101418", linewidth=0.9, label="regime boundary")]


def _isolines(ax: Axes, ds: xr.Dataset, plane: maps.Plane) -> list[Artist]:
    values = np.where(np.isfinite(plane[LARGEST.name]), plane[LARGEST.name], np.nan)
    if not np.isfinite(values).any() or min(values.shape) < 2:
        return []
    # Each sign on its own: between them exponents jump, and lines there would show the jump and nothing else.
    for sign in (-1.0, 1.0):
        size = np.where(sign * values > 0.0, np.abs(values), np.nan)
        if np.isfinite(size).sum() < 2:
            continue
        levels = MaxNLocator(5).tick_values(0.0, float(np.nanpercentile(size, 98)))[1:]
        shown = np.ma.masked_invalid(_smooth(size))
        lines = ax.contour(plane.x.values, plane.y.values, shown, levels=levels, colors="#000000", linewidths=0.45)
        lines.set(alpha=0.75, zorder=2.5)
        ax.clabel(
            lines, fmt=lambda level, sign=sign: f"{sign * level:g}".replace("-", "−"), fontsize=6.5, inline_spacing=2
        )
    return [Line2D([], [], color="black", alpha=0.75, linewidth=0.6, label=r"$\lambda_1$ constant")]


_DRAW: dict[str, Callable[[Axes, xr.Dataset, maps.Plane], list[Artist]]] = {
    "grazing": _grazing,
    "boundaries": _boundaries,
    "isolines": _isolines,
}


def _smooth(values: NDArray[np.float64], width: float = 1.5) -> NDArray[np.float64]:
    """A Gaussian mean over neighbours that have a value, for the error bars of neighbouring cells not to wrinkle lines.

    Cells with few such neighbours are left out: what is chopped up has no isolines.
    """
    known = np.isfinite(values)
    weight = ndimage.gaussian_filter(known.astype(float), width, mode="nearest")
    total = ndimage.gaussian_filter(np.where(known, values, 0.0), width, mode="nearest")
    return np.where(known & (weight > 0.7), total / np.maximum(weight, 1e-12), np.nan)


def _points(system: System, axis: axes.Axis, count: int) -> NDArray[np.float64]:
    # From edge to edge, or from the outermost cell's centre where its edge lies outside the parameter's range.
    admits = system.parameter(axis.name).admits
    first, last = axis.edges[0], axis.edges[-1]
    first, last = first if admits(first) else axis.values[0], last if admits(last) else axis.values[-1]
    return np.asarray((np.geomspace if axis.log else np.linspace)(first, last, count))
