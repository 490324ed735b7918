"""The search for the curves that bound the regions of a two-parameter atlas, as stages of tasks.

A task depends only on results of earlier stages. The curves found therefore do not depend on the number of workers, nor
on when a search was stopped and resumed. An edge lies between two neighbouring cells with different orbits; an event is
a bifurcation or a graze of an orbit.

1. Find the edges across which a cell's orbit still exists and attracts. Only basins of attraction end there.
2. At one edge of each pair of regions, find the events at which the orbit of a cell ceases to exist or to attract.
3. Follow the curves of these events, at a time one per kind of event and orbit. Skip events that lie on a known curve.
4. Find which edges these curves explain. Return to 2 for the remaining edges, the longest borders first.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.orbits.curves.borders import BASIN, CURVE, NONE, OPEN, TRIED, BorderSchedule
from atlas.orbits.curves.cell_orbits import CEASES, IS, PERSISTS, CellOrbits
from atlas.orbits.curves.following import FollowedCurve, PlaneEvent, lies_on
from atlas.orbits.curves.passages import ONE_CELL, edge_midpoints, find_passed_edges
from atlas.orbits.curves.plane import CurvePlane
from atlas.orbits.curves.settings import CurveSettings
from atlas.orbits.curves.tasks import FindEventsTask, FollowTask, MatchTask, PersistTask, Task
from atlas.orbits.curves.to_json import curve_from_json, event_from_json
from workers.continuation import Itinerary

CHUNK = 128
"""Maximum number of pairs of cells, or of passages of curves, in one task."""

WAY = 1000
"""Maximum number of points of a curve, to either side of the event from which it is followed."""

SHORT_REACH, LONG_REACH = 2.0, 12.0
"""Distances, in cells, over which a cell's orbit is followed to find the event at which it ends.

