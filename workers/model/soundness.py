"""Whether a definition makes a machine at the defaults of its parameters: what no machine can be is refused at once."""

from collections.abc import Iterable

import numpy as np

from workers.model.definition import Definition
from workers.model.modes import undamped_modes
from workers.model.oscillator import Array, Machines
from workers.model.parameter import Parameter
from workers.model.reading import DefinitionError

ROUNDING = 1e-12
"""Relative size of an eigenvalue that counts as zero."""


def check_at_defaults(definition: Definition, parameters: Iterable[Parameter]) -> None:
    """DefinitionError in one line unless the machine of the defaults is one.

    M symmetric and positive definite; C and K symmetric and positive semidefinite; 0 <= R <= 1; the lower stop below
    the upper one; a gap row other than zero, which sees every free motion, K x = 0.
    """
    many = definition.machines({p.name: np.array([p.default]) for p in parameters})
    machine = Machines(*(field[0] for field in many))
    matrices = {"mass": machine.mass, "damping": machine.damping, "stiffness": machine.stiffness}
    rest = {"gap": machine.gap_row, "load": machine.load, "restitution": machine.R}
    forces = [(f"force of order {k + 1}", row) for part in (machine.force_sin, machine.force_cos)
              for k, row in enumerate(part)]  # fmt: skip
    for name, entries in (*matrices.items(), *rest.items(), *forces):
        if not np.isfinite(entries).all():
            raise DefinitionError(f"system.{name}: found {_shown(entries)} at the defaults, must be finite numbers")
    for name, matrix in matrices.items():
        _check_matrix(f"system.{name}", matrix, definite=name == "mass")
    if not 0.0 <= machine.R <= 1.0:
        raise DefinitionError(f"system.restitution: found {machine.R:g} at the defaults, must be 0 to 1")
    if not machine.lower < machine.upper:
        raise DefinitionError(
            f"system.upper: found {machine.upper:g}, lower {machine.lower:g} at the defaults, "
            "must be above lower; stops are positions of the gap coordinate"
        )
    if not machine.gap_row.any():
        raise DefinitionError("system.gap: found zeros only; give the row that makes y of the coordinates")
    _check_free_motions(machine)


def _check_matrix(where: str, matrix: Array, definite: bool) -> None:
    unequal = np.argwhere(matrix != matrix.T)
    if unequal.size:
        i, k = map(int, unequal[0])
        raise DefinitionError(
            f"{where}: found [{i}][{k}] = {matrix[i, k]:.17g} and [{k}][{i}] = {matrix[k, i]:.17g} at the defaults, "
            "must be symmetric"
        )
    values = np.linalg.eigvalsh(matrix)
    least, size = float(values[0]), float(np.max(np.abs(values)))
    if definite and not least > ROUNDING * size:
        raise DefinitionError(f"{where}: its least eigenvalue is {least:g} at the defaults, must be positive definite")
    if least < -ROUNDING * size:
        raise DefinitionError(f"{where}: its least eigenvalue is {least:g} at the defaults, must be 0 or more")


def _check_free_motions(machine: Machines) -> None:
    """The gap sees one free motion at most: of two, some combination leaves y as it is."""
    with np.errstate(all="ignore"):
        squares, modes = (of[0] for of in undamped_modes(machine.mass[None], machine.stiffness[None]))
    if not np.isfinite(modes).all():
        raise DefinitionError(
            f"system.mass: found {_shown(machine.mass)} at the defaults, with stiffness {_shown(machine.stiffness)}, "
            "must be large enough that stiffness over mass is within double precision"
        )
    free = modes[:, squares <= ROUNDING * max(float(squares[-1]), 1e-300)]
    seen = np.abs(machine.gap_row @ free)
    if free.shape[1] > 1 or np.any(seen <= ROUNDING * np.abs(machine.gap_row) @ np.abs(free)):
        raise DefinitionError(
            "system.stiffness: leaves a free motion that the gap does not see; tie it down by a spring, or take the "
            "relative displacement as the coordinate"
        )


def _shown(entries: Array) -> str:
    return str(np.asarray(entries).tolist())
