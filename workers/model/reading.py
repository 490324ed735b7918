"""A table, as a TOML file has it, to a definition and its parameters, each fault in one line."""

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from numbers import Real
from reprlib import Repr
from typing import Any

from workers.model.definition import NO_STOP, Definition, Harmonic, Matrix, Row
from workers.model.expression import RESERVED, Expression, ExpressionError, parse
from workers.model.names import is_taken
from workers.model.parameter import OMEGA, TAU, Parameter, unknown_name

LARGEST = 8
"""Coordinates of a system."""
HARMONICS = 4
"""The highest order of a harmonic."""
MANY = 64
"""Parameters, and names in ``let``, of a system."""

PARAMETER_KEYS = ("default", "low", "high", "low_open", "high_open", "symbol", "unit", "meaning")
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}", re.ASCII)
_GREEK = (
    "alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "kappa", "lambda", "mu", "nu", "xi", "rho",
    "sigma", "tau", "phi", "chi", "psi", "omega", "Gamma", "Delta", "Theta", "Lambda", "Xi", "Sigma", "Phi", "Psi",
    "Omega",
)  # fmt: skip
_short = Repr()
_short.maxstring = _short.maxlong = _short.maxother = 60


class DefinitionError(ValueError):
    """What is wrong with the definition of a system, in one line: the entry, what was found, what would be right."""


def read_text(where: str, value: object, default: str | None = None) -> str:
    """A text; DefinitionError for anything else."""
    if value is None and default is not None:
        return default
    if not isinstance(value, str) or len(value) > 5000:
        raise _found(where, value, "must be text in quotes")
    return value


def read_parameters(table: object, coordinates: tuple[str, ...], velocities: tuple[str, ...]) -> tuple[Parameter, ...]:
    """All parameters in order: omega, the table's, tau, then the initial values of coordinates and velocities.

    Omega, tau and the initial values exist by themselves: the table may change their default, range and words.
    """
    given = read_table("system.parameters", table)
    if len(given) > MANY:
        raise DefinitionError(f"system.parameters: found {len(given)}, must be at most {MANY}")
    first = Parameter(OMEGA, r"\omega", "1", "forcing frequency", 1.0, low=0.0, low_open=True)
    last = [Parameter(TAU, r"\tau", "rad", "phase of the force at t = 0", 0.0)]
    last += [Parameter(name, f"{symbol_of(name)}(0)", "1", "initial displacement", 0.0) for name in coordinates]
    for name, of in zip(velocities, coordinates, strict=True):
        last.append(Parameter(name, rf"\dot {symbol_of(of)}(0)", "1", "initial velocity", 0.0))
    for name in (*coordinates, *velocities):
        for key in ("low", "high"):
            if isinstance(given.get(name), Mapping) and key in given[name]:
                where = f"system.parameters.{name}.{key}"
                raise DefinitionError(f"{where}: an initial value has no range; the stops alone bound it")
    built_in = {parameter.name: parameter for parameter in (first, *last)}
    found = built_in | {name: _read_parameter(name, one, built_in.get(name)) for name, one in given.items()}
    own = [name for name in given if name not in built_in]
    return tuple(found[name] for name in (OMEGA, *own, *(parameter.name for parameter in last)))


def _read_parameter(name: str, given: object, base: Parameter | None) -> Parameter:
    where = f"system.parameters.{name}"
    table = read_table(where, given, PARAMETER_KEYS)
    _check_name(where, name)
    if base is None and "default" not in table:
        raise DefinitionError(f"{where}: default missing; give a number")
    known = base or Parameter(name, symbol_of(name), "1", name, 0.0)
    found = Parameter(
        name,
        symbol=_read_words(f"{where}.symbol", table.get("symbol"), known.symbol),
        unit=_read_words(f"{where}.unit", table.get("unit"), known.unit),
        meaning=_read_words(f"{where}.meaning", table.get("meaning"), known.meaning),
        default=read_number(f"{where}.default", table.get("default", known.default)),
        low=read_number(f"{where}.low", table.get("low", known.low), infinite=True),
        high=read_number(f"{where}.high", table.get("high", known.high), infinite=True),
        low_open=_read_flag(f"{where}.low_open", table.get("low_open", known.low_open)),
        high_open=_read_flag(f"{where}.high_open", table.get("high_open", known.high_open)),
    )
    if not found.low <= found.high:
        raise DefinitionError(f"{where}: low {found.low:g} must not be above high {found.high:g}")
    if name == OMEGA and not (found.low > 0.0 or (found.low == 0.0 and found.low_open)):
        raise DefinitionError(f"{where}.low: found {found.low:g}, must be 0 with low_open = true, or more")
    if not found.admits(found.default):
        raise DefinitionError(f"{where}.default: found {found.default:g}, must satisfy {found.range}")
    return found


