"""A run that has lost its claim of a store finishes nothing more there: neither its jobs nor its coordinator.

Truth: the bytes of the store before and after.
"""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import zarr
from distributed import Client

import atlas
from atlas.check import repair as repairing
from atlas.errors import RunError
from atlas.overview.builder import OverviewBuilder
from atlas.service.lease import Lease, LeaseRecord
from atlas.service.progress import Progress
from atlas.spec.extension import refine_spec
from atlas.store.create import create_store
from atlas.store.groups import write_group
from atlas.store.object_backend import LocalBackend
from atlas.store.origin import Origin, RetryRequest
from atlas.store.parts import put_part
from atlas.store.record_format import RECORDS
from atlas.store.sidecar import LEASE_NAME, sidecar_of
from atlas.store.store import AtlasStore, done_tiles, open_store
from atlas.store.tile_records import TileRecords, write_records
from atlas.store.tiles import drop_tile
from atlas.task import tile_job
from atlas.task.store_ref import StoreRef, WorkerRefusedError
from atlas.task.tile_job import RunJob, run_tile_job
from tests.planes import plane_of
from workers import tile as solving
from workers.settings import MAX_PERIODS

LOST = "the run that sent this job has lost its lease; nothing more is finished"
OURS = LeaseRecord("ours", 3, "here", 1, "")
THEIRS = replace(OURS, token="theirs", host="far")


def contents(store: Path) -> dict[str, bytes]:
    """Every object of a store but the list of machines, which anybody may add to."""
    keys = (key for key in LocalBackend(store).list_keys() if not key.startswith("hosts/"))
    return {key: (store / key).read_bytes() for key in keys}


def take_over(store: Path) -> None:
    """Replace our claim of a store by that of another run."""
    sidecar_of(store).put(LEASE_NAME, THEIRS.pack())


