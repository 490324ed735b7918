"""A spec as the text of a TOML file that a person can go on with."""

import json
import re
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from workers import Settings
from workers.model.system import System


def spec_toml(
    system: System,
    parameters: Mapping[str, float],
    axes: Mapping[str, Mapping[str, Any]],
    settings: Settings,
    attractors: Mapping[str, Any] | None = None,
) -> str:
    """The text of a spec with these tables; what has its default is left out. ``Spec.from_toml`` reads it."""
    defaults = {parameter.name: parameter.default for parameter in system.parameters}
    tables: dict[str, Any] = {} if system.packaged else {"system": system.table()}
    tables["parameters"] = {name: value for name, value in parameters.items() if value != defaults[name]}
    for name, axis in axes.items():
        tables[f"axes.{name}"] = {key: value for key, value in axis.items() if (key, value) != ("scale", "linear")}
    solve = {field.name: (getattr(settings, field.name), field.default) for field in fields(Settings)}
    tables["solve"] = {name: value for name, (value, default) in solve.items() if value != default}
    tables["attractors"] = attractors or {}
    text = f"system = {_value(system.name)}\n" if system.packaged else ""
    return text + "".join(_table(name, table) for name, table in tables.items() if table)


def _table(name: str, table: Mapping[str, Any]) -> str:
    lines = [f"{_key(key)} = {_value(value)}" for key, value in table.items()]
    return "\n".join(["", f"[{name}]", *lines, ""])


def _value(value: Any) -> str:
    """A value as TOML; a string as JSON writes it is one of TOML's too."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(key)} = {_value(each)}" for key, each in value.items()) + " }"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    return json.dumps(value) if isinstance(value, str) else repr(value)


def _key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key)
