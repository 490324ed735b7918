"""The smallest and largest values of a variable, for each regime, period or impact pattern, or over all cells."""

from typing import TYPE_CHECKING, Any

import numpy as np

from atlas.argument_checks import check_name
from atlas.errors import InputError, check_names
from atlas.query.cell_blocks import CellBlock, iter_cell_blocks
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
    check_name("variable", name)
    check_name("by", by)
    check_number(ds, name)
    classes, part = None if by == ALL else CellClassifier(ds, by), select_window(ds, window)
    meant = variable_of(ds, name)
    codes = meant.regimes
    if classes is not None:
        codes = codes & {*classes.codes}
    needed = [name, *(classes.names if classes else ())]
    dims = part[REGIME.name].dims
    best: dict[int, _ExtremeTracker] = {}
    for block in iter_cell_blocks(part, needed, codes):
        counted = np.isin(block.regime, list(codes)) & np.isfinite(block.values[name])
        if meant.allows_infinite:
            counted &= block.values[name] >= 0
        numbers = np.where(counted, 1 if classes is None else classes.number(block), 0)
        for number in np.unique(numbers[numbers > 0]).tolist():
            best.setdefault(number, _ExtremeTracker()).add(block, block.values[name], numbers == number)
    ordered = [(1, None)] if classes is None else classes.list_classes()
    entries: list[dict[str, Any]] = []
    for number, value in ordered:
        for extreme, (at, number_there) in best[number].ends() if number in best else ():
            index = dict(zip(map(str, dims), at, strict=True))
            entry: dict[str, Any] = {} if classes is None else {by: value}
            entry |= {"extreme": extreme}
            entry |= {axis: float(axis_values(part, axis)[index[axis]]) for axis in axis_names(part)}
            entry |= {name: float(axis_values(part, name)[at[0]]) for name in columns(part)}
            entry["value"] = number_there
            if name == LARGEST.name and ERROR.name in ds:
                entry["error"] = float(part[ERROR.name].isel(index).values)
            entries.append(entry | {"cells": best[number].cells})
    return entries


class _ExtremeTracker:
    """The smallest and the largest value of the cells seen so far, with the indices of their cells."""

    def __init__(self) -> None:
        self.cells = 0
        self.low: tuple[Any, tuple[int, ...]] | None = None
        self.high: tuple[Any, tuple[int, ...]] | None = None

    def add(self, block: CellBlock, values: Any, cells: Any) -> None:
        """Update both extremes with the values of a block of cells; only cells in the mask ``cells`` count."""
        at = np.argwhere(cells)
        self.cells += len(at)
        inside = values[cells]
        for low, k in ((True, int(inside.argmin())), (False, int(inside.argmax()))):
            value = inside[k].item()
            index = tuple(int(i) + s.start for i, s in zip(at[k], block.cells, strict=True))
            before = self.low if low else self.high
            better = before is None or (value < before[0] if low else value > before[0])
            if better or (before is not None and value == before[0] and index < before[1]):
                if low:
                    self.low = value, index
                else:
                    self.high = value, index

    def ends(self) -> list[tuple[str, tuple[tuple[int, ...], Any]]]:
        """Return both extremes by name, "smallest" and "largest", each with the indices of its cell and its value."""
        assert self.low is not None and self.high is not None
        return [("smallest", self.low[::-1]), ("largest", self.high[::-1])]


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
