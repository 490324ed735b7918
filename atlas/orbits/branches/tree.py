"""A tree of branches of periodic orbits in one parameter: branches of given orbits, and branches that fork off at their
events.

An event of a branch is a bifurcation, a graze or a change of contacts or slides.
"""

from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from atlas.orbits.orbit_table import are_on_orbit
from workers.continuation import (
    BranchRun,
    Event,
    Family,
    Itinerary,
    Orbit,
    SolutionPoint,
    branch,
    family_of,
    orbit_from_state,
    section_states,
    switch_branch,
)
from workers.continuation.equilibria import equilibria
from workers.continuation.families import has_images
from workers.continuation.orbits import group_indices, refine_orbit
from workers.model.system import System

Array = NDArray[np.float64]

AMPLITUDES = (0.02, 0.005, 1e-3, 2e-4)
"""Distances from a bifurcation at which an orbit of the branch that forks off there is searched, in turn.

They are in units of the scale of states and times. The branch of an orbit found is accepted if it returns to the
bifurcation.
"""

CONTINUATION_OFFSET = 1e-3
"""Distance of parameter, relative to its window, past an event at which the orbit that continues there is searched."""

LEAVES = ("symmetry_breaking", "period_doubling")
"""Kinds of events at which another branch forks off."""

GOES_ON = (
    "graze", "impact_lost", "contact_lost", "lift_off", "stick_onset", "stick_end", "grazing_sliding", "adding_sliding",
    "vertex", "exchange",
)  # fmt: skip
"""Kinds of events at which a branch may end and a branch with other contacts or slides begin.

If the orbit changes continuously at such an event, the same branch continues through it.
"""


@dataclass(frozen=True, eq=False)
class Branch:
    """One branch of periodic orbits in one parameter.

    run                  points and events of the branch, as they were followed
    itinerary            sequence of impacts and other events of the orbit from which the branch was followed
    sections (N, n, 2d)  states of each of the N orbits at its n sections: once per forcing period; for a cycle, at each
                         passage of the section
    mirrored (N, n, 2d)  states of the mirror images; None if orbits are symmetric, or the machine is not
    origins              numbers of other branches, each with the event at which this branch forks off that branch
    """

    run: BranchRun
    itinerary: Itinerary
    sections: Array
    mirrored: Array | None = None
    origins: tuple[tuple[int, Event | None], ...] = ()

    @property
    def values(self) -> Array:
        """The value (N,) of the parameter at each of the branch's N points."""
        return np.array([point.values[0] for point in self.run.points])

    @property
    def event_indices(self) -> list[int]:
        """The indices of the solution points at which the events of the branch lie, in the order of the events."""
        numbers = {id(point): k for k, point in enumerate(self.run.points)}
        return [numbers[id(event.point)] for event in self.run.events]

    @property
    def itineraries(self) -> list[Itinerary]:
        """The itinerary of the orbit at each point, that is its sequence of impacts and other events.

        A branch may end at an orbit of half the period or of more symmetry. That end has the itinerary of the point
        before.
        """
        itineraries = [point.orbit.itinerary for point in self.run.points]
        for end, neighbour in ((0, 1), (-1, -2)) if len(itineraries) > 1 else ():
            if self.run.ends[end] in LEAVES:
                itineraries[end] = itineraries[neighbour]
        return itineraries

    def ends_at(self, event: Event) -> bool:
        """Return True if the branch ends at a bifurcation or another of its events."""
        return any(self.run.points[end] is event.point and self.run.ends[end] == event.kind for end in (0, -1))

    @property
    def stability_parts(self) -> Iterator[tuple[bool, slice]]:
        """Yield the intervals of the branch in which all orbits are stable (True), or all unstable (False), as slices
        of points.

        Adjacent intervals share the point between them.
        """
        unstable = np.array([point.unstable for point in self.run.points]) > 0
        steps = unstable[1:] | unstable[:-1]
        ends = [0, *(np.flatnonzero(steps[1:] != steps[:-1]) + 1).tolist(), len(steps)]
        return ((not steps[first], slice(first, last + 1)) for first, last in pairwise(ends) if last > first)

    def crossings(self, value: float) -> Iterator[tuple[int, float]]:
        """Yield each passage of the branch through a parameter value.

        A passage is the index of the point before and the position in the step to the next point, from 0 to 1.
        """
        values = self.values
        for k in np.flatnonzero((values[:-1] - value) * (values[1:] - value) <= 0.0):
            if values[k] != values[k + 1]:
                yield int(k), float((value - values[k]) / (values[k + 1] - values[k]))

    def orbit_after(self, family: Family, k: int, share: float, value: float) -> Orbit:
        """Return the exact orbit at a parameter value that the branch passes in the step after point k.

        ``share`` is the position of the value in the step, from 0 at point k to 1 at the next. Raise ValueError if
        Newton's method finds no orbit.
        """
        one, other = self.run.points[k].orbit, self.run.points[k + 1].orbit
        if one.itinerary != other.itinerary:
            raise ValueError("the orbit changes between these points")
        fields = (
            orbit_field + share * (other_field - orbit_field)
            for orbit_field, other_field in zip(one[1:], other[1:], strict=True)
        )
        return refine_orbit(family, Orbit(one.itinerary, *fields), np.array([value]))

    def orbits_at(self, family: Family, value: float) -> Iterator[Orbit]:
        """Yield the exact orbit at each passage of the branch through a value of the parameter."""
        for k, share in self.crossings(value):
            with suppress(ValueError):
                yield self.orbit_after(family, k, share, value)


