"""Check whether the segments of a law matter: solve a coarse plane, and again with twice as many segments, and compare.

A law, such as the force of a contact, that is given as an expression is replaced by straight segments.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from atlas.errors import InputError
from atlas.formatting import PrintableResult
from atlas.spec.spec import Spec
from workers import solve_tile
from workers.model.definition import Definition
from workers.model.elements import Contact, Friction, Spring
from workers.model.expression import Expression
from workers.model.laws import SEGMENTS, segments_of
from workers.model.system import System
from workers.results import INVALID, REGIME

CELLS = 12
"""Number of cells along an axis of the coarse plane."""

FINER = 4.0
"""Factor by which the bound on the segments' error is reduced; the number of segments grows as its square root."""

STEPS = "system.within"
"""Entry of the bound of smooth coefficients, which has a number of steps."""

MAX_ROWS = 20
"""Maximum number of cells of changed class that the text of a comparison lists."""

CLASS = ("regime", "period", "impacts_upper", "impacts_lower")
"""Names of the results that define the class of a cell. Cells of different classes move differently."""

_Element = TypeVar("_Element", Contact, Friction, Spring)


class FinerLaws(NamedTuple):
    """A system whose laws that are expressions have about twice as many segments as in the original system.

    record    the system
    segments  for each law, by its entry in the definition, its number of segments in the original and in this system
    """

    record: System
    segments: dict[str, tuple[int, int]]


