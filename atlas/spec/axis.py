"""The axes of an atlas: each has the name of a parameter and the exact values at its points."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np

from atlas.argument_checks import is_integer
from atlas.errors import InputError, brief_repr, check_names
from workers.model.parameter import Parameter

KEYS = ("start", "stop", "num", "values", "scale", "continuation")
SCALES = ("linear", "log")
DIRECTIONS = ("forward", "backward")
MAX_POINTS = 1_000_000
"""Maximum number of points on an axis: a million already makes a store of many terabytes, so more is a typing error."""


Values = Mapping[str, tuple[float, ...]]
"""The values of axes, or of the columns of a table of points, by name."""


@dataclass(frozen=True)
class Axis:
    """An axis of a spec: a swept parameter.

    name          name of the parameter
    values        its values, strictly increasing
    scale         scale of its plots, "linear" or "log"
    continuation  "forward" (rising values) or "backward" if each cell starts from its neighbour's attractor; None for
                  independent cells
    """

    name: str
    values: tuple[float, ...]
    scale: str = "linear"
    continuation: str | None = None

    @property
    def start(self) -> float:
        """The first value."""
        return self.values[0]

    @property
    def stop(self) -> float:
        """The last value."""
        return self.values[-1]

    def __len__(self) -> int:
        return len(self.values)

    def __str__(self) -> str:
        scale = ", log" if self.scale == "log" else ""
        continued = f", continued {self.continuation}" if self.continuation else ""
        return f"{self.name} {self.start:g}..{self.stop:g} ({len(self)} values{scale}{continued})"

    def to_resolved(self) -> dict[str, Any]:
        """Return the axis as a dict for JSON, with all its values."""
        continued = {"continuation": self.continuation} if self.continuation else {}
        return {"name": self.name, "scale": self.scale, **continued, "values": list(self.values)}


def number(where: str, value: object) -> float:
    """Return a value from a spec as a float; raise InputError, naming ``where``, unless it is a finite real number."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, Real):
        raise InputError(f"{where}: found {brief_repr(value)}, must be a number")
    try:
        result = float(value) + 0.0  # -0.0 becomes 0.0: equal specs have one digest
    except OverflowError:
        raise InputError(f"{where}: found {brief_repr(value)}, must be a finite number") from None
    if not math.isfinite(result):
        raise InputError(f"{where} = {result!r}: must be a finite number")
    return result


def validate_in_range(parameter: Parameter, value: object) -> float:
    """Return the value as a float in the parameter's valid range; raise InputError with the range for other values."""
    result = number(parameter.name, value)
    if not parameter.admits(result):
        raise InputError(f"{parameter.name} = {result!r}: must satisfy {parameter.range}")
    return result


def read_axis(parameter: Parameter, value: object) -> Axis:
    """Return the axis that a spec describes as ``{start, stop, num}``, ``{values}``, or a list or an array of values.

    A table may also have a scale and a continuation.
    """
    where = f"axes.{parameter.name}"
    if isinstance(value, Axis):
        value = {"values": value.values, "scale": value.scale, "continuation": value.continuation}
    if isinstance(value, tuple):  # a tuple could mean start, stop and num
        raise InputError(
            f"{where}: found the tuple {brief_repr(value)}, "
            "must be a list of values, or a table with start, stop and num"
        )
    if isinstance(value, np.ndarray) or (isinstance(value, Sequence) and not isinstance(value, str)):
        value = {"values": value}
    if not isinstance(value, Mapping):
        raise InputError(
            f"{where}: found {brief_repr(value)}, must be a table with start, stop and num, or with values"
        )
    check_names(f"key in {where}", value, KEYS)
    scale, continuation = _checked_kind(where, value)
    values = _listed(where, value) if "values" in value else spaced_values(where, value, scale)
    if scale == "log" and values[0] <= 0:
        raise InputError(f"{where}: found {values[0]!r} on a log scale, must be > 0")
    if not np.all(parameter.admits(np.array(values))):
        for point in values:
            validate_in_range(parameter, point)
    return Axis(parameter.name, values, scale, continuation)


