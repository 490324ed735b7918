"""Measuring some cells of a tile on a worker: the message and its execution."""

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
"""Results that the measures of a cell depend on, besides its parameters."""
CELLS_PER_JOB = {LINEAR: 2048, SHOCKS: 4}
"""Cells of a job: a second or a few of work, up to minutes for shocks."""


def group_of(family: str) -> str:
    """The group of a family's parts while it is measured; another request has other parts."""
    return f"{STABILITY}/{family}"


@dataclass(frozen=True)
class MeasureJob:
    """Some cells of a tile, in C order from ``first`` to before ``last``, and the name of the part for their measures.

    ``measure_and_keep`` runs it locally.
    """

    index: tuple[int, ...]
    name: str
    family: str
    tile: tuple[int, ...]
    first: int
    last: int
    norm: tuple[tuple[str, float], ...]
    store_ref: StoreRef


def pieces(handle: AtlasStore, family: str) -> Iterator[tuple[str, tuple[int, ...], int, int]]:
    """Name, tile and cells, from the first to before the last, of each part that the measures of a family take."""
    for tile in (one.index for one in handle.tiling.tiles()):
        count, most = int(np.prod(handle.tiling.at(tile).shape)), CELLS_PER_JOB[family]
        for first in range(0, count, most):
            yield f"{family}/{'.'.join(map(str, tile))}-{first}", tile, first, min(first + most, count)


def measure_and_keep(job: MeasureJob) -> PartReport:
    """Measure some cells and keep the measures as a part of the store."""
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
    """The measures that a part holds; RefusedError if there is none."""
    with np.load(io.BytesIO(stored_part(handle, STABILITY, name))) as arrays:
        return dict(arrays)


def check_store(handle: AtlasStore) -> None:
    """InputError unless a store is a finished atlas whose attractors can be measured."""
    spec = handle.spec
    if spec.basins:
        raise InputError(
            f"{handle.backend}: found basins of one machine; measure its attractors by atlas attractors stability --set"
        )
    must_have_force(spec.system_def, "stability measures")
    check_names(handle)
    held = {variable.name for variable in handle.variables}
    if lacking := [name for name in NEEDED if name not in held]:
        raise InputError(f"{handle.backend}: lacks {lacking[0]!r}; measures need a spec with exponents")
    check_table_size(handle, of_family(LINEAR))  # no measure is larger
    must_be_finished(handle)


def _measured(
    spec: Spec, job: MeasureJob, params: dict[str, NDArray[np.float64]], cells: dict[str, NDArray[Any]]
) -> Arrays:
    from atlas.robustness.stored_cells import linear_measures, shock_measures  # with it Numba

    some = slice(job.first, job.last)
    params = {name: values[some].copy() for name, values in params.items()}
    cells = {name: values[some] for name, values in cells.items()}
    if job.family == LINEAR:
        return linear_measures(spec.system_def, params, cells, dict(job.norm))
    assert spec.attractors is not None
    return shock_measures(spec.system_def, params, cells, dict(job.norm), spec.settings, spec.attractors)
