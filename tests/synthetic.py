"""Stores with made-up results, for tests of what is read and written and not of what is solved; and naive twins."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import zarr

import atlas
from atlas.overview.builder import OverviewBuilder
from atlas.query.resample import read_view
from atlas.store import create, store
from atlas.store.metadata import seal, unsealed
from atlas.store.record_format import Rows
from atlas.store.schema import SPEC_KEY
from atlas.store.tile_records import TileRecords, write_records
from atlas.store.tiles import read_tile, record_of
from workers.results import CHAOTIC, PENDING, PERIODIC, empty_results, result_variables

Index = tuple[int, ...]
_MADE: dict[tuple[object, ...], dict[Path, bytes]] = {}
"""The files of each store that ``complete`` has made."""


def spec_of(nx: int = 45, ny: int = 38, **axis: object) -> atlas.Spec:
    """A plane of nx x ny cells; ``axis`` changes the first axis."""
    omega = {"start": 1.0, "stop": 4.0, "num": nx} | axis
    return atlas.Spec("two-mass", axes={"omega": omega, "b": {"start": 0.1, "stop": 0.5, "num": ny}})


def results(handle: store.AtlasStore, index: Index, seed: int = 0) -> dict[str, np.ndarray]:
    """Random results of a tile: every regime but pending and failed, exponents -inf and NaN among them."""
    rng = np.random.default_rng([seed, *index])
    shape = handle.tiling.at(index).shape
    made = empty_results(result_variables(handle.spec.settings), shape, {"exponent": 4, "state": 4, "sample": 0})
    made["regime"] = rng.choice([0, 1, 1, 1, 2, 3, 3, 4, 5], shape).astype(np.int8)
    made["largest"] = largest = np.where(made["regime"] == CHAOTIC, 1.0, -1.0) * rng.random(shape)
    largest[rng.random(shape) < 0.1] = -np.inf
    largest[made["regime"] >= 4] = np.nan
    made["period"] = np.where(made["regime"] == PERIODIC, rng.integers(1, 4, shape), 0).astype(np.int32)
    made["impacts_upper"] = np.where(made["regime"] == PERIODIC, rng.integers(0, 2, shape), 0).astype(np.int32)
    made["sticks"] = rng.random(shape) < 0.3
    made["periods_used"] = rng.integers(100, 200, shape).astype(np.int32)
    return made


def indices(handle: store.AtlasStore) -> list[Index]:
    return [tile.index for tile in handle.tiling.tiles()]


def fill(handle: store.AtlasStore, skip: tuple[Index, ...] = (), seed: int = 0) -> None:
    """Write all tiles but some, without overviews."""
    tiles = {index: results(handle, index, seed) for index in indices(handle)}
    group = zarr.open_group(handle.path, mode="r+", use_consolidated=False)
    for variable in handle.variables:
        array: Any = group[variable.name]
        whole = array[...]
        for index, made in tiles.items():
            whole[handle.tiling.at(index).slices] = made[variable.name]
        array.with_config({"write_empty_chunks": True})[...] = whole  # all chunks at once: a tenth of the time
    for index in skip:
        handle.path.joinpath("regime", "c", *map(str, index)).unlink()


def overviews_of(handle: store.AtlasStore, side: int = 8, least: int = 8) -> OverviewBuilder:
    """Overviews with chunks of 8 cells and levels down to 8, so that a small plane has many of both."""
    return OverviewBuilder(handle, side=side, minimum=least)


def keep(handle: store.AtlasStore, side: int = 8, least: int = 8) -> int:
    """Make all overviews that can be made; the number of chunks made."""
    overviews = overviews_of(handle, side=side, least=least)
    return overviews.finish()


def complete(
    path: Path, tile: Index = (8, 8), spec: atlas.Spec | None = None, side: int = 8, least: int = 8
) -> store.AtlasStore:
    """A whole store with its overviews; a store that was asked for before is written file by file."""
    spec = spec or spec_of()
    files = _MADE.get(key := (spec.digest, tile, side, least))
    if files is None:
        handle = create.create_store(path, spec, tile)
        fill(handle)
        keep(handle, side, least)
        _MADE[key] = {file.relative_to(path): file.read_bytes() for file in path.rglob("*") if file.is_file()}
        return handle
    for name, data in files.items():
        file = path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)
    return store.open_store(path)


def set_attribute(path: Path, name: str, value: object) -> None:
    """Make a store one whose metadata were made with another value of an attribute."""
    change_attributes(path, lambda attributes: attributes.update({name: value}))


def change_attributes(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Make a store one whose metadata were made with attributes that ``change`` has changed."""
    for key in ("zarr.json", SPEC_KEY):
        data = (path / key).read_bytes()
        attributes = unsealed(data) or {}
        change(attributes)
        node = json.loads(data) | {"attributes": seal(attributes)}
        (path / key).write_bytes(json.dumps(node).encode())


