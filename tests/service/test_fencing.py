"""A run that has lost its claim of a store writes nothing more into it: neither its jobs nor its coordinator.

Truth: the bytes of the store before and after.
"""

import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import zarr
from distributed import Client
from zarr.core.sync import sync

import atlas
from atlas.check import repair as repairing
from atlas.errors import RunError
from atlas.overview.builder import OverviewBuilder
from atlas.service.lease import Lease, LeaseRecord
from atlas.service.progress import Progress
from atlas.spec.extension import refine_spec
from atlas.store import sidecar
from atlas.store.create import create_store
from atlas.store.object_backend import AT_ONCE, LocalBackend, StoreBackend, open_backend
from atlas.store.origin import Origin, RetryRequest
from atlas.store.record_format import RECORDS
from atlas.store.sidecar import LEASE_NAME, sidecar_of
from atlas.store.store import done_tiles, open_store
from atlas.store.tile_records import TileRecords, write_records
from atlas.store.zarr_stores import zarr_store
from atlas.task import attempt, store_ref
from atlas.task.attempt import run_tile_job
from atlas.task.store_ref import StoreRef, WorkerRefusedError
from atlas.task.tile_job import RunJob
from tests.planes import plane_of
from tests.support.fake_object_store import FakeObjectStore, InjectedFault, object_store
from workers import tile as solving
from workers.settings import MAX_PERIODS

LOST = "the run that sent this job has lost its lease; nothing more is written"
OURS = LeaseRecord("ours", 3, "here", 1, "")
THEIRS = replace(OURS, token="theirs", host="far")


def contents(store: Path) -> dict[str, bytes]:
    """Every object of a store but the list of machines, which anybody may add to."""
    keys = (key for key in LocalBackend(store).list_keys() if not key.startswith("hosts/"))
    return {key: (store / key).read_bytes() for key in keys}


def take_over(store: Path) -> None:
    """Replace our claim of a store by that of another run."""
    assert sidecar_of(store).compare_and_set(LEASE_NAME, THEIRS.pack(), expected=OURS.pack())


def claimed_job(store: Path, index: tuple[int, ...]) -> RunJob:
    handle = open_store(store)
    sidecar_of(store).compare_and_set(LEASE_NAME, OURS.pack(), expected=None)
    return RunJob(index, StoreRef(str(store), handle.run_id, handle.solver_version, lease=OURS.token))


def new_store(folder: Path, _: Path) -> RunJob:
    return claimed_job(create_store(folder / "new.zarr", plane_of(), (2, 3)).path, (1, 1))


def retried_store(folder: Path, finished: Path) -> RunJob:
    handle = open_store(finished)
    origin = Origin(str(finished), handle.run_id, RetryRequest(("periodic",), max_periods=MAX_PERIODS))
    return claimed_job(create_store(folder / "again.zarr", handle.spec, handle.tile, origin).path, (1, 1))


def extended_store(folder: Path, finished: Path) -> RunJob:
    spec = refine_spec(open_store(finished).spec, 2)
    origin = Origin(str(finished), open_store(finished).run_id)
    return claimed_job(create_store(folder / "finer.zarr", spec, (2, 3), origin).path, (1, 1))


JOBS: dict[str, Callable[[Path, Path], RunJob]] = {
    "of a plain run": new_store,
    "of a retry": retried_store,
    "of an extension": extended_store,
}


