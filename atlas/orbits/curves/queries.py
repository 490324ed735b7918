"""Questions about the stored curves of an atlas, and their table."""

from typing import TYPE_CHECKING

from atlas.errors import InputError, check_names
from atlas.orbits.curves.export import columns, rows
from atlas.orbits.curves.table import KINDS, Curves, read_curves
from atlas.query.open import handle_of

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


def curves_of(ds: "xr.Dataset") -> Curves:
    """The curves that the store of an atlas keeps; InputError where it keeps none."""
    handle = handle_of(ds)
    curves = read_curves(handle)
    if curves is None:
        raise InputError(f"{handle.backend}: has no curves yet; atlas find curves finds them")
    return curves


def frame(curves: Curves, kind: str | None = None) -> "pd.DataFrame":
    """The curves as a table, of one kind or all: a row a point, with the columns of the CSV.

    Points of codimension two are rows of their own kind. Its attribute ``report`` says how the curves were found.
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
