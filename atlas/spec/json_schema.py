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

    Its keys are some of ``KEYS``; the sizes of rows and matrices are limited by the number of coordinates.
    """
    row, matrix = _list(_ENTRY, 1, MAX_COORDINATES), _list(_list(_ENTRY, 1, MAX_COORDINATES), 1, MAX_COORDINATES)
    entries: Schema = {key: _TEXT for key in TEXTS}
    entries |= {key: _list(_NAME, 1, MAX_COORDINATES) for key in ("coordinates", "velocities")}
    entries |= {key: matrix for key in ("mass", "damping", "stiffness")}
    entries |= {key: row for key in ("force", "phase", "cosine", "load", "gap")}
    entries |= {key: _ENTRY for key in ("upper", "lower", "restitution", "period")}
    entries |= {
        "name": {"type": "string", "pattern": "^[A-Za-z0-9_-]{1,40}$"},
        "version": _whole(1, LATEST),
        "axes": _map(_list(_ENTRY, 2, 2)),
        "harmonics": _list(_harmonic(row)),
        "contacts": _list(_element(CONTACT_KEYS, ["name", "gap"]), 1, STOPS),
        "friction": _list(_element(FRICTION_KEYS, ["name", "row"]), 0, FRICTION),
        "springs": _list(_element(SPRING_KEYS, [*SPRING_KEYS[:3]]), 0, SPRINGS),
        "phases": _list(_phase(row, matrix), 0, PHASES),
        "drift": _NAME,
        "within": _ENTRY,
        "steps": {**_whole(STEPS, SMOOTH_PHASES // 2), "multipleOf": 2},
        "measures": _map(_measure(row), 0, MEASURES),
        "let": _map(_ENTRY, 0, MANY),
        "parameters": _map(_own_parameter(), 0, MANY),
    }
    return _table({key: entries[key] for key in KEYS}, ["name", "coordinates", "mass"])


def _harmonic(row: Schema) -> Schema:
    """Return the schema of a harmonic of the force. ``row`` is the schema of a value per coordinate."""
    order: Schema = {"anyOf": [_whole(1, HIGHEST), {"type": "string", "pattern": f"^{ORDER.pattern}$"}]}
    table = _table({key: order if key == "order" else row for key in HARMONIC_KEYS}, ["order"])
    return {**table, "anyOf": [{"required": ["force"]}, {"required": ["cosine"]}]}


def _element(keys: Iterable[str], required: list[str]) -> Schema:
    """Return the schema of a contact or a friction element: a name, a row of coefficients, and constants."""
    known: Schema = {
        "name": _NAME,
        "gap": _list(_ENTRY, 1, MAX_COORDINATES),
        "row": _list(_ENTRY, 1, MAX_COORDINATES),
        "release": {"enum": list(RELEASES), "default": RELEASES[0]},
        "law": {"anyOf": [_list(_list(_ENTRY, 2, 2), 2, SEGMENTS + 1), {"type": "string"}]},
        "law_back": _list(_list(_ENTRY, 2, 2), 2, SEGMENTS + 1),
        "range": {"anyOf": [_ENTRY, _list(_ENTRY, 2, 2)]},
    }
    return _table({key: known.get(key, _ENTRY) for key in keys}, required)


def _phase(row: Schema, matrix: Schema) -> Schema:
    """Return the schema of a phase: a part of each forcing period in which entries of the definition are replaced."""
    entries: Schema = {
        "start": _ENTRY, "stiffness": matrix, "damping": matrix, "force": row, "cosine": row,
        "load": row, "contacts": _map(_table({key: _ENTRY for key in PAD})),
        "friction": _map(_table({key: _ENTRY for key in RUB})),
    }  # fmt: skip
    return _table({key: entries[key] for key in PHASE_KEYS}, ["start"])


def _measure(row: Schema) -> Schema:
    """Return the schema of an output of a machine, a combination of its coordinates, and of the results reported about
    it.
    """
    report = {**_list({"enum": list(REPORTS)}, 1), "uniqueItems": True}
    known: Schema = {"weight": _ENTRY, "report": report}
    return _table({key: known.get(key, row) for key in MEASURE_KEYS}, ["report"])


def _own_parameter() -> Schema:
    """Return the schema of a parameter in a definition: its default, a number or an expression, or a table of more."""
    words: Schema = {"type": "string", "maxLength": 200}
    flags: Schema = {"low_open": _FLAG, "high_open": _FLAG, "symbol": words, "unit": words, "meaning": words}
    return {"anyOf": [_ENTRY, _table({key: flags.get(key, _ENTRY) for key in PARAMETER_KEYS})]}


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