@dataclass(frozen=True, repr=False)
class LawCheck(PrintableResult):
    """The comparison of the cells of a coarse plane by the original laws and by laws of twice as many segments.

    segments  for each law, by its entry, its number of segments at the defaults, in the original and in the finer
              system; for ``within`` of the system, the numbers of steps
    cells     number of cells of the plane
    beyond    number of cells that are invalid in either system
    changed   cells of another class: values of the axes, class in the original and in the finer system
    state     for periodic cells of the same class, the largest change of a component of the state, this change relative
              to the largest component, and the cell; None if there is no such cell
    """

    segments: dict[str, tuple[int, int]]
    cells: int
    beyond: int
    changed: list[tuple[dict[str, float], str, str]]
    state: tuple[float, float, dict[str, float]] | None

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The result of the comparison to show, as sentences."""
        lines = [
            f"{where}: {coarse} {'steps' if where == STEPS else 'segments at the defaults'}, compared with {fine}"
            for where, (coarse, fine) in self.segments.items()
        ]
        invalid = f", {self.beyond} of them invalid" if self.beyond else ""
        lines.append(f"{len(self.changed)} of {self.cells} cells change their class{invalid}")
        if self.state is not None:
            size, share, at = self.state
            lines.append(
                f"states of periodic cells change by {size:.2g} at most, {share:.2g} of their size, at {_point(at)}"
            )
        lines += [f"{_point(at)}: {coarse}, with the finer ones {fine}" for at, coarse, fine in self.changed[:MAX_ROWS]]
        if len(self.changed) > MAX_ROWS:
            lines.append(f"... and {len(self.changed) - MAX_ROWS} more; --json lists all")
        return [(line,) for line in lines]

    def as_dict(self) -> dict[str, Any]:
        """Return the check as a dict for JSON."""
        change = dict(
            zip(("state_change", "state_change_share", "state_change_at"), self.state or (None,) * 3, strict=True)
        )
        changed = [
            {"at": at, "class": coarse_class, "finer_class": finer_class}
            for at, coarse_class, finer_class in self.changed
        ]
        return {"segments": self.segments, "cells": self.cells, "invalid": self.beyond, "changed": changed, **change}


def finer(spec: Spec) -> FinerLaws:
    """Return the system of a spec with finer laws that are expressions, and finer steps of smooth coefficients.

    Each bound is a quarter of the original bound, which takes about twice as many segments. Raise InputError if there
    is no such law or coefficient, if the finer ones have too many segments or phases, or if the spec is a table of
    points.
    """
    if spec.points:
        raise InputError("points: found a table of parameter sets; --laws takes a plane, [axes.NAME]")
    system = spec.system_def
    record, within = replace(system, definition=_finer(system.definition)), system.definition.within
    segments = _segments(system, record)
    if within is not None:
        try:
            record = record.with_steps(within / FINER)
        except ValueError as error:
            raise InputError(f"a quarter of the bound: {error}") from None
        segments[STEPS] = system.definition.pieces // 2, record.definition.pieces // 2
    if not segments:
        raise InputError(f"{spec.system}: no law is an expression; a law given as a table is exact")
    for where, (_, count) in segments.items():
        if where != STEPS and count > SEGMENTS:
            raise InputError(
                f"{where}: found {count} segments within a quarter of its bound, must be at most {SEGMENTS}"
            )
    return FinerLaws(record, segments)


def check_law(spec: Spec, fine: FinerLaws, cells: int = CELLS) -> LawCheck:
    """Solve a coarse plane of a spec, ``cells`` along each axis, with its own and with finer laws, and compare the
    cells.

    Classes of cells and states of periodic cells are compared. The error of states falls as the square of the segments'
    length. The error of exponents need not fall steadily, so exponents are not compared.
    """
    lines = [
        np.unique(np.asarray(axis.values)[np.linspace(0, len(axis) - 1, cells).round().astype(int)])
        for axis in spec.axes
    ]
    grids = dict(zip((axis.name for axis in spec.axes), np.meshgrid(*lines), strict=True))
    params = {**spec.parameters, **{name: grid.ravel() for name, grid in grids.items()}}
    results, finer_results = (solve_tile(record, params, spec.settings) for record in (spec.system_def, fine.record))
    invalid = (results["regime"] == INVALID) | (finer_results["regime"] == INVALID)
    other = np.any([results[name] != finer_results[name] for name in CLASS], axis=0) & ~invalid

    def at(k: int) -> dict[str, float]:
        return {axis.name: float(params[axis.name][k]) for axis in spec.axes}

    changed = [(at(k), _named(results, k), _named(finer_results, k)) for k in np.flatnonzero(other).tolist()]
    change = np.max(np.abs(results["state"] - finer_results["state"]), axis=-1)
    change = np.where((results["period"] > 0) & ~other & ~invalid, change, np.nan)
    state = None
    if not np.all(np.isnan(change)):
        k = int(np.nanargmax(change))
        state = float(change[k]), float(change[k] / np.max(np.abs(results["state"][k]))), at(k)
    return LawCheck(fine.segments, len(other), int(np.sum(invalid)), changed, state)


def _finer(definition: Definition) -> Definition:
    return replace(
        definition,
        contacts=tuple(map(_of_quarter, definition.contacts)),
        friction=tuple(map(_of_quarter, definition.friction)),
        springs=tuple(map(_of_quarter, definition.springs)),
    )


def _of_quarter(element: _Element) -> _Element:
    """Return an element with a quarter of the bound on its segments' error, if its law is an expression; else
    unchanged.
    """
    if element.within is None:
        return element
    return replace(element, within=Expression(f"( {element.within.text} ) / {FINER}"))


def _segments(system: System, finer_system: System) -> dict[str, tuple[int, int]]:
    """Return the number of segments, in both systems, of each law that is an expression, by its entry in the
    definition.

    The numbers are those at the default parameters.
    """
    defaults = {p.name: np.array([p.default]) for p in system.parameters}
    pairs = zip(*(record.definition.laws(defaults) for record in (system, finer_system)), strict=True)
    return {
        where: (segments_of(element, table), segments_of(element, finer))
        for (where, element, (table,)), (_, _, (finer,)) in pairs
        if element.within is not None
    }


def _point(at: dict[str, float]) -> str:
    return ", ".join(f"{name} = {value:.6g}" for name, value in at.items())


def _named(arrays: dict[str, Any], k: int) -> str:
    """Return the class of cell number k as text."""
    name = REGIME.meaning(arrays[REGIME.name][k]).name
    period, *impacts = (int(arrays[key][k]) for key in CLASS[1:])
    return f"{name} {period} ({', '.join(map(str, impacts))})" if period > 0 else name


__all__ = ["CELLS", "FinerLaws", "LawCheck", "check_law", "finer"]
