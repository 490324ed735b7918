"""A patch: cells on a grid of two parameters that the explorer has solved as one job on a worker."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.task.compile import ATTRACTORS, compile_once, kernels_for
from atlas.task.store_ref import check_solver
from workers import SOLVER_VERSION, Settings
from workers.attractors.initial_states import AttractorSettings
from workers.model.system import System


@dataclass(frozen=True)
class GridPatch:
    """Cells on a grid of two parameters, to be solved as one job by ``solve_patch``, on a worker or locally.

    system           the system
    parameters       value of each parameter that is not an axis, by name
    settings         settings of the solver
    x, y             name of an axis, and the values of the grid along the axis
    mask_bits        mask (y, x) of the cells to solve, packed by ``numpy.packbits``; empty for all cells
    starts           settings of the search for all attractors of each cell; None to solve only its own motion
    solver_version   version of the solver that must solve the cells
    """

    system: System
    parameters: Mapping[str, float]
    settings: Settings
    x: tuple[str, tuple[float, ...]]
    y: tuple[str, tuple[float, ...]]
    mask_bits: bytes = b""
    starts: AttractorSettings | None = None
    solver_version: int = SOLVER_VERSION

    @property
    def mask(self) -> NDArray[np.bool_]:
        """The mask (y, x) of the cells to solve."""
        shape = len(self.y[1]), len(self.x[1])
        if not self.mask_bits:
            return np.ones(shape, dtype=bool)
        bits = np.frombuffer(self.mask_bits, dtype=np.uint8)
        return np.unpackbits(bits, count=shape[0] * shape[1]).reshape(shape).astype(bool)


def packed(mask: NDArray[np.bool_]) -> bytes:
    """Return the mask (y, x) of the cells to solve, as packed bits for ``GridPatch.mask_bits``."""
    return b"" if mask.all() else np.packbits(mask).tobytes()


def solve_patch(patch: GridPatch) -> dict[str, NDArray[Any]]:
    """Solve a patch, and return the results of its N cells, row by row, as arrays (N, ...) by name.

    Raise RefusedError if this worker has another solver version.
    """
    check_solver(patch.solver_version)
    compile_once(*kernels_for(patch.system, *(() if patch.starts is None else (ATTRACTORS,)), settings=patch.settings))
    rows, columns = np.nonzero(patch.mask)
    (x, across), (y, up) = patch.x, patch.y
    cells: dict[str, Any] = {**patch.parameters, x: np.array(across)[columns], y: np.array(up)[rows]}
    if patch.starts is not None:
        from workers.attractors.coexistence import solve_attractors

        return solve_attractors(patch.system, cells, patch.settings, patch.starts)
    from workers.tile import solve_tile

    return solve_tile(patch.system, cells, patch.settings)
