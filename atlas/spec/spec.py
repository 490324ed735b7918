"""The spec of an atlas: everything that determines its numbers, checked when the spec is created."""

import json
from collections.abc import Iterable, Mapping
from copy import copy
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from atlas.argument_checks import is_integer, validate_atlas, validate_path, validate_type
from atlas.errors import InputError, brief_repr, check_names
from atlas.spec.attractors import attractors_to_json, parse_attractors
from atlas.spec.axis import Axis, read_axis, validate_in_range
from atlas.spec.examples import packaged_text
from atlas.spec.points import FILE, Columns, axis_of, describe_points, parse_points
from atlas.spec.resolved import resolved_digest, unpack_axes
from atlas.spec.system import parse_system, resolved_system
from workers import Settings
from workers.attractors.initial_states import AttractorSettings
from workers.model.observables import VALUE
from workers.model.system import System
from workers.model.toml_text import TomlError, parse_toml, read_toml
from workers.results import ATTRACTOR, Variable

SECTIONS = ("system", "parameters", "axes", "points", "solve", "attractors", "store")
MAX_AXES = 3
FORMS = {1: "one whole number in brackets", 2: "two whole numbers (y, x)", 3: "three whole numbers (1, y, x)"}
"""Valid form of the shape of a tile, as text for messages, by the number of axes."""
SETTING_MEANINGS = {
    "exponents": "Which Lyapunov exponents.",
    "tolerance": "Standard error of the largest exponent at which a chaotic cell stops.",
    "max_periods": "Maximum forcing periods for deciding the regime, and for averaging.",
    "survival": "Further periods for which apparently chaotic motion may be watched.",
    "method": "adaptive; or fixed: a transient is dropped, then exponents are averaged.",
    "transient_periods": "Periods that are dropped, with fixed.",
    "periods": "Periods that are averaged, with fixed.",
    "max_period": "Longest orbit to search for, in forcing periods.",
    "section_samples": "Number of the last section states to store.",
    "observe": "Observables, separated by commas, such as impact_phase:stop.",
    "observe_values": "Number of values of each observable to store.",
}
"""Meaning of each setting by which a cell is solved, as a line of text."""
Slices = tuple[slice, ...]


