"""Solving cells of an atlas again into a new store: undetermined ones with a larger budget, chaotic ones for longer.

Truth: the cells of an atlas whose spec has these settings, solved without a service; all others, the old store's bytes.
"""

import json
import os
import shutil
from collections.abc import Callable
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
from atlas.service.retry import validate_retry
from atlas.store.backend import LocalBackend, StoreBackend
from atlas.store.create import create_store
from atlas.store.host import host_from_facts
from atlas.store.host_records import read_hosts, record_host
from atlas.store.origin import Origin, RetryRequest
from atlas.store.store import chunk_key, done_tiles, open_store
from atlas.store.tiles import read_tile
from workers.results import APERIODIC, CHAOTIC, REGIME, UNDETERMINED
from workers.settings import MAX_PERIODS
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
def old(solved_once: Callable[[atlas.Spec], Path]) -> Path:
    """A plane with undetermined cells. No test changes it."""
    return solved_once(plane_of_few())


@pytest.fixture(scope="module")
def retried(old: Path, client: Client) -> atlas.service.summary.RunSummary:
    return atlas.retry(old, old.with_name("more.zarr"), "undetermined", max_periods=MORE, client=client)


@pytest.fixture(scope="module")
def new(old: Path, retried: object) -> Path:
    return old.with_name("more.zarr")


def whole(store: Path) -> dict[str, np.ndarray]:
    ds = xr.open_zarr(store)
    return {str(name): ds[name].values for name in ds.data_vars}


