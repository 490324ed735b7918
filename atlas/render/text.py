"""Texts in pictures: symbols, units and values of parameters, labels of axes, titles."""

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache

import xarray as xr
from matplotlib.mathtext import MathTextParser

from atlas.query.plane import CoordinateInfo
from atlas.spec.system import stored_system
from workers.model.parameter import TAU
from workers.model.system import System
from workers.results import PER_PERIOD, PER_TIME, REGIME, Variable

_TERMS = 3
"""Maximum number of terms with which a label writes out the gap coordinate."""


@lru_cache(maxsize=1024)
def shown_symbol(symbol: str, name: str) -> str:
    r"""Return a symbol as mathtext, without the dollars.

    Return the name instead if the symbol is empty or invalid, as ``\frac{``.
    """
    try:
        parsed = bool(symbol) and MathTextParser("path").parse(f"${symbol}$")
    except ValueError:
        parsed = False
    return symbol if parsed else rf"\mathit{{{name.replace('_', chr(92) + '_')}}}"


def symbol(ds: xr.Dataset, name: str) -> str:
    """Return the symbol of an atlas's parameter as mathtext, without the dollars."""
    return shown_symbol(CoordinateInfo.from_dataset(ds, name).symbol, name)


def axis_label(name: str, meaning: CoordinateInfo) -> str:
    """Return the label of an axis: meaning, symbol and unit, as ``impact speed $v$ [m/s]``; a pure number has no unit.

    A parameter without a meaning is labelled by its symbol.
    """
    symbol, text = shown_symbol(meaning.symbol, name), meaning.words.split(":")[0]
    return f"{text if text != name else ''} ${symbol}${unit_ending(meaning.unit or '1')}".strip()


def variable_label(ds: xr.Dataset, name: str) -> str:
    """Return the meaning and the unit of a variable, as the label of a colorbar."""
    meaning, unit = str(ds[name].attrs.get("long_name", name)).split(";")[0], str(ds[name].attrs.get("units", "1"))
    for rate in (PER_PERIOD, PER_TIME):
        if meaning.endswith(f" {rate}"):
            return f"{meaning.removesuffix(f' {rate}')} [{rate}]"
    return meaning + unit_ending(unit)


def in_its_unit(ds: xr.Dataset, label: str) -> str:
    """Return a label of exponents with the unit of the atlas's machine: per unit time if the machine has no force."""
    return label.replace(PER_PERIOD, PER_TIME) if is_unforced(ds) else label


def is_unforced(ds: xr.Dataset) -> bool:
    """Return True if the machine of an atlas has no force."""
    system = stored_system(ds.attrs)
    return system is not None and system.definition.unforced


def regime(ds: xr.Dataset) -> Variable:
    """Return the variable of regimes, with the words for its codes that suit the atlas's machine."""
    system = stored_system(ds.attrs)
    return REGIME if system is None else system.regime


def motion_key(ds: xr.Dataset) -> str:
    """Return the title of a legend that explains the names n-p-q of motions."""
    return f"$n$-$p$-$q$: $n$ {'passages' if is_unforced(ds) else 'periods'},\n$p$ impacts above, $q$ below"


def rest(ds: xr.Dataset) -> str:
    """Return the words for the rest that erases disturbances: on a rigid stop, or sticking if no stop is rigid."""
    system = stored_system(ds.attrs)
    rigid = system is None or any(contact.restitution is not None for contact in system.definition.contacts)
    return "rest on a stop" if rigid else "stick"


def unit_ending(*units: str) -> str:
    """Return the ending of a label: its unit in brackets.

    The ending is empty for pure numbers, whose unit is 1, and for several different units.
    """
    return "" if len({*units}) > 1 or units[0] == "1" else f" [{units[0]}]"


