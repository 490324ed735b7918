"""Export of the curves of a plane to a file for other programs: CSV or JSON, selected by the suffix."""

import json
from pathlib import Path

import numpy as np

from atlas.argument_checks import validate_path
from atlas.orbits.curves.queries import to_frames
from atlas.orbits.curves.table import Curves
from atlas.query.export import check_target, replace_on_success, write_table

FORMATS = (".csv", ".json")


def export(curves: Curves, path: str | Path) -> None:
    """Write the curves to a file, completely or not at all.

    CSV has the points, then the points of codimension two, as in ``atlas.orbits.curves.queries.to_frames``, with
    numbers in their shortest exact form. JSON has one object: ``axes``, ``curves`` with the fields of ``Curve`` and of
    ``CodimTwoPoint`` by name, and ``report``. Raise InputError for another suffix, and for a path that cannot be
    written.
    """
    target = validate_path(path)
    if check_target(target, FORMATS) == ".csv":
        import pandas as pd

        points, corners = to_frames(curves)
        write_table(target, pd.concat([points, corners.drop(columns="point")]) if len(corners) else points)
        return
    listed = [{**vars(curve), "corners": [corner._asdict() for corner in curve.corners]} for curve in curves]
    content = {"axes": curves.axes, "curves": listed, "report": dict(curves.report)}
    with replace_on_success(target) as unfinished:
        unfinished.write_text(json.dumps(content, allow_nan=False, default=np.ndarray.tolist) + "\n", encoding="utf-8")
