"""Overlays of a map: lines and marks over its cells, as plain data that figures and pages draw alike.

They are the grazing of impact-free motion, borders between regimes, the exact curves of bifurcations and grazes that a
store has, with their ends and their points of codimension two, and over basins the saddles between them.

The orbit of a curve undergoes the curve's bifurcation or graze. A curve is drawn only where this orbit is otherwise
stable, since there it bounds a region with attractors. The rest crosses regions without an effect and is left out.

To add an overlay, add its function and its row in ``OVERLAYS`` here, and its meaning in ``kinds.py``.
"""

from collections.abc import Callable, Mapping

from atlas.errors import InputError
from atlas.orbits.curves import queries
from atlas.query import machine
from atlas.query.open import handle_of
from atlas.query.window import axis_names
from atlas.render.grazing import grazing_lines
from atlas.render.kinds import OverlayError
from atlas.render.layers import MapView, Overlay, OverlayLine
from atlas.render.looks import CORNERS, EVENT_STYLES, LineLook, MarkLook, corner_look
from atlas.render.outlines import simplify_regimes
from atlas.robustness.saddles import saddles_in

Size = tuple[float, float]
"""Width and height of a plane, in points or pixels."""

BOUNDARY = "#101418"
"""Colour of regime boundaries."""


def overlay_of(view: MapView, name: str, size: Size) -> Overlay:
    """Return the overlay ``name`` of a map of ``size`` (width, height). Raise OverlayError if there is none."""
    try:
        return OVERLAYS[name](view, size)
    except InputError as error:
        raise OverlayError(name, str(error)) from None


def _grazing(view: MapView, size: Size) -> Overlay:
    x, y = view.plane.x, view.plane.y
    lines = grazing_lines(view.ds, x, y)
    symmetric = machine.twins_everywhere(view.ds, {x.name: x.values, y.name: y.values})
    label = r"grazing, $|Y| = b$" if symmetric else "impact-free motion\ngrazes a stop"
    none = f"{label}: not in this window"
    look = LineLook(label if lines else none, "#000000", (5, 2), 1.3, "#ffffff", joins=True)
    return Overlay({"grazing": look}, [OverlayLine("grazing", line) for line in lines], none=none)


def _boundaries(view: MapView, size: Size) -> Overlay:
    regions, left_out = simplify_regimes(view.plane.regime, size)
    label = "regime boundary" + (",\nclouds of cells left out" if left_out else "")
    return Overlay({"boundaries": LineLook(label, BOUNDARY, width=0.7)}, regions=regions)


def _curves(view: MapView, size: Size) -> Overlay:
    requested = view.request.curves
    try:
        stored = queries.curves_of(view.ds)
    except InputError as error:
        raise InputError(f"overlay 'curves': {error}") from None
    if stored.axes != axis_names(view.ds):
        axes = ", ".join(axis_names(view.ds))
        raise InputError(f"overlay 'curves': curves over {', '.join(stored.axes)}, found a map of {axes}")
    curves = [curve for curve in stored if requested is None or curve.kind in requested]
    corners = sorted({(corner.kind, corner.x, corner.y) for curve in curves for corner in curve.stable_corners})
    if requested is not None and "codimension_two" not in requested:
        corners = []
    lines = [OverlayLine(curve.kind, points) for curve in curves for points in curve.stable_lines]
    drawn, marked = {line.kind for line in lines}, {kind for kind, *_ in corners}
    looks = {
        kind: LineLook(look.label, look.color, look.dashes, edge="#ffffff")
        for kind, look in EVENT_STYLES.items()
        if kind in drawn
    }
    marks = {kind: corner_look(kind) for kind in sorted(marked, key=[*CORNERS, *sorted(marked)].index)}
    ends = [(curve.kind, *at.tolist()) for curve in curves for at in curve.loose_ends]
    return Overlay(looks, lines, marks, corners, ends, none="curves: none in this window")


def _saddles(view: MapView, size: Size) -> Overlay:
    saddles = saddles_in(view.ds, handle_of(view.ds).spec, (view.plane.x.name, view.plane.y.name))
    mark = MarkLook("saddle: unstable orbit", "X", 7.0, "black", "white", 0.8)
    spots = [("saddle", *at) for states in saddles for at in states.tolist()]
    return Overlay(marks={"saddle": mark}, corners=spots, none="no saddle found between basins")


OVERLAYS: Mapping[str, Callable[[MapView, Size], Overlay]] = {
    "grazing": _grazing,
    "boundaries": _boundaries,
    "curves": _curves,
    "saddles": _saddles,
}
"""For each overlay of a map, the function that makes it."""
