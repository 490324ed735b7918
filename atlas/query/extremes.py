"""The smallest and largest values of a variable, for each regime, period or impact pattern, or over all cells."""

from typing import TYPE_CHECKING, Any

import numpy as np

from atlas.argument_checks import check_name
from atlas.errors import InputError, check_names
from atlas.query.cell_blocks import iter_cell_blocks
from atlas.query.classes import CellClassifier
from atlas.query.window import Window, axis_names, axis_values, columns, select_window
from atlas.spec.system import stored_system
from workers.results import ERROR, LARGEST, REASON, REGIME, Variable, result_named

if TYPE_CHECKING:
    import xarray as xr

ALL = "all"
"""Value of ``by`` that puts all cells into one class."""


def extremes(ds: "xr.Dataset", name: str, by: str = REGIME.name, window: Window | None = None) -> list[dict[str, Any]]:
    """Return the smallest and the largest value of a variable in each class of cells, with the cells that have them.

    Each class has two dicts, with the keys:

    by (its value)  the class, see ``CellClassifier``; missing for "all"
    extreme         "smallest" or "largest"
    (axis)          parameter of the cell, for each axis; for a table of points also for each column
    value           the extreme value
    error           error of the exponent, for the variable ``largest`` only
    cells           number of cells compared

    If several cells have the same extreme value, the first of them counts, row by row. Only finite values of solved
    cells are compared. Exponents of -inf are left out, and so are exponents of cells without a class, since the average
    of an undetermined cell may be far off. Periods are compared for periodic cells only. Infinitely many impacts (of
    sticking motions) are omitted, and so are classes without values. Raise InputError for a variable without one number
    per cell, and as ``regions`` does. The variable and the variables that determine the class are read, in tiles with
    such cells.
    """
    import pandas as pd

    check_name("variable", name)
    check_name("by", by)
    check_number(ds, name)
    classes, part = None if by == ALL else CellClassifier(ds, by), select_window(ds, window)
    meant = variable_of(ds, name)
    codes = meant.regimes
    if classes is not None:
        codes = codes & {*classes.codes}
    needed = [name, *(classes.names if classes else ())]
    dims, tables = [str(dim) for dim in part[REGIME.name].dims], []
    for block in iter_cell_blocks(part, needed, codes):
        counted = np.isin(block.regime, list(codes)) & np.isfinite(block.values[name])
        if meant.allows_infinite:
            counted &= block.values[name] >= 0
        numbers = np.where(counted, 1 if classes is None else classes.number(block), 0)
        at = np.nonzero(numbers)
        index = {dim: i + side.start for dim, i, side in zip(dims, at, block.cells, strict=True)}
        cells = pd.DataFrame({"class": numbers[at], "value": block.values[name][at], **index})
        ends = cells.groupby("class")["value"].agg(["idxmin", "idxmax", "size"])
        for extreme, first in (("smallest", "idxmin"), ("largest", "idxmax")):
            tables.append(cells.loc[ends[first]].assign(extreme=extreme, cells=ends["size"].to_numpy()))
    entries: list[dict[str, Any]] = []
    table = pd.concat(tables, ignore_index=True) if tables else pd.DataFrame(columns=["class", "extreme"])
    for number, value in [(1, None)] if classes is None else classes.list_classes():
        for extreme, rising in (("smallest", True), ("largest", False)):
            rows = table[(table["class"] == number) & (table["extreme"] == extreme)]
            if rows.empty:
                continue
            best = rows.sort_values(["value", *dims], ascending=[rising] + [True] * len(dims)).iloc[0]
            cell = {dim: int(best[dim]) for dim in dims}
            entry: dict[str, Any] = {} if classes is None else {by: value}
            entry |= {"extreme": extreme}
            entry |= {axis: float(axis_values(part, axis)[cell[axis]]) for axis in axis_names(part)}
            entry |= {column: float(axis_values(part, column)[cell[dims[0]]]) for column in columns(part)}
            entry["value"] = best["value"].item()
            if name == LARGEST.name and ERROR.name in ds:
                entry["error"] = float(part[ERROR.name].isel(cell).values)
            entries.append(entry | {"cells": int(rows["cells"].sum())})
    return entries


def variable_of(ds: "xr.Dataset", name: str) -> Variable:
    """Return the description of the variable ``name``: one of the atlas's own system, or one that all atlases have."""
    system = stored_system(ds.attrs)
    system_variables = system.own_variables if system else ()
    return next((variable for variable in system_variables if variable.name == name), result_named(name))


def check_number(ds: "xr.Dataset", name: str) -> None:
    """Raise InputError unless a variable has one number per cell."""
    possible = numbers_of_cells(ds)
    if name in ds and name not in possible:
        raise InputError(f"variable {name!r} does not have one number per cell; possible: {', '.join(possible)}")
    check_names("variable", [name], possible)


def numbers_of_cells(ds: "xr.Dataset") -> list[str]:
    """Return the names of the variables with one number per cell; codes and flags are excluded."""
    dims = set(ds[REGIME.name].dims) if REGIME.name in ds else set(axis_names(ds))
    return [
        str(name) for name in ds.data_vars
        if set(ds[name].dims) == dims and ds[name].dtype.kind in "if" and name not in (REGIME.name, REASON.name)
    ]  # fmt: skip
