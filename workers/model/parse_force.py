"""Conversion of the force in a table [system] to harmonics, with every error in one line."""

import re
from collections.abc import Collection, Mapping
from fractions import Fraction
from typing import Any

from workers.model.entries import DefinitionError, fault, read_entries, read_table, read_tables
from workers.model.force import Harmonic, turns_of

HARMONICS = 8
"""Maximum number of orders of a force."""
HIGHEST = 32
"""Maximum order, as a multiple of the frequency at which the whole force repeats."""

FORCE_KEYS = ("force", "phase", "cosine")
HARMONIC_KEYS = ("order", *FORCE_KEYS)
ORDER = re.compile(r"([1-9][0-9]{0,3})(/[1-9][0-9]{0,3})?", re.ASCII)


def is_unforced(table: Mapping[str, Any]) -> bool:
    """Return True if a table [system] declares neither a force nor phases, nor coefficients by the phase."""
    return (
        not any(key in table for key in (*FORCE_KEYS, "within"))
        and not table.get("harmonics")
        and not table.get("phases")
    )


def read_force(table: Mapping[str, Any], known: Collection[str], n: int) -> tuple[Harmonic, ...]:
    """Return the harmonics of the force in a table [system] of n coordinates.

    Parts of the same order add up.
    """
    parts = read_tables("system.harmonics", table.get("harmonics", []))
    if "force" in table or "cosine" in table:
        parts = {"system": {key: table[key] for key in FORCE_KEYS if key in table}} | parts
    elif "phase" in table:
        raise DefinitionError("system.phase: found without a force; give force too")
    tables = {where: read_table(where, part, HARMONIC_KEYS) for where, part in parts.items()}
    orders = {where: _read_order(where, part) for where, part in tables.items()}
    turns = turns_of(orders.values())
    for where, order in orders.items():
        if order * turns > HIGHEST:
            of = "" if turns == 1 else f" times omega / {turns}, the frequency at which the force repeats"
            raise DefinitionError(f"{where}.order: found {order * turns}{of}, must be at most {HIGHEST}")
    count = len(set(orders.values()))
    if count > HARMONICS:
        raise DefinitionError(
            f"system.harmonics: found {count} orders, must be at most {HARMONICS}; leave out {count - HARMONICS}"
        )
    harmonics = list[Harmonic]()
    for where, part in tables.items():
        if "force" not in part and "cosine" not in part:
            raise DefinitionError(f"{where}: force missing; give a list of {n}")
        rows = {key: read_entries(f"{where}.{key}", part.get(key, [0.0] * n), known, n) for key in FORCE_KEYS}
        if all(entry.constant == 0.0 for entry in rows["cosine"]):
            rows["cosine"] = ()
        harmonics.append(Harmonic(orders[where], **rows))
    return tuple(sorted(harmonics, key=lambda harmonic: harmonic.order))


def _read_order(where: str, part: Mapping[str, Any]) -> Fraction:
    """Return the order of a harmonic from its table ``part``: a whole number, or a ratio in quotes.

    A force that stands in [system] itself has order 1.
    """
    order = part.get("order", 1 if where == "system" else None)
    if isinstance(order, int) and not isinstance(order, bool) and order > 0:
        return Fraction(order)
    if isinstance(order, str) and ORDER.fullmatch(order):
        return Fraction(order)
    raise fault(f"{where}.order", order, f'must be a whole number, 1 to {HIGHEST}, or a ratio of two such as "3/2"')
