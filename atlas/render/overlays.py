"""Lines over a map: where the impact-free motion would graze, where regimes meet, where exponents are equal."""

from collections.abc import Callable, Iterable

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.path import Path
from matplotlib.patheffects import withStroke
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from scipy import ndimage

from atlas.errors import InputError
from atlas.render import axes, maps, style
from workers.model.system import System
from workers.results import LARGEST, PENDING

LEAST_REGION = 2e-4
"""Share of the plane below which a connected region is not outlined: dust would turn into a black cloud."""

POINTS = 400
"""Points along an axis at which the grazing line is computed, where it takes one axis at a time."""
POINTS_OF_PAIRS = 60
"""The same where every pair of points has to be computed, at most."""

_LEAST_LINE = 40.0
"""Length in points below which a piece of an isoline is left out."""
_LABEL_ROOM = 30.0
"""Points between labels of isolines."""


def read(ds: xr.Dataset, variables: Iterable[str], kind: str, options: maps.Options) -> maps.Plane:
    """Read what a map with overlays takes: its own variables and theirs, as ``maps.read`` does."""
    extra = (LARGEST.name,) if "isolines" in options.overlays else ()
    return maps.read(ds, (*variables, *extra), kind, options.pixels)


def draw(ax: Axes, ds: xr.Dataset, plane: maps.Plane, options: maps.Options) -> list[Artist]:
    """Draw overlays over a map and return their legend entries."""
    entries: list[Artist] = []
    for name, lines in DRAW.items():
        if name in options.overlays:
            entries += lines(ax, ds, plane, options)
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
    system: System, fixed: dict[str, float], x: axes.DrawnAxis, y: axes.DrawnAxis, points: int = POINTS
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Points along x, points along y and ``grazing_ratio`` over them, from edge to edge of the map.

    ``points`` along each axis where it takes one axis at a time, else as many and at most POINTS_OF_PAIRS.
    """
    xs, ys = _points(system, x, points), _points(system, y, points)
    few = [values[[0, points // 3, points // 2, -1]] for values in (xs, ys)]
    probe = grazing_ratio(system, fixed, (x.name, few[0]), (y.name, few[1]))
    if np.allclose(probe, probe[:1] + probe[:, :1] - probe[0, 0], rtol=0, atol=1e-9):
        # Mostly one axis is the clearance: then log(|Y| / b) is a sum of a term in x and a term in y.
        row = grazing_ratio(system, fixed, (x.name, xs), (y.name, ys[:1]))
        column = grazing_ratio(system, fixed, (x.name, xs[:1]), (y.name, ys))
        return xs, ys, row + column - row[0, 0]
    points = min(points, POINTS_OF_PAIRS)
    xs, ys = _points(system, x, points), _points(system, y, points)
    return xs, ys, grazing_ratio(system, fixed, (x.name, xs), (y.name, ys))


def large_regions(regime: NDArray[np.int8], share: float = LEAST_REGION) -> NDArray[np.int16]:
    """Every cell's regime where its connected region has at least this share of the plane; else the nearest such."""
    least = max(2, int(share * regime.size))
    small = np.zeros(regime.shape, dtype=bool)
    for code in np.unique(regime):
        regions, _ = ndimage.label(regime == code)
        sizes = np.bincount(regions.ravel())
        small |= (sizes < least)[regions] & (regions > 0)
    if small.all():
        return np.full(regime.shape, PENDING, dtype=np.int16)
    nearest = ndimage.distance_transform_edt(small, return_distances=False, return_indices=True)
    return regime[tuple(nearest)].astype(np.int16)


def _grazing(ax: Axes, ds: xr.Dataset, plane: maps.Plane, options: maps.Options) -> list[Artist]:
    system = style.system_of(ds)
    if system is None:
        raise InputError("overlay 'grazing': the atlas does not name a system that is known here")
    fixed = {p.name: float(ds[p.name]) for p in system.parameters if p.name in ds.coords and ds[p.name].ndim == 0}
    xs, ys, ratio = grazing_grid(system, fixed, plane.x, plane.y)
    dashes, halo = (0, (5, 2)), [withStroke(linewidth=2.8, foreground="white")]
    label = r"grazing, $|Y| = b$"
    if np.any(ratio < 0.0) and np.any(ratio > 0.0):
        lines = ax.contour(xs, ys, ratio, levels=[0.0], colors="black", linewidths=1.3, linestyles=[dashes], zorder=3)
        lines.set_path_effects([*halo])
    else:
        label += ": not in this window"
    return [Line2D([], [], color="black", linewidth=1.3, linestyle=dashes, path_effects=halo, label=label)]


def _boundaries(ax: Axes, ds: xr.Dataset, plane: maps.Plane, options: maps.Options) -> list[Artist]:
    regions = large_regions(plane.regime)
    for code in np.unique(regions):
        axes.outline(ax, plane.x, plane.y, regions == code, "#101418", 0.5)
    return [Line2D([], [], color="#101418", linewidth=0.9, label="regime boundary")]


