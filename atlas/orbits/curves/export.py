"""The curves of a plane as tables, and their export to a file: CSV or JSON, selected by the suffix."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from atlas.argument_checks import validate_path, validate_suffix
from atlas.errors import check_names
from atlas.orbits.curves.table import KINDS, Curve, Curves
from atlas.query.export import check_writable, replace_on_success

if TYPE_CHECKING:
    import pandas as pd

FORMATS = (".csv", ".json")


def export(curves: Curves, path: str | Path) -> None:
    """Write the curves to a file, completely or not at all.

    CSV has the rows of ``to_frames``, numbers in their shortest exact form: the points, then the points of codimension
    two. JSON has one object, as ``as_json``. Raise InputError for another suffix, and for a path that cannot be
    written.
    """
    target = validate_path(path)
    suffix = check_path(target)
    with replace_on_success(target) as unfinished:
        if suffix == ".csv":
            points, corners = to_frames(curves)
            points.to_csv(unfinished, index=False)
            corners.drop(columns="after").to_csv(unfinished, index=False, header=False, mode="a")
        else:
            unfinished.write_text(json.dumps(as_json(curves), allow_nan=False) + "\n", "utf-8")


def check_path(path: Path) -> str:
    """Return the suffix of a file. Raise InputError unless ``export`` knows it, and the file can be written."""
    suffix = validate_suffix(path, FORMATS)
    check_writable(path)
    return suffix


class CurveFrames(NamedTuple):
    """Curves as tables.

    points   one row per point, curve by curve, in order along each: number of the curve, its kind, period, impacts and
             symmetry of its orbit, the position, and ``unstable``, the multipliers of modulus above 1 besides the
             event's own; the attribute ``report`` is the report on the search
    corners  one row per point of codimension two, with its own kind and position, the orbit at the point of the curve
             that it follows, and the number ``after`` of that point
    """

    points: "pd.DataFrame"
    corners: "pd.DataFrame"


def to_frames(curves: Curves, kind: str | None = None) -> CurveFrames:
    """Return curves as tables, of one kind or all. Raise InputError for an unknown kind."""
    import pandas as pd

    if kind is not None:
        check_names("kind of curve", [kind], KINDS)
    columns = ["curve", "kind", "period", "impacts_upper", "impacts_lower", "symmetric", *curves.axes, "unstable"]
    points, corners = list["pd.DataFrame"](), list["pd.DataFrame"]()

    def rows(number: int, curve: Curve, kinds: Any, at: Any, places: Any) -> "pd.DataFrame":
        upper, lower, unstable = (values[at] for values in (curve.impacts_upper, curve.impacts_lower, curve.unstable))
        orbit = number, kinds, curve.period, upper, lower, curve.symmetric
        return pd.DataFrame(dict(zip(columns, (*orbit, *np.transpose(places), unstable), strict=True)))

    for number, curve in enumerate(curves):
        if kind in (None, curve.kind):
            points.append(rows(number, curve, curve.kind, slice(None), curve.points))
            if curve.corners:
                kinds, x, y, after = zip(*curve.corners, strict=True)
                at = np.minimum(after, len(curve.points) - 1)
                corners.append(rows(number, curve, kinds, at, list(zip(x, y, strict=True))).assign(after=at))
    made = CurveFrames(
        pd.concat(points, ignore_index=True) if points else pd.DataFrame(columns=columns),
        pd.concat(corners, ignore_index=True) if corners else pd.DataFrame(columns=[*columns, "after"]),
    )
    made.points.attrs["report"] = dict(curves.report)
    return made


def as_json(curves: Curves) -> dict[str, Any]:
    """Return the curves as plain values: ``axes``, ``curves`` with their fields by name, and ``report``."""
    return {
        "axes": list(curves.axes),
        "curves": [
            {
                "kind": curve.kind,
                "period": curve.period,
                "impacts_upper": curve.impacts_upper.tolist(),
                "impacts_lower": curve.impacts_lower.tolist(),
                "symmetric": curve.symmetric,
                "ends": list(curve.ends),
                "points": curve.points.tolist(),
                "unstable": curve.unstable.tolist(),
                "corners": [{"kind": corner.kind, "position": [corner.x, corner.y]} for corner in curve.corners],
            }
            for curve in curves
        ],
        "report": dict(curves.report),
    }
