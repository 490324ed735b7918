"""The spec: everything that decides the numbers of an atlas, checked once."""

import hashlib
import json
import re
import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, fields
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from atlas.errors import InputError, check_names, shown
from atlas.spec.axis import Axis, admitted, read_axis
from workers import Settings
from workers.model.system import System, find_system, unknown_name

SECTIONS = ("system", "parameters", "axes", "solve", "store")
FIRST_SETTINGS = (
    "exponents", "tolerance", "max_periods", "method", "transient_periods", "periods", "max_period", "section_samples",
)  # fmt: skip
"""Those of the first version, which enter every digest. A setting added since does not belong here."""
MAX_FILE = 1_000_000
"""Bytes of a spec file: far more than a spec needs, and nothing that could fill the memory."""

_DEEP_KEY = re.compile(r"""^[ \t]*+(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){100}""", re.MULTILINE)
"""A dotted key of a hundred parts: the time that tomllib takes for one grows as the square of their number."""

Slices = tuple[slice, ...]


@dataclass(frozen=True, init=False)
class Spec:
    """What to compute: a system, its fixed parameters (defaults filled in), one or two axes, and how to solve.

    ``Spec("two-mass", axes={"omega": {"start": 2, "stop": 4, "num": 100}}, parameters={"b": 0.15})`` takes what the
    TOML file has in its tables; an axis may also be a sequence of values. The first axis is x, the last dimension
    of every array. An axis with ``continuation`` is swept: each cell starts from its neighbour's attractor, and a
    whole line of cells is in one tile. ``tile`` is the (y, x) shape asked for, or None; it does not change a number.
    Raises InputError for anything that cannot be solved.
    """

    system: str
    parameters: dict[str, float]
    axes: tuple[Axis, ...]
    settings: Settings
    tile: tuple[int, ...] | None

    def __init__(
        self,
        system: str,
        axes: Mapping[str, Any],
        parameters: Mapping[str, Any] | None = None,
        solve: Mapping[str, Any] | Settings | None = None,
        store: Mapping[str, Any] | None = None,
    ) -> None:
        record = checked_system(system)
        parameters, store = {} if parameters is None else parameters, {} if store is None else store
        _check_tables(parameters=parameters, axes=axes, store=store)
        known = [parameter.name for parameter in record.parameters]
        check_names("parameter", parameters, known)
        check_names("parameter in axes", axes, known)
        if not 1 <= len(axes) <= 2:
            found = f"found {len(axes)} ({', '.join(axes)})" if axes else "found none"
            raise InputError(f"axes: {found}, must be one or two")
        for name in axes:
            if name in parameters:
                raise InputError(f"{name} is both a parameter and an axis; remove one of the two")
        put = object.__setattr__
        put(self, "system", record.name)
        put(self, "axes", tuple(read_axis(record.parameter(name), given) for name, given in axes.items()))
        _check_continuation(self.axes, record)
        fixed = checked_parameters(record, parameters)
        put(self, "parameters", {name: value for name, value in fixed.items() if name not in axes})
        put(self, "settings", _settings_of(solve))
        put(self, "tile", _checked_tile(store, len(axes)))
        _check_whole_lines(self)

    @classmethod
    def from_mapping(cls, given: Mapping[str, Any]) -> "Spec":
        """The spec of a mapping that has the form of the TOML file."""
        check_names("key", given, SECTIONS)
        for key in ("system", "axes"):
            if key not in given:
                raise InputError(f"{key} missing" + ("; one or two tables [axes.NAME]" if key == "axes" else ""))
        return cls(**given)

    @classmethod
    def from_toml(cls, source: str | Path) -> "Spec":
        """The spec of a TOML file, or of the packaged example of that name where there is no such file."""
        path, where = Path(source), str(source) or "''"
        try:
            text = _text_of(path) if path.exists() else _example(str(source))
            return cls.from_mapping(_parsed(text))
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
        except RecursionError:
            raise InputError(f"{where}: nested too deeply; a spec has no more than tables in tables") from None
        except OSError as error:
            raise InputError(f"{where}: cannot be read: {error.strerror}") from None

    @property
    def dims(self) -> tuple[str, ...]:
        """Dimensions of the arrays, slowest first: ("b", "omega") for axes (omega, b)."""
        return tuple(axis.name for axis in reversed(self.axes))

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells along each of ``dims``."""
        return tuple(len(axis) for axis in reversed(self.axes))

    @property
    def continuation(self) -> tuple[int, bool] | None:
        """Place in ``dims`` of the axis that is continued, and whether backward; None where cells are independent."""
        for place, axis in enumerate(reversed(self.axes)):
            if axis.continuation:
                return place, axis.continuation == "backward"
        return None

    @property
    def record(self) -> System:
        """The system's own record: its parameters with their units and meanings."""
        return find_system(self.system)

    def resolved(self) -> dict[str, Any]:
        """The spec as plain JSON: what the store keeps, and enough to build an equal spec with ``from_resolved``."""
        axes = [
            {"name": axis.name, "scale": axis.scale, "values": list(axis.values)}
            | ({"continuation": axis.continuation} if axis.continuation else {})
            for axis in self.axes
        ]
        return {"system": self.system, "parameters": self.parameters, "axes": axes, "solve": asdict(self.settings)}

    @classmethod
    def from_resolved(cls, resolved: Mapping[str, Any]) -> "Spec":
        """The inverse of ``resolved``, tile shape aside."""
        axes = {
            axis["name"]: Axis(axis["name"], tuple(axis["values"]), axis["scale"], axis.get("continuation"))
            for axis in resolved["axes"]
        }
        return cls(resolved["system"], axes, resolved["parameters"], resolved["solve"])

    @property
    def digest(self) -> str:
        """SHA-256 of all that decides the numbers, see ``resolved_digest``."""
        return resolved_digest(self.resolved())

    def cell_params(self, slices: Slices) -> dict[str, float | np.ndarray]:
        """Parameters of a block of cells as solve_tile takes them: axes as arrays that broadcast to its shape."""
        params: dict[str, float | np.ndarray] = dict(self.parameters)
        for i, (axis, part) in enumerate(zip(reversed(self.axes), slices, strict=True)):
            along = [1] * len(self.axes)
            along[i] = -1
            params[axis.name] = np.array(axis.values[part], dtype="float64").reshape(along)
        return params


