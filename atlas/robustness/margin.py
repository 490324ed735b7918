"""Margins of the cells of a store's plane to the curves that it keeps."""

import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.argument_checks import validate_type
from atlas.errors import ChunkError, InputError, check_names
from atlas.orbits.curves.chords import chords_of, margins
from atlas.orbits.curves.plane import CurvePlane, plane_of
from atlas.orbits.curves.table import KINDS, Curves, read_curves
from atlas.robustness.table import MARGIN, Arrays, empty, of_family
from atlas.spec.axis import number
from atlas.store.store import AtlasStore


def validate_scale(handle: AtlasStore, parameters: Mapping[str, Any] | None) -> dict[str, float]:
    """The unit of distance along each axis, x first: those given, else the width of the plane.

    Along a logarithmic axis it is a unit of the natural logarithm. InputError for a bad name or a unit not above 0.
    """
    plane = plane_of(handle)
    parameters = (
        {}
        if parameters is None
        else validate_type("scale", parameters, Mapping, "units by axis, such as {'omega': 0.1}")
    )
    check_names("axis in scale", parameters, plane.axes)
    units = {}
    for name, log in zip(plane.axes, plane.log, strict=True):
        low, high = (np.log(end) if log else end for end in plane.window[name])
        unit = number(f"scale.{name}", parameters[name]) if name in parameters else float(high - low)
        if unit <= 0.0:
            raise InputError(f"scale.{name}: found {unit:g}, must be above 0")
        units[name] = unit
    return units


def margin_request(handle: AtlasStore, scale: Mapping[str, float]) -> dict[str, Any]:
    """What decides the margins of a plane; InputError if it has no curves."""
    curves = _curves(handle)
    content = hashlib.sha256(handle.digest.encode())
    for curve in curves:
        content.update(repr((curve.kind, curve.points.tolist(), curve.unstable.tolist())).encode())
    return {"content": content.hexdigest(), "scale": dict(scale)}


def margins_hold(handle: AtlasStore, request: Mapping[str, Any]) -> bool:
    """Whether the margins that answer a request are to the curves that the store has now."""
    try:
        return margin_request(handle, request["scale"]) == request
    except (ChunkError, InputError, KeyError):
        return False


def margins_of(handle: AtlasStore, scale: Mapping[str, float]) -> Arrays:
    """The margin of each cell: its distance to the nearest part of a curve along which an attractor begins or ends.

    Not known of cells whose parameters make no sense, and where there is no such curve.
    """
    plane, curves = plane_of(handle), _curves(handle)
    chords = chords_of((_placed(plane, curve.points, scale), curve.is_bounding) for curve in curves)
    valid, count = np.flatnonzero(plane.valid), len(plane.x) * len(plane.y)
    columns = empty(of_family(MARGIN), (count,))
    if len(chords.curve) and len(valid):
        nearest = margins(_placed(plane, plane.values(valid), scale), chords)
        kinds = np.array([KINDS.index(curve.kind) for curve in curves])
        columns["margin"][valid], columns["margin_error"][valid] = nearest.distance, nearest.error
        columns["margin_curve"][valid], columns["margin_kind"][valid] = nearest.curve, kinds[nearest.curve]
    return {name: values.reshape(plane.shape) for name, values in columns.items()}


def _curves(handle: AtlasStore) -> Curves:
    curves = read_curves(handle)
    if curves is None:
        raise InputError(f"{handle.backend}: has no curves to measure margins to; find them with atlas find curves")
    return curves


def _placed(plane: CurvePlane, values: NDArray[np.float64], scale: Mapping[str, float]) -> NDArray[np.float64]:
    """Points (N, 2) of the plane in units of the scale."""
    columns = [
        (np.log(column) if log else column) / scale[name]
        for column, name, log in zip(values.T, plane.axes, plane.log, strict=True)
    ]
    return np.stack(columns, axis=1)
