"""How far cells leave the range of laws that are given as expressions, and the errors of segments and steps.

A law, such as the force of a contact, that is an expression is replaced by straight segments over a range. Coefficients
that are expressions of the phase are replaced by steps.
"""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from atlas.errors import InputError
from atlas.formatting import plural
from atlas.spec.spec import Spec
from workers.model.measures import LAW_ERROR, RANGE_SHARE
from workers.model.system import System

__all__ = ["LawUse", "check_steps", "law_lines", "law_names", "law_uses", "merged", "step_lines", "uses_of_cell"]

ROWS = 16
"""Number of rows of a table of points at which steps are checked."""

SHOWN = 1e-10
"""Error of the force, relative to the largest force, below which no digit that a terminal shows can change."""


class LawUse(NamedTuple):
    """How far some cells used a law that is an expression, and the error of its segments.

    beyond  number of cells whose motion left the range of the law
    share   largest used share of the range; above 1 beyond it
    error   largest error of the force, relative to the largest force
    """

    beyond: int
    share: float
    error: float


def law_names(system: System) -> list[str]:
    """Return the names of the results about the use of laws; empty if the system has no law that is an expression."""
    return [element.name + ending for element in system.definition.fitted for ending in (RANGE_SHARE, LAW_ERROR)]


def law_uses(system: System, results: Mapping[str, Any]) -> dict[str, LawUse]:
    """Return the use of each law, by the name of the element with the law, from results of cells by name.

    NaN and missing results are left out.
    """
    uses = {}
    for element in system.definition.fitted:
        shares, errors = (
            np.asarray(results.get(element.name + ending, ()), dtype=np.float64) for ending in (RANGE_SHARE, LAW_ERROR)
        )
        shares, errors = shares[np.isfinite(shares)], errors[np.isfinite(errors)]
        if shares.size:
            beyond, error = int(np.count_nonzero(shares > 1.0)), float(errors.max(initial=0.0))
            uses[element.name] = LawUse(beyond, float(shares.max()), error)
    return uses


def uses_of_cell(system: System, results: Mapping[str, Any]) -> dict[str, LawUse]:
    """Return the use of each law by one cell, and by all its attractors if the results list them, by the law's
    element.
    """
    uses = merged(law_uses(system, one) for one in (results, *results.get("coexisting", ())))
    return {name: use._replace(beyond=min(use.beyond, 1)) for name, use in uses.items()}


def merged(uses: Iterable[Mapping[str, LawUse]]) -> dict[str, LawUse]:
    """Return the use of each law by all cells, from the uses by disjoint groups of cells."""
    total: dict[str, LawUse] = {}
    for part in uses:
        for name, use in part.items():
            before = total.get(name, LawUse(0, 0.0, 0.0))
            total[name] = LawUse(before.beyond + use.beyond, max(before.share, use.share), max(before.error, use.error))
    return total


def law_lines(uses: Mapping[str, LawUse]) -> list[str]:
    """Return a line of text for each law that was used beyond its range, or whose error affects digits that are
    shown.
    """
    lines = []
    for name, use in uses.items():
        words = []
        if use.beyond:
            goes_on = f"beyond its range in {plural(use.beyond, 'cell')}, up to {use.share:.3g} of it"
            words.append(f"{goes_on}, where its last segment is used")
        if use.error > SHOWN:
            words.append(f"its segments are off by up to {100.0 * use.error:.2g} % of the greatest force")
        if words:
            lines.append(f"law of {name}: {'; '.join(words)}; compare a smaller bound, or atlas plan --laws")
    return lines


def step_lines(system: System) -> list[str]:
    """Return a line with the number of steps of smooth coefficients and their error; empty if there are none."""
    definition = system.definition
    if definition.within is None:
        return []
    steps, phases = definition.pieces // 2, definition.phase_count
    error, where = float(np.nanmax(system.step_errors())), "on the usual axes" if system.axes else "at the defaults"
    return [
        f"smooth coefficients: {steps} steps, {phases} phases; off by {error:.2g} {where}, bound {definition.within:g}"
    ]


def check_steps(spec: Spec) -> None:
    """Raise InputError if the steps of smooth coefficients exceed their bound at ends or middles of a spec's axes.

    Of a table of points some rows are checked.
    """
    system, within = spec.system_def, spec.system_def.definition.within
    if within is None:
        return
    lines = {axis.name: np.unique(np.asarray(axis.values)[[0, len(axis) // 2, -1]]) for axis in spec.axes}
    grids = dict(zip(lines, map(np.ravel, np.meshgrid(*lines.values())), strict=True))
    for name, column in spec.points.items():
        grids[name] = np.asarray(column)[np.linspace(0, len(column) - 1, ROWS).round().astype(int)]
    count = len(next(iter(grids.values())))
    values = {name: np.full(count, number, dtype=np.float64) for name, number in spec.parameters.items()}
    errors = system.step_errors(values | grids)
    k = int(np.argmax(np.where(np.isfinite(errors), errors, 0.0)))
    if errors[k] > within:
        at = ", ".join(f"{name} = {column[k]:.6g}" for name, column in grids.items())
        raise InputError(
            f"system.within: found {within:g}, but {system.definition.pieces // 2} steps are off by {errors[k]:.2g} at "
            f"{at}; widen the usual axes of the system, system.axes, to these cells, or give more steps"
        )
