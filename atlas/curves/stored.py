"""The curves that the store of an opened atlas keeps."""

from typing import TYPE_CHECKING

from atlas.curves.table import Curves, read_curves
from atlas.errors import InputError
from atlas.query.window import axis_names
from atlas.store.store import read_header

if TYPE_CHECKING:
    import xarray as xr


def stored_curves(ds: "xr.Dataset") -> Curves:
    """The curves of a plane, or of a part of it, as ``atlas.open`` gave it.

    InputError, which names the command to run, where there are none, and where the atlas is no plane.
    """
    source = ds.encoding.get("source")
    if source is None:
        raise InputError("curves are read from a store, and this dataset does not say which: open it by atlas.open")
    found = read_curves(read_header(source))
    if found is None:
        raise InputError(f"this atlas has no curves yet: compute them by atlas curves {source}")
    if found.axes != axis_names(ds):
        raise InputError(f"curves of the plane {', '.join(found.axes)}, found {', '.join(axis_names(ds))}")
    return found
