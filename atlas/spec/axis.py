"""An axis of the parameter plane: a name and the exact values at its points."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np

from atlas.errors import InputError, check_names, shown
from workers.model.parameter import Parameter

KEYS = ("start", "stop", "num", "values", "scale", "continuation")
SCALES = ("linear", "log")
DIRECTIONS = ("forward", "backward")
MAX_POINTS = 1_000_000
"""Points on one axis: a million already makes a store of many terabytes, so that more is a slip of the pen."""


@dataclass(frozen=True)
class Axis:
    """A swept parameter: its name, its strictly increasing values, and the scale it is drawn on.

    ``continuation`` is "forward" (rising values) or "backward" where each cell starts from its neighbour's attractor,
    and None where cells are independent.
    """

    name: str
    values: tuple[float, ...]
    scale: str = "linear"
    continuation: str | None = None

    def __len__(self) -> int:
        return len(self.values)

    def __str__(self) -> str:
        scale = ", log" if self.scale == "log" else ""
        continued = f", continued {self.continuation}" if self.continuation else ""
        return f"{self.name} {self.values[0]:g}..{self.values[-1]:g} ({len(self)} values{scale}{continued})"


def number(where: str, value: object) -> float:
    """The value as a float; InputError where it is not a finite real number. ``where`` names it in the message."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, Real):
        raise InputError(f"{where}: found {shown(value)}, must be a number")
    try:
        result = float(value) + 0.0  # -0.0 becomes 0.0: equal specs have one digest
    except OverflowError:
        raise InputError(f"{where}: found {shown(value)}, must be a finite number") from None
    if not math.isfinite(result):
        raise InputError(f"{where} = {result!r}: must be a finite number")
    return result


def admitted(parameter: Parameter, value: object) -> float:
    """The value as a float inside the parameter's valid range; InputError with the range otherwise."""
    result = number(parameter.name, value)
    if not parameter.admits(result):
        raise InputError(f"{parameter.name} = {result!r}: must satisfy {parameter.range}")
    return result


def read_axis(parameter: Parameter, given: object) -> Axis:
    """An Axis from ``{start, stop, num}``, ``{values}`` or a sequence of values.

    A table may also have a scale and a continuation.
    """
    where = f"axes.{parameter.name}"
    if isinstance(given, Axis):
        given = {"values": given.values, "scale": given.scale, "continuation": given.continuation}
    if isinstance(given, np.ndarray) or (isinstance(given, Sequence) and not isinstance(given, str)):
        given = {"values": given}
    if not isinstance(given, Mapping):
        raise InputError(f"{where}: found {shown(given)}, must be a table with start, stop and num, or with values")
    check_names(f"key in {where}", given, KEYS)
    scale = given.get("scale", "linear")
    if scale not in SCALES:
        raise InputError(f"{where}.scale: found {shown(scale)}, must be one of {', '.join(SCALES)}")
    continuation = given.get("continuation")
    if continuation is not None and continuation not in DIRECTIONS:
        raise InputError(f"{where}.continuation: found {shown(continuation)}, must be one of {', '.join(DIRECTIONS)}")
    values = _listed(where, given) if "values" in given else _spaced(where, given, scale)
    if scale == "log" and values[0] <= 0:
        raise InputError(f"{where}: found {values[0]!r} on a log scale, must be > 0")
    for value in values:
        admitted(parameter, value)
    return Axis(parameter.name, values, scale, continuation)


def _listed(where: str, given: Mapping[str, Any]) -> tuple[float, ...]:
    mixed = [key for key in ("start", "stop", "num") if key in given]
    if mixed:
        raise InputError(f"{where}: found values and {mixed[0]}; give either values, or start, stop and num")
    listed = given["values"]
    if isinstance(listed, np.ndarray) and listed.ndim == 1:
        listed = listed.tolist()
    if not isinstance(listed, Sequence) or isinstance(listed, str):
        raise InputError(f"{where}.values: found {shown(listed)}, must be a list of numbers")
    check_count(f"{where}.values", len(listed))
    values = tuple(number(f"{where}.values[{i}]", value) for i, value in enumerate(listed))
    _check_increasing(f"{where}.values", values)
    return values


def _spaced(where: str, given: Mapping[str, Any], scale: str) -> tuple[float, ...]:
    missing = [key for key in ("start", "stop", "num") if key not in given]
    if missing:
        raise InputError(f"{where}: {', '.join(missing)} missing; give start, stop and num, or values")
    num = given["num"]
    if isinstance(num, bool) or not isinstance(num, int):
        raise InputError(f"{where}.num: found {shown(num)}, must be a whole number, 1 or more")
    check_count(f"{where}.num", num)
    start, stop = number(f"{where}.start", given["start"]), number(f"{where}.stop", given["stop"])
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
    """Raise InputError unless an axis may have so many points; ``where`` names it in the message."""
    if not 1 <= count <= MAX_POINTS:
        raise InputError(f"{where}: found {shown(count)} points, must be 1 to {MAX_POINTS}")


def _check_increasing(where: str, values: tuple[float, ...]) -> None:
    for before, after in itertools.pairwise(values):
        if not before < after:
            raise InputError(f"{where}: found {after!r} after {before!r}, must be strictly increasing")
