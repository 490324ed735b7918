"""Claims about exported windows: every cell, exactly, in files that other programs read."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from xarray.backends import BackendArray
from xarray.core import indexing

import atlas
from atlas.errors import InputError
from atlas.query.export import export
from atlas.query.window import select_window
from atlas.spec.points import POINT
from atlas.store import create
from tests.synthetic import fill, spec_of
from workers.results import REGIMES

WINDOW = {"omega": (1.5, 2.5), "b": (0.2, 0.3)}


@pytest.fixture(scope="module")
def ds(tmp_path_factory: pytest.TempPathFactory) -> xr.Dataset:
    handle = create.create_store(tmp_path_factory.mktemp("export") / "a.zarr", spec_of(nx=20, ny=12), (6, 10))
    fill(handle)
    return atlas.open(handle.path)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_csv_has_a_row_for_every_cell_x_fastest(ds: xr.Dataset, tmp_path: Path) -> None:
    part = select_window(ds, WINDOW)
    assert export(ds, tmp_path / "a.csv", WINDOW) == part.regime.size
    rows = rows_of(tmp_path / "a.csv")
    assert [(float(row["omega"]), float(row["b"])) for row in rows] == [
        (x, y) for y in part.b.values for x in part.omega.values
    ]


@pytest.mark.parametrize("block", [1, 25, 1 << 16])
def test_a_csv_holds_exact_numbers_and_regimes_by_name(ds: xr.Dataset, tmp_path: Path, block: int) -> None:
    export(ds, tmp_path / "a.csv", csv_cells=block)
    rows = rows_of(tmp_path / "a.csv")
    names = ds.regime.attrs["flag_meanings"].split()
    assert [row["regime"] for row in rows] == [names[code + 1] for code in ds.regime.values.ravel()]
    np.testing.assert_array_equal([float(row["largest"]) for row in rows], ds.largest.values.ravel())
    assert [int(row["period"]) for row in rows] == ds.period.values.ravel().tolist()


def test_a_csv_holds_the_codes_of_a_measure_by_name_and_one_without_a_name_as_a_number(
    ds: xr.Dataset, tmp_path: Path
) -> None:
    attrs = {"flag_values": [0, 1], "flag_meanings": "fold flip"}
    codes = (np.arange(240) % 3 - 1).astype(np.int8).reshape(12, 20)
    kinds = xr.DataArray(codes, ds.regime.coords, ds.regime.dims)
    export(ds[["regime"]].assign(margin_kind=kinds.assign_attrs(attrs)), tmp_path / "a.csv")
    assert [row["margin_kind"] for row in rows_of(tmp_path / "a.csv")] == ["-1", "fold", "flip"] * 80


def test_a_csv_has_a_column_for_each_component(ds: xr.Dataset, tmp_path: Path) -> None:
    export(ds, tmp_path / "a.csv", WINDOW)
    columns = rows_of(tmp_path / "a.csv")[0].keys()
    assert {"state_x1", "state_x2", "state_v1", "state_v2", "sticks"} <= columns


def test_a_sweep_is_exported_too(ds: xr.Dataset, tmp_path: Path) -> None:
    export(ds.isel(b=3), tmp_path / "a.csv")
    rows = rows_of(tmp_path / "a.csv")
    assert [float(row["omega"]) for row in rows] == ds.omega.values.tolist()
    np.testing.assert_array_equal([float(row["largest"]) for row in rows], ds.largest.values[3])


class Counted(BackendArray):
    """Numbers that are read when they are asked for; ``sizes`` of the parts that were."""

    def __init__(self, values: np.ndarray) -> None:
        self._values, self.shape, self.dtype = values, values.shape, values.dtype
        self.sizes: list[int] = []

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.BASIC, self._get)

    def _get(self, key: Any) -> np.ndarray:
        self.sizes.append(self._values[key].size)
        return self._values[key]


@pytest.mark.parametrize("dim", ["omega", POINT])
def test_a_sweep_and_a_table_are_read_a_block_at_a_time(ds: xr.Dataset, tmp_path: Path, dim: str) -> None:
    """Truth: a table was read as a whole, whatever its size."""
    line = ds[["regime", "largest"]].isel(b=3).load()
    if dim == POINT:
        line = line.rename({"omega": POINT}).assign_coords({POINT: np.arange(20), "omega": (POINT, ds.omega.values)})
    counted = Counted(line.largest.values)
    lazy = xr.Variable((dim,), indexing.LazilyIndexedArray(counted))
    export(line.assign(largest=lazy), tmp_path / "a.csv", csv_cells=6)
    assert counted.sizes == [6, 6, 6, 2]
    rows = rows_of(tmp_path / "a.csv")
    np.testing.assert_array_equal([float(row["largest"]) for row in rows], line.largest.values)
    np.testing.assert_array_equal([float(row["omega"]) for row in rows], ds.omega.values)


def test_a_netcdf_file_holds_the_window_with_its_attributes(ds: xr.Dataset, tmp_path: Path) -> None:
    export(ds, tmp_path / "a.nc", WINDOW)
    with xr.open_dataset(tmp_path / "a.nc", engine="scipy") as read:
        xr.testing.assert_equal(read.drop_vars("component"), select_window(ds, WINDOW).drop_vars("component"))
        assert read.component.values.tolist() == ["x1", "x2", "v1", "v2"]
        assert read.regime.attrs["flag_values"].dtype == np.int8
        assert read.regime.dtype == np.int8
        assert read.attrs["digest"] == ds.attrs["digest"]
        assert float(read.R) == 0.8


def test_exporting_leaves_the_dataset_as_it_was(ds: xr.Dataset, tmp_path: Path) -> None:
    export(ds, tmp_path / "a.nc", WINDOW)
    assert ds.regime.attrs["flag_values"] == [regime.code for regime in REGIMES]
    assert ds.encoding["source"]


@pytest.mark.parametrize("name", ["a.txt", "a"])
def test_another_suffix_is_refused(ds: xr.Dataset, tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"the suffix chooses the format, .*possible: \.csv, \.nc$"):
        export(ds, tmp_path / name)


@pytest.mark.parametrize("name", ["a.csv", "a.nc"])
def test_a_file_that_cannot_be_written_leaves_nothing(ds: xr.Dataset, tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    with pytest.raises(InputError, match=f"{name}: cannot be written"):
        export(ds, tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_window_too_large_for_netcdf_is_refused(ds: xr.Dataset, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="bytes, netCDF allows 1000"):
        export(ds, tmp_path / "a.nc", netcdf_bytes=1000)
    assert list(tmp_path.iterdir()) == []
