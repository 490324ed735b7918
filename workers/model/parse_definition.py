"""Conversion of a TOML table to a definition and its parameters, with every error in one line."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from functools import partial
from numbers import Real
from typing import Any

import numpy as np

from workers.model.definition import Definition
from workers.model.entries import (
    DefinitionError,
    check_name,
    fault,
    name_taken,
    read_constant,
    read_entries,
    read_flag,
    read_list,
    read_names,
    read_table,
    read_text,
    read_words,
)
from workers.model.expression import Expression
from workers.model.measures import read_measures
from workers.model.parameter import OMEGA, PHASE, TAU, Parameter, unknown_name
from workers.model.parse_elements import check_element_count, read_contacts, read_friction, read_phases, read_springs
from workers.model.parse_force import is_unforced, read_force
from workers.model.reserved_names import is_taken
from workers.model.smooth import SMOOTH_PHASES, STEPS

MAX_COORDINATES = 8
"""Maximum number of coordinates of a system."""
MANY = 64
"""Maximum number of parameters, and of names in ``let``, of a system."""

_GREEK = (
    "alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "kappa", "lambda", "mu", "nu", "xi", "rho",
    "sigma", "tau", "phi", "chi", "psi", "omega", "Gamma", "Delta", "Theta", "Lambda", "Xi", "Sigma", "Phi", "Psi",
    "Omega",
)  # fmt: skip
_read_end = partial(read_constant, infinite=True)
PARAMETER_KEYS: dict[str, Any] = {
    "default": read_constant, "low": _read_end, "high": _read_end, "low_open": read_flag, "high_open": read_flag,
    "symbol": read_words, "unit": read_words, "meaning": read_words,
}  # fmt: skip


def read_parameters(
    machine: Mapping[str, Any], coordinates: tuple[str, ...], velocities: tuple[str, ...]
) -> tuple[Parameter, ...]:
    """Return all parameters of a table [system]: omega, the system's own, tau, then the initial values.

    The initial values are those of coordinates and velocities. Omega and tau of a force, and the initial values, need
    no entry: the table may change their default, range and words. A single number or expression is a default. With a
    period there is no omega. The formulas of initial values are as written, see ``with_formulas``.
    """
    entries, unforced = read_table("system.parameters", machine.get("parameters", {})), is_unforced(machine)
    for name in (OMEGA, TAU) if unforced else ():
        if name in entries:
            raise DefinitionError(f"system.parameters.{name}: found in a machine without a force; give force too")
    if OMEGA in entries and "period" in machine:
        raise DefinitionError(f"system.parameters.{OMEGA}: found beside system.period, which decides it; leave one out")
    if len(entries) > MANY:
        raise DefinitionError(f"system.parameters: found {len(entries)}, must be at most {MANY}")
    frequency = [] if unforced or "period" in machine else [OMEGA]
    of_force = [
        Parameter(OMEGA, r"\omega", "1", "forcing frequency", 1.0, low=0.0, low_open=True),
        Parameter(TAU, r"\tau", "rad", "phase of the force at t = 0", 0.0),
    ]
    built_in = [
        *([] if unforced else of_force[1 - len(frequency) :]),
        *(Parameter(name, f"{symbol_of(name)}(0)", "1", "initial displacement", 0.0) for name in coordinates),
        *(
            Parameter(name, rf"\dot {symbol_of(of)}(0)", "1", "initial velocity", 0.0)
            for name, of in zip(velocities, coordinates, strict=True)
        ),
    ]
    for name in (*coordinates, *velocities):
        for key in ("low", "high"):
            if isinstance(entries.get(name), Mapping) and key in entries[name]:
                where = f"system.parameters.{name}.{key}"
                raise DefinitionError(f"{where}: an initial value has no range, since only the stops limit it")
    known = {parameter.name: parameter for parameter in built_in}
    added = [name for name in entries if name not in known]
    starts = {*coordinates, *velocities}
    parameters = known | {
        name: _read_parameter(name, one, known.get(name), name in starts) for name, one in entries.items()
    }
    return tuple(parameters[name] for name in (*frequency, *added, *list(known)[len(frequency) :]))


def _read_parameter(name: str, value: object, base: Parameter | None, starts: bool) -> Parameter:
    """Return a parameter; one that ``starts`` a motion has an expression as its formula, without a default."""
    where = f"system.parameters.{name}"
    table = dict(read_table(where, {"default": value} if isinstance(value, Real | str) else value, PARAMETER_KEYS))
    check_name(where, name)
    if base is not None and starts and isinstance(table.get("default"), str):
        base = replace(base, formula=table.pop("default"))
    if base is None and "default" not in table:
        raise DefinitionError(f"{where}: default missing; give a number")
    read = {key: PARAMETER_KEYS[key](f"{where}.{key}", value) for key, value in table.items()}
    parameter = replace(base or Parameter(name, symbol_of(name), "1", name, 0.0), **read)
    if not parameter.low <= parameter.high:
        raise DefinitionError(
            f"{where}: found low {parameter.low:g} above high {parameter.high:g}, must be low <= high"
        )
    if name == OMEGA and not (parameter.low > 0.0 or (parameter.low == 0.0 and parameter.low_open)):
        raise DefinitionError(f"{where}.low: found {parameter.low:g}, must be 0 with low_open = true, or more")
    if not parameter.admits(parameter.default):
        raise DefinitionError(f"{where}.default: found {parameter.default:g}, must satisfy {parameter.range}")
    return parameter


def with_formulas(parameters: Iterable[Parameter], definition: Definition) -> tuple[Parameter, ...]:
    """Return the parameters with the formulas of initial values in normal form, and their values at the defaults."""
    states, completed = {*definition.coordinates, *definition.velocities}, []
    known = [p.name for p in parameters if p.name not in states] + [name for name, _ in definition.let]
    known += [OMEGA] if definition.period else []
    defaults = {p.name: np.array([p.default]) for p in parameters}
    for parameter in parameters:
        if parameter.formula:
            where = f"system.parameters.{parameter.name}.default"
            formula = read_entries(where, parameter.formula, known)
            (value,) = definition.value(formula, defaults)
            if not np.isfinite(value):
                raise DefinitionError(f"{where}: found {value:g} at the defaults, must be a finite number")
            parameter = replace(parameter, default=float(value), formula=formula.text if formula.names else "")
        completed.append(parameter)
    return tuple(completed)


def read_coordinates(table: Mapping[str, Any]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of the coordinates and velocities.

    The default name of a velocity is v with the number at the end of its coordinate's name: v1 for x1, v for y.
    """
    coordinates = read_names("system.coordinates", table["coordinates"])
    if not 1 <= len(coordinates) <= MAX_COORDINATES:
        raise DefinitionError(f"system.coordinates: found {len(coordinates)}, must be 1 to {MAX_COORDINATES}")
    if "velocities" in table:
        velocities = read_names(
            "system.velocities", read_list("system.velocities", table["velocities"], len(coordinates))
        )
    else:
        velocities = tuple("v" + name[len(name.rstrip("0123456789")) :] for name in coordinates)
    names = (*coordinates, *velocities)
    for name in names:
        if name in (OMEGA, TAU):
            raise DefinitionError(f"system.coordinates: {name} is a parameter of the force; choose another name")
        if names.count(name) > 1:
            twice = f"found {name} twice in {', '.join(names)}"
            raise DefinitionError(f"system.coordinates: {twice}; give velocities = [...] too")
    return coordinates, velocities


