"""Impact Atlas: maps of chaos in vibro-impact oscillators.

``Spec`` says what to compute, ``run`` computes it into a store, ``open`` gives the store as an xarray Dataset.
``extend`` computes a larger or finer one from it, ``verify`` tells whether it is what it says.
"""

# Imported here and not at first use: a function must take its name back from the module of that name.
# None of them loads Dask, Zarr, xarray or Numba before it is called.
from atlas.extend import extend
from atlas.run import run
from atlas.spec import Spec
from atlas.store import open_atlas as open
from atlas.verify import verify

__all__ = ["Spec", "__version__", "extend", "open", "run", "verify"]


def __getattr__(name: str) -> str:
    """The version of the installed distribution, looked up when asked for."""
    if name == "__version__":
        from importlib.metadata import version

        return version("impact-atlas")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
