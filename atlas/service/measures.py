"""Measure the stability of the attractors of a finished atlas on the workers.

The workers' results are kept in the store as parts, so that an interrupted measurement resumes.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from atlas.argument_checks import validate_flag
from atlas.errors import InputError, RunError
from atlas.formatting import PrintableResult, duration, plural
from atlas.robustness.job import (
    NEEDED,
    MeasureJob,
    check_store,
    group_of,
    measure_and_keep,
    pieces,
    read_measured,
)
from atlas.robustness.norm import validate_weights
from atlas.robustness.table import (
    LINEAR,
    MEASURES,
    SHOCKS,
    VERSION,
    Arrays,
    StoredMeasures,
    empty,
    of_family,
    read_measures,
    summary_of,
    write_measures,
)
from atlas.service.options import DEFAULTS, RunOptions, with_fields
from atlas.service.part_run import PartCost, PartRun
from atlas.service.progress import Progress
from atlas.service.store_call import store_call
from atlas.store.object_backend import Given
from atlas.store.store import AtlasStore
from atlas.store.tiles import read_tile
from atlas.task.solve_block import kernels_of
from workers import SOLVER_VERSION

if TYPE_CHECKING:
    from distributed import Client

Request = dict[str, Any]


@dataclass(frozen=True, repr=False)
class MeasureSummary(PartCost, PrintableResult):
    """Statistics of a store's stability measures, and the cost of computing them.

    store     path or URL of the store
    measures  statistics by measure
    requests  what each stored family of measures was computed for: ``norm``, and ``content``, a digest of the cells
    """

    store: str
    measures: Mapping[str, Mapping[str, float]]
    requests: Mapping[str, Request]

    def as_dict(self) -> dict[str, Any]:
        """Return the dict that ``atlas attractors measure --json`` prints."""
        times = {"seconds": self.seconds, "processor_seconds": self.processor_seconds, "tasks": self.tasks}
        requests = {
            name: {k: v for k, v in request.items() if k != "content"} for name, request in self.requests.items()
        }
        return {"store": self.store, "measures": dict(self.measures), **requests, **times}

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The statistics of the measures, and the cost of computing them, to show as sentences."""
        lines = [f"{self.store}: {plural(len(self.measures), 'measure')}"]
        for name, numbers in self.measures.items():
            ends = f", {numbers['least']:.4g} to {numbers['largest']:.4g}, median {numbers['median']:.4g}"
            lines.append(f"{name}: {plural(int(numbers['known']), 'attractor')}{ends if 'median' in numbers else ''}")
        if self.seconds:
            lines.append(f"in {duration(self.seconds)}, {duration(self.processor_seconds)} of processor time")
        return [(line,) for line in lines]


@with_fields
def measure_attractors(
    store: Given,
    *,
    shocks: bool = False,
    norm: Mapping[str, float] | None = None,
    client: "Client | None" = None,
    options: RunOptions = DEFAULTS,
    **fields: Any,
) -> MeasureSummary:
    """Measure the stability of all attractors of a finished atlas, and write the measures into its store.

    The measures are ``return_time``, ``reactivity`` and ``amplification``, as defined by ``atlas.stability``, in its
    ``norm``. ``shocks`` adds ``fatal_shock`` in an atlas of all attractors, which takes seconds to minutes for each
    attractor. Stored measures are not computed again. Without ``shocks`` stored ones remain as long as the cells are
    the same. The jobs run on ``client`` or on the workers of the options, like ``run``; the same call resumes a
    measurement that was stopped. Raise InputError if the store is not a finished atlas; see also ``run``.
    """
    with store_call(store, client, options, fields) as call:
        handle = call.open()
        check_store(handle)
        weights = validate_weights(norm, handle.spec.system_def)
        requests = _requests(handle, validate_flag("shocks", shocks), weights)
        before = read_measures(handle)
        stored = _still_true(before, requests)
        missing = [family for family, request in requests.items() if stored.requests.get(family) != request]
        if not missing:
            return MeasureSummary(str(handle.backend), summary_of(stored.arrays), stored.requests)
        digests = {group_of(family): _digest({family: requests[family]}) for family in missing}
        parts = PartRun(call, handle, measure_and_keep, kernels_of(handle.spec), digests)
        handle = parts.handle
        if read_measures(handle).requests != before.requests:  # the other run's measures must not be lost
            raise RunError(f"{handle.backend}: another run has measured it meanwhile; rerun the same command")
        arrays = stored.arrays | _measure(parts, missing, tuple(weights.items()))
        ordered = {name: arrays[name] for name in MEASURES if name in arrays}
        measured = stored.requests | {family: requests[family] for family in missing}
        write_measures(handle, StoredMeasures(ordered, measured))
        return MeasureSummary(str(handle.backend), summary_of(ordered), measured, **vars(parts.end()))


