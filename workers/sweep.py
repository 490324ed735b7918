"""``solve_lines``: slow sweeps along lines of cells; each cell starts from the attractor of the cell before it."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from workers.cell.cell_batch import Results
from workers.kernel.cell_loops import clamp_to_stops
from workers.model.oscillator import Array
from workers.model.system import System, find_system
from workers.results import NO_REASON
from workers.settings import Settings
from workers.tile import initial_state, solve_tile


def solve_lines(
    system: str | System,
    params: Mapping[str, ArrayLike],
    settings: Settings | None = None,
    *,
    axis: int = -1,
    backward: bool = False,
) -> Results:
    """Solve every line along one axis as a slow sweep, and return results as ``solve_tile`` does.

    system    as for ``solve_tile``
    params    as for ``solve_tile``
    settings  as for ``solve_tile``
    axis      axis of the parameters' broadcast shape along which the lines run
    backward  True if each line is solved from its last cell to its first

    The first cell of a line starts from its own initial state. Every other cell starts from the nearest earlier cell
    with ``state``, a state on the attractor at a fixed phase of the force. Invalid and failed cells have no ``state``.
    If the gap has become too narrow for the state, its gap coordinate is moved onto the stop, as by a wall that closes
    in. The velocities stay; an outward velocity is reversed by the impact that follows at once.

    A cell depends on its line, but on no other line. Raise the errors of ``solve_tile``, and ValueError if the axis
    does not exist.
    """
    record = find_system(system)
    grids = record.complete(params)
    shape = next(iter(grids.values())).shape
    if not -len(shape) <= axis < len(shape):
        raise ValueError(f"axis: found {axis}, must be one of the {len(shape)} axes of the cells")
    if shape[axis] == 0:
        return solve_tile(system, params, settings)
    values = {name: np.moveaxis(grid, axis, 0) for name, grid in grids.items()}
    # Per line, the newest state on an attractor; NaN before the first.
    last = np.full((*np.delete(shape, axis), len(record.states)), np.nan)
    solved: dict[int, Results] = {}
    positions = range(shape[axis])
    for i in reversed(positions) if backward else positions:
        line = {name: grid[i] for name, grid in values.items()}
        solved[i] = solve_tile(system, line | _starts(record, line, last), settings)
        states = solved[i]["state"]
        last = np.where(np.isfinite(states).all(-1, keepdims=True), states, last)
    along = axis % len(shape)
    return {name: np.stack([solved[i][name] for i in positions], axis=along) for name in solved[0]}


def _starts(record: System, line: Mapping[str, Array], last: Array) -> dict[str, Array]:
    """Return the initial state of each cell of a line, by the names of the states.

    A line is the set of cells at one position along the axis of the sweep.

    record  the system
    line    parameters of the cells (...)
    last    (..., 2n) newest known state on an attractor; if it is NaN, the cell's own initial state counts

    A gap coordinate beyond a stop is moved onto the stop. Without velocity the mass rests there, see
    kernel.coordinates.start_at.
    """
    states = initial_state(record, line)
    known = np.isfinite(last).all(axis=-1)
    if known.any():
        oscillators, reasons = record.build_many({name: grid[known] for name, grid in line.items()})
        states_inside = last[known].copy()
        for row, upper, lower in oscillators.rigid_stops:
            clamp_to_stops(row, upper, lower, states_inside)
        built = reasons == NO_REASON  # solve_tile marks the others invalid
        states[known] = np.where(built[:, None], states_inside, last[known])
    return {name: states[..., k] for k, name in enumerate(record.states)}
