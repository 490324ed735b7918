"""Margins of the cells of a store's plane to its stored curves."""

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
    """Return the unit of distance along each axis, x first: the given one, else the width of the plane.

    Along a logarithmic axis the unit is one of the natural logarithm. Raise InputError for an unknown name or a unit
    that is not above 0.
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
    """Return what decides the margins of a plane. Raise InputError if the store has no curves."""
    curves = _curves(handle)
    content = hashlib.sha256(handle.digest.encode())
    for curve in curves:
        content.update(repr((curve.kind, curve.points.tolist(), curve.unstable.tolist())).encode())
    return {"content": content.hexdigest(), "scale": dict(scale)}


def margins_hold(handle: AtlasStore, request: Mapping[str, Any]) -> bool:
    """Return True if the margins of a request are those to the curves that the store has now."""
    try:
        return margin_request(handle, request["scale"]) == request
    except (ChunkError, InputError, KeyError):
        return False


def margins_of(handle: AtlasStore, scale: Mapping[str, float]) -> Arrays:
    """Return the margin of each cell: its distance to the nearest part of a curve at which an attractor begins or ends.

    The margin is unknown for cells with invalid parameters, and if there is no such curve.
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
        raise InputError(f"{handle.backend}: found no curves, which margins need; find them with atlas find curves")
    return curves


def _placed(plane: CurvePlane, values: NDArray[np.float64], scale: Mapping[str, float]) -> NDArray[np.float64]:
    """Return points (N, 2) of the plane in units of the scale."""
    columns = [
        (np.log(column) if log else column) / scale[name]
        for column, name, log in zip(values.T, plane.axes, plane.log, strict=True)
    ]
    return np.stack(columns, axis=1)
