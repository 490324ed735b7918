"""What explorers keep in a store: its budget, and what happens where it cannot be written."""

import errno
import shutil
from collections.abc import Iterator
from inspect import signature
from pathlib import Path

import pytest

from atlas.cli.explore import GB, explore
from atlas.explore import persistent_tiles
from atlas.explore.metatiles import MetatileCatalog, MetatileKey
from atlas.explore.persistent_tiles import MAX_BYTES, PersistentTileCache
from atlas.explore.session import explore as session
from atlas.explore.subject import Arrays, Subject, subject_of
from atlas.explore.tile_cache import TileCache
from atlas.explore.viewport import TILE_CELLS, TileKey
from atlas.store.create import create_store
from atlas.store.store import AtlasStore, open_store
from atlas.store.zoom import FILE_BLOCK, ZOOM, drop_metatile, list_metatiles, metatile_bytes
from tests.explore.test_solving import waited
from tests.synthetic import spec_of
from workers.results import PERIODIC, REGIME


@pytest.fixture
def handle(tmp_path: Path) -> AtlasStore:
    return create_store(tmp_path / "a.zarr", spec_of(), (19, 45))


def test_each_file_counts_as_a_whole_block_so_that_the_budget_bounds_files_too(handle: AtlasStore) -> None:
    """A tile takes about twenty files, and a screen of cells a thousand tiles."""
    sheet = handle.path / ZOOM / "plane" / "sheet"
    sheet.mkdir(parents=True)
    for k, size in enumerate((1, 100, FILE_BLOCK, FILE_BLOCK + 1)):
        (sheet / str(k)).write_bytes(b"0" * size)
    assert metatile_bytes(handle, "plane", "sheet") == 5 * FILE_BLOCK
    assert MAX_BYTES / FILE_BLOCK < 65_000


def test_the_command_and_python_have_the_same_budget() -> None:
    (limit,) = [param.default for param in explore.params if param.name == "limit"]
    assert limit * GB == signature(session).parameters["most_bytes"].default == MAX_BYTES


KEYS = [TileKey(4, 4, x, y) for x in (0, 1) for y in (0, 1)]


@pytest.fixture
def subject(finished: Path) -> Subject:
    return subject_of(str(finished))


@pytest.fixture
def keeper(subject: Subject, monkeypatch: pytest.MonkeyPatch) -> Iterator[PersistentTileCache]:
    """A keeper that tries again soon."""
    monkeypatch.setattr(persistent_tiles, "BATCH_PAUSE", 0.05)
    monkeypatch.setattr(persistent_tiles, "MAX_BATCH_PAUSE", 0.1)
    made = PersistentTileCache(subject)
    yield made
    made.stop()


def tile(subject: Subject) -> Arrays:
    """A tile of cells that are all periodic."""
    arrays = subject.without_results(subject.variables, (TILE_CELLS, TILE_CELLS))
    arrays[REGIME.name][...] = PERIODIC
    return arrays


def offer(keeper: PersistentTileCache, subject: Subject) -> None:
    for key in KEYS:
        keeper.enqueue(subject.plane, key, tile(subject))


