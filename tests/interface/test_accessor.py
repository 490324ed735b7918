"""Claims about ``ds.atlas``: it answers as the functions do, of whatever selection it is asked."""

import inspect
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner
from PIL import Image

import atlas
import atlas.accessor
from atlas.accessor import AtlasAccessor, PlottableBranches, PlottableComparison
from atlas.cell.trajectory import cell_orbit
from atlas.cli.compare import compare
from atlas.cli.main import main
from atlas.cli.pictures import plot
from atlas.errors import ChunkError, InputError
from atlas.query import queries as query
from tests.query.test_query import plane
from tests.synthetic import complete
from workers import Settings
from workers.results import CHAOTIC, PENDING, PERIODIC, QUASIPERIODIC

P, C, Q, N = PERIODIC, CHAOTIC, QUASIPERIODIC, PENDING


def with_units(ds: xr.Dataset) -> xr.Dataset:
    ds.largest.attrs.update(units="1", long_name="largest Lyapunov exponent per forcing period")
    return ds


def test_at_takes_the_axes_by_name_and_gives_the_cell_of_the_query() -> None:
    ds = plane([1, 2, 3], [0.1, 0.2])
    found, cell = ds.atlas.at(omega=2.9, b=0.2), query.nearest_cell(ds, {"omega": 2.9, "b": 0.2})
    away = {f"distance_{name}": value for name, value in cell.pop("distance").items()}
    assert {name: found[name].item() for name in (*cell, *away)} == cell | away


def test_at_takes_lists_of_points_and_gives_each_cell_once_for_each() -> None:
    ds = plane([1, 2, 3], [0.1, 0.2], [[P, C, Q], [P, P, N]])
    found = ds.atlas.at(omega=[1, 2.1, 3, 2], b=[0.1, 0.1, 0.2, 0.1])
    assert found["regime"].dims == ("point",)
    assert found["regime"].values.tolist() == ["periodic", "chaotic", "pending", "chaotic"]
    assert found["omega"].values.tolist() == [1.0, 2.0, 3.0, 2.0]
    assert ds.atlas.at(omega=[1, 2], b=0.2)["distance_omega"].values.tolist() == [0.0, 0.0]


def test_lists_of_points_of_different_lengths_are_refused() -> None:
    with pytest.raises(InputError, match=r"points: found the shapes omega \[2\], b \[3\], must be numbers"):
        plane([1, 2, 3], [0.1, 0.2]).atlas.at(omega=[1, 2], b=[0.1, 0.1, 0.1])


def test_fractions_take_a_window() -> None:
    ds = plane([1, 2], [0.1, 0.2], [[P, C], [P, P]])
    assert ds.atlas.fractions({"omega": (2, 2)}).to_dict() == {"periodic": 0.5, "chaotic": 0.5}


def test_the_accessor_answers_of_a_selection() -> None:
    ds = plane([1, 2], [0.1, 0.2], [[P, C], [P, P]])
    assert ds.isel(b=0).atlas.fractions().to_dict() == {"periodic": 0.5, "chaotic": 0.5}


def test_where_regime_takes_the_other_results_out_and_keeps_the_regimes() -> None:
    kept = plane([1, 2], [0.1, 0.2], [[P, C], [Q, P]]).atlas.where_regime("chaotic", "quasiperiodic")
    np.testing.assert_array_equal(kept.largest, [[np.nan, 1.0], [2.0, np.nan]])
    assert kept.regime.values.tolist() == [[P, C], [Q, P]]
    assert kept.sticks.dtype == float
    assert np.isnan(kept.state.values[0, 0]).all()


def test_cells_of_a_regime_are_asked_for_by_its_name() -> None:
    ds = plane([1, 2], [0.1, 0.2], [[P, C], [Q, P]])
    assert ds.atlas.is_("chaotic").values.tolist() == [[False, True], [False, False]]
    assert ds.atlas.is_("chaotic", "quasiperiodic").values.tolist() == [[False, True], [True, False]]
    with pytest.raises(InputError, match=r"chaotc.*chaotic"):
        ds.atlas.is_("chaotc")


def test_a_store_opened_by_xarray_has_the_attributes_and_the_accessor_of_one_opened_by_atlas(tmp_path: Path) -> None:
    complete(tmp_path / "out.zarr")
    ours, plain = atlas.open(tmp_path / "out.zarr"), xr.open_zarr(tmp_path / "out.zarr")
    assert ours.largest.attrs["units"] == "1"
    assert all(ours[name].attrs == plain[name].attrs for name in plain.variables)
    assert plain.atlas.fractions().to_dict() == ours.atlas.fractions().to_dict()