def _checked_kind(where: str, table: Mapping[str, Any]) -> tuple[str, str | None]:
    """Return scale and continuation of an axis from its table. Raise InputError, naming ``where``, if either is
    invalid.
    """
    scale, continuation = table.get("scale", "linear"), table.get("continuation")
    if scale not in SCALES:
        raise InputError(f"{where}.scale: found {brief_repr(scale)}, must be one of {', '.join(SCALES)}")
    if continuation is not None and continuation not in DIRECTIONS:
        raise InputError(
            f"{where}.continuation: found {brief_repr(continuation)}, must be one of {', '.join(DIRECTIONS)}"
        )
    return scale, continuation


def _validate_num(where: str, table: Mapping[str, Any]) -> int:
    """Return the number of values that an axis's table states; raise InputError unless it is an integer."""
    num = table["num"]
    if not is_integer(num):
        raise InputError(f"{where}.num: found {brief_repr(num)}, must be a whole number, 1 or more")
    return num


def _listed(where: str, table: Mapping[str, Any]) -> tuple[float, ...]:
    mixed = [key for key in ("start", "stop", "num") if key in table]
    if mixed:
        raise InputError(f"{where}: found values and {mixed[0]}; give either values, or start, stop and num")
    listed = table["values"]
    if isinstance(listed, np.ndarray) and listed.ndim == 1:
        listed = listed.tolist()
    if not isinstance(listed, Sequence) or isinstance(listed, str):
        raise InputError(f"{where}.values: found {brief_repr(listed)}, must be a list of numbers")
    check_count(f"{where}.values", len(listed))
    values = all_floats(listed) or tuple(number(f"{where}.values[{i}]", value) for i, value in enumerate(listed))
    _check_increasing(f"{where}.values", values)
    return values


def spaced_values(where: str, table: Mapping[str, Any], scale: str) -> tuple[float, ...]:
    """Return the values of an axis from a table with start, stop and num, evenly spaced on its scale.

    Raise InputError, naming ``where``, for an invalid table.
    """
    missing = [key for key in ("start", "stop", "num") if key not in table]
    if missing:
        raise InputError(f"{where}: {', '.join(missing)} missing; give start, stop and num, or values")
    num = _validate_num(where, table)
    check_count(f"{where}.num", num)
    start, stop = number(f"{where}.start", table["start"]), number(f"{where}.stop", table["stop"])
    if scale == "log" and min(start, stop) <= 0:
        raise InputError(f"{where}: found {min(start, stop)!r} on a log scale, must be > 0")
    if num > 1 and not start < stop:
        raise InputError(f"{where}: start {start!r} must be less than stop {stop!r}")
    try:
        with np.errstate(over="raise", invalid="raise"):
            points = (np.geomspace if scale == "log" else np.linspace)(start, stop, num)
    except FloatingPointError:
        raise InputError(f"{where}: from start {start!r} to stop {stop!r} is farther than a float can hold") from None
    values = tuple(points.tolist())
    _check_increasing(where, values)  # too many points between two neighbouring floats
    return values


def check_count(where: str, count: int) -> None:
    """Raise InputError, naming ``where``, if ``count`` exceeds the number of points that an axis may have."""
    if not 1 <= count <= MAX_POINTS:
        raise InputError(f"{where}: found {brief_repr(count)} points, must be 1 to {MAX_POINTS}")


def all_floats(values: Sequence[object]) -> tuple[float, ...]:
    """Return the values as a tuple if all are finite floats, else (). All are checked in one pass, since there may be
    many.
    """
    if not all(type(value) is float for value in values):
        return ()
    floats = np.array(values, dtype=np.float64) + 0.0  # -0.0 becomes 0.0: equal specs have one digest
    return tuple(floats.tolist()) if np.all(np.isfinite(floats)) else ()


def _check_increasing(where: str, values: tuple[float, ...]) -> None:
    array = np.array(values)
    if np.all(array[:-1] < array[1:]):
        return
    for before, after in itertools.pairwise(values):
        if not before < after:
            raise InputError(f"{where}: found {after!r} after {before!r}, must be strictly increasing")
