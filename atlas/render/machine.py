"""What pictures have to know of the machines behind the cells: the gap coordinate, and whether motions have twins."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.render import style
from workers.model.oscillator import COLUMN, Oscillator
from workers.model.system import System
from workers.results import NO_REASON

Array = NDArray[np.float64]

AT_ONCE = 4096
"""So many points whose oscillators are made at a time: together they take some megabytes."""

_TERMS = 3
"""Terms of a gap coordinate that a label spells out, at most."""


def known_system(ds: xr.Dataset, who: str) -> System:
    """The atlas's system; InputError, for ``who`` needs it, where it names none that is known."""
    system = style.system_of(ds)
    if system is None:
        raise InputError(f"{who}: the atlas does not name a system that is known here")
    return system


def fixed(ds: xr.Dataset, system: System) -> dict[str, float]:
    """The parameters that are the same in all cells of an atlas."""
    return {p.name: float(ds[p.name]) for p in system.parameters if p.name in ds.coords and ds[p.name].ndim == 0}


def oscillators(
    system: System, same: Mapping[str, float], points: Mapping[str, Array]
) -> Iterator[tuple[slice, Oscillator, NDArray[np.bool_]]]:
    """The oscillators at points (N,) of some parameters, and where there is one, in parts of AT_ONCE."""
    count = len(next(iter(points.values())))
    for low in range(0, count, AT_ONCE):
        part = slice(low, min(low + AT_ONCE, count))
        given = {name: np.full(part.stop - low, value) for name, value in same.items()}
        osc, reasons = system.build_many(given | {name: values[part] for name, values in points.items()})
        yield part, osc, reasons == NO_REASON


def has_twins(system: System, same: Mapping[str, float], points: Mapping[str, Array]) -> NDArray[np.bool_]:
    """Where x(t) -> -x(t + T/2) takes motions to motions, at points (N,) of some parameters."""
    found = np.zeros(len(next(iter(points.values()))), dtype=bool)
    for part, osc, there in oscillators(system, same, points):
        found[part] = there & (osc.symmetric > 0.0)
    return found


def why_no_twins(system: System, values: Mapping[str, float]) -> str:
    """What keeps the machine of these parameters from having mirror images of its motions."""
    osc = system.build(values)
    if system.has_modes:
        return "mirror images are known of machines with one rigid contact alone"
    if not (np.isfinite(osc.upper) and np.isfinite(osc.lower)):
        return "there is only one stop"
    if osc.b_upper != osc.b_lower:
        return f"the stops lie {osc.b_upper:g} above and {osc.b_lower:g} below the rest position"
    if np.any(osc.gap.blocks[:, COLUMN.load] != 0.0):
        return "a constant load acts on a mass that no spring holds"
    return "the force has even harmonics"


def gap_values(ds: xr.Dataset, x: str, states: xr.DataArray) -> Array:
    """The gap coordinate y = g . x of physical states (cell, sample, component) along the axis of a sweep.

    Of an atlas whose system is not known it is the first component.
    """
    system = style.system_of(ds)
    if system is None:
        return np.asarray(states[..., 0].values, dtype=np.float64)
    rows = gap_rows(system, {**fixed(ds, system), x: np.asarray(ds[x].values, np.float64)})
    found = np.zeros(states.shape[:-1])
    for i in np.flatnonzero(np.any(rows != 0.0, axis=0)):  # what it does not consist of is not read
        found += rows[:, i, None] * np.asarray(states[..., int(i)].values)
    return found


def gap_rows(system: System, values: Mapping[str, float | Array]) -> Array:
    """The rows g (N, n) of the gap coordinate y = g . x, for parameters that are numbers or have N values."""
    count = max(np.size(value) for value in values.values())
    given = {name: np.broadcast_to(np.asarray(value, dtype=np.float64), (count,)) for name, value in values.items()}
    return system.definition.shown_rows(given)


def gap_label(ds: xr.Dataset) -> str:
    """Meaning, symbol and unit of the gap coordinate at a section, in two lines."""
    system = style.system_of(ds)
    return "first state at $t = kT$" if system is None else gap_label_of(system)


def gap_label_of(system: System) -> str:
    """The same, of a system."""
    entries = [entry.constant for entry in system.definition.shown]
    states = [system.parameter(name) for name in system.definition.coordinates]
    (unit, *others) = {each.unit for each, entry in zip(states, entries, strict=True) if entry != 0.0}
    ending = " at $t = kT$" + ("" if others else f" [{style.unit_text(unit)}]")
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
