"""Claims about reading a store with chunks that are damaged or gone: it is said which, and nothing is made up.

Truth is the same question put to the store before the damage, or the name of the chunk that was damaged.
"""

import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import zarr

import atlas
from atlas.check.verify import verify
from atlas.errors import ChunkError
from atlas.overview.builder import OverviewBuilder
from atlas.query.export import export
from atlas.query.queries import fractions
from atlas.query.resample import read_view
from atlas.render import figure
from atlas.store import create, store
from atlas.store.tile_records import complete_records
from atlas.store.tiles import drop_tile, read_tile, write_tile
from tests.corruption import flip
from tests.paths import ROOT
from tests.synthetic import assert_view_is_true, indices, keep, results, spec_of
from workers import solve_tile
from workers.results import PENDING, result_variables

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Solved cells, 64 of them in another order in every tile: sound, by all that is known of a cell."""
    handle = create.create_store(tmp_path_factory.mktemp("made") / "whole.zarr", spec_of(), (8, 8))
    cells = solve_tile("two-mass", handle.spec.cell_params((slice(4, 12), slice(10, 18))), handle.spec.settings)
    for index in indices(handle):
        shape = results(handle, index)["regime"].shape
        order = np.random.default_rng(index).permutation(64)[: shape[0] * shape[1]].reshape(shape)
        mixed = {name: array.reshape(64, *array.shape[2:])[order] for name, array in cells.items()}
        write_tile(handle, index, mixed)
    complete_records(handle)
    keep(handle)
    return handle.path


@pytest.fixture
def whole(made: Path, tmp_path: Path) -> store.AtlasStore:
    """38 x 45 cells in 5 x 6 tiles, with three levels."""
    return store.open_store(shutil.copytree(made, tmp_path / "whole.zarr"))


def overview_faults(handle: store.AtlasStore) -> list[str]:
    faults = verify(handle.path, sample=0).faults
    assert all(fault.tile is None for fault in faults)
    return [fault.what for fault in faults]


# Overviews


def test_sound_overviews_are_read_whole_and_found_sound(whole: store.AtlasStore) -> None:
    report = verify(whole.path, sample=0)
    files = [path for path in (whole.path / "overviews").rglob("*") if path.is_file() and "c" in path.parts]
    coordinates = coordinates_of(whole)
    axes = [path for path in files if path.relative_to(whole.path).parts[2] in coordinates]
    assert overview_faults(whole) == []
    assert report.overview_chunks == len(files) - len(axes)


def coordinates_of(handle: store.AtlasStore) -> set[str]:
    coarse = xr.open_zarr(handle.path, group="overviews/1", chunks=None)
    return {*map(str, coarse.coords), "omega_coarse_bounds", "b_coarse_bounds", "class"}


@pytest.mark.parametrize("name", ["largest", "regime", "regime_shown", "regime_share", "period_count", "sticks"])
def test_a_flipped_byte_of_an_overview_is_found(whole: store.AtlasStore, name: str) -> None:
    key = f"overviews/2/{name}/c/1/0" + ("/0" if name == "regime_share" else "")
    flip(whole.path / key)
    assert overview_faults(whole) == [f"{key} is damaged (its checksum is wrong)"]


def test_a_lost_chunk_of_an_overview_is_found(whole: store.AtlasStore) -> None:
    (whole.path / "overviews/1/largest/c/1/2").unlink()
    assert overview_faults(whole) == ["overviews/1/largest/c/1/2 is missing"]


@pytest.mark.parametrize("level", [1, 2, 3])
def test_an_overview_that_says_something_else_than_its_cells_is_found(whole: store.AtlasStore, level: int) -> None:
    array = zarr.open_group(whole.path, mode="r+", use_consolidated=False)[f"overviews/{level}/periods_used"]
    array[0, 0] += 1e-3
    assert overview_faults(whole) == [f"overviews/{level}/periods_used/c/0/0 differs from the cells below it: 1 number"]


def test_an_overview_of_a_tile_that_is_not_done_is_found(whole: store.AtlasStore) -> None:
    (whole.path / "regime/c/4/5").unlink()
    faults = verify(whole.path, sample=0).faults
    assert [fault.what for fault in faults if fault.tile is not None] == ["regime/c/4/5 is missing"]
    assert [fault.what for fault in faults if fault.tile is None] == [
        f"overviews/{level}/regime/c/{place} covers tile (4, 5), which is not done"
        for level, place in ((1, "2/2"), (2, "1/1"), (3, "0/0"))
    ]


def test_repair_drops_a_bad_overview_with_all_above_it_and_they_are_made_anew(
    whole: store.AtlasStore, made: Path
) -> None:
    flip(whole.path / "overviews/1/largest/c/1/1")
    report = verify(whole.path, sample=0, repair=True)
    assert (report.repaired, report.dropped) == ((), 3)
    assert keep(whole) == 3
    assert verify(whole.path, sample=0).is_sound
    for level in (1, 2, 3):
        before, after = (xr.open_zarr(path, group=f"overviews/{level}") for path in (made, whole.path))
        xr.testing.assert_identical(before.load(), after.load())


def test_a_bad_tile_takes_all_overviews_of_it_with_it(whole: store.AtlasStore) -> None:
    flip(whole.path / "largest/c/0/0")
    report = verify(whole.path, sample=0, repair=True)
    assert report.repaired == ((0, 0),)
    assert all(xr.open_zarr(whole.path, group=f"overviews/{n}").regime.values[0, 0] == PENDING for n in (1, 2, 3))
    assert verify(whole.path, sample=0).faults == ()


@pytest.mark.parametrize("name", ["regime", "regime_shown", "largest", "regime_share"])
@pytest.mark.parametrize("lost", [True, False])
def test_where_an_overview_is_bad_its_cells_are_read(whole: store.AtlasStore, name: str, lost: bool) -> None:
    for level in (1, 2, 3):
        path = whole.path / f"overviews/{level}/{name}/c/0/0" / ("0" if name == "regime_share" else "")
        path.unlink() if lost else flip(path)
    assert_view_is_true(whole)


def test_overviews_with_damaged_metadata_are_not_read(whole: store.AtlasStore) -> None:
    (whole.path / "overviews/2/largest/zarr.json").write_text("{")
    assert_view_is_true(whole)
    (whole.path / "overviews/zarr.json").write_text("{")
    assert_view_is_true(whole)


@pytest.mark.parametrize(
    ("key", "lost"),
    [("largest/zarr.json", False), ("largest/zarr.json", True), ("omega_coarse/c/0", True), ("class/c/0", False)],
)
def test_metadata_and_coordinates_of_overviews_are_checked_and_made_anew(
    whole: store.AtlasStore, key: str, lost: bool
) -> None:
    path = whole.path / "overviews/2" / key
    path.unlink() if lost else path.write_bytes(b"{")
    faults = overview_faults(whole)
    assert faults and all(fault.startswith(f"overviews/2/{key.partition('/')[0]}") for fault in faults)
    verify(whole.path, sample=0, repair=True)
    assert keep(whole) == 0  # metadata are written again, no chunk is
    assert verify(whole.path, sample=0).is_sound


@pytest.mark.parametrize("tile", [(0, 0), (2, 3), (4, 5)])
def test_an_overview_does_not_speak_for_a_tile_that_is_gone(whole: store.AtlasStore, tile: tuple[int, int]) -> None:
    whole.path.joinpath("regime", "c", *map(str, tile)).unlink()
    assert_view_is_true(whole)


def test_an_overview_is_not_made_of_a_lost_chunk(whole: store.AtlasStore) -> None:
    (whole.path / "largest/c/4/5").unlink()
    for level, place in ((1, "2/2"), (2, "1/1"), (3, "0/0")):
        for name in ("regime", "regime_shown"):
            (whole.path / f"overviews/{level}/{name}/c/{place}").unlink()
    with pytest.raises(ChunkError, match="largest/c/4/5 is missing"):
        overviews = OverviewBuilder(whole)
        overviews.finish()


def test_a_run_drops_an_overview_whose_marks_are_damaged(whole: store.AtlasStore) -> None:
    for name in ("regime", "regime_shown"):
        flip(whole.path / f"overviews/1/{name}/c/0/0")
    tile = read_tile(whole, (0, 0))
    drop_tile(whole, (0, 0))
    overviews = OverviewBuilder(whole)
    write_tile(whole, (0, 0), tile)
    assert overviews.finish() == 3
    assert_view_is_true(whole)


# Cells

VARIABLES = [variable.name for variable in result_variables(spec_of().settings) if not variable.sparse]


def chunk(handle: store.AtlasStore, name: str) -> Path:
    return handle.path.joinpath(name, "c", "0", "0", *(["0"] if name == "state" else []))


@pytest.mark.parametrize("lost", [True, False])
@pytest.mark.parametrize("name", ["largest", "period", "sticks", "state"])
def test_a_bad_chunk_is_named_by_whatever_reads_it(
    whole: store.AtlasStore, tmp_path: Path, name: str, lost: bool
) -> None:
    chunk(whole, name).unlink() if lost else flip(chunk(whole, name))
    ds = atlas.open(whole.path)
    key = chunk(whole, name).relative_to(whole.path)
    fault = "is missing" if lost else "is damaged (its checksum is wrong)"
    asked = [
        lambda: ds.atlas.where_regime("chaotic"),
        lambda: export(ds, tmp_path / "a.csv"),
        lambda: export(ds, tmp_path / "a.nc"),
        lambda: ds[name].values,
        lambda: read_view(ds, [name]).load(),
    ]
    asked += [lambda: ds.atlas.at(omega=1, b=0.1)] if name != "state" else []
    for ask in asked:
        with pytest.raises(ChunkError) as error:
            ask()
        line = f"{whole.path}: {key} {fault}: atlas verify --repair {whole.path}, then run it again"
        assert str(error.value) == line
    assert not list(tmp_path.glob("a.*"))


@pytest.mark.parametrize("lost", [True, False])
def test_a_picture_of_a_bad_chunk_is_not_drawn(whole: store.AtlasStore, lost: bool) -> None:
    chunk(whole, "largest").unlink() if lost else flip(chunk(whole, "largest"))
    with pytest.raises(ChunkError, match="largest/c/0/0 is"):
        figure(atlas.open(whole.path), window={"omega": (1.0, 1.5), "b": (0.1, 0.2)})


def test_shares_of_a_damaged_regime_are_not_told(whole: store.AtlasStore) -> None:
    flip(chunk(whole, "regime"))
    with pytest.raises(ChunkError, match="regime/c/0/0 is damaged"):
        fractions(atlas.open(whole.path), {"omega": (1.0, 1.2), "b": (0.1, 0.12)})


def test_what_is_not_done_is_no_damage(whole: store.AtlasStore) -> None:
    for name in VARIABLES:
        chunk(whole, name).unlink(missing_ok=True)  # none of reasons where there are none
    ds = atlas.open(whole.path)
    assert (ds.regime.values[:8, :8] == PENDING).all()
    assert np.isnan(ds.largest.values[:8, :8]).all()


def test_the_message_survives_the_way_between_processes(whole: store.AtlasStore) -> None:
    error = ChunkError(whole.backend, {"regime/c/0/0": "is missing"})
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


@pytest.mark.parametrize("command", [["export", "--out", "cells.csv"], ["plot", "--out", "map.png"]])
def test_a_command_that_meets_damage_says_one_line_and_nothing_else(
    whole: store.AtlasStore, tmp_path: Path, command: list[str]
) -> None:
    for path in (whole.path / "largest" / "c").rglob("*"):
        if path.is_file():
            flip(path)
    name, *options = command
    done = subprocess.run(
        [sys.executable, "-c", "from atlas.cli.main import main; main()", name, str(whole.path), *options],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    lines = [line for line in done.stderr.splitlines() if line not in ("drawing", "reading and writing")]
    assert len(lines) == 1
    assert lines[0].startswith(f"Error: {whole.path}: ")
    assert lines[0].endswith(
        f" is damaged (its checksum is wrong): atlas verify --repair {whole.path}, then run it again"
    )
