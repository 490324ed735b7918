"""Lines over a map: where the impact-free motion would graze, where regimes meet, where exponents are equal, curves."""

from collections.abc import Callable, Iterable

import numpy as np
import xarray as xr
from contourpy import contour_generator
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from scipy import ndimage

from atlas.errors import InputError
from atlas.query import grazing, machine
from atlas.render import axes, crowding, curves, maps
from atlas.render.kinds import OverlayError
from atlas.spec.system import refuse_modes
from workers.model.system import System
from workers.results import LARGEST, PENDING

Array = NDArray[np.float64]

LEAST_REGION = 2e-4
"""Share of the plane below which a connected region is a small one."""
_SEEN = 5.0
"""Width of a cell in points from which its outline leaves its colour to be seen, however many there are."""
_CLOUD, _DENSE = 12.0, 0.2
"""Small regions are a cloud, which outlines would turn black, where they cover more than this share of the area within
this many points.
"""

_CROWDED = 5.0
"""Distance in points below which two grazing lines are drawn solid: dashes side by side look like a bar code."""
_LEAST_LINE = 40.0
"""Length in points below which a piece of an isoline is left out."""
_SHADOW = "#3c4650"
"""What an isoline, white to be told from a boundary, stands out against on pale cells."""
_LABEL_ROOM = 30.0
"""Points between labels of isolines."""


def read(ds: xr.Dataset, variables: Iterable[str], kind: str, options: maps.Options, lacking: str = "") -> maps.Plane:
    """Read what a map with overlays takes: its own variables and theirs, as ``maps.read`` does."""
    extra = (LARGEST.name,) if "isolines" in options.overlays else ()
    return maps.read(ds, (*variables, *extra), kind, options.pixels, lacking)


def draw(ax: Axes, ds: xr.Dataset, plane: maps.Plane, options: maps.Options) -> list[Artist]:
    """Draw overlays over a map and return their legend entries; OverlayError for one that cannot be drawn."""
    entries: list[Artist] = []
    for name, lines in DRAW.items():
        if name in options.overlays:
            try:
                entries += lines(ax, ds, plane, options)
            except InputError as error:
                raise OverlayError(name, str(error)) from None
    return entries


def outlined(regime: NDArray[np.int8], size: tuple[float, float]) -> tuple[NDArray[np.int16], bool]:
    """Every cell's regime as boundaries show it on a map of a size (width, height) in points, and whether they leave
    something out: clouds of small regions, which take on the regime that is nearest. Isolated cells stay.
    """
    if min(points / cells for cells, points in zip(regime.shape, size[::-1], strict=True)) >= _SEEN:
        return regime.astype(np.int16), False
    least = max(2, int(LEAST_REGION * regime.size))
    small = np.zeros(regime.shape, dtype=bool)
    for code in np.unique(regime):
        regions, _ = ndimage.label(regime == code)
        small |= (np.bincount(regions.ravel()) < least)[regions] & (regions > 0)
    near = [max(3, round(_CLOUD * cells / points)) for cells, points in zip(regime.shape, size[::-1], strict=True)]
    cloud = small & (ndimage.uniform_filter(small.astype(float), near) > _DENSE)
    if not cloud.any():
        return regime.astype(np.int16), False
    if cloud.all():
        return np.full(regime.shape, PENDING, dtype=np.int16), True
    nearest = ndimage.distance_transform_edt(cloud, return_distances=False, return_indices=True)
    return regime[tuple(nearest)].astype(np.int16), True


def _grazing(ax: Axes, ds: xr.Dataset, plane: maps.Plane, options: maps.Options) -> list[Artist]:
    system = machine.known_system(ds, "overlay 'grazing'")
    refuse_modes(system, "grazing lines")
    same = machine.fixed(ds, system)
    across, up = np.meshgrid(plane.x.values[[0, -1]], plane.y.values[[0, -1]])
    corners = {plane.x.name: across.ravel(), plane.y.name: up.ravel()}
    _refuse_drift(system, same, corners)
    xs, ys, ratio = grazing.grazing_grid(system, same, plane.x, plane.y)
    dashes, halo = (0, (5, 2)), [withStroke(linewidth=2.8, foreground="white")]
    symmetric = bool(np.all(machine.has_twins(system, same, corners)))
    label = r"grazing, $|Y| = b$" if symmetric else "impact-free motion\ngrazes a stop"
    if np.any(ratio < 0.0) and np.any(ratio > 0.0):
        lines = _lines(xs, ys, ratio, 0.0)
        places = [axes.in_points(ax, line, options.size) for line in lines]
        cut = [(part, beside) for _, part, beside in crowding.parts(lines, places, _CROWDED)]
        crowded, alone = ([part for part, beside in cut if beside is side] for side in (True, False))
        looks = ((lines, "white", 2.8, "solid"), (crowded, "black", 0.8, "solid"), (alone, "black", 1.3, dashes))
        for segments, color, width, look in looks:
            drawn = LineCollection(segments, colors=color, linewidths=width, linestyles=[look], zorder=3)
            ax.add_collection(drawn, autolim=False)
    else:
        label += ": not in this window"
    return [Line2D([], [], color="black", linewidth=1.3, linestyle=dashes, path_effects=halo, label=label)]


