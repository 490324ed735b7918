"""Workers that fail at tile after tile, that are gone, or that have too little memory: the others do their tiles."""

import errno
import os
import re
import time
from pathlib import Path
from typing import Any

import pytest
from distributed import Client, LocalCluster, Status, get_worker

import atlas
from atlas.errors import RunError
from atlas.service import run as running
from atlas.service.progress import Progress
from atlas.service.status import read_status
from atlas.service.timing import Timing
from atlas.store.store import find_store
from atlas.task import tile_job as jobs
from atlas.task.store_ref import WorkerRefusedError
from atlas.task.tile_job import RunJob, execute_job
from tests.planes import plane_of
from tests.service.test_faults import noted

pytestmark = pytest.mark.slow


BROKEN: dict[str, Exception] = {
    "a module that is missing": ModuleNotFoundError("No module named 'llvmlite'"),
    "a cache of kernels without room": OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "/root/.cache/kernels"),
}


@pytest.mark.parametrize("broken", BROKEN)
def test_a_worker_at_which_tile_after_tile_fails_is_left_out_and_named_and_costs_no_tile(
    tmp_path: Path, two_workers: Client, monkeypatch: pytest.MonkeyPatch, broken: str
) -> None:
    """It fails at once and so is always idle; the other takes its time."""
    unfit, name, error = min(two_workers.nthreads()), str(tmp_path), BROKEN[broken]

    def compiling(*_: object) -> None:
        noted(name).append(get_worker().address)
        if get_worker().address == unfit:
            raise error
        time.sleep(0.05)

    monkeypatch.setattr(jobs, "compile_once", compiling)
    summary = atlas.run(plane_of((1, 1)), tmp_path / "out.zarr", client=two_workers)
    assert (summary.tiles_done, summary.failures) == (35, ())
    assert summary.refused.keys() == {unfit}
    assert re.match(r"\d+ tiles failed on this worker and succeeded elsewhere, the first is ", summary.refused[unfit])
    assert str(error) in summary.refused[unfit]


def test_a_run_in_which_every_tile_fails_at_every_worker_ends_with_worker_tile_and_reason(
    tmp_path: Path, two_workers: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(job: RunJob) -> None:
        noted(str(tmp_path)).append(job.index)
        raise ImportError("no numba")

    monkeypatch.setattr(running, "execute_job", fail)
    words = r"^16 tiles failed twice and none succeeded, for example tile .* on inproc://\S+: ImportError: no numba"
    with pytest.raises(RunError, match=words):
        atlas.run(plane_of((1, 1)), tmp_path / "out.zarr", client=two_workers)
    assert len({*noted(str(tmp_path))}) < 35


def test_a_tile_given_to_a_worker_that_is_gone_is_given_to_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While one of three workers is left out, tiles go to the others by name; then one of these leaves."""
    name = str(tmp_path)
    with (
        LocalCluster(processes=False, n_workers=3, threads_per_worker=1, dashboard_address="127.0.0.1:0") as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        unfit, leaving, _ = sorted(client.nthreads())

        def picky(job: RunJob) -> jobs.TileReport:
            if get_worker().address == unfit:
                raise WorkerRefusedError("sees no store")
            noted(name).append(get_worker().address)
            return execute_job(job)

        left: list[str] = []

        def leave(progress: Progress) -> None:
            if leaving in noted(name) and not left:
                left.append(leaving)
                client.retire_workers([leaving], close_workers=True)

        monkeypatch.setattr(running, "execute_job", picky)
        timing = Timing(tick=0.05)
        options = atlas.RunOptions(on_progress=leave, timing=timing)
        summary = atlas.run(plane_of((1, 1)), tmp_path / "out.zarr", client=client, options=options)
    assert left
    assert (summary.tiles_done, summary.failures) == (35, ())


MISSING = """
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "atlas":
            raise ModuleNotFoundError("No module named 'atlas'", name=name)
sys.meta_path.insert(0, Missing())
"""


def test_a_worker_without_this_package_costs_no_tile(tmp_path: Path) -> None:
    """Dask takes it out of the cluster, since it cannot read what it is sent."""
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, memory_limit=0, dashboard_address="127.0.0.1:0") as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        client.run(exec, MISSING, {}, workers=[min(client.nthreads())])
        summary = atlas.run(plane_of((1, 1)), tmp_path / "out.zarr", client=client)
    assert (summary.tiles_done, summary.failures) == (35, ())


# Memory


def test_a_worker_with_too_little_memory_gets_no_tile_and_is_named(tmp_path: Path, plane: atlas.Spec) -> None:
    """Truth: such a worker of Dask never began a tile, and the run stood still without a word."""
    with (
        LocalCluster(
            processes=False, n_workers=1, threads_per_worker=1, memory_limit="300MB", dashboard_address="127.0.0.1:0"
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
        pytest.raises(
            RunError,
            match=r"memory limit 300 MB is below the required 500 MB; raise it with: dask worker --memory-limit",
        ),
    ):
        atlas.run(plane, tmp_path / "out.zarr", client=client)


def test_a_run_whose_workers_are_paused_says_so_to_its_user_and_to_the_status(
    tmp_path: Path, plane: atlas.Spec
) -> None:
    def pause(dask_worker: Any, paused: bool) -> None:
        dask_worker.status = Status.paused if paused else Status.running

    said: list[str] = []
    shown: list[Any] = []
    with (
        LocalCluster(
            processes=False, n_workers=2, threads_per_worker=1, memory_limit=0, dashboard_address="127.0.0.1:0"
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):

        def look(progress: Progress) -> None:
            said.append(progress.stage)
            handle = find_store(tmp_path / "out.zarr") if "paused" in progress.stage else None
            if handle is None:
                return
            status = read_status(handle)
            if status.trouble:
                shown.append(status)
                client.run(pause, paused=False)

        client.run(pause, paused=True)
        timing = Timing(tick=0.05, stall_after=0.2, heartbeat=0.05)
        options = atlas.RunOptions(on_progress=look, timing=timing)
        summary = atlas.run(plane, tmp_path / "out.zarr", client=client, options=options)
        names = sorted(client.nthreads())
    assert summary.tiles_done == 9
    line = next(stage for stage in said if "paused" in stage)
    assert re.match(r"no job finished for .* s: Dask has paused 2 workers short of memory: ", line)
    assert all(name in line for name in names)
    assert "Dask has paused 2 workers" in str(shown[0])
    assert (shown[0].seconds_left, " left" in str(shown[0])) == (None, False)
