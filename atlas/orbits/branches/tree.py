"""Branches followed from orbits, with further branches from their events."""

from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.continuation import (
    BranchRun,
    Event,
    Family,
    Itinerary,
    Orbit,
    SolutionPoint,
    branch,
    family_of,
    leaving_branch,
    orbit_from_state,
    section_states,
)
from workers.continuation.equilibria import equilibria
from workers.continuation.families import has_images
from workers.continuation.orbits import alike, refine_orbit
from workers.model.system import System

Array = NDArray[np.float64]

AMPLITUDES = (0.02, 0.005, 1e-3, 2e-4)
"""How far from an event the branch that leaves there is looked for, in turn: one that is near comes back to it."""

CONTINUATION_OFFSET = 1e-3
"""How far from an event, as a share of the window, the orbit is taken that continues through it."""

LEAVES = ("symmetry_breaking", "period_doubling")
"""Kinds of events at which a branch leaves."""

GOES_ON = (
    "graze", "impact_lost", "contact_lost", "lift_off", "stick_onset", "stick_end", "grazing_sliding", "adding_sliding",
    "vertex", "exchange",
)  # fmt: skip
"""Kinds of events at which a branch may end, and one of orbits with other contacts or slides begin: through continuous
ones the branch itself continues."""

SAME_ORBIT = 1e-6
"""Difference, relative to the size of states, below which two orbits at one parameter are the same."""


@dataclass(frozen=True, eq=False)
class Branch:
    """One branch: its run, the itinerary of the orbit it was followed from, and what it leaves.

    sections (N, n, 2d)  states at the n sections of a turn, of each of the N points of the run
    mirrored (N, n, 2d)  those of the mirror images; None where orbits are symmetric, or the machine is not
    origins              other branches, by their numbers, each with the event at which it leaves that one
    """

    run: BranchRun
    itinerary: Itinerary
    sections: Array
    mirrored: Array | None = None
    origins: tuple[tuple[int, Event | None], ...] = ()

    @property
    def values(self) -> Array:
        """The parameter (N,) at each point."""
        return np.array([point.values[0] for point in self.run.points])

    @property
    def event_indices(self) -> list[int]:
        """The number of the point that each event of the run is."""
        numbers = {id(point): k for k, point in enumerate(self.run.points)}
        return [numbers[id(event.point)] for event in self.run.events]

    @property
    def itineraries(self) -> list[Itinerary]:
        """Of the orbit of each point; where the branch ends at a shorter one, of that before."""
        own = [point.orbit.itinerary for point in self.run.points]
        for end, beside in ((0, 1), (-1, -2)) if len(own) > 1 else ():
            if self.run.ends[end] in LEAVES:
                own[end] = own[beside]
        return own

    def ends_at(self, event: Event) -> bool:
        """Whether it ends at an event."""
        return any(self.run.points[end] is event.point and self.run.ends[end] == event.kind for end in (0, -1))

    @property
    def stability_parts(self) -> Iterator[tuple[bool, slice]]:
        """Stretches of points that are all stable, or all unstable, each joined to the next at the point between."""
        unstable = np.array([point.unstable for point in self.run.points]) > 0
        steps = unstable[1:] | unstable[:-1]
        ends = [0, *(np.flatnonzero(steps[1:] != steps[:-1]) + 1).tolist(), len(steps)]
        return ((not steps[first], slice(first, last + 1)) for first, last in pairwise(ends) if last > first)

    def crossings(self, value: float) -> Iterator[tuple[int, float]]:
        """Where it passes a value of the parameter: after which point, and at which share of the step to the next."""
        values = self.values
        for k in np.flatnonzero((values[:-1] - value) * (values[1:] - value) <= 0.0):
            if values[k] != values[k + 1]:
                yield int(k), float((value - values[k]) / (values[k + 1] - values[k]))

    def orbit_after(self, family: Family, k: int, share: float, value: float) -> Orbit:
        """The orbit at a value that it passes after point k; ValueError where Newton's method finds none."""
        one, other = self.run.points[k].orbit, self.run.points[k + 1].orbit
        if one.itinerary != other.itinerary:
            raise ValueError("the orbit changes between these points")
        fields = (here + share * (there - here) for here, there in zip(one[1:], other[1:], strict=True))
        return refine_orbit(family, Orbit(one.itinerary, *fields), np.array([value]))

    def orbits_at(self, family: Family, value: float) -> Iterator[Orbit]:
        """The orbits at a value of the parameter, each between two neighbouring points."""
        for k, share in self.crossings(value):
            with suppress(ValueError):
                yield self.orbit_after(family, k, share, value)


class UnfollowedEvent(NamedTuple):
    """An event of a branch, by its number, at which no branch was followed, and why."""

    branch: int
    event: Event
    why: str


