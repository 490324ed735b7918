"""Conversion of tables to laws of springs, contacts and friction, see laws.py, with every error in one line."""

from collections.abc import Collection, Mapping
from typing import Any

from workers.model.elements import LAW, Spring
from workers.model.entries import DefinitionError, check_name, fault, read_entries, read_list, read_table, read_text
from workers.model.laws import ARGUMENTS, SEGMENTS

SPRING_KEYS = ("name", "row", *LAW)


def read_law_back(where: str, table: Mapping[str, Any], law: Mapping[str, Any], known: Collection[str]) -> Any:
    """Return the table of friction for v < 0, beside the entries LAW of its ``law``; None if there is none."""
    if "law_back" not in table:
        return None
    if not isinstance(law.get("law"), tuple):
        raise DefinitionError(f"{where}.law_back: found without a table in law; give law as a table too")
    return _read_rows(f"{where}.law_back", table["law_back"], known, "v", "")


def read_law(where: str, table: Mapping[str, Any], known: Collection[str], kind: type) -> dict[str, Any]:
    """Return the force law in an element's table, with the error bound and range of an expression, by the keys LAW.

    where  name of the table in error messages
    table  the table, with the key ``law``
    known  names that expressions may use
    kind   class of the element: Contact, Friction or Spring
    """
    law, argument = table["law"], ARGUMENTS[kind]
    if isinstance(law, str):
        if argument in known:
            raise DefinitionError(
                f"{where}.law: {argument} is the argument of the law and a parameter; rename the parameter"
            )
        for key, meaning in (
            ("within", "largest error, as a share of the largest force"),
            ("range", "largest argument"),
        ):
            if key not in table:
                raise DefinitionError(f"{where}: {key} missing; a law that is an expression needs its {meaning}")
        ends = (2,) if kind is Spring and isinstance(table["range"], list | tuple) else ()
        return {
            "law": read_entries(f"{where}.law", law, [*known, argument]),
            "within": read_entries(f"{where}.within", table["within"], known),
            "range": read_entries(f"{where}.range", table["range"], known, *ends),
        }
    for key in (key for key in LAW[1:] if key in table):
        raise DefinitionError(f"{where}.{key}: found beside a table, which is exact; only an expression takes this key")
    return {"law": _read_rows(f"{where}.law", law, known, argument, f", or an expression of {argument}")}


def _read_rows(where: str, law: Any, known: Collection[str], argument: str, other: str) -> Any:
    """Return the rows [argument, force] of a law; ``other`` ends the error for no table."""
    if not isinstance(law, list | tuple) or not 2 <= len(law) <= SEGMENTS + 1:
        description = f"{len(law)} rows" if isinstance(law, list | tuple) else law
        raise fault(where, description, f"must be 2 to {SEGMENTS + 1} rows [{argument}, force]{other}")
    ending = f", {argument} and the force"
    rows = [read_list(f"{where}[{i}]", row, 2, "numbers", ending) for i, row in enumerate(law)]
    return read_entries(where, rows, known, len(rows), 2)


def read_spring(where: str, value: object, known: Collection[str], n: int) -> Spring:
    """Return the spring that a table describes, for a machine of n coordinates.

    where  name of the table in error messages
    value  the table
    known  names that expressions may use
    """
    one = read_table(where, value, SPRING_KEYS)
    for key in ("name", "row", "law"):
        if key not in one:
            raise DefinitionError(f"{where}: {key} missing; a spring has a name, a row and a law of y = row . x")
    check_name(f"{where}.name", one["name"])
    row = read_entries(f"{where}.row", one["row"], known, n)
    return Spring(read_text(f"{where}.name", one["name"]), row, **read_law(where, one, known, Spring))
