"""Solving cells of finished tiles again: failed ones, and others with a larger budget or a longer survival."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
import zarr
from click.testing import CliRunner, Result
from distributed import Client

import atlas
from atlas.check.verify import verify
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.store.added import add_allowances
from atlas.store.schema import BUDGET
from atlas.store.sidecar import notes_of
from atlas.store.store import create, done_tiles, read_header
from atlas.store.tiles import read_tile, write_tile
from atlas.task import attempt
from atlas.task.attempt import run_job
from atlas.task.retry import Retry, checked_retry
from atlas.task.task import Job
from workers.results import APERIODIC, CHAOTIC, FAILED, REGIME, UNDETERMINED
from workers.settings import MOST_PERIODS
from workers.tile import solve_tile

FEW, MORE = 40, 60
"""Budgets that leave cells of the plane undetermined, and that decide some of them."""


def plane_of_few(max_periods: int = FEW) -> atlas.Spec:
    return atlas.Spec(
        "two-mass",
        axes={"omega": {"start": 2.0, "stop": 4.0, "num": 7}, "b": {"start": 0.1, "stop": 0.5, "num": 5}},
        solve={"max_periods": max_periods, "survival": 0, "tolerance": 0.1, "section_samples": 2},
        store={"tile": (2, 3)},
    )


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory, client: Client) -> Path:
    path = tmp_path_factory.mktemp("retry") / "few.zarr"
    atlas.run(plane_of_few(), path, client=client)
    return path


@pytest.fixture
def store(solved: Path, tmp_path: Path) -> Path:
    """A store with undetermined cells of its own for each test."""
    return Path(shutil.copytree(solved, tmp_path / "out.zarr"))


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
    expected = solve_tile("two-mass", fresh.cell_params((slice(0, 5), slice(0, 7))), fresh.settings)
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


def test_a_tile_that_is_lost_after_a_retry_is_solved_within_the_budget_of_the_spec(store: Path, client: Client) -> None:
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
    notes_of(store).put("started-" + "-".join(map(str, index)), b'{"attempt": 2}', expected=None)
    monkeypatch.setattr(attempt, "solve_isolated", lambda job, slices: "it died")
    add_allowances(header, [BUDGET])
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
        ("periodic", MORE, "unknown regime to retry 'periodic'"),
        ("chaotic", MORE, "chaotic cells come out the same within the same survival; give --survival above 0"),
        ("faild", None, "did you mean 'failed'?"),
        (",", None, "retry: found none, must be one or more of chaotic, undetermined, failed, aperiodic"),
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
    shown = call("retry", tmp_path / "out.zarr", "failed")
    assert (shown.exit_code, len(shown.stderr.splitlines())) == (2, 1)
    assert "no such store" in shown.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_command_solves_cells_of_a_store_again_and_needs_no_spec(store: Path, client: Client) -> None:
    shown = call("retry", store, "undetermined", "--max-periods", MORE, "--scheduler", client.scheduler.address)
    assert shown.exit_code == 0
    expected = solve_tile(
        "two-mass", plane_of_few().cell_params((slice(0, 5), slice(0, 7))), plane_of_few(MORE).settings
    )
    np.testing.assert_array_equal(whole(store)["regime"], expected["regime"])


def test_leaving_a_retry_to_a_cluster_needs_its_address(tmp_path: Path) -> None:
    shown = call("retry", tmp_path / "out.zarr", "failed", "--submit")
    assert (shown.exit_code, len(shown.stderr.splitlines())) == (2, 1)
    assert "give its --scheduler too" in shown.stderr


# Survival

BRIEF, LONG = 0, 64_000
"""Periods for which chaos is watched: not at all, and long enough to cost some."""


def chaotic_plane(survival: int = BRIEF, exponents: str = "largest", max_periods: int = 2000) -> atlas.Spec:
    """A plane of 4 x 3 cells, chaotic ones among them; with a wider stop some are known to settle late."""
    return atlas.Spec(
        "two-mass",
        axes={"omega": [1.4, 1.5, 1.6, 2.5], "b": [0.1, 0.26, 0.3]},
        solve={"max_periods": max_periods, "survival": survival, "tolerance": 0.1, "exponents": exponents},
        store={"tile": (2, 2)},
    )


@pytest.fixture
def watched(tmp_path: Path, client: Client) -> Path:
    atlas.run(chaotic_plane(), tmp_path / "chaos.zarr", client=client)
    return tmp_path / "chaos.zarr"


def retry_of(spec: atlas.Spec, names: str = "chaotic", **given: int) -> atlas.RunOptions:
    return atlas.RunOptions(retry=checked_retry(spec, names, **given))


def whole_block(spec: atlas.Spec) -> dict[str, np.ndarray]:
    return solve_tile("two-mass", spec.cell_params(tuple(slice(0, n) for n in spec.shape)), spec.settings)


def test_chaotic_cells_come_out_as_in_an_atlas_with_that_survival(watched: Path, client: Client) -> None:
    before, spec = whole(watched), chaotic_plane()
    chaotic = before["regime"] == CHAOTIC
    assert 0 < chaotic.sum() < 12
    summary = atlas.run(spec, watched, client=client, options=retry_of(spec, survival=LONG))
    assert summary.cells_solved == chaotic.sum()
    after, expected = whole(watched), whole_block(chaotic_plane(LONG))
    for name, values in before.items():
        assert same(after[name], values)[~chaotic].all(), name
        assert same(after[name], expected[name])[chaotic].all(), name
    np.testing.assert_array_equal(after["survival"], np.where(chaotic, LONG, BRIEF))
    still = after["regime"] == CHAOTIC
    assert (after["survived"][still] >= LONG // 32).all()
    assert summary.changed == (chaotic & ~still).sum()
    assert "changed regime" in str(summary)


def test_a_retry_of_chaotic_cells_leaves_a_store_that_is_sound_to_the_bit(watched: Path, client: Client) -> None:
    spec = chaotic_plane()
    atlas.run(spec, watched, client=client, options=retry_of(spec, survival=LONG))
    report = verify(watched, sample=12)
    assert (report.fine, report.cells_solved, report.comparison) == (True, 12, "bits")


def test_a_survival_changed_by_hand_is_a_fault(watched: Path, client: Client) -> None:
    spec = chaotic_plane()
    atlas.run(spec, watched, client=client, options=retry_of(spec, survival=LONG))
    cell = tuple(np.argwhere(whole(watched)["regime"] == CHAOTIC)[0].tolist())
    zarr.open_group(watched, mode="r+")["survival"][cell] = LONG + 1
    (fault,) = verify(watched, sample=0).faults
    assert fault.what.startswith("its chunks were not written together here")


def test_a_retry_of_chaotic_cells_done_twice_solves_nothing_the_second_time(watched: Path, client: Client) -> None:
    spec = chaotic_plane()
    atlas.run(spec, watched, client=client, options=retry_of(spec, survival=LONG))
    assert (whole(watched)["regime"] == CHAOTIC).any()
    assert atlas.run(spec, watched, client=client, options=retry_of(spec, survival=LONG)).cells_solved == 0
    again = atlas.run(spec, watched, client=client, options=retry_of(spec, survival=LONG + 1))
    assert again.cells_solved == (whole(watched)["regime"] == CHAOTIC).sum()


def test_a_retry_of_chaotic_cells_that_was_stopped_goes_on_with_the_tiles_left(watched: Path, client: Client) -> None:
    spec, header = chaotic_plane(), read_header(watched)
    retry = checked_retry(spec, "chaotic", survival=LONG)
    add_allowances(header, retry.raises)
    tiles = {index: int((read_tile(header, index)["regime"] == CHAOTIC).sum()) for index in done_tiles(header)}
    first = next(index for index, count in sorted(tiles.items()) if count)
    run_job(Job(first, str(watched), header.run_id, header.solver_version, retry))
    summary = atlas.run(spec, watched, client=client, options=atlas.RunOptions(retry=retry))
    assert summary.cells_solved == sum(tiles.values()) - tiles[first]


def test_undetermined_and_chaotic_cells_are_solved_again_together(tmp_path: Path, client: Client) -> None:
    """A budget of 500 leaves cells undetermined that one of 2000 decides; either kind gets both."""
    spec, store = chaotic_plane(max_periods=500), tmp_path / "out.zarr"
    atlas.run(spec, store, client=client)
    chosen = np.isin(whole(store)["regime"], (CHAOTIC, UNDETERMINED))
    options = retry_of(spec, "chaotic,undetermined", max_periods=2000, survival=LONG)
    assert atlas.run(spec, store, client=client, options=options).cells_solved == chosen.sum() > 0
    after, expected = whole(store), whole_block(chaotic_plane(LONG))
    assert same(after["regime"], expected["regime"])[chosen].all()
    assert same(after["largest"], expected["largest"])[chosen].all()
    assert verify(store, sample=12).fine


@pytest.mark.slow
def test_aperiodic_cells_can_be_watched_for_longer(tmp_path: Path, client: Client) -> None:
    spec, store = chaotic_plane(survival=400, exponents="none"), tmp_path / "out.zarr"
    atlas.run(spec, store, client=client)
    aperiodic = whole(store)["regime"] == APERIODIC
    assert aperiodic.any()
    assert atlas.run(spec, store, client=client, options=retry_of(spec, "aperiodic", survival=LONG)).cells_solved
    after, expected = whole(store), whole_block(chaotic_plane(LONG, exponents="none"))
    assert all(same(after[name], expected[name])[aperiodic].all() for name in expected)
    assert verify(store, sample=12).fine


def test_cells_watched_for_longer_are_not_taken_over_by_a_grown_atlas(
    watched: Path, tmp_path: Path, client: Client
) -> None:
    spec = chaotic_plane()
    atlas.run(spec, watched, client=client, options=retry_of(spec, survival=LONG))
    atlas.extend(watched, tmp_path / "grown.zarr", refine={"b": 2}, client=client)
    grown, fresh = whole(tmp_path / "grown.zarr"), whole_block(spec)
    assert "survival" not in grown
    assert all(same(grown[name][::2], values).all() for name, values in fresh.items())


@pytest.mark.slow
def test_a_tile_of_chaotic_cells_is_solved_again_by_a_process_of_its_own_too(watched: Path) -> None:
    spec, header = chaotic_plane(), read_header(watched)
    retry = checked_retry(spec, "chaotic", survival=LONG)
    add_allowances(header, retry.raises)
    index = next(i for i in sorted(done_tiles(header)) if (read_tile(header, i)["regime"] == CHAOTIC).any())
    notes_of(watched).put("started-" + "-".join(map(str, index)), b'{"attempt": 2}', expected=None)
    receipt = run_job(Job(index, str(watched), header.run_id, header.solver_version, retry))
    assert receipt.cells == (read_tile(header, index)["survival"] == LONG).sum() > 0


@pytest.mark.parametrize(
    ("names", "survival", "message"),
    [
        ("chaotic", 48_000, "survival: found 48000, must exceed the spec's 48000"),
        ("chaotic", MOST_PERIODS + 1, f"and be at most {MOST_PERIODS}"),
        ("aperiodic", None, "aperiodic cells come out the same within the same survival; give --survival above 48000"),
        ("failed", 50_000, "survival: is for chaotic and aperiodic cells, found failed"),
    ],
)
def test_a_survival_that_could_change_nothing_is_refused_in_one_line(
    tmp_path: Path, names: str, survival: int | None, message: str
) -> None:
    create(tmp_path / "out.zarr", atlas.Spec.from_toml("tiny"), (2, 2))
    before = sorted(tmp_path.rglob("*"))
    given = [] if survival is None else ["--survival", survival]
    shown = call("retry", tmp_path / "out.zarr", names, *given)
    assert (shown.exit_code, len(shown.stderr.splitlines())) == (2, 1)
    assert message in shown.stderr
    assert sorted(tmp_path.rglob("*")) == before


def test_the_fixed_schedule_has_no_survival_to_raise() -> None:
    spec = atlas.Spec("two-mass", {"omega": [2.0]}, solve={"method": "fixed"})
    with pytest.raises(InputError, match='method = "fixed" has no survival'):
        checked_retry(spec, "chaotic", survival=10**6)
