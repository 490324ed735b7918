"""Two sweeps of one axis together, mostly up and down: where they end on different motions there is hysteresis."""

import json
from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.query.window import axis_names
from atlas.render import axes, maps, style, sweep
from workers.results import ERROR, LARGEST, REGIME, SECTION

COLORS = ("#0a6ebd", "#e8701a")
_SHADE = "#ece9f3"
_COUNTS = ("period", "impacts_upper", "impacts_lower")


def figure(ds: xr.Dataset, against: xr.Dataset) -> Figure:
    """Both sweeps as one figure; InputError unless they have the same axis and share something to draw."""
    _check_same_axis(ds, against)
    atlases = (ds, against)
    names = [name for name in (SECTION.name, LARGEST.name) if all(name in each and each[name].size for each in atlases)]
    if not names:
        raise InputError("kind 'hysteresis' draws 'section' or 'largest', and the two atlases do not both hold either")
    optional = [name for name in (ERROR.name, *_COUNTS, LARGEST.name) if all(name in each for each in atlases)]
    (first, x), (second, _) = (sweep.line(each, [*names, *optional]) for each in atlases)
    differs = differ(first, second)

    def draw(name: str) -> sweep.Panel:
        def panel(ax: Axes, read: xr.Dataset, x: axes.DrawnAxis) -> None:
            _shade(ax, x, differs)
            for number, each in enumerate((first, second)):
                _points(ax, each[name].values, x, number)
            if name == LARGEST.name:
                ax.axhline(0.0, color="black", linewidth=0.7, zorder=1)
            ax.set_ylabel(sweep.state_label(ds) if name == SECTION.name else sweep.LARGEST_LABEL)

        return panel

    with rc_context(style.STYLE):
        return sweep.stack(ds, first, x, {name: draw(name) for name in names}, _legend(atlases, x, bool(differs.any())))


def differ(first: xr.Dataset, second: xr.Dataset) -> NDArray[np.bool_]:
    """Where two sweeps end on different motions: of another regime, period or impact counts, or of exponents that
    differ by more than four of their errors. Cells whose motion is not known in both count as equal.
    """
    one, two = first[REGIME.name].values, second[REGIME.name].values
    known = maps.determined(one) & maps.determined(two)
    unlike = one != two
    for name in _COUNTS:
        if name in first:
            unlike |= first[name].values != second[name].values
    if LARGEST.name in first and ERROR.name in first:
        distance = np.abs(first[LARGEST.name].values - second[LARGEST.name].values)
        errors = np.hypot(first[ERROR.name].values, second[ERROR.name].values)
        unlike |= distance > 4.0 * errors + 1e-9
    return np.asarray(known & unlike)


def _check_same_axis(ds: xr.Dataset, against: xr.Dataset) -> None:
    (name,), others = axis_names(ds), axis_names(against)
    if others != (name,):
        raise InputError(f"the atlases have different axes: {name} and {', '.join(others)}")
    one, two = np.sort(ds[name].values), np.sort(against[name].values)
    if one.shape != two.shape or np.any(one != two):
        raise InputError(
            f"the atlases have different points on {name}: {one.size} from {one[0]:g} to {one[-1]:g}, "
            f"and {two.size} from {two[0]:g} to {two[-1]:g}"
        )
    scalars = [
        str(key) for key in ds.coords if ds[key].ndim == 0 and ds[key].dtype.kind == "f" and key in against.coords
    ]
    for key in scalars:
        if float(ds[key]) != float(against[key]):
            raise InputError(f"the atlases differ in {key}: {float(ds[key]):g} and {float(against[key]):g}")


def _points(ax: Axes, values: NDArray[np.float64], x: axes.DrawnAxis, number: int) -> None:
    values = values[..., 0] if values.ndim == 3 else values[:, None]
    at = np.broadcast_to(x.values[:, None], values.shape)
    shown = np.isfinite(values)
    # The second on top and smaller, so that both are seen where they agree.
    size = sweep.point_size(x, 2.0) * (1.5, 0.8)[number]
    ax.plot(
        at[shown],
        values[shown],
        ".",
        color=COLORS[number],
        alpha=(0.55, 1.0)[number],
        markersize=size,
        markeredgewidth=0,
        zorder=2 + number,
        rasterized=True,
    )


def _shade(ax: Axes, x: axes.DrawnAxis, differs: NDArray[np.bool_]) -> None:
    change = np.diff(np.pad(differs, 1).astype(np.int8))
    for low, high in zip(np.flatnonzero(change == 1), np.flatnonzero(change == -1), strict=True):
        ax.axvspan(x.edges[low], x.edges[high], color=_SHADE, linewidth=0, zorder=0)


def _legend(atlases: Sequence[xr.Dataset], x: axes.DrawnAxis, differ_somewhere: bool) -> list[Artist]:
    entries: list[Artist] = [
        Line2D([], [], linestyle="", marker="o", markersize=(6, 3.5)[i], color=color, label=_direction(each, x.name))
        for i, (each, color) in enumerate(zip(atlases, COLORS, strict=True))
    ]
    return (
        [*entries, Patch(facecolor=_SHADE, edgecolor="#a9a4b8", linewidth=0.4, label="different motions")]
        if differ_somewhere
        else entries
    )


def _direction(ds: xr.Dataset, name: str) -> str:
    try:
        (found,) = (axis.get("continuation") for axis in json.loads(ds.attrs["spec"])["axes"] if axis["name"] == name)
    except (KeyError, TypeError, ValueError):
        found = None
    symbol = style.symbol(ds, name)
    return {"forward": f"rising ${symbol}$", "backward": f"falling ${symbol}$"}.get(
        str(found), "each cell from its own start"
    )
