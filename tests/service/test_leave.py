"""Runs that nobody watches: a detached process, as of a batch system, and a task of the cluster itself.

Every tile takes 0.3 s, so that something can happen meanwhile.
"""

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from distributed import Client, LocalCluster, fire_and_forget

import atlas
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.service.lease import LeaseRecord
from atlas.service.status import StatusReader, read_status, watch
from atlas.service.timing import TIMING
from atlas.store.create import create_store
from atlas.store.sidecar import LEASE_NAME, sidecar_of
from atlas.store.store import find_store, open_store
from tests.planes import plane_of
from tests.polling import until
from tests.support.faults import ATLAS, attempts, environment

pytestmark = pytest.mark.slow

TILES = 35
PLANE = plane_of((1, 1))  # 35 tiles, 5 s with two workers: longer than the heartbeat of a lease, 3 s
SPEC = """
system = "two-mass"
[axes.omega]
start = 2.0
stop = 4.0
num = 30
[solve]
max_periods = 300
tolerance = 0.1
[store]
tile = [1]
"""


def tiles_done(store: Path) -> int:
    handle = find_store(store)
    return 0 if handle is None else read_status(handle).tiles_done


def ends(store: Path) -> bool:
    handle = find_store(store)
    found = None if handle is None else read_status(handle)
    return found is not None and found.fraction == 1 and found.run is None


@pytest.fixture
def left(tmp_path: Path) -> Iterator[Path]:
    """The store of a run in a process of its own, which nobody waits for."""
    (tmp_path / "spec.toml").write_text(SPEC)
    with (tmp_path / "run.log").open("w") as log:
        process = subprocess.Popen(
            [*ATLAS, "run", "spec.toml", "-o", "out.zarr", "--workers", "1"],
            cwd=tmp_path,
            env=environment(tmp_path / "faults", {"*": ["slow"]}),
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
    store = tmp_path / "out.zarr"
    try:
        until(lambda: tiles_done(store) >= 1)
        yield store
    finally:
        process.kill()
        process.wait()


def call(*args: object) -> Result:
    return CliRunner().invoke(main, [str(arg) for arg in args])


def test_a_detached_run_is_watched_to_its_end_by_its_store(left: Path) -> None:
    assert tiles_done(left) < 30
    seen = list(watch(StatusReader(open_store(left)), seconds=0.1))
    assert [status.tiles_done for status in seen] == sorted(status.tiles_done for status in seen)
    assert (seen[-1].fraction, seen[-1].run) == (1.0, None)
    assert "30 of 30 tiles done" in (left.parent / "run.log").read_text()


def test_status_reports_a_detached_run_and_cancel_stops_it(left: Path) -> None:
    until(lambda: read_status(open_store(left)).seconds_left is not None)
    message = json.loads(call("status", left, "--json").stdout)
    assert (message["workers"], message["run"][:8]) == (1, "process ")
    assert message["cells_pending"] == message["cells"] - message["cells_done"]
    ended = call("cancel", left)
    assert (ended.exit_code, ended.stdout.splitlines()[-1]) == (0, f"{left}: {message['run']} has stopped")
    assert read_status(open_store(left)).run is None
    assert "stopped by atlas cancel; finished tiles are kept" in (left.parent / "run.log").read_text()
    assert call("cancel", left).exit_code == 2


# The coordinator as a task of the cluster


@dataclass(frozen=True)
class Service:
    """A scheduler with two workers of one thread, and a folder."""

    client: Client
    folder: Path

    def leave(self, name: str) -> Path:
        """Leave a run to the cluster, by a client that goes; return its store once a tile is done."""
        (self.folder / "faults" / "log").write_text("")
        store = self.folder / name
        with Client(self.client.scheduler.address, set_as_default=False) as client:
            fire_and_forget(client.submit(atlas.run, PLANE, str(store), pure=False))
        assert not ends(store)  # the client goes while the run begins
        until(lambda: tiles_done(store) >= 1)
        return store


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


def test_a_cluster_finishes_a_run_whose_client_is_gone(service: Service) -> None:
    store = service.leave("alone.zarr")
    until(lambda: ends(store))
    assert set(attempts(service.folder / "faults").values()) == {1}


def test_the_coordinator_starts_again_after_its_workers_death_and_redoes_nothing_stored(service: Service) -> None:
    store = service.leave("killed.zarr")
    until(lambda: tiles_done(store) >= 3)
    run = read_status(open_store(store)).run
    assert run is not None
    os.kill(run.pid, signal.SIGKILL)
    until(lambda: ends(store))
    tried = attempts(service.folder / "faults")
    assert len(tried) == TILES
    assert tried.total() <= TILES + 4  # those in flight
    assert (atlas.open(store).regime.values != 6).all()


def test_two_runs_share_a_scheduler_and_a_third_on_the_same_store_is_refused(service: Service) -> None:
    one, two = service.leave("one.zarr"), service.leave("two.zarr")
    with pytest.raises(InputError, match=r"one.zarr: leased by another run \(process \d+ on "):
        atlas.run(PLANE, one, service.client)
    until(lambda: ends(one) and ends(two))


def test_watch_gives_up_on_a_lease_that_stands_still(tmp_path: Path) -> None:
    store = create_store(tmp_path / "out.zarr", PLANE, (1, 3)).path
    sidecar_of(store).put_new(LEASE_NAME, LeaseRecord("theirs", 7, "far", 1, "another-boot pid:[1] 1 1").pack())
    seen = list(watch(StatusReader(open_store(store)), seconds=4.0, sleep=lambda _: None))
    assert all(status.run is not None for status in seen)
    assert len(seen) == 1 + TIMING.expire_after // 4 + 1
