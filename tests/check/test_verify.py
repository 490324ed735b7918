import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from click.testing import CliRunner
from distributed import Client

import atlas
from atlas.check import reproduce as recheck
from atlas.check.find_faults import draw_cells
from atlas.check.report import StoreFault, VerifyReport
from atlas.check.rules import broken_rules, law_of
from atlas.check.verify import verify
from atlas.cli.main import main
from atlas.errors import ChunkError, InputError
from atlas.service.progress import Progress
from atlas.store import store
from atlas.store.host import current_host, host_from_facts
from atlas.store.host_records import read_hosts, record_host
from atlas.store.record_format import RECORDS, TILES, WIDTH
from atlas.store.tiles import drop_tile, read_tile, record_of
from tests.corruption import flip
from tests.synthetic import put_record, set_attribute
from workers import solve_tile
from workers.cell.exponents import sum_of_exponents
from workers.model.system import find_system
from workers.results import (
    APERIODIC,
    CHAOTIC,
    FAILED,
    GAVE_UP,
    INVALID,
    NO_IMPACT,
    NO_REASON,
    NOT_RELAXED,
    NOT_STATIONARY,
    PERIODIC,
    result_variables,
)

SPEC = atlas.Spec(
    "two-mass",
    axes={"omega": [2.1, 2.4, 3.0, 4.0], "b": [0.1, 0.3, 0.5]},
    solve={"max_periods": 1000, "tolerance": 0.1, "exponents": "spectrum", "section_samples": 2},
    store={"tile": [2, 2]},
)
VARIABLES = [variable.name for variable in result_variables(SPEC.settings) if not variable.sparse]


@pytest.fixture(scope="module")
def solved(solved_once: Callable[[atlas.Spec], Path]) -> Path:
    return solved_once(SPEC)


@pytest.fixture
def whole(solved: Path, tmp_path: Path) -> Path:
    """A store of four tiles of its own for each test."""
    return Path(shutil.copytree(solved, tmp_path / "out.zarr"))


@pytest.fixture(scope="module")
def cells(solved: Path) -> dict[str, np.ndarray]:
    """The results of all cells, only to be read."""
    group = zarr.open_group(solved, mode="r")
    return {variable.name: group[variable.name][...] for variable in store.open_store(solved).variables}


def chunk(path: Path, name: str, tile: str = "0/1") -> Path:
    extra = {v.name: len(v.extra_dims) for v in result_variables(SPEC.settings)}.get(name, 0)
    return path.joinpath(name, "c", tile, *["0"] * extra)