def blocks(values: np.ndarray, level: int) -> list[list[np.ndarray]]:
    """The cells below each coarse cell, one small array each."""
    n = 2**level
    rows = range(0, values.shape[0], n)
    return [[values[y : y + n, x : x + n] for x in range(0, values.shape[1], n)] for y in rows]


def each_block(values: np.ndarray, level: int, function: object) -> np.ndarray:
    return np.array([[function(block) for block in row] for row in blocks(values, level)])  # type: ignore[operator]


def naive_shares(codes: np.ndarray) -> dict[int, float]:
    return {code: float(np.mean(codes == code)) for code in np.unique(codes).tolist()}


def assert_view_is_true(handle: store.AtlasStore) -> None:
    """Every level that can be looked at is what the cells in the store say, by definitions applied to the cells."""
    ds = atlas.open(handle.path)
    base = atlas.open(handle.path).load()
    codes = base.regime.values
    largest = np.where(codes == PENDING, np.nan, base.largest.values)
    for level in range(1, store_levels(handle) + 1):
        ny, nx = (-(-n // 2**level) for n in codes.shape)
        seen = read_view(ds, ["largest"], pixels=(nx, ny), marks=False)
        assert seen.sizes["omega"] == nx
        np.testing.assert_array_equal(seen.regime.values, each_block(codes, level, mode))
        np.testing.assert_allclose(seen.largest.values, each_block(largest, level, mean), rtol=1e-12)
        pending = each_block(codes, level, lambda block: (block == PENDING).any())
        shown = read_view(ds, ["largest"], pixels=(nx, ny))
        np.testing.assert_array_equal(shown.regime.values == PENDING, pending)
        assert np.isnan(shown.largest.values[pending]).all()
    naive = {code: share for code, share in naive_shares(codes).items()}
    names = dict(zip(base.regime.attrs["flag_values"], base.regime.attrs["flag_meanings"].split(), strict=True))
    found = ds.atlas.fractions().to_dict()
    assert set(found) == {names[code] for code in naive}
    np.testing.assert_allclose([found[names[code]] for code in naive], list(naive.values()), rtol=1e-12)


def assert_overviews_are_of(handle: store.AtlasStore) -> None:
    """Every chunk that counts as current, by either mark, says what the cells say now."""
    codes, largest = (atlas.open(handle.path)[name].values for name in ("regime", "largest"))
    coarse = xr.open_zarr(handle.path, group="overviews/1", chunks=None)
    for mark in (coarse.regime.values, coarse.regime_shown.values):
        current = mark != PENDING
        np.testing.assert_allclose(coarse.largest.values[current], each_block(largest, 1, mean)[current], rtol=1e-12)
    current = coarse.regime.values != PENDING
    np.testing.assert_array_equal(coarse.regime.values[current], each_block(codes, 1, mode)[current])


def store_levels(handle: store.AtlasStore) -> int:
    from atlas.overview.pyramid import Pyramid

    return Pyramid(handle).levels.count


def mode(block: np.ndarray) -> int:
    codes, counts = np.unique(block, return_counts=True)
    return int(codes[counts == counts.max()].max())


def mean(block: np.ndarray) -> float:
    finite = block[np.isfinite(block)]
    if finite.size:
        return float(finite.mean())
    return -np.inf if (block == -np.inf).any() else np.nan


def arrays_of(path: Path, group: str | None = None) -> dict[str, bytes]:
    ds = xr.open_zarr(path, group=group, chunks=None)  # without Dask: a tenth of the time
    return {str(name): ds[name].values.tobytes() for name in ds.data_vars}


def put_record(handle: store.AtlasStore, index: Index, row: Rows) -> None:
    """Write the record of a tile into the table."""
    rows = TileRecords(handle, store.done_mask(handle)).columns().copy()
    rows[index] = row
    write_records(handle, rows)


def record_again(path: Path) -> store.AtlasStore:
    """Write the record of each tile by the cells that it has now."""
    handle = store.open_store(path)
    for index in store.done_tiles(handle):
        put_record(handle, index, record_of(handle, index, read_tile(handle, index)))
    return handle
