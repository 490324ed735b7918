"""What goes wrong under a run, on cue, and how often each tile was tried for it."""

import errno
import os
import re
import subprocess
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from distributed import Client, get_worker

import atlas
from atlas.errors import NetworkError, RunError
from atlas.service import dispatch
from atlas.service import run as running
from atlas.service.options import RunOptions
from atlas.service.timing import Timing
from atlas.store.create import create_store
from atlas.store.object_backend import LocalBackend
from atlas.store.store import done_tiles, open_store
from atlas.store.tiles import read_tile
from atlas.task import tile_job as jobs
from atlas.task.store_ref import StoreFullError, StoreRef, WorkerRefusedError
from atlas.task.tile_job import RunJob, execute_job, run_tile_job
from tests.support.faults import ATLAS, attempts, environment
from workers import tile as solving
from workers.results import result_variables
from workers.tile import solve_tile

pytestmark = pytest.mark.slow

SPEC = """
system = "two-mass"
[axes.omega]
start = 2.0
stop = 4.0
num = 6
[axes.b]
values = [0.1, 0.2, 0.4, 0.5]
[solve]
max_periods = 300
tolerance = 0.1
[store]
tile = [2, 2]
"""


@dataclass
class Run:
    """A folder with a spec, and the command run in it while faults are on."""

    folder: Path
    script: dict[str, list[str]]

    def __call__(self, *more: str) -> subprocess.CompletedProcess[str]:
        (self.folder / "spec.toml").write_text(SPEC)
        return subprocess.run(
            [*ATLAS, "run", "spec.toml", "-o", "out.zarr", *more],
            cwd=self.folder,
            env=environment(self.folder / "faults", self.script),
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )

    @property
    def attempts(self) -> dict[str, int]:
        return dict(attempts(self.folder / "faults"))

    @property
    def store(self) -> Path:
        return self.folder / "out.zarr"


def tiles(*but: str) -> list[str]:
    return [name for name in (f"{i}-{j}" for i in range(2) for j in range(3)) if name not in but]


@pytest.fixture(scope="module")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, subprocess.CompletedProcess[str]]:
    """One run of six tiles that meets everything at once."""
    run = Run(
        tmp_path_factory.mktemp("faulty"),
        {"0-0": ["die", "ok"], "0-1": ["die"], "0-2": ["fail", "fail", "ok"], "1-0": ["fail"]},
    )
    return run, run("--workers", "2")


def test_each_tile_is_tried_as_often_as_its_faults_ask_for(faulty: tuple[Run, object]) -> None:
    """Dask tries a tile that kills its process twice before all other tiles, and twice after them."""
    assert faulty[0].attempts == {"0-0": 2, "0-1": 4, "0-2": 3, "1-0": 3, "1-1": 1, "1-2": 1}


def test_a_tile_that_kills_its_processes_is_reported_with_the_last_one(
    faulty: tuple[Run, subprocess.CompletedProcess[str]],
) -> None:
    ended = faulty[1]
    says = r"tile \(0, 1\) failed on tls://127\.0\.0\.1:\d+: all of its workers have died, 2 of them"
    assert len([line for line in ended.stderr.splitlines() if re.fullmatch(says, line)]) == 1


def test_every_other_tile_is_finished_and_right(faulty: tuple[Run, subprocess.CompletedProcess[str]]) -> None:
    run, ended = faulty
    handle = open_store(run.store)
    assert done_tiles(handle) == {(0, 0), (0, 2), (1, 1), (1, 2)}
    assert "4 of 6 tiles done" in ended.stdout
    spec = handle.spec
    for index in done_tiles(handle):
        part = tuple(slice(2 * i, 2 * i + 2) for i in index)
        expected = solve_tile(spec.system, spec.cell_params(part), spec.settings)
        stored = read_tile(handle, index)
        for name, values in expected.items():
            np.testing.assert_array_equal(stored[name], values, err_msg=name)


