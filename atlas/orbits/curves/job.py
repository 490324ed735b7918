"""The job that does one task of a search on a worker."""

import json
import time
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

from atlas.orbits.curves.cell_orbits import CellOrbits
from atlas.orbits.curves.following import FollowedCurve
from atlas.orbits.curves.plane import plane_of
from atlas.orbits.curves.settings import CurveSettings
from atlas.orbits.curves.tasks import Task, run_task
from atlas.orbits.curves.to_json import curve_from_json
from atlas.store.groups import CURVES
from atlas.store.store import AtlasStore
from atlas.task.compile import ORBITS, compile_once, kernels_for
from atlas.task.store_ref import PartReport, StoreRef, WorkerRefusedError, stored_part


@dataclass(frozen=True)
class CurveJob:
    """A job for one task of a search. ``run_and_store`` runs it locally.

    index      index of the job
    name       name of the part for the result
    task       the task
    settings   budget of the search
    digest     digest of the search; a worker whose store has another digest refuses
    store_ref  reference to the store
    """

    index: tuple[int, ...]
    name: str
    task: Task
    settings: CurveSettings
    digest: str
    store_ref: StoreRef

    @property
    def part(self) -> str:
        """The group and the name of the part."""
        return f"{CURVES}/{self.name}"


def run_and_store(job: CurveJob) -> PartReport:
    """Run a task and write its result as a part of the store."""
    handle = job.store_ref.open()
    compile_once(*kernels_for(handle.spec.system_def, ORBITS))
    begin = time.thread_time()
    orbits = _orbits(job.store_ref, job.digest, job.settings)
    try:
        result = run_task(job.task, orbits, partial(read_part, handle), partial(_curve, job.store_ref, job.digest))
    except (ArithmeticError, ValueError, IndexError, AssertionError) as error:
        # One point at which a method breaks down must not end the search: the error is counted, in words.
        result = {"trouble": f"{type(error).__name__}: {error}"}
    job.store_ref.write_part(handle, CURVES, job.name, json.dumps(result).encode())
    return PartReport(job.index, job.name, time.thread_time() - begin)


def read_part(handle: AtlasStore, name: str) -> dict[str, Any]:
    """Return the result of a part. Raise RefusedError if there is none."""
    part: dict[str, Any] = json.loads(stored_part(handle, CURVES, name))
    return part


@lru_cache(maxsize=64)  # a curve passes many edges
def _curve(site: StoreRef, digest: str, name: str) -> FollowedCurve:
    return curve_from_json(read_part(site.open(), name)["curve"])


@lru_cache(maxsize=1)  # reading a plane and finding its orbits is slow
def _orbits(site: StoreRef, digest: str, settings: CurveSettings) -> CellOrbits:
    plane = plane_of(site.open())
    if settings.digest(plane) != digest:
        text = "its cells differ from those of the search; check that the path is the same on every host"
        raise WorkerRefusedError(f"{site.store}: {text}")
    return CellOrbits(plane)