def all_written(keeper: PersistentTileCache, subject: Subject) -> bool:
    """Whether all tiles are in the store, within a minute, and nothing is said to be wrong."""
    done = waited(lambda: keeper.n_queued == 0 and keeper.trouble == "")
    return done and keeper.sheets is not None and all(keeper.sheets.has(subject.plane, key) for key in KEYS)


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO])
@pytest.mark.parametrize("where", ["atlas.explore.persistent_tiles.write_tile", "atlas.explore.metatiles.create_store"])
def test_after_a_full_disk_or_an_error_of_the_disk_all_that_was_solved_is_kept(
    keeper: PersistentTileCache, subject: Subject, monkeypatch: pytest.MonkeyPatch, where: str, code: int
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(code, errno.errorcode[code])

    with monkeypatch.context() as broken:
        broken.setattr(where, refuse)
        offer(keeper, subject)
        assert waited(lambda: f"not saved yet: [Errno {code}]" in keeper.trouble)
        assert keeper.n_queued == len(KEYS) and not keeper.is_full
    assert all_written(keeper, subject)


def test_of_more_tiles_than_may_wait_the_oldest_are_not_kept_and_are_counted(
    keeper: PersistentTileCache, subject: Subject, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, "full")

    monkeypatch.setattr(persistent_tiles, "MAX_QUEUED", 2)
    with monkeypatch.context() as broken:
        broken.setattr("atlas.explore.persistent_tiles.write_tile", refuse)
        keeper.enqueue(subject.plane, KEYS[0], tile(subject))
        assert waited(lambda: "full" in keeper.trouble)
        offer(keeper, subject)
        assert keeper.n_queued == 2 and "2 solved tiles could not be saved: more than 2 were waiting" in keeper.trouble
    assert waited(lambda: keeper.n_queued == 0)


@pytest.mark.parametrize("name", ["zarr.json", "regime/zarr.json"])
@pytest.mark.parametrize("content", [b"", b"{", None])
def test_a_damaged_sheet_is_made_anew_and_keeping_goes_on(
    keeper: PersistentTileCache, subject: Subject, finished: Path, name: str, content: bytes | None
) -> None:
    offer(keeper, subject)
    assert all_written(keeper, subject)
    ((plane, sheet),) = list_metatiles(open_store(finished))
    file = finished / ZOOM / plane / sheet / name
    if content is None:
        file.unlink()
    else:
        file.write_bytes(content)
    again = PersistentTileCache(subject)
    try:
        offer(again, subject)
        assert all_written(again, subject)
    finally:
        again.stop()
    fresh = MetatileCatalog(subject, open_store(finished))
    assert all(fresh.has(subject.plane, key) for key in KEYS)


@pytest.mark.parametrize("where", ["_opened", "Sheet.arrays"])
def test_what_the_disk_refuses_to_read_is_said_and_stays_and_is_read_when_the_disk_is_well_again(
    keeper: PersistentTileCache, subject: Subject, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    class Refusing(dict[str, object]):
        __getitem__ = refuse  # type: ignore[assignment]

    monkeypatch.setattr("atlas.explore.metatiles.RELIST_SECONDS", 0.2)
    offer(keeper, subject)
    assert all_written(keeper, subject)
    fresh, names = MetatileCatalog(subject, open_store(subject.store.backend)), [REGIME.name]  # type: ignore[union-attr]
    with monkeypatch.context() as broken:
        if where == "_opened":
            broken.setattr("atlas.explore.metatiles.open_store", refuse)
        else:
            sheet = fresh.find(subject.plane, MetatileKey.from_tile(KEYS[0]))
            assert sheet is not None
            broken.setattr(sheet, "arrays", Refusing(sheet.arrays))
        assert fresh.load(subject.plane, KEYS, names) == {}
        assert "saved cells cannot be read: [Errno 5] Input/output error" in fresh.trouble
        assert not any(fresh.has(subject.plane, key) for key in KEYS)
    assert waited(lambda: fresh.load(subject.plane, KEYS, names).keys() == {*KEYS})
    assert waited(lambda: fresh.trouble == "")


def test_a_sheet_that_another_explorer_made_meanwhile_is_taken_as_it_is(
    keeper: PersistentTileCache, subject: Subject
) -> None:
    other = PersistentTileCache(subject)
    try:
        assert not any(other.has(subject.plane, key) for key in KEYS)  # it remembers for a while that there is none
        keeper.enqueue(subject.plane, KEYS[0], tile(subject))
        assert waited(lambda: keeper.n_queued == 0)
        for key in KEYS[1:]:
            other.enqueue(subject.plane, key, tile(subject))
        assert waited(lambda: other.n_queued == 0) and other.trouble == ""
        assert other.has(subject.plane, KEYS[0])
    finally:
        other.stop()


def test_a_tile_that_cannot_be_written_for_a_reason_of_its_own_holds_up_no_other(
    keeper: PersistentTileCache, subject: Subject
) -> None:
    keeper.enqueue(subject.plane, TileKey(4, 4, 2, 2), {name: array[:3] for name, array in tile(subject).items()})
    offer(keeper, subject)
    assert waited(lambda: keeper.n_queued == 0) and "1 solved tile could not be saved" in keeper.trouble
    assert keeper.sheets is not None and all(keeper.sheets.has(subject.plane, key) for key in KEYS)


def test_a_store_that_is_gone_is_said_to_be_and_nothing_is_dropped(
    keeper: PersistentTileCache, subject: Subject, finished: Path
) -> None:
    shutil.move(finished, finished.with_name("away.zarr"))
    offer(keeper, subject)
    assert waited(lambda: "not saved yet" in keeper.trouble) and keeper.n_queued == len(KEYS)
    shutil.move(finished.with_name("away.zarr"), finished)
    assert all_written(keeper, subject)


@pytest.mark.parametrize("how", ["damaged", "missing", "trimmed"])
def test_what_is_lost_of_a_tile_is_solved_again_though_the_rest_of_it_is_in_memory(
    keeper: PersistentTileCache, subject: Subject, finished: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    """As where a map of exponents was looked at, and then one of periods."""
    monkeypatch.setattr("atlas.explore.metatiles.RELIST_SECONDS", 0.0)
    offer(keeper, subject)
    assert all_written(keeper, subject)
    other = PersistentTileCache(subject)
    tiles = TileCache(subject, other)
    try:
        assert tiles.get(subject.plane, KEYS, ["largest"]).keys() == {*KEYS}
        assert all(tiles.has(subject.plane, key) for key in KEYS)
        ((plane, sheet),) = list_metatiles(open_store(finished))
        if how == "trimmed":
            drop_metatile(open_store(finished), plane, sheet)
        for chunk in (finished / ZOOM / plane / sheet / "period" / "c").glob("*/*"):
            chunk.write_bytes(b"?") if how == "damaged" else chunk.unlink()
        assert tiles.get(subject.plane, KEYS, ["period"]) == {}
        assert not any(tiles.has(subject.plane, key) for key in KEYS)
        for key in KEYS:
            tiles.put(subject.plane, key, tile(subject))
        assert tiles.get(subject.plane, KEYS, ["period"]).keys() == {*KEYS}
    finally:
        other.stop()
