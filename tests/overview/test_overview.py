"""Claims about overviews: what a coarse cell says, when a chunk of them is there, and that none ever lies.

Truth is the definition applied to the cells of the store, block by block.
"""

import itertools
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import zarr
from distributed import Client

import atlas
from atlas.check.overviews import check_overviews
from atlas.errors import ChunkError, RunError
from atlas.overview.builder import OverviewBuilder
from atlas.overview.coarsen import POSITIVE, coarsen, from_cells
from atlas.overview.levels import OverviewLevels
from atlas.overview.pyramid import Pyramid
from atlas.query.queries import fractions
from atlas.query.resample import read_view
from atlas.service.progress import Progress
from atlas.store import create, store
from atlas.store.object_backend import LocalBackend
from atlas.store.tiles import drop_tile, write_tile
from atlas.task import tile_job
from atlas.task.store_ref import StoreRef, WorkerRefusedError
from atlas.task.tile_job import RunJob, commit, execute_job, make_chunk
from tests.planes import plane_of
from tests.synthetic import (
    arrays_of,
    assert_overviews_are_of,
    assert_view_is_true,
    complete,
    each_block,
    fill,
    indices,
    keep,
    mean,
    mode,
    overviews_of,
    results,
    spec_of,
)
from workers.results import APERIODIC, CHAOTIC, FAILED, NO_IMPACT, PENDING, PERIODIC, REGIME, UNDETERMINED


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two stores of all tiles, to be copied: one without overviews, one with."""
    folder = tmp_path_factory.mktemp("made")
    fill(create.create_store(folder / "filled.zarr", spec_of(), (8, 8)))
    shutil.copytree(folder / "filled.zarr", folder / "whole.zarr")
    keep(store.open_store(folder / "whole.zarr"))
    return folder


@pytest.fixture
def shared(made: Path) -> store.AtlasStore:
    """A whole store with overviews, only to be read."""
    return store.open_store(made / "whole.zarr")


@pytest.fixture
def filled(made: Path, tmp_path: Path) -> store.AtlasStore:
    """A whole store without overviews."""
    return store.open_store(shutil.copytree(made / "filled.zarr", tmp_path / "filled.zarr"))


@pytest.fixture
def whole(made: Path, tmp_path: Path) -> store.AtlasStore:
    """A whole store with overviews."""
    return store.open_store(shutil.copytree(made / "whole.zarr", tmp_path / "whole.zarr"))


@pytest.fixture
def handle(tmp_path: Path) -> store.AtlasStore:
    return create.create_store(tmp_path / "a.zarr", spec_of(), (8, 8))


# What a coarse cell says


@pytest.mark.parametrize("level", [1, 2, 3])
def test_exponents_have_mean_count_and_positive_share_of_the_finite_values(
    shared: store.AtlasStore, level: int
) -> None:
    largest = atlas.open(shared.path).largest.values
    coarse = xr.open_zarr(shared.path, group=f"overviews/{level}", chunks=None)
    finite = each_block(largest, level, lambda block: np.isfinite(block).sum())
    positive = each_block(largest, level, lambda block: (np.isfinite(block) & (block > 0)).sum())
    np.testing.assert_allclose(coarse.largest.values, each_block(largest, level, mean), rtol=1e-12)
    np.testing.assert_array_equal(coarse.largest_count.values, finite)
    np.testing.assert_allclose((coarse.largest_positive * coarse.largest_count).fillna(0), positive, atol=1e-9)


@pytest.mark.parametrize("level", [1, 2, 3])
def test_the_regime_is_the_most_frequent_one_and_a_tie_goes_to_the_later(shared: store.AtlasStore, level: int) -> None:
    codes = atlas.open(shared.path).regime.values
    coarse = xr.open_zarr(shared.path, group=f"overviews/{level}", chunks=None)
    np.testing.assert_array_equal(coarse.regime.values, each_block(codes, level, mode))


@pytest.mark.parametrize("level", [1, 2, 3])
def test_period_and_impacts_are_those_of_a_periodic_cell_below(shared: store.AtlasStore, level: int) -> None:
    base = atlas.open(shared.path).load()
    names = ["period", "impacts_upper", "impacts_lower"]
    triples = np.stack([base[name].values for name in names], axis=-1)
    coarse = xr.open_zarr(shared.path, group=f"overviews/{level}", chunks=None).load()
    n = 2**level
    for y, x in np.ndindex(coarse.regime.shape):
        part = np.s_[y * n : y * n + n, x * n : x * n + n]
        below = triples[part][base.regime.values[part] == PERIODIC].tolist()
        found = [int(coarse[name][y, x]) for name in names]
        assert found in below or (not below and found == [0, 0, 0])
        assert below.count(found) >= coarse.period_count[y, x]


def test_at_the_first_level_the_triple_is_the_most_frequent_and_a_tie_goes_to_the_smallest() -> None:
    cells = {
        "regime": np.full((2, 4), PERIODIC, np.int8),
        "period": np.array([[3, 2, 3, 3], [2, 3, 1, 3]], np.int32),
        "impacts_upper": np.array([[1, 1, 1, 1], [1, 1, 1, 0]], np.int32),
        "impacts_lower": np.zeros((2, 4), np.int32),
    }
    names = [*cells, "period_count", "regime_share", "cells"]
    made = coarsen(from_cells(cells, names), (np.ones(2), np.ones(4)))
    assert made["period"].tolist() == [[2, 3]]
    assert made["impacts_upper"].tolist() == [[1, 1]]
    assert made["period_count"].tolist() == [[2, 2]]


def test_flags_and_costs_are_means_over_the_solved_cells(shared: store.AtlasStore) -> None:
    base = atlas.open(shared.path)
    coarse = xr.open_zarr(shared.path, group="overviews/2", chunks=None)
    for name in ("sticks", "periods_used"):
        np.testing.assert_allclose(coarse[name].values, each_block(base[name].values, 2, np.mean), rtol=1e-12)
    np.testing.assert_array_equal(coarse.cells.values, each_block(base.regime.values, 2, np.size))


def test_shares_weigh_cells_by_their_widths_on_a_log_axis(tmp_path: Path) -> None:
    handle = complete(tmp_path / "a.zarr", spec=spec_of(start=0.1, scale="log"))
    edges = np.exp(np.interp(np.arange(46) - 0.5, np.arange(45), np.log(handle.spec.axes[0].values)))
    edges[0], edges[-1] = 0.1**2 / edges[1], 4.0**2 / edges[-2]
    widths = np.broadcast_to(np.diff(edges), (38, 45))
    codes = atlas.open(handle.path).regime.values
    for level in (1, 3):
        coarse = xr.open_zarr(handle.path, group=f"overviews/{level}", chunks=None)
        chaotic = each_block(np.where(codes == CHAOTIC, widths, 0), level, np.sum) / each_block(widths, level, np.sum)
        np.testing.assert_allclose(coarse.regime_share.sel({"class": "chaotic"}), chaotic, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("level", [1, 2, 3])
def test_one_failed_cell_is_shown_at_every_level(handle: store.AtlasStore, level: int) -> None:
    for index in indices(handle):
        made = results(handle, index)
        made["regime"][made["regime"] == UNDETERMINED] = PERIODIC
        if index == (1, 2):
            made["regime"][1, 2] = FAILED
        write_tile(handle, index, made)
    keep(handle)
    coarse = xr.open_zarr(handle.path, group=f"overviews/{level}", chunks=None)
    assert np.argwhere(coarse.regime_shown.values == FAILED).tolist() == [[9 >> level, 18 >> level]]


@pytest.mark.parametrize(("other", "said"), [(CHAOTIC, APERIODIC), (UNDETERMINED, UNDETERMINED), (FAILED, FAILED)])
def test_a_tie_of_aperiodic_cells_goes_towards_doubt(other: int, said: int) -> None:
    codes = np.array([[APERIODIC, other], [other, APERIODIC]], np.int8)
    cells = coarsen(from_cells({"regime": codes}, ["regime_share", "cells"]), (np.ones(2), np.ones(2)))
    assert cells["regime"].item() == said


@pytest.mark.parametrize(("count", "shown"), [(1, UNDETERMINED), (0, PERIODIC)])
def test_undetermined_cells_are_shown_from_a_sixteenth_of_the_area_on(count: int, shown: int) -> None:
    codes = np.full((4, 4), PERIODIC, np.int8)
    codes[0, :count] = UNDETERMINED
    cells = from_cells({"regime": codes}, ["regime_share", "cells"])
    for n in (4, 2):
        cells = coarsen(cells, (np.ones(n), np.ones(n)))
    assert (cells["regime_shown"].item(), cells["regime"].item()) == (shown, PERIODIC)


def test_only_periodic_cells_have_a_period_in_levels() -> None:
    """Motion without impact has one in the atlas."""
    codes, period = np.array([[NO_IMPACT, PERIODIC, CHAOTIC]], np.int8), np.array([[1, 3, 0]], np.int32)
    cells = from_cells({"regime": codes, "period": period}, ["period", "period_count"])
    assert cells["period"].tolist() == [[0, 3, 0]]
    assert cells["period_count"].tolist() == [[0, 1, 0]]


def test_an_exponent_of_zero_is_not_positive_in_levels() -> None:
    codes, largest = np.full((1, 4), CHAOTIC, np.int8), np.array([[0.0, 1e-300, -1.0, -np.inf]])
    positive = from_cells({"regime": codes, "largest": largest}, [POSITIVE.name])[POSITIVE.name]
    np.testing.assert_array_equal(positive, [[0.0, 1.0, 0.0, np.nan]])


def test_levels_stop_when_no_side_is_longer_than_the_least_worth_a_picture(shared: store.AtlasStore) -> None:
    assert Pyramid(shared).levels.count == 3
    assert Pyramid(shared).levels.shape_of(3) == (5, 6)
    for side, count in ((8, 0), (9, 1), (16, 1), (17, 2)):
        assert OverviewLevels((3, side), (4, 4), chunk_side=8, min_side=8).count == count


def test_the_blocks_of_the_chunks_of_a_level_cover_its_cells_once() -> None:
    levels = OverviewLevels((38, 45), (8, 8), chunk_side=16, min_side=8)
    for level in range(1, levels.count + 1):
        covered = [
            cell
            for index in levels.chunks(level)
            for cell in itertools.product(*(range(part.start, part.stop) for part in levels.block(level, index)))
        ]
        assert sorted(covered) == [*np.ndindex(*levels.shape_of(level))]


# In the store


def test_plain_xarray_opens_the_store_and_each_level_without_a_warning(shared: store.AtlasStore) -> None:
    assert xr.open_zarr(shared.path).regime.shape == (38, 45)
    coarse = xr.open_zarr(shared.path, group="overviews/1", chunks=None)
    assert coarse.regime.dims == ("b_coarse", "omega_coarse")
    assert coarse.regime.shape == (19, 23)
    assert float(coarse.R) == 0.8
    assert coarse["class"].values.tolist()[0] == "pending"


def test_coarse_cells_have_the_edges_of_the_cells_below(shared: store.AtlasStore) -> None:
    coarse = xr.open_zarr(shared.path, group="overviews/2", chunks=None)
    step = 3.0 / 44
    edges = 1.0 - step / 2 + step * np.minimum(np.arange(13) * 4, 45)
    np.testing.assert_allclose(coarse.omega_coarse_bounds.values, np.stack([edges[:-1], edges[1:]], 1), rtol=1e-12)
    np.testing.assert_allclose(coarse.omega_coarse.values, (edges[:-1] + edges[1:]) / 2, rtol=1e-12)


def test_making_overviews_again_makes_nothing(filled: store.AtlasStore) -> None:
    assert keep(filled) == sum(len(list(Pyramid(filled).levels.chunks(level))) for level in (1, 2, 3))
    assert keep(filled) == 0


def test_a_chunk_above_an_unfinished_tile_is_not_made(handle: store.AtlasStore) -> None:
    fill(handle, skip=((0, 0),))
    keep(handle)
    for level in range(1, 4):
        missing = np.argwhere(xr.open_zarr(handle.path, group=f"overviews/{level}").regime.values == PENDING)
        assert len(missing)
        assert (missing < 8).all()


@pytest.mark.slow
def test_views_and_shares_of_a_half_done_atlas_are_true(handle: store.AtlasStore) -> None:
    pending = ((0, 0), (2, 3), (4, 5))
    fill(handle, skip=pending)
    keep(handle)
    assert_view_is_true(handle)


def test_an_atlas_without_overviews_is_seen_alike(handle: store.AtlasStore) -> None:
    fill(handle, skip=((2, 2),))
    assert_view_is_true(handle)


def test_a_run_goes_by_the_sizes_that_the_store_has(whole: store.AtlasStore) -> None:
    overviews = OverviewBuilder(whole)
    assert overviews.finish() == 0
    assert Pyramid(whole).levels.count == 3


@pytest.mark.slow
@pytest.mark.parametrize(
    "attributes", [{"side": 0}, {"least": "many"}, {"classes": 99}, {"classes": 8}, {"complete": False}]
)
def test_overviews_of_a_form_unknown_are_not_read_and_made_anew(
    whole: store.AtlasStore, attributes: dict[str, object]
) -> None:
    zarr.open_group(whole.path / "overviews", mode="r+", use_consolidated=False).update_attributes(attributes)
    assert_view_is_true(whole)
    assert keep(whole) == 14
    assert_view_is_true(whole)


def test_a_store_with_overviews_opens_as_a_tree_of_datasets(shared: store.AtlasStore) -> None:
    with xr.open_datatree(shared.path, engine="zarr") as tree:
        assert [*tree["overviews"].children] == ["1", "2", "3"]
        assert tree["overviews/2/largest"].sizes == {"b_coarse": 10, "omega_coarse": 12}
        xr.testing.assert_identical(
            tree["overviews/1"].to_dataset(inherit=False), xr.open_zarr(shared.path, group="overviews/1")
        )
        xr.testing.assert_identical(tree.to_dataset(), xr.open_zarr(shared.path))
        scales = tree["overviews"].attrs["multiscales"][0]
    assert scales["axes"] == ["b", "omega"]
    assert [dataset["path"] for dataset in scales["datasets"]] == ["..", "1", "2", "3"]
    assert scales["datasets"][2]["scale"] == [4, 4]


# During a run


@pytest.fixture
def begun(tmp_path: Path) -> Path:
    """A store without a tile whose overviews are to go down to 4 cells."""
    handle = create.create_store(tmp_path / "a.zarr", plane_of(), (2, 3))
    keep(handle, least=4)
    return handle.path


def test_a_run_leaves_overviews_of_all_levels(begun: Path, tmp_path: Path, client: Client) -> None:
    atlas.run(plane_of(), begun, client=client)
    coarse = xr.open_zarr(tmp_path / "a.zarr", group="overviews/1", chunks=None)
    assert (coarse.regime.values != PENDING).all()
    assert int(coarse.cells.sum()) == 35
    assert_view_is_true(store.open_store(tmp_path / "a.zarr"))


def test_finished_parts_of_an_unfinished_atlas_get_overviews(handle: store.AtlasStore) -> None:
    keep(handle)
    first = [tile for tile in indices(handle) if Pyramid(handle).levels.chunk_over(tile) == (0, 0)]
    for tile in first:
        write_tile(handle, tile, results(handle, tile))
    keep(handle)
    coarse = xr.open_zarr(handle.path, group="overviews/1", chunks=None).regime.values
    assert np.array_equal(np.argwhere(coarse != PENDING), np.argwhere(np.ones((8, 8))))
    assert_view_is_true(handle)


def test_an_interrupted_run_keeps_what_was_finished_and_goes_on(begun: Path, tmp_path: Path, client: Client) -> None:
    def interrupt(progress: Progress) -> None:
        if progress.tiles_done == 5 and progress.stage == "solving":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        atlas.run(plane_of(), tmp_path / "a.zarr", client=client, options=atlas.RunOptions(on_progress=interrupt))
    assert_overviews_are_of(store.open_store(tmp_path / "a.zarr"))
    atlas.run(plane_of(), tmp_path / "a.zarr", client=client)
    assert (xr.open_zarr(tmp_path / "a.zarr", group="overviews/1").regime.values != PENDING).all()


def test_a_lost_tile_that_is_solved_refreshes_all_that_lies_over_it_and_nothing_else(whole: store.AtlasStore) -> None:
    before = {path: path.stat().st_mtime_ns for path in (whole.path / "overviews").rglob("c/*/*") if path.is_file()}
    drop_tile(whole, (4, 5))
    overviews = OverviewBuilder(whole)
    write_tile(whole, (4, 5), results(whole, (4, 5), seed=1))
    assert overviews.finish() == 3
    changed = {path for path, time in before.items() if path.stat().st_mtime_ns != time}
    over = {1: "2/2", 2: "1/1", 3: "0/0"}
    for level, place in over.items():
        parts = {path for path in changed if f"overviews/{level}/" in path.as_posix()}
        assert parts
        assert {"/".join(path.parts[-2:]) for path in parts} == {place}
    assert_view_is_true(whole)


def test_overviews_that_cannot_be_written_are_told(filled: store.AtlasStore, monkeypatch: pytest.MonkeyPatch) -> None:

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Pyramid, "build_chunk", full)
    with pytest.raises(RunError, match=r"finished tiles are kept, but the overviews could not be written .*No space"):
        keep(filled)


# By workers


def job_of(handle: store.AtlasStore, index: tuple[int, ...], level: int = 0) -> RunJob:
    return RunJob(index, StoreRef(str(handle.path), handle.run_id, handle.solver_version), level=level)


def test_chunks_made_by_jobs_are_those_made_here_to_the_bit(filled: store.AtlasStore, whole: store.AtlasStore) -> None:
    due = overviews_of(filled)
    made = [
        (level, index)
        for level in due.levels
        for index in due.missing_chunks(level)
        if not execute_job(job_of(filled, index, level)).fault
    ]
    assert len(made) == 14
    assert not due
    for level in (1, 2, 3):
        group = f"overviews/{level}"
        assert arrays_of(filled.path, group) == arrays_of(whole.path, group)


def test_a_chunk_is_missing_until_it_is_made_and_can_be_made_when_all_below_it_is_done(
    handle: store.AtlasStore,
) -> None:
    fill(handle, skip=((0, 0), (4, 5)))
    overviews = overviews_of(handle)
    assert overviews.missing_chunks(1) == [
        index for index in Pyramid(handle).levels.chunks(1) if index not in ((0, 0), (2, 2))
    ]
    write_tile(handle, (0, 0), results(handle, (0, 0)))
    assert (0, 0) in overviews.missing_chunks(1)
    for index in ((0, 0), (0, 1), (1, 0)):
        execute_job(job_of(handle, index, 1))
    assert not {(0, 0), (0, 1), (1, 0)} & {*overviews.missing_chunks(1)}
    assert overviews.missing_chunks(2) == []
    execute_job(job_of(handle, (1, 1), 1))
    assert overviews.missing_chunks(2) == [(0, 0)]


def large(path: Path, tile: tuple[int, int] = (16, 16)) -> store.AtlasStore:
    """A store without a tile, of tiles larger than a chunk, each with a chunk of level 1 of its own."""
    handle = create.create_store(path, spec_of(), tile)
    overviews_of(handle)
    return handle


def made_of_level_1(handle: store.AtlasStore) -> set[tuple[int, ...]]:
    return Pyramid(handle).stored(1, REGIME)


@pytest.mark.slow
def test_of_a_tile_larger_than_a_chunk_the_chunk_of_level_1_is_made_of_its_arrays_to_the_bit(tmp_path: Path) -> None:
    handle, other = large(tmp_path / "a.zarr"), large(tmp_path / "b.zarr")
    assert Pyramid(handle).levels.chunk == (8, 8)
    for index in indices(handle):
        made = results(handle, index)
        write_tile(other, index, made)
        commit(handle, job_of(handle, index), made)
        assert Pyramid(handle).levels.chunk_over(index) in made_of_level_1(handle)
    assert [len(overviews_of(handle).missing_chunks(level)) for level in (1, 2, 3)] == [0, 4, 0]
    assert keep(other) == 9 + 4 + 1
    assert keep(handle) == 4 + 1
    for level in (1, 2, 3):
        group = f"overviews/{level}"
        assert arrays_of(handle.path, group) == arrays_of(other.path, group)
    assert_view_is_true(handle)
    assert check_overviews(handle, set(), lambda level: None)[1] == []


@pytest.mark.parametrize("tile", [(8, 8), (7, 9), (17, 16), (16, 8)])
def test_a_tile_whose_chunk_lies_over_others_too_is_left_to_a_job(tmp_path: Path, tile: tuple[int, int]) -> None:
    handle = large(tmp_path / "a.zarr", tile)
    commit(handle, job_of(handle, (0, 0)), results(handle, (0, 0)))
    assert not made_of_level_1(handle)
    if tile == (17, 16):  # neither a chunk nor a part of one
        fill(handle)
        keep(handle)
        assert_view_is_true(handle)


def test_a_run_has_its_workers_make_the_overviews(begun: Path, client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[tuple[int, tuple[int, ...]]] = []
    monkeypatch.setattr(tile_job, "make_chunk", lambda job: (made.append((job.level, job.index)), make_chunk(job))[1])
    atlas.run(plane_of(), begun, client=client)
    levels = Pyramid(store.open_store(begun)).levels
    assert sorted(made) == sorted(
        (level, index) for level in range(1, levels.count + 1) for index in levels.chunks(level)
    )
    assert_view_is_true(store.open_store(begun))


def test_chunks_that_no_worker_can_make_are_told_and_the_tiles_are_kept(
    begun: Path, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(Pyramid, "build_chunk", full)
    with pytest.raises(RunError, match=r"finished tiles are kept, but the overviews could not be written .*Input"):
        atlas.run(plane_of(), begun, client=client)
    assert len(store.done_tiles(store.open_store(begun))) == store.open_store(begun).tiling.count


def test_a_chunk_over_damage_is_named_at_the_end_and_no_worker_is_blamed(begun: Path, client: Client) -> None:
    atlas.run(plane_of(), begun, client=client)
    handle = store.open_store(begun)
    (begun / "largest" / "c" / "0" / "0").unlink()
    Pyramid(handle).drop([(0, 0), (2, 2)])
    drop_tile(handle, (2, 2))
    job = job_of(handle, (0, 0), 1)
    assert "largest/c/0/0 is missing" in getattr(execute_job(job), "fault", "")
    with pytest.raises(ChunkError, match="largest/c/0/0 is missing"):
        atlas.run(plane_of(), begun, client=client)
    assert len(store.done_tiles(handle)) == 9


def test_a_job_whose_run_has_lost_its_lease_finishes_no_chunk(filled: store.AtlasStore) -> None:
    overviews_of(filled)
    job = job_of(filled, (0, 0), 1)
    with pytest.raises(WorkerRefusedError, match="has lost its lease"):
        execute_job(replace(job, store_ref=replace(job.store_ref, lease="another")))
    assert not list(filled.backend.list_keys("overviews/1/regime/c/"))


# Killed at any step


class Killed(BaseException):
    """What stands for kill -9: nothing catches it."""


def killed_after(monkeypatch: pytest.MonkeyPatch, writes: int) -> None:
    """Let that many writes of arrays and of attributes, and removals of chunks, through, then none."""
    left = [writes]
    steps = (zarr.Array, "__setitem__"), (zarr.Group, "create_group"), (zarr.Group, "create_array")
    for kind, name in (*steps, (LocalBackend, "remove")):
        whole = getattr(kind, name)

        def write(*given: object, whole: object = whole, **named: object) -> object:
            left[0] -= 1
            if left[0] < 0:
                raise Killed
            return whole(*given, **named)  # type: ignore[operator]

        monkeypatch.setattr(kind, name, write)


def survive(handle: store.AtlasStore, monkeypatch: pytest.MonkeyPatch, writes: int, tile: tuple[int, int]) -> bool:
    """Repair a tile and solve it as a run does, killed after that many writes; whether it came to its end."""
    with monkeypatch.context() as patch:
        killed_after(patch, writes)
        try:
            Pyramid(handle).drop([tile])
            drop_tile(handle, tile)
            overviews = OverviewBuilder(handle)  # as a run does, which goes by what the store has
            write_tile(handle, tile, results(handle, tile, seed=1))
            overviews.finish()
        except Killed:
            return False
    return True


@pytest.mark.slow
def test_a_kill_between_any_two_writes_never_leaves_an_overview_that_lies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = spec_of(nx=20, ny=18)
    whole = create.create_store(tmp_path / "whole.zarr", spec, (8, 8))
    fill(whole)
    write_tile(whole, (2, 2), results(whole, (2, 2), seed=1))
    keep(whole, least=10)
    handle = complete(tmp_path / "a.zarr", (8, 8), spec, least=10)
    steps = 0
    while not survive(handle, monkeypatch, steps, (2, 2)):
        assert_overviews_are_of(handle)
        steps += 1
    assert steps > 25  # arrays of the tile and of the chunk over it
    assert_view_is_true(handle)
    assert arrays_of(handle.path, "overviews/1") == arrays_of(whole.path, "overviews/1")


@pytest.mark.slow
def test_a_kill_while_levels_are_created_leaves_a_store_that_works_and_goes_on(
    filled: store.AtlasStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    for writes in (0, 1, 20, 70):
        with monkeypatch.context() as patch:
            killed_after(patch, writes)
            with pytest.raises(Killed):
                keep(filled)
        assert xr.open_zarr(filled.path).regime.shape == (38, 45)
        assert fractions(atlas.open(filled.path)) == fractions(atlas.open(filled.path).load())
    keep(filled)
    assert_view_is_true(filled)


def test_a_run_killed_between_two_levels_is_completed_by_the_next(whole: store.AtlasStore) -> None:
    root = zarr.open_group(whole.path, mode="r+", use_consolidated=False)
    for level in (1, 3):
        for name in ("regime", "regime_shown"):
            array = root[f"overviews/{level}/{name}"].with_config({"write_empty_chunks": False})
            array[...] = PENDING
    assert keep(whole) == len(list(Pyramid(whole).levels.chunks(1))) + 1
    assert_view_is_true(whole)


def test_the_store_itself_stays_as_it_was(filled: store.AtlasStore) -> None:
    before = {name: data for name, data in arrays_of(filled.path).items()}
    spec = json.loads(xr.open_zarr(filled.path).attrs["spec"])
    keep(filled)
    assert arrays_of(filled.path) == before
    assert json.loads(xr.open_zarr(filled.path).attrs["spec"]) == spec


def test_a_view_with_marks_takes_away_what_the_shown_class_does_not_have(shared: store.AtlasStore) -> None:
    seen = read_view(atlas.open(shared.path), ["largest", "period"], pixels=(12, 10))
    shown = seen.regime.values
    assert np.isnan(seen.largest.values[shown == UNDETERMINED]).all()
    assert (seen.period.values[shown == NO_IMPACT] == 1).all()
    assert (seen.period.values[(shown != PERIODIC) & (shown != NO_IMPACT)] == 0).all()
