"""The maps of classes, each with a colour and an entry in the legend: periods, symmetry, attractors, labels."""

import colorsys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
import xarray as xr
from matplotlib.colors import to_hex, to_rgb
from matplotlib.patches import Patch
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.query import machine
from atlas.query.attractors import branches
from atlas.render import maps, style
from atlas.render.maps import Painted, View
from workers.results import LABEL, NO_IMPACT, PERIODIC

PERIODS: tuple[tuple[int, int | None, str], ...] = (
    (1, 1, style.COLORS[PERIODIC]),
    (2, 2, "#38ad83"),
    (3, 3, "#a467ff"),
    (4, 4, "#06493b"),
    (5, 5, "#5bedff"),
    (6, 6, "#b5a3b7"),
    (7, 8, "#594e6e"),
    (9, 16, "#8faefc"),
    (17, None, "#0314cf"),
)
"""First and last period of each class and its colour, the same in every picture: cool ones, since warm ones are chaos.

Chosen, with the colours of the regimes and of the chaos, for the greatest least difference (CIEDE2000) between any two:
above 20 among periods, above 12 as seen without red, green or blue receptors.
"""

SYMMETRIC, UPPER, LOWER, UNTOLD, ALONE = "#90b8de", "#8a4fd0", "#f0b13c", "#2f3f58", "#4a4ae8"
"""The colours of periodic motions: symmetric; broken with more impacts at the upper stop; at the lower; broken, with
as many; of a machine whose stops, load or force are not symmetric, so that no motion has a mirror image.
"""
SYMMETRIES = {
    SYMMETRIC: "symmetric",
    UPPER: "broken, twin A (more impacts above)",
    LOWER: "broken, twin B (more impacts below)",
    UNTOLD: "broken, as many impacts above as below",
    ALONE: "periodic, of a machine that is not symmetric",
}

COUNTS = {1: "#dfe8ee", 2: "#8fb8d8", 3: "#4a7fb5", 4: "#f0b13c", 5: "#d9622b", 6: "#7a1f5c"}
"""The colour of each number of attractors; the last of all larger ones."""

PALETTE = ("#4477aa", "#e0a83a", "#5fa36a", "#b65c8f", "#7f6bb3", "#c9703f", "#3aa6a6", "#8c7a2e")
"""Colours of the branches of largest share; each also in a darker tone, of its mirror image: as a point on white a
paler one would not be seen.
"""
REST = "#4d4d4d"
"""The colour of all other branches."""
PALER, DARKER = 0.8, 0.25
"""Lightness of the colour of a mirror image, whose hue is that of its twin, on the way from black 0 to white 1."""


Class: TypeAlias = tuple[NDArray[np.bool_], str, str]
"""Cells (y, x), their colour and their name."""


def colored(
    regime: NDArray[np.int8],
    classes: Iterable[Class],
    beside: str | None = None,
    rgba: NDArray[np.uint8] | None = None,
    known: NDArray[np.bool_] | None = None,
) -> Painted:
    """Cells in the colours of their classes, and those of no class in the colours of their regimes.

    ``known`` ones keep the colour that they have in ``rgba`` (y, x, 4).
    """
    rgba = np.zeros((*regime.shape, 4), np.uint8) if rgba is None else rgba
    others, legend = np.ones(regime.shape, bool) if known is None else ~known, []
    for cells, color, name in classes:
        others &= ~cells
        if cells.any():
            rgba[cells] = style.rgb(color)
            legend.append(style.swatch(color, name))
    return Painted(rgba, legend + maps.paint_regimes(rgba, regime, others), beside=beside)


def period(view: View) -> Painted:
    """The forcing periods of each cell's orbit, and the regime where it never closes."""
    return periods(view.plane.regime, view.plane["period"])


def periods(regime: NDArray[np.int8], period: NDArray[np.int32]) -> Painted:
    """The same of arrays (y, x)."""
    counted = (regime == PERIODIC) & (period >= 1)
    most = np.iinfo(np.int32).max
    classes = [
        (counted & (period >= first) & (period <= (last or most)), color, _name_of_period(first, last))
        for first, last, color in PERIODS
    ]
    return colored(regime, classes, beside="")


def _name_of_period(first: int, last: int | None) -> str:
    if last is None:
        return f"period ≥ {first}"
    return f"period {first}" if first == last else f"period {first}–{last}"


def symmetry(view: View) -> Painted:
    """Which periodic motions are their own mirror image, x(t) = -x(t + T/2), and of the others which of two it is.

    A broken one has a twin, which another start reaches. Impact counts tell the two apart unless they are equal, or
    infinite where the mass comes to rest. InputError where no machine of the periodic cells is symmetric.
    """
    plane = view.plane
    counts = plane["impacts_upper"], plane["impacts_lower"]
    return symmetries(plane.regime, plane["symmetric"], *counts, _has_twins(view.ds, plane))


