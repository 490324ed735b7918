"""How far cells leave the range of laws that are given as expressions, and the error of these laws' segments.

A law, such as the force of a contact, that is an expression is replaced by straight segments over a range.
"""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from atlas.formatting import plural
from workers.model.measures import LAW_ERROR, RANGE_SHARE
from workers.model.system import System

__all__ = ["LawUse", "law_lines", "law_names", "law_uses", "merged", "uses_of_cell"]

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
