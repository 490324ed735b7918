"""Export of cells to a file for other programs: CSV or netCDF, selected by the suffix."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

import numpy as np

from atlas.argument_checks import validate_path
from atlas.errors import InputError
from atlas.platform import move_whole, temporary_beside
from atlas.query.window import Window, axis_names, select_window
from atlas.query.window import columns as columns_of

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

FORMATS = (".csv", ".nc")
NETCDF_BYTES = 2**32 - 4
"""Maximum size, in bytes, of a variable in netCDF 3."""
CSV_CELLS = 1 << 16
"""Number of cells that are read at a time for CSV."""


def export(
    ds: "xr.Dataset",
    path: str | Path,
    window: Window | None = None,
    *,
    csv_cells: int = CSV_CELLS,
    netcdf_bytes: int = NETCDF_BYTES,
) -> int:
    """Write the cells of a window to a file, at full resolution, and return their number.

    CSV has one row per cell, with the first axis varying fastest. Its columns are the axes and every variable; a table
    of points has the row number and the parameters of each point. A variable with several components has a column for
    each (``state_x1``, ``spectrum_1``). Codes such as regime and reason are written by name, codes without a name as
    numbers. Numbers have their shortest exact form; NaN and -inf are written as such, and no field is empty.

    netCDF (version 3, 64-bit offset) has the dataset as it is, with fixed parameters as scalar coordinates. The file is
    written completely or not at all.

    csv_cells     number of cells read at a time for CSV; at least one row is read
    netcdf_bytes  maximum size of a variable, in bytes

    Raise InputError for another suffix, an unknown axis, a window without a cell or too large for netCDF, and a path
    that cannot be written.
    """
    target = validate_path(path)
    suffix = check_target(target, FORMATS)
    selection = select_window(ds, window)
    count = int(np.prod([selection.sizes[name] for name in axis_names(selection)]))
    with replace_on_success(target) as unfinished:
        if suffix == ".csv":
            _write_csv(selection, unfinished, csv_cells)
        else:
            _write_netcdf(selection, unfinished, netcdf_bytes)
    return count


def write_table(path: Path, table: "pd.DataFrame") -> None:
    """Write a table as CSV, completely or not at all. Raise InputError for a path that cannot be written."""
    with replace_on_success(path) as unfinished, unfinished.open("w", newline="", encoding="utf-8") as file:
        _append(file, table)


def write_history(table: "pd.DataFrame", path: Path) -> None:
    """Write the table of a time history as CSV or netCDF (version 3), completely or not at all.

    The suffix of the path selects the format. Raise InputError for another suffix and for a path that cannot be
    written.
    """
    if check_target(path, FORMATS) == ".csv":
        write_table(path, table)
        return
    with replace_on_success(path) as unfinished:
        words = table["event"].to_numpy(dtype=str)  # netCDF 3 has characters only
        ds = table.drop(columns="event").rename_axis("row").to_xarray().assign(event=("row", words))
        ds.to_netcdf(unfinished, format="NETCDF3_64BIT", engine="scipy")


def _append(file: TextIO, table: "pd.DataFrame", header: bool = True) -> None:
    """Append a table to an open file; NaN and infinities are written as such."""
    table.to_csv(file, index=False, header=header, na_rep="nan", lineterminator="\n")


def check_target(path: Path, formats: Sequence[str]) -> str:
    """Return the suffix of a file to write, in lower case. Call this function before work that may take long.

    Raise InputError unless ``formats`` has the suffix and the file can be written.
    """
    suffix, folder = path.suffix.lower(), path.absolute().parent
    if suffix not in formats:
        suffix_text = f"found {path.suffix!r}" if len(suffix) > 1 else "found none"
        raise InputError(f"{path.name}: the suffix chooses the format, {suffix_text}; possible: {', '.join(formats)}")
    if path.is_dir():
        raise InputError(f"{path}: cannot be written: is a folder")
    if not folder.is_dir():
        raise InputError(f"{path}: cannot be written: there is no folder {folder}")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"{path}: cannot be written: no permission in {folder}")
    return suffix


@contextmanager
def replace_on_success(target: Path) -> Iterator[Path]:
    """Yield a temporary path to write to; at the end of the context its file replaces ``target``.

    After an error the temporary file is removed instead. Raise InputError for a target that cannot be written.
    """
    try:
        with temporary_beside(target, ".") as unfinished:
            yield unfinished
            move_whole(unfinished, target)
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror or error}") from None


def _write_csv(ds: "xr.Dataset", path: Path, cells_at_a_time: int) -> None:
    names = axis_names(ds)
    dims = tuple(reversed(names))
    cells = ds[[name for name in ds.data_vars if set(dims) <= set(ds[name].dims)]]
    rows = max(1, cells_at_a_time // (ds.sizes[names[0]] if len(names) > 1 else 1))
    with path.open("w", newline="", encoding="utf-8") as file:
        for number, block in enumerate(_blocks(cells, dims, rows)):
            _append(file, _table(block.load(), names), header=number == 0)


def _table(block: "xr.Dataset", names: tuple[str, ...]) -> "pd.DataFrame":
    """Return the cells of a block as a table, one row per cell, with the first axis varying fastest."""
    dims = tuple(reversed(names))
    columns: dict[str, xr.DataArray] = {}
    for name, variable in block.data_vars.items():
        columns |= _components(str(name), variable, dims)
    table = block[[]].assign(columns).to_dataframe(dim_order=dims).reset_index()
    table = table[[*names, *columns_of(block), *columns]]
    for column, variable in columns.items():
        if words := code_names(variable):
            table[column] = [words.get(code, code) for code in table[column].tolist()]
    return table


def code_names(variable: "xr.DataArray") -> dict[int, str]:
    """Return the names of a variable's codes, by code; empty if the variable has no codes."""
    codes, names = variable.attrs.get("flag_values", ()), variable.attrs.get("flag_meanings", "")
    return dict(zip((int(code) for code in codes), names.split(), strict=True))


