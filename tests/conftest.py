"""What several test files share: one in-process Dask client, a small plane, and its store."""

import gc
import json
import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import dask
import pytest
from distributed import Client, LocalCluster

import atlas
from atlas.service import cluster
from atlas.task.compile import YOUNG_OBJECTS
from tests.planes import plane_of
from tests.support.browser import started

dask.config.set({"distributed.worker.profile.enabled": False})  # as local_cluster does, for clusters in this process
gc.set_threshold(YOUNG_OBJECTS)
cluster.DASHBOARD = "127.0.0.1:0"  # several tests at once: at a port that is taken Dask leaves a socket open

HERE = Path(__file__).parent
DURATIONS = HERE / "durations.json"
"""For each stage, by the expression of its marks, the seconds of each file that takes one or more, the longest first.

Null where none were measured yet.
"""
MEMORY, ROOM = Path("/dev/shm"), 4 * 2**30
"""A folder in memory, and the free bytes that it has to have: a stage keeps up to 1.5 GB there."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """``scripts/test --record-durations`` and ``scripts/test slow --record-durations`` measure a stage anew."""
    parser.addoption("--record-durations", action="store_true", help="write tests/durations.json")


class Durations:
    """Adds up the seconds of each file and writes them; files that this session leaves out keep theirs."""

    def __init__(self, stage: str) -> None:
        self.stage, self.seconds = stage, Counter[str]()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """With xdist the process that hands out the tests gets the reports of all."""
        self.seconds[report.nodeid.partition("::")[0].removeprefix("tests/")] += report.duration

    def pytest_sessionfinish(self) -> None:
        stages = json.loads(DURATIONS.read_text())
        known = {name: seconds for name, seconds in stages.get(self.stage, {}).items() if (HERE / name).exists()}
        found = known | {name: round(seconds, 1) for name, seconds in self.seconds.items()}
        longest = sorted(found, key=lambda name: -(found[name] or 0.0))
        stages[self.stage] = {name: found[name] for name in longest if found[name] is None or found[name] >= 1.0}
        DURATIONS.write_text(json.dumps(stages, indent=1) + "\n")


def pytest_configure(config: pytest.Config) -> None:
    """Stores are thousands of small files: temporary folders are in memory if it holds them and may run programs."""
    if MEMORY.is_dir() and shutil.disk_usage(MEMORY).free > ROOM and not os.statvfs(MEMORY).f_flag & os.ST_NOEXEC:
        os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(MEMORY))
    if config.getoption("record_durations") and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Durations(config.option.markexpr))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """The longest files first, all others as they were found: begun last they would keep one worker busy alone."""
    longest = json.loads(DURATIONS.read_text()).get(config.option.markexpr, {})
    places = {name: place for place, name in enumerate(longest)}
    items.sort(key=lambda item: places.get(item.path.relative_to(HERE).as_posix(), len(places)))
    gc.collect()
    gc.freeze()  # all modules and tests: every later search would go through them


@pytest.fixture(scope="session")
def client() -> Iterator[Client]:
    """Two threads of this process as a cluster."""
    with Client(
        processes=False, n_workers=1, threads_per_worker=2, dashboard_address="127.0.0.1:0", set_as_default=False
    ) as made:
        yield made


@pytest.fixture
def two_workers() -> Iterator[Client]:
    """A cluster of two workers of one thread in this process, of its own for each test."""
    with (
        LocalCluster(processes=False, n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0") as local,
        Client(local, set_as_default=False) as made,
    ):
        yield made


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """One browser for all tests of a file."""
    with started() as made:
        yield made


@pytest.fixture(scope="module")
def running(client: Client) -> Iterator[Any]:
    """An explorer of the packaged plane, for all tests of a file."""
    from atlas.explore.session import explore

    made = explore("omega-b", client=client)
    yield made
    made.stop()


@pytest.fixture(scope="module")
def one_processor() -> Iterator[None]:
    """One for this process and those it starts: local clusters of one worker, since each takes seconds to start."""
    allowed = sorted(os.sched_getaffinity(0))
    number = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])
    os.sched_setaffinity(0, {allowed[number % len(allowed)]})
    yield
    os.sched_setaffinity(0, allowed)


@pytest.fixture(scope="session")
def solved_once(tmp_path_factory: pytest.TempPathFactory, client: Client) -> Callable[[atlas.Spec], Path]:
    """The store of a spec after a run, only to be read; each spec is run once for all files that ask for it."""
    stores: dict[tuple[object, ...], Path] = {}

    def store_of(spec: atlas.Spec) -> Path:
        key = spec.digest, spec.tile
        if key not in stores:
            stores[key] = tmp_path_factory.mktemp("solved") / "out.zarr"
            atlas.run(spec, stores[key], client=client)
        return stores[key]

    return store_of


@pytest.fixture(scope="session")
def solved_plane(solved_once: Callable[[atlas.Spec], Path]) -> Path:
    """The store of ``plane`` after a run, only to be read."""
    return solved_once(plane_of())


@pytest.fixture
def finished(solved_plane: Path, tmp_path: Path) -> Path:
    """The store of ``plane`` after a run, of its own for each test: out.zarr in ``tmp_path``."""
    return Path(shutil.copytree(solved_plane, tmp_path / "out.zarr"))


@pytest.fixture
def plane() -> atlas.Spec:
    """7 x 5 cells in tiles of 3 x 2, cheap to solve."""
    return plane_of()
