import re
import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from click.testing import CliRunner
from distributed import Client

import atlas
from atlas.check.verify import verify
from atlas.cli.main import main
from atlas.errors import InputError, RunError
from atlas.service.extend import extend
from atlas.spec.axis import Axis
from atlas.spec.extension import keep_values, refine_spec
from atlas.store.create import create_store
from atlas.store.host import host_from_facts
from atlas.store.host_records import read_hosts, record_host
from atlas.store.object_backend import LocalBackend
from atlas.store.origin import Origin
from atlas.store.store import done_tiles, open_store
from atlas.task.reuse import reuse_cells
from tests.synthetic import record_again, set_attribute
from workers import tile as solving
from workers.results import FAILED

pytestmark = pytest.mark.slow

READS = 4
"""Of an object of the origin: by the program twice or thrice, by its one worker once."""
SOLVE = {"max_periods": 300, "tolerance": 0.1, "section_samples": 2}


def spec_of(omega: Any = (2.0, 2.4, 3.0, 4.0), b: Any = (0.1, 0.3, 0.5), **changes: Any) -> atlas.Spec:
    given = {"parameters": {}, "solve": SOLVE, "store": {"tile": [2, 2]}} | changes
    return atlas.Spec("two-mass", axes={"omega": list(omega), "b": list(b)}, **given)


@pytest.fixture(scope="module")
def solved(solved_once: Callable[[atlas.Spec], Path]) -> Path:
    return solved_once(spec_of())


@pytest.fixture
def old(solved: Path, tmp_path: Path) -> Path:
    """A whole atlas of 4 x 3 cells."""
    return Path(shutil.copytree(solved, tmp_path / "old.zarr"))


@pytest.fixture
def solved_cells(monkeypatch: pytest.MonkeyPatch) -> list[tuple[float, float]]:
    """The (omega, b) of every cell that the solver is given."""
    found: list[tuple[float, float]] = []
    whole = solving.solve_tile

    def noted(system, params, settings):  # type: ignore[no-untyped-def]
        grids = np.broadcast_arrays(params["omega"], params["b"])
        found.extend(zip(grids[0].ravel().tolist(), grids[1].ravel().tolist(), strict=True))
        return whole(system, params, settings)

    monkeypatch.setattr(solving, "solve_tile", noted)
    return found


def arrays_of(path: Path) -> dict[str, bytes]:
    ds = atlas.open(path)
    return {str(name): ds[name].values.tobytes() for name in ds.variables}


@pytest.mark.parametrize("factor", [2, 3])
def test_a_refined_atlas_has_the_bits_of_one_computed_from_scratch(
    old: Path, tmp_path: Path, client: Client, factor: int
) -> None:
    extend(old, tmp_path / "new.zarr", refine=factor, client=client)
    grown = open_store(tmp_path / "new.zarr").spec
    assert grown.shape == (2 * factor + 1, 3 * factor + 1)
    atlas.run(grown, tmp_path / "scratch.zarr", client=client)
    assert arrays_of(tmp_path / "new.zarr") == arrays_of(tmp_path / "scratch.zarr")


def test_refining_solves_every_new_cell_once_and_no_old_one(
    old: Path, tmp_path: Path, client: Client, solved_cells: list[tuple[float, float]]
) -> None:
    summary = extend(old, tmp_path / "new.zarr", refine=2, client=client)
    assert (summary.cells_solved, len(solved_cells)) == (7 * 5 - 12, 7 * 5 - 12)
    ds = atlas.open(old)
    assert not {(omega, b) for omega in ds.omega.values for b in ds.b.values} & set(solved_cells)
    assert len(set(solved_cells)) == len(solved_cells)
    assert sum(summary.counts.values()) == summary.cells_solved


