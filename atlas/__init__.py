"""Impact Atlas: maps of chaos in vibro-impact oscillators.

``Spec`` says what to compute, ``run`` computes it into a store, ``open`` gives the store as an xarray Dataset, whose
``.atlas`` answers questions and draws; ``portrait`` draws the motion of a single cell.
``extend`` computes a larger or finer atlas from it, ``verify`` checks that it is complete and sound, ``pack`` makes it
one file. ``RunOptions``
says where and how a run computes.
"""

import os
from typing import TYPE_CHECKING

from atlas.check.verify import verify
from atlas.query.open import open_atlas
from atlas.render import portrait

# Imported here and not at first use: a function must replace the module of its name as attribute of the package.
# None of them loads Dask, Zarr, xarray or Numba before it is called.
from atlas.service.extend import extend
from atlas.service.options import RunOptions
from atlas.service.pack import pack
from atlas.service.run import run
from atlas.spec.spec import Spec

if TYPE_CHECKING:
    import xarray

__all__ = ["RunOptions", "Spec", "__version__", "extend", "open", "pack", "portrait", "run", "verify"]


def open(store: str | os.PathLike[str]) -> "xarray.Dataset":
    """The atlas of a store as an xarray Dataset, read from disk as it is used; ``ds.atlas`` is its accessor.

    Raises atlas.errors.InputError where the store is not an atlas.
    """
    import atlas.accessor  # noqa: F401  registers it

    return open_atlas(store)


def __getattr__(name: str) -> str:
    """The version of the installed distribution, looked up when asked for."""
    if name == "__version__":
        from importlib.metadata import version

        return version("impact-atlas")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
