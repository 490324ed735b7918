"""Two sweeps of one axis together, mostly up and down: where they end on different motions there is hysteresis.

A different orbit is shaded; a mirror image of the same orbit, x(t) and -x(t + T/2), in a paler shade. The rule is in
``compare``.
"""

import json
from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from atlas.branches.table import Branches
from atlas.errors import InputError
from atlas.query.window import axis_names
from atlas.render import axes, machine, maps, style, sweep
from atlas.render.page import STANDARD, Page
from workers.results import ERROR, LARGEST, NO_IMPACT, PERIODIC, REGIME, SECTION

COLORS = ("#0a6ebd", "#e8701a")
_COUNTS = ("period", "impacts_upper", "impacts_lower")
_INVARIANT = ("symmetric", "impacts_per_period", "min_impact_speed", "stuck_fraction")
"""Results that two mirror images of one orbit share, besides their exponents."""

SAME, MIRRORED, DIFFERENT = range(3)
"""What two cells may be to each other."""

SHADES = {MIRRORED: "#f0eedd", DIFFERENT: "#d6cdea"}

_ORBIT_TOLERANCE = 1e-6
"""Distance between section states of one orbit, in parts of the extent of all of them; exact orbits agree to 1e-12."""
_APART = 0.5
"""Kolmogorov-Smirnov distance of section values from which two motions that do not close are held for different."""
_LEAST_SAMPLES = 16


def figure(ds: xr.Dataset, against: xr.Dataset, page: Page = STANDARD, branches: Branches | None = None) -> Figure:
    """Both sweeps as one figure; InputError unless they have the same axis and share something to draw."""
    _check_same_axis(ds, against)
    atlases = (ds, against)
    names = [name for name in (SECTION.name, LARGEST.name) if all(name in each and each[name].size for each in atlases)]
    if not names:
        raise InputError("kind 'hysteresis' draws 'section' or 'largest', and the two atlases do not both hold either")
    wanted = (ERROR.name, LARGEST.name, SECTION.name, "state", *_COUNTS, *_INVARIANT)
    optional = [name for name in wanted if all(name in each for each in atlases)]
    (first, x), (second, _) = (sweep.line(each, [*names, *optional]) for each in atlases)
    found = compare(first, second)

    def draw(name: str) -> sweep.Panel:
        def panel(ax: Axes, read: xr.Dataset, x: axes.DrawnAxis, page: Page) -> None:
            _shade(ax, x, found)
            for number, each in enumerate((first, second)):
                values = machine.gap_values(each, x.name, each[name]) if name == SECTION.name else each[name].values
                _points(ax, values, x, number, page)
            if name == LARGEST.name:
                ax.axhline(0.0, color="black", linewidth=0.7, zorder=1)
            ax.set_ylabel(machine.gap_label(ds) if name == SECTION.name else sweep.LARGEST_LABEL)

        return panel

    with page.context():
        panels = {name: draw(name) for name in names}
        return sweep.stack(ds, first, x, panels, _legend(atlases, x, found), page, branches)


def compare(first: xr.Dataset, second: xr.Dataset) -> NDArray[np.int8]:
    """What the motions of two sweeps are to each other, cell by cell: SAME, MIRRORED or DIFFERENT.

    Motions of another regime are DIFFERENT, and so are those whose largest exponents differ by more than four of their
    errors. Orbits that close are the SAME if their section states are; they are MIRRORED, one the other's x(t) and
    -x(t + T/2), if neither is symmetric in itself, the impacts at one stop of the one are those at the other stop of
    the other, and the exponents, the slowest impact and the time at rest agree. Without section samples, orbits of
    several periods are compared by these numbers alone. Motions that do not close are compared as samples: where
    section values are distributed otherwise (Kolmogorov-Smirnov distance above 1/2 in any component, from 16 samples
    on) but exponents agree, they are held for MIRRORED. Where the machine is not symmetric, or not known, what would be
    MIRRORED is DIFFERENT. A cell whose motion is not known in both counts as SAME.
    """
    one, two = first[REGIME.name].values, second[REGIME.name].values
    known = maps.determined(one) & maps.determined(two)
    unlike = (one != two) | _exponents_differ(first, second)
    closed = (one == PERIODIC) & (two == PERIODIC)
    straight, swapped, shared = (np.ones(one.shape, bool) for _ in range(3))
    for name, other in zip(_COUNTS, (_COUNTS[0], _COUNTS[2], _COUNTS[1]), strict=True):
        if name in first and other in second:
            straight &= first[name].values == second[name].values
            swapped &= first[name].values == second[other].values
    for name in _INVARIANT:
        if name in first:
            shared &= np.isclose(first[name].values, second[name].values, rtol=1e-6, atol=1e-9, equal_nan=True)
    broken = ~first["symmetric"].values if "symmetric" in first else np.ones(one.shape, bool)
    apart = _sections_apart(first, second, closed)
    same = ~unlike & ~apart & (straight | ~closed)
    mirrored = ~unlike & ~same & np.where(closed, swapped & shared & broken, one != NO_IMPACT) & _has_twins(first)
    return np.where(~known | same, SAME, np.where(mirrored, MIRRORED, DIFFERENT)).astype(np.int8)


