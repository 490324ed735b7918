"""Runs left to a cluster of processes; every tile takes 0.3 s, so that something can happen meanwhile."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from distributed import Client, LocalCluster

import atlas
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.service.lease import LeaseRecord
from atlas.service.options import RunOptions
from atlas.service.status import StatusReader, read_status, watch
from atlas.service.submit import submit
from atlas.service.timing import TIMING
from atlas.store.create import create_store
from atlas.store.sidecar import LEASE_NAME, sidecar_of
from atlas.store.store import open_store
from tests.planes import plane_of
from tests.polling import until
from tests.support.faults import attempts, environment
from workers import SOLVER_VERSION

pytestmark = pytest.mark.slow

TILES = 15
PLANE = plane_of((1, 3))


@dataclass(frozen=True)
class Service:
    """A scheduler with two workers of one thread, and a folder."""

    client: Client
    folder: Path

    @property
    def address(self) -> str:
        return str(self.client.scheduler.address)

    def submit(self, name: str, plane: atlas.Spec = PLANE) -> str:
        (self.folder / "faults" / "log").write_text("")
        return submit(plane, self.folder / name, RunOptions(scheduler=self.address))

    def tiles_done(self, name: str) -> int:
        return read_status(open_store(self.folder / name)).tiles_done

    def ends(self, name: str) -> bool:
        found = read_status(open_store(self.folder / name))
        return found.fraction == 1 and found.run is None


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    folder = tmp_path_factory.mktemp("service")
    with pytest.MonkeyPatch.context() as patch:
        for name, value in environment(folder / "faults", {"*": ["slow"]}).items():
            patch.setenv(name, value)
        with (
            LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0") as made,
            Client(made, set_as_default=False) as client,
        ):
            yield Service(client, folder)


def call(*args: object) -> Result:
    return CliRunner().invoke(main, [str(arg) for arg in args])


def test_submit_leaves_while_tiles_are_due_and_the_cluster_finishes_them(service: Service) -> None:
    assert service.submit("alone.zarr") in service.client.nthreads()
    assert service.tiles_done("alone.zarr") < TILES
    until(lambda: service.ends("alone.zarr"))
    assert set(attempts(service.folder / "faults").values()) == {1}


def test_the_coordinator_starts_again_after_its_workers_death_and_redoes_nothing_stored(service: Service) -> None:
    where = service.submit("killed.zarr")
    until(lambda: service.tiles_done("killed.zarr") >= 3)
    os.kill(service.client.run(os.getpid)[where], signal.SIGKILL)
    until(lambda: service.ends("killed.zarr"))
    tried = attempts(service.folder / "faults")
    assert len(tried) == TILES
    assert tried.total() <= TILES + 2  # one under way on each worker
    assert (atlas.open(service.folder / "killed.zarr").regime.values != 6).all()


def pretend(solver_version: int) -> None:
    """Give this process another solver version."""
    for module in list(sys.modules.values()):
        if "SOLVER_VERSION" in vars(module):
            module.SOLVER_VERSION = solver_version  # type: ignore[attr-defined]


def test_a_coordinator_that_dask_starts_again_on_a_worker_of_another_solver_goes_on_on_a_fit_one(
    service: Service,
) -> None:
    where = service.submit("moved.zarr")
    (unfit,) = {*service.client.nthreads()} - {where}
    service.client.run(pretend, 99, workers=[unfit])
    try:
        os.kill(service.client.run(os.getpid, workers=[where])[where], signal.SIGKILL)
        until(lambda: service.ends("moved.zarr"))
    finally:
        service.client.run(pretend, SOLVER_VERSION, workers=[unfit])
    assert read_status(open_store(service.folder / "moved.zarr")).ended == ""


def test_two_jobs_share_a_scheduler_and_a_third_on_the_same_store_is_refused(service: Service) -> None:
    service.submit("one.zarr")
    service.submit("two.zarr")
    with pytest.raises(InputError, match=r"one.zarr: leased by another run \(process \d+ on "):
        service.submit("one.zarr")
    until(lambda: service.ends("one.zarr") and service.ends("two.zarr"))


def test_status_reports_the_run_at_work_and_cancel_stops_it(service: Service) -> None:
    store = service.folder / "cancelled.zarr"
    service.submit(store.name, plane_of((1, 1)))  # 35 tiles, about 6 s: a beat and a tick are 3 s
    until(lambda: read_status(open_store(store)).seconds_left is not None)
    message = json.loads(call("status", store, "--json").stdout)
    assert message["workers"] == 2
    assert message["run"].startswith("process ")
    assert message["cells_per_second"] > 0
    assert message["cells_pending"] == message["cells"] - message["cells_done"]
    ended = call("cancel", store)
    assert (ended.exit_code, ended.stdout.splitlines()[-1]) == (0, f"{store}: {message['run']} has stopped")
    kept = service.tiles_done(store.name)
    assert kept < 35
    until(lambda: not service.client.processing() or not any(service.client.processing().values()))
    assert service.tiles_done(store.name) <= kept + 2
    assert read_status(open_store(store)).run is None
    assert call("cancel", store).exit_code == 2


def test_watch_ends_with_the_atlas_never_goes_back_and_reads_no_chunk(service: Service) -> None:
    service.submit("watched.zarr")
    census = StatusReader(open_store(service.folder / "watched.zarr"))
    seen = list(watch(census, seconds=0.1))
    assert len(seen) > 3
    assert [s.tiles_done for s in seen] == sorted(s.tiles_done for s in seen)
    assert (seen[-1].fraction, sum(seen[-1].regimes.values())) == (1.0, 35)
    assert census.tiles_read == 0


def test_watch_gives_up_on_a_claim_that_stands_still(tmp_path: Path) -> None:
    store = create_store(tmp_path / "out.zarr", PLANE, (1, 3)).path
    sidecar_of(store).put(LEASE_NAME, LeaseRecord("theirs", 7, "far", 1, "another-boot pid:[1] 1 1").pack())
    seen = list(watch(StatusReader(open_store(store)), seconds=4.0, sleep=lambda _: None))
    assert all(status.run is not None for status in seen)
    assert len(seen) == 1 + TIMING.expire_after // 4 + 1


def test_status_reports_how_a_run_ended_that_nobody_watched(service: Service) -> None:
    script, store = service.folder / "faults" / "script.json", service.folder / "ended.zarr"
    before = script.read_text()
    script.write_text(json.dumps({"0-0": ["full"], "*": ["ok"]}))
    try:
        service.submit(store.name)
        until(lambda: read_status(open_store(store)).ended != "")
    finally:
        script.write_text(before)
    message = json.loads(call("status", store, "--json").stdout)
    assert "No space left on device; finished tiles are kept" in message["ended"]
    assert "none at work; the last one submitted ended: " in call("status", store).stdout
    service.submit(store.name)
    until(lambda: service.ends(store.name))
    assert json.loads(call("status", store, "--json").stdout)["ended"] is None


@pytest.fixture
def by_hand(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """A scheduler in a process of its own, and its address; a worker in another."""
    faults, file = environment(tmp_path / "faults", {"*": ["slow"]}), tmp_path / "scheduler.json"
    command = [sys.executable, "-m", "distributed.cli.{}", "--host", "127.0.0.1", "--no-dashboard", "--scheduler-file"]
    with (tmp_path / "log").open("w") as log:

        def start(what: str, *more: str) -> subprocess.Popen[bytes]:
            line = [word.format(what) for word in command]
            return subprocess.Popen([*line, str(file), *more], env=faults, stdout=log, stderr=log)

        with start("dask_scheduler", "--port", "0") as scheduler, start("dask_worker", "--no-nanny") as worker:
            try:
                until(file.exists)
                yield scheduler, json.loads(file.read_text())["address"]
            finally:
                scheduler.kill()
                worker.kill()


def test_a_killed_scheduler_leaves_a_word_for_the_status(
    by_hand: tuple[subprocess.Popen[bytes], str], tmp_path: Path
) -> None:
    scheduler, address = by_hand
    store = tmp_path / "lost.zarr"
    submit(plane_of((1, 1)), store, RunOptions(scheduler=address))
    scheduler.kill()
    until(lambda: read_status(open_store(store)).ended != "")
    found = read_status(open_store(store))
    assert found.fraction < 1
    assert "the cluster was lost; rerun the same command to resume from the stored tiles" in str(found)


def test_a_bad_submission_is_one_line_and_exit_code_2(service: Service, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    shown = call("run", "tiny", "--submit", "-o", tmp_path / "file" / "out.zarr", "--scheduler", service.address)
    assert shown.exit_code == 2
    assert "cannot be written" in shown.stderr.splitlines()[-1]
