"""Solve a block of cells of a spec, each by itself, or whole lines in which each cell starts from the cell before
it.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from atlas.errors import RunError
from atlas.spec.spec import Slices, Spec
from atlas.store.origin import ALLOWANCES
from atlas.task.compile import ATTRACTORS, kernels_for
from workers import Settings

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from workers.cell.cell_batch import Results


def kernels_of(spec: Spec) -> tuple[str, ...]:
    """Return the names of the compiled kernels that cells of the spec need, see ``compile.kernels_for``."""
    return kernels_for(spec.system_def, *(() if spec.attractors is None else (ATTRACTORS,)), settings=spec.settings)


def solve_independent(spec: Spec, params: Mapping[str, Any], settings: Settings) -> "Results":
    """Solve cells that do not depend on each other, and return their results.

    spec      spec of the atlas: one attractor per cell, all attractors, or basins
    params    parameters by name, arrays that broadcast
    settings  settings of the cells, which may differ from the spec's
    """
    if spec.basins:
        from workers.attractors.basins import solve_basins

        return solve_basins(spec.system_def, params, settings, spec.attractors)
    if spec.coexistence:
        from workers.attractors.coexistence import solve_attractors

        return solve_attractors(spec.system_def, params, settings, spec.attractors)
    from workers.tile import solve_tile

    return solve_tile(spec.system_def, params, settings)


def solve_block(spec: Spec, slices: Slices) -> "Results":
    """Solve the cells in these slices of the atlas and return their results.

    Along a continued axis a cell depends on all earlier cells of its line. Raise RunError for a part of a line.
    """
    params = spec.cell_params(slices)
    if spec.continuation is None:
        return solve_independent(spec, params, spec.settings)
    axis, backward = spec.continuation
    if slices[axis].indices(spec.shape[axis]) != (0, spec.shape[axis], 1):
        raise RunError(f"found a part of a line along {spec.dims[axis]}, which is continued, must be whole lines")
    from workers.sweep import solve_lines

    return solve_lines(spec.system_def, params, spec.settings, axis=axis, backward=backward)


def solve_missing(spec: Spec, slices: Slices, known: Mapping[str, Any], due: "NDArray[np.bool_]") -> "Results":
    """Solve the cells of the mask ``due`` and return the results of all cells in these slices.

    ``known`` are results of the other cells. A cell depends only on its parameters, the settings and the solver. Cells
    known from another store therefore have the values that they would get here. Budgets among the known arrays apply to
    each cell.
    """
    if due.all() and not any(allowance.name in known for allowance in ALLOWANCES):
        return solve_block(spec, slices)
    arrays = {name: values.copy() for name, values in known.items()}
    params = {name: np.broadcast_to(value, due.shape) for name, value in spec.cell_params(slices).items()}
    for settings, cells in _by_settings(spec, known, due):
        results = solve_independent(spec, {name: values[cells] for name, values in params.items()}, settings)
        for name, values in results.items():
            arrays[name][cells] = values
    return arrays


def _by_settings(
    spec: Spec, known: Mapping[str, Any], due: "NDArray[np.bool_]"
) -> "Iterator[tuple[Settings, NDArray[np.bool_]]]":
    """Yield (settings, mask) for each group of cells to be solved with the same settings.

    Settings differ between cells if a retry has raised the budgets of some.
    """
    allowances = [allowance for allowance in ALLOWANCES if allowance.name in known]
    if not allowances:
        yield from [(spec.settings, due)] if due.any() else []
        return
    amounts_of = np.stack([known[allowance.name] for allowance in allowances], axis=-1)
    for amounts in np.unique(amounts_of[due], axis=0).tolist():
        more: dict[str, Any] = {allowance.setting: n for allowance, n in zip(allowances, amounts, strict=True)}
        yield replace(spec.settings, **more), due & (amounts_of == amounts).all(axis=-1)