@dataclass(frozen=True, init=False)
class Spec:
    """The spec of an atlas: a system, its fixed parameters (defaults filled in), its cells, and how to solve them.

    ``Spec("two-mass", axes={"omega": {"start": 2, "stop": 4, "num": 100}}, parameters={"b": 0.15})`` takes the tables
    of the TOML file; an axis may also be a list or array of values. The first axis is x, the last dimension of every
    array. An axis with ``continuation`` is swept: each cell starts from its neighbour's attractor, and a whole line of
    cells is in one tile.

    ``tile`` is the (y, x) shape of a tile, or None for the default; it does not affect any number. ``system`` is the
    name of a packaged system, the path of a .toml file, a table of its form or a ``workers.System``. The spec keeps the
    name as ``system`` and the definition as ``system_def``.

    One axis makes a sweep, two a plane, three a stack of planes: one plane for each value of the third. ``points``
    replaces the axes by a table of parameter sets, one row per cell: its columns by name, or ``{"file": "table.csv"}``.
    The spec's only axis is then the row number, ``point``, and ``points`` has the columns; otherwise ``points`` is
    empty. Columns override ``parameters``. An initial value whose default is an expression is not among ``parameters``,
    unless it is given: each cell has its own.

    ``attractors`` asks for all attractors reached from a number of initial states of a cell. It is a table such as
    ``{"starts": 32, "seed": 0, "box": {"x1": [-0.1, 0.1]}, "keep": 4}``, or a
    ``workers.attractors.initial_states.AttractorSettings``. None asks for the attractor of the cell's own initial
    state. If all axes are components of the initial state, the results are basins: the attractor of each initial state
    of one machine.

    Raise InputError for anything that cannot be solved.

    >>> import atlas
    >>> spec = atlas.Spec("two-mass", {"omega": {"start": 2, "stop": 4, "num": 5}, "b": [0.1, 0.2]}, {"R": 0.6})
    >>> spec.dims, spec.shape, spec.parameters["R"]
    (('b', 'omega'), (2, 5), 0.6)
    """

    system: str
    parameters: dict[str, float]
    axes: tuple[Axis, ...]
    settings: Settings
    tile: tuple[int, ...] | None
    system_def: System = field(repr=False)
    points: Columns = field(repr=False)
    attractors: AttractorSettings | None = None

    def __init__(
        self,
        system: str | Mapping[str, Any] | System,
        axes: Mapping[str, Any] | None = None,
        parameters: Mapping[str, Any] | None = None,
        solve: Mapping[str, Any] | Settings | None = None,
        store: Mapping[str, Any] | None = None,
        points: Mapping[str, Any] | None = None,
        attractors: Mapping[str, Any] | AttractorSettings | None = None,
    ) -> None:
        record = parse_system(system)
        parameters, store = {} if parameters is None else parameters, {} if store is None else store
        if axes is None and points is None:
            raise InputError("axes: found None, must be a table of one to three axes; or give points")
        axes = {} if axes is None else axes
        _check_tables(parameters=parameters, axes=axes, store=store)
        check_parameters(record, parameters)
        check_parameters(record, axes, "parameter in axes")
        if points is not None and axes:
            raise InputError(f"found axes ({', '.join(axes)}) and points; give one of the two")
        if points is None and not 1 <= len(axes) <= MAX_AXES:
            count = f"found {len(axes)} ({', '.join(axes)})" if axes else "found none"
            raise InputError(f"axes: {count}, must be one to three")
        columns = {} if points is None else parse_points(points, record)
        for name in axes:
            if name in parameters:
                raise InputError(f"{name} is both a parameter and an axis; remove one of the two")
        read = tuple(read_axis(record.parameter(name), axis_values) for name, axis_values in axes.items())
        read = (axis_of(columns),) if columns else read
        _check_continuation(read, record)
        fixed = validate_parameters(record, parameters)
        differ = {*(axes or columns), *(p.name for p in record.parameters if p.formula and p.name not in parameters)}
        fixed = {name: value for name, value in fixed.items() if name not in differ}
        settings = observable_settings(_settings_of(solve), record)
        vars(self).update(system=record.name, system_def=record, points=columns, axes=read, parameters=fixed)
        vars(self).update(settings=settings, attractors=parse_attractors(attractors, record, settings))
        vars(self).update(tile=_checked_tile(store, len(read)))
        _check_whole_lines(self)
        if self.attractors is not None and self.continuation is not None:
            raise InputError("attractors: an axis with continuation starts each cell from its neighbour; remove one")

    def __repr__(self) -> str:
        changed_parameters = [
            f"{name} = {value:g}"
            for name, value in self.parameters.items()
            if value != self.system_def.parameter(name).default
        ]
        return f"<Spec of {self.system}: {'; '.join([' x '.join(self.axis_descriptions), *changed_parameters])}>"

    @classmethod
    def from_mapping(cls, tables: Mapping[str, Any], folder: Path | None = None) -> "Spec":
        """Return the spec of a mapping that has the tables of the TOML file.

        The path of a system's file is relative to ``folder``.
        """
        check_names("key", tables, SECTIONS)
        if "system" not in tables:
            raise InputError("system missing")
        if "axes" not in tables and "points" not in tables:
            raise InputError("axes missing; one to three tables [axes.NAME], or [points] with a file")
        system = parse_system(tables["system"], folder)
        points = {"points": parse_points(tables["points"], system, folder)} if "points" in tables else {}
        return cls(**{**tables, **points, "system": system})

    @classmethod
    def from_toml(cls, source: str | Path, points: str | Path | None = None) -> "Spec":
        """Return the spec of a TOML file, or of the packaged example of this name if there is no such file.

        ``points`` is a CSV file of parameter sets that replaces the points of the spec or its axes, which must be
        columns of the file.
        """
        path, where = validate_path(source, "spec"), str(source) or "''"
        try:
            tables = read_toml(path) if path.exists() else parse_toml(packaged_text(str(source)))
            if points is not None:
                tables = _with_points(tables, Path(points), path.parent)
            return cls.from_mapping(tables, path.parent)
        except (InputError, TomlError) as error:
            raise InputError(f"{where}: {error}") from None
        except OSError as error:
            raise InputError(f"{where}: cannot be read: {error.strerror}") from None

    @property
    def dims(self) -> tuple[str, ...]:
        """Dimensions of the arrays, slowest first: ("b", "omega") for axes (omega, b)."""
        return tuple(axis.name for axis in reversed(self.axes))

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of cells along each of ``dims``."""
        return tuple(len(axis) for axis in reversed(self.axes))

    @property
    def axis_descriptions(self) -> tuple[str, ...]:
        """A short text for each axis, or for the table of points."""
        return (describe_points(self.points),) if self.points else tuple(map(str, self.axes))

    @property
    def n_uncoarsened_dims(self) -> int:
        """Number of leading ``dims`` that are never coarsened: the planes of a stack, the rows of a table."""
        return 1 if self.points or len(self.axes) == MAX_AXES else 0

    @property
    def continuation(self) -> tuple[int, bool] | None:
        """The axis along which each cell starts from its neighbour's attractor: its index in ``dims``, and True if
        backward.

        None if all cells are independent.
        """
        for dim, axis in enumerate(reversed(self.axes)):
            if axis.continuation:
                return dim, axis.continuation == "backward"
        return None

    def to_resolved(self) -> dict[str, Any]:
        """Return the spec with all defaults filled in, as a dict for JSON.

        Its digest identifies the spec. ``from_resolved`` builds an equal spec from it.
        """
        points = {"points": {name: list(values) for name, values in self.points.items()}} if self.points else {}
        many = {} if self.attractors is None else {"attractors": attractors_to_json(self.attractors)}
        return (
            self.system_def.to_resolved()
            | {"parameters": self.parameters, "axes": [] if self.points else [axis.to_resolved() for axis in self.axes]}
            | points
            | {"solve": asdict(self.settings)}
            | many
        )

    @classmethod
    def from_resolved(cls, resolved: Mapping[str, Any]) -> "Spec":
        """Build a spec from the result of ``to_resolved``; the shape of the tiles is not part of it."""
        axes = {
            axis["name"]: Axis(axis["name"], tuple(axis["values"]), axis["scale"], axis.get("continuation"))
            for axis in resolved["axes"]
        }
        parts = axes, resolved["parameters"], resolved["solve"]
        many = resolved.get("attractors")
        return cls(resolved_system(resolved), *parts, points=resolved.get("points"), attractors=many)

    @property
    def values(self) -> Columns:
        """Values of the axes by name, or of the columns of the table of points."""
        return self.points or {axis.name: axis.values for axis in self.axes}

    def check_stored_form(self) -> None:
        """Raise InputError unless the JSON of the spec in a store can be read back as an equal spec."""
        stored_form = json.loads(json.dumps(self.to_resolved()))
        try:
            again = Spec.from_resolved(stored_form).to_resolved()
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(f"a store of this spec could not be read: {error}") from None
        if json.loads(json.dumps(again)) != stored_form:
            raise InputError("a store of this spec could not be read: its spec would be another one")

    @classmethod
    def from_dataset(cls, ds: Any) -> "Spec":
        """Return the spec of an atlas that is opened, exported or loaded whole as an xarray Dataset.

        The tile shape is not part of it. Raise InputError if the dataset lacks its spec or some of its cells.
        """
        validate_atlas(ds)
        try:
            spec = cls.from_resolved(unpack_axes(json.loads(ds.attrs["spec"])))
            same = all(tuple(ds[name].values.tolist()) == values for name, values in spec.values.items())
        except InputError:
            raise
        except (KeyError, TypeError, ValueError):
            raise InputError("this dataset lacks the spec of its atlas, or a coordinate") from None
        if not same or ds.attrs.get("digest") != spec.digest:
            raise InputError("this dataset lacks cells of its atlas, or its cells differ from its spec")
        return spec

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The variables with the results of each cell, ``regime`` last."""
        return self.system_def.variables(self.settings, attractors=self.coexistence, basins=self.basins)

    @property
    def extra_sizes(self) -> dict[str, int]:
        """Lengths by name of the dimensions that results of a cell may have after the axes, such as its attractors."""
        attractor_sizes = {ATTRACTOR: self.attractors.keep} if self.attractors is not None and self.coexistence else {}
        sample_sizes = {"sample": self.settings.section_samples, VALUE: self.settings.observe_values}
        return (
            {"exponent": self.system_def.exponents, "state": len(self.system_def.states)}
            | sample_sizes
            | attractor_sizes
        )

    def with_observables(self, observe: str) -> "Spec":
        """Return the same spec with the observables, separated by commas in ``observe``; see ``workers.Settings``."""
        return self._with(settings=observable_settings(replace(self.settings, observe=observe), self.system_def))

    def in_tiles(self, tile: tuple[int, ...]) -> "Spec":
        """Return the same spec with tiles of this shape."""
        return self._with(tile=tile)

    def _with(self, **changed: object) -> "Spec":
        other = copy(self)
        vars(other).update(changed)
        return other

    @property
    def basins(self) -> bool:
        """True if the results are basins: the attractor of each initial state of one machine."""
        return self.attractors is not None and self.has_state_axes

    @property
    def has_state_axes(self) -> bool:
        """True if all axes are components of the initial state, so that the cells belong to one machine."""
        names = [*self.points] if self.points else [axis.name for axis in self.axes]
        return {*self.system_def.states}.issuperset(names)

    @property
    def coexistence(self) -> bool:
        """True if the spec asks for all attractors of each cell."""
        return self.attractors is not None and not self.basins

    @property
    def digest(self) -> str:
        """SHA-256 of everything that determines the numbers of the atlas, see ``resolved_digest``."""
        return resolved_digest(self.to_resolved())

    def cell_params(self, slices: Slices) -> dict[str, float | np.ndarray]:
        """Return the values of all parameters in a block of cells, by name, as ``solve_tile`` takes them.

        Values of axes are arrays that broadcast to the shape of the block.
        """
        params: dict[str, float | np.ndarray] = dict(self.parameters)
        if self.points:
            (rows,) = slices
            return params | {name: np.array(values[rows], dtype="float64") for name, values in self.points.items()}
        for i, (axis, part) in enumerate(zip(reversed(self.axes), slices, strict=True)):
            along = [1] * len(self.axes)
            along[i] = -1
            params[axis.name] = np.array(axis.values[part], dtype="float64").reshape(along)
        return params