def read_definition(
    table: Mapping[str, Any], parameters: Collection[str], coordinates: tuple[str, ...], velocities: tuple[str, ...]
) -> Definition:
    """Return the definition of a table [system] with these parameters, coordinates and velocities."""
    n = len(coordinates)
    # The initial state is not part of the machine.
    known = [name for name in parameters if name not in (*coordinates, *velocities)]
    within, steps = _read_bound(table, parameters)
    period = _read_period(table, known)
    known += [] if period is None else [OMEGA]
    let = _read_let(table.get("let", {}), known if within is None else [*known, PHASE], {*parameters, *known})
    moving = {PHASE} if within is not None else set()
    for name, expression in let:
        moving |= {name} if expression.names & moving else set()
    known = [*known, *(name for name, _ in let if name not in moving)]
    smooth = [*known, *sorted(moving)]
    matrix, row = np.zeros((n, n)).tolist(), np.zeros(n).tolist()
    damping = read_entries("system.damping", table.get("damping", matrix), smooth, n, n)
    stiffness = read_entries("system.stiffness", table.get("stiffness", matrix), smooth, n, n)
    load = read_entries("system.load", table.get("load", row), smooth, n)
    contacts, friction = read_contacts(table, known, n, smooth), read_friction(table, known, n, smooth)
    springs = read_springs(table, known, n)
    check_element_count(contacts, friction, springs)
    phases = read_phases(table, known, n, contacts, friction, smooth)
    harmonics = read_force(table, known, n)
    definition = Definition(
        coordinates=coordinates,
        velocities=velocities,
        mass=read_entries("system.mass", table["mass"], known, n, n),
        damping=damping,
        stiffness=stiffness,
        harmonics=harmonics,
        load=load,
        contacts=contacts,
        let=let,
        friction=friction,
        phases=phases,
        drift=_read_drift(table.get("drift"), coordinates, is_unforced(table)),
        measures=read_measures(table.get("measures", {}), known, n),
        springs=springs,
        period=period,
        within=within,
        steps=steps,
    )
    if within is not None and PHASE not in definition.used:
        raise DefinitionError(f"system.within: found without an entry that is an expression of {PHASE}; leave it out")
    return definition


