"""Resolved specs, in which all defaults are filled in, as JSON, and the digest that identifies a spec.

For the digest axes are lists of values; in a store evenly spaced axes are shortened.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any

import numpy as np

from workers import Settings
from workers.model.system import identity

FIRST_SETTINGS = (
    "exponents", "tolerance", "max_periods", "method", "transient_periods", "periods", "max_period", "section_samples",
)  # fmt: skip
"""Settings of the package's first version, which enter every digest. Settings added since do not belong here."""


def pack_axes(resolved: Mapping[str, Any]) -> dict[str, Any]:
    """Return a resolved spec with evenly spaced axes shortened, the form in which a store has it.

    An axis whose values ``start + k (stop - start) / (num - 1)`` gives to the bit has these three numbers in place of
    the values.
    """
    return {**resolved, "axes": [_packed(axis) for axis in resolved["axes"]]}


def unpack_axes(stored: Mapping[str, Any]) -> dict[str, Any]:
    """Return a resolved spec with all values of its axes, from the form in a store; the inverse of ``pack_axes``."""
    return {**stored, "axes": [_unpacked(axis) for axis in stored["axes"]]}


def _packed(axis: Mapping[str, Any]) -> Mapping[str, Any]:
    values = axis["values"]
    ends = {"start": values[0], "stop": values[-1], "num": len(values)}
    same = len(values) > 1 and _evenly_spaced(**ends) == list(values)
    return {key: value for key, value in axis.items() if key != "values"} | ends if same else axis


def _unpacked(axis: Mapping[str, Any]) -> Mapping[str, Any]:
    if "values" in axis:
        return axis
    ends = {key: axis[key] for key in ("start", "stop", "num")}
    return {key: value for key, value in axis.items() if key not in ends} | {"values": _evenly_spaced(**ends)}


def _evenly_spaced(start: float, stop: float, num: int) -> list[float]:
    """Return ``num`` evenly spaced values from start to stop, by operations that round in the same way on every
    host.
    """
    values = np.arange(num, dtype=np.float64) * ((stop - start) / (num - 1)) + start
    values[-1] = stop
    return list(values.tolist())


def resolved_digest(resolved: Mapping[str, Any], table: type[Settings] = Settings) -> str:
    """Return the SHA-256 of a resolved spec: all that affects the numbers of its atlas.

    Axes enter as an ordered list of names and exact values; the tile shape does not enter. A packaged system enters by
    its name, and from its second version on also by its version. Another system enters by its definition without texts.
    Settings added since the first version of the package enter only if they differ from their defaults, so that earlier
    specs keep their digests. ``table`` has the defaults.
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
    """Return the SHA-256 of a mapping, written as JSON, as a hexadecimal text.

    Python writes floats as shortest exact decimals, so that equal text means equal bits.
    """
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()
