"""The stability measures of an atlas, and the group ``stability`` of a store in which they are kept."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.orbits.orbit_table import current_group
from atlas.robustness.linear_measures import FLAGS
from atlas.store.groups import STABILITY, write_table
from atlas.store.schema import StoredArray, variable_attributes
from atlas.store.store import AtlasStore
from workers import SOLVER_VERSION
from workers.results import ATTRACTOR, CodeMeaning, Variable

Arrays = dict[str, NDArray[Any]]

VERSION = 1
"""Version of the computation of measures; incremented whenever a measure may change."""

LINEAR, SHOCKS = FAMILIES = ("linear", "shocks")
"""Families of measures that are computed together."""


@dataclass(frozen=True)
class MeasureVariable(Variable):
    """The description of a stability measure; measures of one ``family`` are computed together."""

    family: str = ""


def _numbered(names: Iterable[str]) -> tuple[CodeMeaning, ...]:
    return tuple(CodeMeaning(code, name, name.replace("_", " ")) for code, name in enumerate(names))


_NAN = float("nan")
_FAMILIES = {
    LINEAR: (
        MeasureVariable("return_time", "float64", _NAN, "forcing periods in which deviations fall by e in the end"),
        MeasureVariable("reactivity", "float64", _NAN, "largest log growth of a deviation over one forcing period"),
        MeasureVariable("amplification", "float64", _NAN, "largest growth of a deviation over any number of periods"),
        MeasureVariable("amplified_after", "int32", -1, "forcing periods after which it is that large"),
        MeasureVariable(
            "unmeasured", "int8", -1, "why one of these is not known; -1 if all are", codes=_numbered(FLAGS)
        ),
    ),
    SHOCKS: (
        MeasureVariable("fatal_shock", "float64", _NAN, "smallest deviation found that leads to another attractor"),
        MeasureVariable("shock_reaches", "int32", -1, "place of the attractor it leads to; -2 if it is not stored"),
        MeasureVariable("shock_tried", "int32", -1, "states that fill the ball of this size and are not fatal"),
    ),
}
MEASURES = {measure.name: replace(measure, family=family) for family, some in _FAMILIES.items() for measure in some}
"""The descriptions of all measures, by name."""


def of_family(family: str) -> list[MeasureVariable]:
    """Return the descriptions of the measures of a family."""
    return [measure for measure in MEASURES.values() if measure.family == family]


def empty(measures: Iterable[MeasureVariable], shape: tuple[int, ...]) -> Arrays:
    """Return arrays of one shape in which every measure is unknown."""
    return {measure.name: np.full(shape, measure.fill, dtype=measure.dtype) for measure in measures}


@dataclass(frozen=True, eq=False)
class StoredMeasures:
    """The stability measures that a store holds.

    arrays    values by name of the measure
    requests  settings, such as the weights of the norm, from which the measures were computed, by family
    """

    arrays: Arrays
    requests: dict[str, dict[str, Any]]


def read_measures(handle: AtlasStore) -> StoredMeasures:
    """Return the stability measures of a store; empty if it has none, or if they are damaged or of another version."""
    arrays, attributes = current_group(handle, STABILITY, VERSION) or ({}, {})
    requests = {family: dict(attributes[family]) for family in FAMILIES if family in attributes}
    return StoredMeasures({name: arrays[name] for name in MEASURES if name in arrays}, requests)


def write_measures(handle: AtlasStore, stored: StoredMeasures) -> None:
    """Write measures into the store, replacing any earlier ones."""
    dims = (*handle.spec.dims, ATTRACTOR) if handle.spec.coexistence else handle.spec.dims
    columns = {
        name: StoredArray(values, dims, variable_attributes(MEASURES[name])) for name, values in stored.arrays.items()
    }
    attributes = {"title": "stability measures", "version": VERSION, "solver_version": SOLVER_VERSION}
    write_table(handle, STABILITY, columns, attributes | stored.requests)


def check_names(handle: AtlasStore) -> None:
    """Raise InputError if the machine has a parameter or a result with the name of a measure."""
    shared = {*handle.array_names} & MEASURES.keys()
    if shared:
        raise InputError(f"{handle.backend}: {min(shared)!r} is also the name of a measure; rename it in the system")


def summary_of(arrays: Mapping[str, NDArray[Any]]) -> dict[str, dict[str, float]]:
    """Return for each numeric measure how often it is known, and its smallest, median and largest finite value."""
    summary = {}
    for name, values in arrays.items():
        if MEASURES[name].dtype != "float64":
            continue
        known = values[np.isfinite(values)]
        summary[name] = {"known": int(np.sum(~np.isnan(values)))} | (
            {"least": float(known.min()), "median": float(np.median(known)), "largest": float(known.max())}
            if known.size
            else {}
        )
    return summary
