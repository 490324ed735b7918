"""Rounds of some lanes, with tangent vectors, compiled and on CUDA's simulator: prints what comes of both as JSON.

    NUMBA_ENABLE_CUDASIM=1 python -m tests.simulated

Compiled, all lanes share one array; on the device each thread has a lane and an array of its own.
"""

import hashlib
import json

import numpy as np
from numba import cuda
from numpy.typing import NDArray

from workers.cell.cell_batch import CellBatch
from workers.kernel.device import make_translator
from workers.kernel.lanes.frames import MAX_SPREAD, load_frame, spread_pass, transfer_pass
from workers.kernel.lanes.layout import BLOCK_SIZE, FLYING, GAP_SIZE, LANE, LANE_SIZE, LANES, STRIDE
from workers.kernel.lanes.rounds import run_round
from workers.kernel.lanes.run import load, park
from workers.kernel.motion import axes
from workers.model.system import find_system
from workers.settings import Settings
from workers.tile import broadcast, initial_state, result_arrays

CELLS, ROUNDS, BLOCKS = 8, 40, 2
VECTORS = 2 * BLOCKS
SIZES = {"fields": LANE_SIZE + BLOCKS * BLOCK_SIZE, "frames": VECTORS * VECTORS * STRIDE, "partial": 2 * STRIDE,
         "chosen": LANES, "gathered": GAP_SIZE}  # fmt: skip
"""Numbers of an array of lanes, of their frames, and of what their passes overwrite."""

Array = NDArray[np.float64]


def some_cells() -> CellBatch:
    """Cells of the default system in regular and in chaotic motion."""
    system, settings = find_system("two-mass"), Settings()
    params = broadcast(system, {"omega": np.linspace(2.0, 4.0, CELLS), "b": np.linspace(0.05, 0.4, CELLS)})
    found = result_arrays(system.variables(settings), settings, CELLS, VECTORS)
    return CellBatch(*system.build_many(params), initial_state(system, params), settings, found)


def room(arrays: int) -> dict[str, Array]:
    """Arrays of lanes, each with what SIZES has."""
    return {
        name: np.zeros((arrays, size), np.uint32 if name == "chosen" else np.float64) for name, size in SIZES.items()
    }


def loaded(cells: CellBatch, arrays: int) -> dict[str, Array]:
    """The cells in the lanes of one array, or each in the first lane of its own."""
    plain, osc, motions = make_translator(lambda function: function), cells.oscillators, cells.batch.motions
    found, gap = room(arrays), osc.gap
    for fields in found["fields"]:
        for i in range(LANES):
            plain(park)(fields, i)
    for r in range(CELLS):
        k, i = (r, 0) if arrays > 1 else (0, r)
        plain(load)(
            found["fields"][k], i, r, osc.head, osc.tau, gap.blocks, gap.waves, gap.numbers, motions.h, motions.tally
        )
        frame = found["frames"][k].reshape(VECTORS, -1)
        plain(load_frame)(axes(BLOCKS), np.zeros(VECTORS), frame, np.zeros((VECTORS, STRIDE)), i)
    return found


def digest(found: dict[str, Array], k: int, i: int) -> str:
    """Of the bits of lane i of array k."""
    parts = [np.ascontiguousarray(found[name][k].reshape(-1, STRIDE)[:, i]) for name in ("fields", "frames")]
    return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()


def compiled(cells: CellBatch) -> tuple[list[str], int]:
    """The bits of each lane after some rounds, and how many events they have been through."""
    found, events = loaded(cells, 1), 0
    fields, frames, partial, chosen, gathered = (array[0] for array in found.values())
    for _ in range(ROUNDS):
        run_round(fields, BLOCKS, 0, True, True, CELLS, chosen, gathered)
        spread_pass(fields, MAX_SPREAD, CELLS)
        for u in frames.reshape(VECTORS, -1):
            transfer_pass(fields, u, partial, CELLS)
        events += int(np.count_nonzero(fields[LANE.event : LANE.event + CELLS] != FLYING))
    return [digest(found, 0, i) for i in range(CELLS)], events


def on_device(cells: CellBatch) -> list[str]:
    """The same of a thread for each lane."""
    found, device = loaded(cells, CELLS), make_translator(cuda.jit(device=True))
    one_round, spread, transfer = device(run_round), device(spread_pass), device(transfer_pass)
    size = VECTORS * STRIDE

    @cuda.jit
    def rounds(fields, frames, partial, chosen, gathered):  # type: ignore[no-untyped-def]
        k = cuda.grid(1)
        if k < len(fields):
            for _ in range(ROUNDS):
                one_round(fields[k], BLOCKS, 0, True, True, 1, chosen[k], gathered[k])
                spread(fields[k], MAX_SPREAD, 1)
                for v in range(VECTORS):
                    transfer(fields[k], frames[k, v * size : (v + 1) * size], partial[k], 1)

    rounds[1, CELLS](*found.values())
    return [digest(found, k, 0) for k in range(CELLS)]


if __name__ == "__main__":
    bits, passed = compiled(some_cells())
    print(json.dumps({"compiled": bits, "device": on_device(some_cells()), "events": passed}))