def test_kept_cells_keep_all_their_results(old: Path, tmp_path: Path, client: Client) -> None:
    group = zarr.open_group(old, mode="r+", use_consolidated=False)
    marked = np.arange(12, dtype="int32").reshape(3, 4) + 1000  # nothing that solving could give
    group["periods_used"][...] = marked
    record_again(old)
    summary = extend(old, tmp_path / "new.zarr", refine=2, client=client)
    new = atlas.open(tmp_path / "new.zarr").periods_used.values
    assert (new[::2, ::2] == marked).all()
    assert new.sum() == marked.sum() + summary.periods


@pytest.mark.parametrize("tile", [[1, 1], [5, 7], [3, 2]])
def test_the_tiles_need_not_be_those_of_the_old_store(
    old: Path, tmp_path: Path, client: Client, tile: list[int]
) -> None:
    grown = refine_spec(spec_of(), {"omega": 2}, tuple(tile))
    assert extend(old, tmp_path / "new.zarr", grown, client=client).cells_solved == 3 * 3
    atlas.run(grown, tmp_path / "scratch.zarr", client=client)
    assert arrays_of(tmp_path / "new.zarr") == arrays_of(tmp_path / "scratch.zarr")


def test_an_axis_extended_at_both_ends_keeps_what_is_between(old: Path, tmp_path: Path, client: Client) -> None:
    grown = spec_of(omega=[1.5, 2.0, 2.4, 3.0, 4.0, 4.2], b=[0.1, 0.2, 0.3, 0.5])
    assert extend(old, tmp_path / "new.zarr", grown, client=client).cells_solved == 6 * 4 - 12
    atlas.run(grown, tmp_path / "scratch.zarr", client=client)
    assert arrays_of(tmp_path / "new.zarr") == arrays_of(tmp_path / "scratch.zarr")


def test_values_may_be_left_out(old: Path, tmp_path: Path, client: Client) -> None:
    grown = spec_of(omega=[2.4, 2.5, 4.0], b=[0.3, 0.5])
    assert extend(old, tmp_path / "new.zarr", grown, client=client).cells_solved == 2


def test_a_sweep_can_be_refined(tmp_path: Path, client: Client) -> None:
    sweep = atlas.Spec("two-mass", axes={"omega": [2.0, 3.0, 4.0]}, solve=SOLVE, store={"tile": [2]})
    atlas.run(sweep, tmp_path / "old.zarr", client=client)
    assert extend(tmp_path / "old.zarr", tmp_path / "new.zarr", refine=2, client=client).cells_solved == 2


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_a_spaced_axis_that_goes_on_takes_the_old_values_over(tmp_path: Path, scale: str) -> None:
    first = {"start": 0.1, "stop": 1.3, "num": 41, "scale": scale}
    step = 1.2 / 40 if scale == "linear" else 13.0 ** (1 / 40)
    stop = 1.3 + 20 * step if scale == "linear" else 1.3 * step**20
    old = Axis("b", tuple(atlas.Spec("two-mass", axes={"b": first}).axes[0].values), scale)
    new = atlas.Spec("two-mass", axes={"b": {"start": 0.1, "stop": stop, "num": 61, "scale": scale}}).axes[0]
    assert not set(old.values) <= set(new.values)  # the last bits differ
    taken = keep_values(old, new)
    assert set(old.values) <= set(taken.values)
    assert taken.values[41:] == new.values[41:]
    np.testing.assert_allclose(taken.values, new.values, rtol=1e-14)


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_refined_axes_hold_the_old_values_to_the_bit_and_even_steps_between(scale: str) -> None:
    spec = atlas.Spec("two-mass", axes={"b": {"start": 0.01, "stop": 0.7, "num": 23, "scale": scale}}, solve=SOLVE)
    old, new = spec.axes[0], refine_spec(spec, 4).axes[0]
    assert new.values[::4] == old.values
    assert (len(new), new.scale) == (89, scale)
    steps = np.diff(np.log(new.values) if scale == "log" else new.values)
    np.testing.assert_allclose(steps, steps.mean(), rtol=1e-10)


