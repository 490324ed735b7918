"""Queries for the stored curves of an atlas, and their table."""

from typing import TYPE_CHECKING

from atlas.errors import InputError, check_names
from atlas.orbits.curves.export import columns, rows
from atlas.orbits.curves.table import KINDS, Curves, read_curves
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
    """Return the curves as a table, of one kind or all: one row per point, with the columns of the CSV.

    Points of codimension two are rows of their own kind. The attribute ``report`` is the report on the search.
    """
    import pandas as pd

    if kind is not None:
        check_names("kind of curve", [kind], KINDS)
    numbers = {number for number, curve in enumerate(curves) if kind in (None, curve.kind)}
    wanted = [row for row in rows(curves) if row[0] in numbers]
    made = pd.DataFrame(wanted, columns=columns(curves.axes))
    made["symmetric"] = made["symmetric"] == "true"
    made.attrs["report"] = dict(curves.report)
    return made