SHORT_REACH applies if the orbit ceases at the edge. LONG_REACH applies if only its basin ends there and the orbit
continues.
"""

FAR = "the orbits of its cells have no event within one cell"
SPENT = "the budget of curves or points is spent"

Result = dict[str, Any]


@dataclass
class _Event:
    """An event, that is a bifurcation or a graze, that was found near an edge and whose curve may still have to be
    followed.

    part    name of the part of the store, an intermediate result, in which the event is recorded
    number  index of the event in the part
    event   the event
    edge    index of the edge that the event may explain, -1 for none
    """

    part: str
    number: int
    event: PlaneEvent
    edge: int


@dataclass
class CurveSearch:
    """The state of a search for curves. ``tasks`` returns the next tasks, and ``add_results`` takes their results.

    plane        the atlas in which curves are searched
    settings     the budget
    orbits       orbits of the cells
    curves       curves found
    curve_names  for each curve, the name of the part of the store, an intermediate result, that holds it
    troubles     errors in words
    n_searched   number of edges searched
    points       number of points of all curves
    dropped      number of events not followed for lack of budget
    why          reason, in words, for each searched edge that no curve explains, by the index of the edge
    """

    plane: CurvePlane
    settings: CurveSettings
    orbits: CellOrbits = field(init=False)
    curves: list[FollowedCurve] = field(default_factory=list)
    curve_names: list[str] = field(default_factory=list)
    troubles: list[str] = field(default_factory=list)
    n_searched: int = 0
    points: int = 0
    dropped: int = 0
    why: dict[int, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.orbits = CellOrbits(self.plane)
        self.edges = self.plane.edges
        self.middles = edge_midpoints(self.plane, self.edges)
        self.verdicts: NDArray[np.int64] = np.full(len(self.edges), OPEN)
        self.groups = BorderSchedule(self.plane, self.settings.min_cells)
        self._names: list[str] = []
        self._pending: list[_Event] = []
        self._stages = self._run()
        self._results: list[Result] = []
        self.stage = 0
        self.doing = ""

    def tasks(self) -> dict[str, Task]:
        """Return the tasks of the next stage; empty at the end of the search.

        The key of a task is the name under which its result is stored, as a part of the store.
        """
        for tasks in self._stages:
            if tasks:
                named_tasks = {f"{self.stage:05d}-{k:05d}": task for k, task in enumerate(tasks)}
                self.stage += 1
                self._names = list(named_tasks)
                return named_tasks
            self._results = []
        return {}

    @property
    def n_settled(self) -> int:
        """Number of edges that the search need not look at again: explained, searched without success, or without a
        change.
        """
        return int(np.sum(self.verdicts != OPEN))

    def add_results(self, results: list[Result]) -> None:
        """Take the results of the tasks that ``tasks`` returned last, in the order of these tasks."""
        self._results = results

    def _run(self) -> Iterator[list[Any]]:
        yield from self._find_basins()
        while looks := self.groups.choose(self.verdicts, self.settings.edges - self.n_searched):
            yield from self._look_beside(looks)
            known = len(self.curves)
            while self._pending:
                yield from self._follow()
            if len(self.curves) > known:
                yield from self._explain(known)

    def _find_basins(self) -> Iterator[list[Any]]:
        self.doing = "searching for orbits beyond their regions"
        directions = np.concatenate([self.edges, self.edges[:, ::-1]])
        which = np.tile(np.arange(len(self.edges)), 2)
        inside = self.groups.inside[directions[:, 0]]
        directions, which = directions[inside], which[inside]
        order = np.argsort(directions[:, 0], kind="stable")
        directions, which = directions[order], which[order]
        parts = [slice(k, k + CHUNK) for k in range(0, len(directions), CHUNK)]
        yield [PersistTask(tuple((int(a), int(b)) for a, b in directions[part])) for part in parts]
        for part, result in zip(parts, self._results, strict=True):
            fates = np.array(result.get("persist", [CEASES] * len(directions[part])))
            self.verdicts[which[part][fates == PERSISTS]] = BASIN
            self.verdicts[which[part][fates == IS]] = NONE
            self._note(result)

    def _look_beside(self, edges: list[int]) -> Iterator[list[Any]]:
        self.doing = "searching for events near edges"
        far = [self.verdicts[edge] == BASIN for edge in edges]
        yield [
            FindEventsTask(self.groups.orders(self.edges[edge]), LONG_REACH if beyond else SHORT_REACH)
            for edge, beyond in zip(edges, far, strict=True)
        ]
        self.n_searched += len(edges)
        for name, edge, result in zip(self._names, edges, self._results, strict=True):
            if self.verdicts[edge] == OPEN:
                self.verdicts[edge] = {PERSISTS: BASIN, IS: NONE}.get(result.get("there", CEASES), TRIED)
            self.why[edge] = result.get("why") or result.get("trouble") or FAR
            self.groups.record_attempt(edge, bool(result.get("events")))
            self._note(result)
            for number, event_data in enumerate(result.get("events", [])):
                event = event_from_json(event_data)
                off = np.abs(self.plane.places(event.values[None])[0] - self.middles[edge])
                event_edge = edge if np.max(off) <= ONE_CELL and self.verdicts[edge] == TRIED else -1
                self._pending.append(_Event(name, number, event, event_edge))

    def _follow(self) -> Iterator[list[Any]]:
        """Yield tasks that follow the curves of the events found: of those with equal signature, only the first
        event's.

        Events on known curves are dropped. Events with an equal signature probably lie on the curve of the first and
        are checked again when it is known.
        """
        self.doing = "following curves"
        left, followed_events, signatures = [], list[_Event](), set[Any]()
        for met in self._pending:
            if any(lies_on(self.orbits, met.event, curve) for curve in self.curves):
                self._explained(met)
            elif met.event.signature in signatures:
                left.append(met)
            else:
                signatures.add(met.event.signature)
                followed_events.append(met)
        self._pending = left
        room = max(0, self.settings.curves - len(self.curves))
        followed_events, over = followed_events[:room], followed_events[room:]
        points = max(0, self.settings.points - self.points)
        if not followed_events or points < len(followed_events):
            self.dropped += len(followed_events) + len(over) + len(left)
            self.why |= {met.edge: SPENT for met in self._pending + followed_events + over if met.edge >= 0}
            self._pending = []
            return
        budget = min(WAY, points // (2 * len(followed_events)) or 1)
        self._pending = over + left
        yield [FollowTask(met.part, met.number, budget) for met in followed_events]
        for met, name, result in zip(followed_events, self._names, self._results, strict=True):
            self._note(result)
            if "curve" in result:
                new_curve = curve_from_json(result["curve"])
                self.curves.append(new_curve)
                self.curve_names.append(name)
                self.points += len(new_curve.values)
                self._explained(met)
            elif met.edge >= 0:
                self.why[met.edge] = f"no curve of its {met.event.kind.replace('_', ' ')}: {result.get('trouble')}"

    def _explain(self, known: int) -> Iterator[list[Any]]:
        """Yield tasks that find which edges the new curves explain, and mark these edges.

        A curve explains an edge if it passes within one cell and its orbit becomes the orbit of a cell of the edge. New
        are the curves from index ``known`` on.
        """
        self.doing = "searching for the edges that curves explain"
        unexplained = np.flatnonzero((self.verdicts == OPEN) | (self.verdicts == TRIED))
        passings, which = [], []
        for name, curve in list(zip(self.curve_names, self.curves, strict=True))[known:]:
            rows, chords, shares = find_passed_edges(self.plane, curve.values, self.middles[unexplained])
            for edge, chord, share in zip(unexplained[rows].tolist(), chords.tolist(), shares.tolist(), strict=True):
                for cell in self.edges[edge].tolist():
                    if any(self._may_be(curve.orbits[k].itinerary, cell) for k in (chord, chord + 1)):
                        passings.append((name, chord, share, cell))
                        which.append(edge)
        parts = [slice(k, k + CHUNK) for k in range(0, len(passings), CHUNK)]
        yield [MatchTask(tuple(passings[part])) for part in parts]
        for part, result in zip(parts, self._results, strict=True):
            edges = np.array(which[part], dtype=np.int64)
            self.verdicts[edges[np.array(result.get("match", [False] * len(edges)), dtype=bool)]] = CURVE
            self._note(result)

    def _may_be(self, itinerary: Itinerary, cell: int) -> bool:
        """Return True if a cell's orbit has the period and the numbers of impacts of an itinerary, or of its mirror
        image.

        An itinerary is the sequence of impacts and other events of an orbit.
        """
        plane = self.plane
        counts = {itinerary.impacts(1), itinerary.impacts(-1)}
        cell_counts = {int(plane.impacts_upper[cell]), int(plane.impacts_lower[cell])}
        uncounted = min(cell_counts) < 0
        return (
            bool(plane.proven[cell])
            and plane.period[cell] == itinerary.sections
            and (counts == cell_counts or uncounted)
        )

    def _explained(self, met: _Event) -> None:
        if met.edge >= 0:
            self.verdicts[met.edge] = CURVE

    def _note(self, result: Result) -> None:
        if "trouble" in result:
            self.troubles.append(result["trouble"])
