"""The branch of periodic orbits through the orbit of a clicked cell, and branches as plot data of the page.

A branch is a curve of orbits over one parameter, computed by numerical continuation. Its events are bifurcations and
grazes.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from atlas.cell.trajectory import samples_of
from atlas.errors import InputError
from atlas.explore.jobs import Computation
from atlas.explore.motion import POINTS, MotionPlotData, motion_through
from atlas.explore.subject import Subject, slider_range
from atlas.explore.text import number
from atlas.explore.view_state import FollowedOrbit, Range, ViewState
from atlas.explore.view_state import Point as Where
from atlas.orbits.branches.from_cell import tree_from
from atlas.orbits.branches.seed import seed_of_point
from atlas.orbits.branches.table import BranchTable, modulus
from atlas.task.compile import ORBITS, compile_once, kernels_for
from workers import Settings
from workers.model.system import System

if TYPE_CHECKING:
    from atlas.orbits.branches.tree import Branch, BranchTree
    from workers.continuation import Family, SolutionPoint

Array = NDArray[np.float64]

BESIDE = 1e-9
"""Time before an event, as a share of the forcing period, at which the motion before the event is drawn."""
ENDS = {
    "budget": "most points", "stalled": "no further point found", "inadmissible": "orbit ceases",
    "shorter_orbit": "shorter orbit",
}  # fmt: skip
"""Words for the ends of a branch that are neither events nor ends of the parameter range, by reason."""


@dataclass(frozen=True)
class BranchDiagram:
    """Branches of periodic orbits as lines over a parameter, by the gap coordinate (the displacement that stops limit).

    stretches   segments of equal stability: True if stable, parameter (N,), gap coordinate (N,)
    events      kind, parameter and gap coordinate of each event
    """

    stretches: tuple[tuple[bool, Array, Array], ...]
    events: tuple[tuple[str, float, float], ...]

    @classmethod
    def from_table(cls, table: BranchTable) -> "BranchDiagram":
        """Return the diagram of all branches of a table and of their mirror images.

        Events are marked on the branches themselves, not on their mirror images.
        """
        events = []
        for branch in table.traced:
            gap = next(iter(table.gap_values(branch)))
            for k, event in zip(branch.event_indices, branch.run.events, strict=True):
                events += [(event.kind, float(branch.values[k]), float(value)) for value in gap[k]]
        return cls(tuple((stable, *line.T) for stable, line in table.lines()), tuple(events))


class BranchMarker(NamedTuple):
    """An event of a branch, or an end of the branch.

    point_index   index, along the branch, of the solution point at the event
    kind          kind of the event or end, in words
    value         value of the parameter at the event
    """

    point_index: int
    kind: str
    value: float


class BranchPosition(NamedTuple):
    """An orbit on a branch: a computed solution point, or an orbit between two of them.

    point_index   index of the orbit's solution point, or of the solution point before it along the branch
    value         value of the parameter
    point         the orbit as a solution point
    kind          kind, in words, of the event at the orbit; empty if there is no event
    """

    point_index: int
    value: float
    point: "SolutionPoint"
    kind: str = ""

    @property
    def multiplier(self) -> float:
        """The largest modulus of the orbit's Floquet multipliers."""
        return modulus(self.point, self.point.orbit.itinerary)


