"""The form of a spec file as a JSON Schema, with which editors of TOML complete and check the file.

The schema is generated from the same definitions by which ``Spec`` checks a spec. ``Spec`` also refuses every spec that
the schema refuses, except for an unused ``stop`` of an axis of one value. ``Spec`` alone checks the rest, such as
rising values of an axis.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any

from atlas.spec import attractors, axis
from atlas.spec.points import FILE
from atlas.spec.spec import MAX_AXES, SECTIONS, SETTING_MEANINGS
from workers.attractors.initial_states import INTEGER_BOUNDS as STARTS
from workers.attractors.initial_states import AttractorSettings
from workers.model.elements import PAD, RELEASES, RUB
from workers.model.entries import NAME
from workers.model.laws import SEGMENTS
from workers.model.measures import KEYS as MEASURE_KEYS
from workers.model.measures import MEASURES, REPORTS
from workers.model.parameter import Parameter
from workers.model.parse_definition import MANY, MAX_COORDINATES, PARAMETER_KEYS
from workers.model.parse_elements import CONTACT_KEYS, FRICTION, FRICTION_KEYS, PHASE_KEYS, PHASES, SPRINGS, STOPS
from workers.model.parse_force import HARMONIC_KEYS, HIGHEST, ORDER
from workers.model.parse_laws import SPRING_KEYS
from workers.model.smooth import SMOOTH_PHASES, STEPS
from workers.model.system import DEFAULT, KEYS, LATEST, TEXTS, System, packaged_system, system_names
from workers.settings import INTEGER_BOUNDS, VALID_WORDS, Settings

DRAFT = "https://json-schema.org/draft/2020-12/schema"
Schema = dict[str, Any]

_NUMBER: Schema = {"type": "number"}
_TEXT: Schema = {"type": "string", "maxLength": 5000}
_FLAG: Schema = {"type": "boolean"}
_POSITIVE: Schema = {"exclusiveMinimum": 0}
_ENTRY: Schema = {"type": ["number", "string"], "description": "a number, or an expression of parameters in quotes"}
_NAME: Schema = {"type": "string", "pattern": f"^{NAME.pattern}$"}


def spec_schema() -> Schema:
    """Return the JSON Schema of a spec file. TOML's infinities and NaN are not JSON: a validator sees floats there."""
    sections = {
        "system": {
            "description": "a packaged system, the path of a .toml file, or a definition",
            "anyOf": [{"enum": list(system_names())}, {"type": "string", "pattern": r"\.toml$"}, _definition()],
            "default": DEFAULT,
        },
        "parameters": {"description": "fixed parameters; others have their default", **_map(_NUMBER)},
        "axes": {"description": "the parameters that are swept, x first", **_map(_axis(), 0, MAX_AXES)},
        "points": {
            "description": "parameter sets, one row a cell, in place of axes",
            "anyOf": [
                _table({FILE: {"type": "string", "description": "a CSV file, its first row the names"}}, [FILE]),
                _map(_list(_NUMBER, 1), 1),
            ],
        },
        "solve": {"description": "how a cell is solved", **_settings()},
        "attractors": {"description": "asks for all attractors of each cell", **_attractors()},
        "store": {
            "description": "how the atlas is stored",
            **_table({"tile": {**_list(_whole(1), 1, MAX_AXES), "description": "cells of a tile, y before x"}}),
        },
    }
    assert tuple(sections) == SECTIONS
    return {
        "$schema": DRAFT,
        "title": "spec of an impact atlas",
        **_table(sections, ["system"]),
        "anyOf": [
            {"required": ["axes"], "properties": {"axes": {"minProperties": 1}, "points": False}},
            {"required": ["points"], "properties": {"axes": {"maxProperties": 0}}},
        ],
        "allOf": [_of_packaged(packaged_system(name)) for name in system_names()],
    }