def given_values(mapping: Mapping[str, Any] | None, named: Mapping[str, Any]) -> dict[str, Any]:
    """Merge values by name that a caller gave as a mapping, as keywords or both, as in xarray's ``sel``.

    Raise InputError for a name that is given twice.
    """
    if mapping is not None and not isinstance(mapping, Mapping):
        raise InputError(f"found {brief_repr(mapping)}, must be values by name, such as omega=3 or {{'omega': 3}}")
    for name in named:
        if name in (mapping or {}):
            raise InputError(f"{name}: given twice")
    return {**(mapping or {}), **named}


def given_settings(settings: Settings | None) -> Settings:
    """Return the settings that a caller gave; the default settings for None."""
    return Settings() if settings is None else validate_type("settings", settings, Settings, "atlas.Settings(...)")


def check_parameters(system: System, names: Iterable[object], kind: str = "parameter") -> None:
    """Raise InputError at the first name that is no parameter of a system.

    ``kind`` says in the message what the names are.
    """
    known = {parameter.name for parameter in system.parameters}
    for name in names:
        if name not in known:
            raise InputError(system.unknown_name_message(name if isinstance(name, str) else brief_repr(name), kind))


def validate_parameters(system: System, values: Mapping[str, Any]) -> dict[str, float]:
    """Return all parameters of a system by name: the given values, and the defaults of the others.

    Raise InputError for a name that is no parameter, and for a value outside the parameter's range.
    """
    check_parameters(system, values)
    given = {p.name: validate_in_range(p, values[p.name]) for p in system.parameters if p.name in values}
    return {name: float(value) for name, value in system.complete(given).items()}


