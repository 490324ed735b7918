"""Checks of the entries of a table; each error is one line with the entry, the value and the valid form."""

import math
import re
from collections.abc import Collection, Mapping
from numbers import Real
from reprlib import Repr
from typing import Any

import numpy as np

from workers.model.expression import RESERVED, Expression, ExpressionError, parse
from workers.model.parameter import OMEGA, unknown_name

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}", re.ASCII)
_short = Repr()
_short.maxstring = _short.maxlong = _short.maxother = 60


class DefinitionError(ValueError):
    """Error of a definition, in one line: the entry, the value found, the valid form."""


def read_entries(where: str, value: object, known: Collection[str], *shape: int) -> Any:
    """Return the expression of an entry, a number or a text; for an entry of lists, a row or matrix of expressions.

    where  name of the entry in error messages
    value  the entry
    known  names that expressions may use
    shape  number of rows and columns, empty for a single expression
    """
    if shape:
        entries = read_list(where, value, shape[0], "rows" if len(shape) > 1 else "entries")
        return tuple(read_entries(f"{where}[{i}]", entry, known, *shape[1:]) for i, entry in enumerate(entries))
    if isinstance(value, str):
        try:
            return parse(value, known)
        except ExpressionError as error:
            raise DefinitionError(f"{where}: {error}") from None
    return Expression(repr(read_number(where, value, "must be a number or an expression in quotes")))


def read_text(where: str, value: object) -> str:
    """Return the value, a text; raise DefinitionError for any other value."""
    if not isinstance(value, str) or len(value) > 5000:
        raise fault(where, value, "must be text in quotes")
    return value


def read_words(where: str, value: object) -> str:
    """Return the value, printable words on one line that can stand beside a formula; else raise DefinitionError."""
    text = read_text(where, value)
    if not text.isprintable() or "$" in text or len(text) > 200:
        raise fault(where, value, "must be one line of at most 200 characters without a dollar")
    return text


def read_flag(where: str, value: object) -> bool:
    """Return the value, true or false; raise DefinitionError for any other value."""
    if not isinstance(value, bool):
        raise fault(where, value, "must be true or false")
    return value


def read_number(where: str, value: object, valid_form: str = "must be a number", infinite: bool = False) -> float:
    """Return the value as a float.

    where       name of the entry in error messages
    value       the entry
    valid_form  end of the error message
    infinite    True if the number may be infinite
    """
    if isinstance(value, bool) or not isinstance(value, Real):
        raise fault(where, value, valid_form)
    try:
        number = float(value) + 0.0  # -0.0 becomes 0.0: equal definitions have one digest
    except OverflowError:
        raise fault(where, value, "must be a finite number") from None
    if math.isnan(number) or (math.isinf(number) and not infinite):
        raise DefinitionError(f"{where}: found {number!r}, must be a finite number")
    return number


def read_constant(where: str, value: object, infinite: bool = False) -> float:
    """Return the value, a number or an expression of numbers such as "2*pi", as a float, see ``read_number``."""
    if isinstance(value, str):
        with np.errstate(all="ignore"):
            value = float(read_entries(where, value, ())({OMEGA: np.zeros(1)})[0])
    return read_number(where, value, "must be a number or an expression in quotes", infinite)


def read_table(where: str, value: object, keys: Collection[str] = ()) -> Mapping[str, Any]:
    """Return the value, a table; raise DefinitionError for any other value, or for a key that is not among ``keys``.

    An empty ``keys`` admits all keys.
    """
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise fault(where, value, "must be a table")
    for key in value:
        if keys and key not in keys:
            raise DefinitionError(unknown_name(f"key in {where}", key, keys))
    return value


def read_tables(where: str, value: object) -> dict[str, object]:
    """Return the tables of a list [[where]], each under the name that error messages give it, such as ``where[0]``."""
    if not isinstance(value, list):
        raise fault(where, value, f"must be tables [[{where}]]")
    return {f"{where}[{i}]": one for i, one in enumerate(value)}


def read_list(
    where: str, value: object, length: int, what: str = "entries", ending: str = ", one per coordinate"
) -> list[Any]:
    """Return the value, a list of this length; raise DefinitionError for any other value."""
    if not isinstance(value, list | tuple):
        raise fault(where, value, f"must be a list of {length} {what}{ending}")
    if len(value) != length:
        raise DefinitionError(f"{where}: found {len(value)} {what}, must be {length}{ending}")
    return list(value)


def read_names(where: str, value: object) -> tuple[str, ...]:
    """Return the value, a list of names, as a tuple; raise DefinitionError for any other value or an invalid name."""
    if not isinstance(value, list | tuple):
        raise fault(where, value, "must be a list of names")
    for i, name in enumerate(value):
        check_name(f"{where}[{i}]", name)
    return tuple(value)


def check_name(where: str, name: object) -> None:
    """Raise DefinitionError if a name is invalid, or reserved by expressions."""
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise fault(where, name, "must be a name of letters, digits and underscores, 40 at most")
    if name in RESERVED:
        raise name_taken(where, name)


def name_taken(where: str, name: str) -> DefinitionError:
    """Return the error for a name that already has another meaning."""
    return DefinitionError(f"{where}: {name!r} has another meaning already; choose another name")


def fault(where: str, value: object, valid_form: str) -> DefinitionError:
    """Return the error for an entry, with the value found and the valid form."""
    try:
        text = _short.repr(value)
    except ValueError:  # an integer with more digits than Python writes
        text = "a whole number of thousands of digits"
    return DefinitionError(f"{where}: found {text}, {valid_form}")
