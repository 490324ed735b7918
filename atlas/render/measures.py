"""Numbers and lengths as they are given for a picture: checked, and lengths in inches."""

import math
import re

from atlas.errors import InputError, shown

_INCHES = {"mm": 1.0 / 25.4, "cm": 1.0 / 2.54, "in": 1.0}
_LENGTHS = (0.8, 60.0)
"""Least and greatest length of a page in inches."""


def length(name: str, value: float | str | None) -> float | None:
    """A length in inches from a number of them or from a text with its unit, such as "85mm"; InputError otherwise."""
    if value is None:
        return None
    wrong = InputError(f"{name}: found {shown(value)}, must be a length such as 85mm, 8.5cm or 3.35in")
    if isinstance(value, str):
        match = re.fullmatch(r"\s*([0-9.eE+-]+)\s*(mm|cm|in)\s*", value)
        if not match:
            raise wrong
        try:
            value = float(match[1]) * _INCHES[match[2]]
        except ValueError:
            raise wrong from None
    inches = number(name, value) or 0.0
    low, high = _LENGTHS
    if not low <= inches <= high:
        raise InputError(
            f"{name}: found {inches:.3g} inches, must be {low:g} to {high:g} inches ({25.4 * low:.0f}mm to "
            f"{25.4 * high:.0f}mm)"
        )
    return inches


def positive(name: str, value: float | None) -> float | None:
    """A positive number, or None; InputError otherwise."""
    found = number(name, value)
    if found is not None and not 0.0 < found <= 1e4:
        raise InputError(f"{name}: found {found:g}, must be positive and at most 10000")
    return found


def number(name: str, value: float | None) -> float | None:
    """A finite number, or None; InputError otherwise."""
    if value is None:
        return None
    try:
        found = float(value)
    except (TypeError, ValueError):
        found = math.nan
    if not math.isfinite(found):
        raise InputError(f"{name}: found {shown(value)}, must be a number")
    return found
