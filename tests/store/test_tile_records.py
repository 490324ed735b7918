"""The records of tiles: what status and shares of an unfinished atlas read, and that no kill makes them wrong."""

import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import zarr
from distributed import Client

import atlas
from atlas.overview.pyramid import Pyramid
from atlas.query.queries import fractions
from atlas.query.read_counter import count_chunk_reads
from atlas.service.status import StoreStatus, read_status
from atlas.store import tile_records
from atlas.store.object_backend import LocalBackend
from atlas.store.record_format import BY_REASON, RECORDS, WIDTH, digest_of
from atlas.store.store import AtlasStore, done_mask, done_tiles, open_store
from atlas.store.tile_records import RunTileRecords, TileRecords, complete_records, forget_records
from atlas.store.tiles import drop_tile, read_tile, record_of, write_tile
from atlas.task.store_ref import StoreRef
from atlas.task.tile_job import RunJob, run_tile_job
from tests.chunk_keys import noted_keys
from tests.planes import plane_of
from tests.synthetic import complete, indices, put_record, results, spec_of
from workers.results import FAILED, GAVE_UP, REGIMES, Variable

TILES = 11 * 13


def half_done(path: Path) -> AtlasStore:
    """104 x 88 cells of which every other tile is done, so that no overview is."""
    handle = complete(path, (8, 8), spec_of(104, 88), side=32)
    missing = [index for index in indices(handle) if sum(index) % 2]
    Pyramid(handle).drop(missing)
    for index in missing:
        drop_tile(handle, index)
    return handle


def test_a_digest_is_of_the_place_of_a_tile_and_of_the_names_and_values_of_its_results() -> None:
    first, second = (Variable(name, "int32", 0, name, "1") for name in ("period", "impacts"))
    arrays = {"period": np.array([1, 2]), "impacts": np.array([3, 4]), "renamed": np.array([3, 4])}
    whole = digest_of((0, 1), [first, second], arrays)
    assert whole == digest_of((0, 1), [first, second], arrays | {"period": np.array([1, 2], dtype=">i8")})
    others = [
        digest_of((1, 0), [first, second], arrays),
        digest_of((0, 1), [first, replace(second, name="renamed")], arrays),
        digest_of((0, 1), [first, second], arrays | {"impacts": np.array([3, 5])}),
        digest_of((0, 1), [first], arrays),
    ]
    assert len({whole, *others}) == 5


@pytest.fixture(scope="module")
def handle(tmp_path_factory: pytest.TempPathFactory) -> AtlasStore:
    """The half-done atlas with a record of each tile, as a run that was killed leaves it."""
    made = half_done(tmp_path_factory.mktemp("records") / "half.zarr")
    complete_records(made)
    return made


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    whole = complete(tmp_path_factory.mktemp("records") / "whole.zarr", (16, 16))
    complete_records(whole)
    return whole.path


@pytest.fixture
def whole(made: Path, tmp_path: Path) -> AtlasStore:
    """A whole atlas in 9 tiles with a record of each, of its own for each test."""
    return open_store(shutil.copytree(made, tmp_path / "whole.zarr"))


@pytest.fixture
def copy(handle: AtlasStore, tmp_path: Path) -> AtlasStore:
    """The half-done atlas, of its own for each test."""
    return open_store(shutil.copytree(handle.path, tmp_path / "half.zarr"))


