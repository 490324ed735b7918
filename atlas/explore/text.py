"""The texts of an explorer page, as Unicode: symbols, numbers, labels, the chosen cell, the progress."""

import base64
import json
import math
import shlex
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from atlas.cell.point_command import point_words
from atlas.explore.cell_lookup import CellResult
from atlas.explore.jobs import ServiceState
from atlas.explore.subject import Subject
from atlas.formatting import mathtext_to_unicode, plural
from atlas.task.compile import compile_notice, kernels_for
from workers.model.parameter import Parameter
from workers.model.system import System
from workers.results import REASON, REASONS, REGIME, result_named

_ABOVE = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def symbol_of(system: System, name: str) -> str:
    """Return a parameter's symbol in Unicode."""
    return mathtext_to_unicode(system.parameter(name).symbol or name)


def axis_label(system: System, name: str) -> str:
    """Return the label of an axis: the parameter's meaning, symbol and unit."""
    parameter = system.parameter(name)
    unit = "" if parameter.unit == "1" else f" [{parameter.unit}]"
    return f"{meaning_of(parameter)} {symbol_of(system, name)}{unit}"


def meaning_of(parameter: Parameter) -> str:
    """Return a parameter's meaning in few words."""
    return parameter.meaning.split(":")[0]


def number(value: float, digits: int = 6) -> str:
    """Return a number as text, as the function ``number`` of ``front/words.mjs`` does in the browser.

    The text has at most ``digits`` significant digits, a true minus sign, and a power of ten if the number is below a
    thousandth.
    """
    if not math.isfinite(value):
        return "none" if math.isnan(value) else "∞" if value > 0.0 else "−∞"
    near = float(f"{value:.{digits - 1}e}")
    if near != 0.0 and not 1e-3 <= abs(value) < 1e21:
        mantissa, _, power = np.format_float_scientific(near, trim="-").partition("e")
        text = "" if mantissa == "1" else f"{mantissa.replace('-', '−')}·"
        return f"{text}10{str(int(power)).translate(_ABOVE)}"
    return np.format_float_positional(near + 0.0, trim="-").replace("-", "−")


def where(subject: Subject, parameters: Mapping[str, float]) -> dict[str, str]:
    """Return the parameters that tell where a cell lies, as texts by symbol.

    These are the values of its axes, and the other parameters in which it differs from the subject's plane.
    """
    changed = [name for name, value in subject.plane.parameters if parameters[name] != value]
    return {symbol_of(subject.system, name): number(parameters[name]) for name in (*subject.axes, *changed)}


def cell_given(cell: CellResult, subject: Subject) -> dict[str, Any]:
    """Return the numbers of a cell with their meanings, see ``plain``.

    The browser leaves out numbers that cells of the regime do not have.
    """
    variables = {variable.name: variable for variable in subject.system.variables(subject.settings)}
    numbers = {name: value for name, value in cell.results.items() if isinstance(value, bool | int | float)}
    values = {name: value for name, value in numbers.items() if name not in subject.axes}
    reasons = [reason.text for reason in REASONS]
    values[REGIME.name] = REGIME.code_of(cell.results[REGIME.name])
    values[REASON.name] = reasons.index(cell.results[REASON.name]) if REASON.name in cell.results else 0
    meant = {name: variables.get(name) or result_named(name) for name in (REGIME.name, REASON.name, *values)}
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
        "values": values,
    }


def cell_text(cell: CellResult) -> str:
    """Return all numbers of a cell as JSON, in full precision; NaN is null."""
    values = cell.parameters | cell.results
    return json.dumps({name: None if value != value else value for name, value in values.items()}, indent=1)


def plain(value: Any) -> Any:
    """Return a value as plain JSON for the browser: arrays as lists of numbers of six digits, null for NaN.

    An infinite number is text that JavaScript turns into the number; infinite entries of arrays are null.
    """
    if isinstance(value, np.ndarray):
        return (
            [float(f"{entry:.6g}") if np.isfinite(entry) else None for entry in value.tolist()]
            if value.ndim == 1
            else [plain(row) for row in value]
        )
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else "Infinity" if value > 0.0 else "-Infinity"
    if isinstance(value, Mapping):
        return {name: plain(part) for name, part in value.items()}
    return [plain(part) for part in value] if isinstance(value, list | tuple) else value


def first_compile_notice(system: System, *more: str) -> str:
    """Return the end of a sentence that says which kernels local workers will compile first; empty if there are none.

    system   the system
    more     names of computations beyond cells for which kernels are needed
    """
    said = compile_notice(*kernels_for(system, *more))
    return f"; workers on this machine begin by {said}" if said.startswith("compiling") else ""


def point_line(cell: CellResult, subject: Subject) -> str:
    """Return the shell command that solves this cell again, with equal results to the bit."""
    settings = subject.spec.settings if cell.of_atlas else subject.settings
    return shlex.join(point_words(subject.system, cell.parameters, settings, cell.results.keys()))


def refinement(shares: Sequence[float]) -> str:
    """Return how densely the visible cells are drawn so far, as text.

    ``shares`` are the shares of the viewport that are known at each density, the coarsest first; each density halves
    the cell width of the one before.
    """
    if not shares:
        return "no picture yet"
    if min(shares) == 1.0:
        return "all visible cells are solved"
    stage = next(k for k, share in enumerate(shares) if share < 1.0)
    names = [*(f"1/{1 << k} of full resolution" for k in range(len(shares) - 1, 0, -1)), "full resolution"]
    begun = f"{math.floor(100.0 * shares[stage])} % at {names[stage]}"
    return f"drawn at {names[stage - 1]}, {begun}" if stage else f"drawn: {begun}"


def progress(state: ServiceState, left: int, notes: Iterable[str], shares: Sequence[float] = ()) -> str:
    """Return the progress line under the plane as text.

    state    state of the job service: workers and solving rate
    left     number of tiles still to be solved
    notes    further notes; empty ones are left out
    shares   shares of the viewport, see ``refinement``
    """
    parts = [refinement(shares)]
    if left:
        parts.append(f"{plural(left, 'tile')} left, {spaced(state.rate)} cells/s")
    parts.append(plural(state.workers, "worker"))
    return " · ".join([*parts, *filter(None, notes)])


def spaced(count: float) -> str:
    """Return a whole number with narrow spaces between thousands."""
    return f"{count:,.0f}".replace(",", "\N{NARROW NO-BREAK SPACE}")


def data_address(kind: str, content: bytes) -> str:
    """Return ``content`` of the media type ``kind``, such as image/png, as a data URL."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
