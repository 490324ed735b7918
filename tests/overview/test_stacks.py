"""Claims about stacks: planes for several values of a third axis, in one store."""

import csv
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas
import pytest
import xarray as xr
from click.testing import CliRunner
from distributed import Client

import atlas
import workers
from atlas import render
from atlas.check.overviews import check_overviews
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.query.read_counter import count_chunk_reads
from atlas.query.resample import read_view
from atlas.service.plan import make_plan
from atlas.store import create, store
from tests import synthetic
from tests.synthetic import each_block, mean, mode

pytestmark = pytest.mark.slow

AXES = {"omega": np.linspace(2, 4, 6), "b": np.linspace(0.1, 0.5, 5), "R": [0.6, 0.7, 0.8]}


def stack_of(tile: tuple[int, int, int] = (1, 3, 4), **axes: object) -> atlas.Spec:
    solve = {"max_periods": 300, "tolerance": 0.1}
    return atlas.Spec("two-mass", axes=AXES | axes, solve=solve, store={"tile": tile})


@pytest.fixture(scope="module")
def solved(solved_once: Callable[[atlas.Spec], Path]) -> Path:
    """The store of the stack after a run, only to be read."""
    return solved_once(stack_of())


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> store.AtlasStore:
    """Three planes of made-up results with overviews, one tile not done."""
    path = tmp_path_factory.mktemp("large") / "out.zarr"
    axes = {"omega": np.linspace(1, 4, 45), "b": np.linspace(0.1, 0.5, 38), "R": [0.5, 0.6, 0.8]}
    handle = create.create_store(path, atlas.Spec("two-mass", axes=axes), (1, 8, 8))
    synthetic.fill(handle, skip=((1, 0, 0),))
    synthetic.keep(handle)
    return handle


def answered(*arguments: object, code: int = 0) -> str:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == code, result.output
    return result.output


def test_a_plane_of_a_stack_comes_out_to_the_bit_as_it_does_on_its_own(solved: Path) -> None:
    spec = stack_of()
    ds = xr.open_zarr(solved)
    for R in AXES["R"]:
        plane = atlas.Spec("two-mass", axes={n: AXES[n] for n in ("omega", "b")}, parameters={"R": R})
        cells = plane.cell_params((slice(0, 5), slice(0, 6)))
        for name, values in workers.solve_tile("two-mass", cells, spec.settings).items():
            np.testing.assert_array_equal(ds.sel(R=R)[name].values, values, err_msg=name, strict=True)


def test_the_third_axis_is_the_first_dimension_and_no_tile_has_two_planes(solved: Path) -> None:
    ds = xr.open_zarr(solved)
    assert ds.regime.dims == ("R", "b", "omega")
    assert ds.regime.encoding["chunks"] == (1, 3, 4)
    assert make_plan(atlas.Spec("two-mass", axes=AXES), 1).tiling.tile[0] == 1


def test_a_tile_of_two_planes_is_refused() -> None:
    with pytest.raises(InputError, match=r"found \[2, 3, 4\], must begin with 1: a tile lies in one plane"):
        stack_of(tile=[2, 3, 4])  # type: ignore[arg-type]


def test_four_axes_are_refused() -> None:
    with pytest.raises(InputError, match=r"found 4 \(omega, b, R, zeta\), must be one to three"):
        stack_of(zeta=[0.05])


def test_a_stack_is_not_continued() -> None:
    with pytest.raises(InputError, match="a stack cannot have a continued axis; compute its planes one by one"):
        stack_of(omega={"values": [2.0, 3.0], "continuation": "forward"})


def test_a_stack_verifies_and_says_how_far_it_is(solved: Path) -> None:
    assert "12 of 12 done" in answered("status", solved)
    assert answered("verify", solved).endswith("fine\n")


def test_a_stack_stopped_half_way_is_completed_to_the_same_bits(solved: Path, tmp_path: Path, client: Client) -> None:
    shutil.copytree(solved, tmp_path / "out.zarr")
    (tmp_path / "out.zarr" / "regime" / "c" / "1" / "0" / "1").unlink()
    assert atlas.run(stack_of(), tmp_path / "out.zarr", client=client).tiles_solved == 1
    for name, values in atlas.open(solved).data_vars.items():
        np.testing.assert_array_equal(atlas.open(tmp_path / "out.zarr")[name].values, values.values, err_msg=name)