@pytest.fixture
def keys(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Keys of the chunks of cells that Zarr gets from disk, whoever asks."""
    return noted_keys(monkeypatch, lambda key: key.startswith(("regime/c/", "reason/c/")))


def counts_of(path: Path) -> Counter[str]:
    """Cells by regime from the regimes themselves."""
    names = {regime.code: regime.name for regime in REGIMES if regime.name != "pending"}
    codes = xr.open_zarr(path).regime.values
    return Counter({names[code]: int((codes == code).sum()) for code in names if (codes == code).any()})


def assert_true(status: StoreStatus, path: Path) -> None:
    assert status.regimes == counts_of(path)
    assert status.cells_done == sum(status.regimes.values())


def test_status_of_a_half_done_atlas_reads_no_cell(handle: AtlasStore, keys: list[str]) -> None:
    status = read_status(handle)
    assert keys == []
    assert status.tiles_done == TILES // 2 + 1
    assert_true(status, handle.path)


def test_shares_of_a_half_done_atlas_read_no_cell(handle: AtlasStore, keys: list[str]) -> None:
    ds = atlas.open(handle.path)
    with count_chunk_reads() as reads:
        found = fractions(ds)
    assert keys == []
    assert reads.chunks <= 1  # shares that are left of a dropped overview
    assert found == pytest.approx(fractions(ds.load().copy()), rel=1e-12)


@pytest.mark.parametrize("part", [(3, 101, 2, 86), (8, 96, 16, 80), (17, 18, 5, 80), (0, 104, 16, 32)])
def test_shares_in_a_window_of_a_half_done_atlas_read_its_border_alone(
    handle: AtlasStore, keys: list[str], part: tuple[int, int, int, int]
) -> None:
    left, right, low, high = part
    block = atlas.open(handle.path).isel(omega=slice(left, right), b=slice(low, high))
    found = fractions(block)
    read = {tuple(map(int, key.split("/")[2:])) for key in keys}
    cut = [(y, x) for y, x in indices(handle) if not (low <= 8 * y and 8 * y + 8 <= high)
           or not (left <= 8 * x and 8 * x + 8 <= right)]  # fmt: skip
    assert read <= set(cut)
    assert found == pytest.approx(fractions(block.load().copy()), rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("values", [np.geomspace(1.0, 50.0, 80), np.linspace(1.0, 4.0, 80) ** 2])
def test_shares_weigh_cells_that_are_not_of_one_width(tmp_path: Path, values: np.ndarray) -> None:
    spec = atlas.Spec("two-mass", axes={"omega": values, "b": np.geomspace(0.1, 5.0, 40)})
    handle = complete(tmp_path / "a.zarr", (8, 8), spec, side=32)
    drop_tile(handle, (3, 4))
    Pyramid(handle).drop([(3, 4)])
    complete_records(handle)
    ds = atlas.open(handle.path)
    with count_chunk_reads() as reads:
        found = fractions(ds)
    assert reads.chunks < 10
    assert found == pytest.approx(fractions(ds.load().copy()), rel=1e-12)


def test_a_tile_whose_record_is_lost_is_read_and_no_other(copy: AtlasStore, keys: list[str]) -> None:
    put_record(copy, (4, 4), np.zeros(WIDTH))
    keys.clear()
    assert_true(read_status(copy), copy.path)
    assert keys.count("regime/c/4/4") == 2  # the second is of the comparison
    found = fractions(atlas.open(copy.path))
    assert found == pytest.approx(fractions(atlas.open(copy.path).load().copy()), rel=1e-12)


def test_records_of_tiles_that_are_no_longer_done_do_not_count(copy: AtlasStore) -> None:
    copy.path.joinpath("regime/c/4/4").unlink()
    assert_true(read_status(copy), copy.path)
    ds = atlas.open(copy.path)
    assert fractions(ds) == pytest.approx(fractions(ds.load().copy()), rel=1e-12)


def remove(path: Path) -> None:
    path.unlink()


def tear(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:40])


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0x10
    path.write_bytes(data)


@pytest.mark.parametrize("harm", [remove, tear, flip])
def test_tiles_whose_table_is_missing_or_damaged_are_counted_again(
    whole: AtlasStore, harm: Callable[[Path], None], keys: list[str]
) -> None:
    harm(whole.path / RECORDS / "c.0.0.0")
    assert_true(read_status(whole), whole.path)
    assert len(keys) > 9


@pytest.mark.parametrize("harm", [remove, tear])
def test_records_are_read_whatever_their_metadata_have_become(
    whole: AtlasStore, harm: Callable[[Path], None], keys: list[str]
) -> None:
    harm(whole.path / RECORDS / "zarr.json")
    assert_true(read_status(whole), whole.path)
    assert len(keys) == 9  # no cell


def test_a_record_with_a_reason_of_a_later_version_is_counted_again(whole: AtlasStore, keys: list[str]) -> None:
    row = TileRecords(whole).columns()[1, 1].copy()
    row[BY_REASON.start] -= 1
    row[BY_REASON.stop] += 1
    put_record(whole, (1, 1), row)
    assert_true(read_status(whole), whole.path)
    assert keys.count("regime/c/1/1") == 2


def test_a_run_leaves_one_object_with_the_records_of_all_tiles(tmp_path: Path, client: Client, keys: list[str]) -> None:
    atlas.run(plane_of(), tmp_path / "out.zarr", client=client)
    handle = open_store(tmp_path / "out.zarr")
    assert sorted(handle.backend.list_keys(f"{RECORDS}/")) == [f"{RECORDS}/c.0.0.0", f"{RECORDS}/zarr.json"]
    keys.clear()
    status = read_status(handle)
    assert keys == []
    assert (status.tiles_done, status.cells_done) == (9, 35)
    assert_true(status, handle.path)


def test_records_are_those_of_the_workers_and_of_the_cells(finished: Path) -> None:
    handle = open_store(finished)
    rows = TileRecords(handle).columns()
    for index in done_tiles(handle):
        np.testing.assert_array_equal(rows[index], record_of(handle, index, read_tile(handle, index)))


def test_a_run_of_a_finished_atlas_writes_no_record(
    finished: Path, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    def put(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(tile_records, "write_records", put)
    assert atlas.run(plane_of(), finished, client=client).tiles_solved == 0


def test_the_next_run_records_what_an_earlier_one_did_not(finished: Path, client: Client) -> None:
    handle = open_store(finished)
    before = TileRecords(handle).columns()
    (finished / RECORDS / "c.0.0.0").unlink()
    drop_tile(handle, (2, 2))
    atlas.run(plane_of(), finished, client=client)
    np.testing.assert_array_equal(TileRecords(handle).columns(), before)


def fail(handle: AtlasStore, index: tuple[int, ...]) -> None:
    """Make two cells of a tile failed ones."""
    arrays = read_tile(handle, index)
    arrays["regime"][0, :2] = FAILED
    arrays["reason"] = np.where(arrays["regime"] == FAILED, GAVE_UP, 0).astype(np.int8)
    write_tile(handle, index, arrays)


def test_a_tile_whose_regime_was_lost_is_not_taken_for_its_old_self_when_it_is_solved_again(finished: Path) -> None:
    handle = open_store(finished)
    fail(handle, (1, 1))
    put_record(handle, (1, 1), record_of(handle, (1, 1), read_tile(handle, (1, 1))))
    drop_tile(handle, (1, 1))
    RunTileRecords(handle, records_of(handle)).write()  # what a run does first
    run_tile_job(RunJob((1, 1), StoreRef(str(finished), handle.run_id, handle.solver_version)))
    assert_true(read_status(handle), finished)


def records_of(handle: AtlasStore) -> TileRecords:
    """The records as a run finds them."""
    found = TileRecords(handle, done_mask(handle))
    found.columns()
    return found


# Kills: at each write of a tile that is written again, and of a compaction


class Killed(BaseException):
    pass


def kill_at(monkeypatch: pytest.MonkeyPatch, step: int) -> list[str]:
    """Let the process die at its step-th change of the store, which is not made; what it changes is listed."""
    changes: list[str] = []

    def counted(key: str) -> None:
        if len(changes) >= step:
            raise Killed
        changes.append(key)

    def put(place: LocalBackend, key: str, data: bytes) -> None:
        counted(f"put {key}")
        whole_put(place, key, data)

    def removed(place: LocalBackend, key: str) -> None:
        counted(f"remove {key}")
        whole_remove(place, key)

    async def set_(self: object, key: str, value: object) -> None:
        counted(f"put {key}")
        await whole_set(self, key, value)  # type: ignore[arg-type]

    whole_put, whole_remove, whole_set = LocalBackend.put, LocalBackend.remove, zarr.storage.LocalStore.set
    monkeypatch.setattr(LocalBackend, "put", put)
    monkeypatch.setattr(LocalBackend, "remove", removed)
    monkeypatch.setattr(zarr.storage.LocalStore, "set", set_)
    return changes


def killed_everywhere(
    handle: AtlasStore, act: Callable[[AtlasStore], None], holds: Callable[[AtlasStore], None]
) -> list[str]:
    """Do something in copies of a store, killed at each of its changes in turn; what it changes when it is not."""
    for step in range(1000):
        copied = open_store(shutil.copytree(handle.path, handle.path.parent / f"killed-{step}.zarr"))
        with pytest.MonkeyPatch.context() as patch:
            changes = kill_at(patch, step)
            try:
                act(copied)
                ended = True
            except Killed:
                ended = False
        holds(copied)
        shutil.rmtree(copied.path)
        if ended:
            return changes
    raise AssertionError


@pytest.mark.slow
def test_records_are_right_whenever_a_run_is_killed_that_solves_lost_tiles_again(whole: AtlasStore) -> None:
    tiles = ((0, 0), (1, 1), (2, 1))
    for index in tiles:
        drop_tile(whole, index)

    def run(handle: AtlasStore) -> None:
        records = RunTileRecords(handle, records_of(handle))
        records.write()
        for index in tiles:
            records.add(index, write_tile(handle, index, results(handle, index, seed=1)).tolist())
        records.finish()

    def true(handle: AtlasStore) -> None:
        assert_true(read_status(handle), handle.path)
        rows, known = TileRecords(handle).columns(), TileRecords(handle).known_mask
        for index in np.argwhere(known).tolist():
            row = record_of(handle, tuple(index), read_tile(handle, tuple(index)))
            np.testing.assert_array_equal(rows[tuple(index)], row)

    changes = killed_everywhere(whole, run, true)
    assert changes[0] == changes[-1] == f"put {RECORDS}/c.0.0.0"


def test_records_are_right_whenever_a_repair_is_killed_that_drops_tiles(whole: AtlasStore) -> None:
    def drop(handle: AtlasStore) -> None:
        forget_records(handle, [(0, 1)])
        drop_tile(handle, (0, 1))

    changes = killed_everywhere(whole, drop, lambda handle: assert_true(read_status(handle), handle.path))
    assert changes == [f"put {RECORDS}/c.0.0.0", "remove regime/c/0/1"]


@pytest.mark.slow
def test_records_are_right_whenever_a_worker_is_killed_that_writes_a_first_tile(whole: AtlasStore) -> None:
    forget_records(whole, [(0, 1)])
    drop_tile(whole, (0, 1))

    def write(handle: AtlasStore) -> None:
        write_tile(handle, (0, 1), results(handle, (0, 1), seed=1))

    changes = killed_everywhere(whole, write, lambda handle: assert_true(read_status(handle), handle.path))
    assert changes[-1] == "put regime/c/0/1"


def test_a_run_saves_its_records_now_and_then(whole: AtlasStore, monkeypatch: pytest.MonkeyPatch) -> None:
    row = record_of(whole, (1, 1), read_tile(whole, (1, 1)))
    put_record(whole, (1, 1), np.zeros(WIDTH))
    run = RunTileRecords(whole, records_of(whole))
    run.add((1, 1), row.tolist())
    run.save()
    assert not TileRecords(whole).known_mask[1, 1]
    monkeypatch.setattr(run, "_next", 0.0)
    run.save()
    assert TileRecords(whole).known_mask[1, 1]


def test_a_run_reports_what_its_store_holds_after_each_receipt(finished: Path) -> None:
    handle = open_store(finished)
    run = RunTileRecords(handle, TileRecords(handle))
    fail(handle, (1, 1))
    run.add((1, 1), record_of(handle, (1, 1), read_tile(handle, (1, 1))).tolist())
    assert run.counts is not None
    assert (run.counts["tiles"], run.counts["regimes"]) == (9, counts_of(finished))
    run.write()
    assert run.counts["reasons"] == read_status(handle).reasons
    run.add((0, 0), (0.0,) * WIDTH)
    assert run.counts is None


def test_plain_xarray_does_not_see_the_records(handle: AtlasStore) -> None:
    assert "records" not in xr.open_zarr(handle.path).variables
    assert "records" in xr.open_zarr(handle.path, group="tiles", consolidated=False).variables
