"""The budget of a search."""

import hashlib
from dataclasses import asdict, dataclass, fields

from atlas.argument_checks import is_integer
from atlas.errors import InputError, brief_repr
from atlas.orbits.curves.plane import SMALL, CurvePlane
from workers import SOLVER_VERSION

VERSION = 5
"""Of the search: raised whenever any curve may change."""


@dataclass(frozen=True)
class CurveSettings:
    """The budget of a search, in counts, so that no result depends on a machine's speed; InputError below 1.

    edges       largest number of places beside edges where events are searched for
    curves      largest number of curves that are followed
    points      largest number of points of all curves; the table marks a curve that this limit ends
    min_cells   smallest region, in cells, beside which events are searched for; 1 takes long

    >>> import atlas
    >>> atlas.CurveSettings(edges=40, points=2000).curves
    300
    """

    edges: int = 1000
    curves: int = 300
    points: int = 60_000
    min_cells: int = SMALL

    def __post_init__(self) -> None:
        for limit in fields(self):
            value = getattr(self, limit.name)
            if not is_integer(value) or value < 1:
                raise InputError(f"{limit.name}: found {brief_repr(value)}, must be a whole number, 1 or more")

    def digest(self, plane: CurvePlane) -> str:
        """The digest of the cells and the budget."""
        return hashlib.sha256(
            repr((plane.digest, sorted(asdict(self).items()), SOLVER_VERSION, VERSION)).encode()
        ).hexdigest()