def _of_packaged(system: System) -> Schema:
    """Return the schema for a packaged system: its parameters with their ranges."""
    known = system.parameters
    fixed = {p.name: {"description": p.meaning, "default": p.default, **_NUMBER, **_range(p)} for p in known}
    swept = {p.name: {"description": p.meaning, **_values_within(_range(p))} for p in known}
    columns = [FILE, *(p.name for p in known)]
    return {
        "if": {"required": ["system"], "properties": {"system": {"const": system.name}}},
        "then": {
            "properties": {
                "parameters": _table(fixed),
                "axes": _table(swept),
                "points": {"propertyNames": {"enum": columns}},
                "attractors": {"properties": {"box": {"propertyNames": {"enum": list(system.states)}}}},
            }
        },
    }


def _range(parameter: Parameter) -> Schema:
    low = "exclusiveMinimum" if parameter.low_open else "minimum"
    high = "exclusiveMaximum" if parameter.high_open else "maximum"
    return {key: end for key, end in ((low, parameter.low), (high, parameter.high)) if math.isfinite(end)}


def _values_within(ends: Schema) -> Schema:
    """Return the schema of the values of an axis, a list or a table, within the range ``ends``."""
    return {"items": ends, "properties": {"start": ends, "stop": ends, "values": {"items": ends}}} if ends else {}


def _axis() -> Schema:
    """Return the schema of an axis: a list of values, or a table."""
    values = _list(_NUMBER, 1, axis.MAX_POINTS)
    entries: Schema = {
        "start": _NUMBER,
        "stop": _NUMBER,
        "num": _whole(1, axis.MAX_POINTS),
        "values": values,
        "scale": {"enum": list(axis.SCALES), "default": axis.SCALES[0]},
        "continuation": {"enum": list(axis.DIRECTIONS)},
    }
    assert tuple(entries) == axis.KEYS
    spaced, listed = ["start", "stop", "num"], ["values"]
    logarithmic = {
        "if": {"required": ["scale"], "properties": {"scale": {"const": "log"}}},
        "then": {"properties": {"start": _POSITIVE, "stop": _POSITIVE, "values": {"items": _POSITIVE}}},
    }
    either = {"oneOf": [{"required": spaced, "not": {"required": listed}}, {"required": listed, **_without(spaced)}]}
    return {"anyOf": [values, {**_table(entries), **either, **logarithmic}]}


def _settings() -> Schema:
    """Return the schema of the table [solve], the settings of a cell."""
    kinds: Schema = {name: {"enum": list(known)} for name, known in VALID_WORDS.items()}
    kinds |= {name: _whole(*ends) for name, ends in INTEGER_BOUNDS.items()}
    kinds |= {"tolerance": {**_NUMBER, **_POSITIVE}, "observe": _TEXT}
    return _table(
        {
            field.name: {"description": SETTING_MEANINGS[field.name], **kinds[field.name], "default": field.default}
            for field in fields(Settings)
        }
    )


def _attractors() -> Schema:
    """Return the schema of the table [attractors], the initial states from which attractors are searched."""
    defaults = {"starts": AttractorSettings.count, "seed": AttractorSettings.seed, "keep": AttractorSettings.keep}
    entries: Schema = {name: {**_whole(*ends), "default": defaults[name]} for name, ends in STARTS.items()}
    entries["box"] = {
        "description": "lowest and highest initial value of components of the state",
        **_map(_list(_NUMBER, 2, 2)),
    }
    return _table({name: entries[name] for name in attractors.KEYS})