def test_a_stack_grows_by_planes_and_keeps_those_it_has(solved: Path, tmp_path: Path, client: Client) -> None:
    grown = stack_of(R=[0.6, 0.7, 0.75, 0.8])
    summary = atlas.extend(solved, tmp_path / "more.zarr", grown, client=client)
    assert summary.cells_solved == 30
    kept = atlas.open(tmp_path / "more.zarr").sel(R=AXES["R"])
    np.testing.assert_array_equal(kept.largest.values, atlas.open(solved).largest.values)


def test_a_cell_of_a_stack_is_asked_for_by_three_values(solved: Path) -> None:
    found = atlas.open(solved).atlas.at(omega=2.4, b=0.2, R=0.7)
    assert (found["omega"], found["b"], found["R"]) == (2.4, 0.2, 0.7)


def test_shares_of_a_stack_are_those_of_all_its_cells(solved: Path) -> None:
    ds = atlas.open(solved)
    assert ds.atlas.fractions().to_dict() == pytest.approx(ds.load().atlas.fractions().to_dict(), rel=1e-12)


def test_csv_of_a_stack_has_a_row_for_every_cell_x_fastest(solved: Path, tmp_path: Path) -> None:
    answered("export", solved, "-o", tmp_path / "out.csv")
    with (tmp_path / "out.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[:3] == ["omega", "b", "R"]
    cells = [(R, b, omega) for R in AXES["R"] for b in AXES["b"] for omega in AXES["omega"]]
    assert [(float(row["R"]), float(row["b"]), float(row["omega"])) for row in rows] == cells
    found = [float(row["largest"]) for row in rows]
    np.testing.assert_array_equal(found, atlas.open(solved).largest.values.ravel())


def test_a_plane_is_selected_on_the_command_line(solved: Path, tmp_path: Path) -> None:
    answered("export", solved, "--select", "R=0.7", "-o", tmp_path / "out.csv")
    assert len((tmp_path / "out.csv").read_text().splitlines()) == 31
    assert "R = 0.72 lies outside" not in answered("query", solved, "--select", "R=0.72")
    assert "R = 1.2 lies outside the grid; valid: 0.55 to 0.85" in answered(
        "query", solved, "--select", "R=1.2", code=2
    )


def test_two_stacks_are_compared_cell_by_cell(solved: Path) -> None:
    ds = atlas.open(solved)
    compared = ds.atlas.compare(ds)
    assert (compared.numbers.same, compared.numbers.compared) == (1.0, int(np.isfinite(ds.largest).sum()))


def test_a_plane_of_a_large_stack_is_read_from_its_overviews(large: store.AtlasStore) -> None:
    ds, cells = atlas.open(large.path), atlas.open(large.path)  # what is loaded is not read from overviews
    codes, largest = cells.regime.values, cells.largest.values
    for k in (0, 2):
        for level in (1, 2, 3):
            ny, nx = (-(-n // 2**level) for n in codes.shape[1:])
            with count_chunk_reads() as reads:
                seen = read_view(ds.isel(R=k), ["largest"], pixels=(nx, ny), marks=False)
            assert (reads.level, seen.regime.dims) == (level, ("b", "omega"))
            np.testing.assert_allclose(seen.largest.values, each_block(largest[k], level, mean), rtol=1e-12)
            np.testing.assert_array_equal(seen.regime.values, each_block(codes[k], level, mode))


def test_a_level_of_a_stack_never_mixes_planes(large: store.AtlasStore) -> None:
    coarse = xr.open_zarr(large.path, group="overviews/1", chunks=None)
    assert coarse.R.values.tolist() == [0.5, 0.6, 0.8]
    assert coarse.regime.shape == (3, 19, 23)
    assert coarse.cells.isel(R=0).values.sum() == 45 * 38


def test_a_whole_stack_seen_coarser_keeps_its_planes(large: store.AtlasStore) -> None:
    ds = atlas.open(large.path)
    seen = read_view(ds, ["largest"], pixels=(12, 10), marks=False)
    assert (seen.R.values.tolist(), seen.regime.shape) == ([0.5, 0.6, 0.8], (3, 10, 12))
    for k in range(3):
        np.testing.assert_array_equal(
            seen.regime.values[k], read_view(ds.isel(R=k), [], pixels=(12, 10), marks=False).regime
        )


def test_the_overviews_of_a_stack_are_what_its_cells_give(large: store.AtlasStore) -> None:
    chunks, faults = check_overviews(large, set(), lambda level: None)
    assert chunks > 0
    assert faults == []


@pytest.mark.parametrize("k", [0, 1, 2])
def test_answers_about_a_plane_are_those_of_its_cells(large: store.AtlasStore, k: int) -> None:
    ds = atlas.open(large.path).isel(R=k)
    naive = atlas.open(large.path).isel(R=k).load()
    naive.encoding.clear()
    window = {"omega": (1.3, 3.1), "b": (0.12, 0.4)}
    assert ds.atlas.fractions(window).to_dict() == pytest.approx(naive.atlas.fractions(window).to_dict(), rel=1e-9)
    assert ds.atlas.fractions().to_dict() == pytest.approx(naive.atlas.fractions().to_dict(), rel=1e-9)
    assert ds.atlas.count_reasons().to_dict() == naive.atlas.count_reasons().to_dict()
    pandas.testing.assert_frame_equal(
        ds.atlas.regions("period", window=window), naive.atlas.regions("period", window=window)
    )
    assert str(ds.atlas.extremes("largest")) == str(naive.atlas.extremes("largest"))
    pandas.testing.assert_frame_equal(ds.atlas.boundary("chaotic"), naive.atlas.boundary("chaotic"))


def test_shares_of_a_large_stack_count_every_plane(large: store.AtlasStore) -> None:
    ds, naive = atlas.open(large.path), atlas.open(large.path).load()
    naive.encoding.clear()
    window = {"R": (0.55, 0.9), "omega": (1.3, 3.1)}
    assert ds.atlas.fractions(window).to_dict() == pytest.approx(naive.atlas.fractions(window).to_dict(), rel=1e-9)


def test_the_planes_of_a_stack_are_drawn_on_one_scale_under_their_values(solved: Path) -> None:
    drawn = render.figure(atlas.open(solved))
    titles = [ax.get_title("left") for ax in drawn.axes if ax.get_title("left")]
    assert titles == ["$R = 0.6$", "$R = 0.7$", "$R = 0.8$"]


def test_one_plane_of_a_stack_is_drawn_as_a_plane(solved: Path, tmp_path: Path) -> None:
    answered("plot", solved, "--select", "R=0.8", "--variable", "periods_used", "-o", tmp_path / "one.png")
    answered("plot", solved, "-o", tmp_path / "all.png", "--window", "R=0.65:0.85")
    assert len(render.figure(atlas.open(solved), window={"R": (0.8, 0.8)}).axes) == 2  # map and scale


def test_too_many_planes_for_one_picture_are_refused(tmp_path: Path) -> None:
    handle = create.create_store(tmp_path / "out.zarr", stack_of(R=np.linspace(0.1, 0.9, 13).tolist()), (1, 3, 4))
    text = answered("plot", handle.path, "-o", tmp_path / "out.png", code=2)
    assert "a stack of 13 planes: at most 12 are drawn together; pick one by --select R=0.1" in text
    assert not (tmp_path / "out.png").exists()


def test_overlays_and_other_kinds_are_drawn_over_one_plane_only(solved: Path) -> None:
    ds = atlas.open(solved)
    with pytest.raises(InputError, match="overlay: goes with one plane, found a stack of 3; pick one by --select R"):
        render.figure(ds, overlay="boundaries")
    with pytest.raises(InputError, match="kind 'sweep' draws one axis, found a stack of 3 planes"):
        render.figure(ds, "sweep")
    with pytest.raises(InputError, match="kind 'basins' is drawn of one atlas; side by side: exponent, period"):
        render.figure(ds, "basins")


def test_a_boundary_needs_a_plane(solved: Path) -> None:
    with pytest.raises(InputError, match=r"a boundary needs two axes, found 3 \(omega, b, R\)"):
        atlas.open(solved).atlas.boundary("chaotic")