def title_line(ds: xr.Dataset) -> str:
    r"""Return the fixed parameters in the system's order, as ``$R = 0.8$,  $\zeta = 0.05$``.

    Initial states of zero are left out. If all constants of the machine are numbers, with no fixed parameter but the
    phase of its force, the line is the title of the machine.
    """
    system = stored_system(ds.attrs)
    order = [p.name for p in system.parameters] if system else [str(name) for name in ds.coords]
    fixed = [name for name in order if name in ds.coords and ds[name].ndim == 0 and ds[name].dtype.kind in "iuf"]
    states = system.states if system else ()
    names = [n for n in fixed if float(ds[n]) or n not in states]
    if system is not None and {*names} <= {TAU}:
        names = [n for n in names if float(ds[n])]
        title = (system.title or system.name).replace("$", r"\$")
        return ",  ".join(filter(None, [title, parameter_line([(symbol(ds, n), float(ds[n])) for n in names])]))
    return parameter_line([(symbol(ds, n), float(ds[n])) for n in names])


def system_line(system: System, values: Mapping[str, float]) -> str:
    """Return the line of ``title_line`` for the parameters ``values`` of a system, without an atlas."""
    parameters = [p for p in system.parameters if p.name in values and (values[p.name] or p.name not in system.states)]
    return parameter_line([(shown_symbol(p.symbol, p.name), values[p.name]) for p in parameters])


def parameter_line(items: Sequence[tuple[str, float]]) -> str:
    """Return symbols with their values on one line, which ``text_wrap.wrap_texts`` may break at commas."""
    return ",  ".join(f"${sign} = {number(value)}$" for sign, value in items)


def number(value: float) -> str:
    """Return a number as mathtext: with up to six digits, or as a simple multiple of pi."""
    for below in (1, 2, 3, 4, 6):
        above = value / math.pi * below
        times = round(above)
        if abs(above - times) < 1e-12 and 0 < abs(times) <= 12:
            return {1: "", -1: "-"}.get(times, str(times)) + r"\pi" + (f"/{below}" if below > 1 else "")
    mantissa, _, power = f"{value:.6g}".partition("e")
    return rf"{mantissa} \times 10^{{{int(power)}}}" if power else mantissa


def gap_label(system: System | None) -> str:
    """Return the label of the gap coordinate at t = k T: meaning, symbol and unit, in two lines.

    For a machine without a force the label names its event instead of t = k T.
    """
    if system is None:
        return "first state at $t = kT$"
    entries = [entry.constant for entry in system.definition.picture_row]
    states = [system.parameter(name) for name in system.definition.coordinates]
    at = "its event" if system.definition.unforced else "$t = kT$"
    ending = f" at {at}" + unit_ending(*(state.unit for state, c in zip(states, entries, strict=True) if c != 0.0))
    known = [entry for entry in entries if entry is not None]
    if len(known) < len(entries):
        return f"gap coordinate\n$y${ending}"
    formula = combination(known, [state_symbol(system, state.name) for state in states])
    alone = [(state, c) for state, c in zip(states, known, strict=True) if c != 0.0]
    # The text after the comma would take more lines.
    short_meaning = alone[0][0].meaning.removeprefix("initial ").split(",")[0]
    meaning = short_meaning if [c for _, c in alone] == [1.0] else "gap coordinate"
    return f"{meaning}\n${formula}${ending}"


def state_symbol(system: System, state: str) -> str:
    """Return the symbol of a component of the state, derived from that of the parameter for its initial value."""
    return shown_symbol(system.parameter(state).symbol.removesuffix("(0)"), state)


def combination(row: Sequence[float], symbols: Sequence[str], otherwise: str = "y") -> str:
    """Return a linear combination of symbols as mathtext, positive terms first: ``x_2 - x_1``.

    ``row`` are the coefficients. Return ``otherwise`` for more than three terms.
    """
    terms = [(c, symbol) for c, symbol in zip(row, symbols, strict=True) if c != 0.0]
    terms.sort(key=lambda term: term[0] < 0.0)
    if not 0 < len(terms) <= _TERMS:
        return otherwise
    written = ""
    for c, symbol in terms:
        sign = "-" if c < 0.0 else "+" if written else ""
        factor = "" if abs(c) == 1.0 else rf"{number(abs(float(c)))}\,"
        written += (f" {sign} " if written else sign) + factor + symbol
    return written
