"""Tiles larger than 64 cells a side: one object of smaller chunks an array, solved and read part by part."""

import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import zarr
from distributed import Client

import atlas
from atlas.check.verify import verify
from atlas.errors import ChunkError
from atlas.query.read_counter import count_chunk_reads
from atlas.service.extend import extend
from atlas.store import create, store
from atlas.store.store import done_tiles, open_store
from atlas.store.tiles import drop_tile, read_tile, write_tile
from atlas.store.tiling import part_side
from atlas.store.zarr_store import BackendStore
from tests.corruption import flip
from tests.synthetic import assert_view_is_true, indices, keep, results, spec_of

CHEAP = {"max_periods": 300, "tolerance": 1.0, "exponents": "none"}


def made(path: Path, skip: tuple[tuple[int, ...], ...] = ()) -> store.AtlasStore:
    """150 x 140 cells in tiles of 128 x 96: shards of 64 x 48, the last ones cut by the plane's ends."""
    handle = create.create_store(path, spec_of(150, 140), (96, 128))
    for index in indices(handle):
        if index not in skip:
            write_tile(handle, index, results(handle, index))
    return handle


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(tmp_path_factory.mktemp("shards") / "whole.zarr").path


@pytest.fixture
def whole(original: Path, tmp_path: Path) -> store.AtlasStore:
    return open_store(shutil.copytree(original, tmp_path / "whole.zarr"))


@pytest.mark.parametrize(
    ("tile", "side"), [(512, 64), (64, 64), (65, 65), (96, 48), (250, 50), (97, 97), (1, 1), (7, 7)]
)
def test_parts_are_as_near_to_64_cells_as_divides(tile: int, side: int) -> None:
    assert part_side(tile) == side


def test_a_large_tile_is_one_object_of_each_array_in_chunks_of_about_64(whole: store.AtlasStore) -> None:
    array = zarr.open_group(whole.path, mode="r", use_consolidated=False)["largest"]
    assert (array.shards, array.chunks) == ((96, 128), (48, 64))  # type: ignore[union-attr]
    keys = [key for key in whole.backend.list_keys("largest/c/")]
    assert sorted(keys) == [f"largest/c/{y}/{x}" for y, x in indices(whole)]
    assert (whole.tile, len(done_tiles(whole))) == ((96, 128), 4)


@pytest.mark.parametrize("skip", [(), ((0, 1), (1, 0))])
def test_plain_xarray_opens_it_without_a_warning_half_done_too(
    tmp_path: Path, skip: tuple[tuple[int, ...], ...]
) -> None:
    handle = made(tmp_path / "a.zarr", skip)
    with warnings.catch_warnings(action="error"):
        ds = xr.open_zarr(handle.path).load()
    for index in indices(handle):
        at, truth = handle.tiling.at(index).slices, results(handle, index)
        for variable in handle.variables:
            expected = variable.fill if index in skip else truth[variable.name]
            np.testing.assert_array_equal(ds[variable.name].values[at], expected)


def test_a_cell_is_read_with_the_chunk_around_it_alone(whole: store.AtlasStore) -> None:
    ds = atlas.open(whole.path)
    size = (whole.path / "largest/c/0/0").stat().st_size
    taken: list[int] = []
    get = BackendStore.get

    async def counting(self: BackendStore, key: str, *args: object, **named: object) -> object:
        found = await get(self, key, *args, **named)  # type: ignore[arg-type]
        taken.append(len(found.to_bytes()) if found is not None and "/c/" in key else 0)
        return found

    with pytest.MonkeyPatch.context() as patch, count_chunk_reads():
        patch.setattr(BackendStore, "get", counting)
        np.testing.assert_array_equal(ds.largest[3, 5].values, results(whole, (0, 0))["largest"][3, 5])
    assert 0 < sum(taken) < size / 3