def parse_settings(table: Mapping[str, Any]) -> Settings:
    """Convert a [solve] table to settings; raise InputError, naming the setting, for a wrong table."""
    if not isinstance(table, Mapping):
        raise InputError(f"solve: found {brief_repr(table)}, must be a table")
    check_names("key in solve", table, [field.name for field in fields(Settings)])
    for name, value in table.items():
        if is_integer(value) and abs(value) >= 2**63:  # no setting is so large, and few messages could show it
            raise InputError(f"solve.{name}: found {brief_repr(value)}, must be less than 2**63")
    # A whole tolerance must have the same digest as the equal float.
    arguments: dict[str, Any] = {
        name: float(value) if name == "tolerance" and is_integer(value) else value for name, value in table.items()
    }
    try:
        return Settings(**arguments)
    except ValueError as error:
        raise InputError(f"solve.{error}") from None


def observable_settings(settings: Settings, system: System) -> Settings:
    """Return the settings unchanged; raise InputError if they name an observable that the system does not have."""
    try:
        system.observables(settings)
    except ValueError as error:
        raise InputError(f"solve.{error}") from None
    return settings


def _with_points(tables: Mapping[str, Any], points: Path, folder: Path) -> dict[str, Any]:
    """Return the tables of a spec with the parameter sets of a CSV file, ``points``, in place of its axes.

    Raise InputError unless each axis is a column of the file.
    """
    check_names("key", tables, SECTIONS)
    if "system" not in tables:
        raise InputError("system missing")
    columns = parse_points({FILE: points}, parse_system(tables["system"], folder))
    axes = tables.get("axes", {})
    for name in axes if isinstance(axes, Mapping) else ():
        if name not in columns:
            raise InputError(f"{name} is an axis but not a column of {points}; add the column or remove the axis")
    replaced = ("axes", "store") if "axes" in tables else ()  # the tile shape of the axes does not fit the rows
    return {**{key: table for key, table in tables.items() if key not in replaced}, "points": columns}


