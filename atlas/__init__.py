"""Impact Atlas: maps of chaos in vibro-impact oscillators.

``Spec`` says what to compute, ``run`` computes it into a store, ``open`` gives the store as an xarray Dataset;
``portrait`` draws the motion of a single cell.
"""

# Imported here and not at first use: the function ``run`` must take its name back from the module of that name.
# None of them loads Dask, Zarr, xarray or Numba before it is called.
from atlas.point import portrait
from atlas.run import run
from atlas.spec import Spec
from atlas.store import open_atlas as open

__all__ = ["Spec", "__version__", "open", "portrait", "run"]


def __getattr__(name: str) -> str:
    """The version of the installed distribution, looked up when asked for."""
    if name == "__version__":
        from importlib.metadata import version

        return version("impact-atlas")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
