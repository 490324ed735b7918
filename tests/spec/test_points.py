"""Claims about tables of points: parameter sets, one row a cell, and their results beside them."""

import csv
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import zarr
from click.testing import CliRunner
from distributed import Client

import atlas
import workers
from atlas.check.rules import law_of
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.service.plan import make_plan
from atlas.spec.points import parse_points
from atlas.store import create
from atlas.store.store import done_tiles, open_store
from workers import Settings
from workers.model.system import find_system

SOLVE = {"max_periods": 500, "tolerance": 0.1, "exponents": "spectrum"}
TABLE = {
    "omega": [2.5, 3.0, 3.5, 2.5, 4.0],
    "b": [0.1, 0.2, 0.15, 0.1, 0.05],
    "R": [0.8, 0.6, 0.8, 0.8, 0.5],
}
TEXT = "omega,b,R\n2.5,0.1,0.8\n3.0,0.2,0.6\n3.5,0.15,0.8\n2.5,0.1,0.8\n4,0.05,0.5\n"


def table_of(tile: int = 2, **parameters: float) -> atlas.Spec:
    return atlas.Spec("two-mass", points=TABLE, parameters=parameters, solve=SOLVE, store={"tile": [tile]})


@pytest.fixture(scope="module")
def solved(solved_once: Callable[[atlas.Spec], Path]) -> Path:
    """The store of the table after a run, only to be read."""
    return solved_once(table_of())


def answered(*arguments: object, code: int = 0) -> str:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == code, result.output
    return result.output


def refused(path: Path, text: str) -> str:
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        parse_points({"file": path}, find_system("two-mass"))
    return str(caught.value).removeprefix(str(path))


def test_a_row_comes_out_to_the_bit_as_its_parameters_do_on_their_own(solved: Path) -> None:
    expected = workers.solve_tile("two-mass", TABLE, Settings(**SOLVE))
    ds = atlas.open(solved)
    for name, values in expected.items():
        np.testing.assert_array_equal(ds[name].values, values, err_msg=name, strict=True)


def test_plain_xarray_has_the_parameters_as_coordinates_along_the_points(solved: Path) -> None:
    ds = xr.open_zarr(solved)
    assert ds.regime.dims == ("point",)
    assert ds.point.values.tolist() == [0, 1, 2, 3, 4]
    for name, values in TABLE.items():
        assert ds.coords[name].dims == ("point",)
        assert ds[name].values.tolist() == values
    assert float(ds.coords["zeta"]) == 0.05


def test_a_column_wins_over_a_parameter() -> None:
    assert table_of(R=0.3) == table_of()


def test_the_store_keeps_the_table(solved: Path) -> None:
    assert open_store(solved).spec == atlas.Spec("two-mass", points=TABLE, solve=SOLVE)


def test_the_digest_has_the_rows_and_not_the_order_of_the_columns() -> None:
    turned = atlas.Spec("two-mass", points=dict(reversed(TABLE.items())), solve=SOLVE)
    other = atlas.Spec("two-mass", points=TABLE | {"R": [0.8, 0.6, 0.8, 0.8, 0.6]}, solve=SOLVE)
    assert turned.digest == table_of().digest != other.digest


def test_a_file_gives_the_same_spec_as_its_columns(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("\ufeffomega, b ,R\r\n" + TEXT.partition("\n")[2], encoding="utf-8")
    (tmp_path / "s.toml").write_text('system = "two-mass"\n[points]\nfile = "t.csv"\n')
    assert atlas.Spec.from_toml(tmp_path / "s.toml") == atlas.Spec("two-mass", points=TABLE)


def test_points_take_the_place_of_the_axes_that_they_have_as_columns(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(TEXT)
    assert atlas.Spec.from_toml("tiny", tmp_path / "t.csv").shape == (5,)


def test_an_axis_that_is_no_column_is_refused(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("omega,R\n2,0.5\n")
    with pytest.raises(InputError, match=r"b is an axis but not a column of .*t.csv; add the column"):
        atlas.Spec.from_toml("tiny", tmp_path / "t.csv")


def test_axes_and_points_together_are_refused() -> None:
    with pytest.raises(InputError, match=r"found axes \(b\) and points; give one of the two"):
        atlas.Spec("two-mass", axes={"b": [0.1]}, points=TABLE)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ": is empty; its first row must name parameters"),
        ("omega,b\n", ": found 0 rows below the names, must be 1 or more"),
        ("omgea,b\n2,0.1\n", ": unknown parameter 'omgea'; did you mean 'omega'?"),
        ("omega,b,omega\n2,0.1,3\n", ": column omega occurs twice"),
        ("omega,b\n2,0.1\n3,wide\n", ", row 3, column b: found 'wide', must be a number"),
        ("omega,b\n2,0.1\n3,\n", ", row 3, column b: found '', must be a number"),
        ("omega,b\n2,nan\n", ", row 2, column b = nan: must be a finite number"),
        ("omega,b\n2,0.1,5\n", ", row 2: found 3 fields, must be 2 as in the first row"),
        ("omega,b\n2,0.1\n\n3,0.1\n", ", row 3: is empty; remove it"),
        ("omega,R\n2,1.5\n", ", row 2, column R: R = 1.5: must satisfy 0 <= R <= 1"),
        ('omega,b\n2,"0.1\n', ": is not CSV: unexpected end of data"),
    ],
)
def test_a_bad_table_is_answered_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    assert refused(tmp_path / "t.csv", text) == words


