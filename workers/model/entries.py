"""Checks of the entries of a table: each error is one line with the entry, the value and the valid form."""

import math
import re
from collections.abc import Collection, Mapping
from numbers import Real
from reprlib import Repr
from typing import Any

from workers.model.expression import RESERVED, Expression, ExpressionError, parse
from workers.model.parameter import unknown_name

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}", re.ASCII)
_short = Repr()
_short.maxstring = _short.maxlong = _short.maxother = 60


class DefinitionError(ValueError):
    """The fault of a definition, in one line: the entry, the value found, the valid form."""


def read_entries(where: str, given: object, known: Collection[str], *shape: int) -> Any:
    """The expression that a number or a text is; of a list of that shape a row or a matrix of them."""
    if shape:
        entries = read_list(where, given, shape[0], "rows" if len(shape) > 1 else "entries")
        return tuple(read_entries(f"{where}[{i}]", entry, known, *shape[1:]) for i, entry in enumerate(entries))
    if isinstance(given, str):
        try:
            return parse(given, known)
        except ExpressionError as error:
            raise DefinitionError(f"{where}: {error}") from None
    return Expression(repr(read_number(where, given, "must be a number or an expression in quotes")))


def read_text(where: str, value: object) -> str:
    """A text; DefinitionError for anything else."""
    if not isinstance(value, str) or len(value) > 5000:
        raise fault(where, value, "must be text in quotes")
    return value


def read_words(where: str, value: object) -> str:
    """Words on one line that can stand beside a formula."""
    found = read_text(where, value)
    if not found.isprintable() or "$" in found or len(found) > 200:
        raise fault(where, value, "must be one line of at most 200 characters without a dollar")
    return found


def read_flag(where: str, given: object) -> bool:
    """True or false; DefinitionError for anything else."""
    if not isinstance(given, bool):
        raise fault(where, given, "must be true or false")
    return given


def read_number(where: str, given: object, right: str = "must be a number", infinite: bool = False) -> float:
    """The value as a float."""
    if isinstance(given, bool) or not isinstance(given, Real):
        raise fault(where, given, right)
    try:
        number = float(given) + 0.0  # -0.0 becomes 0.0: equal definitions have one digest
    except OverflowError:
        raise fault(where, given, "must be a finite number") from None
    if math.isnan(number) or (math.isinf(number) and not infinite):
        raise DefinitionError(f"{where}: found {number!r}, must be a finite number")
    return number


def read_table(where: str, given: object, keys: Collection[str] = ()) -> Mapping[str, Any]:
    """The value, a table that has these keys at most, or any; DefinitionError for anything else."""
    if not isinstance(given, Mapping) or not all(isinstance(key, str) for key in given):
        raise fault(where, given, "must be a table")
    for key in given:
        if keys and key not in keys:
            raise DefinitionError(unknown_name(f"key in {where}", key, keys))
    return given


def read_tables(where: str, given: object) -> dict[str, object]:
    """The tables [[where]] of a list, each under the name that errors give it."""
    if not isinstance(given, list):
        raise fault(where, given, f"must be tables [[{where}]]")
    return {f"{where}[{i}]": one for i, one in enumerate(given)}


def read_list(
    where: str, given: object, length: int, what: str = "entries", each: str = ", one per coordinate"
) -> list[Any]:
    """The value, a list of that length; DefinitionError for anything else."""
    if not isinstance(given, list | tuple):
        raise fault(where, given, f"must be a list of {length} {what}{each}")
    if len(given) != length:
        raise DefinitionError(f"{where}: found {len(given)} {what}, must be {length}{each}")
    return list(given)


def read_names(where: str, given: object) -> tuple[str, ...]:
    """The value, a list of names."""
    if not isinstance(given, list | tuple):
        raise fault(where, given, "must be a list of names")
    for i, name in enumerate(given):
        check_name(f"{where}[{i}]", name)
    return tuple(given)


def check_name(where: str, name: object) -> None:
    """DefinitionError for what is no name, or one that expressions have for their own."""
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise fault(where, name, "must be a name of letters, digits and underscores, 40 at most")
    if name in RESERVED:
        raise taken(where, name)


def taken(where: str, name: str) -> DefinitionError:
    """The error of a name that means something else."""
    return DefinitionError(f"{where}: {name!r} has another meaning already; choose another name")


def fault(where: str, value: object, right: str) -> DefinitionError:
    """The error of an entry: the value found, and the valid form."""
    try:
        shown = _short.repr(value)
    except ValueError:  # a whole number of more digits than Python writes
        shown = "a whole number of thousands of digits"
    return DefinitionError(f"{where}: found {shown}, {right}")