def test_chunks_that_were_exchanged_are_not_taken_over(old: Path, tmp_path: Path, client: Client) -> None:
    one, other = old / "largest" / "c" / "0" / "0", old / "largest" / "c" / "1" / "0"
    first, second = one.read_bytes(), other.read_bytes()
    one.write_bytes(second)
    other.write_bytes(first)
    failures = extend(old, tmp_path / "new.zarr", refine=2, client=client).failures
    assert failures
    assert all("its digest does not match" in failure.message for failure in failures)


def test_only_finished_tiles_are_taken_over(old: Path, tmp_path: Path, client: Client) -> None:
    (old / "regime" / "c" / "0" / "1").unlink()
    assert extend(old, tmp_path / "new.zarr", refine=2, client=client).cells_solved == 7 * 5 - 8


def test_failed_cells_which_would_come_out_the_same_are_taken_over(old: Path, tmp_path: Path, client: Client) -> None:
    zarr.open_group(old, mode="r+", use_consolidated=False)["regime"][0, 0] = FAILED
    record_again(old)
    grown = spec_of(omega=[2.0, 2.4, 3.0, 4.0], b=[0.1, 0.3, 0.5, 0.6])
    assert extend(old, tmp_path / "new.zarr", grown, client=client).cells_solved == 4
    assert atlas.open(tmp_path / "new.zarr").regime.values[0, 0] == FAILED


def test_cells_solved_again_with_a_larger_budget_are_fine_and_not_taken_over(
    old: Path, tmp_path: Path, client: Client
) -> None:
    again = atlas.retry(old, tmp_path / "again.zarr", "undetermined", 800, client=client).cells_solved
    assert again > 0
    assert verify(tmp_path / "again.zarr", sample=12).is_sound
    summary = extend(tmp_path / "again.zarr", tmp_path / "new.zarr", refine=2, client=client)
    assert summary.cells_solved == 7 * 5 - 12 + again
    atlas.run(open_store(tmp_path / "new.zarr").spec, tmp_path / "scratch.zarr", client=client)
    assert arrays_of(tmp_path / "new.zarr") == arrays_of(tmp_path / "scratch.zarr")


def test_an_interrupted_extension_goes_on(old: Path, tmp_path: Path, client: Client) -> None:
    def interrupt(progress: Any) -> None:
        if progress.tiles_done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        extend(old, tmp_path / "new.zarr", refine=2, client=client, options=atlas.RunOptions(on_progress=interrupt))
    assert len(done_tiles(open_store(tmp_path / "new.zarr"))) < 12
    assert extend(old, tmp_path / "new.zarr", refine=2, client=client).tiles_done == 12


def test_an_extension_can_be_extended(old: Path, tmp_path: Path, client: Client) -> None:
    extend(old, tmp_path / "new.zarr", refine=2, client=client)
    summary = extend(tmp_path / "new.zarr", tmp_path / "newer.zarr", refine={"b": 2}, client=client)
    assert summary.cells_solved == 7 * 4
    assert verify(tmp_path / "newer.zarr", sample=63).is_sound


def test_a_grown_store_lists_the_machines_of_its_origin(old: Path, tmp_path: Path, client: Client) -> None:
    another = host_from_facts({"processor": "Z80"})
    record_host(open_store(old), another)
    extend(old, tmp_path / "new.zarr", refine=2, client=client)
    assert {machine.name for machine in read_hosts(open_store(tmp_path / "new.zarr"))} > {
        host_from_facts({"processor": "Z80"}).name
    }


def test_the_old_store_stays_as_it_is(old: Path, tmp_path: Path, client: Client) -> None:
    before = {path: path.read_bytes() for path in old.rglob("*") if path.is_file()}
    extend(old, tmp_path / "new.zarr", refine=2, client=client)
    assert {path: path.read_bytes() for path in old.rglob("*") if path.is_file()} == before


def lose(old: Path) -> None:
    shutil.rmtree(old)


def swap(old: Path) -> None:
    shutil.rmtree(old)
    create_store(old, spec_of(), (2, 2))


def damage(old: Path) -> None:
    chunk = old.joinpath("state", "c", "0", "0", "0")
    assert chunk.is_file()
    chunk.write_bytes(b"")


