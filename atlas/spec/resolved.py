"""Resolved specs as plain JSON: with the values of their axes for the digest, without these values for stores."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any

from atlas.spec.axis import Values
from workers import Settings
from workers.model.system import identity

FIRST_SETTINGS = (
    "exponents", "tolerance", "max_periods", "method", "transient_periods", "periods", "max_period", "section_samples",
)  # fmt: skip
"""Settings of the first version, which enter every digest. Settings added since do not belong here."""


def outline_names(outline: Mapping[str, Any]) -> list[str]:
    """Return the names of the axes of an outline, or of the columns of its points."""
    return list(outline["points"]["columns"]) if "points" in outline else [axis["name"] for axis in outline["axes"]]


def with_values(outline: Mapping[str, Any], values: Values) -> dict[str, Any]:
    """Return the resolved spec of an outline, with the values of its axes or of the columns of its points, by name."""
    if "points" in outline:
        return {**outline, "points": {name: list(values[name]) for name in outline_names(outline)}}
    ends = ("start", "stop", "num")
    axes = [
        {key: value for key, value in axis.items() if key not in ends} | {"values": list(values[axis["name"]])}
        for axis in outline["axes"]
    ]
    return {**outline, "axes": axes}


def resolved_digest(resolved: Mapping[str, Any], table: type[Settings] = Settings) -> str:
    """Return the SHA-256 of a resolved spec: axes as an ordered list of names and exact values, no tile shape.

    A packaged system enters by its name, and from its second version on also by its version. Another system enters by
    its definition without texts. Settings added since the first version enter only if they differ from their defaults,
    so that earlier specs keep their digests. ``table`` has the defaults.
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
    return digest_of({**resolved, **identity(resolved), "axes": axes, "solve": settings})


def digest_of(identity: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a mapping as JSON.

    Python writes floats as shortest exact decimals, so that equal text means equal bits.
    """
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()
