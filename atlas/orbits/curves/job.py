"""The job that executes one task of a search for curves on a worker, and stores its result."""

import json
import time
from dataclasses import dataclass
from functools import partial
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
    """A job for one task of a search for curves. ``run_and_store`` runs it in the calling process.

    index      index of the job
    name       name under which the result is stored, as a part of the store
    task       the task
    settings   budget of the search
    digest     digest of the cells and the budget; a worker that computes another from its store refuses the job
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
        """Path of the stored result in the store: its group and its name."""
        return f"{CURVES}/{self.name}"


def run_and_store(job: CurveJob) -> PartReport:
    """Run a task of a search and write its result into the store, as a part, that is an intermediate result."""
    handle = job.store_ref.open()
    compile_once(*kernels_for(handle.spec.system_def, ORBITS))
    begin = time.thread_time()
    orbits, curve_of = _read_plane(job, handle), partial(_curve, handle, job.digest)
    try:
        result = run_task(job.task, orbits, partial(read_part, handle), curve_of)
    except (ArithmeticError, ValueError, IndexError, AssertionError) as error:
        # One point at which a method breaks down must not end the search: the error is counted, in words.
        result = {"trouble": f"{type(error).__name__}: {error}"}
    job.store_ref.write_part(handle, CURVES, job.name, json.dumps(result).encode())
    return PartReport(job.index, job.name, time.thread_time() - begin)


def read_part(handle: AtlasStore, name: str) -> dict[str, Any]:
    """Return the stored result of a task by its name. Raise WorkerRefusedError if the store does not have it."""
    part: dict[str, Any] = json.loads(stored_part(handle, CURVES, name))
    return part


def _curve(handle: AtlasStore, digest: str, name: str) -> FollowedCurve:
    """Return a curve by the name of its part; a curve passes many edges, so the handle keeps it."""
    curve = handle.cache.get(f"{digest} {name}") or curve_from_json(read_part(handle, name)["curve"])
    handle.cache[f"{digest} {name}"] = curve
    return curve


def _read_plane(job: CurveJob, handle: AtlasStore) -> CellOrbits:
    """Return the orbits of the cells; the handle keeps them, since reading a plane and finding its orbits is slow.

    Raise WorkerRefusedError if the cells are not those of the search.
    """
    orbits = handle.cache.get(job.digest)
    if orbits is None:
        plane = plane_of(handle)
        if job.settings.digest(plane) != job.digest:
            text = "its cells differ from those of the search; check that the path is the same on every host"
            raise WorkerRefusedError(f"{job.store_ref.store}: {text}")
        orbits = handle.cache[job.digest] = CellOrbits(plane)
    return orbits
