"""A patch: cells of a grid of two parameters that somebody is looking at, solved and handed back."""

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
    """What is to be solved. All that crosses the scheduler; ``solve_patch`` redoes it by hand.

    x, y    the name of an axis and the values of the grid along it
    wanted  which cells (y, x) are to be solved, as numpy.packbits packs them; empty for all
    starts  from which initial states all attractors of each cell are sought; None for the motion from its own alone
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
        """The cells (y, x) to be solved."""
        shape = len(self.y[1]), len(self.x[1])
        if not self.mask_bits:
            return np.ones(shape, dtype=bool)
        bits = np.frombuffer(self.mask_bits, dtype=np.uint8)
        return np.unpackbits(bits, count=shape[0] * shape[1]).reshape(shape).astype(bool)


def packed(mask: NDArray[np.bool_]) -> bytes:
    """The cells of a mask as a patch has them."""
    return b"" if mask.all() else np.packbits(mask).tobytes()


def solve_patch(patch: GridPatch) -> dict[str, NDArray[Any]]:
    """Results of the wanted cells, row by row in arrays (N, ...); RefusedError if this worker has another solver."""
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
