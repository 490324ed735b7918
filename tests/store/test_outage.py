"""An object store that is away for a while, or for good; and what is asked of each kind of store."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import obstore
import pytest
from click.testing import CliRunner
from distributed import Client
from obstore.exceptions import GenericError

import atlas
from atlas.cli.main import main
from atlas.errors import InputError, NetworkError, RunError
from atlas.service.lease import hold_lease
from atlas.service.timing import Timing
from atlas.store import outage
from atlas.store.create import create_store
from atlas.store.object_backend import ObjectBackend
from atlas.store.sidecar import LEASE_NAME, clear_sidecar, read_lease_token, sidecar_of
from atlas.store.store import done_tiles, open_store
from atlas.task.store_ref import StoreRef, WorkerRefusedError
from atlas.task.tile_job import RunJob, run_tile_job
from tests.planes import find, plane_of
from tests.support.fake_object_store import FakeObjectStore, InjectedFault, object_store
from workers.results import REGIME

pytestmark = pytest.mark.slow
URL = "s3://bucket/plane.zarr"


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeObjectStore]:
    with object_store() as served:
        for name, value in served.environment.items():
            monkeypatch.setenv(name, value)
        yield served


def test_the_server_answers_after_its_delay_and_many_at_once(server: FakeObjectStore) -> None:
    place, keys = ObjectBackend(URL), [f"x/{k}" for k in range(64)]
    server.put({f"bucket/plane.zarr/{key}": key.encode() for key in keys})
    server.delay(0.2)
    begin = time.perf_counter()
    assert len(place.get_all(keys)) == 64
    assert 0.2 <= time.perf_counter() - begin < 0.2 * 64 / 4
    assert server.counts == {"get": 64}


def test_the_server_gives_parts_of_objects_and_pages_of_keys(server: FakeObjectStore) -> None:
    place = ObjectBackend(URL)
    server.put({f"bucket/plane.zarr/x/{k:04}": b"0123456789" for k in range(2001)})
    assert bytes(obstore.get_range(place.client, "x/0000", start=2, end=5)) == b"234"
    assert bytes(obstore.get(place.client, "x/0000", options={"range": {"suffix": 3}}).bytes()) == b"789"
    assert list(place.list_keys("x/")) == [f"x/{k:04}" for k in range(2001)]
    assert server.counts == {"get": 2, "list": 3}


def arrays_of(where: object) -> dict[str, bytes]:
    ds = atlas.open(where)  # type: ignore[arg-type]
    return {str(name): ds[name].values.tobytes() for name in ds.variables}


@pytest.mark.parametrize("how", [503, 429, "drop", "lost"])
def test_every_operation_of_a_place_outlives_an_outage(server: FakeObjectStore, how: int | str) -> None:
    place = ObjectBackend(URL)

    def after_outage(operation: object, *args: object) -> object:
        server.trouble = InjectedFault(0, 1, how)
        done = operation(*args)  # type: ignore[operator]
        assert server.trouble.left == 0
        return done

    after_outage(place.put, "a/b", b"1")
    assert after_outage(place.get, "a/b") == b"1"
    assert after_outage(place.exists, "a/b")
    assert after_outage(lambda: list(place.list_keys("a/"))) == ["a/b"]
    assert after_outage(place.put_new, "a/c", b"2")
    assert not after_outage(place.put_new, "a/c", b"3")
    after_outage(place.commit, "a/c", b"4")
    assert after_outage(place.get, "a/c", slice(-1, None)) == b"4"
    after_outage(place.remove, "a/b")
    assert list(place.list_keys()) == ["a/c"]


@pytest.mark.parametrize("url", ["s3://bucket/plane.zarr", "gs://bucket/plane.zarr"])
def test_objects_that_are_got_or_removed_together_outlive_an_outage(server: FakeObjectStore, url: str) -> None:
    place, keys = ObjectBackend(url), [f"x/{k}" for k in range(5)]
    for key in keys:
        place.put(key, key.encode())
    server.trouble = InjectedFault(0, 3)
    assert place.get_all(keys) == {key: key.encode() for key in keys}
    server.trouble = InjectedFault(0, 1, "lost")
    place.remove_all([*keys, "x/none"])
    assert server.trouble.left == 0
    assert list(place.list_keys()) == []


def test_thousands_of_objects_are_removed_by_a_few_requests(server: FakeObjectStore) -> None:
    server.put({f"bucket/plane.zarr/{k}": b"1" for k in range(2500)})
    server.forget()
    ObjectBackend(URL).remove_all(list(ObjectBackend(URL).list_keys()))
    assert server.counts == {"list": 3, "delete many": 3}
    assert not server.objects


def test_a_claim_that_is_released_leaves_nothing(server: FakeObjectStore) -> None:
    with hold_lease(sidecar_of(URL), URL):
        assert [*server.objects] == [f"bucket/.plane.zarr.run/{LEASE_NAME}"]
    assert not server.objects


def test_a_release_whose_answer_is_lost_leaves_the_claim_of_the_next_run_alone(server: FakeObjectStore) -> None:
    with (
        hold_lease(sidecar_of(URL), URL, timing=Timing(heartbeat=600.0)) as claim,
        pytest.MonkeyPatch.context() as patch,
    ):
        remove = ObjectBackend.remove_all

        def lost(place: ObjectBackend, keys: list[str]) -> None:
            remove(place, keys)
            place.put_new(LEASE_NAME, b'{"token": "next"}')
            raise NetworkError("no answer")

        patch.setattr(ObjectBackend, "remove_all", lost)
        claim.release()
    assert read_lease_token(sidecar_of(URL)) == "next"


def test_a_process_has_one_client_of_a_place(server: FakeObjectStore) -> None:
    assert ObjectBackend(URL).client is ObjectBackend(URL, patience=3.0).client
    assert ObjectBackend(URL).client is ObjectBackend(URL).with_lease(lambda: None).client


def test_zarr_outlives_an_outage_too(server: FakeObjectStore) -> None:
    handle = create_store(ObjectBackend(URL), plane_of(), (2, 3))
    server.trouble = InjectedFault(0, 7)
    array = handle.arrays[REGIME.name]
    assert (np.asarray(array[...]) == -1).all()
    assert server.trouble.left == 0


@pytest.mark.parametrize("how", [503, "drop"])
def test_a_run_outlives_an_outage_and_has_the_bits_of_an_undisturbed_one(
    server: FakeObjectStore, solved_plane: Path, client: Client, how: int | str
) -> None:
    server.trouble = InjectedFault(3, 8, how)
    summary = atlas.run(plane_of(), URL, client=client)
    assert server.trouble.left == 0
    assert (summary.tiles_done, summary.failures, dict(summary.refused)) == (9, (), {})
    assert arrays_of(URL) == arrays_of(solved_plane)


def test_a_store_that_stays_away_ends_the_run_in_words_and_the_same_line_goes_on(
    server: FakeObjectStore, solved_plane: Path, client: Client
) -> None:
    server.trouble = InjectedFault(4, np.inf)
    words = rf"for example inproc://\S+: {URL}: no answer for \d+ s \(.*503.*\); finished tiles are kept"
    with pytest.raises(RunError, match=words):
        atlas.run(plane_of(), ObjectBackend(URL, patience=0.1), client=client, options=atlas.RunOptions(patience=0.3))
    server.trouble = InjectedFault()
    kept = len(done_tiles(open_store(URL)))
    assert kept == 3
    clear_sidecar(
        sidecar_of(URL), [LEASE_NAME]
    )  # this very process left its claim, so that nobody can tell that its run is over
    assert atlas.run(plane_of(), URL, client=client).tiles_solved == 9 - kept
    assert arrays_of(URL) == arrays_of(solved_plane)


def test_a_header_that_cannot_be_reached_is_a_fault_of_the_network_and_not_of_the_path(server: FakeObjectStore) -> None:
    handle = create_store(ObjectBackend(URL), plane_of(), (2, 3))
    job = RunJob((0, 0), StoreRef(URL, handle.run_id, handle.solver_version, patience=0.0))
    server.trouble = InjectedFault(0, np.inf)
    with pytest.raises(NetworkError, match=rf"^{URL}: no answer for 0 s \(.*503 Service Unavailable\)$"):
        run_tile_job(job)
    with pytest.raises(NetworkError):
        find(ObjectBackend(URL, patience=0.0), plane_of())


def test_a_server_that_refuses_a_worker_is_named_without_a_word_about_paths(server: FakeObjectStore) -> None:
    handle = create_store(ObjectBackend(URL), plane_of(), (2, 3))
    server.trouble, before = InjectedFault(0, np.inf, 403), len(server.requests)
    with pytest.raises(WorkerRefusedError, match=r"403 Forbidden$"):
        run_tile_job(RunJob((0, 0), StoreRef(URL, handle.run_id, handle.solver_version)))
    assert len(server.requests) == before + 1  # waiting would not mend it
    with pytest.raises(InputError, match=rf"{URL}: cannot be read: "):
        open_store(URL)


@pytest.mark.parametrize(
    "operation",
    [
        lambda place: place.get("a"),
        lambda place: place.put("a", b"1"),
        lambda place: place.put_new("a", b"1"),
        lambda place: place.remove_all(["a"]),
        lambda place: [*place.list_keys()],
    ],
    ids=["get", "put", "put_new", "remove_all", "list"],
)
def test_an_expired_credential_is_named_and_is_no_fault_of_an_object(server: FakeObjectStore, operation: Any) -> None:
    server.trouble = InjectedFault(0, np.inf, "expired")
    said = r"400 Bad Request \(ExpiredToken: The provided token has expired\.\)$"
    with pytest.raises(PermissionError, match=said):
        operation(ObjectBackend(URL))
    with pytest.raises(PermissionError, match=r"400 Bad Request; check that the credentials are still valid$"):
        ObjectBackend(URL).exists("a")  # the answer to HEAD has no body


def test_a_credential_that_expires_gives_up_no_tile_and_the_same_line_goes_on(
    server: FakeObjectStore, solved_plane: Path, client: Client
) -> None:
    server.trouble = InjectedFault(4, np.inf, "expired")
    words = rf"for example inproc://\S+: {URL}: .*400 Bad Request.*; finished tiles are kept, rerun the"
    with pytest.raises(RunError, match=words):
        atlas.run(plane_of(), URL, client=client)
    server.trouble = InjectedFault()
    kept = len(done_tiles(open_store(URL)))
    clear_sidecar(
        sidecar_of(URL), [LEASE_NAME]
    )  # this very process left its claim, so that nobody can tell that its run is over
    summary = atlas.run(plane_of(), URL, client=client)
    assert (summary.tiles_solved, summary.failures) == (9 - kept, ())
    assert arrays_of(URL) == arrays_of(solved_plane)


def test_a_request_that_a_server_timed_out_is_made_again() -> None:
    """S3 answers 400 to it."""
    answer = "status code: 400 Bad Request: <?xml ?>\n<Error><Code>RequestTimeout</Code></Error>\n\nDebug source:\nx"
    answers = iter([GenericError(answer)])

    def upload() -> str:
        for error in answers:
            raise error
        return "done"

    assert outage.retry_call(upload, URL, patience=30.0) == "done"


def test_an_outage_begins_with_the_first_failure_and_not_with_the_request(monkeypatch: pytest.MonkeyPatch) -> None:
    """A request that was under way for longer than the patience is made again when it fails."""
    now, asked = [0.0], []

    def upload() -> str:
        asked.append(now[0])
        now[0] += 60.0
        if len(asked) == 1:
            raise GenericError("HTTP error: error sending request")
        return "done"

    def sleep(seconds: float) -> None:
        now[0] += seconds

    monkeypatch.setattr(outage.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(outage.time, "sleep", sleep)
    assert outage.retry_call(upload, URL, patience=30.0) == "done"
    assert len(asked) == 2


def test_a_job_at_a_url_looks_at_the_claim_once_right_before_it_finishes_its_tile(server: FakeObjectStore) -> None:
    handle = create_store(ObjectBackend(URL), plane_of(), (2, 3))
    job = RunJob((0, 0), StoreRef(URL, handle.run_id, handle.solver_version, lease="ours"))
    sidecar_of(URL).put_new(LEASE_NAME, b'{"token": "ours"}')
    before = len(server.requests)
    run_tile_job(job)
    asked = [(request.method, request.key) for request in server.requests[before:]]
    look = ("GET", "bucket/.plane.zarr.run/claim")
    assert asked.count(look) == 1
    assert asked[asked.index(look) + 1] == ("PUT", "bucket/plane.zarr/regime/c/0/0")


def test_a_claim_lost_while_the_server_was_away_is_seen_before_the_next_attempt_at_a_commit(
    server: FakeObjectStore,
) -> None:
    """Truth: the objects' generations. The lease is held at the first look; the first attempt at the commit fails."""
    server.put({"bucket/plane.zarr/a": b"1"})
    before, looks = server.objects, list[int]()

    def confirm() -> None:
        looks.append(1)
        if len(looks) > 1:
            raise RunError("lost")
        server.trouble = InjectedFault(0, 1)

    with pytest.raises(RunError, match="lost"):
        ObjectBackend(URL).with_lease(confirm).commit("a", b"2")
    assert (server.objects, server.trouble.left) == (before, 0)


