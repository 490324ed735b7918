"""A table of points: parameter sets, one row per cell, which a spec may have in place of axes."""

import csv
import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from atlas.errors import InputError, brief_repr, check_names
from atlas.spec.axis import Axis, Values, all_floats, number, validate_in_range
from workers.model.parameter import Parameter
from workers.model.system import System

POINT = "point"
"""Name of the dimension along the rows, which are numbered from 0."""
FILE = "file"
"""Key of the table [points] of a spec whose value is the name of a CSV file."""

MAX_FILE = 10**9
"""Maximum size, in bytes, of a CSV file of points: its numbers take about four times as much memory."""

Columns = Values
"""The columns of a table of points, each with the values of one parameter, by name."""


def row_count(points: Columns) -> int:
    """Return the number of rows of a table of points."""
    return len(next(iter(points.values())))


def parse_points(points: object, system: System, folder: Path | None = None) -> Columns:
    """Return the columns of a table of points by name.

    ``points`` is ``{"file": path}``, with a path relative to ``folder`` if given, or a mapping of names to lists of
    values of one length. Raise InputError with row and column for a value that is no number, or is outside its
    parameter's range. Rows are counted as in a spreadsheet: row 1 has the names.
    """
    if isinstance(points, Mapping) and isinstance(points.get(FILE), str | Path):
        check_names("key in points", points, [FILE])
        path = Path(points[FILE])
        return _read_file(path if folder is None else folder / path, system)
    if not isinstance(points, Mapping):
        raise InputError(f"points: found {brief_repr(points)}, must be a table with the key {FILE}, or with columns")
    return _checked_columns("points", points, system)


def axis_of(points: Columns) -> Axis:
    """Return an axis for a table of points, whose values are the row numbers."""
    return Axis(POINT, tuple(map(float, range(row_count(points)))))


def describe_points(points: Columns) -> str:
    """Return a short text about a table of points: its size and its columns."""
    return f"{row_count(points)} rows of {', '.join(points)}"


def describe_difference(stored: Columns, points: Columns) -> list[str]:
    """Return a list with a short text about the difference of two tables of points; empty if they are equal."""
    if stored == points:
        return []
    if stored.keys() != points.keys():
        sides = [", ".join(columns) or "none" for columns in (stored, points)]
        return [f"columns of points {sides[0]} in the store, {sides[1]} in the spec"]
    rows = [row_count(columns) for columns in (stored, points)]
    if rows[0] != rows[1]:
        return [f"{rows[0]} points in the store, {rows[1]} in the spec"]
    row, name = next((i, name) for i in range(rows[0]) for name in stored if stored[name][i] != points[name][i])
    return [f"point {row}: {name} = {stored[name][row]!r} in the store, {points[name][row]!r} in the spec"]


def _read_file(path: Path, system: System) -> Columns:
    """Read a CSV file of parameter sets and return its columns. Raise InputError as ``parse_points`` does."""
    if path.exists() and not path.is_dir() and not path.is_file():  # a device or a pipe may never end
        raise InputError(f"{path}: cannot be read: not a regular file")
    try:
        if (size := path.stat().st_size) > MAX_FILE:
            raise InputError(f"{path}: found {size} bytes, must be at most {MAX_FILE}; make several atlases")
        with path.open(newline="", encoding="utf-8-sig") as file:
            return _read_rows(str(path), csv.reader(file, strict=True), system)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not UTF-8 text") from None
    except csv.Error as error:
        raise InputError(f"{path}: is not CSV: {error}") from None


def _read_rows(where: str, rows: Iterator[list[str]], system: System) -> Columns:
    names = [name.strip() for name in next(rows, [])]
    _check_handle(where, names, system)
    columns: dict[str, list[object]] = {name: [] for name in names}
    for row_number, row in enumerate(rows, 2):
        if not any(field.strip() for field in row):
            raise InputError(f"{where}, row {row_number}: is empty; remove it")
        if len(row) != len(names):
            raise InputError(
                f"{where}, row {row_number}: found {len(row)} fields, must be {len(names)} as in the first row"
            )
        for name, field in zip(names, row, strict=True):
            try:
                columns[name].append(float(field.strip() if "_" not in field else ""))
            except ValueError:
                raise InputError(
                    f"{where}, row {row_number}, column {name}: found {brief_repr(field)}, must be a number"
                ) from None
    return _checked_columns(where, columns, system)


def _check_handle(where: str, names: Sequence[object], system: System) -> None:
    if not any(names):
        raise InputError(f"{where}: is empty; its first row must name parameters")
    try:
        check_names("parameter", names, [parameter.name for parameter in system.parameters])
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    twice = next((name for k, name in enumerate(names) if name in names[:k]), None)
    if twice is not None:
        raise InputError(f"{where}: column {twice} occurs twice")


def _checked_columns(where: str, table: Mapping[str, Any], system: System) -> Columns:
    _check_handle(where, list(table), system)
    columns: dict[str, tuple[float, ...]] = {}
    for name, values in table.items():
        listed = values.tolist() if isinstance(values, np.ndarray) and values.ndim == 1 else values
        if not isinstance(listed, Sequence) or isinstance(listed, str):
            raise InputError(f"{where}: column {name}: found {brief_repr(values)}, must be a list of numbers")
        columns[name] = _all_admitted(system.parameter(name), listed) or tuple(
            _value(f"{where}, row {row_number}, column {name}", name, value, system)
            for row_number, value in enumerate(listed, 2)
        )
    for (one, values), (other, others) in itertools.pairwise(columns.items()):
        if len(values) != len(others):
            raise InputError(f"{where}: found {len(values)} values of {one} and {len(others)} of {other}")
    if not row_count(columns):
        raise InputError(f"{where}: found 0 rows below the names, must be 1 or more")
    return columns


def _all_admitted(parameter: Parameter, values: Sequence[object]) -> tuple[float, ...]:
    """Return the values as a tuple if all are floats in the parameter's valid range; else ()."""
    floats = all_floats(values)
    return floats if np.all(parameter.admits(np.array(floats))) else ()


def _value(where: str, name: str, value: object, system: System) -> float:
    checked = number(where, value)
    try:
        return validate_in_range(system.parameter(name), checked)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
