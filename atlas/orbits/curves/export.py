"""Export of the curves of a plane to a file for other programs: CSV or JSON, selected by the suffix."""

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from atlas.argument_checks import validate_path, validate_suffix
from atlas.orbits.curves.table import Curve, Curves
from atlas.query.export import check_writable, replace_on_success

FORMATS = (".csv", ".json")


def export(curves: Curves, path: str | Path) -> None:
    """Write the curves to a file, completely or not at all.

    CSV has one row per point, curve by curve, with the columns of ``columns`` and numbers in their shortest exact form.
    A point of codimension two is a row of its own kind at its position in the curve. JSON has one object, as
    ``as_json``. Raise InputError for another suffix, and for a path that cannot be written.
    """
    target = validate_path(path)
    suffix = check_path(target)
    with replace_on_success(target) as unfinished, unfinished.open("w", newline="", encoding="utf-8") as file:
        if suffix == ".csv":
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns(curves.axes))
            writer.writerows(rows(curves))
        else:
            json.dump(as_json(curves), file, allow_nan=False)
            file.write("\n")


def check_path(path: Path) -> str:
    """Return the suffix of a file. Raise InputError unless ``export`` knows it, and the file can be written."""
    suffix = validate_suffix(path, FORMATS)
    check_writable(path)
    return suffix


def columns(axes: tuple[str, str]) -> list[str]:
    """Return the columns of the CSV; ``unstable`` counts unstable multipliers besides the event's own."""
    return ["curve", "kind", "period", "impacts_upper", "impacts_lower", "symmetric", *axes, "unstable"]


def rows(curves: Curves) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of the CSV; a point of codimension two has the orbit and ``unstable`` of the point before it."""
    for number, curve in enumerate(curves):
        corners, symmetric = _placed(curve), str(curve.symmetric).lower()
        counts = (column.tolist() for column in (curve.impacts_upper, curve.impacts_lower, curve.unstable))
        for k, ((x, y), upper, lower, unstable) in enumerate(zip(curve.points.tolist(), *counts, strict=True)):
            orbit = (curve.period, upper, lower, symmetric)
            yield (number, curve.kind, *orbit, x, y, unstable)
            for corner in corners.get(k, ()):
                yield (number, corner.kind, *orbit, corner.x, corner.y, unstable)


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


def _placed(curve: Curve) -> dict[int, list[Any]]:
    """Return the points of codimension two by the index of the curve's point that they follow."""
    corners_after: dict[int, list[Any]] = {}
    for corner in curve.corners:
        corners_after.setdefault(min(corner.after, len(curve.points) - 1), []).append(corner)
    return corners_after