def claimed_job(store: Path, index: tuple[int, ...]) -> RunJob:
    handle = open_store(store)
    sidecar_of(store).put_new(LEASE_NAME, OURS.pack())
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
def test_a_job_that_sleeps_through_a_lost_claim_does_not_finish_its_tile_and_changes_nothing_else(
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
    assert done_tiles(open_store(store)) == set()
    assert contents(store).items() >= before.items()


def test_a_job_that_sleeps_while_another_store_takes_the_place_of_its_own_writes_nothing(
    tmp_path: Path, finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = new_store(tmp_path, finished)
    store, whole = Path(job.store_ref.store), solving.solve_tile
    before: dict[str, bytes] = {}

    def slow(*given: Any) -> Any:
        shutil.rmtree(store)
        create_store(store, plane_of(R=0.5), (2, 3))
        before.update(contents(store))
        return whole(*given)

    monkeypatch.setattr(solving, "solve_tile", slow)
    with pytest.raises(WorkerRefusedError, match="is not the store of run"):
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
def test_a_job_without_a_claim_in_the_store_finishes_nothing(tmp_path: Path, finished: Path, claim: bytes) -> None:
    job = new_store(tmp_path, finished)
    sidecar_of(job.store_ref.store).remove(LEASE_NAME)
    if claim:
        sidecar_of(job.store_ref.store).put_new(LEASE_NAME, claim)
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


def test_a_tile_is_finished_after_one_look_at_the_claim(
    tmp_path: Path, finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job, order = new_store(tmp_path, finished), list[str]()
    put, get = LocalBackend.put, LocalBackend.get
    monkeypatch.setattr(LocalBackend, "put", lambda place, key, data: (order.append(key), put(place, key, data))[1])
    monkeypatch.setattr(
        LocalBackend, "get", lambda place, key, part=None: (order.append(key), get(place, key, part))[1]
    )
    run_tile_job(job)
    assert order.count(LEASE_NAME) == 1
    assert order[order.index(LEASE_NAME) + 1] == "regime/c/1/1"


def test_every_job_of_a_run_has_the_token_of_its_claim(
    tmp_path: Path, plane: atlas.Spec, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, tokens = tile_job.run_tile_job, set()

    def looking(job: RunJob) -> Any:
        record = LeaseRecord.unpack(sidecar_of(job.store_ref.store).get(LEASE_NAME) or b"")
        tokens.add((job.store_ref.lease, record and record.token))
        return whole(job)

    monkeypatch.setattr(tile_job, "run_tile_job", looking)
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
    claims = [lambda: None]
    handle = open_store(finished)
    handle = handle.with_backend(handle.backend.with_lease(lambda: claims[-1]()))
    overviews = OverviewBuilder(handle, side=2, minimum=1)
    claims.append(lost)
    for make in (overviews.finish, lambda: OverviewBuilder(handle, side=2, minimum=1)):
        with pytest.raises(LostError):
            make()
    assert not any("/regime/c/" in key for key in handle.backend.list_keys("overviews/"))


def test_records_are_not_written_after_the_claim_is_lost(finished: Path) -> None:
    handle = open_store(finished)
    before = (finished / RECORDS / "c.0.0.0").read_bytes()
    with pytest.raises(LostError):
        write_records(handle.with_backend(handle.backend.with_lease(lost)), TileRecords(handle).columns())
    assert (finished / RECORDS / "c.0.0.0").read_bytes() == before


CHANGES: dict[str, Callable[[AtlasStore], object]] = {
    "an object that finishes others": lambda handle: handle.backend.commit("zarr.json", b""),
    "the same below": lambda handle: handle.backend.commit("regime/zarr.json", b""),
    "a part of a search": lambda handle: put_part(handle, "curves", "1", b"1"),
    "a tile that is dropped": lambda handle: drop_tile(handle, (0, 0)),
    "a group": lambda handle: write_group(handle, "curves", {}, {}),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_store_is_not_changed_once_the_claim_is_lost(finished: Path, change: str) -> None:
    before, handle = contents(finished), open_store(finished)
    with pytest.raises(LostError):
        CHANGES[change](handle.with_backend(handle.backend.with_lease(lost)))
    assert contents(finished) == before


def test_a_repair_whose_claim_is_taken_drops_no_further_tile(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for index in ("0/0", "0/1", "1/0"):
        (finished / "largest/c" / index).unlink()
    before, drop = done_tiles(open_store(finished)), repairing.drop_tile

    def taken(handle: Any, index: tuple[int, ...]) -> None:
        drop(handle, index)
        notes = sidecar_of(finished)
        notes.put(LEASE_NAME, THEIRS.pack())

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
            notes.put(LEASE_NAME, THEIRS.pack())
            notes.put_new("theirs", b"1")
            written.update(contents(store))

    monkeypatch.setattr(Lease, "_beat", lambda _: None)
    with pytest.raises(RunError, match="lease lost: another run has taken over the store; finished tiles are kept"):
        atlas.run(plane, store, client=client, options=atlas.RunOptions(on_progress=asleep))
    assert contents(store) == written
    assert sidecar_of(store).get("theirs") == b"1"
    assert sidecar_of(store).get(LEASE_NAME) == THEIRS.pack()


def test_a_run_whose_workers_refuse_since_the_claim_was_taken_says_so(
    tmp_path: Path, plane: atlas.Spec, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = tmp_path / "out.zarr"

    def taken(progress: Progress) -> None:
        notes = sidecar_of(store)
        found = LeaseRecord.unpack(notes.get(LEASE_NAME) or b"")
        if progress.tiles_done == 1 and found is not None and found.token != THEIRS.token:
            notes.put(LEASE_NAME, THEIRS.pack())

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
            notes.put(LEASE_NAME, THEIRS.pack())
            notes.put_new("theirs", b"1")
            raise KeyboardInterrupt

    monkeypatch.setattr(Lease, "_beat", lambda _: None)
    with pytest.raises(KeyboardInterrupt):
        atlas.run(plane, store, client=client, options=atlas.RunOptions(on_progress=interrupted))
    assert sidecar_of(store).get("theirs") == b"1"
