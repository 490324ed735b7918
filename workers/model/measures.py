"""Measures of a machine and results of its elements, besides the results of every machine."""

import math
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from workers.model.elements import Contact, Friction
from workers.model.entries import DefinitionError, check_name, fault, read_entries, read_table, taken
from workers.model.expression import Expression, Row
from workers.results import PER_PERIOD, Variable, count_of_orbit

MEASURES = 8
"""Measures of a machine."""

ORDERS = ("displacement", "velocity", "acceleration")
"""What a measure may be a row on: derivatives of the displacements."""

REPORTS = {
    "mean": "mean", "rms": "root mean square", "peak": "greatest modulus", "power": "mean power",
}  # fmt: skip
"""What a measure may report, in words."""

KEYS = (*ORDERS, "weight", "report")


@dataclass(frozen=True)
class OutputMeasure:
    """An output, row . x, row . x' or row . x'', whichever row it has, and what is reported of it.

    The mean, the root mean square, the greatest modulus; the power is ``weight`` times the mean square.
    """

    displacement: Row | None = None
    velocity: Row | None = None
    acceleration: Row | None = None
    weight: Expression | None = None
    report: tuple[str, ...] = ()

    @property
    def kind(self) -> str:
        """Which of ORDERS it is a row on."""
        return next(key for key in ORDERS if getattr(self, key) is not None)

    @property
    def row(self) -> Row:
        """Its row."""
        found: Row = getattr(self, self.kind)
        return found


Measures = tuple[tuple[str, OutputMeasure], ...]


def read_measures(given: object, known: Collection[str], n: int) -> Measures:
    """The measures in a table [system] of n coordinates, by their names."""
    tables = read_table("system.measures", given)
    if len(tables) > MEASURES:
        raise DefinitionError(f"system.measures: found {len(tables)}, must be at most {MEASURES}")
    for name in tables:
        check_name(f"system.measures.{name}", name)
    return tuple((name, _read_measure(f"system.measures.{name}", one, known, n)) for name, one in tables.items())


def _read_measure(where: str, given: object, known: Collection[str], n: int) -> OutputMeasure:
    table = read_table(where, given, KEYS)
    rows = [key for key in ORDERS if key in table]
    if len(rows) != 1:
        found = " and ".join(rows) or "none"
        raise DefinitionError(f"{where}: found {found}, must be one row: {', '.join(ORDERS[:-1])} or {ORDERS[-1]}")
    report = _read_report(f"{where}.report", table.get("report"))
    if ("power" in report) != ("weight" in table):
        raise DefinitionError(f"{where}: weight and the report 'power' go together; power is weight times mean square")
    row = read_entries(f"{where}.{rows[0]}", table[rows[0]], known, n)
    weight = read_entries(f"{where}.weight", table["weight"], known) if "weight" in table else None
    return OutputMeasure(**{rows[0]: row}, weight=weight, report=report)


def _read_report(where: str, given: Any) -> tuple[str, ...]:
    known = isinstance(given, list | tuple) and all(isinstance(each, str) and each in REPORTS for each in given)
    if not known or not given or len(set(given)) < len(given):
        raise fault(where, given, f"must be a list of some of {', '.join(REPORTS)}, each once")
    return tuple(given)


def measure_variables(measures: Measures) -> Iterator[tuple[str, Variable]]:
    """What measures report, as variables NAME_mean, NAME_rms, NAME_peak and NAME_power, each with its entry."""
    for name, measure in measures:
        for report in measure.report:
            yield f"system.measures.{name}", _number(f"{name}_{report}", f"{REPORTS[report]} of {measure.kind} {name}")


def element_variables(contacts: Iterable[Contact], frictions: Iterable[Friction]) -> Iterator[tuple[str, Variable]]:
    """What contacts and friction show, as variables that begin with their names, each with its entry."""
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


def refuse_ambiguous(variables: Iterable[tuple[str, Variable]], known: Collection[str]) -> None:
    """DefinitionError at the first variable whose name is among those ``known``, or of another one before it."""
    seen = set(known)
    for where, variable in variables:
        if variable.name in seen:
            raise taken(where, variable.name)
        seen.add(variable.name)


def _number(name: str, long_name: str) -> Variable:
    return Variable(name, "float64", math.nan, long_name, "1")


def _loss(name: str, of: str) -> Variable:
    return _number(f"{name}_loss", f"energy lost in {of} {PER_PERIOD}")
