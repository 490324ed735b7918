"""Queries for the stored curves of an atlas, and their table."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from atlas.errors import InputError, check_names
from atlas.orbits.curves.table import KINDS, Curve, Curves, read_curves
from atlas.query.open import handle_of

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


def curves_of(ds: "xr.Dataset") -> Curves:
    """Return the curves in the store of an atlas. Raise InputError if it has none."""
    handle = handle_of(ds)
    curves = read_curves(handle)
    if curves is None:
        raise InputError(f"{handle.backend}: has no curves yet; find them with atlas find curves")
    return curves


def frame(curves: Curves, kind: str | None = None) -> "pd.DataFrame":
    """Return the curves as a table, of one kind or all: one row per point, curve by curve.

    ``unstable`` counts unstable multipliers besides the event's own. A point of codimension two is a row of its own
    kind at its position in the curve, with the orbit and ``unstable`` of the point before it. The attribute ``report``
    is the report on the search.
    """
    import pandas as pd

    if kind is not None:
        check_names("kind of curve", [kind], KINDS)
    rows = [row for k, curve in enumerate(curves) if kind in (None, curve.kind) for row in _rows(k, curve)]
    names = ["curve", "kind", "period", "impacts_upper", "impacts_lower", "symmetric", *curves.axes, "unstable"]
    table = pd.DataFrame(rows, columns=names).astype({"symmetric": bool})
    table.attrs["report"] = dict(curves.report)
    return table


def _rows(number: int, curve: Curve) -> Iterator[tuple[Any, ...]]:
    corners: dict[int, list[Any]] = {}
    for corner in curve.corners:
        corners.setdefault(min(corner.after, len(curve.points) - 1), []).append(corner)
    counts = (column.tolist() for column in (curve.impacts_upper, curve.impacts_lower, curve.unstable))
    for k, ((x, y), upper, lower, unstable) in enumerate(zip(curve.points.tolist(), *counts, strict=True)):
        orbit = (curve.period, upper, lower, curve.symmetric)
        yield (number, curve.kind, *orbit, x, y, unstable)
        for corner in corners.get(k, ()):
            yield (number, corner.kind, *orbit, corner.x, corner.y, unstable)
