"""The tally of a store: what status and shares of an unfinished atlas read, and that no kill makes it wrong."""

import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import zarr
from distributed import Client

import atlas
from atlas.overview.pyramid import drop
from atlas.query.queries import fractions
from atlas.query.reads import counted
from atlas.service.status import Status, read_status
from atlas.store import tally
from atlas.store.store import Header, done_tiles, read_header
from atlas.store.tally import TallyKeeper
from atlas.store.tiles import drop_tile, read_tile, write_tile
from atlas.task.attempt import run_job
from atlas.task.retry import Retry
from atlas.task.task import Job
from tests.planes import plane_of
from tests.synthetic import complete, indices, keep, results, spec_of
from workers.results import FAILED, GAVE_UP, REGIMES

TILES = 11 * 13


def half_done(path: Path) -> Header:
    """104 x 88 cells of which every other tile is done, so that no overview is."""
    header = complete(path, (8, 8), spec_of(104, 88), side=32)
    missing = [index for index in indices(header) if sum(index) % 2]
    drop(header, missing)
    for index in missing:
        drop_tile(header, index)
    return header


def keep_tally(header: Header) -> None:
    """Count what is uncounted, as a run does."""
    with TallyKeeper(header) as keeper:
        keeper.finish()


@pytest.fixture(scope="module")
def header(tmp_path_factory: pytest.TempPathFactory) -> Header:
    made = half_done(tmp_path_factory.mktemp("tally") / "half.zarr")
    keep_tally(made)
    return made


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return complete(tmp_path_factory.mktemp("tally") / "whole.zarr", (16, 16)).path


@pytest.fixture
def whole(made: Path, tmp_path: Path) -> Header:
    """A whole atlas in 9 tiles without a tally, of its own for each test."""
    return read_header(shutil.copytree(made, tmp_path / "whole.zarr"))


@pytest.fixture
def sound(made: Path, tmp_path: Path) -> Header:
    """A whole atlas in 9 tiles and its tally, of its own for each test."""
    header = read_header(shutil.copytree(made, tmp_path / "whole.zarr"))
    keep_tally(header)
    return header


@pytest.fixture
def copy(header: Header, tmp_path: Path) -> Header:
    """The half-done atlas and its tally, of its own for each test."""
    return read_header(shutil.copytree(header.path, tmp_path / "half.zarr"))


