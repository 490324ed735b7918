"""Queries for the stored curves of an atlas."""

from typing import TYPE_CHECKING

from atlas.errors import InputError
from atlas.orbits.curves.table import Curves, read_curves
from atlas.query.open import handle_of

if TYPE_CHECKING:
    import xarray as xr


def curves_of(ds: "xr.Dataset") -> Curves:
    """Return the curves in the store of an atlas. Raise InputError if it has none."""
    handle = handle_of(ds)
    curves = read_curves(handle)
    if curves is None:
        raise InputError(f"{handle.backend}: has no curves yet; find them with atlas find curves")
    return curves
