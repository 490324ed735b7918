"""The words of the page, as plain Unicode and HTML: symbols, numbers, the cell clicked, the title, the ticks."""

import base64
import html
import json
import math
import shlex
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from atlas.cell.point_command import point_words
from atlas.explore.cell_lookup import CellResult
from atlas.explore.jobs import ServiceState
from atlas.explore.subject import PlaneParameters, Subject
from atlas.formatting import mathtext_to_unicode, plural
from atlas.task.compile import compile_notice, kernels_for
from workers.model.system import System
from workers.results import REASON, REASONS, REGIME, result_named

_ABOVE = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
HELP = """point at the plane: the numbers of a cell
click a cell, or Enter: all of it, its motion, its attractors, its basins
wheel, two fingers, + and −: zoom
drag, arrows: move
pen above the plane: a cut along a line"""
CLOSE = 1e-3
"""A window so narrow, relative to its place, has ticks that count from a round number near its centre."""


def symbol_of(system: System, name: str) -> str:
    """A parameter's symbol in Unicode."""
    return mathtext_to_unicode(system.parameter(name).symbol or name)


def title(subject: Subject, plane: PlaneParameters) -> str:
    """The system and the fixed parameters that matter, as HTML: all but an initial state of zero."""
    states, values = subject.system.states, dict(plane.parameters)
    shown = [
        _equation(symbol_of(subject.system, name), number(values[name]))
        for name in (parameter.name for parameter in subject.system.parameters)
        if name in values and (values[name] or name not in states)
    ]
    return f"<b>{html.escape(subject.name)}</b> &ensp; {', &ensp;'.join(shown)}"


def _equation(symbol: str, value: str) -> str:
    """A symbol and its value, as HTML that stays on one line."""
    return f'<span class="number"><i>{html.escape(symbol)}</i> = {value}</span>'


def number(value: float, digits: int = 6) -> str:
    """A number for text: at most this many digits, a proper minus, powers of ten."""
    mantissa, _, power = f"{value:.{digits}g}".partition("e")
    text = mantissa.replace("-", "−")
    return f"{text}·10{str(int(power)).translate(_ABOVE)}" if power else text


class TickFormat(NamedTuple):
    """The writing of an axis's ticks, (tick - base) / unit to a number of decimals, and its label."""

    base: float
    unit: float
    decimals: int
    label: str


def ticks(subject: Subject, name: str, low: float, high: float) -> TickFormat:
    """The ticks of a window: plain numbers, and where it is close to one value, the distance from a round one."""
    parameter = subject.system.parameter(name)
    meaning = parameter.meaning.split(":")[0]
    unit = "" if parameter.unit == "1" else f" [{parameter.unit}]"
    symbol = symbol_of(subject.system, name)
    span, centre = high - low, 0.5 * (low + high)
    power = math.floor(math.log10(span))
    if span > CLOSE * abs(centre):
        return TickFormat(0.0, 1.0, max(0, 1 - power), f"{meaning} {symbol}{unit}")
    base = round(centre, -power)
    scale = f"10{str(power).translate(_ABOVE)}"
    return TickFormat(base, 10.0**power, 2, f"{meaning} {symbol}: distance from {base!r} in {scale}{unit}")


def where(subject: Subject, parameters: Mapping[str, float]) -> dict[str, str]:
    """Where a cell lies, by symbols: its axes, and the parameters by which its plane is not that of the subject."""
    changed = [name for name, value in subject.plane.parameters if parameters[name] != value]
    return {symbol_of(subject.system, name): number(parameters[name]) for name in (*subject.axes, *changed)}


def cell_line(cell: CellResult, subject: Subject) -> str:
    """Where a cell lies and its regime, as HTML."""
    places = [_equation(name, value) for name, value in where(subject, cell.parameters).items()]
    return f"{', &ensp;'.join(places)} &ensp; {html.escape(str(cell.results[REGIME.name]).replace('_', ' '))}"


def cell_given(cell: CellResult, subject: Subject) -> dict[str, Any]:
    """The numbers of a cell with their meanings, as JSON, of which the page shows the results of its regime."""
    own = {variable.name: variable for variable in subject.system.variables(subject.settings)}
    numbers = {name: value for name, value in cell.results.items() if isinstance(value, bool | int | float)}
    values = {name: value for name, value in numbers.items() if name not in subject.axes}
    reasons = [reason.text for reason in REASONS]
    values[REGIME.name] = REGIME.code_of(cell.results[REGIME.name])
    values[REASON.name] = reasons.index(cell.results[REASON.name]) if REASON.name in cell.results else 0
    meant = {name: own.get(name) or result_named(name) for name in (REGIME.name, REASON.name, *values)}
    return {
        "caption": "cell of the atlas" if cell.of_atlas else f"explored cell, tolerance {subject.settings.tolerance:g}",
        "places": [(symbol_of(subject.system, name), cell.results[name]) for name in subject.axes],
        "variables": {
            name: {
                "label": name if name in (REGIME.name, REASON.name) else variable.words,
                "flag": isinstance(values[name], bool),
                "endless": variable.allows_infinite,
                "regimes": sorted(variable.regimes),
            }
            for name, variable in meant.items()
        },
        "values": _plain(values),
    }


def cell_text(cell: CellResult) -> str:
    """All numbers of a cell as JSON, in full precision; NaN is null."""
    values = cell.parameters | cell.results
    return json.dumps(_plain(values), indent=1)


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values for JSON: None in place of NaN."""
    return {name: None if value != value else value for name, value in values.items()}


def first_compile_notice(system: System, *more: str) -> str:
    """The kernels that workers on this machine compile before they begin, as the end of a sentence; perhaps empty."""
    said = compile_notice(*kernels_for(system, *more))
    return f"; workers on this machine begin by {said}" if said.startswith("compiling") else ""


def point_line(cell: CellResult, subject: Subject) -> str:
    """The command that solves this cell again, to the bit."""
    settings = subject.spec.settings if cell.of_atlas else subject.settings
    return shlex.join(point_words(subject.system, cell.parameters, settings, cell.results.keys()))


def refinement(shares: Sequence[float]) -> str:
    """How densely a view is drawn, in words, by the share of it that is known at each stage, the coarsest first."""
    if not shares:
        return "no picture yet"
    if min(shares) == 1.0:
        return "all that is in view is solved"
    whole = next(k for k, share in enumerate(shares) if share < 1.0)
    names = [*(f"1/{1 << k} of full resolution" for k in range(len(shares) - 1, 0, -1)), "full resolution"]
    begun = f"{math.floor(100.0 * shares[whole])} % at {names[whole]}"
    return f"drawn at {names[whole - 1]}, {begun}" if whole else f"drawn: {begun}"


def progress(state: ServiceState, left: int, notes: Iterable[str], shares: Sequence[float] = ()) -> str:
    """The line under the plane, as HTML; ``left`` are tiles still to be solved, ``shares`` as in ``refinement``."""
    parts = [refinement(shares)]
    if left:
        parts.append(f"{plural(left, 'tile')} left, {spaced(state.rate)} cells/s")
    parts.append(plural(state.workers, "worker"))
    parts += [html.escape(note) for note in notes if note]
    text = " &middot; ".join(parts)
    if state.trouble:
        text = f'<span class="trouble" role="alert">{html.escape(state.trouble)}</span> &middot; {text}'
    return text


def spaced(count: float) -> str:
    """A whole number with its thousands apart."""
    return f"{count:,.0f}".replace(",", "\N{NARROW NO-BREAK SPACE}")


def data_address(kind: str, content: bytes) -> str:
    """The content of a file of this media type as an address."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
