"""Overlays and labels of a map as plain JSON and arrays, for a web page that draws them itself."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.query.plane import Plane
from atlas.render import overlays, style
from atlas.render.coded_maps import described_curves, text_of
from atlas.render.kinds import OverlayError
from atlas.render.label_placement import places
from atlas.render.layers import MapLayers, MapView
from atlas.render.outlines import simplify_regimes

Array = NDArray[np.float64]
Size = tuple[float, float]
"""Width and height of a plane, in pixels."""

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
    try:
        return _OVERLAYS[name](view, size)
    except InputError as error:
        raise OverlayError(name, str(error)) from None


def names_on(layers: MapLayers, plane: Plane, size: Size) -> list[dict[str, Any]]:
    """Return the labels that fit into regions of a map of ``size`` pixels, each with its position, angle and colour."""
    (x, columns), (y, rows) = plane.x.even(), plane.y.even()
    step, even_index = np.array(size[::-1]) / (rows.size, columns.size), np.ix_(rows, columns)
    names = []
    for spot in places([(cells[even_index], name) for cells, name, _ in layers.names], step, NAME_SIZE):
        _, text, under = layers.names[spot.number]
        at = x.values[spot.cell[1]], y.values[spot.cell[0]]
        names.append(_name(text, at, spot.angle, style.ink_on(under)))
    return names


def _name(text: str, at: Iterable[float], angle: float, color: str) -> dict[str, Any]:
    x, y = map(float, at)
    return {"x": x, "y": y, "text": text, "angle": angle, "color": color, "size": NAME_SIZE}


def _grazing(view: MapView, size: Size) -> OverlayLines:
    lines = overlays.lines_of_grazing(view)
    look = {"label": text_of(overlays.grazing_label(view, lines)), "color": "#000000", "dashes": [5, 2], "width": 1.5}
    return _polylines(view.plane, "grazing", look, lines)


def _boundaries(view: MapView, size: Size) -> OverlayLines:
    regions, left_out = simplify_regimes(view.plane.regime, size)
    label = "regime boundary" + (", clouds of cells left out" if left_out else "")
    look = {"label": label, "color": overlays.BOUNDARY, "dashes": [], "edge": overlays.BOUNDARY, "fixed": True}
    return OverlayLines(_described({"boundaries": look}, []), regions.astype(np.uint8))


def _curves(view: MapView, size: Size) -> OverlayLines:
    curves = described_curves(overlays.requested_curves(view, "overlay 'curves'"))
    lines = [
        {"kind": line["kind"], "points": part}
        for line in curves["lines"]
        for part in _parts(view.plane, np.reshape(line["points"], (-1, 2)))
    ]
    low, high = map(np.array, _ends(view.plane))
    inside = {
        name: [mark for mark in curves[name] if np.all((low <= mark[1:]) & (mark[1:] <= high))]
        for name in ("corners", "ends")
    }
    return OverlayLines(curves | inside | {"lines": lines})


def _polylines(plane: Plane, kind: str, style: Mapping[str, Any], lines: Iterable[Array]) -> OverlayLines:
    """Return an overlay of lines that all have one kind and style; its legend has no switch for the kind."""
    parts = [{"kind": kind, "points": part} for line in lines for part in _parts(plane, line)]
    return OverlayLines(_described({kind: {**style, "fixed": True}}, parts))


def _described(looks: Mapping[str, Any], lines: list[dict[str, Any]]) -> dict[str, Any]:
    return {"looks": looks, "lines": lines, "marks": {}, "corners": [], "ends": []}


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


_OVERLAYS: dict[str, Callable[[MapView, Size], OverlayLines]] = {
    "grazing": _grazing,
    "boundaries": _boundaries,
    "curves": _curves,
}
