"""The curves of a plane as a file that other programs read: CSV or JSON, chosen by the suffix."""

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
    """Write the curves to a file; it appears whole or not at all.

    CSV: one row a point, curve by curve, numbers in their shortest exact form: the columns of ``columns``; a point of
    codimension two is a row of its own kind at its place in the curve. JSON: one object, as ``as_json``.
    Raises InputError for another suffix and for a path that cannot be written.
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
    """The suffix of a file; InputError unless ``export`` knows it, and the file can be written."""
    suffix = validate_suffix(path, FORMATS)
    check_writable(path)
    return suffix


def columns(axes: tuple[str, str]) -> list[str]:
    """The columns of the CSV; ``unstable`` counts unstable multipliers besides the event's own."""
    return ["curve", "kind", "period", "impacts_upper", "impacts_lower", "symmetric", *axes, "unstable"]


def rows(curves: Curves) -> Iterator[tuple[Any, ...]]:
    """The rows of the CSV; a point of codimension two has the orbit and ``unstable`` of the point before it."""
    for number, curve in enumerate(curves):
        corners, symmetric = _placed(curve), str(curve.symmetric).lower()
        counts = (column.tolist() for column in (curve.impacts_upper, curve.impacts_lower, curve.unstable))
        for k, ((x, y), upper, lower, unstable) in enumerate(zip(curve.points.tolist(), *counts, strict=True)):
            orbit = (curve.period, upper, lower, symmetric)
            yield (number, curve.kind, *orbit, x, y, unstable)
            for corner in corners.get(k, ()):
                yield (number, corner.kind, *orbit, corner.x, corner.y, unstable)


def as_json(curves: Curves) -> dict[str, Any]:
    """The curves as plain values: ``axes``, ``curves`` with their fields by name, and ``report``."""
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
    """The points of codimension two by the point of the curve that they follow."""
    corners_after: dict[int, list[Any]] = {}
    for corner in curve.corners:
        corners_after.setdefault(min(corner.after, len(curve.points) - 1), []).append(corner)
    return corners_after