def _settings_of(solve: Mapping[str, Any] | Settings | None) -> Settings:
    return solve if isinstance(solve, Settings) else parse_settings({} if solve is None else solve)


def _check_tables(**tables: object) -> None:
    for name, table in tables.items():
        if not isinstance(table, Mapping):
            raise InputError(f"{name}: found {brief_repr(table)}, must be a table")


def _check_continuation(axes: tuple[Axis, ...], system: System) -> None:
    continued = [axis.name for axis in axes if axis.continuation]
    if len(axes) == MAX_AXES and continued:
        raise InputError(f"axes.{continued[0]}: a stack cannot have a continued axis; compute its planes one by one")
    if len(continued) > 1:
        raise InputError(f"axes: found continuation on {' and '.join(continued)}, must be on one")
    if continued and continued[0] in system.states:
        raise InputError(f"axes.{continued[0]}: an initial state cannot be continued; continue another parameter")


def _check_whole_lines(spec: Spec) -> None:
    if spec.tile is None or spec.continuation is None:
        return
    dim, _ = spec.continuation
    if spec.tile[dim] < spec.shape[dim]:
        raise InputError(
            f"store.tile: found {brief_repr(list(spec.tile))}, must hold whole lines of {spec.dims[dim]}, "
            f"which is continued over {spec.shape[dim]} cells"
        )


def _checked_tile(store: Mapping[str, Any], axes: int) -> tuple[int, ...] | None:
    check_names("key in store", store, ["tile"])
    if "tile" not in store:
        return None
    tile = store["tile"]
    right = isinstance(tile, list | tuple) and len(tile) == axes and all(is_integer(n) and n >= 1 for n in tile)
    if not right:
        raise InputError(f"store.tile: found {brief_repr(tile)}, must be {FORMS[axes]}, each 1 or more")
    if axes == MAX_AXES and tile[0] != 1:
        raise InputError(f"store.tile: found {brief_repr(tile)}, must begin with 1: a tile lies in one plane")
    return tuple(int(n) for n in tile)