def test_a_tile_that_raises_each_time_is_reported_and_left_for_another_run(
    faulty: tuple[Run, subprocess.CompletedProcess[str]],
) -> None:
    ended = faulty[1]
    assert ended.returncode == 1
    says = r"tile \(1, 0\) failed on tls://127\.0\.0\.1:\d+: ZeroDivisionError: attempt 3"
    assert [line for line in ended.stderr.splitlines() if re.fullmatch(says, line)]


def test_no_note_is_left_beside_the_store(faulty: tuple[Run, object]) -> None:
    assert sorted(path.name for path in faulty[0].folder.iterdir()) == ["faults", "out.zarr", "spec.toml"]


def test_a_full_disk_stops_the_run_and_nothing_is_lost_or_redone(tmp_path: Path) -> None:
    run = Run(tmp_path, {"1-0": ["full"]})
    first = run("--workers", "1")
    assert first.returncode == 1
    advice = "finished tiles are kept, make room and rerun the same command"
    assert first.stderr.splitlines()[-1] == f"Error: {run.store}: No space left on device; {advice}"
    kept = len(done_tiles(open_store(run.store)))
    assert kept >= 2  # the first two tiles are begun before any cost is known, and 1-0 is not one of them
    run.script = {}
    second = run("--workers", "1")
    assert second.returncode == 0
    assert f"resuming: {kept} of 6 tiles are done" in second.stderr
    assert run.attempts == dict.fromkeys(tiles("1-0"), 1) | {"1-0": 2}


@pytest.fixture
def made(tmp_path: Path, plane: atlas.Spec) -> RunJob:
    """The job of one tile of a new store."""
    handle = create_store(tmp_path / "out.zarr", plane, (2, 3))
    return RunJob((1, 1), StoreRef(str(handle.path), handle.run_id, handle.solver_version))


def test_a_worker_with_another_solver_refuses(made: RunJob) -> None:
    with pytest.raises(WorkerRefusedError, match=r"this worker has solver version \d+, the run needs 999"):
        run_tile_job(replace(made, store_ref=replace(made.store_ref, solver_version=999)))


def test_a_worker_that_sees_another_store_there_refuses(made: RunJob) -> None:
    with pytest.raises(
        WorkerRefusedError, match=r"not the store of run 0123; check that the path is the same on every host"
    ):
        run_tile_job(replace(made, store_ref=replace(made.store_ref, run_id="0123")))


def test_a_worker_that_sees_no_store_there_refuses(made: RunJob) -> None:
    with pytest.raises(WorkerRefusedError, match=r"no such store; check that the path is the same on every host"):
        run_tile_job(replace(made, store_ref=replace(made.store_ref, store="/nowhere/out.zarr")))


