"""The cells or attractors of a finished store as columns of results and parameters; rows may be orbits."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import ChunkError, InputError, check_names
from atlas.formatting import plural
from atlas.query.open import open_atlas
from atlas.spec.spec import Spec
from atlas.store.groups import read_group
from atlas.store.store import AtlasStore, done_mask
from atlas.store.tiles import read_tile
from workers import SOLVER_VERSION
from workers.model.system import System

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
Mask = NDArray[np.bool_]

SAME_ORBIT = 1e-6
"""Maximum distance of section states of one orbit, relative to the largest component of any; exact orbits agree to
1e-12.
"""


def are_on_orbit(orbits: Array, states: Array) -> Mask:
    """Return the mask (...) of states (..., n) that are section states of their orbits, which have states (..., q, n).

    The distance from the nearest one must be at most SAME_ORBIT of the orbit's largest component.
    """
    away = np.abs(orbits - states[..., None, :]).max(axis=-1).min(axis=-1)
    return np.asarray(away <= SAME_ORBIT * np.abs(orbits).max(axis=(-2, -1), initial=1e-300))


@dataclass(frozen=True, eq=False, kw_only=True)
class OrbitTable:
    """Cells or attractors of a store, N rows.

    system              system of the store
    axes                names of the axes
    fixed               all other parameters by name
    regime (N,)         regime, as the store has it
    period (N,)         period in forcing periods
    impacts_upper (N,)  impacts at the upper stop
    impacts_lower (N,)  impacts at the lower stop
    symmetric (N,)      mask of orbits that are their own mirror images
    state (N, 2n)       section state
    cycle_period (N,)   periods of cycles, NaN for other motion; None with a force
    """

    system: System
    axes: tuple[str, ...]
    fixed: Mapping[str, float]
    regime: Rows
    period: Rows
    impacts_upper: Rows
    impacts_lower: Rows
    symmetric: Mask
    state: Array
    cycle_period: Array | None = None

    @property
    def proven(self) -> Mask:
        """The mask (N,) of rows with a periodic orbit."""
        raise NotImplementedError

    def values(self, rows: Rows) -> Array:
        """Return the parameters (R, axes) of rows."""
        raise NotImplementedError

    @cached_property
    def kind(self) -> Rows:
        """A number (N,) for each kind of orbit: regime, period, impacts at either stop, symmetry."""
        parts = (self.regime, self.period, self.impacts_upper, self.impacts_lower, self.symmetric)
        return np.unique(np.stack(parts, axis=1), axis=0, return_inverse=True)[1].ravel()


def must_be_finished(handle: AtlasStore) -> None:
    """Raise InputError, with the remedy, if a tile of a store is unfinished."""
    missing = handle.tiling.count - int(done_mask(handle).sum())
    if missing:
        raise InputError(f"{handle.backend}: {plural(missing, 'tile')} unfinished; complete the store with atlas run")


def current_group(
    handle: AtlasStore, group: str, version: int
) -> tuple[dict[str, NDArray[Any]], dict[str, Any]] | None:
    """Return the arrays and the attributes of a group, if written by this version of the method and of the solver.

    Return None if there is no such group, or it is damaged: the group is then computed again.
    """
    try:
        stored = read_group(handle, group)
    except ChunkError:
        return None
    wrote = ("version", version), ("solver_version", SOLVER_VERSION)
    return stored if stored and all(stored[1].get(name) == expected for name, expected in wrote) else None


def columns_of(
    handle: AtlasStore, names: Sequence[str], tile: tuple[int, ...] | None = None
) -> dict[str, NDArray[Any]]:
    """Return results (cells, keep, ...) of a store's cells, or of those of a tile, in C order; keep is 1 for one
    attractor.

    Integers are int64. Raise InputError for a result that the store does not have, and ChunkError if a chunk is missing
    or damaged.
    """
    check_names("result of this atlas", names, [variable.name for variable in handle.variables])
    if tile is None:
        ds = open_atlas(handle)
        arrays = {name: ds[name].values for name in names}
    else:
        arrays = read_tile(handle, tile, names)
    dims, keep = len(handle.spec.shape), int(handle.spec.coexistence)
    wide = {name: values.astype(np.int64) if values.dtype.kind == "i" else values for name, values in arrays.items()}
    return {
        name: values.reshape(-1, *(values.shape[dims : dims + 1] if keep else (1,)), *values.shape[dims + keep :])
        for name, values in wide.items()
    }


def params_of(spec: Spec, slices: tuple[slice, ...] | None = None) -> dict[str, NDArray[np.float64]]:
    """Return the value (cells,) of every parameter in a block of cells, by default in all, in C order."""
    block = tuple(slice(0, n) for n in spec.shape) if slices is None else slices
    return {name: grid.ravel() for name, grid in spec.system_def.complete(spec.cell_params(block)).items()}
