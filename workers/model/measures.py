"""Measures of a machine and results of its elements, in addition to the results that every machine has."""

import math
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from workers.model.elements import Contact, Friction, Spring
from workers.model.entries import DefinitionError, check_name, fault, name_taken, read_entries, read_table
from workers.model.expression import Expression, Row
from workers.results import PER_PERIOD, Variable, count_of_orbit

MEASURES = 8
"""Maximum number of measures of a machine."""

ORDERS = ("displacement", "velocity", "acceleration")
"""Keys of a measure, by the derivative of the displacements of which it is a weighted sum."""

REPORTS = {
    "mean": "mean", "rms": "root mean square", "peak": "greatest modulus", "power": "mean power",
}  # fmt: skip
"""Reports of a measure, in words."""

KEYS = (*ORDERS, "weight", "report")

RANGE_SHARE, LAW_ERROR = "_range_share", "_law_error"
"""Endings of the names of results of a law that is an expression, see ``law_variables``."""


@dataclass(frozen=True)
class OutputMeasure:
    """An output row . x, row . x' or row . x'' that is measured, and the numbers to report; row weights coordinates.

    displacement, velocity, acceleration  the row, on x, x' or x''; the other two are None
    weight                                factor of the power, None without that report
    report                                "mean", "rms" (root mean square), "peak" (greatest modulus) or "power"
                                          (``weight`` times the mean square)
    """

    displacement: Row | None = None
    velocity: Row | None = None
    acceleration: Row | None = None
    weight: Expression | None = None
    report: tuple[str, ...] = ()

    @property
    def kind(self) -> str:
        """The derivative of the displacements of which the output is a weighted sum, one of ORDERS."""
        return next(key for key in ORDERS if getattr(self, key) is not None)

    @property
    def row(self) -> Row:
        """Weights of the coordinates in the output."""
        row: Row = getattr(self, self.kind)
        return row


Measures = tuple[tuple[str, OutputMeasure], ...]


def read_measures(value: object, known: Collection[str], n: int) -> Measures:
    """Return pairs (name, measure) from the entry ``measures`` of a table [system] of n coordinates.

    ``known`` are the names that expressions may use.
    """
    tables = read_table("system.measures", value)
    if len(tables) > MEASURES:
        raise DefinitionError(f"system.measures: found {len(tables)}, must be at most {MEASURES}")
    for name in tables:
        check_name(f"system.measures.{name}", name)
    return tuple((name, _read_measure(f"system.measures.{name}", one, known, n)) for name, one in tables.items())


def _read_measure(where: str, value: object, known: Collection[str], n: int) -> OutputMeasure:
    table = read_table(where, value, KEYS)
    rows = [key for key in ORDERS if key in table]
    if len(rows) != 1:
        names = " and ".join(rows) or "none"
        raise DefinitionError(f"{where}: found {names}, must be one row: {', '.join(ORDERS[:-1])} or {ORDERS[-1]}")
    report = _read_report(f"{where}.report", table.get("report"))
    if ("power" in report) != ("weight" in table):
        raise DefinitionError(f"{where}: weight and the report 'power' go together; power is weight times mean square")
    row = read_entries(f"{where}.{rows[0]}", table[rows[0]], known, n)
    weight = read_entries(f"{where}.weight", table["weight"], known) if "weight" in table else None
    return OutputMeasure(**{rows[0]: row}, weight=weight, report=report)


def _read_report(where: str, value: Any) -> tuple[str, ...]:
    known = isinstance(value, list | tuple) and all(isinstance(report, str) and report in REPORTS for report in value)
    if not known or not value or len(set(value)) < len(value):
        raise fault(where, value, f"must be a list of some of {', '.join(REPORTS)}, each once")
    return tuple(value)


def measure_variables(measures: Measures) -> Iterator[tuple[str, Variable]]:
    """Yield (entry, variable) for each number that is reported of a measured output.

    The variables are NAME_mean, NAME_rms, NAME_peak and NAME_power, as far as the definition asks for them. The entry
    is the key of the definition, for error messages.
    """
    for name, measure in measures:
        for report in measure.report:
            yield f"system.measures.{name}", _number(f"{name}_{report}", f"{REPORTS[report]} of {measure.kind} {name}")


def element_variables(contacts: Iterable[Contact], frictions: Iterable[Friction]) -> Iterator[tuple[str, Variable]]:
    """Yield (entry, variable) for each result of a contact or friction; variables begin with the element's name.

    The entry is the key of the definition, for error messages.
    """
    for k, contact in enumerate(contacts):
        where, name, of = f"system.contacts[{k}].name", contact.name, f"contact {contact.name}"
        for side in ("upper", "lower"):
            if getattr(contact, side) is not None:
                words = f"contacts at the {side} stop of {of} per orbit period; -1 where it comes to rest by chatter"
                yield where, count_of_orbit(f"{name}_{side}", words)
        yield where, _number(f"{name}_fraction", f"share of the time in {of}")
        yield where, _loss(name, of)
        if not contact.rigid:
            yield where, _number(f"{name}_penetration", f"greatest depth of {of}")
            yield where, _number(f"{name}_force", f"greatest force of {of}")
    for k, friction in enumerate(frictions):
        where, name, of = f"system.friction[{k}].name", friction.name, f"friction {friction.name}"
        yield where, _number(f"{name}_stuck", f"share of the time that {of} sticks")
        yield where, _loss(name, of)
    yield "system.damping", _loss("damper", "the dampers of the machine itself")


def law_variables(elements: Iterable[Contact | Friction | Spring]) -> Iterator[tuple[str, Variable]]:
    """Yield (entry, variable) for results that say if a law given as an expression was used within its range.

    They are the largest argument, that argument as a share of the range, and the error bound. The variables begin with
    the names of the elements. The largest argument of a contact's law is its penetration.
    """
    for element in elements:
        name, where, of = element.name, f"law of {element.name}", f"the law of {element.name}"
        if isinstance(element, Friction):
            yield where, _number(f"{name}_speed", f"greatest sliding speed in {of}")
        if isinstance(element, Spring):
            yield where, _number(f"{name}_reach", f"greatest argument of {of}, of either sign")
        yield where, _number(f"{name}{RANGE_SHARE}", f"greatest argument of {of} as a share of its range")
        yield where, _number(f"{name}{LAW_ERROR}", f"error bound of {of} as a share of the greatest force that it gave")


def check_unambiguous(variables: Iterable[tuple[str, Variable]], known: Collection[str]) -> None:
    """Raise DefinitionError at the first variable named like one of the ``known`` names or like an earlier variable."""
    taken_names = set(known)
    for where, variable in variables:
        if variable.name in taken_names:
            raise name_taken(where, variable.name)
        taken_names.add(variable.name)


def _number(name: str, long_name: str) -> Variable:
    return Variable(name, "float64", math.nan, long_name, "1")


def _loss(name: str, of: str) -> Variable:
    return _number(f"{name}_loss", f"energy lost in {of} {PER_PERIOD}")
