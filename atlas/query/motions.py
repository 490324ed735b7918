"""Names n-p-q of periodic motions: n forcing periods, p impacts at the upper and q at the lower stop."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from atlas.formatting import motion_name
from workers.results import PERIODIC

VARIABLES = ("period", "impacts_upper", "impacts_lower")


class MotionName(NamedTuple):
    """The name of a periodic motion: n forcing periods, p impacts at the upper stop and q at the lower stop.

    A sticking motion has infinitely many impacts; its n is 0, and p and q are -1.
    """

    n: int
    p: int
    q: int

    @property
    def label(self) -> str:
        """The name as a legend shows it."""
        return motion_name(*self) if self.p >= 0 else "periodic, sticks"


STICKS = MotionName(0, -1, -1)
"""The name that all sticking motions share."""


def motion_keys(period: NDArray[np.int32], upper: NDArray[np.int32], lower: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return n, p and q (..., 3) of periodic cells; those of STICKS for sticking cells.

    Sticking motions have infinitely many impacts.
    """
    keys = np.stack([period, upper, lower], axis=-1).astype(np.int64)
    keys[(keys[..., 1:] < 0).any(axis=-1)] = STICKS
    return keys


def motions(
    regime: NDArray[np.int8], period: NDArray[np.int32], upper: NDArray[np.int32], lower: NDArray[np.int32]
) -> tuple[list[MotionName], NDArray[np.intp]]:
    """Return the names of the motions that periodic cells have, in rising order, and the index of each cell's motion.

    The index is -1 for cells that are not periodic.
    """
    counted = (regime == PERIODIC) & (period >= 1)
    kinds, which = np.unique(motion_keys(period, upper, lower)[counted], axis=0, return_inverse=True)
    number = np.full(regime.shape, -1)
    number[counted] = which.ravel()
    return [MotionName(*map(int, kind)) for kind in kinds], number
