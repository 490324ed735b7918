"""The stored curves of an atlas for a user's queries, also as pandas tables."""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from atlas.errors import InputError, check_names
from atlas.orbits.curves.table import KINDS, Curve, Curves, read_curves
from atlas.query.open import handle_of

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


def curves_of(ds: "xr.Dataset") -> Curves:
    """Return the curves that are stored with an atlas, opened as a dataset. Raise InputError if it has none."""
    handle = handle_of(ds)
    curves = read_curves(handle)
    if curves is None:
        raise InputError(f"{handle.backend}: has no curves yet; find them with atlas find curves")
    return curves


class CurveFrames(NamedTuple):
    """Curves as pandas tables.

    points   one row per point, curve by curve, in order along each: number of the curve, its kind, period, impacts and
             symmetry of its orbit, the position, and ``unstable``, the multipliers of modulus above 1 besides the
             critical multipliers; the attribute ``report`` is the report on the search
    corners  one row per point of codimension two: its kind and position, the orbit at the preceding point of its curve,
             and ``point``, the number of that point
    """

    points: "pd.DataFrame"
    corners: "pd.DataFrame"


def to_frames(curves: Curves, kind: str | None = None) -> CurveFrames:
    """Return curves as pandas tables of points and of points of codimension two.

    ``kind`` selects one kind of curve; None selects all. Raise InputError for an unknown kind.
    """
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
                corners.append(rows(number, curve, kinds, at, list(zip(x, y, strict=True))).assign(point=at))
    frames = CurveFrames(
        pd.concat(points, ignore_index=True) if points else pd.DataFrame(columns=columns),
        pd.concat(corners, ignore_index=True) if corners else pd.DataFrame(columns=[*columns, "point"]),
    )
    frames.points.attrs["report"] = dict(curves.report)
    return frames
