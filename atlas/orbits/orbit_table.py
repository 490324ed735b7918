"""The results of a finished store as columns, one row for each cell or attractor; orbits are found from them."""

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
"""Tolerance for identifying section states, relative to the largest component of any state of the orbit.

Section states are the states once per forcing period, or per passage of a section. Exact orbits agree to 1e-12.
"""


def are_on_orbit(orbits: Array, states: Array) -> Mask:
    """Return the mask (...) of states that lie on an orbit.

    orbits (..., q, n)  section states of the orbits: once per forcing period, or per passage of a section
    states (..., n)     state to be tested for each orbit

    The distance from the nearest section state must be at most SAME_ORBIT of the orbit's largest component.
    """
    away = np.abs(orbits - states[..., None, :]).max(axis=-1).min(axis=-1)
    return np.asarray(away <= SAME_ORBIT * np.abs(orbits).max(axis=(-2, -1), initial=1e-300))


@dataclass(frozen=True, eq=False, kw_only=True)
class OrbitTable:
    """Results of the cells or attractors of a store as columns with N rows; base class.

    system              system of the store
    axes                names of the axes
    fixed               all other parameters by name
    regime (N,)         regime, as the store has it
    period (N,)         period in forcing periods
    impacts_upper (N,)  impacts at the upper stop
    impacts_lower (N,)  impacts at the lower stop
    symmetric (N,)      mask of orbits that are their own mirror images
    state (N, 2n)       state at the start of a forcing period, or at a section of a motion without a force
    cycle_period (N,)   periods of limit cycles, NaN for other motion; None with a force
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
        """The mask (N,) of rows with a known periodic orbit."""
        raise NotImplementedError

    def values(self, rows: Rows) -> Array:
        """Return the axes' parameters (R, axes) of the given R rows."""
        raise NotImplementedError

    @cached_property
    def kind(self) -> Rows:
        """A number (N,) for each row's kind of orbit. Equal numbers mean equal regime, period, impacts and symmetry."""
        parts = (self.regime, self.period, self.impacts_upper, self.impacts_lower, self.symmetric)
        return np.unique(np.stack(parts, axis=1), axis=0, return_inverse=True)[1].ravel()


def must_be_finished(handle: AtlasStore) -> None:
    """Raise InputError, with the command that completes the store, if a tile of the store is unfinished."""
    missing = handle.tiling.count - int(done_mask(handle).sum())
    if missing:
        raise InputError(f"{handle.backend}: {plural(missing, 'tile')} unfinished; complete the store with atlas run")


def current_group(
    handle: AtlasStore, group: str, version: int
) -> tuple[dict[str, NDArray[Any]], dict[str, Any]] | None:
    """Return the arrays and the attributes of a group if this version of the method and of the solver wrote it.

    handle   the store
    group    name of the group
    version  version of the method, as stored in the group

    Return None if there is no such group, another version wrote it, or it is damaged. The group is then computed again.
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
    """Return the named results (cells, keep, ...) of a store's cells, or of the cells of a tile, in C order.

    ``keep`` is the number of attractors stored per cell; 1 in an atlas of one attractor per cell. Integers are int64.
    Raise InputError for a result that the store does not have, and ChunkError if a chunk is missing or damaged.
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
    """Return the value (cells,) of every parameter in the cells of a block, in C order.

    ``slices`` selects the block along each dimension; None selects all cells.
    """
    block = tuple(slice(0, n) for n in spec.shape) if slices is None else slices
    return {name: grid.ravel() for name, grid in spec.system_def.complete(spec.cell_params(block)).items()}
