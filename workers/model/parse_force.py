"""Conversion of the force in a table [system] to harmonics, waveforms included, with every error in one line."""

import math
import re
from collections.abc import Collection, Mapping
from fractions import Fraction
from typing import Any

from workers.model.entries import DefinitionError, fault, read_entries, read_number, read_table, read_tables
from workers.model.expression import Expression, ExpressionError, Row, parse
from workers.model.force import Harmonic, turns_of
from workers.model.waveform import WAVEFORMS, Waveform

HARMONICS = 8
"""Maximum number of orders of a force."""
HIGHEST = 32
"""Maximum order, as a multiple of the frequency at which the whole force repeats."""
POINTS = 1000
"""Maximum number of points of a waveform."""

FORCE_KEYS = ("force", "phase", "cosine")
HARMONIC_KEYS = ("order", *FORCE_KEYS)
WAVEFORM_KEYS = ("order", "force", "phase", "waveform", "within")
ORDER = re.compile(r"([1-9][0-9]{0,3})(/[1-9][0-9]{0,3})?", re.ASCII)
_JUMPS = (
    "at a jump harmonics err by half of it, however many there are; a force that is constant between jumps is exact "
    'as [[system.phases]], a square wave as start = 0.0 with load = ["F"] and start = 0.5 with load = ["-F"]'
)


def is_unforced(table: Mapping[str, Any]) -> bool:
    """Return True if a table [system] declares neither a force nor phases."""
    return not any(key in table for key in FORCE_KEYS) and not table.get("harmonics") and not table.get("phases")


def read_force(table: Mapping[str, Any], known: Collection[str], n: int) -> tuple[tuple[Harmonic, ...], list[Row]]:
    """Return the harmonics of the force in a table [system] of n coordinates, and the means of its waveforms, as loads.

    Parts of the same order add up.
    """
    parts = read_tables("system.harmonics", table.get("harmonics", []))
    if "force" in table or "cosine" in table:
        parts = {"system": {key: table[key] for key in FORCE_KEYS if key in table}} | parts
    elif "phase" in table:
        raise DefinitionError("system.phase: found without a force; give force too")
    tables = {
        where: read_table(where, one, WAVEFORM_KEYS if _is_waveform(one) else HARMONIC_KEYS)
        for where, one in parts.items()
    }
    orders = {where: _read_order(where, one) for where, one in tables.items()}
    turns = turns_of(orders.values())
    for where, order in orders.items():
        if order * turns > HIGHEST:
            of = "" if turns == 1 else f" times omega / {turns}, the frequency at which the force repeats"
            raise DefinitionError(f"{where}.order: found {order * turns}{of}, must be at most {HIGHEST}")
    used = {orders[where] for where, one in tables.items() if not _is_waveform(one)}
    if len(used) > HARMONICS:
        raise DefinitionError(
            f"system.harmonics: found {len(used)} orders, must be at most {HARMONICS}; "
            f"leave out {len(used) - HARMONICS}"
        )
    harmonics, means = list[Harmonic](), list[Row]()
    for where, one in sorted(tables.items(), key=lambda item: _is_waveform(item[1])):
        if "force" not in one and "cosine" not in one:
            raise DefinitionError(f"{where}: force missing; give a list of {n}")
        rows = {key: read_entries(f"{where}.{key}", one.get(key, [0.0] * n), known, n) for key in FORCE_KEYS}
        if all(entry.constant == 0.0 for entry in rows["cosine"]):
            rows["cosine"] = ()
        part = Harmonic(orders[where], **rows)
        if not _is_waveform(one):
            harmonics.append(part)
            continue
        if Fraction(1) not in used:
            _refuse_phases_of_force(table)
        wave = _read_waveform(where, one)
        waves = _harmonics_of(where, one, wave, part, turns, HARMONICS - len(used), known)
        harmonics, used = [*harmonics, *waves], used.union(harmonic.order for harmonic in waves)
        means += [_times(where, wave.mean, part.force, known)] if wave.mean else []
    return tuple(sorted(harmonics, key=lambda harmonic: harmonic.order)), means


def with_means(where: str, load: Row, means: list[Row], known: Collection[str]) -> Row:
    """Return a load plus these means."""
    for mean in means:
        load = tuple(_sum(where, one, other, known) for one, other in zip(load, mean, strict=True))
    return load


def _sum(where: str, one: Expression, other: Expression, known: Collection[str]) -> Expression:
    if 0.0 in (one.constant, other.constant):
        return other if one.constant == 0.0 else one
    return _parsed(where, f"{one.text} + {other.text}", known)


def _is_waveform(one: object) -> bool:
    return isinstance(one, Mapping) and ("waveform" in one or "within" in one)


