"""Why a cell is invalid, failed or given up: kept with the atlas, checked, and shown by all that shows cells."""

import csv
import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import zarr
from click.testing import CliRunner, Result

import atlas
from atlas.check.verify import verify
from atlas.cli.main import main
from atlas.query import queries as query
from atlas.store.store import open_store
from atlas.store.tiles import read_tile, record_of
from tests.oscillators import mass_spring
from tests.planes import plane_of
from tests.synthetic import put_record
from workers import solve_tile
from workers.cell import cell_batch
from workers.results import (
    BEYOND_STOP,
    CHAOTIC,
    FAILED,
    INVALID,
    LOCKING,
    LONG_PERIOD,
    NO_OSCILLATOR,
    NO_REASON,
    NOT_STATIONARY,
    OUT_OF_RANGE,
    REASONS,
    RESONANCE,
    RIGID_MODE,
    UNDETERMINED,
    UNSTABLE,
    WORK_SPENT,
    InvalidError,
)

BEYOND = "the initial state lies beyond a stop"
LINE = f"14 invalid cells: {BEYOND}"
"""With b from 0.1 to 0.5 and x1 = 0.25, the rows of b = 0.1 and 0.2, 7 cells each, start beyond a stop."""


@pytest.fixture(scope="module")
def solved(solved_once: Callable[[atlas.Spec], Path]) -> Path:
    return solved_once(plane_of(x1=0.25))


@pytest.fixture
def store(solved: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(solved, tmp_path / "out.zarr"))


def record(store: Path, cell: tuple[int, int]) -> None:
    """Write the record of a cell's tile anew."""
    handle = open_store(store)
    index = tuple(i // n for i, n in zip(cell, handle.tile, strict=True))
    put_record(handle, index, record_of(handle, index, read_tile(handle, index)))


def call(*args: object) -> Result:
    return CliRunner().invoke(main, [str(arg) for arg in args])


def test_codes_are_the_places_in_the_table_and_their_names_differ() -> None:
    assert [reason.code for reason in REASONS] == list(range(len(REASONS)))
    assert len({reason.name for reason in REASONS}) == len({reason.text for reason in REASONS}) == len(REASONS)
    assert {reason.regime for reason in REASONS[1:]} == {FAILED, INVALID, UNDETERMINED, CHAOTIC, LOCKING}


@pytest.mark.parametrize(
    ("params", "reason"),
    [
        ({}, NO_REASON),
        ({"x1": 0.2}, BEYOND_STOP),
        ({"R": 1.5}, OUT_OF_RANGE),
        ({"zeta": 0.0, "omega": 1e-7}, LONG_PERIOD),
        ({"zeta": 0.0, "mu_k": 1.5, "mu_m": 1.0, "omega": math.sqrt(0.5)}, RESONANCE),
    ],
)
def test_a_cell_says_by_its_code_why_it_is_invalid(params: dict[str, float], reason: int) -> None:
    found = solve_tile("two-mass", params)
    assert (found["reason"], found["reason"].dtype) == (reason, np.int8)
    assert (found["regime"] == INVALID) == (reason != NO_REASON)


def test_a_cell_given_up_for_its_cost_is_undetermined_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cell_batch, "MIN_WORK", 1)
    monkeypatch.setattr(cell_batch, "WORK_PER_PERIOD", 0)
    found = solve_tile("two-mass", {})
    assert (found["regime"], found["reason"]) == (UNDETERMINED, WORK_SPENT)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"stiffness": np.diag([1.0, 0.0])}, RIGID_MODE),
        ({"stiffness": np.zeros((2, 2))}, RIGID_MODE),
        ({"stiffness": np.diag([1.0, -1.0])}, UNSTABLE),
        ({"damping": np.diag([1.0, -0.1])}, UNSTABLE),
        ({"mass": np.diag([-1.0, 1.0])}, NO_OSCILLATOR),
    ],
)
def test_an_oscillator_that_cannot_be_built_says_why(changes: dict[str, np.ndarray], reason: int) -> None:
    system = {"mass": np.eye(2), "damping": np.zeros((2, 2)), "stiffness": np.diag([1.0, 2.0])} | changes
    forced = {"gap_row": np.array([1.0, 0.0]), "force": np.array([1.0, 0.0]), "omega": 3.0, "tau": 0.0}
    with pytest.raises(InvalidError) as caught:
        mass_spring(**system, **forced, b_upper=1.0, b_lower=1.0, R=0.8)
    assert caught.value.reason == reason


