"""A spec as the text of a TOML file, for editing."""

from dataclasses import fields
from typing import Any

import tomli_w

from atlas.spec.attractors import attractors_to_json
from atlas.spec.axis import Axis, spaced_values
from atlas.spec.spec import Spec
from workers import Settings


def spec_toml(spec: Spec) -> str:
    """Return the text of a TOML file for a spec, without defaults. ``Spec.from_toml`` reads it."""
    system, settings = spec.system_def, spec.settings
    defaults = {p.name: None if p.formula else p.default for p in system.parameters}
    tables = {
        "system": system.name if system.packaged else system.table(),
        "parameters": {name: value for name, value in spec.parameters.items() if value != defaults[name]},
        "axes": {axis.name: _axis_table(axis) for axis in spec.axes},
        "solve": {
            field.name: value for field in fields(Settings) if (value := getattr(settings, field.name)) != field.default
        },
        "attractors": None if spec.attractors is None else attractors_to_json(spec.attractors),
    }
    return tomli_w.dumps({name: table for name, table in tables.items() if table}, multiline_strings=True)


def _axis_table(axis: Axis) -> dict[str, Any]:
    """Return an axis as a TOML table: with start, stop and num if it is evenly spaced on its scale, else with its
    values.
    """
    ends = {"start": axis.start, "stop": axis.stop, "num": len(axis)}
    table = ends if spaced_values(axis.name, ends, axis.scale) == axis.values else {"values": list(axis.values)}
    axis_options = {"scale": axis.scale, "continuation": axis.continuation}
    return table | {key: value for key, value in axis_options.items() if value not in ("linear", None)}