def test_a_table_has_as_many_rows_as_it_wants(tmp_path: Path) -> None:
    from atlas.store.create import create_store

    rows = np.random.default_rng(0).uniform(1.0, 4.0, 250_000)
    (tmp_path / "t.csv").write_text("omega\n" + "\n".join(map(repr, rows.tolist())))
    handle = create_store(tmp_path / "out.zarr", atlas.Spec("two-mass", points={"file": tmp_path / "t.csv"}), (512,))
    assert np.array(handle.spec.points["omega"]).tobytes() == rows.tobytes()


def test_a_missing_table_exits_with_2_and_writes_nothing(tmp_path: Path) -> None:
    text = answered("run", "--points", tmp_path / "no.csv", "tiny", "-o", tmp_path / "out.zarr", code=2)
    assert "no.csv: cannot be read: No such file or directory" in text
    assert list(tmp_path.iterdir()) == []


def test_columns_of_unequal_length_are_refused() -> None:
    with pytest.raises(InputError, match="found 2 values of omega and 1 of b"):
        atlas.Spec("two-mass", points={"omega": [2, 3], "b": [0.1]})


def test_a_plan_says_how_many_rows_of_what() -> None:
    assert "axes   5 rows of omega, b, R\ncells  5 (5; point) in 3 tiles of 2" in str(make_plan(table_of(), 1))


def test_status_names_the_columns(solved: Path) -> None:
    assert "5 rows of omega, b, R" in answered("status", solved)
    assert json.loads(answered("status", "--json", solved))["columns"] == ["omega", "b", "R"]


def test_a_table_verifies_with_every_cell_solved_again(solved: Path) -> None:
    assert "5 cells solved again" in answered("verify", solved)


def test_a_coordinate_that_is_not_the_table_is_found(solved: Path, tmp_path: Path) -> None:
    shutil.copytree(solved, tmp_path / "out.zarr")
    (tmp_path / "out.zarr" / "R" / "c" / "0").unlink()
    assert "R/c/0 is missing: atlas verify --repair" in answered("verify", tmp_path / "out.zarr", code=1)


def test_the_sum_law_of_a_table_is_that_of_each_row() -> None:
    spec = atlas.Spec("two-mass", points=TABLE | {"zeta": [0.05, 0.01, 0.02, 0.05, 0.0]})
    free, parts = (np.broadcast_to(part, spec.shape) for part in law_of(spec, (slice(0, 5),)))
    for row in range(5):
        one = atlas.Spec("two-mass", axes={"omega": [spec.points["omega"][row]]}, parameters={
            name: values[row] for name, values in spec.points.items() if name != "omega"
        })  # fmt: skip
        np.testing.assert_array_equal([free[row], parts[row]], np.ravel(law_of(one, (slice(0, 1),))))


def test_a_point_is_asked_for_by_its_row(solved: Path) -> None:
    cell = atlas.open(solved).atlas.at(point=4)
    assert (cell["omega"], cell["b"], cell["R"]) == (4.0, 0.05, 0.5)
    text = answered("query", solved, "--at", "omega=3", code=2)
    assert "omega is not an axis here but a column of points; give point, the row's number from 0 on" in text


