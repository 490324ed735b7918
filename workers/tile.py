"""``solve_tile``: the results of every cell of a tile, a block of cells, as arrays, from arrays of parameters."""

import math
import sys
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import ArrayLike

from workers.cell.autonomous import convert_to_time
from workers.cell.cell_batch import CellBatch, Results
from workers.cell.measures import explain, measure, measure_energy
from workers.cell.observables import observe
from workers.cell.solve import solve
from workers.model.observables import VALUE
from workers.model.oscillator import Array
from workers.model.system import System, find_system
from workers.results import ATTRACTOR, Variable, empty_results
from workers.settings import Settings

MAX_SECTION_BYTES, MIN_BATCH = 64 * 2**20, 256
"""Maximum number of bytes of section states of the active cells; minimum number of active cells."""

MODES_AT_ONCE = 512
"""Maximum number of active cells of machines with modes, since each has a table of its modes."""


def solve_tile(system: str | System, params: Mapping[str, ArrayLike], settings: Settings | None = None) -> Results:
    """Return exponents, regime and periodicity of every cell, as arrays of the parameters' broadcast shape.

    system    name of a system in the package, such as "two-mass", or a System
    params    parameter name -> float or array; all others have their defaults. The arrays broadcast to the shape of
              every result. "spectrum" and "state" have one more axis (2n; "spectrum" 2n - 1 if a coordinate drifts),
              "section" (the last K states at a fixed phase of the force) two (K, 2n)
    settings  see Settings

    Exponents are per forcing period. ``System.variables`` has the variables and their units. A cell depends on its own
    parameters and the settings only, to the bit. A cell never raises an error. It is "invalid" outside the valid range,
    and "failed" if its motion cannot be simulated; "reason" gives the cause. Raise KeyError for an unknown system or
    parameter name, and ValueError for shapes that do not broadcast.

    >>> from workers import solve_tile
    >>> result = solve_tile("two-mass", {"omega": 4.0, "b": [0.1, 0.15]})
    >>> result["largest"].shape
    (2,)
    """
    record, settings = find_system(system), settings or Settings()

    def solve_part(params: dict[str, Array], arrays: Results) -> None:
        unforced, starts = record.definition.unforced, initial_state(record, params)
        cells = CellBatch(*record.build_many(params), starts, settings, arrays, unforced=unforced)
        solve(cells)
        explain(cells, record.definition, params)
        measure(cells, record.definition, params)
        measure_energy(cells)
        observe(cells, record.definition, params)
        if unforced:
            convert_to_time(cells, variables)

    n_sections, variables = settings.max_period + settings.section_samples, record.variables(settings)
    most = MODES_AT_ONCE if record.has_modes else sys.maxsize
    at_once = min(most, max(MIN_BATCH, MAX_SECTION_BYTES // (8 * len(record.states) * n_sections)))
    return solve_parts(record, params, settings, variables, at_once, solve_part)


def solve_parts(
    record: System,
    params: Mapping[str, ArrayLike],
    settings: Settings,
    variables: tuple[Variable, ...],
    at_once: int,
    solve_part: Callable[[dict[str, Array], Results], None],
    attractors: int = 0,
) -> Results:
    """Return the result arrays of all cells, by name; at most ``at_once`` cells are solved together.

    record      the system
    params      as for ``solve_tile``
    settings    see Settings
    variables   result variables
    at_once     maximum number of cells solved together
    solve_part  function that writes the results of N cells from their parameters (N,)
    attractors  number of attractors kept for each cell
    """
    grids = record.complete(params)
    shape = next(iter(grids.values())).shape
    flat = {name: grid.flatten() for name, grid in grids.items()}
    count = math.prod(shape)
    results = result_arrays(variables, settings, count, len(record.states), attractors, record.exponents)
    for begin in range(0, count, at_once):
        part = slice(begin, begin + at_once)
        solve_part(*({name: array[part] for name, array in arrays.items()} for arrays in (flat, results)))
    return {name: array.reshape(shape + array.shape[1:]) for name, array in results.items()}


def initial_state(record: System, params: Mapping[str, Array]) -> Array:
    """Return the initial states (..., 2n) of cells from their parameters (...): displacements, then velocities."""
    return np.stack([params[name] for name in record.states], axis=-1)


def result_arrays(
    variables: tuple[Variable, ...], settings: Settings, count: int, size: int, attractors: int = 0, exponents: int = 0
) -> Results:
    """Return the result arrays of ``count`` cells, by name, filled with the values that stand for no result.

    variables   result variables
    settings    see Settings
    size        number of components of a state
    attractors  number of attractors kept for each cell
    exponents   number of exponents, 0 for ``size``
    """
    sizes = {ATTRACTOR: attractors, "exponent": exponents or size, "state": size}
    sizes |= {"sample": settings.section_samples, VALUE: settings.observe_values}
    return empty_results(variables, (count,), sizes)