def _refuse_drift(system: System, same: dict[str, float], corners: dict[str, Array]) -> None:
    """InputError where a mode has no stiffness in any corner of a map."""
    if all(np.all(grazing.drifts(osc) | ~there) for _, osc, there in machine.oscillators(system, same, corners)):
        raise InputError(
            f"overlay 'grazing': there is no such line, since a mode of {system.name} has no stiffness and its "
            "impact-free motion may drift anywhere"
        )


def _boundaries(ax: Axes, ds: xr.Dataset, plane: maps.Plane, options: maps.Options) -> list[Artist]:
    regions, left_out = outlined(plane.regime, options.size)
    for code in np.unique(regions):
        axes.outline(ax, plane.x, plane.y, regions == code, "#101418", 0.6)
    label = "regime boundary" + (",\nclouds of cells left out" if left_out else "")
    return [Line2D([], [], color="#101418", linewidth=0.9, label=label)]


def _isolines(ax: Axes, ds: xr.Dataset, plane: maps.Plane, options: maps.Options) -> list[Artist]:
    known = maps.determined(plane.regime) & np.isfinite(plane[LARGEST.name])
    if min(known.shape) < 2:
        return []
    segments: list[Array] = []
    named: list[Array] = []
    # Each sign on its own: between them exponents jump, and lines there would show the jump and nothing else.
    for sign, width in ((-1.0, 1.5), (1.0, 2.5)):
        size = np.where(known & (sign * plane[LARGEST.name] > 0.0), np.abs(plane[LARGEST.name]), np.nan)
        shown = _smooth(size, width)
        if np.isfinite(shown).sum() < 4:
            continue
        ticks = np.asarray(MaxNLocator(5).tick_values(0.0, float(np.nanpercentile(size, 98))))
        for level in ticks[(ticks > np.nanmin(shown)) & (ticks < np.nanmax(shown))].tolist():
            for line in _lines(plane.x.values, plane.y.values, np.ma.masked_invalid(shown), level):
                place, along = crowding.dense(axes.in_points(ax, line, options.size))
                if along[-1] >= _LEAST_LINE:
                    segments.append(line)
                    if options.names:
                        _name_line(ax, f"{sign * level:g}".replace("-", "\N{MINUS SIGN}"), place, named, options)
    if not segments:
        return []
    drawn = LineCollection(segments, colors="white", linewidths=0.7, zorder=2.5)
    drawn.set_path_effects([withStroke(linewidth=1.5, foreground=_SHADOW)])
    ax.add_collection(drawn, autolim=False)
    shadow = [withStroke(linewidth=2.0, foreground=_SHADOW)]
    return [Line2D([], [], color="white", linewidth=1.0, path_effects=shadow, label=r"$\lambda_1$ constant")]


def _lines(x: Array, y: Array, values: Array, level: float) -> list[Array]:
    """The lines (N, 2) along which an array (y, x) has a value."""
    return [np.asarray(line) for line in contour_generator(x, y, values).lines(level)]


def _name_line(ax: Axes, name: str, place: Array, named: list[Array], options: maps.Options) -> None:
    """Write a name along a line (N, 2) in points, where it keeps off the frame and the places of other names."""
    size, room = np.array(options.size), _LABEL_ROOM / 2
    for share in (0.5, 0.25, 0.75):
        k = int(share * (len(place) - 1))
        at = place[k]
        if np.all((at > room) & (at < size - room)) and all(np.hypot(*(at - other)) > _LABEL_ROOM for other in named):
            named.append(at)
            across, up = place[min(k + 3, len(place) - 1)] - place[max(k - 3, 0)]
            upright = (np.degrees(np.arctan2(up, across)) + 90.0) % 180.0 - 90.0
            data = ax.transData.inverted().transform(ax.transAxes.transform(at / size))
            ax.text(
                float(data[0]), float(data[1]), name, fontsize=7.0 * options.page.scale, color="black", zorder=3.5,
                rotation=upright, ha="center", va="center",
                path_effects=[withStroke(linewidth=1.6, foreground="white", alpha=0.85)],
            )  # fmt: skip
            return


DRAW: dict[str, Callable[[Axes, xr.Dataset, maps.Plane, maps.Options], list[Artist]]] = {
    "grazing": _grazing,
    "boundaries": _boundaries,
    "isolines": _isolines,
    "curves": curves.draw,
}


def _smooth(values: Array, width: float) -> Array:
    """A Gaussian mean over neighbours that have a value, for the error bars of neighbouring cells not to wrinkle lines.

    Cells with few such neighbours are left out: what is chopped up has no isolines.
    """
    known = np.isfinite(values)
    weight = ndimage.gaussian_filter(known.astype(float), width, mode="nearest")
    total = ndimage.gaussian_filter(np.where(known, values, 0.0), width, mode="nearest")
    return np.where(known & (weight > 0.8), total / np.maximum(weight, 1e-12), np.nan)
