"""The tasks of a search for curves as small records, and the function that executes them."""

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
"""Maximum step along a curve, relative to the width of the plane."""


@dataclass(frozen=True)
class PersistTask:
    """Task: for each pair of cells, find whether the first cell's orbit exists and attracts at the second cell's
    parameters.
    """

    pairs: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class FindEventsTask:
    """Task: find the bifurcations and grazes of the orbits of some cells, each followed towards a neighbouring cell.

    directions  pairs of cell and neighbour; the result has the events of the first pair with any
    cells       distance, in cells, over which an orbit is followed
    """

    directions: tuple[tuple[int, int], ...]
    cells: float


@dataclass(frozen=True)
class FollowTask:
    """Task: follow the curve of a bifurcation or graze that an earlier task found.

    part    name of the stored result of the earlier task
    event   index of the event in that result
    budget  maximum number of points in either direction
    """

    part: str
    event: int
    budget: int


@dataclass(frozen=True)
class MatchTask:
    """Task: find for curves that pass a cell whether the curve's orbit becomes the orbit of the cell.

    Each entry of ``passings`` is a tuple. It has the name of the stored result with the curve, the index of a chord
    between two points of the curve, the position on the chord from 0 to 1, and the number of the cell.
    """

    passings: tuple[tuple[str, int, float, int], ...]


Task = PersistTask | FindEventsTask | FollowTask | MatchTask
Known = Callable[[str], dict[str, Any]]
"""Function that returns the stored result of an earlier task by its name."""


def run_task(task: Task, orbits: CellOrbits, known: Known, curve_of: Callable[[str], FollowedCurve]) -> dict[str, Any]:
    """Execute a task of a search and return its result as dicts, lists and numbers, which JSON stores exactly.

    task      the task
    orbits    orbits of the plane's cells
    known     returns the result of an earlier task by its name
    curve_of  returns the curve in the result of an earlier task by its name
    """
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
    """Do a FindEventsTask. Return the events of the first direction with any, or the reason for each direction
    without.
    """
    why, fates = list[str](), list[int]()
    for start, beyond in task.directions:
        result = events_between(orbits, start, beyond, task.cells)
        if result.events:
            return {"events": [event_as_json(event) for event in result.events]}
        why.append(result.why)
        fates.append(result.fate)
    return {"events": [], "why": "; ".join(dict.fromkeys(why)), "there": max(fates, default=CEASES)}
