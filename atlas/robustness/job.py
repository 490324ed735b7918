"""The job that measures the stability of some cells of a tile on a worker.

Its result is kept in the store as a part, an intermediate result, until all cells are measured.
"""

import io
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.orbits.orbit_table import columns_of, must_be_finished, params_of
from atlas.robustness.table import LINEAR, SHOCKS, Arrays, check_names, of_family
from atlas.spec.spec import Spec
from atlas.spec.system import must_have_force
from atlas.store.groups import STABILITY, check_table_size
from atlas.store.store import AtlasStore
from atlas.task.compile import compile_once
from atlas.task.solve_block import kernels_of
from atlas.task.store_ref import PartReport, StoreRef, stored_part, translate_file_errors
from workers.results import LARGEST, REGIME

NEEDED = (REGIME.name, "period", LARGEST.name, "state")
"""Results on which the measures of a cell depend, besides its parameters."""
CELLS_PER_JOB = {LINEAR: 2048, SHOCKS: 4}
"""Number of cells of a job: a few seconds of work, up to minutes for shocks."""


def group_of(family: str) -> str:
    """Return the group of the store with the parts (intermediate results) for a family of measures.

    The parts of one request cannot serve another, since its measures differ.
    """
    return f"{STABILITY}/{family}"


@dataclass(frozen=True)
class MeasureJob:
    """A job that computes measures of some cells of a tile; ``measure_and_keep`` runs it.

    index      index of the job
    name       name of the part, the intermediate result in the store, for the measures
    family     family of measures that are computed together
    tile       index of the tile
    first      first cell of the tile, in C order
    last       end of the cells, exclusive
    norm       weights of the norm, by component of the state
    store_ref  reference to the store
    """

    index: tuple[int, ...]
    name: str
    family: str
    tile: tuple[int, ...]
    first: int
    last: int
    norm: tuple[tuple[str, float], ...]
    store_ref: StoreRef

    @property
    def part(self) -> str:
        """The name of the part (the intermediate result) in the store, with its group."""
        return f"{STABILITY}/{self.name}"


def pieces(handle: AtlasStore, family: str) -> Iterator[tuple[str, tuple[int, ...], int, int]]:
    """Yield the division of an atlas's cells into jobs for a family of measures.

    Each item is the name of the job's intermediate result, the index of the tile, the first cell, and the end of the
    cells.
    """
    for tile in (one.index for one in handle.tiling.tiles()):
        count, most = int(np.prod(handle.tiling.at(tile).shape)), CELLS_PER_JOB[family]
        for first in range(0, count, most):
            yield f"{family}/{'.'.join(map(str, tile))}-{first}", tile, first, min(first + most, count)


def measure_and_keep(job: MeasureJob) -> PartReport:
    """Compute the measures of a job's cells, write them as a part (an intermediate result) of the store, and report."""
    handle = job.store_ref.open()
    with translate_file_errors(job.store_ref.store):
        cells = columns_of(handle, NEEDED, job.tile)
    compile_once(*kernels_of(handle.spec))
    begin = time.thread_time()
    slices = handle.tiling.at(job.tile).slices
    arrays = _measured(handle.spec, job, params_of(handle.spec, slices), cells)
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, **arrays)
    job.store_ref.write_part(handle, STABILITY, job.name, file.getvalue())
    return PartReport(job.index, job.name, time.thread_time() - begin, job.last - job.first)


def read_measured(handle: AtlasStore, name: str) -> Arrays:
    """Return the measures of a part, the intermediate result of a job, by name.

    Raise WorkerRefusedError if the part does not exist.
    """
    with np.load(io.BytesIO(stored_part(handle, STABILITY, name))) as arrays:
        return dict(arrays)


def check_store(handle: AtlasStore) -> None:
    """Raise InputError unless a store is a finished atlas whose attractors can be measured."""
    spec = handle.spec
    if spec.basins:
        raise InputError(
            f"{handle.backend}: found basins of one machine; measure its attractors by atlas attractors stability --set"
        )
    must_have_force(spec.system_def, "stability measures")
    check_names(handle)
    stored_names = {variable.name for variable in handle.variables}
    if lacking := [name for name in NEEDED if name not in stored_names]:
        raise InputError(f"{handle.backend}: found no {lacking[0]!r}; measures need a spec with exponents")
    check_table_size(handle, of_family(LINEAR))  # the largest measures
    must_be_finished(handle)


def _measured(
    spec: Spec, job: MeasureJob, params: dict[str, NDArray[np.float64]], cells: dict[str, NDArray[Any]]
) -> Arrays:
    from atlas.robustness.stored_cells import linear_measures, shock_measures  # imports Numba, which is slow

    some = slice(job.first, job.last)
    params = {name: values[some].copy() for name, values in params.items()}
    cells = {name: values[some] for name, values in cells.items()}
    if job.family == LINEAR:
        return linear_measures(spec.system_def, params, cells, dict(job.norm))
    assert spec.attractors is not None
    return shock_measures(spec.system_def, params, cells, dict(job.norm), spec.settings, spec.attractors)