def change(path: Path, name: str, where: Callable[[np.ndarray], np.ndarray], value: Any) -> tuple[int, ...]:
    """Another value, with a right checksum and record, in the first cell that ``where`` picks by its regime."""
    group = zarr.open_group(path, mode="r+", use_consolidated=False)
    cell = tuple(int(i[0]) for i in np.nonzero(where(group["regime"][...])))
    values = group[name][...]
    values[cell] = value(values[cell]) if callable(value) else value
    group[name].with_config({"write_empty_chunks": True})[...] = values
    tile = (cell[0] // 2, cell[1] // 2)
    handle = store.open_store(path)
    put_record(handle, tile, record_of(handle, tile, read_tile(handle, tile)))
    return cell


def message(report: VerifyReport) -> list[str]:
    return [str(fault) for fault in report.faults]


def arrays_of(path: Path) -> dict[str, bytes]:
    ds = atlas.open(path)
    return {str(name): ds[name].values.tobytes() for name in ds.variables}


def test_a_store_as_it_was_made_is_fine_and_every_chunk_of_it_was_read(whole: Path) -> None:
    report = verify(whole, sample=12)
    assert message(report) == []
    assert report.is_sound
    assert (report.tiles_done, report.chunks) == (4, 4 * len(VARIABLES))
    assert (report.cells_checked, report.cells_solved, report.comparison) == (12, 12, "bits")


@pytest.mark.parametrize("byte", [0, -1])
def test_a_corrupted_byte_is_found_in_every_kind_of_chunk(whole: Path, byte: int) -> None:
    for name in VARIABLES:
        flip(chunk(whole, name), byte)
    found = message(verify(whole, sample=0))
    for fault, name in zip(found, VARIABLES, strict=True):
        assert fault.startswith(f"tile (0, 1): {chunk(whole, name).relative_to(whole)} is damaged (")


@pytest.mark.parametrize("size", [0, 1, 3, 10])
def test_a_torn_chunk_is_found(whole: Path, size: int) -> None:
    os.truncate(chunk(whole, "state"), size)
    (fault,) = message(verify(whole, sample=0))
    assert "tile (0, 1): state/c/0/1/0 is damaged" in fault


def test_a_missing_chunk_of_every_kind_is_found(whole: Path) -> None:
    names = [name for name in VARIABLES if name != "regime"]
    for name in names:
        chunk(whole, name).unlink()
    missing = [f"tile (0, 1): {chunk(whole, name).relative_to(whole)} is missing" for name in names]
    assert message(verify(whole, sample=0)) == missing


def test_every_bad_chunk_is_reported_and_not_only_the_first(whole: Path) -> None:
    chunk(whole, "error").unlink()
    flip(chunk(whole, "period"), 5)
    flip(chunk(whole, "period", "1/0"), 5)
    assert len(message(verify(whole, sample=0))) == 3


def test_repair_and_run_give_the_same_bits_again(whole: Path, client: Client) -> None:
    before = arrays_of(whole)
    flip(chunk(whole, "state"), 7)
    chunk(whole, "largest", "1/1").unlink()
    report = verify(whole, sample=0, repair=True)
    assert report.repaired == ((0, 1), (1, 1))
    assert atlas.run(SPEC, whole, client=client).tiles_solved == 2
    assert arrays_of(whole) == before
    assert verify(whole, sample=12).is_sound


def test_without_repair_nothing_is_written(whole: Path) -> None:
    flip(chunk(whole, "state"), 7)
    before = {path: path.read_bytes() for path in whole.rglob("*") if path.is_file()}
    assert verify(whole).repaired is None
    assert {path: path.read_bytes() for path in whole.rglob("*") if path.is_file()} == before


def test_cells_are_checked_whatever_the_metadata_have_become(whole: Path, client: Client) -> None:
    before = arrays_of(whole)
    (whole / "largest" / "zarr.json").unlink()
    flip(chunk(whole, "state"), 7)
    report = verify(whole, sample=0, repair=True)
    assert [fault.tile for fault in report.faults] == [None, (0, 1)]
    assert (report.repaired, report.restored) == (((0, 1),), ("largest/zarr.json written again",))
    atlas.run(SPEC, whole, client=client)
    assert arrays_of(whole) == before
    assert verify(whole, sample=0).is_sound


def leave_pending(atlas: Path, tile: tuple[int, ...]) -> None:
    """Make a tile one that no run has finished: its chunk of regimes is gone, and so is its record."""
    drop_tile(store.open_store(atlas), tile)
    verify(atlas, sample=0, repair=True)


def test_a_repair_of_a_store_without_a_fault_changes_nothing(whole: Path) -> None:
    """No byte, no time of a file and no name: of a complete store, and of one with a tile to be solved."""

    def state() -> dict[Path, tuple[int, int, bytes]]:
        files = [path for path in whole.rglob("*") if path.is_file()]
        return {path: (path.stat().st_mtime_ns, path.stat().st_ino, path.read_bytes()) for path in files}

    for tile in ((), (0, 1)):
        if tile:
            leave_pending(whole, tile)
        before = state()
        report = verify(whole, sample=2, repair=True)
        assert (report.faults, report.repaired, report.restored) == ((), (), ())
        assert state() == before
        assert not whole.with_name(f".{whole.name}.run").exists()


@pytest.mark.parametrize("name", ["omega", "b", "R", "component"])
def test_a_corrupted_coordinate_is_found_and_restored(whole: Path, name: str) -> None:
    before = arrays_of(whole)
    (found,) = (path for path in (whole / name / "c", whole / name / "c" / "0") if path.is_file())
    flip(found, 6)
    (fault,) = message(verify(whole, sample=0, repair=True))
    assert fault.startswith(f"{found.relative_to(whole).as_posix()} is damaged or another chunk: ")
    assert verify(whole, sample=0).is_sound
    assert arrays_of(whole) == before


def test_a_coordinate_with_another_value_is_found(whole: Path) -> None:
    zarr.open_group(whole, mode="r+", use_consolidated=False)["omega"][1] = np.nextafter(2.4, 3)
    (fault,) = message(verify(whole, sample=0))
    assert fault.startswith("omega/c/0 is damaged or another chunk: ")


def test_a_changed_value_with_a_right_checksum_is_found_by_solving_again(whole: Path) -> None:
    cell = change(whole, "largest", lambda regime: regime == PERIODIC, lambda x: np.nextafter(x, 0))
    assert verify(whole, sample=0).is_sound
    (fault,) = message(verify(whole, sample=12))
    assert f"cell {recheck.place_in(SPEC, cell)}: largest " in fault
    assert verify(whole, sample=12, repair=True).repaired == ((cell[0] // 2, cell[1] // 2),)


@pytest.mark.parametrize(
    ("name", "regime", "value", "rule"),
    [
        ("regime", PERIODIC, 10, "regime is not one of 0 to 9"),
        ("regime", PERIODIC, -1, "regime is not one of 0 to 9"),
        ("regime", CHAOTIC, APERIODIC, "aperiodic although the spec has exponents"),
        ("largest", CHAOTIC, np.nan, "largest is NaN"),
        ("largest", CHAOTIC, 0.01, "chaotic, but largest is not positive by 4 errors"),
        ("error", PERIODIC, -1e-9, "error is negative"),
        ("period", PERIODIC, 0, "period is not positive in a periodic cell"),
        ("period", CHAOTIC, 3, "period is not 0 outside orbits"),
        ("period", NO_IMPACT, 2, "period is not 1 without impact"),
        ("impacts_upper", CHAOTIC, 1, "impacts_upper is not 0 outside orbits"),
        ("impacts_lower", PERIODIC, -1, "impacts_lower is negative"),
        ("impacts_per_period", NO_IMPACT, 1.0, "impacts_per_period is not 0 without impact"),
        ("impacts_per_period", PERIODIC, 7.5, "impacts_per_period is not the orbit's impacts over its period"),
        ("sticks", PERIODIC, True, "stuck_fraction contradicts sticks"),
        ("stuck_fraction", CHAOTIC, 1.5, "stuck_fraction is outside 0 to 1"),
        ("symmetric", CHAOTIC, True, "symmetric outside orbits"),
        ("min_impact_speed", NO_IMPACT, 0.1, "min_impact_speed without impact"),
        ("max_impact_speed", NO_IMPACT, 0.1, "max_impact_speed without impact"),
        ("mean_impact_speed", PERIODIC, 1e3, "mean_impact_speed is above max_impact_speed"),
        ("max_impact_speed", CHAOTIC, 1e-6, "mean_impact_speed is above max_impact_speed"),
        ("impact_energy", CHAOTIC, -1e-3, "impact_energy is negative"),
        ("impact_energy", NO_IMPACT, 1e-3, "impact_energy is not 0 without impact"),
        ("peak_to_peak", PERIODIC, -0.1, "peak_to_peak is negative"),
        ("kaplan_yorke", CHAOTIC, 4.5, "kaplan_yorke is outside 0 to 4"),
        ("periods_used", PERIODIC, -5, "periods_used is negative"),
        ("survived", CHAOTIC, -1, "survived is negative"),
        ("survived", CHAOTIC, 0, "survived is 0 in a chaotic or aperiodic cell"),
        ("survived", CHAOTIC, 10**8, "survived exceeds the simulated periods"),
        ("survived", PERIODIC, 5, "survived is not 0 outside chaos"),
        ("reason", PERIODIC, NOT_RELAXED, "reason is not one for this regime"),
        ("reason", NO_IMPACT, NOT_STATIONARY, "reason is not one for this regime"),
        ("state", PERIODIC, np.nan, "state is not finite"),
        ("regime", PERIODIC, INVALID, "state has a value in an invalid or failed cell"),
        ("spectrum", PERIODIC, lambda s: s[::-1], "spectrum is not descending"),
        ("spectrum", PERIODIC, lambda s: s + np.array([1, 0, 0, 0]), "largest is not the first of the spectrum"),
        ("spectrum", PERIODIC, lambda s: s - [0, 0, 0, 1e-6], "spectrum breaks the sum law"),
        ("spectrum", CHAOTIC, lambda s: s - [0, 0, 0, 1e-6], "spectrum breaks the sum law"),
        ("sum_law_defect", PERIODIC, 1e-6, "sum_law_defect is too large, or of no spectrum"),
    ],
)
def test_results_that_contradict_each_other_break_a_rule(
    cells: dict[str, np.ndarray], name: str, regime: int, value: Any, rule: str
) -> None:
    cell = tuple(np.argwhere(cells["regime"] == regime)[0].tolist())
    changed = cells | {name: cells[name].copy()}
    changed[name][cell] = value(changed[name][cell]) if callable(value) else value
    broken = broken_rules(SPEC, (slice(0, 3), slice(0, 4)), changed)
    assert np.argwhere(broken[rule]).tolist() == [[*cell]]


def test_a_cell_that_breaks_a_rule_is_a_fault_of_its_tile(whole: Path) -> None:
    cell = change(whole, "error", lambda regime: regime == PERIODIC, -1e-9)
    place = recheck.place_in(SPEC, cell)
    assert message(verify(whole, sample=0)) == [
        f"tile {(cell[0] // 2, cell[1] // 2)}: error is negative: 1 cell, the first at {place}"
    ]


def rules_broken_by_chaos(whole: Path, reason: int, errors: float) -> list[str]:
    """By a tile one of whose chaotic cells has this reason and an exponent of so many errors."""
    handle = store.open_store(whole)
    for tile in handle.tiling.tiles():
        arrays = read_tile(handle, tile.index)
        if (arrays["regime"] == CHAOTIC).any():
            cell = tuple(np.argwhere(arrays["regime"] == CHAOTIC)[0].tolist())
            arrays["reason"][cell], arrays["error"][cell] = reason, arrays["largest"][cell] / errors
            return list(broken_rules(SPEC, tile.slices, arrays))
    raise AssertionError("there is no chaotic cell")


@pytest.mark.parametrize(
    ("reason", "errors", "rules"),
    [
        (NO_REASON, 4.5, []),
        (NO_REASON, 3.0, ["chaotic, but largest is not positive by 4 errors"]),
        (NOT_RELAXED, 4.5, []),
        (NOT_RELAXED, 3.0, ["chaotic, but largest is not positive by 4 errors"]),
        (NOT_STATIONARY, 3.0, []),
    ],
)
def test_only_where_its_averages_differ_may_the_error_of_chaos_exceed_a_quarter_of_its_exponent(
    whole: Path, reason: int, errors: float, rules: list[str]
) -> None:
    assert rules_broken_by_chaos(whole, reason, errors) == rules


def test_with_the_fixed_method_chaos_has_survived_for_the_periods_averaged() -> None:
    settings = {"method": "fixed", "transient_periods": 300, "periods": 700, "exponents": "spectrum"}
    spec = atlas.Spec("two-mass", axes={"omega": [2.1, 2.4, 3.0, 4.0]}, parameters={"b": 0.1}, solve=settings)
    everything = (slice(0, 4),)
    arrays = solve_tile("two-mass", spec.cell_params(everything), spec.settings)
    chaotic = arrays["regime"] == CHAOTIC
    assert chaotic.any()
    assert broken_rules(spec, everything, arrays) == {}
    arrays["survived"][chaotic] = 699
    ((rule, cells),) = broken_rules(spec, everything, arrays).items()
    assert rule == "survived is not the periods averaged"
    np.testing.assert_array_equal(cells, chaotic)


@pytest.mark.parametrize(
    "axes",
    [
        {"omega": [1.0, 2.0, 3.0], "b": [0.1, 0.3]},
        {"R": [0.0, 0.5, 1.0], "zeta": [0.0, 0.2]},
        {"mu_k": [1.0, 4.0, 9.0], "mu_m": [0.5, 2.0]},
        {"b": [0.1, 0.2], "x1": [0.0, 0.05]},
        {"omega": [1.0, 2.0, 3.0]},
    ],
)
def test_the_law_of_a_tile_is_that_of_each_of_its_cells(axes: dict[str, list[float]]) -> None:
    spec = atlas.Spec("two-mass", axes=axes)
    slices = tuple(slice(0, n) for n in spec.shape)
    free, parts = (np.broadcast_to(part, spec.shape) for part in law_of(spec, slices))
    cells = {name: np.broadcast_to(values, spec.shape) for name, values in spec.cell_params(slices).items()}
    for cell in np.ndindex(spec.shape):
        oscillator = find_system("two-mass").build({name: float(values[cell]) for name, values in cells.items()})
        assert free[cell] == sum_of_exponents(oscillator, 0.0)
        if oscillator.R:
            assert free[cell] + 2.5 * parts[cell] == pytest.approx(sum_of_exponents(oscillator, 2.5), rel=1e-12)
        else:
            assert np.isnan(parts[cell])


def test_pending_tiles_are_no_damage_but_the_store_is_not_complete(whole: Path) -> None:
    leave_pending(whole, (0, 1))
    report = verify(whole, repair=True)
    assert (report.faults, report.tiles_done, report.is_sound, report.repaired) == ((), 3, False, ())


@pytest.fixture
def elsewhere(whole: Path) -> None:
    """The store was solved by a machine of another kind."""
    shutil.rmtree(whole / "hosts" / current_host().name)
    record_host(store.open_store(whole), host_from_facts({"processor": "Z80"}))


@pytest.mark.usefixtures("elsewhere")
def test_on_another_machine_solutions_may_differ_by_their_errors(whole: Path) -> None:
    change(whole, "largest", lambda regime: regime == PERIODIC, lambda x: x + 1e-12)
    report = verify(whole, sample=12)
    assert (report.comparison, report.is_sound, report.cells_solved) == ("error", True, 12)


@pytest.mark.usefixtures("elsewhere")
def test_on_another_machine_more_than_the_error_is_in_doubt_and_stays(whole: Path) -> None:
    change(whole, "largest", lambda regime: regime == PERIODIC, lambda x: x + 5e-7)
    report = verify(whole, sample=12, repair=True)
    assert not report.is_sound
    assert (len(report.doubts), report.faults, report.repaired) == (1, (), ())


def test_the_store_records_the_machines_that_solved_it(whole: Path) -> None:
    (machine,) = read_hosts(store.open_store(whole))
    assert {"processor", "instructions", "software"} <= set(machine.facts)
    assert f"numpy {np.__version__}" in machine.facts["software"]


def test_tiles_of_two_kinds_of_machine_are_compared_within_error(whole: Path) -> None:
    record_host(store.open_store(whole), host_from_facts({"processor": "Z80"}))
    assert verify(whole).comparison == "error"


def test_a_store_of_another_solver_is_read_but_not_solved_again(whole: Path) -> None:
    set_attribute(whole, "solver_version", 3)
    report = verify(whole)
    assert (report.is_sound, report.cells_solved) == (True, 0)
    assert dict(report.rows[:5])["sample"].startswith("not solved again: the store has solver version 3, this program")


def test_a_cell_that_was_marked_failed_by_hand_is_solved_again_and_found(whole: Path) -> None:
    values = {v.name: v.fill for v in result_variables(SPEC.settings)} | {"regime": FAILED, "reason": GAVE_UP}
    for name, value in values.items():
        change(whole, name, lambda regime: np.arange(regime.size).reshape(regime.shape) == 0, value)
    report = verify(whole, sample=12)
    assert report.cells_solved == 12
    assert [fault.tile for fault in report.faults if "solved again" in fault.what] == [(0, 0)]


def test_metadata_that_differ_from_their_consolidated_copy_are_found(whole: Path) -> None:
    zarr.open_group(whole, mode="r+", use_consolidated=False)["period"].attrs["units"] = "s"
    assert message(verify(whole)) == [
        f"period/zarr.json has attributes.units 's', must be '1': atlas verify --repair {whole} restores them"
    ]


def test_status_of_a_store_without_records_names_a_damaged_chunk(whole: Path) -> None:
    (whole / RECORDS / "c.0.0.0").unlink()
    flip(chunk(whole, "regime"), 3)
    result = CliRunner().invoke(main, ["status", str(whole)])
    assert result.exit_code == 1
    assert "regime/c/0/1 is damaged (" in result.stderr
    assert f"atlas verify --repair {whole}" in result.stderr


def test_a_digest_that_is_not_the_specs_is_found(whole: Path) -> None:
    set_attribute(whole, "digest", "0" * 64)
    assert "zarr.json: the digest does not match the spec" in message(verify(whole))


FOREIGN = ["7777", "05/0", "0/05", "²/0", "0/²", "0/+1", "0/1_0", "0/2", "2/0", "0/1/0", "x"]
"""Names that no chunk of a grid of 2 x 2 tiles has."""


def lay(path: Path, names: list[str]) -> None:
    for name in names:
        file = path / "regime" / "c" / name
        if not file.parent.is_file():
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(b"?")


def test_names_that_are_no_chunks_are_found_and_removed(whole: Path) -> None:
    names = [name for name in FOREIGN if name != "0/1/0"]  # a folder in place of a chunk
    lay(whole, names)
    (whole / "state" / "c" / "0" / "0" / "1").write_bytes(b"?")
    report = verify(whole, sample=0, repair=True)
    expected = {f"regime/c/{name}" for name in names} | {"state/c/0/0/1"}
    assert set(message(report)) == {f"{key} is not a chunk of this atlas" for key in expected}
    assert set(report.removed) == expected
    assert verify(whole, sample=0).is_sound


def test_names_that_are_no_chunks_are_no_tiles(whole: Path, client: Client) -> None:
    chunk(whole, "regime").unlink()
    lay(whole, FOREIGN)
    assert store.done_tiles(store.open_store(whole)) == {(0, 0), (1, 0), (1, 1)}
    assert json.loads(CliRunner().invoke(main, ["status", "--json", str(whole)]).stdout)["tiles_done"] == 3
    (whole / "regime" / "c" / "0" / "1" / "0").unlink()
    (whole / "regime" / "c" / "0" / "1").rmdir()
    assert atlas.run(SPEC, whole, client=client).tiles_done == 4


def records_of(path: Path) -> Any:
    return zarr.open_array(path / RECORDS, mode="r+")


def exchange(path: Path, one: str, other: str, names: list[str]) -> None:
    for name in names:
        if name == RECORDS:
            rows = records_of(path)
            rows[...] = rows[...][:, ::-1]
            continue
        files = [chunk(path, name, tile) for tile in (one, other)]
        contents = [file.read_bytes() for file in files]
        for file, content in zip(files, reversed(contents), strict=True):
            file.write_bytes(content)


@pytest.mark.parametrize("names", [VARIABLES, [*VARIABLES, RECORDS], ["largest"], [RECORDS]])
def test_tiles_or_chunks_exchanged_with_another_tiles_are_found(whole: Path, names: list[str]) -> None:
    exchange(whole, "0/0", "1/1", names)
    exchanged = [fault.tile for fault in verify(whole, sample=0).faults if "swapped with another" in fault.what]
    assert {(0, 0), (1, 1)} <= {*exchanged}
    assert RECORDS in names or exchanged == [(0, 0), (1, 1)]  # exchanged are the records of all four


def test_records_that_are_gone_are_found_and_a_repair_makes_them_anew(whole: Path) -> None:
    shutil.rmtree(whole / TILES)
    assert f"{RECORDS}/zarr.json is missing: atlas verify --repair {whole} restores them" in message(verify(whole))
    verify(whole, sample=0, repair=True)
    assert verify(whole, sample=0).is_sound


@pytest.mark.parametrize("byte", [0, -1])
def test_a_damaged_record_of_all_tiles_is_found_and_a_repair_makes_it_anew(whole: Path, byte: int) -> None:
    flip(whole / RECORDS / "c.0.0.0", byte)
    (fault,) = message(verify(whole, sample=0))
    assert fault.startswith("tiles/records/c.0.0.0 is damaged (")
    assert verify(whole, sample=0, repair=True).repaired == ()
    assert verify(whole, sample=0).is_sound


def test_a_missing_record_of_a_complete_store_is_found_and_a_repair_makes_it_anew(whole: Path) -> None:
    put_record(store.open_store(whole), (0, 1), np.zeros(WIDTH))
    assert message(verify(whole, sample=0)) == ["tiles/records: the records of 1 tile are missing"]
    assert verify(whole, sample=0, repair=True).repaired == ()
    assert verify(whole, sample=0).is_sound


def test_a_tile_that_the_records_say_is_done_and_is_not_is_found(whole: Path, client: Client) -> None:
    chunk(whole, "regime").unlink()
    assert message(verify(whole, sample=0)) == ["tile (0, 1): regime/c/0/1 is missing"]
    assert verify(whole, sample=0, repair=True).repaired == ((0, 1),)
    assert message(verify(whole, sample=0)) == []
    atlas.run(SPEC, whole, client=client)
    assert verify(whole, sample=0).is_sound


def test_a_place_that_cannot_be_read_is_no_damage(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(*_: object) -> None:
        raise OSError("the network is gone")

    handle = store.open_store(whole)
    handle.cache["arrays"] = dict.fromkeys(
        VARIABLES, type("Array", (), {"__getitem__": gone, "shards": None, "chunks": (), "shape": ()})()
    )
    with pytest.raises(OSError, match="the network is gone"):
        read_tile(handle, (0, 0))


def test_reading_a_tile_reports_what_is_wrong_with_it(whole: Path) -> None:
    chunk(whole, "error").unlink()
    with pytest.raises(ChunkError, match=r"error/c/0/1 is missing: atlas verify --repair"):
        read_tile(store.open_store(whole), (0, 1))


def test_the_sample_is_that_of_its_seed(whole: Path) -> None:
    handle = store.open_store(whole)
    done = sorted(store.done_tiles(handle))
    first, again, other = (draw_cells(handle.tiling, done, 4, seed) for seed in (1, 1, 2))
    assert sum(map(len, first.values())) == 4
    assert first == again != other
    assert verify(whole, sample=4).cells_solved == 4


def test_a_sample_of_all_cells_has_each_of_them_once(whole: Path) -> None:
    handle = store.open_store(whole)
    tiling = handle.tiling
    drawn = draw_cells(tiling, sorted(store.done_tiles(handle)), tiling.cells, 1)
    assert {index: sorted(cells) for index, cells in drawn.items()} == {
        tile.index: list(range(tile.size)) for tile in tiling.tiles()
    }


def test_progress_ends_with_every_cell_read(whole: Path) -> None:
    seen: list[Progress] = []
    verify(whole, sample=1, on_progress=seen.append)
    reading = [progress for progress in seen if progress.stage == "reading"]
    assert (reading[-1].tiles_done, reading[-1].cells_done, reading[-1].cells_solved) == (4, 12, 12)


def test_a_negative_sample_is_refused(whole: Path) -> None:
    with pytest.raises(InputError, match="sample: found -1, must be a whole number, 0 or more"):
        verify(whole, sample=-1)


def test_the_command_reports_by_its_exit_code(whole: Path, tmp_path: Path) -> None:
    def call(*args: object) -> tuple[int, str]:
        result = CliRunner().invoke(main, ["verify", *map(str, args)])
        return result.exit_code, result.stdout

    assert call(whole, "--sample", 2)[0] == 0
    flip(chunk(whole, "state"), 7)
    code, shown = call(whole, "--sample", 2, "--json")
    assert code == 1
    found = json.loads(shown)
    assert (found["sound"], found["faults"][0]["tile"]) == (False, [0, 1])
    code, shown = call(whole, "--repair")
    assert (code, "1 tile dropped: run it again to solve them" in shown) == (1, True)
    assert "nothing wrong, but not complete" in call(whole)[1]
    assert call(tmp_path / "none.zarr")[0] == 2


def test_the_report_shows_so_many_faults_and_counts_the_rest() -> None:
    faults = tuple(StoreFault((i,), "is damaged") for i in range(60))
    report = VerifyReport("x", 60, 60, 0, 0, 0, "none asked for", 0, faults=faults, doubts=())
    assert "and 10 more found: --json lists them" in str(report)
    assert len(replace(report).as_dict()["faults"]) == 60
