"""Claims about what views and shares read: the chunks in view, at the level that fits, of what the store holds."""

import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

import atlas
from atlas import render
from atlas.query.queries import fractions
from atlas.query.read_counter import ReadCounter, count_chunk_reads
from atlas.query.resample import read_view
from atlas.query.store_block import find_part
from atlas.query.window import cell_edges
from atlas.store import create, store
from atlas.store.tiles import write_tile
from tests.chunk_keys import noted_keys
from tests.paths import ROOT
from tests.synthetic import complete, fill, keep, results, spec_of
from workers.results import FAILED, PERIODIC

TILE = 8


@pytest.fixture(scope="module")
def handle(tmp_path_factory: pytest.TempPathFactory) -> store.AtlasStore:
    """100 x 90 cells in tiles of 8, levels in chunks of 16 down to 16 cells."""
    folder = tmp_path_factory.mktemp("view")
    return complete(folder / "a.zarr", (TILE, TILE), spec_of(nx=100, ny=90), side=16, least=16)


@pytest.fixture
def ds(handle: store.AtlasStore) -> xr.Dataset:
    return atlas.open(handle.path)


@pytest.fixture
def keys(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Keys of the chunks that Zarr gets from disk, whoever asks."""
    return noted_keys(monkeypatch, lambda key: "/c/" in key)


def of_cells(keys: list[str]) -> list[str]:
    return [key for key in keys if not key.startswith(("omega/", "b/", "component/"))]


def test_a_whole_plane_is_read_from_the_level_that_fits_its_pixels(ds: xr.Dataset, keys: list[str]) -> None:
    keys.clear()
    with count_chunk_reads() as reads:
        seen = read_view(ds, ["largest"], pixels=(25, 23))
    assert (reads.level, reads.block, seen.regime.shape) == (2, (4, 4), (23, 25))
    assert sorted(of_cells(keys)) == sorted(
        f"overviews/2/{name}/c/{y}/{x}" for name in ("largest", "regime_shown") for y in (0, 1) for x in (0, 1)
    )
    assert reads.chunks == 8


@pytest.mark.parametrize("window", [None, {"omega": (1.0, 2.0), "b": (0.1, 0.3)}])
def test_a_plane_of_dask_arrays_is_read_from_the_same_level(
    handle: store.AtlasStore, keys: list[str], window: dict[str, tuple[float, float]] | None
) -> None:
    """As pictures read a store that was opened with ``chunks``, a selection of it too."""
    seen, read = [], []
    for chunks in (None, {}):
        ds = atlas.open(handle.path, chunks=chunks)
        keys.clear()
        seen.append(read_view(ds.isel(omega=slice(2, 98)), ["largest"], window, pixels=(25, 23)))
        read.append(sorted(of_cells(keys)))
    assert read[0] == read[1] and all(key.startswith("overviews/") for key in read[0])
    xr.testing.assert_identical(*seen)
    assert seen[1].largest.chunks is None


def test_dask_arrays_with_other_values_are_not_taken_for_those_of_the_store(handle: store.AtlasStore) -> None:
    ds = atlas.open(handle.path, chunks={})
    assert find_part(ds, ["largest"]) is not None
    for changed in (ds.largest * 2, ds.error, ds.largest.roll(omega=1), ds.largest.fillna(0.0), ds.largest.compute()):
        assert find_part(ds.assign(largest=changed), ["largest"]) is None
    assert find_part(ds.where(ds.regime == PERIODIC), ["largest"]) is None
    assert find_part(ds.isel(omega=slice(None, None, 2)), ["largest"]) is None
    assert find_part(ds.isel(omega=slice(None, None, -1)), ["largest"]) is None


def test_what_was_read_says_at_which_resolution() -> None:
    assert str(ReadCounter(1)) == "1 chunk read from the store, at full resolution"
    coarse = "8 chunks read from the store, at reduced resolution: one value for 4 x 2 cells"
    assert str(ReadCounter(8, 2, (4, 2))) == coarse


def test_a_window_is_read_from_its_own_chunks_alone(ds: xr.Dataset, keys: list[str]) -> None:
    window = {"omega": (1.0, float(ds.omega[29])), "b": (0.1, float(ds.b[20]))}
    keys.clear()
    with count_chunk_reads() as reads:
        seen = read_view(ds, ["largest"], window, pixels=(15, 11))
    assert (reads.level, seen.regime.shape) == (1, (11, 15))
    assert sorted(of_cells(keys)) == ["overviews/1/largest/c/0/0", "overviews/1/regime_shown/c/0/0"]
    assert reads.chunks == 2


def test_cells_not_finer_than_pixels_are_read_themselves(ds: xr.Dataset) -> None:
    window = {"omega": (float(ds.omega[3]), float(ds.omega[12])), "b": (float(ds.b[8]), float(ds.b[15]))}
    with count_chunk_reads() as reads:
        seen = read_view(ds, ["largest"], window, pixels=(10, 8))
    assert (reads.level, reads.chunks) == (0, 4)
    np.testing.assert_array_equal(seen.largest.values, ds.largest.values[8:16, 3:13])


def test_pixels_do_not_change_what_is_read_where_none_are_given(ds: xr.Dataset) -> None:
    xr.testing.assert_identical(read_view(ds, ["period"]).load(), ds[["period", "regime"]].load())


def test_a_long_narrow_plane_is_coarsened_along_its_long_side_alone(tmp_path: Path) -> None:
    handle = create.create_store(tmp_path / "a.zarr", spec_of(nx=200, ny=12), (4, 50))
    fill(handle)
    keep(handle, side=256, least=128)
    ds = atlas.open(handle.path)
    with count_chunk_reads() as reads:
        seen = read_view(ds, ["periods_used"], pixels=(50, 12))
    assert (seen.regime.shape, reads.block) == ((12, 50), (4, 1))
    expected = ds.periods_used.values.reshape(12, 50, 4).mean(2)
    np.testing.assert_allclose(seen.periods_used.where(seen.regime != FAILED), expected, rtol=1e-12)


@pytest.mark.parametrize("pixels", [(1, 1), (2, 1), (1, 3), (3, 2)])
def test_a_plane_that_takes_fewer_pixels_than_the_last_level_has_cells_is_coarsened_on(
    ds: xr.Dataset, pixels: tuple[int, int]
) -> None:
    seen = read_view(ds, ["largest"], pixels=pixels)
    assert seen.sizes["omega"] <= 2 * pixels[0] and seen.sizes["b"] <= 2 * pixels[1]
    assert np.allclose([cell_edges(seen, "omega")[[0, -1]]], cell_edges(ds, "omega")[[0, -1]])


def test_a_coarse_view_ends_where_its_window_ends(ds: xr.Dataset) -> None:
    part = ds.isel(omega=slice(5, 62), b=slice(3, 50))
    seen = read_view(part, ["largest"], pixels=(10, 10))
    for name in ("omega", "b"):
        assert cell_edges(seen, name)[[0, -1]] == pytest.approx(cell_edges(part, name)[[0, -1]], rel=1e-12)


def test_the_widest_cells_of_an_uneven_axis_decide_the_level(tmp_path: Path) -> None:
    omega = np.concatenate([np.linspace(1, 1.1, 150), np.linspace(1.2, 4, 50)])
    spec = atlas.Spec("two-mass", axes={"omega": omega, "b": np.linspace(0.1, 0.5, 150)})
    handle = create.create_store(tmp_path / "a.zarr", spec, (50, 50))
    fill(handle)
    keep(handle, side=256, least=128)
    with count_chunk_reads() as reads:
        assert read_view(atlas.open(handle.path), [], pixels=(100, 100)).sizes["omega"] == 200
    assert reads.level == 0


def test_shares_of_a_whole_plane_need_one_chunk_of_the_last_level(ds: xr.Dataset, keys: list[str]) -> None:
    keys.clear()
    with count_chunk_reads() as reads:
        fractions(ds)
    assert sorted(of_cells(keys)) == ["overviews/3/regime/c/0/0", "overviews/3/regime_share/c/0/0/0"]
    assert reads.chunks == 2


@pytest.mark.parametrize("part", [(3, 97, 2, 88), (17, 18, 5, 80), (0, 100, 16, 32), (8, 9, 8, 9)])
def test_shares_in_a_window_are_those_of_its_cells_from_few_chunks(
    ds: xr.Dataset, part: tuple[int, int, int, int]
) -> None:
    left, right, low, high = part
    block = ds.isel(omega=slice(left, right), b=slice(low, high))
    with count_chunk_reads() as reads:
        found = fractions(block)
    expected = fractions(block.load())
    assert found == pytest.approx(expected, rel=1e-12)
    tiles = (-(-right // TILE) - left // TILE) * (-(-high // TILE) - low // TILE)
    assert 0 < reads.chunks <= max(tiles, 12)


def test_of_unfinished_regions_only_what_exists_is_read(tmp_path: Path, keys: list[str]) -> None:
    handle = create.create_store(tmp_path / "a.zarr", spec_of(nx=300, ny=280), (20, 20))
    for index in ((0, 0), (13, 14)):
        write_tile(handle, index, results(handle, index))
    keep(handle, side=256, least=128)
    keys.clear()
    with count_chunk_reads() as reads:
        seen = read_view(atlas.open(handle.path), ["largest"], pixels=(75, 70))
    assert len(of_cells(keys)) == reads.chunks == 2 * 2
    assert (seen.regime.values >= 0).sum() == 50


def test_what_a_worker_has_begun_to_write_is_not_seen(tmp_path: Path) -> None:
    handle = create.create_store(tmp_path / "a.zarr", spec_of(), (19, 23))
    fill(handle, skip=((0, 0),))
    assert np.isfinite(atlas.open(handle.path).largest.values[:19, :23]).any()
    seen = read_view(atlas.open(handle.path), ["largest", "periods_used"])
    pending = seen.regime.values == -1
    assert pending.any()
    assert np.isnan(seen.largest.values[pending]).all()
    assert (seen.periods_used.values[pending] == 0).all()


# What is not as the store has it


@pytest.mark.parametrize(
    "change",
    [
        lambda ds: ds.assign(largest=ds.largest * 0 + 7),
        lambda ds: ds.where(ds.regime == PERIODIC, 7),
        lambda ds: ds.copy(data={str(name): np.full(ds[name].shape, 7, ds[name].dtype) for name in ds.data_vars}),
        lambda ds: ds.rename(largest="error", error="largest"),
        lambda ds: ds.isel(omega=slice(None, None, -1)),
        lambda ds: ds.assign_coords(omega=ds.omega * 2),
        lambda ds: ds.isel(omega=slice(0, 50, 2)),
    ],
    ids=["computed", "masked", "replaced", "renamed", "turned", "other axis", "strided"],
)
def test_a_changed_atlas_is_drawn_as_it_is_and_not_as_the_store(ds: xr.Dataset, change: object) -> None:
    other = change(ds[["largest", "error", "regime"]])  # type: ignore[operator]
    seen = read_view(other, ["largest"], pixels=(10, 10))
    xr.testing.assert_equal(seen.load(), other[["largest", "regime"]].load())


def test_a_variable_of_another_atlas_is_drawn_as_what_it_is(ds: xr.Dataset, tmp_path: Path) -> None:
    handle = create.create_store(tmp_path / "b.zarr", spec_of(nx=100, ny=90), (50, 50))
    fill(handle, seed=1)
    mixed = ds.assign(largest=atlas.open(handle.path).largest)
    seen = read_view(mixed, ["largest"], pixels=(10, 10))
    np.testing.assert_array_equal(seen.largest, atlas.open(handle.path).largest)


def test_an_assignment_in_place_is_seen(ds: xr.Dataset) -> None:
    ds["largest"][0, 0] = 7.0
    assert float(read_view(ds, ["largest"], pixels=(10, 10)).largest[0, 0]) == 7.0


def test_that_a_variable_is_as_stored_is_found_without_a_read(
    ds: xr.Dataset, handle: store.AtlasStore, keys: list[str]
) -> None:
    part = ds.isel(omega=slice(3, 40))
    keys.clear()
    assert find_part(part, ["largest", "regime"]) is not None
    assert of_cells(keys) == []
    np.testing.assert_array_equal(part.largest, handle.arrays["largest"][:, 3:40])
    assert find_part(part.load(), ["largest", "regime"]) is None


def test_that_a_variable_is_as_stored_is_found_by_no_private_word_of_xarray() -> None:
    pages = [path.read_text() for path in (ROOT / "atlas").rglob("*.py") if "xarray" in path.read_text()]
    assert len(pages) > 10
    assert not any(re.search(r"variable\._|\._variables\b|[\"']_(data|array|copied)[\"']", page) for page in pages)


def test_a_selection_of_neighbours_still_reads_overviews(ds: xr.Dataset) -> None:
    with count_chunk_reads() as reads:
        read_view(ds.sel(omega=slice(1, 3)), ["largest"], pixels=(10, 10))
    assert reads.level > 0


# In pictures


FEW = (25, 23)
"""Pixels, a quarter as many as cells along each axis."""


def title(figure: Figure) -> str:
    return str(figure.axes[0].get_title("left"))


@pytest.mark.parametrize("kind", ["exponent", "period"])
def test_a_map_is_drawn_from_its_overview(ds: xr.Dataset, kind: str) -> None:
    with count_chunk_reads() as reads:
        figure = render.figure(ds, kind, pixels=FEW)
    assert (reads.level, reads.chunks) == (2, 2 * 4 + 2)
    assert "one cell drawn for 4 × 4 computed" in title(figure)


def test_a_coarse_map_names_the_exact_shares_of_doubtful_cells(ds: xr.Dataset) -> None:
    found = title(render.figure(ds, pixels=FEW))
    for name in ("undetermined", "invalid"):
        assert f"{name} {100 * fractions(ds)[name]:.2g} %" in found


def test_a_map_of_the_cells_themselves_says_nothing_of_it(ds: xr.Dataset) -> None:
    assert "computed" not in title(render.figure(ds))


def test_a_picture_of_a_window_has_its_limits(ds: xr.Dataset) -> None:
    ax = render.figure(ds, window={"omega": (2, 3), "b": (0.2, 0.3)}, pixels=FEW).axes[0]
    half = 1.5 * 3 / 99
    assert ax.get_xlim() == pytest.approx((2, 3), abs=half)
    assert ax.get_ylim() == pytest.approx((0.2, 0.3), abs=half)


def test_an_atlas_without_exponents_is_drawn_by_its_periods(tmp_path: Path) -> None:
    spec = atlas.Spec(
        "two-mass",
        axes={"omega": [2.0, 3.0], "b": [0.1, 0.2]},
        solve={"exponents": "none", "max_periods": 50, "transient_periods": 10},
    )
    handle = create.create_store(tmp_path / "a.zarr", spec, (2, 2))
    fill(handle)
    figure = render.figure(atlas.open(handle.path))
    assert any(text.get_text().startswith("period") for legend in figure.legends for text in legend.get_texts())
