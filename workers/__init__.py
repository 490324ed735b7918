"""The numerics of impact-atlas, run by Dask's workers; depends on numpy, scipy and numba only.

``solve_tile`` computes results over arrays of parameters, ``trace`` the history of one motion. Both take the name of a
packaged system, or a ``System`` made by ``System.from_toml``.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from workers.settings import Settings

if TYPE_CHECKING:
    from workers.history import trace
    from workers.model.system import System
    from workers.tile import solve_tile

SOLVER_VERSION = 14
"""Version of the solver, raised whenever a number of ``solve_tile`` may change."""

__all__ = ["SOLVER_VERSION", "Settings", "System", "solve_tile", "trace"]

_HOMES = {"solve_tile": "workers.tile", "trace": "workers.history", "System": "workers.model.system"}


def __getattr__(name: str) -> Any:
    """Return a public name of the package, imported at its first use: importing ``Settings`` does not wait for numba.

    Raise AttributeError for any other name.
    """
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