@pytest.mark.parametrize("first", ["import atlas; find_spec('xarray'); import xarray", "import xarray, atlas"])
def test_xarray_has_the_accessor_whichever_is_imported_first(first: str) -> None:
    """Looking for xarray, as other packages do, is no import of it."""
    program = f"""
import sys
from importlib.util import find_spec
{first}
import xarray.backends
print(hasattr(xarray.Dataset, "atlas"), "atlas.accessor" in sys.modules, len(xarray.Dataset({{"a": 1}}).data_vars))
import atlas.accessor
"""
    done = subprocess.run([sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "False", "1"]


def test_xarray_has_the_engine_without_an_import_of_atlas(tmp_path: Path) -> None:
    complete(tmp_path / "out.zarr")
    program = (
        "import sys, xarray; print(xarray.open_dataset(sys.argv[1], engine='atlas').atlas.fractions()['periodic'])"
    )
    command = [sys.executable, "-W", "error", "-c", program, str(tmp_path / "out.zarr")]
    assert float(subprocess.run(command, capture_output=True, text=True, check=True).stdout) >= 0.0


@pytest.mark.parametrize("chunks", [None, {}])
def test_the_engine_of_xarray_opens_what_atlas_opens(tmp_path: Path, chunks: dict[str, int] | None) -> None:
    complete(tmp_path / "out.zarr")
    ours = atlas.open(tmp_path / "out.zarr", chunks)
    theirs = xr.open_dataset(tmp_path / "out.zarr", engine="atlas", chunks=chunks, drop_variables=["period"])
    xr.testing.assert_identical(theirs.compute(), ours.drop_vars("period").compute())
    assert theirs.atlas.fractions().equals(ours.atlas.fractions())


def test_the_engine_of_xarray_refuses_a_damaged_chunk_by_its_name(tmp_path: Path) -> None:
    handle = complete(tmp_path / "out.zarr")
    chunk = next(path for path in (handle.path / "largest" / "c").rglob("*") if path.is_file())
    chunk.write_bytes(chunk.read_bytes()[:-1])
    with pytest.raises(ChunkError, match="largest"):
        xr.open_dataset(handle.path, engine="atlas").largest.load()


@pytest.mark.parametrize("chunks", [None, {}])
def test_the_encoding_of_a_dataset_is_plain(tmp_path: Path, chunks: dict[str, int] | None) -> None:
    handle = complete(tmp_path / "out.zarr")
    encoding = atlas.open(handle.path, chunks).encoding
    assert json.loads(json.dumps(encoding)) == encoding
    assert (encoding["source"], encoding["run_id"]) == (str(handle.path), handle.run_id)


def test_an_unknown_regime_is_refused_with_the_nearest() -> None:
    with pytest.raises(InputError, match="unknown regime 'chaos'; did you mean 'chaotic'"):
        plane([1, 2], [0.1, 0.2]).atlas.where_regime("chaos")


# Boundaries


def lines_of(frame: pd.DataFrame) -> list[np.ndarray]:
    """The lines of a boundary, points (N, 2) each."""
    return [part[["omega", "b"]].to_numpy() for _, part in frame.groupby("line")]


def test_a_boundary_runs_along_the_edges_of_cells() -> None:
    (line,) = lines_of(plane([1, 2, 3], [0.1, 0.2, 0.3], [[P, C, C]] * 3).atlas.boundary("chaotic"))
    np.testing.assert_allclose(line[:, 0], 1.5)
    assert sorted(line[:, 1]) == pytest.approx([0.1, 0.2, 0.3])


def test_on_a_log_axis_it_lies_at_the_geometric_mean() -> None:
    (line,) = lines_of(plane([1, 4, 16], [0.1, 0.2, 0.3], [[P, P, C]] * 3).atlas.boundary("chaotic"))
    np.testing.assert_allclose(line[:, 0], 8.0)


def test_a_boundary_of_two_regimes_leaves_out_where_a_third_lies_between() -> None:
    ds = plane([1, 2, 3, 4], [0.1, 0.2, 0.3], [[P, C, Q, Q]] * 3)
    assert ds.atlas.boundary("chaotic")["line"].nunique() == 2
    (line,) = lines_of(ds.atlas.boundary("chaotic", "periodic"))
    np.testing.assert_allclose(line[:, 0], 1.5)
    assert ds.atlas.boundary("quasiperiodic", "periodic").empty


def test_each_point_of_a_boundary_has_the_regimes_on_both_sides() -> None:
    """Also beside pending cells, where lines run between diagonal neighbours."""
    found = plane([1, 2, 3, 4], [0.1, 0.2, 0.3], [[P, C, Q, Q], [P, C, Q, Q], [P, N, Q, Q]]).atlas.boundary("chaotic")
    assert set(found["regime"]) == {"chaotic"}
    pairs = set(zip(np.sign(found["omega"] - 2.0), found["other"], strict=True))
    assert pairs == {(-1.0, "periodic"), (1.0, "quasiperiodic")}


def test_pending_cells_bound_nothing() -> None:
    assert plane([1, 2], [0.1, 0.2], [[P, N], [P, N]]).atlas.boundary("periodic").empty


def test_an_island_has_a_closed_boundary() -> None:
    codes = np.full((5, 5), P)
    codes[2, 2] = C
    (line,) = lines_of(plane([1, 2, 3, 4, 5], [1, 2, 3, 4, 5], codes).atlas.boundary("chaotic"))
    assert line[0].tolist() == line[-1].tolist()
    assert np.abs(line - 3).sum(1) == pytest.approx(np.full(len(line), 0.5))


def test_a_boundary_can_be_asked_of_a_window() -> None:
    ds = plane([1, 2, 3, 4], [0.1, 0.2], [[P, C, P, C]] * 2)
    (line,) = lines_of(ds.atlas.boundary("chaotic", window={"omega": (1, 2)}))
    np.testing.assert_allclose(line[:, 0], 1.5)


def test_a_boundary_does_not_depend_on_the_order_of_an_axis() -> None:
    ds = plane([1, 2, 3], [0.1, 0.2, 0.3], [[P, C, C]] * 3)
    (line,) = lines_of(ds.isel(omega=slice(None, None, -1)).atlas.boundary("chaotic"))
    np.testing.assert_allclose(line[:, 0], 1.5)


def test_a_sweep_has_no_boundary_lines() -> None:
    with pytest.raises(InputError, match="a boundary needs two axes"):
        plane([1, 2], [0.1, 0.2]).isel(b=0).atlas.boundary("chaotic")


# Units


@pytest.mark.parametrize("fixed", [False, True])
def test_per_unit_time_divides_by_the_forcing_period(fixed: bool) -> None:
    ds = with_units(plane([1, 2], [0.1, 0.2]))
    ds = ds.isel(omega=1) if fixed else ds
    made = ds.atlas.per_unit_time().largest
    np.testing.assert_allclose(made, ds.largest / (2 * np.pi / ds.omega))
    assert made.dims == ds.largest.dims
    assert made.attrs == {"units": "1", "long_name": "largest Lyapunov exponent per unit time"}


def test_exponents_are_not_converted_twice() -> None:
    with pytest.raises(InputError, match="not per forcing period"):
        with_units(plane([1, 2], [0.1, 0.2])).atlas.per_unit_time().atlas.per_unit_time()


def test_the_forcing_frequency_has_to_be_known() -> None:
    with pytest.raises(InputError, match="forcing frequency of this atlas is not known"):
        with_units(plane([1, 2], [0.1, 0.2])).rename(omega="x").atlas.per_unit_time()


# Pictures


def options_of(command: click.Command, *without: str) -> set[str]:
    return {str(param.name) for param in command.params if param.expose_value} - {"out", "storage_option", *without}


@pytest.mark.parametrize(
    ("method", "options"),
    [
        (AtlasAccessor.plot, options_of(plot, "stores", "select")),  # of which xarray picks the plane
        (AtlasAccessor.portrait, {"width", "height", "font_size", "dpi", "title", "legend", "style"}),
        (AtlasAccessor.explore, {"scheduler", "workers", "tolerance", "port"}),
        (PlottableComparison.plot, options_of(compare, "store", "other", "window", "as_json", "first", "second")),
        (PlottableBranches.plot, {"width", "height", "font_size", "dpi", "title", "legend", "style"}),
    ],
    ids=lambda value: getattr(value, "__qualname__", ""),
)
def test_methods_that_draw_have_the_options_of_their_command_as_keyword_arguments(
    method: Callable[..., object], options: set[str]
) -> None:
    parameters = inspect.signature(method).parameters
    assert options <= parameters.keys()
    assert all(name in (method.__doc__ or "") for name in options)


def test_an_unknown_option_is_refused_with_all_that_there_are() -> None:
    ds = plane([1, 2], [0.1, 0.2])
    possible = [name for name in inspect.signature(AtlasAccessor.plot).parameters if name != "self"]
    with pytest.raises(InputError) as error:
        ds.atlas.plot("exponent", overlays="grazing")
    assert str(error.value) == f"unknown option 'overlays'; possible: {', '.join(possible)}"
    assert {"overlay", "curves", "against", "ax", "width", "vmin"} <= set(possible)
    with pytest.raises(InputError, match="unknown option 'widht'; possible: omega, b, path, width, "):
        ds.atlas.portrait(omega=1, b=0.1, widht="85mm")
    with pytest.raises(InputError, match="unknown option 'widht'; possible: others, kind, window, width, "):
        ds.atlas.plot_side_by_side(ds, widht="85mm")


def test_plot_draws_a_kind_in_a_window() -> None:
    ds = plane([1, 2, 3, 4], [0.1, 0.2])
    assert ds.atlas.plot("exponent", window={"omega": (2, 3)}).axes[0].get_xlim() == (1.5, 3.5)


def test_exponents_per_unit_time_are_not_drawn_under_the_label_of_others() -> None:
    with pytest.raises(InputError, match="pictures need exponents per forcing period, found per unit time"):
        with_units(plane([1, 2], [0.1, 0.2])).atlas.per_unit_time().atlas.plot()


def test_a_portrait_is_of_the_nearest_cell_with_the_settings_of_the_atlas(tmp_path: Path) -> None:
    """The digest in the file is made from the system, all parameters and all settings."""
    spec = json.dumps({"system": "two-mass", "axes": [], "solve": {"max_periods": 123}})
    plane([1, 4], [0.1, 0.6], spec=spec).atlas.portrait(omega=3.9, b=0.5, path=tmp_path / "a.png")
    cell = cell_orbit({"omega": 4.0, "b": 0.6, "R": 0.8}, "two-mass", Settings(max_periods=123))
    with Image.open(tmp_path / "a.png") as image:
        assert image.info["Digest"] == cell.digest


def test_the_command_draws_a_cell_of_a_store_with_the_settings_of_the_atlas(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[tuple[Any, ...]] = []

    def draw(given: Any, *, system: Any, settings: Any, path: Path, **look: Any) -> None:
        drawn.append((given, system.name, settings))

    monkeypatch.setattr("atlas.render.portrait", draw)
    line = ["portrait", str(finished), "--at", "omega=2.3", "--at", "b=0.42", "-o", str(tmp_path / "cell.png")]
    assert CliRunner().invoke(main, line).exit_code == 0
    ((given, system, settings),) = drawn
    cell = atlas.open(finished).atlas.at(omega=2.3, b=0.42)
    assert (given["omega"], given["b"], given["R"]) == (cell["omega"], cell["b"], 0.8)
    assert (system, settings) == ("two-mass", Settings(max_periods=500, tolerance=0.1, section_samples=2))


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (["--at", "omega=3"], "--at needs a STORE"),
        (["a.zarr", "--set", "omega=3"], "--set is for a cell without a STORE"),
        (["a.zarr", "--max-periods", "900"], "--max-periods is for a cell without a STORE"),
    ],
)
def test_options_of_cells_that_do_not_go_together_are_refused(args: list[str], says: str, tmp_path: Path) -> None:
    shown = CliRunner().invoke(main, ["portrait", *args, "-o", str(tmp_path / "cell.png")])
    assert (shown.exit_code, says in shown.output) == (2, True)


def test_a_portrait_needs_to_know_how_the_atlas_was_solved() -> None:
    with pytest.raises(InputError, match="has no record of how it was solved"):
        plane([1, 2], [0.1, 0.2]).atlas.portrait(omega=1, b=0.1)


def test_a_picture_shows_itself_as_a_png_of_its_size() -> None:
    data, size = plane([1, 2], [0.1, 0.2]).atlas.plot(width=5, height=4)._repr_png_()
    assert data.startswith(b"\x89PNG")
    assert size == {"width": 360, "height": 288}
