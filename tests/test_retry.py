"""Solving failed and undetermined cells of finished tiles again."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
import zarr
from click.testing import CliRunner, Result
from distributed import Client

import atlas
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.store.sidecar import notes_of
from atlas.store.store import add_budget, done_tiles, read_header
from atlas.store.tiles import read_tile, write_tile
from atlas.task import attempt
from atlas.task.attempt import run_job
from atlas.task.retry import Retry, checked_retry
from atlas.task.task import Job
from workers.results import FAILED, REGIME, UNDETERMINED, result_variables
from workers.settings import MOST_PERIODS
from workers.tile import solve_cells

FEW, MORE = 40, 60
"""Budgets that leave cells of the plane undetermined, and that decide some of them."""


def plane_of_few(max_periods: int = FEW) -> atlas.Spec:
    return atlas.Spec(
        "two-mass",
        axes={"omega": {"start": 2.0, "stop": 4.0, "num": 7}, "b": {"start": 0.1, "stop": 0.5, "num": 5}},
        solve={"max_periods": max_periods, "tolerance": 0.1, "section_samples": 2},
        store={"tile": (2, 3)},
    )


@pytest.fixture
def store(tmp_path: Path, client: Client) -> Path:
    atlas.run(plane_of_few(), tmp_path / "out.zarr", client=client)
    return tmp_path / "out.zarr"


def whole(store: Path) -> dict[str, np.ndarray]:
    ds = xr.open_zarr(store)
    return {str(name): ds[name].values for name in ds.data_vars}


def same(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cells whose values agree to the bit."""
    equal = (a == b) | ((a != a) & (b != b))
    return equal.reshape(*equal.shape[:2], -1).all(axis=-1)


def test_only_the_chosen_cells_are_solved_again_and_come_out_as_with_that_budget(store: Path, client: Client) -> None:
    before, spec = whole(store), plane_of_few()
    chosen = before["regime"] == UNDETERMINED
    assert 3 < chosen.sum() < 35
    summary = atlas.run(spec, store, client=client, options=atlas.RunOptions(retry=Retry((UNDETERMINED,), MORE)))
    assert summary.cells_solved == chosen.sum()
    after = whole(store)
    fresh = plane_of_few(MORE)
    expected = solve_cells("two-mass", fresh.cell_params((slice(0, 5), slice(0, 7))), fresh.settings).arrays
    assert (expected["regime"][chosen] != UNDETERMINED).any()
    for name, values in before.items():
        assert same(after[name], values)[~chosen].all(), name
        assert same(after[name], expected[name])[chosen].all(), name


def test_the_store_says_what_each_cell_might_cost(store: Path, client: Client) -> None:
    before = whole(store)
    assert "budget" not in before
    chosen = before["regime"] == UNDETERMINED
    atlas.run(plane_of_few(), store, client=client, options=atlas.RunOptions(retry=Retry((UNDETERMINED,), MORE)))
    after = whole(store)
    np.testing.assert_array_equal(after["budget"], np.where(chosen, MORE, FEW))
    assert (after["periods_used"] <= after["budget"]).all()


def test_a_retry_done_twice_solves_nothing_the_second_time(store: Path, client: Client) -> None:
    retry = Retry((UNDETERMINED,), MORE)
    atlas.run(plane_of_few(), store, client=client, options=atlas.RunOptions(retry=retry))
    assert (whole(store)["regime"] == UNDETERMINED).any()
    assert atlas.run(plane_of_few(), store, client=client, options=atlas.RunOptions(retry=retry)).cells_solved == 0


def test_tiles_without_such_cells_are_not_touched(store: Path, client: Client) -> None:
    header = read_header(store)
    due = {
        index
        for index in done_tiles(header)
        if (read_tile(header, index, [REGIME.name])[REGIME.name] == UNDETERMINED).any()
    }
    assert 0 < len(due) < 9
    kept = {p: p.stat().st_mtime_ns for p in (store / "regime" / "c").rglob("*") if p.is_file()}
    atlas.run(plane_of_few(), store, client=client, options=atlas.RunOptions(retry=Retry((UNDETERMINED,), MORE)))
    changed = {p for p, time in kept.items() if p.stat().st_mtime_ns != time}
    assert {(int(p.parent.name), int(p.name)) for p in changed} == due


def test_failed_cells_are_solved_again_within_the_budget_they_had(store: Path, client: Client) -> None:
    before, header = whole(store), read_header(store)
    arrays = read_tile(header, (1, 1))
    arrays["regime"][0, :2] = FAILED
    write_tile(header, (1, 1), arrays)
    assert (whole(store)["regime"] == FAILED).sum() == 2
    summary = atlas.run(plane_of_few(), store, client=client, options=atlas.RunOptions(retry=Retry((FAILED,))))
    assert summary.cells_solved == 2
    after = whole(store)
    for name, values in before.items():
        assert same(after[name], values).all(), name