def _blocks(ds: "xr.Dataset", dims: tuple[str, ...], rows: int) -> Iterator["xr.Dataset"]:
    """Yield consecutive parts of a dataset with at most ``rows`` rows each; a stack is cut plane by plane.

    ``dims`` are the dimensions of the cells.
    """
    along = dims[-2:][0]
    for plane in range(ds.sizes[dims[0]]) if len(dims) > 2 else [None]:
        part = ds if plane is None else ds.isel({dims[0]: slice(plane, plane + 1)})
        for first in range(0, ds.sizes[along], rows):
            yield part.isel({along: slice(first, first + rows)})


def _components(name: str, variable: "xr.DataArray", dims: tuple[str, ...]) -> dict[str, "xr.DataArray"]:
    """Return the table columns of a variable, by name: the variable itself, or one column for each of its components.

    Components are named by their label, or else by their number from 1. ``dims`` are the dimensions of the cells.
    """
    inner = next((dim for dim in variable.dims if dim not in dims), None)
    if inner is None:
        return {name: variable}
    labels = variable[inner].values if inner in variable.coords else range(1, variable.sizes[inner] + 1)
    components: dict[str, xr.DataArray] = {}
    for k, label in enumerate(labels):
        components |= _components(f"{name}_{label}", variable.isel({inner: k}, drop=True), dims)
    return components


def _write_netcdf(ds: "xr.Dataset", path: Path, limit: int) -> None:
    for name in ds.data_vars:
        if ds[name].nbytes > limit:
            raise InputError(f"{name}: found {ds[name].nbytes} bytes, netCDF allows {limit}; narrow the window")
    plain = ds.drop_encoding()
    for array in plain.variables.values():
        if "flag_values" in array.attrs:  # CF requires the variable's own type
            array.attrs["flag_values"] = np.asarray(array.attrs["flag_values"], dtype=array.dtype)
    for name in plain.coords:
        if plain[name].dtype.kind in "OT":
            words = np.array(plain[name].values.tolist(), dtype=str)  # netCDF 3 has characters only
            plain = plain.assign_coords({name: (plain[name].dims, words, plain[name].attrs)})
    plain.to_netcdf(path, format="NETCDF3_64BIT", engine="scipy")
