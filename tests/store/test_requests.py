"""How many requests a server gets for each thing that is done with a store there, and which."""

import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
from click.testing import CliRunner
from distributed import Client

import atlas
from atlas.cli.main import main
from atlas.store.create import create_store
from atlas.store.object_backend import ObjectBackend
from atlas.store.sidecar import LEASE_NAME, sidecar_of
from atlas.store.store import open_store
from atlas.store.tiles import drop_tile
from atlas.task.store_ref import StoreRef
from atlas.task.tile_job import RunJob, run_tile_job
from tests.planes import plane_of
from tests.support.fake_object_store import FakeObjectStore, object_store

pytestmark = pytest.mark.slow
URL = "s3://bucket/plane.zarr"


@pytest.fixture(scope="module")
def served() -> Iterator[FakeObjectStore]:
    with object_store() as server, pytest.MonkeyPatch.context() as patch:
        for name, value in server.environment.items():
            patch.setenv(name, value)
        yield server


@pytest.fixture(scope="module")
def solved(served: FakeObjectStore, client: Client) -> FakeObjectStore:
    """The server with the finished store of a plane."""
    atlas.run(plane_of(), URL, client=client)
    return served


@pytest.fixture
def server(solved: FakeObjectStore) -> FakeObjectStore:
    solved.forget()
    return solved


def listings(server: FakeObjectStore) -> Counter[str]:
    """How often each listing was asked for."""
    return Counter(request.key.removeprefix("bucket/") for request in server.requests if request.kind == "list")


def command(*words: Any) -> str:
    ended = CliRunner().invoke(main, [*map(str, words)], catch_exceptions=False)
    assert ended.exit_code == 0, ended.output
    return ended.output


def test_a_finished_atlas_is_opened_by_two_requests(server: FakeObjectStore) -> None:
    atlas.open(URL)
    assert (sum(server.counts.values()), listings(server)) == (2, {})


def test_the_status_of_a_finished_atlas_takes_at_most_nine_requests_and_one_listing(server: FakeObjectStore) -> None:
    command("status", URL)
    assert sum(server.counts.values()) <= 9
    assert sum(listings(server).values()) <= 1


def test_a_query_takes_at_most_twenty_requests_and_one_listing(server: FakeObjectStore) -> None:
    command("query", URL)
    assert sum(server.counts.values()) <= 20
    assert sum(listings(server).values()) <= 1


@pytest.mark.parametrize("lost", [0, 1])
def test_a_run_that_resumes_lists_tiles_once(server: FakeObjectStore, client: Client, lost: int) -> None:
    for _ in range(lost):
        drop_tile(open_store(URL), (0, 0))
    server.forget()
    assert atlas.run(plane_of(), URL, client=client).tiles_solved == lost
    assert listings(server) == {"plane.zarr/regime/c/": 1}


def test_a_tile_is_written_without_the_metadata_of_each_array(server: FakeObjectStore, client: Client) -> None:
    handle = open_store(URL)
    drop_tile(handle, (0, 0))
    server.forget()
    atlas.run(plane_of(), URL, client=client)
    results = {
        f"bucket/plane.zarr/{variable.name}/zarr.json" for variable in handle.variables if variable != handle.regime
    }
    assert results.isdisjoint(request.key for request in server.requests)


def test_the_objects_of_a_new_store_are_put_many_at_once(served: FakeObjectStore) -> None:
    served.forget()
    served.delay(0.05)
    begin = time.perf_counter()
    create_store(ObjectBackend("s3://bucket/new.zarr"), plane_of(), (2, 3))
    seconds = time.perf_counter() - begin
    served.delay(0.0)
    assert seconds < 0.05 * served.counts["put"] / 2


def test_a_tile_reads_nothing_but_the_claim_of_its_run_and_twice_the_attributes_of_the_root(
    served: FakeObjectStore,
) -> None:
    """After the first tile of a process, which read the handle and opened the arrays."""
    url = "s3://bucket/tiles.zarr"
    handle = create_store(ObjectBackend(url), plane_of(), (2, 3))
    sidecar_of(url).put_new(LEASE_NAME, b'{"token": "ours"}')
    job = RunJob((0, 0), StoreRef(url, handle.run_id, handle.solver_version, lease="ours"))
    run_tile_job(job)
    served.forget()
    run_tile_job(replace(job, index=(1, 1)))
    read = Counter(request.key.removeprefix("bucket/") for request in served.requests if request.kind == "get")
    assert read == {".tiles.zarr.run/claim": 1, "tiles.zarr/spec/zarr.json": 2}
    assert sum(served.counts.values()) <= 34
