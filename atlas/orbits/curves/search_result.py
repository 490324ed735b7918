"""The result of a search for curves: each curve once, in a fixed order, with a report on the search."""

from collections import Counter
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.orbits.curves.borders import BASIN, CURVE, NONE, OPEN, TRIED
from atlas.orbits.curves.chords import project_onto_chords
from atlas.orbits.curves.following import FollowedCurve, lies_on
from atlas.orbits.curves.search import CurveSearch
from atlas.orbits.curves.table import KINDS, CodimTwoPoint, Curve, Curves


def finish_search(search: CurveSearch) -> Curves:
    """Return the curves of a search that has ended, without duplicates and in a fixed order, with the report on the
    search.
    """
    retained_curves = [curve for k, curve in enumerate(search.curves) if not _goes_on(search, k)]
    model = search.orbits.family.model
    curves = sorted(
        (as_curve(curve, bool(model(curve.values).mirrored.all())) for curve in retained_curves), key=_order
    )
    return Curves(search.plane.axes, tuple(curves), report_of(search, len(search.curves) - len(retained_curves)))


def report_of(search: CurveSearch, duplicates: int) -> dict[str, Any]:
    """Return the report on a search: the numbers of edges explained, unexplained and not searched, and the errors.

    digest               digest of the cells and of the budget
    settings             budget of the search
    edges                counts of edges between cells, see below
    looked               number of edges searched
    points               number of points of all curves
    events_not_followed  number of bifurcations and grazes whose curves were not followed for lack of budget
    duplicates           number of curves omitted, since a later curve contains them
    unexplained          for each border and reason: the number of ``edges`` that were searched and stay unexplained,
                         the midpoint of the first (``at``), and ``why``, in words
    troubles             errors in words, with their numbers

    ``edges`` are counted in three groups. ``regions`` have regions of at least the settings' minimum number of cells on
    both sides. ``small`` have a smaller region on at least one side. ``others`` are next to cells without a known
    orbit. Each group counts ``all`` edges, edges explained by a ``curve`` or as the border of ``basins``, searched
    edges that stay ``unexplained``, and edges ``not_tried``.
    """
    plane, settings = search.plane, search.settings
    proven = plane.proven[search.edges].all(axis=1)
    large = (plane.region_sizes[plane.regions[search.edges]] >= settings.min_cells).all(axis=1)
    parts = {"regions": proven & large, "small": proven & ~large, "others": ~proven}
    return {
        "digest": settings.digest(plane),
        "settings": asdict(settings),
        "edges": {name: _counts(search.verdicts[mask]) for name, mask in parts.items()},
        "looked": search.n_searched,
        "points": search.points,
        "events_not_followed": search.dropped,
        "duplicates": duplicates,
        "unexplained": _unexplained(search),
        "troubles": dict(sorted(Counter(search.troubles).items())),
    }


def as_curve(followed: FollowedCurve, mirrored: bool) -> Curve:
    """Convert a curve to the form in which it is stored: in order from the end with the smaller x, or y if x is equal.

    If ``mirrored``, the mirror image of each orbit is an orbit too, with the impacts at the two stops exchanged. The
    numbers stored are then those of the orbit with more impacts at the upper stop.
    """
    itinerary = followed.event.orbit.itinerary
    hits = np.array([[orbit.itinerary.impacts(side) for side in (1, -1)] for orbit in followed.orbits], dtype=np.int64)
    if mirrored and np.sum(hits[:, 1]) > np.sum(hits[:, 0]):
        hits = hits[:, ::-1]
    points, unstable, ends, corners = followed.values, followed.unstable, followed.ends, followed.corners
    if tuple(points[-1]) < tuple(points[0]):
        points, unstable, ends, corners, hits = points[::-1], unstable[::-1], ends[::-1], corners[::-1], hits[::-1]
    return Curve(
        kind=followed.event.kind,
        period=itinerary.sections,
        impacts_upper=hits[:, 0].copy(),
        impacts_lower=hits[:, 1].copy(),
        symmetric=itinerary.symmetric,
        points=points.copy(),
        unstable=unstable.copy(),
        ends=(ends[0], ends[1]),
        corners=tuple(CodimTwoPoint(kind, float(at[0]), float(at[1]), _after(points, at)) for kind, at in corners),
    )


def edge_share(counts: dict[str, int]) -> float:
    """Return the share of the edges between cells that a curve or a border of basins explains; NaN if there are no
    edges.

    ``counts`` has the counts of one group of edges, as in ``report_of``.
    """
    return (counts["curve"] + counts["basins"]) / counts["all"] if counts["all"] else float("nan")


def _unexplained(search: CurveSearch) -> list[dict[str, Any]]:
    plane, entries = search.plane, list[dict[str, Any]]()
    for edges in search.groups.edges:
        reasons = dict[str, list[int]]()
        for edge in edges[search.verdicts[edges] == TRIED].tolist():
            reasons.setdefault(search.why[edge], []).append(edge)
        for why, reason_edges in reasons.items():
            middle = plane.values(search.edges[reason_edges[0]]).mean(axis=0)
            at = dict(zip(plane.axes, middle.tolist(), strict=True))
            entries.append({"edges": len(reason_edges), "at": at, "why": why})
    return entries


def _goes_on(search: CurveSearch, k: int) -> bool:
    """Return True if curve number k is part of a curve that was found later.

    Tested are its middle and the points next to its two ends.
    """
    curve = search.curves[k]
    ends = [
        curve.event._replace(
            condition=curve.conditions[at],
            orbit=curve.orbits[at],
            contact_times=curve.contact_times[at],
            values=curve.values[at],
        )
        for at in (1, len(curve.orbits) // 2, len(curve.orbits) - 2)
        if 0 <= at < len(curve.orbits)
    ]
    later = search.curves[k + 1 :]
    return any(all(lies_on(search.orbits, end, other) for end in ends) for other in later)


def _after(points: NDArray[np.float64], at: NDArray[np.float64]) -> int:
    """Return the index of the curve point that comes just before a position (2,) on the curve, or lies there.

    It is an end of the nearest chord, the straight line between two consecutive points.
    """
    if len(points) < 2:
        return 0
    width = np.ptp(points, axis=0)
    scale = np.where(width > 0.0, width, 1.0)
    share, offsets = project_onto_chords(at / scale, points[:-1] / scale, points[1:] / scale)
    nearest = int(np.argmin(np.hypot(*offsets.T)))
    return nearest + int(share[nearest] == 1.0)


def _order(curve: Curve) -> tuple[Any, ...]:
    orbit = (curve.period, int(curve.impacts_upper[0]), int(curve.impacts_lower[0]), not curve.symmetric)
    return (KINDS.index(curve.kind), *orbit, tuple(curve.points[0]), tuple(curve.points[-1]), len(curve.points))


def _counts(verdicts: NDArray[np.int64]) -> dict[str, int]:
    verdicts = verdicts[verdicts != NONE]
    counts = {name: int(np.sum(verdicts == code)) for name, code in (("curve", CURVE), ("basins", BASIN))}
    open_ones = int(np.sum(verdicts == OPEN))
    return {
        "all": len(verdicts),
        **counts,
        "unexplained": len(verdicts) - sum(counts.values()) - open_ones,
        "not_tried": open_ones,
    }