def test_csv_has_parameters_and_results_side_by_side(solved: Path, tmp_path: Path) -> None:
    answered("export", solved, "-o", tmp_path / "out.csv")
    with (tmp_path / "out.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[:4] == ["point", "omega", "b", "R"]
    assert [float(row["R"]) for row in rows] == TABLE["R"]
    assert [float(row["largest"]) for row in rows] == atlas.open(solved).largest.values.tolist()


def test_shares_of_a_table_count_its_rows(solved: Path) -> None:
    codes, counts = np.unique(atlas.open(solved).regime.values, return_counts=True)
    assert list(atlas.open(solved).atlas.fractions().to_dict().values()) == pytest.approx((counts / 5).tolist())
    assert len(codes) == len(counts)


def test_extremes_say_the_parameters_of_the_row(solved: Path) -> None:
    ds = atlas.open(solved)
    low = ds.atlas.extremes("largest", "all").iloc[0]
    assert low["R"] == TABLE["R"][int(ds.largest.values.argmin())]


def test_windows_of_a_table_are_refused(solved: Path) -> None:
    assert "whose rows are not neighbours" in answered("find", "regions", solved, "regime", code=2)


def test_exponents_per_unit_time_take_the_frequency_of_each_row(solved: Path) -> None:
    ds = atlas.open(solved)
    expected = ds.largest.values * np.array(TABLE["omega"]) / (2 * np.pi)
    np.testing.assert_allclose(ds.atlas.per_unit_time().largest.values, expected, rtol=1e-15)


def test_tables_of_other_parameters_are_not_compared(solved: Path, tmp_path: Path, client: Client) -> None:
    one = atlas.open(solved)
    with pytest.raises(InputError, match=r"column R differs: value 2 is 0.6 here, 0.7 there"):
        one.atlas.compare(one.assign_coords(R=("point", [0.8, 0.7, 0.8, 0.8, 0.5])))
    assert one.atlas.compare(one).numbers.same == 1.0


def test_a_table_is_not_extended(solved: Path, tmp_path: Path) -> None:
    text = answered("extend", solved, "--refine", "2", "-o", tmp_path / "more.zarr", code=2)
    assert "a table of points cannot be extended" in text


def test_a_table_stopped_half_way_is_completed_to_the_same_bits(solved: Path, tmp_path: Path, client: Client) -> None:
    shutil.copytree(solved, tmp_path / "out.zarr")
    os.unlink(tmp_path / "out.zarr" / "regime" / "c" / "1")
    summary = atlas.run(table_of(), tmp_path / "out.zarr", client=client)
    assert (summary.tiles_solved, len(done_tiles(open_store(tmp_path / "out.zarr")))) == (1, 3)
    for name, values in atlas.open(solved).data_vars.items():
        np.testing.assert_array_equal(atlas.open(tmp_path / "out.zarr")[name].values, values.values, err_msg=name)


def test_another_table_does_not_resume_a_store(solved: Path) -> None:
    other = atlas.Spec("two-mass", points=TABLE | {"R": [0.8, 0.6, 0.7, 0.8, 0.5]}, solve=SOLVE)
    with pytest.raises(InputError, match=r"point 2: R = 0.8 in the store, 0.7 in the spec"):
        atlas.run(other, solved)


def test_a_table_is_drawn_as_a_sweep_over_its_rows(solved: Path, tmp_path: Path) -> None:
    answered("plot", solved, "-o", tmp_path / "out.png")
    assert (tmp_path / "out.png").stat().st_size > 1000


def test_a_table_has_no_overviews(tmp_path: Path) -> None:
    spec = atlas.Spec("two-mass", points={"omega": np.linspace(1, 4, 500)})
    from atlas.overview.pyramid import Pyramid
    from atlas.store.create import create_store

    assert Pyramid(create_store(tmp_path / "out.zarr", spec, (64,))).levels.count == 0


def test_a_table_that_never_ends_or_does_not_fit_in_memory_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(InputError, match=f"{path}: cannot be read: not a regular file"):
            atlas.Spec("two-mass", points={"file": path})
    with (tmp_path / "large.csv").open("wb") as file:
        file.truncate(10**9 + 1)
    with pytest.raises(InputError, match=r"large.csv: found 1000000001 bytes, must be at most 1000000000"):
        atlas.Spec("two-mass", points={"file": tmp_path / "large.csv"})


COLUMNS = ("omega", "b", "R", "zeta", "mu_m", "mu_k", "f2", "tau", "x1", "v1")


@pytest.mark.parametrize("edited", [("b", "tau"), COLUMNS])
def test_changed_columns_are_found_and_a_repair_restores_them(tmp_path: Path, edited: tuple[str, ...]) -> None:
    spec = atlas.Spec("two-mass", points={name: [0.1, 0.2, 0.3] for name in COLUMNS})
    path = create.create_store(tmp_path / "out.zarr", spec, (2,)).path
    for name in edited:
        zarr.open_group(path, mode="r+", use_consolidated=False)[name][1] = 0.25
    found = [str(fault) for fault in atlas.verify(path, sample=0, repair=True).faults]
    assert sorted(line.partition(" ")[0] for line in found) == sorted(f"{name}/c/0" for name in edited)
    assert atlas.open(path)["b"].values.tolist() == [0.1, 0.2, 0.3]