@pytest.mark.parametrize("kind", JOBS)
def test_a_job_that_sleeps_through_a_lost_claim_writes_nothing(
    tmp_path: Path, finished: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    job = JOBS[kind](tmp_path, finished)
    store, whole = Path(job.store_ref.store), solving.solve_tile
    before: dict[str, bytes] = {}

    def slow(*given: Any) -> Any:
        take_over(store)
        before.update(contents(store))
        return whole(*given)

    monkeypatch.setattr(solving, "solve_tile", slow)
    with pytest.raises(WorkerRefusedError, match=LOST):
        run_tile_job(job)
    assert contents(store) == before


@pytest.mark.parametrize("kind", JOBS)
def test_a_job_whose_run_holds_the_claim_writes_its_tile(tmp_path: Path, finished: Path, kind: str) -> None:
    job = JOBS[kind](tmp_path, finished)
    before = contents(Path(job.store_ref.store))
    assert run_tile_job(job).cells > 0
    assert contents(Path(job.store_ref.store)) != before
    assert job.index in done_tiles(open_store(job.store_ref.store))


@pytest.mark.parametrize(
    "claim", [b"", b"{", b"[]", b'{"token": "theirs"}'], ids=["none", "torn", "strange", "another"]
)
def test_a_job_without_a_claim_in_the_store_writes_nothing(tmp_path: Path, finished: Path, claim: bytes) -> None:
    job = new_store(tmp_path, finished)
    sidecar_of(job.store_ref.store).compare_and_remove(LEASE_NAME, OURS.pack())
    if claim:
        sidecar_of(job.store_ref.store).compare_and_set(LEASE_NAME, claim, expected=None)
    with pytest.raises(WorkerRefusedError, match=LOST):
        run_tile_job(job)
    assert done_tiles(open_store(job.store_ref.store)) == set()


@pytest.mark.parametrize("kind", JOBS)
@pytest.mark.parametrize("after", ["largest", "periods_used"])
def test_a_job_that_loses_the_claim_while_it_writes_does_not_commit_its_tile(
    tmp_path: Path, finished: Path, monkeypatch: pytest.MonkeyPatch, kind: str, after: str
) -> None:
    job = JOBS[kind](tmp_path, finished)
    store, whole = Path(job.store_ref.store), zarr.Array.__setitem__
    before: dict[str, bytes] = {}

    def stopped(array: zarr.Array[Any], key: Any, value: Any) -> None:
        whole(array, key, value)
        if array.basename == after:
            take_over(store)
            before.update(contents(store))

    monkeypatch.setattr(zarr.Array, "__setitem__", stopped)
    with pytest.raises(WorkerRefusedError, match=LOST):
        run_tile_job(job)
    assert job.index not in done_tiles(open_store(store))
    written = {key.partition("/")[0] for key, data in contents(store).items() if before.get(key) != data}
    assert "regime" not in written


def test_each_write_of_a_tile_is_preceded_by_one_look_at_the_claim_and_one_at_the_attempt(
    tmp_path: Path, finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job, looks, writes = new_store(tmp_path, finished), Counter[str](), Counter[str]()
    run_tile_job(replace(job, index=(0, 0)))  # the first of a process records its machine
    put, remove, token_of = LocalBackend.put, LocalBackend.remove, sidecar.token_fence

    def counted(place: Any, name: str, *rest: Any) -> Any:
        look = token_of(place, name, *rest)
        return lambda: (looks.update([name]), look())

    monkeypatch.setattr(store_ref, "token_fence", counted)
    monkeypatch.setattr(LocalBackend, "put", lambda place, key, data: (writes.update([key]), put(place, key, data)))
    monkeypatch.setattr(LocalBackend, "remove", lambda place, key: (writes.update([key]), remove(place, key)))
    run_tile_job(job)
    assert looks == {LEASE_NAME: writes.total(), "started-1-1": writes.total()}
    assert writes.total() > len(open_store(job.store_ref.store).variables)


def test_every_job_of_a_run_has_the_token_of_its_claim(
    tmp_path: Path, plane: atlas.Spec, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, tokens = attempt.run_tile_job, set()

    def looking(job: RunJob) -> Any:
        record = LeaseRecord.unpack(sidecar_of(job.store_ref.store).read(LEASE_NAME) or b"")
        tokens.add((job.store_ref.lease, record and record.token))
        return whole(job)

    monkeypatch.setattr(attempt, "run_tile_job", looking)
    atlas.run(plane, tmp_path / "out.zarr", client=client)
    ((job, claim),) = tokens
    assert job == claim != ""


# The coordinator


class LostError(RunError):
    """In place of the error of a claim that is lost."""


def lost() -> None:
    raise LostError


def test_overviews_are_not_made_after_the_claim_is_lost(finished: Path) -> None:
    shutil.rmtree(finished / "overviews", ignore_errors=True)
    handle = open_store(finished)
    with pytest.raises(LostError):
        OverviewBuilder(handle.with_backend(handle.backend.with_fence(lost)), side=2, minimum=1)
    assert not handle.backend.exists("overviews/zarr.json")
    claims = [lambda: None]
    overviews = OverviewBuilder(handle.with_backend(handle.backend.with_fence(lambda: claims[-1]())), side=2, minimum=1)
    claims.append(lost)
    with pytest.raises(LostError):
        overviews.finish()
    assert not any("/regime/c/" in key for key in handle.backend.list_keys("overviews/"))


def test_records_are_not_written_after_the_claim_is_lost(finished: Path) -> None:
    handle = open_store(finished)
    before = (finished / RECORDS / "c.0.0.0").read_bytes()
    with pytest.raises(LostError):
        write_records(handle.with_backend(handle.backend.with_fence(lost)), TileRecords(handle).columns())
    assert (finished / RECORDS / "c.0.0.0").read_bytes() == before


def open_group(place: LocalBackend) -> zarr.Group:
    return zarr.open_group(zarr_store(place, read_only=False), mode="r+", use_consolidated=False)


CHANGES: dict[str, Callable[[LocalBackend], object]] = {
    "put": lambda place: place.put("zarr.json", b""),
    "put_all": lambda place: place.put_all({"zarr.json": b""}),
    "put_new": lambda place: place.put_new("new", b""),
    "remove": lambda place: place.remove("zarr.json"),
    "remove_all": lambda place: place.remove_all(["zarr.json"]),
    "inner": lambda place: place.subfolder("regime").put("zarr.json", b""),
    "set by Zarr": lambda place: open_group(place)["regime"].__setitem__(..., 1),
    "attributes by Zarr": lambda place: open_group(place).attrs.update({"a": 1}),
    "deletion by Zarr": lambda place: open_group(place).__delitem__("largest"),
    "creation by Zarr": lambda place: open_group(place).create_group("new"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_place_behind_a_fence_is_not_changed_once_the_fence_raises(finished: Path, change: str) -> None:
    before = contents(finished)
    with pytest.raises(LostError):
        CHANGES[change](LocalBackend(finished).with_fence(lost))
    assert contents(finished) == before


@pytest.fixture(scope="module")
def server() -> Iterator[FakeObjectStore]:
    with object_store() as served, pytest.MonkeyPatch.context() as patch:
        for name, value in served.environment.items():
            patch.setenv(name, value)
        yield served


AT_A_URL: dict[str, Callable[[StoreBackend], object]] = {
    "put": lambda place: place.put("a", b"2"),
    "put_all": lambda place: place.put_all({"a": b"2"}),
    "put_new": lambda place: place.put_new("b", b"2"),
    "take_all": lambda place: place.copy_all(open_backend("s3://bucket/origin.zarr"), ["a"]),
    "remove": lambda place: place.remove("a"),
    "remove_all": lambda place: place.remove_all(["a"]),
    "set by Zarr": lambda place: zarr.create_group(zarr_store(place, False), zarr_format=3, overwrite=True),
    "deletion by Zarr": lambda place: sync(zarr_store(place, False).delete("a")),
    "deletion of a folder by Zarr": lambda place: sync(zarr_store(place, False).delete_dir("")),
}


@pytest.mark.parametrize("change", AT_A_URL)
def test_a_claim_lost_while_the_server_was_away_is_seen_before_the_next_attempt(
    server: FakeObjectStore, change: str
) -> None:
    """Truth: the objects' generations. The fence holds at the first look; the first attempt at the change fails."""
    server.put({"bucket/fenced.zarr/a": b"1", "bucket/origin.zarr/a": b"2"})
    before, looks = server.objects, list[int]()

    def fence() -> None:
        looks.append(1)
        if len(looks) > 1:
            raise LostError
        server.trouble = InjectedFault(0, 1)

    with pytest.raises(LostError):
        AT_A_URL[change](open_backend("s3://bucket/fenced.zarr").with_fence(fence))
    assert server.objects == before
    assert server.trouble.left == 0


def test_objects_beyond_the_first_requests_are_put_after_another_look(server: FakeObjectStore) -> None:
    looks = list[int]()

    def fence() -> None:
        looks.append(1)
        if len(looks) > 1:
            raise LostError

    place = open_backend("s3://bucket/many.zarr")
    with pytest.raises(LostError):
        place.with_fence(fence).put_all({f"{k:03}": b"1" for k in range(AT_ONCE + 1)})
    assert len([*place.list_keys()]) == AT_ONCE


def test_a_repair_whose_claim_is_taken_drops_no_further_tile(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for index in ("0/0", "0/1", "1/0"):
        (finished / "largest/c" / index).unlink()
    before, drop = done_tiles(open_store(finished)), repairing.drop_tile

    def taken(handle: Any, index: tuple[int, ...]) -> None:
        drop(handle, index)
        notes = sidecar_of(finished)
        notes.compare_and_set(LEASE_NAME, THEIRS.pack(), expected=notes.read(LEASE_NAME))

    monkeypatch.setattr(Lease, "_beat", lambda _: None)
    monkeypatch.setattr(repairing, "drop_tile", taken)
    with pytest.raises(RunError, match="lease lost: another run has taken over the store"):
        atlas.verify(finished, sample=0, repair=True)
    assert before - done_tiles(open_store(finished)) == {(0, 0)}


def test_a_coordinator_that_slept_through_the_loss_of_its_claim_stops_and_leaves_the_notes_of_the_other_run(
    tmp_path: Path, plane: atlas.Spec, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = tmp_path / "out.zarr"
    written: dict[str, bytes] = {}

    def asleep(progress: Progress) -> None:
        if progress.tiles_done == 9 and not written:
            notes = sidecar_of(store)
            notes.compare_and_set(LEASE_NAME, THEIRS.pack(), expected=notes.read(LEASE_NAME))
            notes.compare_and_set("started-0-0", b"1", expected=None)
            written.update(contents(store))

    monkeypatch.setattr(Lease, "_beat", lambda _: None)
    with pytest.raises(RunError, match="lease lost: another run has taken over the store; finished tiles are kept"):
        atlas.run(plane, store, client=client, options=atlas.RunOptions(on_progress=asleep))
    assert contents(store) == written
    assert sidecar_of(store).read("started-0-0") == b"1"
    assert sidecar_of(store).read(LEASE_NAME) == THEIRS.pack()


def test_a_run_whose_workers_refuse_since_the_claim_was_taken_says_so(
    tmp_path: Path, plane: atlas.Spec, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = tmp_path / "out.zarr"

    def taken(progress: Progress) -> None:
        notes = sidecar_of(store)
        found = LeaseRecord.unpack(notes.read(LEASE_NAME) or b"")
        if progress.tiles_done == 1 and found is not None and found.token != THEIRS.token:
            notes.compare_and_set(LEASE_NAME, THEIRS.pack(), expected=notes.read(LEASE_NAME))

    monkeypatch.setattr(Lease, "_beat", lambda _: None)
    with pytest.raises(RunError, match="lease lost: another run has taken over the store"):
        atlas.run(plane, store, client=client, options=atlas.RunOptions(on_progress=taken))
    assert len(done_tiles(open_store(store))) < 9


def test_an_interrupted_run_that_lost_its_claim_leaves_the_notes_of_the_other_run(
    tmp_path: Path, plane: atlas.Spec, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = tmp_path / "out.zarr"

    def interrupted(progress: Progress) -> None:
        if progress.tiles_done == 2:
            notes = sidecar_of(store)
            notes.compare_and_set(LEASE_NAME, THEIRS.pack(), expected=notes.read(LEASE_NAME))
            notes.compare_and_set("started-9-9", b"1", expected=None)
            raise KeyboardInterrupt

    monkeypatch.setattr(Lease, "_beat", lambda _: None)
    with pytest.raises(KeyboardInterrupt):
        atlas.run(plane, store, client=client, options=atlas.RunOptions(on_progress=interrupted))
    assert sidecar_of(store).read("started-9-9") == b"1"