def test_the_store_keeps_the_reasons_with_their_meanings(store: Path) -> None:
    ds = xr.open_zarr(store)
    np.testing.assert_array_equal(ds.reason.values, np.where(ds.regime.values == INVALID, BEYOND_STOP, NO_REASON))
    meanings = dict(zip(ds.reason.attrs["flag_values"], ds.reason.attrs["flag_meanings"].split(), strict=True))
    assert meanings[BEYOND_STOP] == "beyond_stop"


def test_tiles_without_a_reason_have_no_chunk_of_them(store: Path) -> None:
    chunks = {path.relative_to(store / "reason" / "c").as_posix() for path in (store / "reason" / "c").rglob("?/?")}
    assert chunks == {"0/0", "0/1", "0/2"}  # b = 0.1 and 0.2


def test_status_reports_the_reasons(store: Path) -> None:
    assert f"  {LINE}" in call("status", store).stdout.splitlines()
    assert json.loads(call("status", store, "--json").stdout)["reasons"] == {BEYOND: 14}


def test_query_reports_the_reasons_of_a_window(store: Path) -> None:
    assert LINE in call("query", store).stdout.splitlines()
    shown = call("query", store, "--window", "omega=2:3", "--json")
    assert json.loads(shown.stdout)["reasons"] == {BEYOND: 8}


def test_query_of_an_atlas_without_such_cells_reports_only_fractions(store: Path) -> None:
    shares = json.loads(call("query", store, "--window", "b=0.3:0.5", "--json").stdout)
    assert sum(shares.values()) == pytest.approx(1.0)


def test_reasons_in_a_window_are_those_of_its_cells(store: Path) -> None:
    part = atlas.open(store).isel(omega=slice(1, 6), b=slice(1, 4))
    assert part.atlas.count_reasons().to_dict() == query.count_reasons(part.load().copy()) == {BEYOND: 5}


def test_query_counts_chaotic_cells_whose_averages_differ(store: Path) -> None:
    group, cell = zarr.open_group(store, mode="r+"), (4, 0)
    group["regime"][cell], group["reason"][cell] = CHAOTIC, NOT_STATIONARY
    shutil.rmtree(store / "tiles" / "records")
    text = REASONS[NOT_STATIONARY].text
    assert f"1 chaotic cell: {text}" in call("query", store).stdout.splitlines()
    assert f"  1 chaotic cell: {text}" in call("status", store).stdout.splitlines()
    assert query.nearest_cell(atlas.open(store), {"omega": 2.0, "b": 0.5})["reason"] == text


def test_a_cell_asked_for_reports_its_reason_in_words(store: Path) -> None:
    assert query.nearest_cell(atlas.open(store), {"omega": 3.0, "b": 0.1})["reason"] == BEYOND
    assert "reason" not in query.nearest_cell(atlas.open(store), {"omega": 3.0, "b": 0.5})


def test_an_export_names_the_reason_of_every_cell(store: Path, tmp_path: Path) -> None:
    ds = atlas.open(store)
    call("export", store, "-o", tmp_path / "a.csv")
    rows = list(csv.DictReader((tmp_path / "a.csv").read_text().splitlines()))
    assert {(row["regime"] == "invalid", row["reason"]) for row in rows} == {(True, "beyond_stop"), (False, "none")}
    call("export", store, "-o", tmp_path / "a.nc")
    with xr.open_dataset(tmp_path / "a.nc", engine="scipy") as written:
        np.testing.assert_array_equal(written.reason.values, ds.reason.values)


def test_a_cell_without_a_result_whose_reason_is_lost_is_a_fault(store: Path) -> None:
    (store / "reason" / "c" / "0" / "1").unlink()
    fault, digest, record = verify(store, sample=0).faults
    assert record.what.startswith("the record of tile")
    assert digest.what.startswith("its digest does not match")
    assert fault.what.startswith("reason is missing in an undetermined, invalid or failed cell: 6 cells")


@pytest.mark.parametrize(("cell", "code"), [((0, 0), WORK_SPENT), ((0, 0), 99), ((4, 0), BEYOND_STOP)])
def test_a_reason_of_another_regime_is_a_fault(store: Path, cell: tuple[int, int], code: int) -> None:
    zarr.open_group(store, mode="r+")["reason"][cell] = code
    fault, digest, record = verify(store, sample=0).faults
    assert record.what.startswith("the record of tile")
    assert digest.what.startswith("its digest does not match")
    assert fault.what.startswith("reason is not one for this regime: 1 cell,")
