"""Checks of the arguments of public functions; an InputError of one line names argument, value and valid form."""

import math
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from numbers import Integral, Real
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from atlas.errors import InputError, brief_repr

T = TypeVar("T")
Window = Mapping[str, tuple[float, float]]
"""Limits of the axes of a plane: (low, high) by axis name; other axes are unlimited."""


def is_integer(value: object, kind: type = int) -> bool:
    """Return True if ``value`` is an integer of type ``kind``, such as int or numbers.Integral, and no boolean."""
    return isinstance(value, kind) and not isinstance(value, bool)


def validate_interval(name: str, value: object) -> tuple[float, float]:
    """Return an argument that must be a pair (low, high) as two floats, which may be infinite and in any order.

    Raise InputError for any other value.
    """
    ends = _items(value)
    if len(ends) == 2 and all(isinstance(end, Real) and not isinstance(end, bool) for end in ends):
        with suppress(OverflowError):
            low, high = map(float, ends)
            if not math.isnan(low + high) or low == -high:
                return low, high
    raise InputError(f"{name}: found {brief_repr(value)}, must be two numbers, (low, high)")


def validate_window(value: object) -> Window:
    """Check an argument with limits of axes, by axis name, and return it with the limits as floats; empty if it is
    None.

    The names of the axes are not checked.
    """
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise InputError(f"window: found {brief_repr(value)}, must be (low, high) by axis, such as {{'omega': (2, 3)}}")
    return {name: validate_interval(f"window of {name}", ends) for name, ends in value.items() if ends is not None}


def validate_pixels(value: object) -> tuple[int, int] | None:
    """Return an argument with the size of a plot in pixels as integers (x, y); None if ``value`` is None."""
    sizes = _items(value)
    if value is None:
        return None
    if len(sizes) != 2 or not all(is_integer(n, Integral) and int(n) >= 1 for n in sizes):
        raise InputError(f"pixels: found {brief_repr(value)}, must be two whole numbers, (x, y), 1 or more")
    x, y = (int(size) for size in sizes)
    return x, y


def validate_path(value: object, name: str = "path") -> Path:
    """Return an argument as a path on this host; a ``~`` at the beginning is replaced by the user's home."""
    if isinstance(value, str | os.PathLike) and isinstance(os.fspath(value), str):
        return Path(os.path.expanduser(value))
    raise InputError(f"{name}: found {brief_repr(value)}, must be a path")


def check_name(name: str, value: object) -> None:
    """Raise InputError, naming the argument ``name``, unless ``value`` is a string."""
    validate_type(name, value, str, "a name")


def validate_flag(name: str, value: object) -> bool:
    """Return the argument ``name`` as a bool. Raise InputError for any value but True and False."""
    return bool(validate_type(name, value, bool | np.bool_, "True or False"))


def validate_type(name: str, value: T, kind: Any, valid_form: str) -> T:
    """Return ``value`` if it is an instance of ``kind``, a type or a union of types.

    Else raise InputError with the text ``valid_form``.
    """
    if not isinstance(value, kind):
        raise InputError(f"{name}: found {brief_repr(value)}, must be {valid_form}")
    return value


def validate_atlas(value: object, name: str = "atlas") -> Any:
    """Return ``value`` if it is an xarray dataset; else raise InputError."""
    if not all(hasattr(value, part) for part in ("dims", "coords", "data_vars")):
        raise InputError(f"{name}: found {brief_repr(value)}, must be an atlas as atlas.open returns it")
    return value


def _items(value: object) -> tuple[Any, ...]:
    """Return the items of a sequence or one-dimensional array; empty for text and for any other value."""
    is_sequence = isinstance(value, Sequence) or getattr(value, "ndim", 0) == 1
    return tuple(value) if is_sequence and not isinstance(value, str | bytes) else ()  # type: ignore[arg-type]