def resolved_digest(resolved: Mapping[str, Any], table: type[Settings] = Settings) -> str:
    """SHA-256 of a resolved spec: axes as an ordered list of names and exact values, no tile shape.

    Settings added since the first version enter it only where they are not at their default, so that a spec from
    before keeps its digest. ``table`` has the defaults.
    """
    axes = [
        [axis["name"], axis["values"]] + ([axis["continuation"]] if "continuation" in axis else [])
        for axis in resolved["axes"]
    ]
    defaults = {field.name: field.default for field in fields(table)}
    settings = {
        name: value
        for name, value in resolved["solve"].items()
        if name in FIRST_SETTINGS or value != defaults.get(name, MISSING)
    }
    return digest_of({**resolved, "axes": axes, "solve": settings})


def digest_of(identity: Mapping[str, Any]) -> str:
    """SHA-256 of a mapping as JSON. Python writes a float as its shortest exact decimal: equal text is equal bits."""
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()


def differences(stored: Spec, given: Spec) -> list[str]:
    """In what two specs differ, each in a few words."""
    found = []
    if stored.system != given.system:
        found.append(f"system {stored.system} in the store, {given.system} in the spec")
    names, wanted = [axis.name for axis in stored.axes], [axis.name for axis in given.axes]
    if names != wanted:
        what = "axis order differs" if sorted(names) == sorted(wanted) else "axes differ"
        found.append(f"{what}: ({', '.join(names)}) in the store, ({', '.join(wanted)}) in the spec")
    else:
        pairs = zip(stored.axes, given.axes, strict=True)
        found += [
            f"axis {old} in the store, {new} in the spec"
            for old, new in pairs
            if (old.values, old.continuation) != (new.values, new.continuation)
        ]
    for before, after in (
        (stored.parameters, given.parameters),
        (stored.resolved()["solve"], given.resolved()["solve"]),
    ):
        common = before.keys() & after.keys()
        found += [
            f"{name} = {before[name]!r} in the store, {after[name]!r} in the spec"
            for name in before
            if name in common and before[name] != after[name]
        ]
    return found


def checked_system(name: object) -> System:
    """The system of that name; InputError with the nearest known name otherwise."""
    if not isinstance(name, str):
        raise InputError(f"system: found {shown(name)}, must be the name of a system")
    try:
        return find_system(name)
    except KeyError as error:
        raise InputError(error.args[0]) from None


