"""``solve_lines``, continuation: lines of cells, each cell started from the attractor of the one before it."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workers.model.system import System, find_system
from workers.settings import Settings
from workers.tile import Solution, solve_cells

Array = NDArray[np.float64]


def solve_lines(
    system: str,
    params: Mapping[str, ArrayLike],
    settings: Settings | None = None,
    *,
    axis: int = -1,
    backward: bool = False,
) -> Solution:
    """Solve every line along one axis of the parameters' broadcast shape as a slow sweep: results as of solve_cells.

    The first cell of a line (with ``backward`` the last) starts from its own initial state. Every other one starts
    from ``state``, the section state on the attractor, of the nearest cell before it that has one: an invalid or
    failed cell has none and is passed over. Where the gap has become narrower than that state needs, its gap
    coordinate is moved onto the stop, as a wall that closes in would push it, and its velocities are kept; an
    outward one is reversed by the impact that follows at once.

    A cell therefore depends on its line, but on no other line. Raises as solve_cells does, ValueError too for an
    axis that does not exist.
    """
    record = find_system(system)
    for name in params:
        record.parameter(name)
    grids = np.broadcast_arrays(*(np.asarray(params.get(p.name, p.default), np.float64) for p in record.parameters))
    shape = grids[0].shape
    if not -len(shape) <= axis < len(shape):
        raise ValueError(f"axis: found {axis}, the cells have {len(shape)} axes")
    if shape[axis] == 0:
        return solve_cells(system, params, settings)
    values = {p.name: np.moveaxis(g, axis, 0) for p, g in zip(record.parameters, grids, strict=True)}
    last: Array | None = None  # per line, the newest state on an attractor; NaN before the first
    solved: list[Solution] = []
    positions = range(shape[axis])
    for i in reversed(positions) if backward else positions:
        here = {name: grid[i] for name, grid in values.items()}
        if last is not None:
            here |= _starts(record, here, last)
        solved.append(solve_cells(system, here, settings))
        states = solved[-1].arrays["state"]
        last = states if last is None else np.where(np.isfinite(states).all(-1, keepdims=True), states, last)
    if backward:
        solved.reverse()
    along = axis % len(shape)
    arrays = {name: np.stack([s.arrays[name] for s in solved], axis=along) for name in solved[0].arrays}
    return Solution(arrays)


def _starts(record: System, here: Mapping[str, Array], last: Array) -> dict[str, Array]:
    """Initial states of the cells at one position of all lines: the newest known ones, their own where none is."""
    states = np.stack([here[name] for name in record.states], axis=-1)
    for index in np.ndindex(last.shape[:-1]):
        if np.all(np.isfinite(last[index])):
            states[index] = _between_stops(
                record, {name: float(grid[index]) for name, grid in here.items()}, last[index]
            )
    return {name: states[..., k] for k, name in enumerate(record.states)}


def _between_stops(record: System, values: Mapping[str, float], state: Array) -> Array:
    """The state with its gap coordinate moved onto the stop that it lies beyond, if it does."""
    try:
        osc = record.build(values)
    except (ValueError, ArithmeticError):
        return state  # solve_cells will call this cell invalid
    row = np.array(osc.gap_row)
    moved = state.copy()
    for _ in range(2):  # the second time takes off what rounding left of the first
        y = float(row @ moved[: row.size])
        moved[: row.size] += row / (row @ row) * (min(max(y, -osc.b_lower), osc.b_upper) - y)
    return moved