def _requests(handle: AtlasStore, shocks: bool, norm: Mapping[str, float]) -> dict[str, Request]:
    """Return what is to be measured: for each family of measures the norm and a digest of the cells.

    The measures of a family are computed together, such as all those of shocks. Stored measures with another digest,
    the ``content`` of a request, are out of date.
    """
    if shocks and not handle.spec.coexistence:
        raise InputError(
            f"{handle.backend}: has one attractor per cell; shocks need an atlas of all attractors, see [attractors]"
        )
    content = _content(handle)
    requests: dict[str, Request] = {LINEAR: {"content": content, "norm": dict(norm)}}
    if shocks:
        requests[SHOCKS] = {"content": content, "norm": dict(norm)}
    return requests


def _still_true(stored: StoredMeasures, requests: Mapping[str, Request]) -> StoredMeasures:
    """Return those of the stored measures that belong to the present cells of the atlas."""
    content = requests[LINEAR]["content"]
    current_requests = {
        family: request for family, request in stored.requests.items() if request.get("content") == content
    }
    return StoredMeasures(
        {name: values for name, values in stored.arrays.items() if MEASURES[name].family in current_requests},
        current_requests,
    )


def _content(handle: AtlasStore) -> str:
    """Return a digest of the cells' results on which the stability measures depend, as text."""
    content = hashlib.sha256(handle.digest.encode())
    for index in sorted(tile.index for tile in handle.tiling.tiles()):
        for name, values in sorted(read_tile(handle, index, NEEDED).items()):
            content.update(name.encode() + np.ascontiguousarray(values).tobytes())
    return content.hexdigest()


def _digest(requests: Mapping[str, Request]) -> str:
    return hashlib.sha256(repr((sorted(map(repr, requests.items())), VERSION, SOLVER_VERSION)).encode()).hexdigest()


def _measure(parts: PartRun[MeasureJob], families: Sequence[str], norm: tuple[tuple[str, float], ...]) -> Arrays:
    """Compute the measures of some families on the workers, and return them as arrays over all cells, by name."""
    handle, ref = parts.handle, parts.pool.store_ref
    every = ((family, *piece) for family in families for piece in pieces(handle, family))
    jobs = [
        MeasureJob((k,), name, family, tile, first, last, norm, ref)
        for k, (family, name, tile, first, last) in enumerate(every)
    ]
    cells, stored = (
        sum(job.last - job.first for job in some) for some in (jobs, [job for job in jobs if job.part in parts.stored])
    )

    def progress() -> Progress:
        solved = stored + parts.cells
        return Progress("measuring", cells=cells, cells_done=solved, detail=f"{solved} of {plural(cells, 'cell')}")

    parts.run(jobs, progress)
    many = (handle.spec.attractors.keep,) if handle.spec.coexistence and handle.spec.attractors else ()
    arrays: Arrays = {}
    for family in families:
        arrays |= empty(of_family(family), (*handle.spec.shape, *many))
    for job in jobs:
        at = handle.tiling.at(job.tile)
        which = np.unravel_index(np.arange(job.first, job.last), at.shape)
        index = tuple(cell + part.start for cell, part in zip(which, at.slices, strict=True))
        for measured, values in read_measured(handle, job.name).items():
            arrays[measured][index] = values if many else values[:, 0]
    return arrays