def _definition() -> Schema:
    """Return the schema of the table [system] that defines a machine.

    The sizes of rows and matrices are limited by the number of coordinates. An entry without a kind below is a number
    or an expression.
    """
    row, pair = _list(_ENTRY, 1, MAX_COORDINATES), _list(_ENTRY, 2, 2)
    matrix, points = _list(row, 1, MAX_COORDINATES), _list(pair, 2, SEGMENTS + 1)
    words: Schema = {"type": "string", "maxLength": 200}
    order: Schema = {"anyOf": [_whole(1, HIGHEST), {"type": "string", "pattern": f"^{ORDER.pattern}$"}]}
    waves: Schema = {"anyOf": [{"required": ["force"]}, {"required": ["cosine"]}]}
    report: Schema = {**_list({"enum": list(REPORTS)}, 1), "uniqueItems": True}
    element: Schema = {"name": _NAME, "gap": row, "row": row, "law_back": points}
    element |= {"law": {"anyOf": [points, {"type": "string"}]}, "range": {"anyOf": [_ENTRY, pair]}}
    element["release"] = {"enum": list(RELEASES), "default": RELEASES[0]}
    phase: Schema = {"contacts": _map(_keyed(PAD)), "friction": _map(_keyed(RUB))}
    phase |= dict.fromkeys(("stiffness", "damping"), matrix) | dict.fromkeys(("force", "cosine", "load"), row)
    parameter = dict.fromkeys(("low_open", "high_open"), _FLAG) | dict.fromkeys(("symbol", "unit", "meaning"), words)
    entries: Schema = dict.fromkeys(TEXTS, _TEXT)
    entries |= dict.fromkeys(("coordinates", "velocities"), _list(_NAME, 1, MAX_COORDINATES))
    entries |= dict.fromkeys(("mass", "damping", "stiffness"), matrix)
    entries |= dict.fromkeys(("force", "phase", "cosine", "load", "gap"), row)
    entries |= {
        "name": {"type": "string", "pattern": "^[A-Za-z0-9_-]{1,40}$"},
        "version": _whole(1, LATEST),
        "axes": _map(pair),
        "harmonics": _list({**_keyed(HARMONIC_KEYS, {"order": order}, ["order"], row), **waves}),
        "contacts": _list(_keyed(CONTACT_KEYS, element, ["name", "gap"]), 1, STOPS),
        "friction": _list(_keyed(FRICTION_KEYS, element, ["name", "row"]), 0, FRICTION),
        "springs": _list(_keyed(SPRING_KEYS, element, SPRING_KEYS[:3]), 0, SPRINGS),
        "phases": _list(_keyed(PHASE_KEYS, phase, ["start"]), 0, PHASES),
        "drift": _NAME,
        "steps": {**_whole(STEPS, SMOOTH_PHASES // 2), "multipleOf": 2},
        "measures": _map(_keyed(MEASURE_KEYS, {"weight": _ENTRY, "report": report}, ["report"], row), 0, MEASURES),
        "let": _map(_ENTRY, 0, MANY),
        "parameters": _map({"anyOf": [_ENTRY, _keyed(PARAMETER_KEYS, parameter)]}, 0, MANY),
    }
    return _keyed(KEYS, entries, ["name", "coordinates", "mass"])


def _keyed(
    keys: Iterable[str], kinds: Mapping[str, Any] | None = None, required: Iterable[str] = (), other: Schema = _ENTRY
) -> Schema:
    """Return the schema of a table with these keys: each has its schema in ``kinds``, or ``other``."""
    return _table({key: (kinds or {}).get(key, other) for key in keys}, required)


def _table(entries: Mapping[str, Any], required: Iterable[str] = ()) -> Schema:
    """Return the schema of a table with these entries, by key, and no others."""
    needed = {"required": [*required]} if required else {}
    return {"type": "object", "properties": dict(entries), "additionalProperties": False, **needed}


def _map(value: Schema, minimum: int = 0, limit: int | None = None) -> Schema:
    """Return the schema of a table with arbitrary keys, whose values have the schema ``value``.

    ``minimum`` and ``limit`` bound the number of keys; None for no limit.
    """
    ends = ({"minProperties": minimum} if minimum else {}) | ({} if limit is None else {"maxProperties": limit})
    return {"type": "object", "additionalProperties": value, **ends}


def _list(value: Schema, minimum: int = 0, limit: int | None = None) -> Schema:
    ends = ({"minItems": minimum} if minimum else {}) | ({} if limit is None else {"maxItems": limit})
    return {"type": "array", "items": value, **ends}


def _whole(low: int, high: int | None = None) -> Schema:
    return {"type": "integer", "minimum": low} | ({} if high is None else {"maximum": high})


def _without(keys: Iterable[str]) -> Schema:
    """Return a schema that forbids all these keys."""
    return {"not": {"anyOf": [{"required": [key]} for key in keys]}}