@pytest.fixture
def keys(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Keys of the chunks of cells that Zarr gets from disk, whoever asks."""
    found: list[str] = []
    whole = zarr.storage.LocalStore.get

    async def get(self: object, key: str, *args: object, **named: object) -> object:
        value = await whole(self, key, *args, **named)  # type: ignore[arg-type]
        if value is not None and key.startswith(("regime/c/", "reason/c/")):
            found.append(key)
        return value

    monkeypatch.setattr(zarr.storage.LocalStore, "get", get)
    return found


def counts_of(path: Path) -> Counter[str]:
    """Cells by regime from the regimes themselves."""
    names = {regime.code: regime.name for regime in REGIMES if regime.name != "pending"}
    codes = xr.open_zarr(path).regime.values
    return Counter({names[code]: int((codes == code).sum()) for code in names if (codes == code).any()})


def assert_true(status: Status, path: Path) -> None:
    assert status.regimes == counts_of(path)
    assert status.cells_done == sum(status.regimes.values())


def test_status_of_a_half_done_atlas_reads_no_cell(header: Header, keys: list[str]) -> None:
    status = read_status(header)
    assert keys == []
    assert status.tiles_done == TILES // 2 + 1
    assert_true(status, header.path)


def test_shares_of_a_half_done_atlas_read_no_cell(header: Header, keys: list[str]) -> None:
    ds = atlas.open(header.path)
    with counted() as reads:
        found = fractions(ds)
    assert keys == []
    assert reads.chunks <= 2  # the tally, and shares that are left of a dropped overview
    assert found == pytest.approx(fractions(ds.load().copy()), rel=1e-12)


@pytest.mark.parametrize("part", [(3, 101, 2, 86), (8, 96, 16, 80), (17, 18, 5, 80), (0, 104, 16, 32)])
def test_shares_in_a_window_of_a_half_done_atlas_read_its_border_alone(
    header: Header, keys: list[str], part: tuple[int, int, int, int]
) -> None:
    left, right, low, high = part
    block = atlas.open(header.path).isel(omega=slice(left, right), b=slice(low, high))
    found = fractions(block)
    read = {tuple(map(int, key.split("/")[2:])) for key in keys}
    cut = [(y, x) for y, x in indices(header) if not (low <= 8 * y and 8 * y + 8 <= high)
           or not (left <= 8 * x and 8 * x + 8 <= right)]  # fmt: skip
    assert read <= set(cut)
    assert found == pytest.approx(fractions(block.load().copy()), rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("values", [np.geomspace(1.0, 50.0, 80), np.linspace(1.0, 4.0, 80) ** 2])
def test_shares_weigh_cells_that_are_not_of_one_width(tmp_path: Path, values: np.ndarray) -> None:
    spec = atlas.Spec("two-mass", axes={"omega": values, "b": np.geomspace(0.1, 5.0, 40)})
    header = complete(tmp_path / "a.zarr", (8, 8), spec, side=32)
    drop_tile(header, (3, 4))
    drop(header, [(3, 4)])
    keep_tally(header)
    ds = atlas.open(header.path)
    with counted() as reads:
        found = fractions(ds)
    assert reads.chunks < 10
    assert found == pytest.approx(fractions(ds.load().copy()), rel=1e-12)


def test_tiles_that_came_after_the_tally_are_read_and_no_others(copy: Header, keys: list[str]) -> None:
    for index in ((0, 1), (5, 4)):
        write_tile(copy, index, results(copy, index, seed=1))
    keys.clear()
    status = read_status(copy)
    assert set(keys) == {"regime/c/0/1", "regime/c/5/4"}
    assert_true(status, copy.path)
    keys.clear()
    found = fractions(atlas.open(copy.path))
    assert set(keys) == {"regime/c/0/1", "regime/c/5/4"}
    assert found == pytest.approx(fractions(atlas.open(copy.path).load().copy()), rel=1e-12)


def test_tiles_in_the_tally_that_are_no_longer_done_do_not_count(copy: Header) -> None:
    drop_tile(copy, (4, 4))
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


@pytest.mark.parametrize("name", ["c/0/0/0", "zarr.json"])
@pytest.mark.parametrize("harm", [remove, tear, flip])
def test_a_tally_that_is_missing_or_damaged_is_counted_again(
    sound: Header, harm: Callable[[Path], None], name: str, keys: list[str]
) -> None:
    harm(sound.path / "tally" / "tiles" / name)
    assert_true(read_status(sound), sound.path)
    keep_tally(sound)
    keys.clear()
    assert_true(read_status(sound), sound.path)
    assert len(keys) == 9  # by the comparison alone


def test_a_tally_from_before_there_was_a_regime_or_a_reason_is_read_and_made_anew_by_a_run(
    sound: Header, keys: list[str]
) -> None:
    group = zarr.open_group(sound.path, mode="r+", use_consolidated=False)["tally"]
    whole, attributes = group["tiles"][...], dict(group["tiles"].attrs)
    older = [name for name in tally.COLUMNS if not name.endswith(("aperiodic", "not_relaxed", "not_stationary"))]
    assert len(older) == len(tally.COLUMNS) - 4
    kept = whole[..., [tally.COLUMNS.index(name) for name in older]]
    group.create_array("tiles", data=kept, attributes=attributes | {"columns": older}, overwrite=True)
    keys.clear()
    status = read_status(sound)
    assert keys == []
    assert_true(status, sound.path)
    keep_tally(sound)
    np.testing.assert_array_equal(group["tiles"][...], whole)


def test_a_tally_of_a_newer_version_is_counted_again(sound: Header) -> None:
    array = zarr.open_group(sound.path, mode="r+", use_consolidated=False)["tally/tiles"]
    array.update_attributes({"columns": [*tally.COLUMNS[:-1], "reason tired"]})
    assert_true(read_status(sound), sound.path)


def test_a_run_keeps_the_tally_of_its_tiles(tmp_path: Path, client: Client, keys: list[str]) -> None:
    atlas.run(plane_of(), tmp_path / "out.zarr", client=client)
    keys.clear()
    status = read_status(read_header(tmp_path / "out.zarr"))
    assert keys == []
    assert (status.tiles_done, status.cells_done) == (9, 35)
    assert_true(status, tmp_path / "out.zarr")


def test_the_next_run_counts_what_an_earlier_one_left_uncounted(
    finished: Path, client: Client, keys: list[str]
) -> None:
    spec, path = plane_of(), finished
    header = read_header(path)
    entries = zarr.open_group(path, mode="r+", use_consolidated=False)["tally/tiles"]
    before = entries[...]
    entries[0] = 0.0
    drop_tile(header, (2, 2))
    atlas.run(spec, path, client=client)
    np.testing.assert_array_equal(entries[...], before)


def test_a_retry_leaves_the_tally_true(finished: Path, client: Client, keys: list[str]) -> None:
    spec, path = plane_of(), finished
    before = read_status(read_header(path))
    fail(read_header(path), (1, 1))
    assert read_status(read_header(path)).regimes["failed"] == 2
    atlas.run(spec, path, client=client, options=atlas.RunOptions(retry=Retry((FAILED,))))
    keys.clear()
    assert read_status(read_header(path)).regimes == before.regimes
    assert keys == []


def fail(header: Header, index: tuple[int, ...]) -> None:
    """Make two cells of a tile failed ones, in the tally too."""
    arrays = read_tile(header, index)
    arrays["regime"][0, :2] = FAILED
    arrays["reason"] = np.where(arrays["regime"] == FAILED, GAVE_UP, 0).astype(np.int8)
    with TallyKeeper(header, [index]):
        write_tile(header, index, arrays)
    keep_tally(header)


def test_a_coordinator_killed_after_a_retried_tile_leaves_no_wrong_entry(
    finished: Path, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The tile is written, its receipt lost: its old entry must not count."""
    spec, path = plane_of(), finished
    header = read_header(path)
    fail(header, (1, 1))

    class Killed(BaseException):
        pass

    def killed(*_: object) -> None:
        raise Killed

    monkeypatch.setattr(TallyKeeper, "add", killed)
    monkeypatch.setattr(TallyKeeper, "_flush", lambda _: None)
    with pytest.raises(Killed):
        atlas.run(spec, path, client=client, options=atlas.RunOptions(retry=Retry((FAILED,))))
    assert "failed" not in counts_of(path)
    assert_true(read_status(header), path)


def test_a_tile_dropped_and_solved_by_hand_is_not_taken_for_its_old_self(finished: Path) -> None:
    header = read_header(finished)
    fail(header, (1, 1))
    drop_tile(header, (1, 1))
    with TallyKeeper(header):  # as every run begins
        run_job(Job((1, 1), str(finished), header.run_id, header.solver_version))
    assert_true(read_status(header), finished)


def test_a_run_that_fails_leaves_a_tally_that_may_be_another_runs_alone(whole: Header) -> None:
    with pytest.raises(RuntimeError), TallyKeeper(whole) as keeper:
        keeper.finish()
        keeper.add((0, 0), np.ones(len(tally.COLUMNS)))
        raise RuntimeError
    assert_true(read_status(whole), whole.path)


def test_plain_xarray_does_not_see_the_tally(header: Header) -> None:
    assert "tiles" not in xr.open_zarr(header.path)
    assert done_tiles(header)
    keep(header)
    assert "tiles" not in xr.open_zarr(header.path)