def read_coordinates(table: Mapping[str, Any]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the coordinates and of their velocities.

    A velocity that is not named is v with the number that ends its coordinate's name: v1 of x1, v of y.
    """
    coordinates = _names("system.coordinates", required(table, "coordinates"))
    if not 1 <= len(coordinates) <= LARGEST:
        raise DefinitionError(f"system.coordinates: found {len(coordinates)}, must be 1 to {LARGEST}")
    if "velocities" in table:
        velocities = _names("system.velocities", read_list("system.velocities", table["velocities"], len(coordinates)))
    else:
        velocities = tuple("v" + name[len(name.rstrip("0123456789")) :] for name in coordinates)
    names = (*coordinates, *velocities)
    for name in names:
        if name in (OMEGA, TAU):
            raise DefinitionError(f"system.coordinates: {name} is a parameter of the force; choose another name")
        if names.count(name) > 1:
            twice = f"{name} is there twice in {', '.join(names)}"
            raise DefinitionError(f"system.coordinates: {twice}; give velocities = [...] too")
    return coordinates, velocities


def read_definition(
    table: Mapping[str, Any], parameters: Collection[str], coordinates: tuple[str, ...], velocities: tuple[str, ...]
) -> Definition:
    """The definition in a table whose parameters have these names, coordinates and velocities included."""
    n = len(coordinates)
    # The initial state is where a motion begins and no part of the machine.
    known = [name for name in parameters if name not in (*coordinates, *velocities)]
    let = _read_let(table.get("let", {}), known, parameters)
    known = [*known, *(name for name, _ in let)]

    def row(where: str, given: object) -> Row:
        entries = read_list(where, given, n)
        return tuple(read_entry(f"{where}[{i}]", entry, known) for i, entry in enumerate(entries))

    def matrix(key: str) -> Matrix:
        where, given = f"system.{key}", table.get(key, [[0.0] * n] * n)
        return tuple(row(f"{where}[{i}]", each) for i, each in enumerate(read_list(where, given, n, "rows")))

    if isinstance(table.get("gap"), list) and any(isinstance(each, list) for each in table["gap"]):
        raise _found("system.gap", table["gap"], "several gaps at once are not supported; give one row")
    required(table, "mass")
    return Definition(
        coordinates=coordinates,
        velocities=velocities,
        let=let,
        mass=matrix("mass"),
        damping=matrix("damping"),
        stiffness=matrix("stiffness"),
        harmonics=_read_harmonics(table, row, n),
        load=row("system.load", table.get("load", [0.0] * n)),
        gap=row("system.gap", required(table, "gap")),
        upper=_read_stop(table, "upper", known),
        lower=_read_stop(table, "lower", known),
        restitution=read_entry("system.restitution", required(table, "restitution"), known),
    )


def _read_let(given: object, known: list[str], taken: Collection[str]) -> tuple[tuple[str, Expression], ...]:
    """Names for expressions, in an order in which each comes after those that it uses."""
    table = read_table("system.let", given)
    if len(table) > MANY:
        raise DefinitionError(f"system.let: found {len(table)} names, must be at most {MANY}")
    for name in table:
        _check_name(f"system.let.{name}", name)
        if name in taken:
            raise DefinitionError(f"system.let.{name}: {name} is a parameter already; choose another name")
    waiting = {name: read_entry(f"system.let.{name}", entry, [*known, *table]) for name, entry in table.items()}
    ready: list[tuple[str, Expression]] = []
    while waiting:
        free = next((name for name, each in waiting.items() if not each.names & waiting.keys()), None)
        if free is None:
            chain = [next(iter(waiting))]
            while chain.count(chain[-1]) < 2:
                chain.append(min(waiting[chain[-1]].names & waiting.keys()))
            circle = " uses ".join(chain[chain.index(chain[-1]) :])
            raise DefinitionError(f"system.let: {circle}, a circle; define one of them without the others")
        ready.append((free, waiting.pop(free)))
    return tuple(ready)


def _read_harmonics(table: Mapping[str, Any], row: Callable[[str, object], Row], n: int) -> tuple[Harmonic, ...]:
    given = table.get("harmonics", [])
    if not isinstance(given, list):
        raise _found("system.harmonics", given, "must be tables [[system.harmonics]]")
    parts = {f"system.harmonics[{i}]": one for i, one in enumerate(given)}
    if "force" in table:
        parts = {"system": {"order": 1} | {key: table[key] for key in ("force", "phase") if key in table}} | parts
    elif "phase" in table:
        raise DefinitionError("system.phase: there is no force that it could be of; give force too")
    elif not given:
        raise DefinitionError(f"system: force missing; give a list of {n}")
    found: list[Harmonic] = []
    for where, one in parts.items():
        part = read_table(where, one, ("order", "force", "phase"))
        order = part.get("order")
        if isinstance(order, bool) or not isinstance(order, int) or not 1 <= order <= HARMONICS:
            raise _found(f"{where}.order", order, f"must be a whole number, 1 to {HARMONICS}")
        if order in [each.order for each in found]:
            raise DefinitionError(f"{where}.order: there is a force of order {order} already; add the two")
        if "force" not in part:
            raise DefinitionError(f"{where}: force missing; give a list of {n}")
        force = row(f"{where}.force", part["force"])
        found.append(Harmonic(order, force, row(f"{where}.phase", part.get("phase", [0.0] * n))))
    return tuple(sorted(found))


def _read_stop(table: Mapping[str, Any], key: str, known: Collection[str]) -> Expression | None:
    if "upper" not in table and "lower" not in table:
        where = "system: upper and lower missing"
        raise DefinitionError(f"{where}; give one stop or both as positions of the gap coordinate")
    if key not in table or table[key] == NO_STOP[key]:
        return None
    return read_entry(f"system.{key}", table[key], known)


def read_entry(where: str, given: object, known: Collection[str]) -> Expression:
    """The expression that a number or a text is."""
    if isinstance(given, str):
        try:
            return parse(given, known)
        except ExpressionError as error:
            raise DefinitionError(f"{where}: {error}") from None
    return Expression(repr(read_number(where, given, "must be a number or an expression in quotes")))


def read_number(where: str, given: object, right: str = "must be a number", infinite: bool = False) -> float:
    """The value as a float."""
    if isinstance(given, bool) or not isinstance(given, Real):
        raise _found(where, given, right)
    try:
        number = float(given) + 0.0  # -0.0 becomes 0.0: equal definitions have one digest
    except OverflowError:
        raise _found(where, given, "must be a finite number") from None
    if math.isnan(number) or (math.isinf(number) and not infinite):
        raise DefinitionError(f"{where}: found {number!r}, must be a finite number")
    return number


def read_table(where: str, given: object, keys: Collection[str] = ()) -> Mapping[str, Any]:
    """The value, a table that has these keys at most, or any; DefinitionError for anything else."""
    if not isinstance(given, Mapping) or not all(isinstance(key, str) for key in given):
        raise _found(where, given, "must be a table")
    for key in given:
        if keys and key not in keys:
            raise DefinitionError(unknown_name(f"key in {where}", key, keys))
    return given


def read_list(
    where: str, given: object, length: int, what: str = "entries", each: str = ", one per coordinate"
) -> list[Any]:
    """The value, a list of that length; DefinitionError for anything else."""
    if not isinstance(given, list | tuple):
        raise _found(where, given, f"must be a list of {length} {what}{each}")
    if len(given) != length:
        raise DefinitionError(f"{where}: found {len(given)} {what}, must be {length}{each}")
    return list(given)


def required(table: Mapping[str, Any], key: str) -> Any:
    """The value of a key that has to be there."""
    if key not in table:
        raise DefinitionError(f"system: {key} missing")
    return table[key]


def symbol_of(name: str) -> str:
    r"""A name as mathtext: ``\mu_{m}`` of mu_m, ``x_{1}`` of x1, words upright."""
    base, underscore, rest = name.partition("_")
    stem = base.rstrip("0123456789")
    below = base[len(stem) :] + ("," if base != stem and underscore else "") + rest.replace("_", ",")
    sign = f"\\{stem}" if stem in _GREEK else stem if len(stem) == 1 else rf"\mathrm{{{stem}}}"
    return sign + (f"_{{{below}}}" if below else "")


def _names(where: str, given: object) -> tuple[str, ...]:
    if not isinstance(given, list | tuple):
        raise _found(where, given, "must be a list of names")
    for i, name in enumerate(given):
        _check_name(f"{where}[{i}]", name)
    return tuple(given)


def _check_name(where: str, name: object) -> None:
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise _found(where, name, "must be a name of letters, digits and underscores, 40 at most")
    if name in RESERVED:
        raise _taken(where, name)


def refuse_taken(definition: Definition, parameters: Iterable[Parameter]) -> None:
    """DefinitionError at the first name that is one of an atlas's own."""
    names = [(f"system.coordinates[{i}]", name) for i, name in enumerate(definition.coordinates)]
    names += [(f"system.velocities[{i}]", name) for i, name in enumerate(definition.velocities)]
    for where, name in [*names, *((f"system.parameters.{p.name}", p.name) for p in parameters)]:
        if is_taken(name):
            raise _taken(where, name)


def _taken(where: str, name: str) -> DefinitionError:
    return DefinitionError(f"{where}: {name!r} has another meaning already; choose another name")


def _read_words(where: str, value: object, default: str) -> str:
    """Words on one line that can stand beside a formula."""
    found = read_text(where, value, default)
    if not found.isprintable() or "$" in found or len(found) > 200:
        raise _found(where, value, "must be one line of at most 200 characters without a dollar")
    return found


def _read_flag(where: str, given: object) -> bool:
    if not isinstance(given, bool):
        raise _found(where, given, "must be true or false")
    return given


def _found(where: str, value: object, right: str) -> DefinitionError:
    try:
        shown = _short.repr(value)
    except ValueError:  # a whole number of more digits than Python writes
        shown = "a whole number of thousands of digits"
    return DefinitionError(f"{where}: found {shown}, {right}")