def _has_twins(ds: xr.Dataset) -> NDArray[np.bool_]:
    """In which cells of a sweep motions have mirror images."""
    system, (name,) = style.system_of(ds), axis_names(ds)
    if system is None:
        return np.zeros(ds[REGIME.name].shape, bool)
    values = np.asarray(ds[name].values, dtype=np.float64)
    return machine.has_twins(system, machine.fixed(ds, system), {name: values})


def _exponents_differ(first: xr.Dataset, second: xr.Dataset) -> NDArray[np.bool_]:
    if LARGEST.name not in first or ERROR.name not in first:
        return np.zeros(first[REGIME.name].shape, bool)
    one, two = first[LARGEST.name].values, second[LARGEST.name].values
    errors = np.hypot(first[ERROR.name].values, second[ERROR.name].values)
    with np.errstate(invalid="ignore"):  # two that are -inf are equal
        return np.asarray((one != two) & (np.abs(one - two) > 4.0 * errors + 1e-9))


def _sections_apart(first: xr.Dataset, second: xr.Dataset, closed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Where the section states of two motions are not those of one motion, as far as they are stored."""
    apart = np.zeros(closed.shape, bool)
    both = (first, second)
    if all(SECTION.name in each and each[SECTION.name].size for each in both):
        samples = [each[SECTION.name].values for each in both]
    elif "state" in first:
        samples = [each["state"].values[:, None] for each in both]
    else:
        return apart
    periods = first["period"].values if "period" in first else np.full(closed.shape, samples[0].shape[1])
    everything = np.concatenate([each.reshape(-1, each.shape[-1]) for each in samples])
    finite = everything[np.isfinite(everything).all(axis=1)]
    scale = np.ptp(finite, axis=0).max() if finite.size else 1.0
    for i in range(closed.size):
        one, two = (each[i][np.isfinite(each[i]).all(axis=-1)] for each in samples)
        if closed[i] and min(len(one), len(two)) >= periods[i] > 0:
            distance = np.abs(one[-periods[i] :, None] - two[-periods[i] :][None]).max(axis=-1)
            apart[i] = max(distance.min(axis=0).max(), distance.min(axis=1).max()) > _ORBIT_TOLERANCE * max(
                scale, 1e-12
            )
        elif not closed[i] and min(len(one), len(two)) >= _LEAST_SAMPLES:
            apart[i] = any(_distance(a, b) > _APART for a, b in zip(one.T, two.T, strict=True))
    return apart


def _distance(one: NDArray[np.float64], two: NDArray[np.float64]) -> float:
    """The Kolmogorov-Smirnov distance of two samples: the greatest one between their distribution functions."""
    at = np.concatenate([one, two])
    ranks = [np.searchsorted(np.sort(each), at, side="right") / each.size for each in (one, two)]
    return float(np.abs(ranks[0] - ranks[1]).max())


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


def _points(ax: Axes, values: NDArray[np.float64], x: axes.DrawnAxis, number: int, page: Page) -> None:
    values = values if values.ndim == 2 else values[:, None]
    at = np.broadcast_to(x.values[:, None], values.shape)
    shown = np.isfinite(values)
    # The second on top and smaller, so that both are seen where they agree.
    size = sweep.point_size(x, 2.0, page) * (1.5, 0.8)[number]
    ax.plot(
        at[shown],
        values[shown],
        ".",
        color=COLORS[number],
        markersize=size,
        markeredgewidth=0,
        zorder=2 + number,
        rasterized=True,
    )


def _shade(ax: Axes, x: axes.DrawnAxis, found: NDArray[np.int8]) -> None:
    for what, color in SHADES.items():
        change = np.diff(np.pad(found == what, 1).astype(np.int8))
        for low, high in zip(np.flatnonzero(change == 1), np.flatnonzero(change == -1), strict=True):
            ax.axvspan(x.edges[low], x.edges[high], color=color, linewidth=0, zorder=0)


def _legend(atlases: Sequence[xr.Dataset], x: axes.DrawnAxis, found: NDArray[np.int8]) -> list[Artist]:
    entries: list[Artist] = [
        Line2D([], [], linestyle="", marker="o", markersize=(6, 3.5)[i], color=color, label=_direction(each, x.name))
        for i, (each, color) in enumerate(zip(atlases, COLORS, strict=True))
    ]
    names = {MIRRORED: "mirror images", DIFFERENT: "different motions"}
    shades = [(SHADES[what], name) for what, name in names.items() if np.any(found == what)]
    return entries + [Patch(facecolor=color, edgecolor="#a9a4b8", linewidth=0.4, label=name) for color, name in shades]


def _direction(ds: xr.Dataset, name: str) -> str:
    try:
        (found,) = (axis.get("continuation") for axis in json.loads(ds.attrs["spec"])["axes"] if axis["name"] == name)
    except (KeyError, TypeError, ValueError):
        found = None
    symbol = style.symbol(ds, name)
    return {"forward": f"rising ${symbol}$", "backward": f"falling ${symbol}$"}.get(
        str(found), "each cell from its own start"
    )