def same(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cells whose values agree to the bit."""
    equal = (a == b) | ((a != a) & (b != b))
    return equal.reshape(*equal.shape[:2], -1).all(axis=-1)


def solved_apart(spec: atlas.Spec) -> dict[str, np.ndarray]:
    return solve_tile("two-mass", spec.cell_params(tuple(slice(0, n) for n in spec.shape)), spec.settings)


def test_the_chosen_cells_come_out_as_with_that_budget_and_all_others_as_before(
    old: Path, new: Path, retried: Any
) -> None:
    before, after, expected = whole(old), whole(new), solved_apart(plane_of_few(MORE))
    chosen = before["regime"] == UNDETERMINED
    assert 3 < chosen.sum() == retried.cells_solved < 35
    assert (expected["regime"][chosen] != UNDETERMINED).any()
    for name, values in before.items():
        assert same(after[name], values)[~chosen].all(), name
        assert same(after[name], expected[name])[chosen].all(), name


def test_the_old_store_does_not_change(old: Path, client: Client, tmp_path: Path) -> None:
    before = {key: (old / key).read_bytes() for key in LocalBackend(old).list_keys()}
    atlas.retry(old, tmp_path / "new.zarr", ["undetermined"], max_periods=MORE, client=client)
    assert {key: (old / key).read_bytes() for key in LocalBackend(old).list_keys()} == before


def test_the_store_says_what_each_cell_might_cost(old: Path, new: Path) -> None:
    before, after = whole(old), whole(new)
    assert "budget" not in before
    np.testing.assert_array_equal(after["budget"], np.where(before["regime"] == UNDETERMINED, MORE, FEW))
    assert (after["periods_used"] <= after["budget"]).all()


def test_the_store_says_from_where_and_why(old: Path, new: Path) -> None:
    handle = open_store(new)
    assert handle.origin == Origin(
        os.path.relpath(old, new), open_store(old).run_id, RetryRequest(("undetermined",), MORE)
    )
    noted = zarr.open_group(new, mode="r").attrs
    assert json.loads(str(noted["origin_retry"])) == {
        "regimes": ["undetermined"],
        "max_periods": MORE,
        "survival": None,
    }


def test_the_summary_counts_the_cells_that_changed_their_regime(old: Path, new: Path, retried: Any) -> None:
    changed = int((whole(old)["regime"] != whole(new)["regime"]).sum())
    assert (retried.retried, retried.changed, retried.tiles_done) == (True, changed, 9)
    assert f"{changed} cells changed regime" in str(retried)


def test_the_new_store_is_sound_to_the_bit(new: Path) -> None:
    report = verify(new, sample=35)
    assert (report.is_sound, report.cells_solved, report.comparison) == (True, 35, "bits")


def test_tiles_without_such_cells_are_the_same_files(old: Path, new: Path) -> None:
    handle = open_store(old)
    shared = {index for index in done_tiles(handle) if not (read_tile(handle, index)["regime"] == UNDETERMINED).any()}
    assert 0 < len(shared) < 9
    for variable in handle.variables:
        for index in done_tiles(handle):
            key = chunk_key(variable, index)
            if (old / key).exists() and (new / key).exists():  # no object says that no cell has a reason
                is_link = index in shared and variable.name != "regime"  # the object that finishes a tile is its own
                assert (old / key).samefile(new / key) == is_link, key


def test_where_there_are_no_links_the_bytes_are_copied(
    old: Path, tmp_path: Path, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    def link(self: LocalBackend, other: StoreBackend, key: str) -> None:
        raise PermissionError("no links")

    monkeypatch.setattr(LocalBackend, "_link", link)
    atlas.retry(old, tmp_path / "new.zarr", "undetermined", max_periods=MORE, client=client)
    assert verify(tmp_path / "new.zarr", sample=0).is_sound


def test_the_machines_of_the_old_store_are_listed(old: Path, tmp_path: Path, client: Client) -> None:
    another = host_from_facts({"processor": "Z80"})
    copy = tmp_path / "old.zarr"
    atlas.retry(old, copy, "undetermined", max_periods=MORE, client=client)
    record_host(open_store(copy), another)
    atlas.retry(copy, tmp_path / "new.zarr", "undetermined", max_periods=MORE + 10, client=client)
    assert another.name in {machine.name for machine in read_hosts(open_store(tmp_path / "new.zarr"))}


def test_a_retry_can_be_retried_and_keeps_what_cells_were_given(new: Path, tmp_path: Path, client: Client) -> None:
    before = whole(new)
    atlas.retry(new, tmp_path / "most.zarr", "undetermined", max_periods=2000, client=client)
    after, expected = whole(tmp_path / "most.zarr"), solved_apart(plane_of_few(2000))
    chosen = before["regime"] == UNDETERMINED
    assert 0 < chosen.sum() < (before["budget"] == MORE).sum()
    np.testing.assert_array_equal(after["budget"], np.where(chosen, 2000, before["budget"]))
    assert same(after["largest"], expected["largest"])[chosen].all()
    assert verify(tmp_path / "most.zarr", sample=35).is_sound


def test_an_interrupted_retry_goes_on_with_the_tiles_left(old: Path, tmp_path: Path, client: Client) -> None:
    def interrupt(progress: Any) -> None:
        if progress.tiles_done == 2:
            raise KeyboardInterrupt

    path = tmp_path / "new.zarr"
    with pytest.raises(KeyboardInterrupt):
        atlas.retry(old, path, "undetermined", max_periods=MORE, client=client, on_progress=interrupt)
    begun = len(done_tiles(open_store(path)))
    assert 2 <= begun < 9
    again = atlas.retry(old, path, "undetermined", max_periods=MORE, client=client)
    assert (again.tiles_done, again.tiles_solved) == (9, 9 - begun)


def test_a_run_of_the_spec_completes_a_retry_that_was_stopped(old: Path, tmp_path: Path, client: Client) -> None:
    handle = open_store(old)
    create_store(
        tmp_path / "new.zarr",
        handle.spec,
        handle.tile,
        Origin(str(old), handle.run_id, RetryRequest(("chaotic",), MORE)),
    )
    assert atlas.run(plane_of_few(), tmp_path / "new.zarr", client=client).tiles_done == 9
    assert verify(tmp_path / "new.zarr", sample=0).is_sound


def test_a_tile_that_is_lost_later_is_taken_or_solved_again_as_the_retry_did(
    old: Path, tmp_path: Path, client: Client
) -> None:
    path = tmp_path / "new.zarr"
    atlas.retry(old, path, "undetermined", max_periods=MORE, client=client)
    before = whole(path)
    for index in ((0, 0), (1, 1), (2, 2)):
        (path / chunk_key(REGIME, index)).unlink()
    atlas.run(plane_of_few(), path, client=client)
    assert all(same(values, before[name]).all() for name, values in whole(path).items())


def test_without_the_old_store_a_tile_that_is_lost_later_stays_so_and_the_error_says_why(
    old: Path, tmp_path: Path, client: Client
) -> None:
    copy, path = tmp_path / "old.zarr", tmp_path / "new.zarr"
    atlas.retry(old, copy, "undetermined", max_periods=MORE, client=client)
    atlas.retry(copy, path, "undetermined", max_periods=MORE + 10, client=client)
    (path / chunk_key(REGIME, (1, 1))).unlink()
    copy.rename(tmp_path / "away.zarr")
    failures = atlas.run(plane_of_few(), path, client=client).failures
    assert [failure.index for failure in failures] == [(1, 1)]
    assert "no such store; " in failures[0].message
    assert "copies cells from it: restore it, or recompute it with atlas run" in failures[0].message
    assert "retry it into a new store" in failures[0].message and "extend" not in failures[0].message


def test_damage_of_the_old_store_is_not_taken_over(old: Path, tmp_path: Path, client: Client) -> None:
    copy, path = tmp_path / "old.zarr", tmp_path / "new.zarr"
    atlas.retry(old, copy, "undetermined", max_periods=MORE, client=client)
    damaged = copy / chunk_key(next(v for v in open_store(copy).variables if v.name == "largest"), (0, 0))
    data = bytearray(damaged.read_bytes())
    data[len(data) // 2] ^= 1
    damaged.unlink()
    damaged.write_bytes(bytes(data))
    summary = atlas.retry(copy, path, "undetermined", max_periods=MORE + 10, client=client)
    assert [failure.index for failure in summary.failures] == [(0, 0)]
    assert "largest/c/0/0 is damaged" in summary.failures[0].message
    assert (0, 0) not in done_tiles(open_store(path))


@pytest.mark.parametrize(
    ("names", "max_periods", "message"),
    [
        ("undetermined", None, f"within the same budget; give --max-periods above {FEW}"),
        ("undetermined", FEW, f"max_periods: found {FEW}, must exceed the {FEW} that such cells were given"),
        ("undetermined", MAX_PERIODS + 1, f"and be at most {MAX_PERIODS}"),
        ("undetermined", "many", "max_periods: found many"),
        ("periodic", MORE, "unknown regime to retry 'periodic'"),
        ("failed", MORE, "unknown regime to retry 'failed'"),
        ("chaotic", MORE, "chaotic cells come out the same within the same survival; give --survival above 0"),
        ("chaotc", None, "did you mean 'chaotic'?"),
        (",", None, "regimes: found no name, must be one or more of chaotic, undetermined, aperiodic"),
    ],
)
def test_a_retry_that_could_change_nothing_is_refused(old: Path, names: str, max_periods: Any, message: str) -> None:
    with pytest.raises(InputError) as caught:
        atlas.retry(old, old.with_name("never.zarr"), names, max_periods)
    assert message in str(caught.value)
    assert not old.with_name("never.zarr").exists()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"regimes": 3}, "regimes: found 3, must be names"),
        ({"regimes": [3]}, "regimes: found 3, must be a name"),
        (
            {"regimes": "undetermined", "max_periods": MORE, "options": 3},
            "options: found 3, must be an atlas.RunOptions",
        ),
    ],
)
def test_arguments_of_a_wrong_kind_are_named(old: Path, tmp_path: Path, given: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        atlas.retry(old, tmp_path / "new.zarr", **given)


def test_a_budget_that_a_retry_gave_before_could_change_nothing(new: Path) -> None:
    with pytest.raises(InputError, match=f"must exceed the {MORE} that such cells were given"):
        validate_retry(open_store(new), ("undetermined",), MORE)


def test_a_retry_of_what_no_cell_is_solves_none_and_makes_the_store(old: Path, tmp_path: Path, client: Client) -> None:
    summary = atlas.retry(old, tmp_path / "new.zarr", "aperiodic", survival=10, client=client)
    assert (summary.cells_solved, summary.tiles_done) == (0, 9)
    assert verify(tmp_path / "new.zarr", sample=0).is_sound


def test_a_retry_of_an_incomplete_atlas_is_refused(tmp_path: Path) -> None:
    create_store(tmp_path / "old.zarr", plane_of_few(), (2, 3))
    with pytest.raises(InputError, match="0 of 9 tiles done: complete it first, with the command that began it"):
        atlas.retry(tmp_path / "old.zarr", tmp_path / "new.zarr", "undetermined", MORE)
    assert not (tmp_path / "new.zarr").exists()


def test_a_retry_into_the_store_itself_is_refused(old: Path) -> None:
    with pytest.raises(InputError, match="found the store to take cells from, must be another path"):
        atlas.retry(old, old, "undetermined", MORE)


def test_a_retry_into_another_store_is_refused(old: Path, new: Path) -> None:
    with pytest.raises(InputError, match="a store that was not made from"):
        atlas.retry(old, new, "undetermined", MORE + 1)


def test_a_store_that_is_no_retry_is_not_completed_by_one(old: Path, tmp_path: Path, client: Client) -> None:
    shutil.copytree(old, tmp_path / "plain.zarr")
    with pytest.raises(InputError, match="choose another path"):
        atlas.retry(old, tmp_path / "plain.zarr", "undetermined", MORE, client=client)


def test_the_largest_budget_of_any_spec_is_one_of_a_retry_too(old: Path) -> None:
    assert validate_retry(open_store(old), ("undetermined",), MAX_PERIODS).max_periods == MAX_PERIODS


@pytest.mark.parametrize(("names", "setting"), [("undetermined", "max_periods"), ("chaotic", "survival")])
def test_the_fixed_schedule_has_nothing_to_raise(tmp_path: Path, names: str, setting: str) -> None:
    spec = atlas.Spec("two-mass", {"omega": [2.0]}, solve={"method": "fixed"})
    handle = create_store(tmp_path / "fixed.zarr", spec, (1,))
    with pytest.raises(InputError, match='method = "fixed" has no'):
        validate_retry(handle, (names,), **{setting: 10**6})


def call(*args: object) -> Result:
    return CliRunner().invoke(main, [str(arg) for arg in args])


def test_a_retry_without_a_store_is_refused_and_writes_nothing(tmp_path: Path) -> None:
    shown = call("retry", tmp_path / "old.zarr", "undetermined", "-o", tmp_path / "new.zarr", "--max-periods", 9)
    assert (shown.exit_code, len(shown.stderr.splitlines())) == (2, 1)
    assert "no such store" in shown.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_retry_without_a_new_store_says_that_it_needs_one(old: Path) -> None:
    shown = call("retry", old, "undetermined", "--max-periods", MORE)
    assert shown.exit_code == 2
    assert "Missing option '-o'" in shown.stderr


def test_the_command_makes_the_new_store_and_needs_no_spec(old: Path, tmp_path: Path, client: Client) -> None:
    given = ["--max-periods", MORE, "--scheduler", client.scheduler.address]
    shown = call("retry", old, "undetermined", "-o", tmp_path / "new.zarr", *given)
    assert shown.exit_code == 0
    assert f"solving {(whole(old)['regime'] == UNDETERMINED).sum()} of 35 cells of {old} again" in shown.stderr
    np.testing.assert_array_equal(whole(tmp_path / "new.zarr")["regime"], solved_apart(plane_of_few(MORE))["regime"])


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


@pytest.fixture(scope="module")
def brief(tmp_path_factory: pytest.TempPathFactory, client: Client) -> Path:
    path = tmp_path_factory.mktemp("chaos") / "brief.zarr"
    atlas.run(chaotic_plane(), path, client=client)
    return path


@pytest.fixture(scope="module")
def long(brief: Path, client: Client) -> Path:
    atlas.retry(brief, brief.with_name("long.zarr"), "chaotic", survival=LONG, client=client)
    return brief.with_name("long.zarr")


def test_chaotic_cells_come_out_as_in_an_atlas_with_that_survival(brief: Path, long: Path) -> None:
    before, after, expected = whole(brief), whole(long), solved_apart(chaotic_plane(LONG))
    chaotic = before["regime"] == CHAOTIC
    assert 0 < chaotic.sum() < 12
    for name, values in before.items():
        assert same(after[name], values)[~chaotic].all(), name
        assert same(after[name], expected[name])[chaotic].all(), name
    np.testing.assert_array_equal(after["survival"], np.where(chaotic, LONG, BRIEF))
    still = after["regime"] == CHAOTIC
    assert (after["survived"][still] >= LONG // 32).all()


def test_a_retry_of_chaotic_cells_makes_a_store_that_is_sound_to_the_bit(long: Path) -> None:
    report = verify(long, sample=12)
    assert (report.is_sound, report.cells_solved, report.comparison) == (True, 12, "bits")


def test_a_survival_changed_by_hand_is_a_fault(long: Path, tmp_path: Path, client: Client) -> None:
    path = tmp_path / "longer.zarr"
    atlas.retry(long, path, "chaotic", survival=LONG + 1, client=client)
    cell = tuple(np.argwhere(whole(path)["regime"] == CHAOTIC)[0].tolist())
    zarr.open_group(path, mode="r+")["survival"][cell] = LONG + 2
    (fault,) = verify(path, sample=0).faults
    assert fault.what.startswith("its digest does not match")


def test_undetermined_and_chaotic_cells_are_solved_again_together(tmp_path: Path, client: Client) -> None:
    """A budget of 500 leaves cells undetermined that one of 2000 decides; either kind gets both."""
    spec, store, new = chaotic_plane(max_periods=500), tmp_path / "out.zarr", tmp_path / "new.zarr"
    atlas.run(spec, store, client=client)
    chosen = np.isin(whole(store)["regime"], (CHAOTIC, UNDETERMINED))
    summary = atlas.retry(store, new, ("chaotic", "undetermined"), 2000, LONG, client=client)
    assert summary.cells_solved == chosen.sum() > 0
    after, expected = whole(new), solved_apart(chaotic_plane(LONG))
    assert same(after["regime"], expected["regime"])[chosen].all()
    assert same(after["largest"], expected["largest"])[chosen].all()
    assert verify(new, sample=12).is_sound


@pytest.mark.slow
def test_aperiodic_cells_can_be_watched_for_longer(tmp_path: Path, client: Client) -> None:
    spec, store, new = chaotic_plane(survival=400, exponents="none"), tmp_path / "out.zarr", tmp_path / "new.zarr"
    atlas.run(spec, store, client=client)
    aperiodic = whole(store)["regime"] == APERIODIC
    assert aperiodic.any()
    assert atlas.retry(store, new, "aperiodic", survival=LONG, client=client).cells_solved == aperiodic.sum()
    after, expected = whole(new), solved_apart(chaotic_plane(LONG, exponents="none"))
    assert all(same(after[name], expected[name])[aperiodic].all() for name in expected)
    assert verify(new, sample=12).is_sound


def test_cells_watched_for_longer_are_not_taken_over_by_a_grown_atlas(
    long: Path, tmp_path: Path, client: Client
) -> None:
    atlas.extend(long, tmp_path / "grown.zarr", refine={"b": 2}, client=client)
    grown, fresh = whole(tmp_path / "grown.zarr"), solved_apart(chaotic_plane())
    assert "survival" not in grown
    assert all(same(grown[name][::2], values).all() for name, values in fresh.items())


@pytest.mark.parametrize(
    ("names", "survival", "message"),
    [
        ("chaotic", 48_000, "survival: found 48000, must exceed the 48000 that such cells were given"),
        ("chaotic", MAX_PERIODS + 1, f"and be at most {MAX_PERIODS}"),
        ("aperiodic", None, "aperiodic cells come out the same within the same survival; give --survival above 48000"),
    ],
)
def test_a_survival_that_could_change_nothing_is_refused_in_one_line(
    tmp_path: Path, names: str, survival: int | None, message: str
) -> None:
    create_store(tmp_path / "out.zarr", atlas.Spec.from_toml("tiny"), (2, 2))
    before = sorted(tmp_path.rglob("*"))
    given = [] if survival is None else ["--survival", survival]
    shown = call("retry", tmp_path / "out.zarr", names, "-o", tmp_path / "new.zarr", *given)
    assert (shown.exit_code, len(shown.stderr.splitlines())) == (2, 1)
    assert message in shown.stderr
    assert sorted(tmp_path.rglob("*")) == before


def test_a_survival_for_undetermined_cells_alone_is_refused(old: Path) -> None:
    with pytest.raises(InputError, match="survival: is for chaotic or aperiodic cells, found undetermined"):
        validate_retry(open_store(old), ("undetermined",), MORE, 9)
