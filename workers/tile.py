"""``solve_tile``: every cell of a tile solved on its own, from arrays of parameters to arrays of results."""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workers.cell import Cell
from workers.model.system import System, find_system
from workers.results import (
    ARITHMETIC,
    FAILED,
    INVALID,
    NO_OSCILLATOR,
    OUT_OF_RANGE,
    REASON,
    InvalidError,
    empty_results,
    reason_counts,
    result_variables,
)
from workers.settings import Settings
from workers.solve import Solving, solving
from workers.stretch import Stretch, ended, run_stretches


class Solution(NamedTuple):
    """Result arrays of a tile."""

    arrays: dict[str, NDArray[Any]]

    @property
    def reasons(self) -> dict[str, int]:
        """Cells that are invalid, failed or given up, by the reason in words."""
        return reason_counts(self.arrays[REASON.name])


def solve_tile(
    system: str, params: Mapping[str, ArrayLike], settings: Settings | None = None
) -> dict[str, NDArray[Any]]:
    """Exponents, regime and periodicity of every cell, as arrays of the parameters' broadcast shape.

    system    name of the system, "two-mass"
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


def solve_cells(system: str, params: Mapping[str, ArrayLike], settings: Settings | None = None) -> Solution:
    """As solve_tile, as a Solution."""
    record = find_system(system)
    settings = settings or Settings()
    for name in params:
        record.parameter(name)
    values = [np.asarray(params.get(p.name, p.default), dtype=np.float64) for p in record.parameters]
    grids = np.broadcast_arrays(*values)
    shape = grids[0].shape
    size = len(record.states)
    variables = result_variables(settings)
    arrays = empty_results(variables, shape, {"exponent": size, "state": size, "sample": settings.section_samples})
    names = [p.name for p in record.parameters]
    cells = [dict(zip(names, cell, strict=True)) for cell in np.stack(grids, axis=-1).reshape(-1, len(names)).tolist()]
    for index, cell in zip(np.ndindex(shape), _solve_together(record, cells, settings), strict=True):
        for variable in variables:
            value = getattr(cell, variable.name)
            if value is not None:
                arrays[variable.name][index] = value
    return Solution(arrays)


def _solve_together(record: System, cells: Iterable[dict[str, float]], settings: Settings) -> list[Cell]:
    """Every cell from its parameters, all of them in batches; whatever happens is a value of the cell."""
    started = [_start(record, values, settings) for values in cells]
    running = {k: one for k, one in enumerate(started) if not isinstance(one, Cell)}
    solved = {k: one for k, one in enumerate(started) if isinstance(one, Cell)}
    waiting: dict[int, Stretch] = {}
    done: dict[int, int] = dict.fromkeys(running, 0)
    ready: dict[int, int | None] = dict.fromkeys(running)
    while ready or waiting:
        for k, count in ready.items():
            try:
                waiting[k], done[k] = running[k].send(count), 0  # type: ignore[arg-type]
            except StopIteration as end:
                solved[k] = end.value
            except (ArithmeticError, np.linalg.LinAlgError):
                solved[k] = Cell(regime=FAILED, reason=ARITHMETIC)
        counts = run_stretches(list(waiting.values()), [done[k] for k in waiting], to_end=False)
        done.update(zip(waiting, counts, strict=True))
        ready = {k: done[k] for k, stretch in waiting.items() if ended(stretch, done[k])}
        for k in ready:
            del waiting[k]
    return [solved[k] for k in range(len(started))]


def _start(record: System, values: dict[str, float], settings: Settings) -> Solving | Cell:
    """A cell to be solved from its parameters, or what it is where they have no motion."""
    for parameter in record.parameters:
        if not parameter.admits(values[parameter.name]):
            return Cell(regime=INVALID, reason=OUT_OF_RANGE)
    try:
        osc = record.build(values)
    except InvalidError as error:
        return Cell(regime=INVALID, reason=error.reason)
    except ValueError:
        return Cell(regime=INVALID, reason=NO_OSCILLATOR)
    return solving(osc, np.array([values[name] for name in record.states]), settings)
