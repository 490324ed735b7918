"""``solve_tile``: every cell of a tile, from arrays of parameters to arrays of results."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workers.cell.solve import solve
from workers.model.system import System, find_system
from workers.results import REASON, empty_results, reason_counts, result_variables
from workers.settings import Settings

MEMORY_AT_ONCE, LEAST_AT_ONCE = 64 * 2**20, 256
"""Bytes of section states that cells under way may take together; so many cells are under way all the same."""


class Solution(NamedTuple):
    """Result arrays of a tile."""

    arrays: dict[str, NDArray[Any]]

    @property
    def reasons(self) -> dict[str, int]:
        """Cells that are invalid, failed or given up, by the reason in words."""
        return reason_counts(self.arrays[REASON.name])


def solve_tile(
    system: str | System, params: Mapping[str, ArrayLike], settings: Settings | None = None
) -> dict[str, NDArray[Any]]:
    """Exponents, regime and periodicity of every cell, as arrays of the parameters' broadcast shape.

    system    name of a system in the package, such as "two-mass", or a System
    params    parameter name -> float or array; what is left out has its default. The arrays broadcast to the
              shape of every result; "spectrum" and "state" have one more axis (2n), "section" two (K, 2n).
    settings  see Settings

    Exponents are per forcing period. The variables and their units are those of ``results.result_variables``.
    A cell depends on its own parameters and the settings only, to the bit. It never raises for a cell: outside
    the valid range it is "invalid", and "failed" where its motion cannot be followed; "reason" says why.
    Raises KeyError for an unknown system or parameter name and ValueError for shapes that do not broadcast.

    >>> from workers import solve_tile
    >>> result = solve_tile("two-mass", {"omega": 4.0, "b": [0.1, 0.15]})
    >>> result["largest"].shape
    (2,)
    """
    return solve_cells(system, params, settings).arrays


def solve_cells(system: str | System, params: Mapping[str, ArrayLike], settings: Settings | None = None) -> Solution:
    """As solve_tile, as a Solution."""
    record = find_system(system)
    settings = settings or Settings()
    for name in params:
        record.parameter(name)
    values = [np.asarray(params.get(p.name, p.default), dtype=np.float64) for p in record.parameters]
    shape = np.broadcast_shapes(*(value.shape for value in values))
    flat = {p.name: np.broadcast_to(v, shape).flatten() for p, v in zip(record.parameters, values, strict=True)}
    count, size = math.prod(shape), len(record.states)
    variables = result_variables(settings)
    found = empty_results(variables, (count,), {"exponent": size, "state": size, "sample": settings.section_samples})
    at_once = max(LEAST_AT_ONCE, MEMORY_AT_ONCE // (8 * size * (settings.max_period + settings.section_samples)))
    for begin in range(0, count, at_once):
        part = slice(begin, begin + at_once)
        here = {name: column[part] for name, column in flat.items()}
        oscillators, reasons = record.build_many(here)
        starts = np.stack([here[name] for name in record.states], axis=-1)
        solve(oscillators, reasons, starts, settings, {name: array[part] for name, array in found.items()})
    return Solution({name: array.reshape(shape + array.shape[1:]) for name, array in found.items()})
