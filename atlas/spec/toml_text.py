"""A spec as the text of a TOML file that a person can go on with."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import tomli_w

from workers import Settings
from workers.model.system import System


def spec_toml(
    system: System,
    parameters: Mapping[str, float],
    axes: Mapping[str, Mapping[str, Any]],
    settings: Settings,
    attractors: Mapping[str, Any] | None = None,
) -> str:
    """The text of a spec with these tables; defaults are omitted. ``Spec.from_toml`` reads it."""
    defaults = {parameter.name: parameter.default for parameter in system.parameters}
    tables = {
        "system": system.name if system.packaged else system.table(),
        "parameters": {name: value for name, value in parameters.items() if value != defaults[name]},
        "axes": {
            name: {key: value for key, value in axis.items() if (key, value) != ("scale", "linear")}
            for name, axis in axes.items()
        },
        "solve": {
            field.name: value for field in fields(Settings) if (value := getattr(settings, field.name)) != field.default
        },
        "attractors": attractors,
    }
    return tomli_w.dumps({name: table for name, table in tables.items() if table}, multiline_strings=True)
