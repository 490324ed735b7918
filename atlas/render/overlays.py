"""Lines over a map: where the impact-free motion would graze, where regimes meet, where exponents are equal, curves."""

from collections.abc import Callable, Iterable
from itertools import pairwise

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.path import Path
from matplotlib.patheffects import withStroke
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from atlas.errors import InputError
from atlas.render import axes, curves, grazing, machine, maps
from atlas.render.kinds import OverlayError
from atlas.spec.system import refuse_modes
from workers.model.system import System
from workers.results import LARGEST, PENDING

LEAST_REGION = 2e-4
"""Share of the plane below which a connected region is a small one."""
_SEEN = 5.0
"""Width of a cell in points from which its outline leaves its colour to be seen, however many there are."""
_CLOUD, _DENSE = 12.0, 0.2
"""Small regions are a cloud, which outlines would turn black, where they are more than this share of the area so many
points around.
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
        contours = ax.contour(xs, ys, ratio, levels=[0.0], linewidths=0.0)
        pieces = [piece for path in contours.get_paths() for piece in _pieces(path)]
        contours.remove()
        alone, crowded = _told_apart(ax, pieces, options.size)
        for lines, ends, width, look in (
            (pieces, "white", 2.8, "solid"),
            (crowded, "black", 0.8, "solid"),
            (alone, "black", 1.3, dashes),
        ):
            collection = LineCollection(lines, colors=ends, linewidths=width, linestyles=[look], zorder=3)
            ax.add_collection(collection, autolim=False)
    else:
        label += ": not in this window"
    return [Line2D([], [], color="black", linewidth=1.3, linestyle=dashes, path_effects=halo, label=label)]


def _refuse_drift(system: System, same: dict[str, float], corners: dict[str, NDArray[np.float64]]) -> None:
    """InputError where a mode has no stiffness in any corner of a map."""
    if all(np.all(grazing.drifts(osc) | ~there) for _, osc, there in machine.oscillators(system, same, corners)):
        raise InputError(
            f"overlay 'grazing': there is no such line, since a mode of {system.name} has no stiffness and its "
            "impact-free motion may drift anywhere"
        )


def _pieces(path: Path) -> list[NDArray[np.float64]]:
    """The connected lines of a path."""
    vertices = np.asarray(path.vertices)
    if not len(vertices):
        return []
    codes = np.full(len(vertices), Path.LINETO) if path.codes is None else path.codes
    return [each for each in np.split(vertices, np.flatnonzero(codes == Path.MOVETO)[1:]) if len(each) > 1]


def _told_apart(
    ax: Axes, pieces: list[NDArray[np.float64]], size: tuple[float, float]
) -> tuple[list[NDArray[np.float64]], list[NDArray[np.float64]]]:
    """Lines cut into the parts that run alone, and those with another line, or another part of themselves, beside."""
    if not pieces:
        return [], []
    places = [axes.in_points(ax, piece, size) for piece in pieces]
    along = [np.append(0.0, np.cumsum(np.hypot(*np.diff(place, axis=0).T))) for place in places]
    everywhere = np.concatenate(places)
    line, length = np.repeat(np.arange(len(pieces)), [len(each) for each in pieces]), np.concatenate(along)
    near = np.zeros(len(everywhere), dtype=bool)
    one, two = KDTree(everywhere).query_pairs(_CROWDED, output_type="ndarray").T
    beside_another = (line[one] != line[two]) | (np.abs(length[one] - length[two]) > 3.0 * _CROWDED)
    near[one[beside_another]] = near[two[beside_another]] = True
    parts: tuple[list[NDArray[np.float64]], list[NDArray[np.float64]]] = ([], [])
    for piece, beside in zip(pieces, np.split(near, np.cumsum([len(each) for each in pieces])[:-1]), strict=True):
        cuts = np.flatnonzero(np.diff(beside)) + 1
        for first, last in pairwise([0, *cuts, len(piece)]):
            parts[int(beside[first])].append(piece[first : last + 1])
    return parts


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
        lines = ax.contour(plane.x.values, plane.y.values, shown, levels=levels, colors="white", linewidths=0.7)
        lines.set(zorder=2.5, path_effects=[withStroke(linewidth=1.5, foreground=_SHADOW)])
        lines.set_paths([_long_pieces(ax, path, options.size) for path in lines.get_paths()])
        if not options.names:
            continue
        names = ax.clabel(lines, fmt=_signed(sign), fontsize=7.0 * options.page.scale, inline=False, colors="black")
        _thin_out(ax, names, options.size)
    shadow = [withStroke(linewidth=2.0, foreground=_SHADOW)]
    return [Line2D([], [], color="white", linewidth=1.0, path_effects=shadow, label=r"$\lambda_1$ constant")]


def _signed(sign: float) -> Callable[[float], str]:
    return lambda level: f"{sign * level:g}".replace("-", "\N{MINUS SIGN}")


def _long_pieces(ax: Axes, path: Path, size: tuple[float, float]) -> Path:
    """The pieces of a line that are long enough to be followed by eye."""
    # Not path.to_polygons, which leaves out points that stand out by less than a ninth of a unit, of data here.
    long = [each for each in _pieces(path) if _length(axes.in_points(ax, each, size)) >= _LEAST_LINE]
    return Path.make_compound_path(*map(Path, long)) if long else Path(np.empty((0, 2)))


def _length(line: NDArray[np.float64]) -> float:
    return float(np.hypot(*np.diff(line, axis=0).T).sum())


def _thin_out(ax: Axes, names: Iterable[Text], size: tuple[float, float]) -> None:
    """Take away labels that would stand in another's way or over the frame; give the others a halo."""
    kept: list[NDArray[np.float64]] = []
    width, height = axes.in_points(ax, np.array([[ax.get_xlim()[1], ax.get_ylim()[1]]]), size)[0]
    for name in names:
        at = axes.in_points(ax, np.array([name.get_position()]), size)[0]
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


DRAW: dict[str, Callable[[Axes, xr.Dataset, maps.Plane, maps.Options], list[Artist]]] = {
    "grazing": _grazing,
    "boundaries": _boundaries,
    "isolines": _isolines,
    "curves": curves.draw,
}


def _smooth(values: NDArray[np.float64], width: float) -> NDArray[np.float64]:
    """A Gaussian mean over neighbours that have a value, for the error bars of neighbouring cells not to wrinkle lines.

    Cells with few such neighbours are left out: what is chopped up has no isolines.
    """
    known = np.isfinite(values)
    weight = ndimage.gaussian_filter(known.astype(float), width, mode="nearest")
    total = ndimage.gaussian_filter(np.where(known, values, 0.0), width, mode="nearest")
    return np.where(known & (weight > 0.8), total / np.maximum(weight, 1e-12), np.nan)