def test_a_disk_that_fails_while_the_header_is_read_leaves_the_tile_to_be_tried_again(
    made: RunJob, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(LocalBackend, "get", fail)
    with pytest.raises(OSError, match=os.strerror(errno.EIO)):
        run_tile_job(made)


@pytest.mark.parametrize("number", [errno.EROFS, errno.EACCES])
def test_a_worker_that_cannot_write_refuses_and_says_why(
    made: RunJob, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def write(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(jobs, "write_tile", write)
    with pytest.raises(WorkerRefusedError, match=os.strerror(number)):
        run_tile_job(made)


def test_a_disk_that_is_full_at_any_of_the_writes_leaves_the_tile_to_do(
    made: RunJob, monkeypatch: pytest.MonkeyPatch
) -> None:
    handle = open_store(Path(made.store_ref.store))
    whole_write = zarr.Array.__setitem__
    for variable in result_variables(handle.spec.settings):

        def full(array: zarr.Array[Any], key: Any, value: Any, at: str = variable.name) -> None:
            if array.basename == at:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            whole_write(array, key, value)

        with monkeypatch.context() as patch:
            patch.setattr(zarr.Array, "__setitem__", full)
            with pytest.raises(StoreFullError, match="No space left on device"):
                run_tile_job(made)
        assert done_tiles(handle) == set()
    run_tile_job(made)
    expected = solve_tile(handle.spec.system, handle.spec.cell_params((slice(2, 4), slice(3, 6))), handle.spec.settings)
    stored = read_tile(handle, made.index)
    for name, values in expected.items():
        np.testing.assert_array_equal(stored[name], values, err_msg=name)


def test_a_tile_that_is_stored_is_not_solved_again(made: RunJob, monkeypatch: pytest.MonkeyPatch) -> None:
    first = run_tile_job(made)
    monkeypatch.setattr(jobs, "solve_and_write", None)
    again = run_tile_job(made)
    assert (again.counts, again.cells, again.periods) == (first.counts, first.cells, first.periods)


def test_two_attempts_at_once_do_not_undo_what_the_first_has_finished(
    made: RunJob, monkeypatch: pytest.MonkeyPatch
) -> None:
    def late(*given: object) -> object:
        monkeypatch.setattr(solving, "solve_tile", solve_tile)
        run_tile_job(made)  # the other attempt, which is faster
        monkeypatch.setattr(jobs, "write_tile", None)
        return solve_tile(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(solving, "solve_tile", late)
    assert jobs.solve_and_write(made, made.handle()).cells == 6
    assert done_tiles(open_store(Path(made.store_ref.store))) == {(1, 1)}


NOTED: dict[str, list[Any]] = {}


def noted(name: str) -> list[Any]:
    """What workers of this process note by name; what a function closes over is copied on its way to them."""
    return NOTED.setdefault(name, [])


def test_a_worker_that_refuses_is_excluded_and_named(
    tmp_path: Path, plane: atlas.Spec, two_workers: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    unfit, name = min(two_workers.nthreads()), str(tmp_path)

    def picky(job: RunJob) -> jobs.TileReport | jobs.DerivedReport:
        address = get_worker().address
        noted(name).append(address)
        if address == unfit:
            raise WorkerRefusedError("sees no store")
        for _ in range(300):  # until the other has refused
            if unfit in noted(name):
                break
            time.sleep(0.1)
        return execute_job(job)

    monkeypatch.setattr(running, "execute_job", picky)
    once = RunOptions(timing=Timing(tick=60.0))  # the workers are looked at before the first tile and after the last
    summary = atlas.run(plane, tmp_path / "out.zarr", two_workers, once)
    assert (summary.tiles_done, summary.failures) == (9, ())
    assert summary.refused == {unfit: "sees no store"}
    assert 1 <= noted(name).count(unfit) <= 2 * dispatch.IN_FLIGHT  # what was in flight when it refused first


def test_a_worker_that_gave_up_on_the_network_is_asked_again_once_another_has_written(
    tmp_path: Path, plane: atlas.Spec, two_workers: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    cut_off, name = min(two_workers.nthreads()), str(tmp_path)

    def cut(job: RunJob) -> jobs.TileReport:
        if get_worker().address == cut_off:
            noted(name).append(job.index)
            if len(noted(name)) == 1:
                raise NetworkError("no answer")
        return execute_job(job)

    monkeypatch.setattr(running, "execute_job", cut)
    summary = atlas.run(plane, tmp_path / "out.zarr", client=two_workers)
    assert (summary.tiles_done, summary.failures, summary.refused) == (9, (), {})
    assert len(noted(name)) > 1


def test_a_run_that_every_worker_refuses_ends_with_the_reason(
    tmp_path: Path, plane: atlas.Spec, two_workers: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(job: RunJob) -> None:
        raise WorkerRefusedError("sees no store")

    monkeypatch.setattr(running, "execute_job", refuse)
    with pytest.raises(RunError, match=r"all workers are excluded, for example inproc://\S+: sees no store"):
        atlas.run(plane, tmp_path / "out.zarr", client=two_workers)


def test_a_scheduler_without_this_package_is_reported_once_and_at_once(
    tmp_path: Path, plane: atlas.Spec, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unloadable(act: object, job: RunJob) -> None:
        raise RuntimeError("Error during deserialization of the task graph. This frequently occurs if ...")

    monkeypatch.setattr(dispatch, "run_attempt", unloadable)
    with pytest.raises(RunError, match="install the same impact-atlas on every host, the scheduler's too"):
        atlas.run(plane, tmp_path / "out.zarr", client=client)