@pytest.mark.parametrize(
    ("harm", "message", "tiles"),
    [
        (lose, "old.zarr: no such store; .* copies cells from it: restore it", 12),
        (swap, "another store than the one that was extended", 12),
        (damage, r"state/c/0/0/0 is damaged .*: atlas verify --repair", 4),
    ],
)
def test_cells_that_cannot_be_taken_over_are_reported_and_nothing_wrong_is_stored(
    old: Path, tmp_path: Path, client: Client, harm: Callable[[Path], None], message: str, tiles: int
) -> None:
    seen = False

    def once(progress: Any) -> None:
        nonlocal seen
        if not seen and progress.stage == "solving":
            seen = True
            harm(old)

    summary = extend(old, tmp_path / "new.zarr", refine=2, client=client, options=atlas.RunOptions(on_progress=once))
    assert len(summary.failures) == tiles
    assert all(re.search(message, failure.message) for failure in summary.failures)
    assert not {failure.index for failure in summary.failures} & done_tiles(open_store(tmp_path / "new.zarr"))
    assert len(done_tiles(open_store(tmp_path / "new.zarr"))) == 12 - tiles


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"parameters": {"R": 0.5}}, "cannot be extended by this spec: R = 0.8 in the store, 0.5 in the spec"),
        ({"solve": SOLVE | {"tolerance": 0.2}}, "tolerance = 0.1 in the store, 0.2 in the spec"),
        ({"solve": SOLVE | {"exponents": "spectrum"}}, "exponents = 'largest' in the store, 'spectrum' in the spec"),
        ({"omega": [2.1, 2.2]}, "no finished cell lies on the new grid"),
    ],
)
def test_a_spec_that_does_not_go_with_the_store_is_refused(
    old: Path, tmp_path: Path, given: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        extend(old, tmp_path / "new.zarr", spec_of(**given))
    assert not (tmp_path / "new.zarr").exists()


def test_another_axis_is_refused(old: Path, tmp_path: Path) -> None:
    other = atlas.Spec("two-mass", axes={"omega": [2.0, 3.0], "R": [0.5, 0.8]}, solve=SOLVE)
    with pytest.raises(InputError, match=r"axes differ: \(omega, b\) in the store, \(omega, R\) in the spec"):
        extend(old, tmp_path / "new.zarr", other)


def test_another_solver_version_is_refused(old: Path, tmp_path: Path) -> None:
    set_attribute(old, "solver_version", 3)
    with pytest.raises(InputError, match=r"computed by solver version 3, .* cannot mix solver versions"):
        extend(old, tmp_path / "new.zarr", refine=2)
    assert not (tmp_path / "new.zarr").exists()


@pytest.mark.parametrize(
    ("refine", "message"),
    [
        (1, "no axis would become finer"),
        (0, "refine omega: found 0, must be a whole number, 1 or more"),
        ({"omga": 2}, "omga.*omega"),
        (None, "give either spec or refine"),
    ],
)
def test_factors_that_make_no_sense_are_refused(old: Path, tmp_path: Path, refine: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        extend(old, tmp_path / "new.zarr", refine=refine)


def test_an_axis_with_one_value_is_refined_by_no_factor() -> None:
    spec = spec_of(omega=[2.0])
    assert refine_spec(spec, 2).shape == (5, 1)
    with pytest.raises(InputError, match="refine omega: an axis with one value has nothing in between"):
        refine_spec(spec, {"omega": 2})


def test_a_store_does_not_grow_in_place_or_into_one_of_another_origin(
    old: Path, tmp_path: Path, client: Client
) -> None:
    with pytest.raises(InputError, match="found the store to take cells from"):
        extend(old, old, refine=2)
    grown = refine_spec(spec_of(), 2)
    atlas.run(grown, tmp_path / "new.zarr", client=client)
    with pytest.raises(InputError, match="a store that was not made from"):
        extend(old, tmp_path / "new.zarr", refine=2)


def test_the_command_refines_and_extends(old: Path, tmp_path: Path, client: Client) -> None:
    def call(*args: object) -> Any:
        return CliRunner().invoke(main, ["extend", *map(str, args), "--scheduler", client.scheduler.address])

    shown = call(old, "--refine", "omega=2", "-o", tmp_path / "a.zarr")
    assert shown.exit_code == 0, shown.output
    assert "reusing 12 of 21 cells" in shown.stderr
    assert "9 cells in " in shown.stdout
    (tmp_path / "spec.toml").write_text(
        'system = "two-mass"\n[axes.omega]\nvalues = [2.0, 2.4]\n[axes.b]\nvalues = [0.1, 0.6]\n'
        "[solve]\nmax_periods = 300\ntolerance = 0.1\nsection_samples = 2\n"
    )
    assert call(old, tmp_path / "spec.toml", "-o", tmp_path / "b.zarr").exit_code == 0
    for args in ([old], [old, tmp_path / "spec.toml", "--refine", 2], [old, "--refine", "two"]):
        assert call(*args, "-o", tmp_path / "c.zarr").exit_code == 2
    assert not (tmp_path / "c.zarr").exists()


def test_the_origin_is_read_once_for_all_tiles_that_copy_from_it(
    old: Path, tmp_path: Path, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Truth: six tiles read its metadata and its axes six times."""
    read: list[str] = []
    whole = LocalBackend.get

    def get(place: LocalBackend, key: str, part: slice | None = None) -> bytes | None:
        if place.local == old:
            read.append(key)
        return whole(place, key, part)

    monkeypatch.setattr(LocalBackend, "get", get)
    summary = extend(old, tmp_path / "new.zarr", spec_of(b=(0.1, 0.2, 0.3, 0.5)), client=client)
    assert summary.tiles_done == 4
    assert max(Counter(read).values()) <= READS


def test_no_attribute_has_an_absolute_path_and_stores_that_are_moved_together_find_each_other(
    old: Path, tmp_path: Path, client: Client
) -> None:
    before, after = tmp_path / "before", tmp_path / "after"
    shutil.copytree(old, before / "old.zarr")
    extend(before / "old.zarr", before / "new.zarr", spec_of(b=(0.1, 0.2, 0.3, 0.5)), client=client)
    assert str(before) not in (before / "new.zarr" / "zarr.json").read_text()
    before.rename(after)
    assert reuse_cells(open_store(after / "new.zarr"), (slice(0, 2), slice(0, 2))).source is None
    (after / "old.zarr").rename(after / "away.zarr")
    with pytest.raises(RunError, match=r"after.old.zarr: no such store"):
        reuse_cells(open_store(after / "new.zarr"), (slice(0, 2), slice(0, 2)))


def test_a_store_finds_its_origin_through_links(old: Path, tmp_path: Path, client: Client) -> None:
    (tmp_path / "far" / "deep").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "far" / "deep")
    extend(tmp_path / "far" / ".." / "old.zarr", tmp_path / "link" / "new.zarr", refine=2, client=client)
    (tmp_path / "again.zarr").symlink_to(tmp_path / "link" / "new.zarr")
    for path in (tmp_path / "again.zarr", tmp_path / "link" / "new.zarr", tmp_path / "far" / "deep" / "new.zarr"):
        reuse_cells(open_store(path), (slice(0, 2), slice(0, 2)))  # or raises RunError


def test_an_origin_that_another_store_has_replaced_is_noticed(old: Path, tmp_path: Path) -> None:
    spec = spec_of(b=(0.1, 0.2, 0.3, 0.5))
    handle = create_store(tmp_path / "new.zarr", spec, (2, 2), Origin(str(old), open_store(old).run_id))
    reuse_cells(handle, (slice(0, 2), slice(0, 2)))
    shutil.rmtree(old)
    create_store(old, spec_of(), (2, 2))
    with pytest.raises(RunError, match="another store than the one that was extended"):
        reuse_cells(handle, (slice(0, 2), slice(0, 2)))