def test_a_tile_at_the_edge_is_unfinished_too_while_it_is_written_again(
    store: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    header, edge = read_header(store), (2, 2)
    arrays = read_tile(header, edge)
    assert arrays["regime"].shape == (1, 1)
    seen: list[bool] = []
    whole_write = zarr.Array.__setitem__

    def looking(array: zarr.Array[Any], key: Any, value: Any) -> None:
        seen.append(edge in done_tiles(header))
        whole_write(array, key, value)

    monkeypatch.setattr(zarr.Array, "__setitem__", looking)
    assert edge in done_tiles(header)
    write_tile(header, edge, arrays)
    assert seen
    assert not any(seen)
    assert edge in done_tiles(header)


def test_a_kill_between_the_arrays_leaves_the_tile_unfinished_and_never_a_mixture(
    store: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    header = read_header(store)
    index = next(i for i in sorted(done_tiles(header)) if (read_tile(header, i)["regime"] == UNDETERMINED).any())
    job = Job(index, str(store), header.run_id, header.solver_version, Retry((UNDETERMINED,), MORE))
    names = [variable.name for variable in result_variables(header.spec.settings)]
    whole_write = zarr.Array.__setitem__
    everything = done_tiles(header)
    for dies_at in names:

        def dying(array: zarr.Array[Any], key: Any, value: Any, dies_at: str = dies_at) -> None:
            if array.basename == dies_at:
                raise KeyboardInterrupt
            whole_write(array, key, value)

        with monkeypatch.context() as patch:
            patch.setattr(zarr.Array, "__setitem__", dying)
            with pytest.raises(KeyboardInterrupt):
                run_job(job)
        assert done_tiles(header) == everything - {index}, dies_at
        run_job(Job(index, str(store), header.run_id, header.solver_version))  # as the next plain run does
    block = header.tiling.at(index).slices
    fresh = solve_cells("two-mass", header.spec.cell_params(block), header.spec.settings).arrays
    stored = read_tile(header, index)
    for name, values in fresh.items():
        np.testing.assert_array_equal(stored[name], values, err_msg=name)


def test_a_plain_run_after_a_retry_that_was_killed_takes_the_larger_budget_back(store: Path, client: Client) -> None:
    atlas.run(plane_of_few(), store, client=client, options=atlas.RunOptions(retry=Retry((UNDETERMINED,), MORE)))
    (store / "regime" / "c" / "1" / "1").unlink()
    atlas.run(plane_of_few(), store, client=client)
    assert (read_tile(read_header(store), (1, 1))["budget"] == FEW).all()


def test_a_tile_that_kills_its_process_in_a_retry_fails_only_in_the_cells_chosen(
    store: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    header = read_header(store)
    index = next(i for i in sorted(done_tiles(header)) if (read_tile(header, i)["regime"] == UNDETERMINED).any())
    before = read_tile(header, index)
    chosen = before["regime"] == UNDETERMINED
    notes_of(store).put("started-" + "-".join(map(str, index)), b"1", expected=None)
    monkeypatch.setattr(attempt, "run_isolated", lambda job: "it died")
    add_budget(header)
    receipt = run_job(Job(index, str(store), header.run_id, header.solver_version, Retry((UNDETERMINED,), MORE)))
    assert receipt.reasons == {"it died": int(chosen.sum())}
    after = read_tile(header, index)
    assert (after["regime"][chosen] == FAILED).all()
    assert np.isnan(after["largest"][chosen]).all()
    np.testing.assert_array_equal(after["largest"][~chosen], before["largest"][~chosen])
    np.testing.assert_array_equal(after["budget"], np.where(chosen, MORE, FEW))


@pytest.mark.parametrize(
    ("names", "max_periods", "message"),
    [
        ("undetermined", None, f"within the same budget; give --max-periods above {FEW}"),
        ("undetermined", FEW, f"max_periods: found {FEW}, must exceed the spec's {FEW}"),
        ("undetermined", MOST_PERIODS + 1, f"and be at most {MOST_PERIODS}"),
        ("chaotic", MORE, "unknown regime to retry 'chaotic'"),
        ("faild", None, "did you mean 'failed'?"),
        (",", None, "retry: found none, must be one or more of undetermined, failed"),
    ],
)
def test_a_retry_that_could_change_nothing_is_refused(names: str, max_periods: int | None, message: str) -> None:
    with pytest.raises(InputError) as caught:
        checked_retry(plane_of_few(), names, max_periods)
    assert message in str(caught.value)


def test_the_largest_budget_of_any_spec_is_one_of_a_retry_too() -> None:
    assert checked_retry(plane_of_few(), "undetermined", MOST_PERIODS).max_periods == MOST_PERIODS


def test_the_fixed_schedule_has_no_budget_to_raise() -> None:
    spec = atlas.Spec("two-mass", {"omega": [2.0]}, solve={"method": "fixed"})
    with pytest.raises(InputError, match='method = "fixed" has no budget'):
        checked_retry(spec, "failed", 10**6)


def call(*args: object) -> Result:
    return CliRunner().invoke(main, [str(arg) for arg in args])


def test_a_retry_without_a_store_is_refused_and_writes_nothing(tmp_path: Path) -> None:
    shown = call("run", "tiny", "-o", tmp_path / "out.zarr", "--retry", "failed")
    assert (shown.exit_code, len(shown.stderr.splitlines())) == (2, 1)
    assert "no such store, so there is nothing to retry" in shown.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_budget_without_a_retry_is_refused(tmp_path: Path) -> None:
    shown = call("run", "tiny", "-o", tmp_path / "out.zarr", "--max-periods", 5)
    assert (shown.exit_code, len(shown.stderr.splitlines())) == (2, 1)
    assert "--max-periods is for cells solved again" in shown.stderr
