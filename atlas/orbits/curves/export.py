"""Export of the curves of a plane to a file for other programs: CSV or JSON, selected by the suffix."""

import json
from pathlib import Path
from typing import Any

from atlas.argument_checks import validate_path
from atlas.orbits.curves.queries import to_frames
from atlas.orbits.curves.table import Curves
from atlas.query.export import check_target, replace_on_success, write_table

FORMATS = (".csv", ".json")


def export(curves: Curves, path: str | Path) -> None:
    """Write the curves to a file, completely or not at all.

    CSV has the points, then the points of codimension two, as in ``atlas.orbits.curves.queries.to_frames``, with
    numbers in their shortest exact form. JSON has one object, as ``as_json``. Raise InputError for another suffix, and
    for a path that cannot be written.
    """
    target = validate_path(path)
    if check_target(target, FORMATS) == ".csv":
        import pandas as pd

        points, corners = to_frames(curves)
        write_table(target, pd.concat([points, corners.drop(columns="point")]) if len(corners) else points)
        return
    with replace_on_success(target) as unfinished:
        unfinished.write_text(json.dumps(as_json(curves), allow_nan=False) + "\n", encoding="utf-8")


def as_json(curves: Curves) -> dict[str, Any]:
    """Return the curves as dicts and lists for JSON: ``axes``, ``curves`` with their fields by name, and ``report``."""
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