def checked_parameters(record: System, given: Mapping[str, Any]) -> dict[str, float]:
    """All parameters of a system, those given checked against their ranges, the others at their defaults."""
    check_names("parameter", given, [parameter.name for parameter in record.parameters])
    return {p.name: admitted(p, given[p.name]) if p.name in given else p.default for p in record.parameters}


def checked_settings(given: Mapping[str, Any]) -> Settings:
    """Settings from the [solve] table; InputError that names the setting otherwise."""
    if not isinstance(given, Mapping):
        raise InputError(f"solve: found {shown(given)}, must be a table")
    check_names("key in solve", given, [field.name for field in fields(Settings)])
    for name, value in given.items():
        if _is_whole(value) and abs(value) >= 2**63:  # no setting is so large, and few messages could show it
            raise InputError(f"solve.{name}: found {shown(value)}, must be less than 2**63")
    # A whole tolerance is the same number, and has to have the same digest, as a float.
    whole: dict[str, Any] = {
        name: float(value) if name == "tolerance" and _is_whole(value) else value for name, value in given.items()
    }
    try:
        return Settings(**whole)
    except ValueError as error:
        raise InputError(f"solve.{error}") from None


def example_names() -> list[str]:
    """Names of the packaged examples."""
    folder = resources.files("atlas").joinpath("examples")
    if not folder.is_dir():
        return []
    return sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml"))


def _example(name: str) -> str:
    names = example_names()
    if name in names:
        return resources.files("atlas").joinpath("examples", f"{name}.toml").read_text(encoding="utf-8")
    if name.endswith(".toml") or "/" in name:
        raise InputError("no such file")
    raise InputError(f"no such file, and {unknown_name('example', name, names)}")


def _text_of(path: Path) -> str:
    """The text of a spec file; anything but a regular file of bounded size could keep its reader for ever."""
    if path.is_dir():
        raise InputError("cannot be read: is a folder")
    if not path.is_file():
        raise InputError("cannot be read: not a regular file")
    with path.open("rb") as file:
        content = file.read(MAX_FILE + 1)
    if len(content) > MAX_FILE:
        raise InputError(f"too large for a spec: more than {MAX_FILE} bytes")
    try:
        text = content.decode()
    except UnicodeDecodeError as error:
        raise InputError(f"not a TOML file: byte {error.start} is not UTF-8 text") from None
    if text.startswith("\ufeff"):
        raise InputError("not a TOML file: it begins with a byte order mark; save it as UTF-8 without one")
    return text


def _parsed(text: str) -> dict[str, Any]:
    if _DEEP_KEY.search(text):
        raise RecursionError
    try:
        return tomllib.loads(text)
    except ValueError as error:  # besides its own, those of numbers with too many digits
        raise InputError(f"not a TOML file: {error}") from None


def _settings_of(solve: Mapping[str, Any] | Settings | None) -> Settings:
    return solve if isinstance(solve, Settings) else checked_settings({} if solve is None else solve)


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _check_tables(**tables: object) -> None:
    for name, table in tables.items():
        if not isinstance(table, Mapping):
            raise InputError(f"{name}: found {shown(table)}, must be a table")


def _check_continuation(axes: tuple[Axis, ...], record: System) -> None:
    continued = [axis.name for axis in axes if axis.continuation]
    if len(continued) > 1:
        raise InputError(f"axes: found continuation on {' and '.join(continued)}, must be on one")
    if continued and continued[0] in record.states:
        raise InputError(f"axes.{continued[0]}: an initial state cannot be continued; continue another parameter")


def _check_whole_lines(spec: Spec) -> None:
    if spec.tile is None or spec.continuation is None:
        return
    place, _ = spec.continuation
    if spec.tile[place] < spec.shape[place]:
        raise InputError(
            f"store.tile: found {shown(list(spec.tile))}, must hold whole lines of {spec.dims[place]}, "
            f"which is continued over {spec.shape[place]} cells"
        )


def _checked_tile(store: Mapping[str, Any], axes: int) -> tuple[int, ...] | None:
    check_names("key in store", store, ["tile"])
    if "tile" not in store:
        return None
    tile = store["tile"]
    form = "two whole numbers (y, x)" if axes == 2 else "one whole number in brackets"
    right = isinstance(tile, list | tuple) and len(tile) == axes and all(_is_whole(n) and n >= 1 for n in tile)
    if not right:
        raise InputError(f"store.tile: found {shown(tile)}, must be {form}, each 1 or more")
    return tuple(int(n) for n in tile)