class UnfollowedEvent(NamedTuple):
    """An event, such as a bifurcation, at which a branch begins that was not followed.

    branch  number of the branch with the event
    event   the event
    why     the reason in words
    """

    branch: int
    event: Event
    why: str


@dataclass
class BranchTree:
    """Branches of periodic orbits in one parameter of a system, with the branches that fork off.

    system    the system
    values    value of each parameter
    along     the free parameter
    window    (low, high) limits of the free parameter
    most      maximum number of branches
    longest   maximum number of impacts of orbits followed from events; each doubling of it doubles the cost
    branches  the branches
    untried   events at which no branch was followed
    """

    system: System
    values: Mapping[str, float]
    along: str
    window: tuple[float, float]
    most: int
    longest: int
    branches: list[Branch] = field(default_factory=list)
    untried: list[UnfollowedEvent] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.family: Family = family_of(self.system, self.values, (self.along,))
        self.twins = has_images(self.system, self.values)

    def grow(self, orbit: Orbit, value: float, leaving: bool) -> None:
        """Follow the branch of an orbit at a parameter value, and add it to the tree.

        With ``leaving`` add also all branches that are connected with it by bifurcations or other events. Raise
        ValueError if the orbit itself cannot be followed.
        """
        first = len(self.branches)
        if self.system.definition.unforced and not orbit.itinerary.sides:
            still = equilibria(self.family, orbit, value, self.window)
            sections = still.states[:, None]
            self.branches.append(Branch(still.run, orbit.itinerary, sections, -sections if self.twins else None))
            return
        self._add(branch(self.family, orbit, value, self.window), orbit.itinerary)
        waiting = deque(self._meetings(first)) if leaving else deque()
        while waiting:
            number, event = waiting.popleft()
            ends, changes = self.branches[number].ends_at(event), event.kind in GOES_ON
            if self._is_met(event) if changes else self._is_known(event, ends):
                continue
            if len(self.branches) >= self.most:
                self.untried.append(UnfollowedEvent(number, event, f"{self.most} branches followed"))
            elif (1 if changes else 2) * len(event.point.orbit.times) > self.longest:
                self.untried.append(UnfollowedEvent(number, event, f"more than {self.longest} impacts"))
            elif (self._go_on if changes else self._follow_shorter if ends else self._follow)(number, event):
                waiting.extend(self._meetings(len(self.branches) - 1))
            else:
                self.untried.append(UnfollowedEvent(number, event, "no orbit found near the event"))

    def states(self, point: SolutionPoint, shift: float = 0.0) -> Array:
        """Return the section states (n, 2d) of the orbit of a point: once per forcing period; for a cycle after each
        event.

        ``shift`` moves the sections, in forcing periods.
        """
        parameters = {name: np.array([value]) for name, value in self.values.items()} | {self.along: point.values}
        return section_states(self.system, parameters, [point.orbit], shift, known=True)[0]

    def _meetings(self, number: int) -> list[tuple[int, Event]]:
        """Return the events, with the branch's number, at which a branch is connected with another branch.

        At such an event the other branch forks off, this branch ends at the other, or it continues as the other.
        """
        traced_branch = self.branches[number]
        return [
            (number, event)
            for event in traced_branch.run.events
            if event.kind in LEAVES or (event.kind in GOES_ON and traced_branch.ends_at(event))
        ]

    def _is_met(self, event: Event) -> bool:
        """Return True if the tree has another event at the orbit of the given event, or at its mirror image."""
        return sum(self._meets(event, other) for branch in self.branches for other in branch.run.events) > 1

    def _go_on(self, number: int, event: Event) -> bool:
        """Add the branch that begins where branch ``number`` ends at an event because its contacts or slides change.

        Return True if the branch is found.
        """
        (low, high), event_value, state = self.window, float(event.point.values[0]), self.states(event.point)[0]
        itinerary, cycle = event.point.orbit.itinerary, None
        if itinerary.is_cycle:
            cycle = float(event.point.orbit.length) / itinerary.turn
        for start_value in (
            event_value + share * sign * (high - low)
            for share in (CONTINUATION_OFFSET, 0.1 * CONTINUATION_OFFSET)
            for sign in (1.0, -1.0)
        ):
            if not low < start_value < high:
                continue
            try:
                parameters = {**self.values, self.along: start_value}
                start = orbit_from_state(self.system, parameters, state, itinerary.periods or 1, cycle=cycle)
                run = branch(self.family, start, start_value, self.window)
            except ValueError:
                continue
            other = start.itinerary not in self.branches[number].itineraries
            if other and any(self._meets(event, end) for end in run.events):
                self._add(run, start.itinerary, (number, event))
                return True
        return False

    def _meets(self, one: Event, other: Event) -> bool:
        """Return True if two events, of any kind, are at the same parameter value and have the same orbit, or mirror
        images.
        """
        near = abs(one.point.values[0] - other.point.values[0]) <= 1e-8 * (self.window[1] - self.window[0])
        return near and self.is_orbit(self.states(one.point)[0], other.point)

    def _follow(self, parent: int, event: Event) -> bool:
        """Add the branch that forks off branch ``parent`` at a bifurcation.

        Return True if a branch is found that returns to the bifurcation.
        """
        low, high = self.window
        for amplitude in AMPLITUDES:
            try:
                start = switch_branch(self.family, event, high - low, amplitude)
                run = branch(self.family, start.orbit, start.value, self.window)
            except ValueError:
                continue
            if any(self._same(event, end) for end in run.events):
                self._add(run, start.orbit.itinerary, (parent, event))
                return True
        return False

    def _follow_shorter(self, number: int, event: Event) -> bool:
        """Add the branch of the orbit of half the period, or of more symmetry, at which branch ``number`` ends.

        Return True if the branch could be followed. It starts near the event, not at it: at the event the test
        function, whose change of sign locates the event, is zero.
        """
        (low, high), event_value = self.window, float(event.point.values[0])
        start_value = event_value + CONTINUATION_OFFSET * (high - low) * (
            1.0 if 2.0 * event_value < low + high else -1.0
        )
        try:
            start = refine_orbit(self.family, event.point.orbit, np.array([start_value]))
            run = branch(self.family, start, start_value, self.window)
        except ValueError:
            return False
        origin = next((met for met in run.events if self._same(met, event)), None)
        ending_branch = self.branches[number]
        self.branches[number] = replace(ending_branch, origins=(*ending_branch.origins, (len(self.branches), origin)))
        self._add(run, event.point.orbit.itinerary)
        return True

    def _is_known(self, event: Event, ends: bool) -> bool:
        """Return True if the tree already has the branch that meets another one at an event.

        If a branch ``ends`` at the event, the branch sought is the one that passes through it; otherwise one that ends
        there.
        """
        others = (other for branch in self.branches for other in branch.run.events if ends != branch.ends_at(other))
        return any(self._same(event, other) for other in others)

    def _same(self, one: Event, other: Event) -> bool:
        """Return True if two events are of one kind and have the same orbit, or mirror images."""
        return one.kind == other.kind and self._meets(one, other)

    def is_orbit(self, state: Array, point: SolutionPoint) -> bool:
        """Return True if a section state (2d,) belongs to the orbit of a point, or to its mirror image."""
        states = self.states(point)
        if self.twins:
            states = np.concatenate([states, -self.states(point, 0.5)])
        return bool(are_on_orbit(states, state))

    def _add(self, run: BranchRun, itinerary: Itinerary, *origins: tuple[int, Event | None]) -> None:
        sections = self._sections(run, 0.0)
        twin = self.twins and not itinerary.symmetric
        mirrored = -self._sections(run, 0.5) if twin else None
        self.branches.append(Branch(run, itinerary, sections, mirrored, origins))

    def _sections(self, run: BranchRun, shift: float) -> Array:
        """Return the section states (N, n, 2d) of the orbits of all points of a run.

        An orbit of half the period, at an end of the branch, has its states repeated. ``shift`` moves the sections, in
        forcing periods.
        """
        states_of = dict[int, Array]()
        for rows in group_indices(point.orbit.itinerary for point in run.points):
            parameters = {name: np.full(len(rows), value) for name, value in self.values.items()}
            parameters[self.along] = np.array([run.points[k].values[0] for k in rows])
            states = section_states(self.system, parameters, [run.points[k].orbit for k in rows], shift)
            states_of |= dict(zip(rows.tolist(), states, strict=True))
        n = max(map(len, states_of.values()))
        return np.stack([np.resize(states_of[k], (n, states_of[k].shape[1])) for k in range(len(run.points))])
