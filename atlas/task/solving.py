"""A block of a spec's cells, solved one by one, or in whole lines where an axis is continued."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from atlas.errors import RunError
from atlas.spec.spec import Slices, Spec
from atlas.task.compile import ATTRACTORS, kernels_for
from workers import Settings

if TYPE_CHECKING:
    from workers.cell.cells import Results


def kernels_of(spec: Spec) -> tuple[str, ...]:
    """The kernels that cells of the spec take, see compile.kernels_for."""
    return kernels_for(spec.record, *(() if spec.attractors is None else (ATTRACTORS,)))


def solve_apart(spec: Spec, params: Mapping[str, Any], settings: Settings) -> "Results":
    """Results of the spec's kind, with these settings, of cells that do not depend on each other."""
    if spec.basins:
        from workers.attractors.basins import solve_basins

        return solve_basins(spec.record, params, settings, spec.attractors)
    if spec.coexistence:
        from workers.attractors.waves import solve_attractors

        return solve_attractors(spec.record, params, settings, spec.attractors)
    from workers.tile import solve_tile

    return solve_tile(spec.record, params, settings)


def solve_block(spec: Spec, slices: Slices) -> "Results":
    """Results of the cells in these slices.

    Along a continued axis a cell depends on all cells before it in its line: RunError for a part of a line.
    """
    params = spec.cell_params(slices)
    if spec.continuation is None:
        return solve_apart(spec, params, spec.settings)
    axis, backward = spec.continuation
    if slices[axis].indices(spec.shape[axis]) != (0, spec.shape[axis], 1):
        raise RunError(f"a part of a line of {spec.dims[axis]}, which is continued, cannot be solved: give whole lines")
    from workers.sweep import solve_lines

    return solve_lines(spec.record, params, spec.settings, axis=axis, backward=backward)
