"""The budget of a search for curves, and the version of its method."""

import hashlib
from dataclasses import asdict, dataclass, fields

from atlas.argument_checks import is_integer
from atlas.errors import InputError, brief_repr
from atlas.orbits.curves.plane import SMALL, CurvePlane
from workers import SOLVER_VERSION

VERSION = 5
"""Version of the method of search; incremented whenever any curve that it finds may change."""


@dataclass(frozen=True)
class CurveSettings:
    """The budget of a search, in counts, so that no result depends on a machine's speed.

    edges      maximum number of edges between cells that are searched for a bifurcation or a graze
    curves     maximum number of curves that are followed
    points     maximum number of points of all curves; the table marks a curve that this limit ends
    min_cells  minimum size, in cells, of a region whose edges are searched; 1 takes long

    Raise InputError for a value below 1.

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
        """Return the digest of a search: of the cells, the budget and the version of the method."""
        return hashlib.sha256(
            repr((plane.digest, sorted(asdict(self).items()), SOLVER_VERSION, VERSION)).encode()
        ).hexdigest()
