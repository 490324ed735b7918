"""How pictures name the gap coordinate, the components of a state, and their units."""

from collections.abc import Sequence

import xarray as xr

from atlas.render import style
from workers.model.system import System

_TERMS = 3
"""Terms of a gap coordinate that a label spells out, at most."""


def unit_of(units: set[str]) -> str:
    """The unit of a quantity as its label ends: nothing for pure numbers, or where its parts have several units."""
    (unit, *others) = units
    return "" if others else style.unit_ending(unit)


def gap_label(ds: xr.Dataset) -> str:
    """Meaning, symbol and unit of the gap coordinate at a section, in two lines."""
    system = style.system_of(ds)
    return "first state at $t = kT$" if system is None else gap_label_of(system)


def gap_label_of(system: System) -> str:
    """The same, of a system."""
    entries = [entry.constant for entry in system.definition.shown]
    states = [system.parameter(name) for name in system.definition.coordinates]
    ending = " at $t = kT$" + unit_of({each.unit for each, c in zip(states, entries, strict=True) if c != 0.0})
    known = [entry for entry in entries if entry is not None]
    if len(known) < len(entries):
        return f"gap coordinate\n$y${ending}"
    formula = combination(known, [symbol_of(system, each.name) for each in states])
    alone = [i for i, entry in enumerate(known) if entry != 0.0]
    if len(alone) == 1 and known[alone[0]] == 1.0:
        return f"{states[alone[0]].meaning.removeprefix('initial ')}\n${formula}${ending}"
    return f"gap coordinate\n${formula}${ending}"


def symbol_of(system: System, state: str) -> str:
    """The symbol of a component of the state; the system knows it as the parameter that sets its initial value."""
    return style.shown_symbol(system.parameter(state).symbol.removesuffix("(0)"), state)


def combination(row: Sequence[float], symbols: Sequence[str], otherwise: str = "y") -> str:
    """The sum of symbols with these coefficients as mathtext, positive ones first: ``x_2 - x_1``.

    ``otherwise`` where there are more than three of them.
    """
    terms = sorted(
        ((c, symbol) for c, symbol in zip(row, symbols, strict=True) if c != 0.0), key=lambda term: term[0] < 0
    )
    if not 0 < len(terms) <= _TERMS:
        return otherwise
    written = []
    for k, (c, symbol) in enumerate(terms):
        sign = "-" if c < 0.0 else "+" if k else ""
        factor = "" if abs(c) == 1.0 else rf"{style.number(abs(float(c)))}\,"
        written.append(f"{f' {sign} ' if k else sign}{factor}{symbol}")
    return "".join(written)