@dataclass
class BranchTree:
    """Branches in one parameter of a system, grown from orbits.

    values    all parameters
    window    the ends of the free one, ``along``
    most      branches in all
    longest   impacts of an orbit that is followed where it leaves another: each doubling costs as much again
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
        """Follow the branch of an orbit; with ``leaving`` all branches that are connected with it by events, too.

        ValueError, in one line, where the orbit itself cannot be followed.
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
                self.untried.append(UnfollowedEvent(number, event, "no orbit found beside it"))

    def states(self, point: SolutionPoint, shift: float = 0.0) -> Array:
        """The section states (n, 2d) of a point; of a cycle those after all its events."""
        given = {name: np.array([value]) for name, value in self.values.items()} | {self.along: point.values}
        return section_states(self.system, given, [point.orbit], shift, known=True)[0]

    def _meetings(self, number: int) -> list[tuple[int, Event]]:
        """The events of a branch at which another one leaves it, or it leaves another, or continues as another."""
        own = self.branches[number]
        return [
            (number, event)
            for event in own.run.events
            if event.kind in LEAVES or (event.kind in GOES_ON and own.ends_at(event))
        ]

    def _is_met(self, event: Event) -> bool:
        """Whether another branch ends at the same orbit."""
        return sum(self._meets(event, other) for branch in self.branches for other in branch.run.events) > 1

    def _go_on(self, number: int, event: Event) -> bool:
        """Add the branch of the orbit with other events that a branch becomes at its end; whether one is found."""
        (low, high), here, state = self.window, float(event.point.values[0]), self.states(event.point)[0]
        own, cycle = event.point.orbit.itinerary, None
        if own.is_cycle:
            cycle = float(event.point.orbit.length) / own.turn
        for beside in (
            here + share * sign * (high - low)
            for share in (CONTINUATION_OFFSET, 0.1 * CONTINUATION_OFFSET)
            for sign in (1.0, -1.0)
        ):
            if not low < beside < high:
                continue
            try:
                given = {**self.values, self.along: beside}
                start = orbit_from_state(self.system, given, state, own.periods or 1, cycle=cycle)
                run = branch(self.family, start, beside, self.window)
            except ValueError:
                continue
            other = start.itinerary not in self.branches[number].itineraries
            if other and any(self._meets(event, end) for end in run.events):
                self._add(run, start.itinerary, (number, event))
                return True
        return False

    def _meets(self, one: Event, other: Event) -> bool:
        """Whether two events of any kind are one orbit, or mirror images."""
        near = abs(one.point.values[0] - other.point.values[0]) <= 1e-8 * (self.window[1] - self.window[0])
        return near and self.is_orbit(self.states(one.point)[0], other.point)

    def _follow(self, parent: int, event: Event) -> bool:
        """Add the branch that leaves at an event; whether one is found that comes back to it."""
        low, high = self.window
        for amplitude in AMPLITUDES:
            try:
                start = leaving_branch(self.family, event, high - low, amplitude)
                run = branch(self.family, start.orbit, start.value, self.window)
            except ValueError:
                continue
            if any(self._same(event, end) for end in run.events):
                self._add(run, start.orbit.itinerary, (parent, event))
                return True
        return False

    def _follow_shorter(self, number: int, event: Event) -> bool:
        """Add the branch of the shorter orbit that a branch ends at; whether it could be followed.

        It starts beside the event, where what changes sign has one.
        """
        (low, high), here = self.window, float(event.point.values[0])
        beside = here + CONTINUATION_OFFSET * (high - low) * (1.0 if 2.0 * here < low + high else -1.0)
        try:
            start = refine_orbit(self.family, event.point.orbit, np.array([beside]))
            run = branch(self.family, start, beside, self.window)
        except ValueError:
            return False
        origin = next((met for met in run.events if self._same(met, event)), None)
        own = self.branches[number]
        self.branches[number] = replace(own, origins=(*own.origins, (len(self.branches), origin)))
        self._add(run, event.point.orbit.itinerary)
        return True

    def _is_known(self, event: Event, ends: bool) -> bool:
        """Whether the branch that leaves at an event is there already: one that ends there.

        Where a branch ``ends`` at it, whether that is there which it leaves.
        """
        others = (other for branch in self.branches for other in branch.run.events if ends != branch.ends_at(other))
        return any(self._same(event, other) for other in others)

    def _same(self, one: Event, other: Event) -> bool:
        """Whether two events are one, or mirror images."""
        return one.kind == other.kind and self._meets(one, other)

    def is_orbit(self, state: Array, point: SolutionPoint) -> bool:
        """Whether a section state (2d,) is one of the orbit of a point, or of its mirror image."""
        states = self.states(point)
        if self.twins:
            states = np.concatenate([states, -self.states(point, 0.5)])
        return bool(
            np.min(np.max(np.abs(states - state), axis=1)) <= SAME_ORBIT * max(1e-300, float(np.max(np.abs(states))))
        )

    def _add(self, run: BranchRun, itinerary: Itinerary, *origins: tuple[int, Event | None]) -> None:
        sections = self._sections(run, 0.0)
        twin = self.twins and not itinerary.symmetric
        mirrored = -self._sections(run, 0.5) if twin else None
        self.branches.append(Branch(run, itinerary, sections, mirrored, origins))

    def _sections(self, run: BranchRun, shift: float) -> Array:
        """States (N, n, 2d) of all points of a run; where it ends at a shorter orbit, those repeated."""
        states_of = dict[int, Array]()
        for rows in alike(point.orbit.itinerary for point in run.points):
            given = {name: np.full(len(rows), value) for name, value in self.values.items()}
            given[self.along] = np.array([run.points[k].values[0] for k in rows])
            states = section_states(self.system, given, [run.points[k].orbit for k in rows], shift)
            states_of |= dict(zip(rows.tolist(), states, strict=True))
        n = max(map(len, states_of.values()))
        return np.stack([np.resize(states_of[k], (n, states_of[k].shape[1])) for k in range(len(run.points))])
