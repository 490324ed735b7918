"""Names of motions and of the regions that they fill in a plane: n-p-q, forcing periods and impacts at either stop."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.formatting import motion_name
from atlas.query import machine
from atlas.query.plane import Cells, Plane
from atlas.spec.system import system_of
from workers.results import CHAOTIC, LOCKING, NO_IMPACT, PERIODIC, QUASIPERIODIC, REGIME, Variable

if TYPE_CHECKING:
    import xarray as xr

VARIABLES = ("period", "impacts_upper", "impacts_lower")
OTHERS = {CHAOTIC: "chaos", QUASIPERIODIC: "tori", NO_IMPACT: "", LOCKING: ""}
"""Names of regions of other motions, if they differ from the names of their regimes."""


class MotionName(NamedTuple):
    """The name of a periodic motion: n forcing periods, p impacts at the upper stop and q at the lower stop.

    A sticking motion has infinitely many impacts; its n is 0, and p and q are -1.
    """

    n: int
    p: int
    q: int

    @property
    def label(self) -> str:
        """The name in a legend."""
        return motion_name(*self) if self.p >= 0 else "periodic, sticks"


STICKS = MotionName(0, -1, -1)
"""All sticking motions."""


def motion_keys(period: NDArray[np.int32], upper: NDArray[np.int32], lower: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return n, p and q (..., 3) of cells with a period; those of STICKS if impacts are infinitely many."""
    keys = np.stack([period, upper, lower], axis=-1).astype(np.int64)
    keys[(keys[..., 1:] < 0).any(axis=-1)] = STICKS
    return keys


def motions(
    regime: NDArray[np.int8], period: NDArray[np.int32], upper: NDArray[np.int32], lower: NDArray[np.int32]
) -> tuple[list[MotionName], NDArray[np.intp]]:
    """Return the motions of periodic cells in rising order, and the index of each cell's motion; -1 if it has none."""
    counted = (regime == PERIODIC) & (period >= 1)
    kinds, which = np.unique(motion_keys(period, upper, lower)[counted], axis=0, return_inverse=True)
    number = np.full(regime.shape, -1)
    number[counted] = which.ravel()
    return [MotionName(*map(int, kind)) for kind in kinds], number


def regions(plane: Plane, twins: bool, regimes: Variable = REGIME) -> Iterator[tuple[str, Cells]]:
    """Yield the name of every class of motion and the mask of its cells (y, x).

    ``regimes`` has the regime names of the machine. If motions have mirror images, the start decides which of the two a
    cell has. Both are then one class, named with the larger number of impacts above. With equal numbers of impacts, a
    motion that is its own mirror image has an s behind its name, others a u.
    """
    period, upper, lower = (plane[name] for name in VARIABLES)
    if twins:
        upper, lower = np.maximum(upper, lower), np.minimum(upper, lower)
    names, number = motions(plane.regime, period, upper, lower)
    for k, motion in enumerate(names):
        cells = number == k
        if twins and motion.p == motion.q >= 0 and "symmetric" in plane.values:
            own = plane["symmetric"].astype(bool)
            yield from ((f"{motion.label} {side}", cells & part) for side, part in (("s", own), ("u", ~own)))
        elif motion.p >= 0:
            yield motion.label, cells
    for code, name in OTHERS.items():
        yield name or regimes.meaning(code).text, plane.regime == code


def broken_cells(ds: "xr.Dataset", plane: Plane) -> Cells:
    """Return the mask of periodic cells (y, x) whose motion has a mirror image other than itself, x(t) != -x(t + T/2).

    Raise InputError if there are periodic cells, but the machine of none has motions with mirror images.
    """
    system, symmetric = system_of(ds.attrs, "kind 'symmetry'"), plane["symmetric"].astype(bool)
    same, periodic = machine.fixed(ds, system), plane.regime == PERIODIC
    rows, columns = np.nonzero(periodic & ~symmetric)
    broken = np.zeros(periodic.shape, bool)
    if not rows.size:
        return broken
    points = {plane.x.name: plane.x.values[columns], plane.y.name: plane.y.values[rows]}
    broken[rows, columns] = machine.has_twins(system, same, points)
    if not broken.any() and not np.any(periodic & symmetric):  # a symmetric motion proves a symmetric machine
        here = {name: float(values[0]) for name, values in points.items()}
        raise InputError(
            f"kind 'symmetry' needs motions with mirror images, and no motion here has one: at "
            f"{', '.join(f'{name} = {value:g}' for name, value in here.items())} "
            f"{machine.why_no_twins(system, same | here)}"
        )
    return broken
