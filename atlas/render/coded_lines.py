"""Overlays and labels of a map as plain JSON and arrays, for a web page that draws them itself."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.markers import MarkerStyle
from numpy.typing import NDArray

from atlas.query.plane import Plane
from atlas.render.coded_maps import text_of
from atlas.render.kinds import CURVES
from atlas.render.label_placement import place_names
from atlas.render.layers import MapLayers, MapView, Overlay
from atlas.render.looks import LineLook, MarkLook
from atlas.render.overlays import Size, overlay_of

Array = NDArray[np.float64]

NAME_SIZE = 11.5
"""Type size of labels, in pixels."""
_FINE = 1e-7
"""Precision of the points of lines, relative to the width of the plane."""


@dataclass(frozen=True)
class OverlayLines:
    """An overlay of a map, for a web page.

    described  lines, marks and their styles, as plain JSON
    regions    numbers of cells (y, x), between which the page draws borders; None for an overlay of lines
    """

    described: dict[str, Any]
    regions: NDArray[np.uint8] | None = None


def lines_over(view: MapView, name: str, size: Size) -> OverlayLines:
    """Return the overlay ``name`` of a map that is ``size`` (width, height) pixels large.

    Raise OverlayError if the overlay cannot be drawn.
    """
    overlay = overlay_of(view, name, size)
    regions = None if overlay.regions is None else overlay.regions.astype(np.uint8)
    return OverlayLines(_described(view.plane, overlay), regions)


def names_on(layers: MapLayers, plane: Plane, size: Size) -> list[dict[str, Any]]:
    """Return the labels that fit into regions of a map of ``size`` pixels, each with its position, angle and colour."""
    return [{**name._asdict(), "size": NAME_SIZE} for name in place_names(layers.names, plane, size, NAME_SIZE)]


def _described(plane: Plane, overlay: Overlay) -> dict[str, Any]:
    """Return an overlay as plain JSON, only with what lies in the plane."""
    low, high = map(np.array, _ends(plane))

    def visible(spots: Any) -> list[list[Any]]:
        return [list(spot) for spot in spots if np.all((low <= spot[1:]) & (spot[1:] <= high))]

    return {
        "looks": {kind: _line_look(kind, look) for kind, look in overlay.looks.items()},
        "lines": [{"kind": line.kind, "points": part} for line in overlay.lines for part in _parts(plane, line.points)],
        "marks": {kind: _mark_look(look) for kind, look in overlay.marks.items()},
        "corners": visible(overlay.corners),
        "ends": visible(overlay.ends),
    }


def _line_look(kind: str, look: LineLook) -> dict[str, Any]:
    """Return the look of lines; lines whose kind users do not choose among CURVES have no switch in the legend."""
    described: dict[str, Any] = {"label": text_of(look.label), "color": look.color, "dashes": [*look.dashes]}
    return described | ({} if look.edge else {"edge": look.color}) | ({} if kind in CURVES else {"fixed": True})


def _mark_look(look: MarkLook) -> dict[str, Any]:
    """Return the name of a mark and the outline of its marker, in units of the marker's size."""
    marker = MarkerStyle(look.marker)
    shape = marker.get_path().transformed(marker.get_transform()).to_polygons()
    return {"label": look.label, "shape": [np.asarray(part).ravel().round(3).tolist() for part in shape]}


def _ends(plane: Plane) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the lowest and the highest (x, y) of a plane, at the outer edges of its cells."""
    return (plane.x.edges[0], plane.y.edges[0]), (plane.x.edges[-1], plane.y.edges[-1])


def _parts(plane: Plane, line: Array) -> list[list[float]]:
    """Return the parts of a line (N, 2) that lie in the plane, each as a flat list of x and y in turn.

    Each part is extended by one point at either end, and rounded to what is visible.
    """
    low, high = _ends(plane)
    first, last = line[:-1], line[1:]
    seen = np.all((np.maximum(first, last) >= low) & (np.minimum(first, last) <= high), axis=1)
    cuts = np.flatnonzero(np.diff(np.concatenate([[False], seen, [False]]).astype(int)))
    decimals = [int(np.ceil(-np.log10(_FINE * width))) for width in np.subtract(high, low)]
    flat = []
    for begin, end in cuts.reshape(-1, 2).tolist():
        part = line[begin : end + 1]
        flat.append(np.column_stack([np.round(part[:, k], decimals[k]) for k in (0, 1)]).ravel().tolist())
    return flat
