"""The symmetry map: which periodic motions are symmetric, and of the others which of two mirror images it is."""

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.query import machine
from atlas.render import maps, overlays, style
from workers.results import PERIODIC

SYMMETRIC, UPPER, LOWER, UNTOLD, ALONE = "#90b8de", "#8a4fd0", "#f0b13c", "#2f3f58", "#4a4ae8"
"""The colours: symmetric; broken with more impacts at the upper stop; at the lower; broken, and it cannot be told;
periodic where stops, load or force are not symmetric, so that no motion has a mirror image.
"""

NAMES = {
    SYMMETRIC: "symmetric",
    UPPER: "broken, twin A (more impacts above)",
    LOWER: "broken, twin B (more impacts below)",
    UNTOLD: "broken, as many impacts above as below",
    ALONE: "periodic, of a machine that is not symmetric",
}


def figure(ds: xr.Dataset, options: maps.Options = maps.PLAIN) -> Figure:
    """The symmetry map as a figure; InputError where the atlas does not hold what it needs, or where no machine of its
    periodic cells is symmetric.

    Symmetric: the motion is its own mirror image, x(t) = -x(t + T/2). A broken one has a twin, which another start
    reaches. Impact counts tell the two apart unless they are equal, or infinite where the mass comes to rest.
    """
    plane = overlays.read(ds, ["symmetric", "impacts_upper", "impacts_lower"], "symmetry", options)
    twins = _has_twins(ds, plane)
    with options.page.context():
        drawn, ax = maps.frame(ds, options.page)
        rgba, legend = paint(plane.regime, plane["symmetric"], plane["impacts_upper"], plane["impacts_lower"], twins)
        maps.draw(ax, plane, rgba, options)
        entries: list[Artist] = [*legend, *overlays.draw(ax, ds, plane, options)]
        options.page.legend(drawn, entries)
    return drawn


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


def paint(
    regime: NDArray[np.int8],
    symmetric: NDArray[np.bool_],
    upper: NDArray[np.int32],
    lower: NDArray[np.int32],
    twins: NDArray[np.bool_],
) -> tuple[NDArray[np.uint8], list[Patch]]:
    """The colour of every cell, (y, x, 4) in bytes, and legend entries for the classes present.

    ``twins``: where motions have mirror images.
    """
    rgba = np.zeros((*regime.shape, 4), dtype=np.uint8)
    periodic = regime == PERIODIC
    broken = periodic & ~symmetric.astype(bool) & twins
    classes = {
        SYMMETRIC: periodic & symmetric.astype(bool),
        UPPER: broken & (upper > lower),
        LOWER: broken & (upper < lower),
        UNTOLD: broken & (upper == lower),
        ALONE: periodic & ~symmetric.astype(bool) & ~twins,
    }
    legend = []
    for color, cells in classes.items():
        if cells.any():
            rgba[cells] = style.rgb(color)
            legend.append(style.swatch(color, NAMES[color]))
    return rgba, legend + maps.paint_regimes(rgba, regime, ~periodic)