def _read_bound(table: Mapping[str, Any], parameters: Collection[str]) -> tuple[float | None, int | None]:
    """Return error bound and number of steps of coefficients that are expressions of PHASE; None if not given."""
    if "within" not in table:
        if "steps" in table:
            raise DefinitionError("system.steps: found without within, the error bound that needs steps; give within")
        return None, None
    within, steps = read_constant("system.within", table["within"]), table.get("steps")
    if within <= 0.0:
        raise fault("system.within", within, "must be above 0, the largest error of a period as a share")
    phases = table.get("phases")
    most = SMOOTH_PHASES // (2 * len(phases) if isinstance(phases, list) and phases else 2)
    if steps is not None and (type(steps) is not int or steps % 2 or not STEPS <= steps <= most):
        raise fault("system.steps", steps, f"must be an even number from {STEPS} to {most}, or left out")
    if PHASE in parameters:
        raise DefinitionError(f"system.parameters.{PHASE}: found beside within, where {PHASE} is 0 to 2 pi; rename it")
    return within, steps


def _read_period(table: Mapping[str, Any], known: Collection[str]) -> Expression | None:
    """Return the period 2 pi / omega as an expression of parameters; None if omega is a parameter itself."""
    if "period" not in table:
        return None
    if is_unforced(table):
        raise DefinitionError("system.period: found in a machine without a force; give force too")
    period: Expression = read_entries("system.period", table["period"], known)
    return period


def _read_drift(value: object, coordinates: Collection[str], unforced: bool) -> str:
    """Return the coordinate that may drift; empty if there is none."""
    if value is None:
        return ""
    name = read_text("system.drift", value)
    if name not in coordinates:
        raise DefinitionError(unknown_name("coordinate in system.drift", name, coordinates))
    if unforced:
        raise DefinitionError(
            "system.drift: found in a machine without a force; a drift is per forcing period: give force too"
        )
    return name


def _read_let(value: object, known: list[str], reserved: Collection[str]) -> tuple[tuple[str, Expression], ...]:
    """Return the entries of the table ``let``, names for expressions, each before the expressions that use it.

    known     names that the expressions may use besides each other
    reserved  names of parameters, which ``let`` may not define again
    """
    table = read_table("system.let", value)
    if len(table) > MANY:
        raise DefinitionError(f"system.let: found {len(table)} names, must be at most {MANY}")
    for name in table:
        check_name(f"system.let.{name}", name)
        if name in reserved:
            raise DefinitionError(f"system.let.{name}: {name} is a parameter already; choose another name")
    waiting = {name: read_entries(f"system.let.{name}", entry, [*known, *table]) for name, entry in table.items()}
    ready: list[tuple[str, Expression]] = []
    while waiting:
        free = next((name for name, expression in waiting.items() if not expression.names & waiting.keys()), None)
        if free is None:
            chain = [next(iter(waiting))]
            while chain.count(chain[-1]) < 2:
                chain.append(min(waiting[chain[-1]].names & waiting.keys()))
            circle = " uses ".join(chain[chain.index(chain[-1]) :])
            raise DefinitionError(
                f"system.let: found the circle {circle}; define one of these names without the others"
            )
        ready.append((free, waiting.pop(free)))
    return tuple(ready)


def symbol_of(name: str) -> str:
    r"""Return a name as mathtext: ``\mu_{m}`` for mu_m, ``x_{1}`` for x1, words in italics."""
    base, underscore, rest = name.partition("_")
    stem = base.rstrip("0123456789")
    below = base[len(stem) :] + ("," if base != stem and underscore else "") + rest.replace("_", ",")
    sign = f"\\{stem}" if stem in _GREEK else stem if len(stem) == 1 else rf"\mathit{{{stem}}}"
    return sign + (f"_{{{below}}}" if below else "")


def check_not_reserved(definition: Definition, parameters: Iterable[Parameter]) -> None:
    """Raise DefinitionError at the first coordinate, velocity or parameter with a name that an atlas uses itself."""
    names = {f"system.coordinates[{i}]": name for i, name in enumerate(definition.coordinates)}
    names |= {f"system.velocities[{i}]": name for i, name in enumerate(definition.velocities)}
    for where, name in (names | {f"system.parameters.{p.name}": p.name for p in parameters}).items():
        if is_taken(name):
            raise name_taken(where, name)