def test_nobody_listening_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    with object_store() as gone:
        for name, value in gone.environment.items():
            monkeypatch.setenv(name, value)
    with pytest.raises(NetworkError, match=rf"{URL}: no answer for \d+ s \(.*error sending request\)"):
        ObjectBackend(URL, patience=0.2).get("x")


@pytest.mark.parametrize("command", ["status", "query", "verify"])
def test_a_command_whose_server_does_not_answer_fails_in_one_line(
    command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def away(*_: object) -> None:
        raise NetworkError(f"{URL}: no answer for 15 s (why)")

    with object_store() as gone:
        for name, value in gone.environment.items():
            monkeypatch.setenv(name, value)
    for operation in ("exists", "get", "list_keys"):
        monkeypatch.setattr(ObjectBackend, operation, away)
    ended = CliRunner().invoke(main, [command, URL])
    assert (ended.exit_code, ended.stderr.splitlines()[-1]) == (1, f"Error: {URL}: no answer for 15 s (why)")


@pytest.mark.parametrize(
    ("url", "absent"),
    [
        ("s3://bucket/plane.zarr", ("if-none-match", "*")),
        ("gs://bucket/plane.zarr", ("x-goog-if-generation-match", "0")),
        ("az://bucket/plane.zarr", ("if-none-match", "*")),
    ],
)
def test_a_claim_is_made_under_the_condition_that_each_kind_of_store_knows(
    server: FakeObjectStore, url: str, absent: tuple[str, str]
) -> None:
    with hold_lease(sidecar_of(url), url, timing=Timing(heartbeat=600.0)):
        put = next(request for request in server.requests if request.method == "PUT")
        assert (put.key, put.headers[absent[0]]) == ("bucket/.plane.zarr.run/claim", absent[1])
        assert not sidecar_of(url).put_new(LEASE_NAME, b"2")


def test_a_run_on_googles_store_has_the_bits_of_a_local_one(
    server: FakeObjectStore, solved_plane: Path, client: Client
) -> None:
    assert atlas.run(plane_of(), "gs://bucket/plane.zarr", client=client).tiles_done == 9
    assert arrays_of("gs://bucket/plane.zarr") == arrays_of(solved_plane)
