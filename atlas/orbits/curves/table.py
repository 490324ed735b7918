"""The curves of a plane as data classes, and their conversion to and from the arrays of a group in the store."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from atlas.errors import ChunkError, message_of
from atlas.formatting import motion_name
from atlas.store.groups import CURVES, read_group, write_group
from atlas.store.schema import StoredArray
from atlas.store.store import AtlasStore

VERSION = 1
"""Version of the arrays' layout in the store. Curves stored with another version count as absent."""

KINDS = (
    "fold", "symmetry_breaking", "period_doubling", "neimark_sacker", "graze", "impact_lost", "lift_off",
    "stick_onset", "stick_end", "grazing_sliding", "adding_sliding", "exchange", "hopf",
)  # fmt: skip
"""Kinds of events that have curves. If an impact is lost, the curve is stored as that of the graze of the orbit without
the impact.
"""


class CodimTwoPoint(NamedTuple):
    """A point of codimension two on a curve.

    kind   cusp, fold_flip, resonance_1_1 to resonance_1_4, double_graze, graze_fold and the like
    x      value of the x axis
    y      value of the y axis
    after  index of the curve's point at this position, or else just before it
    """

    kind: str
    x: float
    y: float
    after: int


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve in a two-parameter plane on which one orbit meets one event: a bifurcation, a graze or the like.

    kind                one of KINDS
    period              period of the orbit in forcing periods
    impacts_upper (N,)  impacts of the orbit at the upper stop
    impacts_lower (N,)  impacts of the orbit at the lower stop
    symmetric           True if the orbit is its own mirror image
    points (N, 2)       points in order along the curve, x axis first; the last point of a closed curve is the first
    unstable (N,)       number of multipliers with modulus above 1, not counting the event's own
    ends                why the curve ends at its first and its last point: edge, closed, budget, stalled, inadmissible,
                        shorter_orbit, or the kind of a point of codimension two
    corners             its points of codimension two, in order along the curve

    Numbers of impacts may change along a curve where nothing jumps. An orbit and its mirror image have the same curves;
    the numbers are those of the orbit with more impacts at the upper stop. Where ``unstable`` is 0 the orbit is
    otherwise stable, and the curve bounds a region in which an attractor can exist.
    """

    kind: str
    period: int
    impacts_upper: NDArray[np.int64]
    impacts_lower: NDArray[np.int64]
    symmetric: bool
    points: NDArray[np.float64]
    unstable: NDArray[np.int64]
    ends: tuple[str, str]
    corners: tuple[CodimTwoPoint, ...] = ()

    @property
    def label(self) -> str:
        """Name of the orbit as n-p-q: period, impacts at the upper stop, impacts at the lower stop.

        If the numbers of impacts change along the curve, the names are listed in order along it.
        """
        counts = zip(self.impacts_upper.tolist(), self.impacts_lower.tolist(), strict=True)
        return ", ".join(dict.fromkeys(motion_name(self.period, upper, lower) for upper, lower in counts))

    @property
    def is_bounding(self) -> NDArray[np.bool_]:
        """The mask (N,) of points at which all multipliers but the critical multipliers lie in the unit circle.

        There the orbit is stable on one side of the curve.
        """
        return self.unstable == 0

    @property
    def stable_parts(self) -> list[tuple[int, int]]:
        """The intervals of the curve on which all multipliers but the critical multipliers lie in the unit circle.

        Each interval is given by the indices of its first and its last point.
        """
        steps = self.is_bounding[1:] & self.is_bounding[:-1]
        ends = np.flatnonzero(np.diff(np.concatenate([[False], steps, [False]]).astype(np.int8)))
        return list(zip(ends[::2].tolist(), ends[1::2].tolist(), strict=True))

    @property
    def stable_lines(self) -> list[NDArray[np.float64]]:
        """The points (N, 2) of each interval of the curve whose orbits are stable on one side of it, see
        ``stable_parts``.
        """
        return [self.points[first : last + 1] for first, last in self.stable_parts]

    @property
    def stable_corners(self) -> list[CodimTwoPoint]:
        """The points of codimension two in or next to an interval of ``stable_parts``."""
        return [
            corner for corner in self.corners if self.is_bounding[max(0, corner.after - 1) : corner.after + 2].any()
        ]

    @property
    def loose_ends(self) -> list[NDArray[np.float64]]:
        """The ends (2,) of the intervals of ``stable_parts`` that lie inside the plane, away from points of codimension
        two.

        At such an end the search gave up, the orbit ceased, or it is unstable beyond.
        """
        why = {0: self.ends[0], len(self.points) - 1: self.ends[1]}
        ends = [k for part in self.stable_parts for k in part if why.get(k) not in ("edge", "closed")]
        return [self.points[k] for k in ends if all(abs(corner.after - k) > 2 for corner in self.corners)]


@dataclass(frozen=True, eq=False)
class Curves:
    """All curves of a plane, with the report on their search.

    axes    names of the axes, x first
    curves  the curves
    report  report on the search as dicts and numbers, see ``atlas.orbits.curves.search_result.report_of``
    """

    axes: tuple[str, str]
    curves: tuple[Curve, ...]
    report: Mapping[str, Any] = field(default_factory=dict)

    def __iter__(self) -> Iterator[Curve]:
        return iter(self.curves)

    def __len__(self) -> int:
        return len(self.curves)

    def of_kind(self, kind: str | None) -> tuple[Curve, ...]:
        """Return the curves of one kind; all if ``kind`` is None."""
        return tuple(curve for curve in self.curves if kind in (None, curve.kind))


def write_curves(handle: AtlasStore, curves: Curves) -> None:
    """Write the curves to their group in the store, completely or not at all, replacing any earlier curves."""
    attributes = {"version": VERSION, "axes": list(curves.axes), "report": dict(curves.report)}
    write_group(handle, CURVES, as_arrays(curves), attributes)


def read_curves(handle: AtlasStore) -> Curves | None:
    """Return the curves stored with an atlas, None if there are none. Raise ChunkError if they are damaged."""
    stored = read_group(handle, CURVES)
    if stored is None or stored[1].get("version") != VERSION:
        return None
    try:
        return from_arrays(*stored)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise ChunkError(handle.backend, {CURVES: f"is damaged ({message_of(error)})"}) from None


def as_arrays(table: Curves) -> dict[str, StoredArray]:
    """Return the curves as arrays with the dimensions ``curve``, ``point`` and ``corner``, a point of codimension two.

    Points of all curves are concatenated, with the number of points of each in ``row_size``, as in CF's ragged arrays.
    """
    curves = table.curves
    corners = [(number, corner) for number, curve in enumerate(curves) for corner in curve.corners]

    def words(values: list[str], dim: str, meaning: str) -> StoredArray:
        return StoredArray(np.array(values, dtype="T"), (dim,), {"long_name": meaning})

    def numbers(values: ArrayLike, dtype: str, dim: str, meaning: str) -> StoredArray:
        return StoredArray(np.array(values, dtype=dtype), (dim,), {"long_name": meaning, "units": "1"})

    def of_points(name: str, meaning: str) -> StoredArray:
        parts = [getattr(curve, name) for curve in curves]
        return numbers(np.concatenate([np.zeros(0, dtype=np.int64), *parts]), "int32", "point", meaning)

    def places(parts: list[Any], dim: str, meaning: str) -> StoredArray:
        return StoredArray(np.concatenate([np.zeros((0, 2)), *parts]), (dim, "axis"), {"long_name": meaning})

    sizes = numbers([len(curve.points) for curve in curves], "int64", "curve", "points of the curve")
    sizes.attributes["sample_dimension"] = "point"
    return {
        "kind": words([curve.kind for curve in curves], "curve", "kind of event"),
        "period": numbers([curve.period for curve in curves], "int32", "curve", "forcing periods per orbit"),
        "symmetric": numbers([curve.symmetric for curve in curves], "bool", "curve", "orbit is its own mirror image"),
        "first_end": words([curve.ends[0] for curve in curves], "curve", "why the curve ends at its first point"),
        "last_end": words([curve.ends[1] for curve in curves], "curve", "why the curve ends at its last point"),
        "row_size": sizes,
        "unstable": of_points("unstable", "unstable multipliers besides the event's own"),
        "impacts_upper": of_points("impacts_upper", "impacts at the upper stop per orbit"),
        "impacts_lower": of_points("impacts_lower", "impacts at the lower stop per orbit"),
        "position": places([curve.points for curve in curves], "point", "points of all curves, end to end"),
        "corner_curve": numbers([number for number, _ in corners], "int32", "corner", "its curve, from 0"),
        "corner_kind": words([corner.kind for _, corner in corners], "corner", "kind of point of codimension two"),
        "corner_after": numbers(
            [corner.after for _, corner in corners], "int64", "corner", "its curve's point that it follows, from 0"
        ),
        "corner_position": places(
            [[(corner.x, corner.y)] for _, corner in corners], "corner", "points of codimension two"
        ),
        "axis": words(list(table.axes), "axis", "axis of the plane"),
    }


def from_arrays(arrays: Mapping[str, NDArray[Any]], attributes: Mapping[str, Any]) -> Curves:
    """Return the curves from the arrays of ``as_arrays``."""
    first, last = attributes["axes"]
    corners: list[list[CodimTwoPoint]] = [[] for _ in arrays["kind"]]
    parts = [arrays[f"corner_{name}"] for name in ("curve", "kind", "position", "after")]
    for number, kind, (x, y), after in zip(*parts, strict=True):
        corners[int(number)].append(CodimTwoPoint(str(kind), float(x), float(y), int(after)))
    ends = np.cumsum(arrays["row_size"])
    curves = tuple(
        Curve(
            kind=str(arrays["kind"][k]),
            period=int(arrays["period"][k]),
            impacts_upper=arrays["impacts_upper"][end - size : end].astype(np.int64),
            impacts_lower=arrays["impacts_lower"][end - size : end].astype(np.int64),
            symmetric=bool(arrays["symmetric"][k]),
            points=arrays["position"][end - size : end].copy(),
            unstable=arrays["unstable"][end - size : end].astype(np.int64),
            ends=(str(arrays["first_end"][k]), str(arrays["last_end"][k])),
            corners=tuple(corners[k]),
        )
        for k, (end, size) in enumerate(zip(ends, arrays["row_size"], strict=True))
    )
    return Curves((str(first), str(last)), curves, attributes["report"])