@dataclass(frozen=True)
class FollowedBranch:
    """The branch of periodic orbits that contains the orbit of a cell.

    table       table of branches with this branch only
    own_index   index of the solution point that is the cell's own orbit
    """

    table: BranchTable
    own_index: int

    @property
    def branch(self) -> "Branch":
        """The branch itself."""
        return self.table.traced[0]

    @cached_property
    def values(self) -> list[float]:
        """The value of the parameter at each solution point of the branch."""
        values: list[float] = self.branch.values.tolist()
        return values

    @cached_property
    def events(self) -> list[BranchMarker]:
        """The events (bifurcations and grazes) of the branch, in order along it."""
        events = zip(self.branch.event_indices, self.branch.run.events, strict=True)
        return [BranchMarker(k, event.kind.replace("_", " "), self.values[k]) for k, event in events]

    @cached_property
    def _family(self) -> "Family":
        from workers.continuation import family_of

        return family_of(self.table.system, self._all(self.values[self.own_index]), (self.table.along,))

    def _all(self, value: float) -> dict[str, float]:
        return {**self.table.parameters, self.table.along: value}

    def position_at(self, index: int, value: float) -> BranchPosition:
        """Return the orbit at a parameter value between the solution points ``index`` and ``index + 1``.

        The orbit is found by Newton's method. If it fails, or the value does not lie between the two points, return the
        solution point ``index`` itself.
        """
        from workers.continuation import SolutionPoint
        from workers.continuation.equations import motion_of
        from workers.continuation.floquet import multipliers
        from workers.continuation.itinerary import many_orbits

        index = min(max(index, 0), len(self.values) - 1)
        shares = [share for k, share in self.branch.crossings(value) if k == index and 0.0 < share < 1.0]
        with suppress(ValueError):
            for share in shares:
                orbit, at = self.branch.orbit_after(self._family, index, share, value), np.array([value])
                modes = multipliers(motion_of(self._family.model(at[None]), many_orbits([orbit])))[0]
                point = SolutionPoint(at, orbit, np.zeros(0), modes, int(np.sum(np.abs(modes) > 1.0)))
                return BranchPosition(index, value, point)
        kind = next((mark.kind for mark in self.events if mark.point_index == index), "")
        return BranchPosition(index, self.values[index], self.branch.run.points[index], kind)

    def find_point(self, value: float, position: BranchPosition) -> int | None:
        """Return where the branch next takes a parameter value: the index of the solution point there or just before.

        Of several passes through the value the pass nearest to ``position`` along the branch counts. Return None if the
        branch does not reach the value.
        """
        passes = [
            (abs(k + share - position.point_index), k + int(share == 1.0)) for k, share in self.branch.crossings(value)
        ]
        return min(passes)[1] if passes else None

    def neighbouring_events(self, position: BranchPosition) -> tuple[BranchMarker | None, BranchMarker | None]:
        """Return the nearest event, or end of the branch, before and after an orbit.

        An element is None if the branch leaves the parameter range on that side before any event.
        """
        last, ends = len(self.values) - 1, self.branch.run.ends
        marks = [
            BranchMarker(k, ENDS[end], self.values[k]) for k, end in zip((0, last), ends, strict=True) if end in ENDS
        ]
        marks = sorted({mark.point_index: mark for mark in (*marks, *self.events)}.values())
        index = (
            position.point_index if position.value == self.values[position.point_index] else position.point_index + 0.5
        )
        before = [mark for mark in marks if mark.point_index < index]
        after = [mark for mark in marks if mark.point_index > index]
        if "closed" in ends:
            before, after = before or after, after or before[:1]
        return (before[-1] if before else None), (after[0] if after else None)

    def motion(self, position: BranchPosition) -> MotionPlotData:
        """Return the plot data of an orbit over its whole period.

        The motion is evaluated in closed form from event to event, so that unstable orbits close, too. Its evenly
        spaced times start at t = k T, the start of a forcing period T, or at the first event of a limit cycle.
        """
        from workers.continuation.equations import motion_of
        from workers.continuation.itinerary import many_orbits

        orbit = position.point.orbit
        machine, periods = self._family.model(np.array([[position.value]])), orbit.itinerary.periods or 1
        count = min(samples_of(self.table.system) // 2, POINTS // periods)
        turn = orbit.span(machine)
        period = turn * (1 + orbit.itinerary.symmetric) / periods
        events = np.concatenate([orbit.times + k * turn for k in range(1 + orbit.itinerary.symmetric)])
        events = np.mod([events, events - BESIDE * period], periods * period).ravel()  # times may lie outside the turn
        times = np.concatenate([np.arange(periods * count + 1) / count * period, events])
        order = np.argsort(times, kind="stable")
        states = motion_of(machine, many_orbits([orbit])).states_at(times[None, order])[0][0] + machine.rest
        return motion_through(
            self.table.system.build(self._all(position.value)), states, order < periods * count, count
        )


class EventArrow(NamedTuple):
    """An arrow with a text over the plane, from an orbit to its next event or to the edge of the visible range."""

    x0: float
    y0: float
    x1: float
    y1: float
    text: str


def distance(mark: BranchMarker, position: BranchPosition) -> str:
    """Return the signed difference in the parameter from an orbit to an event, as text with up to five digits."""
    away = mark.value - position.value
    return f"{'+' if away > 0 else ''}{number(away, 5)}"


def arrows(
    branch: FollowedBranch, position: BranchPosition, subject: Subject, view: ViewState, cell: Where
) -> list[EventArrow]:
    """Return arrows over the map from an orbit of a branch to its next event on either side.

    branch     the branch
    position   the orbit on the branch
    subject    the subject that is explored
    view       the view state of the page, with the visible range
    cell       the cell whose branch is followed, as its plane and its values of both axes

    The list is empty if the branch is followed along a parameter that is no axis of the map.
    """
    if branch.table.along not in subject.axes:
        return []
    (_, x, y), across = cell, branch.table.along == subject.axes[0]
    low, high = view.x if across else view.y
    event_arrows = []
    for mark in filter(None, branch.neighbouring_events(position)):
        begin, end = (min(max(value, low), high) for value in (position.value, mark.value))
        if begin != end:
            text = f"{mark.kind} {distance(mark, position)}"
            event_arrows.append(EventArrow(begin, y, end, y, text) if across else EventArrow(x, begin, x, end, text))
    return event_arrows


def initial_follow(subject: Subject, view: ViewState, cell: Where, along: str) -> FollowedOrbit:
    """Return the state of the page when it begins to follow a cell's own orbit along the parameter ``along``.

    The branch is computed with smaller steps over the visible range of an axis, or over the slider's range of another
    parameter.
    """
    value, parameter = subject.values(*cell)[along], subject.system.parameter(along)
    limits = slider_range(parameter, value)
    seen = dict(zip(subject.axes, (view.x, view.y), strict=True)).get(along, limits)
    low, high = (end if parameter.admits(end) else limit for end, limit in zip(seen, limits, strict=True))
    return FollowedOrbit(along, min(low, value), max(high, value), 0, value)


def branch_computation(subject: Subject, cell: Where, part: tuple[str, float, float]) -> Computation[FollowedBranch]:
    """Return the computation, for a worker, of the branch that contains a cell's orbit.

    subject   the subject that is explored
    cell      the cell, as its plane and its values of both axes
    part      the parameter of the branch, and the limits (low, high) between which it has smaller steps
    """

    def read(branch: FollowedBranch) -> FollowedBranch:
        # The first motion loads the kernels, which must not happen in the page's thread.
        branch.motion(branch.position_at(branch.own_index, branch.values[branch.own_index]))
        return branch

    (along, low, high), axes = part, dict(zip(subject.axes, subject.spec.axes, strict=False))
    ends = (low, high, *(axes[along].values if along in axes else ()))
    windows = (min(ends), max(ends)), (low, high)
    return Computation(
        follow_orbit, (subject.system, subject.values(*cell), subject.spec.settings, along, windows), read
    )


def follow_orbit(arguments: tuple[System, Mapping[str, float], Settings, str, tuple[Range, Range]]) -> FollowedBranch:
    """Return the branch of a cell's orbit along a parameter; this function runs on a worker.

    arguments   system, parameters of the cell, settings, name of the parameter, and two windows (low, high) of it

    The branch covers the first window, with smaller steps in the second window. Raise InputError, with a message of one
    line, if there is no branch.
    """
    from workers.continuation import section_state

    system, values, settings, along, windows = arguments
    compile_once(*kernels_for(system, ORBITS))
    seed = seed_of_point(values, system, settings)
    value, state = seed.values[along], section_state(system, seed.values, seed.orbit)

    def traced(window: Range) -> "tuple[BranchTree, int]":
        tree = tree_from(seed, along, window)
        (branch,) = tree.branches
        near = np.argsort(np.abs(branch.values - value), kind="stable").tolist()
        return tree, next(k for k in near if tree.is_orbit(state, branch.run.points[k]))

    tree, index = traced(windows[0])
    if windows[1] != windows[0]:
        part, part_index = traced(windows[1])
        tree.branches[0], index = _with_part(tree.branches[0], index, part.branches[0], part_index, windows[1])
    if np.ptp(tree.branches[0].values) == 0.0:
        raise InputError(f"the branch of this orbit along {along} has only one point, at {value:g}")
    return FollowedBranch(BranchTable.from_tree(tree), index)


def _with_part(
    full_branch: "Branch", index: int, part: "Branch", part_index: int, window: Range
) -> "tuple[Branch, int]":
    """Return a branch in which the stretch around a cell's orbit is replaced by a finer one, and the orbit's new index.

    full_branch   the branch, computed with large steps
    index         index of the cell's orbit on it
    part          the branch computed with smaller steps within ``window``
    part_index    index of the cell's orbit on ``part``
    window        limits (low, high) of the parameter
    """
    if "closed" in full_branch.run.ends + part.run.ends:
        return (part, part_index) if "closed" in part.run.ends else (full_branch, index)
    outside, last = (
        np.flatnonzero((full_branch.values < window[0]) | (full_branch.values > window[1])),
        len(full_branch.values),
    )
    before, after = outside[outside < index], outside[outside > index]
    # If the part ends within its window, the branch ends there, too.
    first = int(before[-1]) + 1 if before.size and part.run.ends[0] == "edge" else 0
    second = int(after[0]) if after.size and part.run.ends[1] == "edge" else last
    pieces = (full_branch, slice(first)), (part, slice(None)), (full_branch, slice(second, None))
    run = part.run._replace(
        points=[point for branch, piece in pieces for point in branch.run.points[piece]],
        events=[
            *(event for k, event in zip(full_branch.event_indices, full_branch.run.events, strict=True) if k < first),
            *part.run.events,
            *(event for k, event in zip(full_branch.event_indices, full_branch.run.events, strict=True) if k >= second),
        ],
        ends=(
            full_branch.run.ends[0] if first else part.run.ends[0],
            (full_branch if second < last else part).run.ends[1],
        ),
    )
    sections = np.concatenate([branch.sections[piece] for branch, piece in pieces])
    mirrored = [branch.mirrored[piece] for branch, piece in pieces if branch.mirrored is not None]
    return replace(
        part, run=run, sections=sections, mirrored=np.concatenate(mirrored) if mirrored else None
    ), first + part_index
