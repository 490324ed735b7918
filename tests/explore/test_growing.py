"""Clusters that grow with their work and begin without a worker, and the client that the caller has open."""

import time
from collections.abc import Iterator
from contextlib import nullcontext
from functools import partial
from pathlib import Path

import pytest
from distributed import Client, LocalCluster

import atlas
from atlas.errors import InputError, RunError
from atlas.explore.explorer import Explorer
from atlas.explore.session import _connection
from atlas.explore.subject import subject_of
from atlas.service.cluster import count_threads
from atlas.service.dispatch import Dispatcher, WorkerStatus
from atlas.service.progress import Progress
from atlas.service.timing import TIMING, Timing
from tests.explore.test_faults import begun
from tests.explore.test_solving import waited
from tests.fake_cluster import Numbered
from tests.planes import plane_of

WAITING = "waiting for the cluster's first worker"


@pytest.fixture
def growing() -> Iterator[Client]:
    """A cluster without a worker, which gets up to four while it has work."""
    with (
        LocalCluster(processes=False, n_workers=0, threads_per_worker=1, dashboard_address="127.0.0.1:0") as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        cluster.adapt(minimum=0, maximum=4, interval="100ms")
        yield client


@pytest.fixture
def empty() -> Iterator[Client]:
    """A cluster without a worker, which gets none by itself."""
    with (
        LocalCluster(processes=False, n_workers=0, threads_per_worker=1, dashboard_address="127.0.0.1:0") as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        yield client


def test_a_run_on_a_cluster_that_starts_workers_for_work_alone_ends(tmp_path: Path, growing: Client) -> None:
    """Truth: by the documented recipe, cluster.adapt(), no worker came, and the run gave up."""
    told: list[Progress] = []
    timing = Timing(poll=0.05, tick=0.1)
    assert not growing.nthreads()
    summary = atlas.run(plane_of(), tmp_path / "out.zarr", growing, on_progress=told.append, timing=timing)
    assert (summary.tiles_done, summary.failures) == (9, ())
    assert told[0].stage == WAITING


def test_a_run_waits_for_a_worker_for_as_long_as_it_takes_and_says_for_how_long(empty: Client) -> None:
    assert atlas.RunOptions().wait == float("inf")
    waited_for: list[float] = []

    def waiting(seconds: float) -> None:
        waited_for.append(seconds)
        if len(waited_for) == 5:
            empty.cluster.scale(2)

    assert count_threads(empty, waiting, poll=0.05) in (1, 2)
    assert len(waited_for) >= 5
    assert waited_for == sorted(waited_for)
    assert waited_for[4] >= 0.2


def test_a_limit_of_the_users_ends_the_wait_for_a_worker_and_takes_the_work_back(tmp_path: Path, empty: Client) -> None:
    with pytest.raises(InputError, match=r"^the scheduler has no worker after 0\.2 s; start one: dask worker ADDRESS$"):
        atlas.run(plane_of(), tmp_path / "out.zarr", empty, wait=0.2, timing=Timing(poll=0.05))
    assert list(tmp_path.iterdir()) == []
    assert waited(lambda: not empty.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks)))


def test_a_cluster_that_is_lost_while_it_has_no_worker_ends_the_wait(empty: Client) -> None:
    with pytest.raises(RunError, match="the cluster was lost"):
        count_threads(empty, lambda _: empty.cluster.close(), poll=0.05)


def brief(job: Numbered) -> tuple[int, ...]:
    """A job that is shorter than what Dask starts a worker for."""
    time.sleep(0.3)
    return job.index


def test_a_cluster_grows_to_its_largest_for_many_short_jobs(growing: Client) -> None:
    """Two jobs of .3 s under way are too few for Dask to start a second worker, though hundreds wait here."""
    seen: list[int] = []

    class GrownError(Exception):
        """It has."""

    def tick(workers: WorkerStatus) -> None:
        seen.append(workers.threads)
        if workers.threads == 4:
            raise GrownError

    jobs = (Numbered((k,)) for k in range(400))
    with pytest.raises(GrownError):
        for _ in Dispatcher(growing, brief, Timing(tick=0.1)).iter_outcomes(jobs, tick):
            pass
    assert seen[0] == 0


def test_an_explorer_starts_workers_of_a_growing_cluster(finished: Path, growing: Client) -> None:
    explorer = Explorer(subject_of(str(finished)), partial(nullcontext, growing))
    try:
        begun(explorer, 30)
        assert waited(lambda: bool(growing.nthreads()))
    finally:
        explorer.stop()


@pytest.fixture
def opened() -> Iterator[Client]:
    """A client that the caller has open, as in a notebook."""
    with Client(processes=False, n_workers=1, threads_per_worker=2, dashboard_address="127.0.0.1:0") as client:
        yield client


def test_a_run_uses_the_client_that_is_open_and_says_so_in_one_line(tmp_path: Path, opened: Client) -> None:
    told: list[str] = []
    summary = atlas.run(plane_of(), tmp_path / "out.zarr", on_progress=lambda progress: told.append(progress.stage))
    assert (summary.tiles_done, summary.workers) == (9, 2)
    assert told[0] == f"using the active Dask client, connected to {opened.scheduler.address}"
    assert not any("starting" in stage and "worker" in stage for stage in told)
    assert opened.status == "running"


def test_an_explorer_uses_the_client_that_is_open(opened: Client) -> None:
    with _connection(None, None, None, TIMING)() as client:
        assert client is opened
    assert opened.status == "running"


@pytest.mark.slow
def test_a_number_of_workers_asks_for_processes_of_their_own_beside_an_open_client(
    tmp_path: Path, opened: Client
) -> None:
    told: list[str] = []
    atlas.run(plane_of(), tmp_path / "out.zarr", workers=1, on_progress=lambda progress: told.append(progress.stage))
    assert "starting 1 worker" in told