def _refuse_phases_of_force(table: Mapping[str, Any]) -> None:
    """Raise DefinitionError for a phase that changes a force of order 1 if only waveforms have that order."""
    for where, one in read_tables("system.phases", table.get("phases", [])).items():
        for key in ("force", "cosine"):
            if isinstance(one, Mapping) and key in one:
                raise DefinitionError(f"{where}.{key}: a phase changes no waveform; give system.{key} for it to change")


def _read_order(where: str, one: Mapping[str, Any]) -> Fraction:
    """Return the order, a whole number or a ratio in quotes.

    A force in [system] itself, and a waveform without an order, have order 1.
    """
    order = one.get("order", 1 if where == "system" or _is_waveform(one) else None)
    if isinstance(order, int) and not isinstance(order, bool) and order > 0:
        return Fraction(order)
    if isinstance(order, str) and ORDER.fullmatch(order):
        return Fraction(order)
    raise fault(f"{where}.order", order, f'must be a whole number, 1 to {HIGHEST}, or a ratio of two such as "3/2"')


def _read_waveform(where: str, one: Mapping[str, Any]) -> Waveform:
    """Return the waveform of this name, or of a table of points (share of its period, value)."""
    where, value = f"{where}.waveform", one.get("waveform")
    if isinstance(value, str) and value in WAVEFORMS:
        return Waveform(WAVEFORMS[value])
    if value in ("square", "sawtooth"):
        raise fault(where, value, f"which jumps: {_JUMPS}")
    known = " or ".join(repr(name) for name in WAVEFORMS)
    if not isinstance(value, list) or not all(isinstance(pair, list | tuple) and len(pair) == 2 for pair in value):
        raise fault(where, value, f"must be {known}, or a list of pairs [share of the period, value]")
    if not 2 <= len(value) <= POINTS:
        raise DefinitionError(f"{where}: found {len(value)} points, must be 2 to {POINTS}")
    points = [tuple(read_number(f"{where}[{i}]", number) for number in pair) for i, pair in enumerate(value)]
    before = -math.inf
    for i, (share, _) in enumerate(points):
        if share == before:
            raise DefinitionError(f"{where}[{i}]: found the share {share:g} twice, must rise; {_JUMPS}")
        if not max(0.0, before) <= share < 1.0:
            raise DefinitionError(f"{where}[{i}]: found the share {share:g}, must rise from 0 and stay below 1")
        before = share
    if len({value for _, value in points}) == 1:
        raise DefinitionError(f"{where}: found one value only, {points[0][1]:g}; a constant force is a load")
    return Waveform(points)


def _harmonics_of(
    where: str, one: Mapping[str, Any], wave: Waveform, part: Harmonic, turns: int, limit: int, known: Collection[str]
) -> list[Harmonic]:
    """Return the harmonics of a waveform, at most ``limit``, within the error bound of its table."""
    if "within" not in one:
        raise DefinitionError(
            f"{where}: within missing; give the largest error of the waveform over its largest value, such as 0.05"
        )
    within = read_number(f"{where}.within", one["within"])
    if not 0.0 < within < 1.0:
        raise DefinitionError(f"{where}.within: found {within:g}, must be above 0 and below 1")
    reach = int(HIGHEST / (part.order * turns))
    parts, error = wave.fewest(within, range(1, reach + 1), limit)
    if error > within:
        digits = 10.0 ** (1 - math.floor(math.log10(error)))
        raise DefinitionError(
            f"{where}.within: found {within:g}; the {limit} harmonics that are allowed, up to {reach} times its "
            f"frequency, come within {math.ceil(error * digits) / digits:g}; give that or more"
        )
    return [
        Harmonic(
            k * part.order,
            _times(where, sine, part.force, known),
            _times(where, float(k), part.phase, known),
            _times(where, cosine, part.force, known) if cosine else (),
        )
        for k, (sine, cosine) in parts.items()
    ]


def _times(where: str, number: float, row: Row, known: Collection[str]) -> Row:
    """Return a number times a row of expressions."""
    return tuple(_product(where, number, entry, known) for entry in row)


def _product(where: str, number: float, entry: Expression, known: Collection[str]) -> Expression:
    if number == 1.0:
        return entry
    if number == 0.0 or entry.constant is not None:
        return Expression(repr(number * (entry.constant or 0.0) + 0.0))
    text = entry.text if entry.text.isidentifier() else f"({entry.text})"
    return _parsed(where, f"{number!r} * {text}", known)


def _parsed(where: str, text: str, known: Collection[str]) -> Expression:
    try:
        return parse(text, known)
    except ExpressionError as error:
        raise DefinitionError(f"{where}: as part of a waveform {error}; give its force a name in let") from None
