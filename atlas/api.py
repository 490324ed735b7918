"""What ``import atlas`` offers, put together from the packages below it. The package loads this at first use."""

import os
from typing import TYPE_CHECKING

from atlas import errors
from atlas.cell.point import point
from atlas.check.verify import verify
from atlas.curves.settings import CurveSettings
from atlas.query.open import open_atlas
from atlas.render import portrait
from atlas.service.curves import find_curves
from atlas.service.extend import extend
from atlas.service.options import RunOptions
from atlas.service.pack import pack
from atlas.service.run import run
from atlas.spec.spec import Spec
from atlas.task.retry import Retry
from workers import Settings

if TYPE_CHECKING:
    import xarray

__all__ = [
    "CurveSettings",
    "Retry",
    "RunOptions",
    "Settings",
    "Spec",
    "errors",
    "extend",
    "find_curves",
    "open",
    "pack",
    "point",
    "portrait",
    "run",
    "verify",
]


def open(store: str | os.PathLike[str]) -> "xarray.Dataset":
    """The atlas of a store as an xarray Dataset, read from disk as it is used; ``ds.atlas`` is its accessor.

    The store is a folder, a URL, or a zip file that ``pack`` made.
    Raises atlas.errors.InputError where the store is not an atlas.
    """
    import atlas.accessor  # noqa: F401  registers it

    return open_atlas(store)