def _isolines(ax: Axes, ds: xr.Dataset, plane: maps.Plane, options: maps.Options) -> list[Artist]:
    known = maps.determined(plane.regime) & np.isfinite(plane[LARGEST.name])
    if min(known.shape) < 2:
        return []
    # Each sign on its own: between them exponents jump, and lines there would show the jump and nothing else.
    for sign, width in ((-1.0, 1.5), (1.0, 2.5)):
        size = np.where(known & (sign * plane[LARGEST.name] > 0.0), np.abs(plane[LARGEST.name]), np.nan)
        if np.isfinite(size).sum() < 4:
            continue
        shown = np.ma.masked_invalid(_smooth(size, width))
        ticks = np.asarray(MaxNLocator(5).tick_values(0.0, float(np.nanpercentile(size, 98))))
        levels = ticks[(ticks > shown.min()) & (ticks < shown.max())] if shown.count() else ticks[:0]
        if not levels.size:
            continue
        lines = ax.contour(plane.x.values, plane.y.values, shown, levels=levels, colors="black", linewidths=0.5)
        lines.set(alpha=0.8, zorder=2.5)
        lines.set_paths([_long_pieces(ax, path, options.size) for path in lines.get_paths()])
        names = ax.clabel(lines, fmt=_signed(sign), fontsize=7.0 * options.page.scale, inline=False)
        _thin_out(ax, names, options.size)
    return [Line2D([], [], color="black", alpha=0.8, linewidth=0.6, label=r"$\lambda_1$ constant")]


def _signed(sign: float) -> Callable[[float], str]:
    return lambda level: f"{sign * level:g}".replace("-", "\N{MINUS SIGN}")


def _long_pieces(ax: Axes, path: Path, size: tuple[float, float]) -> Path:
    """The pieces of a line that are long enough to be followed by eye."""
    # Not path.to_polygons, which leaves out points that stand out by less than a ninth of a unit, of data here.
    vertices = np.asarray(path.vertices)
    codes = np.full(len(vertices), Path.LINETO) if path.codes is None else path.codes
    pieces = np.split(vertices, np.flatnonzero(codes == Path.MOVETO)[1:])
    long = [
        each
        for each in pieces
        if len(each) > 1 and np.hypot(*np.diff(_in_points(ax, each, size), axis=0).T).sum() >= _LEAST_LINE
    ]
    return Path.make_compound_path(*map(Path, long)) if long else Path(np.empty((0, 2)))


def _thin_out(ax: Axes, names: Iterable[Text], size: tuple[float, float]) -> None:
    """Take away labels that would stand in another's way or over the frame; give the others a halo."""
    kept: list[NDArray[np.float64]] = []
    width, height = _in_points(ax, np.array([[ax.get_xlim()[1], ax.get_ylim()[1]]]), size)[0]
    for name in names:
        at = _in_points(ax, np.array([name.get_position()]), size)[0]
        framed = (
            _LABEL_ROOM / 2 < at[0] < width - _LABEL_ROOM / 2 and _LABEL_ROOM / 2 < at[1] < height - _LABEL_ROOM / 2
        )
        if framed and all(np.hypot(*(at - other)) > _LABEL_ROOM for other in kept):
            kept.append(at)
            upright = (name.get_rotation() + 90.0) % 180.0 - 90.0
            name.set(
                rotation=upright, zorder=3.5, path_effects=[withStroke(linewidth=1.6, foreground="white", alpha=0.85)]
            )
        else:
            name.remove()


def _in_points(ax: Axes, at: NDArray[np.float64], size: tuple[float, float]) -> NDArray[np.float64]:
    """Data coordinates in points from the lower left corner of the plot, by its nominal size: as a layout that
    is not made yet will have them, nearly.
    """
    return np.asarray(ax.transAxes.inverted().transform(ax.transData.transform(at)) * np.array(size))


DRAW: dict[str, Callable[[Axes, xr.Dataset, maps.Plane, maps.Options], list[Artist]]] = {
    "grazing": _grazing,
    "boundaries": _boundaries,
    "isolines": _isolines,
}


def _smooth(values: NDArray[np.float64], width: float) -> NDArray[np.float64]:
    """A Gaussian mean over neighbours that have a value, for the error bars of neighbouring cells not to wrinkle lines.

    Cells with few such neighbours are left out: what is chopped up has no isolines.
    """
    known = np.isfinite(values)
    weight = ndimage.gaussian_filter(known.astype(float), width, mode="nearest")
    total = ndimage.gaussian_filter(np.where(known, values, 0.0), width, mode="nearest")
    return np.where(known & (weight > 0.8), total / np.maximum(weight, 1e-12), np.nan)


def _points(system: System, axis: axes.DrawnAxis, count: int) -> NDArray[np.float64]:
    # From edge to edge, or from the outermost cell's centre where its edge lies outside the parameter's range.
    admits = system.parameter(axis.name).admits
    first, last = axis.edges[0], axis.edges[-1]
    first, last = first if admits(first) else axis.values[0], last if admits(last) else axis.values[-1]
    return np.asarray((np.geomspace if axis.log else np.linspace)(first, last, count))