@pytest.mark.parametrize("tile", [(0, 0), (1, 1)])
def test_a_flipped_byte_anywhere_in_a_shard_is_found_and_verify_names_it(
    whole: store.AtlasStore, tile: tuple[int, int]
) -> None:
    key = f"largest/c/{tile[0]}/{tile[1]}"
    path = whole.path / key
    before = path.read_bytes()
    for byte in [0, 1, *np.linspace(2, len(before) - 1, 12).astype(int).tolist()]:
        path.write_bytes(before)
        flip(path, byte)
        with pytest.raises(ChunkError, match=f"{key} is damaged"):
            read_tile(whole, tile)
    assert any(f"{key} is damaged" in fault.what for fault in verify(whole.path, sample=0).faults)


@pytest.mark.parametrize("tile", [(0, 0), (1, 1)])
@pytest.mark.parametrize("size", [0, 1, 3, 10, 400])
def test_a_torn_shard_is_named_by_whatever_reads_it(whole: store.AtlasStore, tile: tuple[int, int], size: int) -> None:
    key = f"largest/c/{tile[0]}/{tile[1]}"
    (whole.path / key).write_bytes((whole.path / key).read_bytes()[:size])
    y, x = (part.start for part in whole.tiling.at(tile).slices)
    with pytest.raises(ChunkError, match=f"{key} is damaged"):
        atlas.open(whole.path).largest[y, x].load()
    with pytest.raises(ChunkError, match=f"{key} is damaged"):
        atlas.open(whole.path).largest.load()
    with pytest.raises(ChunkError, match=f"{key} is damaged"):
        read_tile(whole, tile)


@pytest.mark.parametrize("tile", [(0, 0), (1, 1)])
def test_a_shard_that_is_gone_is_missing(whole: store.AtlasStore, tile: tuple[int, int]) -> None:
    key = f"largest/c/{tile[0]}/{tile[1]}"
    (whole.path / key).unlink()
    y, x = (part.start for part in whole.tiling.at(tile).slices)
    with pytest.raises(ChunkError, match=f"{key} is missing"):
        atlas.open(whole.path).largest[y, x].load()


@pytest.mark.parametrize("tile", [(0, 0), (0, 1), (1, 1)])
def test_a_damaged_shard_is_written_over(whole: store.AtlasStore, tile: tuple[int, int]) -> None:
    path = whole.path / "largest" / "c" / str(tile[0]) / str(tile[1])
    path.write_bytes(b"torn")
    drop_tile(whole, tile)
    again = results(whole, tile, seed=1)
    write_tile(whole, tile, again)
    np.testing.assert_array_equal(read_tile(whole, tile)["largest"], again["largest"])
    other = made(whole.path.parent / "other.zarr")
    write_tile(other, tile, again)
    assert path.read_bytes() == (other.path / path.relative_to(whole.path)).read_bytes()


def test_overviews_are_of_the_cells_of_shards(whole: store.AtlasStore) -> None:
    keep(whole, side=32, least=32)
    assert_view_is_true(whole)


def plane_in(tile: tuple[int, int], num: int = 66) -> atlas.Spec:
    axes = {"omega": {"start": 2.0, "stop": 4.0, "num": num}, "b": {"start": 0.1, "stop": 0.5, "num": 2}}
    return atlas.Spec("two-mass", axes=axes, solve=CHEAP, store={"tile": list(tile)})


def test_a_tile_solved_part_by_part_has_the_bits_of_small_tiles(tmp_path: Path, client: Client) -> None:
    atlas.run(plane_in((2, 66)), tmp_path / "large.zarr", client=client)
    atlas.run(plane_in((1, 8)), tmp_path / "small.zarr", client=client)
    large, small = (atlas.open(tmp_path / f"{name}.zarr").load() for name in ("large", "small"))
    for name in small.data_vars:
        assert large[name].values.tobytes() == small[name].values.tobytes(), name
    assert open_store(tmp_path / "large.zarr").tiling.count == 1
    assert verify(tmp_path / "large.zarr", sample=4).is_sound
    summary = extend(tmp_path / "large.zarr", tmp_path / "grown.zarr", refine={"b": 2}, client=client)
    assert summary.cells_solved == 66
    grown = atlas.open(tmp_path / "grown.zarr").load()
    assert grown.regime.values[::2].tobytes() == small.regime.values.tobytes()
