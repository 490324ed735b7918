"""Systems: the packaged ones, and definitions by users in the same form."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workers.model.build import build
from workers.model.chain import CHAINS, chain
from workers.model.definition import Definition
from workers.model.definition_checks import check_at_defaults
from workers.model.elements import ALWAYS
from workers.model.entries import DefinitionError, fault, read_constant, read_list, read_table, read_text
from workers.model.expression import Expression
from workers.model.measures import check_unambiguous, element_variables, law_variables, measure_variables
from workers.model.mode_table import build_hybrid
from workers.model.observables import Observable, observables_of
from workers.model.oscillator import Array, take_one
from workers.model.parameter import OMEGA, TAU, Parameter, unknown_name, usual_values
from workers.model.parse_definition import (
    check_not_reserved,
    read_coordinates,
    read_definition,
    read_parameters,
    with_formulas,
)
from workers.model.reserved_names import NAMES
from workers.model.smooth import errors, fewest_steps
from workers.model.toml_text import parse_toml, read_toml
from workers.results import (
    CYCLE_PERIOD,
    DRIFT_PER_PERIOD,
    ENERGY_ERROR,
    NO_REASON,
    OUT_OF_RANGE,
    REGIME,
    InvalidError,
    Variable,
    in_time,
    of_friction,
    result_variables,
)
from workers.settings import Settings

DEFAULT = "two-mass"
SYSTEMS = resources.files("workers.model") / "systems"
TEXTS = ("title", "source", "equation", "picture")
PROSE = (*TEXTS, "axes")
"""Keys that affect no number."""
KEYS = (
    "name", "version", *PROSE, "coordinates", "velocities", "mass", "damping", "stiffness", "force", "phase",
    "cosine", "harmonics", "period", "load", "gap", "upper", "lower", "restitution", "contacts", "friction", "phases",
    "drift", "springs", "measures", "within", "steps", "let", "parameters",
)  # fmt: skip
LATEST = 1_000_000
"""Maximum version of a definition."""
_PARAMETER_PROSE = ("symbol", "unit", "meaning", "default")  # a spec holds all values, and needs only formulas


@dataclass(frozen=True)
class System:
    """A vibro-impact system: its parameters, the names of its physical state, and its definition.

    name        name of the system
    parameters  its parameters, initial values included
    definition  its entries as expressions
    version     version of the definition, raised when a packaged definition changes a number
    packaged    True if the name alone identifies it
    axes        axes of the usual map, each (name of a parameter, low, high)
    title       title, for pictures and lists
    source      reference of the system
    equation    equation of motion, as text
    picture     drawing of the machine, as text

    ``states`` has the components of the physical section state in order, displacements, then velocities. Each is also a
    parameter, the initial value at t = 0.
    """

    name: str
    parameters: tuple[Parameter, ...]
    definition: Definition
    version: int
    packaged: bool
    axes: tuple[tuple[str, float, float], ...]
    title: str
    source: str = ""
    equation: str = ""
    picture: str = ""

    @classmethod
    def from_mapping(cls, table: Mapping[str, Any]) -> "System":
        """Return the system of a table [system]; raise DefinitionError, a ValueError in one line, for any fault."""
        system = _read(table, packaged=False)
        check_not_reserved(system.definition, system.parameters)
        check_unambiguous(system._own, NAMES.union(parameter.name for parameter in system.parameters))
        return system

    @classmethod
    def from_toml(cls, source: str | Path) -> "System":
        """Return the system of a TOML file with one table [system], from the file's path or text.

        A text of one line that ends in .toml is a path. Raise ValueError, in one line that names the file and the
        entry, for any fault.
        """
        if isinstance(source, str) and ("\n" in source or ("=" in source and not source.endswith(".toml"))):
            return cls.from_mapping(_only_system(parse_toml(source)))
        try:
            return cls.from_mapping(_only_system(read_toml(Path(source))))
        except ValueError as error:
            raise DefinitionError(f"{source}: {error}") from None

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the components of the physical state: displacements, then velocities."""
        return (*self.definition.coordinates, *self.definition.velocities)

    @property
    def exponents(self) -> int:
        """Number of Lyapunov exponents of a motion: one per component of the state, none for a drifting position."""
        return len(self.states) - bool(self.definition.drift)

    @property
    def unused_parameters(self) -> tuple[str, ...]:
        """Names of the system's own parameters that no entry of the definition uses: they have no effect."""
        without = {OMEGA, TAU, *self.states, *self.definition.used}
        return tuple(parameter.name for parameter in self.parameters if parameter.name not in without)

    @property
    def has_modes(self) -> bool:
        """True if the equations of motion change in other ways than by impacts on one rigid contact.

        Such a machine has soft contacts, several or no contacts, friction, phases, springs with a law, or no force. It
        moves through modes, sets of linear equations, see model/hybrid_modes.py.
        """
        definition = self.definition
        elements = definition.friction or definition.phases or definition.springs or definition.within
        return bool(elements) or definition.unforced or [contact.rigid for contact in definition.contacts] != [True]

    def with_steps(self, within: float | None) -> "System":
        """Return the system with the fewest steps in the place of smooth coefficients within a bound, see smooth.py.

        The bound holds at the defaults and, for each two usual axes, at their ends and middles. It is unchanged without
        such coefficients. Raise DefinitionError if the steps are too many.
        """
        if within is None:
            return self
        definition = replace(self.definition, within=within, steps=None)
        values, phases = usual_values(self.parameters, self.axes), len(definition.phases or ALWAYS)
        steps = fewest_steps(lambda steps: replace(definition, steps=steps).machines(values), phases, within)
        return replace(self, definition=replace(definition, steps=steps))

    def step_errors(self, values: Mapping[str, Array] | None = None) -> Array:
        """Return the error (N,) by the steps in the place of smooth coefficients, see ``smooth.errors``.

        The machines are those at values (N,) of each parameter, by default those of ``with_steps``.
        """
        definition = self.definition
        values = usual_values(self.parameters, self.axes) if values is None else values
        return errors(lambda steps: replace(definition, steps=steps).machines(values), definition.pieces // 2)

    @property
    def _own(self) -> list[tuple[str, Variable]]:
        """Pairs (entry, variable) of ``own_variables``; the entry is the key that asks for the variable."""
        elements = element_variables(self.definition.contacts, self.definition.friction) if self.has_modes else ()
        drifts = [("system.drift", DRIFT_PER_PERIOD)] if self.definition.drift else []
        cycles = [("system", CYCLE_PERIOD)] if self.definition.unforced else []
        cycles += [("system", ENERGY_ERROR)] if self.definition.unforced and not self.definition.friction else []
        laws = law_variables(self.definition.fitted)
        return [*measure_variables(self.definition.measures), *elements, *laws, *drifts, *cycles]

    @property
    def regime(self) -> Variable:
        """Result variable for the regime of a motion, described in words that suit machines with or without a force."""
        return in_time(REGIME) if self.definition.unforced else REGIME

    @property
    def own_variables(self) -> tuple[Variable, ...]:
        """Result variables that only this system has, such as those of its contacts, friction and measures."""
        variables = tuple(variable for _, variable in self._own)
        return tuple(map(in_time, variables)) if self.definition.unforced else variables

    def variables(self, settings: Settings, attractors: bool = False, basins: bool = False) -> tuple[Variable, ...]:
        """Return the variables of all results of a cell: those of every system, and those of this system alone.

        settings    settings of the solver, which may add results
        attractors  True for cells with all their attractors
        basins      True for cells of basins of attraction

        The results of every system are described in ``results.result_variables``.
        """
        observed = tuple(variable for observable in self.observables(settings) for variable in observable.variables)
        variables = result_variables(settings, attractors, basins, self.own_variables + observed)
        if self.definition.friction:
            stops = any(contact.rigid for contact in self.definition.contacts)
            variables = tuple(of_friction(variable, stops) for variable in variables)
        return tuple(map(in_time, variables)) if self.definition.unforced else variables

    def observables(self, settings: Settings) -> tuple[Observable, ...]:
        """Return the observables named in the settings.

        Raise ValueError, in one line, for an observable that its machines do not have, or whose results would take the
        name of another result.
        """
        try:
            observables = observables_of(settings.observe, self.definition)
        except ValueError as error:
            raise DefinitionError(f"observe: {error}") from None
        if self.definition.unforced and settings.method == "fixed":
            raise DefinitionError('method: found "fixed", must be "adaptive" for a machine without a force')
        names = NAMES.union(variable.name for variable in self.own_variables)
        results = (variable for observable in observables for variable in observable.variables)
        check_unambiguous((("observe", variable) for variable in results), names)
        return observables

    def must_offer(self, what: str, unforced: bool = False) -> None:
        """Raise DefinitionError, in one line, if results of the kind ``what`` do not exist for this system.

        what      the results, a noun in the plural such as "branches"
        unforced  True if these results exist for machines without a force

        They never exist if a coordinate drifts.
        """
        if not unforced:
            self.must_have_force(what)
        if self.definition.drift:
            raise DefinitionError(f"system {self.name!r}: {what} do not exist if a coordinate drifts")

    def must_have_force(self, what: str) -> None:
        """Raise DefinitionError, in one line, if the system has no force, without which ``what`` does not exist."""
        if self.definition.unforced:
            raise DefinitionError(f"system {self.name!r}: {what} do not exist for a machine without a force")

    def with_cycle(self, values: Mapping[str, Array], cycle: float | None) -> dict[str, Array]:
        """Return values (N,) of each parameter, with omega such that a period of the machine has the length ``cycle``.

        The length is that of a limit cycle of machines without a force. The values are unchanged if ``cycle`` is None.
        Raise ValueError for a length if there is a force.
        """
        if cycle is None:
            return dict(values)
        if not self.definition.unforced:
            raise ValueError(
                f"cycle: found {cycle:g}, must be left out: system {self.name!r} has the period of its force"
            )
        return dict(values) | {OMEGA: np.full_like(next(iter(values.values())), 2.0 * np.pi / cycle)}

    def complete(self, given: Mapping[str, ArrayLike]) -> dict[str, Array]:
        """Return every parameter, with its default if missing, as arrays of one shape.

        A default with a formula is its value at the other parameters. Raise KeyError for an unknown name, and
        ValueError for shapes that do not broadcast.
        """
        for name in given:
            self.parameter(name)
        grids = np.broadcast_arrays(*(np.asarray(given.get(p.name, p.default), np.float64) for p in self.parameters))
        values = {p.name: grid for p, grid in zip(self.parameters, grids, strict=True)}
        for parameter in self.parameters:
            if parameter.formula and parameter.name not in given:
                flat = {name: grid.ravel() for name, grid in values.items()}
                start = self.definition.value(Expression(parameter.formula), flat)
                values[parameter.name] = start.reshape(grids[0].shape)
        return values

    def build(self, values: Mapping[str, float]) -> Any:
        """Return the oscillator at one value of each parameter; raise InvalidError, a ValueError, if it is invalid."""
        oscillators, reasons = self.build_many({k: np.array([v], dtype=np.float64) for k, v in values.items()})
        if reasons[0] != NO_REASON:
            raise InvalidError(int(reasons[0]))
        return take_one(oscillators, 0)

    def build_many(self, values: Mapping[str, Array]) -> tuple[Any, NDArray[np.int8]]:
        """Return the oscillators at values (N,) of each parameter, and codes (N,) of the reasons why one is invalid.

        The code of a valid oscillator is NO_REASON.
        """
        machines = self.definition.machines(values)
        oscillators, reasons = build_hybrid(machines) if self.has_modes else build(machines)
        return oscillators, self.out_of_range(values, reasons)

    def out_of_range(self, values: Mapping[str, Array], reasons: NDArray[np.int8]) -> NDArray[np.int8]:
        """Return the codes ``reasons`` (N,), with OUT_OF_RANGE where a value (N,) of a parameter is out of its range.

        ``reasons``, why machines are invalid, changes in place.
        """
        admitted = [p.admits(values[p.name]) for p in self.parameters if p.name in values]
        if self.definition.period:
            omega, _ = self.definition.forcing(values)
            admitted.append((omega > 0.0) & (omega < np.inf))
        reasons[~np.logical_and.reduce(admitted)] = OUT_OF_RANGE
        return reasons

    def parameter(self, name: str) -> Parameter:
        """Return the parameter of this name; raise KeyError, with the nearest known name, if there is none."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(self.unknown_name_message(name))

    def unknown_name_message(self, name: str, kind: str = "parameter") -> str:
        """Return the one-line error message for an unknown name; ``kind`` is the noun before the name."""
        if self.definition.unforced and name in (OMEGA, TAU):
            return f"{kind} {name!r}: system {self.name!r} has no force; leave this name out"
        if self.definition.period and name == OMEGA:
            period = self.definition.period.text
            return f"{kind} {name!r}: in system {self.name!r} it is 2 pi / period, with the period {period}"
        return unknown_name(kind, name, [parameter.name for parameter in self.parameters])

    def table(self) -> dict[str, Any]:
        """Return the whole system as plain JSON in a normal form, of which ``from_mapping`` makes an equal system."""
        table: dict[str, Any] = {"name": self.name, "version": self.version}
        table |= {key: text for key in TEXTS if (text := getattr(self, key))} | self.definition.table()
        if self.axes:
            table["axes"] = {name: [low, high] for name, low, high in self.axes}
        return table | {"parameters": {p.name: p.table() for p in self.parameters}}

    def to_resolved(self) -> dict[str, Any]:
        """Return the entry in a store, enough for ``from_resolved``.

        It is the name of a packaged system, with its version from the second on, or the whole definition of any other
        system.
        """
        if not self.packaged:
            return {"system": self.table()}
        return {"system": self.name} | ({"system_version": self.version} if self.version > 1 else {})

    @classmethod
    def from_resolved(cls, resolved: Mapping[str, Any]) -> "System":
        """Return the system of an entry made by ``to_resolved``.

        Raise DefinitionError or KeyError if this program does not have the system.
        """
        system = resolved["system"]
        # Names that an atlas has reserved since the store was made are accepted: the store can be read.
        record = packaged_system(system) if isinstance(system, str) else _read(system, packaged=False)
        version = resolved.get("system_version", 1)
        if record.packaged and record.version != version:
            raise DefinitionError(
                f"system: found {record.name} of version {version}, installed is version {record.version}"
            )
        return record


def identity(resolved: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of ``System.to_resolved`` that decides numbers, for a digest.

    It is the name of a packaged system, or a definition without its words.
    """
    system = resolved["system"]
    if isinstance(system, str):
        return {key: resolved[key] for key in ("system", "system_version") if key in resolved}
    machine = {key: value for key, value in system.items() if key not in PROSE}
    machine["parameters"] = {
        name: {
            key: value
            for key, value in table.items()
            if key not in _PARAMETER_PROSE or (key == "default" and isinstance(value, str))
        }
        for name, table in system.get("parameters", {}).items()
    }
    return {"system": machine}


def find_system(system: object) -> System:
    """Return the system of this name, path of a .toml file, or table; a System is returned unchanged.

    Raise KeyError, with the nearest known name, for an unknown name, and ValueError for a wrong definition.
    """
    if isinstance(system, System):
        return system
    if isinstance(system, Mapping):
        return System.from_mapping(system)
    if not isinstance(system, str):
        raise DefinitionError(f"system: found {system!r}, must be the name of a system, a path or a table")
    if system.endswith(".toml"):
        return System.from_toml(Path(system))
    return packaged_system(system)


@cache
def packaged_system(name: str) -> System:
    """Return the packaged system of this name; raise KeyError, with the nearest known name, if there is none."""
    if name not in system_names():
        raise KeyError(unknown_name("system", name, system_names()))
    file = SYSTEMS / f"{'chain' if name in CHAINS else name}.toml"
    table = _only_system(parse_toml(file.read_text(encoding="utf-8")))
    return _read(chain(table, CHAINS[name]) if name in CHAINS else table, packaged=True)


@cache
def system_names() -> tuple[str, ...]:
    """Return the names of the packaged systems, with the default first."""
    files = {item.name.removesuffix(".toml") for item in SYSTEMS.iterdir() if item.name.endswith(".toml")}
    return (DEFAULT, *sorted(files.union(CHAINS) - {DEFAULT, "chain"}))


def _only_system(tables: Mapping[str, Any]) -> Mapping[str, Any]:
    if "system" not in tables or len(tables) > 1:
        names = shorten(", ".join(tables) or "none", 60, placeholder=" ...")
        raise DefinitionError(f"found {names}, must be one table [system]")
    return read_table("system", tables["system"])


def _read(value: Mapping[str, Any], packaged: bool) -> System:
    table = read_table("system", value, KEYS)
    for key in ("coordinates", "mass"):
        if key not in table:
            raise DefinitionError(f"system: {key} missing")
    name = read_text("system.name", table.get("name"))
    if not name or len(name) > 40 or not name.replace("-", "").replace("_", "").isalnum() or not name.isascii():
        raise DefinitionError(f"system.name: found {name[:60]!r}, must be letters, digits and hyphens, 40 at most")
    version = table.get("version", 1)
    if isinstance(version, bool) or not isinstance(version, int) or version < 1:
        raise fault("system.version", version, "must be a whole number, 1 or more")
    if version > LATEST:
        raise fault("system.version", version, f"must be at most {LATEST}")
    coordinates, velocities = read_coordinates(table)
    parameters = read_parameters(table, coordinates, velocities)
    names = [parameter.name for parameter in parameters]
    definition = read_definition(table, names, coordinates, velocities)
    check_at_defaults(definition, parameters)
    parameters = with_formulas(parameters, definition)
    texts = {"title": name} | {key: read_text(f"system.{key}", table[key]) for key in TEXTS if key in table}
    axes = _read_axes(table.get("axes", {}), names)
    system = System(name, parameters, definition, version, packaged, axes, **texts)
    if definition.steps is None and definition.within is not None:
        system = system.with_steps(definition.within)
        check_at_defaults(system.definition, parameters)
    return system


def _read_axes(value: object, names: list[str]) -> tuple[tuple[str, float, float], ...]:
    """Return the usual axes of an entry such as ``{ omega = [1.0, 4.0] }``."""
    axes = []
    for name, ends in read_table("system.axes", value).items():
        where = f"system.axes.{name}"
        if name not in names:
            raise DefinitionError(unknown_name("parameter in system.axes", name, names))
        low, high = (read_constant(where, end) for end in read_list(where, ends, 2, "numbers", ""))
        if not low < high:
            raise DefinitionError(f"{where}: found {low:g} and {high:g}, must rise")
        axes.append((name, low, high))
    return tuple(axes)
