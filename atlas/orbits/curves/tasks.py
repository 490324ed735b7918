"""The tasks of a search as small records, and their execution."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.orbits.curves.cell_orbits import CEASES, CellOrbits
from atlas.orbits.curves.following import FollowedCurve, events_between, follow_event
from atlas.orbits.curves.passages import CurvePassage, orbits_beside
from atlas.orbits.curves.to_json import curve_as_json, event_as_json, event_from_json

RESOLUTION = 0.02
"""Maximum step along a curve, relative to the window."""


@dataclass(frozen=True)
class PersistTask:
    """Task: find which orbits, of the first cell of each pair, exist and attract at the second cell too."""

    pairs: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class FindEventsTask:
    """Task: find the events of the orbits of some cells, from each towards a neighbour, over ``cells`` cells.

    The result has the events of the first direction with any.
    """

    directions: tuple[tuple[int, int], ...]
    cells: float


@dataclass(frozen=True)
class FollowTask:
    """Task: follow the curve of event number ``event`` of the part ``part``, at most ``budget`` points in either
    direction.
    """

    part: str
    event: int
    budget: int


@dataclass(frozen=True)
class MatchTask:
    """Task: find which curves are of the orbits of cells that they pass.

    ``passings`` are (name of the curve's part, chord, share of the chord, cell).
    """

    passings: tuple[tuple[str, int, float, int], ...]


Task = PersistTask | FindEventsTask | FollowTask | MatchTask
Known = Callable[[str], dict[str, Any]]
"""Function that returns the result of an earlier task by the name of its part."""


def run_task(task: Task, orbits: CellOrbits, known: Known, curve_of: Callable[[str], FollowedCurve]) -> dict[str, Any]:
    """Return the result of a task as plain values, exact to the bit."""
    if isinstance(task, PersistTask):
        return {"persist": orbits.fates(np.array(task.pairs, dtype=np.int64)).tolist()}
    if isinstance(task, FindEventsTask):
        return _looked(task, orbits)
    if isinstance(task, FollowTask):
        event = event_from_json(known(task.part)["events"][task.event])
        followed = follow_event(orbits, event, RESOLUTION, task.budget)
        return {"trouble": followed} if isinstance(followed, str) else {"curve": curve_as_json(followed)}
    passings = [CurvePassage(curve_of(name), chord, share) for name, chord, share, _ in task.passings]
    points, values = orbits_beside(passings)
    cells: NDArray[np.int64] = np.array([cell for *_, cell in task.passings], dtype=np.int64)
    return {"match": orbits.belong_to_cells(cells, points, values).tolist()}


def _looked(task: FindEventsTask, orbits: CellOrbits) -> dict[str, Any]:
    """Return the events in the first direction that has any; otherwise the reason for each direction."""
    why, fates = list[str](), list[int]()
    for start, beyond in task.directions:
        result = events_between(orbits, start, beyond, task.cells)
        if result.events:
            return {"events": [event_as_json(event) for event in result.events]}
        why.append(result.why)
        fates.append(result.fate)
    return {"events": [], "why": "; ".join(dict.fromkeys(why)), "there": max(fates, default=CEASES)}