def symmetries(
    regime: NDArray[np.int8],
    symmetric: NDArray[np.bool_],
    upper: NDArray[np.int32],
    lower: NDArray[np.int32],
    twins: NDArray[np.bool_],
) -> Painted:
    """The same of arrays (y, x); ``twins``: where motions have mirror images."""
    periodic = regime == PERIODIC
    own = periodic & symmetric.astype(bool)
    broken = periodic & ~own & twins
    cells = {
        SYMMETRIC: own,
        UPPER: broken & (upper > lower),
        LOWER: broken & (upper < lower),
        UNTOLD: broken & (upper == lower),
        ALONE: periodic & ~own & ~twins,
    }
    return colored(regime, [(cells[color], color, name) for color, name in SYMMETRIES.items()])


def _has_twins(ds: xr.Dataset, plane: maps.Plane) -> NDArray[np.bool_]:
    """In which periodic cells (y, x) motions have mirror images; InputError where there are such cells, but in none."""
    system = machine.known_system(ds, "kind 'symmetry'")
    same = machine.fixed(ds, system)
    periodic = plane.regime == PERIODIC
    found = periodic & plane["symmetric"].astype(bool)  # which proves that its machine is
    rows, columns = np.nonzero(periodic & ~found)
    if not rows.size:
        return found
    points = {plane.x.name: plane.x.values[columns], plane.y.name: plane.y.values[rows]}
    found[rows, columns] = machine.has_twins(system, same, points)
    if not found.any():
        here = {name: float(values[0]) for name, values in points.items()}
        raise InputError(
            f"kind 'symmetry' tells motions from their mirror images, which no motion has here: at "
            f"{', '.join(f'{name} = {value:g}' for name, value in here.items())} "
            f"{machine.why_no_twins(system, same | here)}"
        )
    return found


def attractors(view: View) -> Painted:
    """How many attractors the initial states of each cell have reached.

    A cell of which some initial states are undecided may have more: it is counted by those that are known.
    """
    regime, most = view.plane.regime, max(COUNTS)
    count = np.where(maps.determined(regime), np.rint(view.plane["attractors"]), 0).astype(np.int64)
    names = {1: "1 attractor", most: f"{most} or more"}
    classes = [
        (count >= most if number == most else count == number, color, names.get(number, f"{number} attractors"))
        for number, color in COUNTS.items()
    ]
    return colored(regime, classes, beside="")


def labels(view: View) -> Painted:
    """Which branch the attractor of each cell is on, that with the largest share unless another one was selected.

    A mirror image has a darker tone of its twin's hue; chaos and tori, which have no label, the colour of their regime.
    """
    known, regime = branches(view.ds), view.plane.regime
    label = np.rint(view.plane[LABEL.name]).astype(np.int64)
    table = np.array([style.rgb(color) for color in [*branch_colors(known), "white"]], np.uint8)
    painted = colored(regime, (), "", table[label], label >= 0)
    return replace(painted, legend=[*branch_entries(known, label), *painted.legend])


def colors_of(
    known: xr.Dataset, palette: Sequence[str], mirrored: float, quiet: str, rest: str | None = None
) -> list[str]:
    """The colour of every attractor of a table: that of a mirror image has the hue of its twin's and this lightness,
    that of no impact is ``quiet``.

    Where the palette is used up it begins anew, or ``rest`` is the colour of all others.
    """
    found: list[str] = []
    used = 0
    for k, (regime, mirror) in enumerate(zip(known["regime"].values, known["mirror"].values, strict=True)):
        if regime == NO_IMPACT:
            found.append(quiet)
        elif 0 <= mirror < k:
            found.append(found[mirror] if found[mirror] == rest else _toned(found[mirror], mirrored))
        elif rest is not None and used >= len(palette):
            found.append(rest)
        else:
            found.append(palette[used % len(palette)])
            used += 1
    return found


def _toned(color: str, lightness: float) -> str:
    hue, _, saturation = colorsys.rgb_to_hls(*to_rgb(color))
    return to_hex(colorsys.hls_to_rgb(hue, lightness, saturation))


def branch_colors(known: xr.Dataset, ink: bool = False) -> list[str]:
    """The colour of every branch, by its label; small ones share one. ``ink``: of points on white."""
    quiet = style.INK[NO_IMPACT] if ink else style.COLORS[NO_IMPACT]
    return colors_of(known, PALETTE, DARKER, quiet, REST)


def branch_entries(known: xr.Dataset, label: NDArray[np.int64], ink: bool = False) -> list[Patch]:
    """Legend entries of the branches among these labels."""
    there, own = np.unique(label[label >= 0]), branch_colors(known, ink)
    named = [k for k in there.tolist() if own[k] != REST]
    made = [style.swatch(own[k], f"{k}: {_name_of_branch(known, k)}") for k in named]
    return made + ([style.swatch(REST, f"{len(there) - len(named)} others")] if len(there) > len(named) else [])


def _name_of_branch(known: xr.Dataset, label: int) -> str:
    """A branch in a few words: n-p-q, periods, impacts at either stop; and whose mirror image it is."""
    one = known.isel(branch=label)
    if int(one["regime"]) == NO_IMPACT:
        return style.name_of(NO_IMPACT)
    name = "-".join(str(int(one[each])) for each in ("period", "impacts_upper", "impacts_lower"))
    return name + (f", mirrors {int(one['mirror'])}" if 0 <= int(one["mirror"]) < label else "")
