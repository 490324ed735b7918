"""Branches of periodic orbits as pandas tables: one of branches, one of solution points, one of events."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from atlas.formatting import motion_name, plural
from atlas.query import machine
from atlas.spec.resolved import digest_of
from workers.model.observables import Observable
from workers.model.parameter import OMEGA
from workers.model.system import System, identity
from workers.results import CYCLE_PERIOD, NO_IMPACT

if TYPE_CHECKING:
    import pandas

    from atlas.orbits.branches.tree import Branch, BranchTree, UnfollowedEvent
    from workers.continuation import Itinerary, SolutionPoint


@dataclass(frozen=True, eq=False)
class BranchTable:
    """Branches of periodic orbits of a system in one parameter, with their tables.

    system      the system
    parameters  values of all other parameters
    along       the parameter
    window      (low, high) limits of the parameter
    traced      the branches with their orbits, impact by impact
    untried     events at which a branch was to be followed and is missing
    observable  observable that is plotted in place of the gap coordinate at sections; points have its values too

    ``branches``, ``points`` and ``events`` are pandas frames.
    """

    system: System
    parameters: Mapping[str, float]
    along: str
    window: tuple[float, float]
    traced: tuple["Branch", ...]
    untried: tuple["UnfollowedEvent", ...] = ()
    observable: Observable | None = None

    def __repr__(self) -> str:
        low, high = self.window
        points = sum(len(branch.run.points) for branch in self.traced)
        events = sum(len(branch.run.events) for branch in self.traced)
        counts = (plural(len(self.traced), "branch", "branches"), plural(points, "point"), plural(events, "event"))
        reach = f"{self.system.name} along {self.along} from {low:g} to {high:g}"
        return f"<{type(self).__name__} of {reach}: {', '.join(counts)}>"

    @classmethod
    def from_tree(cls, tree: "BranchTree", observable: Observable | None = None) -> Self:
        """Return the table of a tree of branches that have been followed."""
        others = {name: value for name, value in tree.values.items() if name != tree.along}
        return cls(tree.system, others, tree.along, tree.window, tuple(tree.branches), tuple(tree.untried), observable)

    @cached_property
    def branches(self) -> "pandas.DataFrame":
        """The table of branches, one row per branch, indexed by the number ``branch``. Its columns are:

        period         period of the orbit from which the branch was followed; for a cycle without a force, passages of
                       its section
        impacts_upper  number of its impacts at the upper stop
        impacts_lower  number of its impacts at the lower stop
        symmetric      True if the orbit is its own mirror image
        leaves         branch from which this branch forks off, -1 for none
        at             kind of event at which it forks off
        points         number of points
        first_end      why it ends at its first point: edge, closed, budget, stalled, inadmissible, shorter_orbit, or a
                       kind of event
        last_end       why it ends at its last point, likewise
        """
        import pandas

        columns = ["branch", *_PATTERN, "leaves", "at", "points", "first_end", "last_end"]
        rows = [
            (
                number,
                *pattern(branch.itinerary),
                *next(((other, event.kind if event else "") for other, event in branch.origins), (-1, "")),
                len(branch.run.points),
                *branch.run.ends,
            )
            for number, branch in enumerate(self.traced)
        ]
        return pandas.DataFrame(rows, columns=columns).set_index("branch")

    @cached_property
    def points(self) -> "pandas.DataFrame":
        """The table of solution points, one row per point, branch by branch, in order along each. Its columns are:

        branch         number of the branch
        (parameter)    value of the parameter, under its name
        (state)        components of the state at the section t = 0
        multiplier     largest modulus of the multipliers of the orbit
        unstable       number of multipliers with modulus above 1, not counting those of an event at 1
        period         period of the orbit; at an end with a shorter orbit, that of the orbit before
        impacts_upper  impacts at the upper stop, likewise
        impacts_lower  impacts at the lower stop, likewise
        symmetric      True if the orbit is its own mirror image, likewise
        cycle_period   period of a cycle without a force, in units of time
        event          kind of the event at the point, else empty
        (observable)   columns impact_phase_stop_1, ...: values of the observable, if any, NaN beyond the orbit's last
                       value
        """
        import pandas

        columns = ["branch", self.along, *self.system.states, "multiplier", "unstable", *self._pattern, "event"]
        frame = pandas.DataFrame(list(self._points()), columns=columns)
        if self.observable is None:
            return frame
        observed = [next(self.plotted_values(branch)) for branch in self.traced]
        most = max(int(np.max(np.sum(np.isfinite(values), axis=1))) for values in observed)
        rows = np.full((len(frame), most), np.nan)
        for branch, values in enumerate(observed):
            rows[frame["branch"] == branch, : values.shape[1]] = values[:, :most]
        names = [f"{self.observable.variable}_{i}" for i in range(1, most + 1)]
        return pandas.concat([frame, pandas.DataFrame(rows, columns=names)], axis=1)

    @cached_property
    def events(self) -> "pandas.DataFrame":
        """The table of events, such as bifurcations and grazes, one row per event, in order along each branch.

        An event at which two branches meet has a row for each. The columns are:

        branch         number of the branch
        kind           kind of the event
        (parameter)    value of the parameter, under its name
        (state)        components of the state at the section t = 0
        unstable       number of multipliers with modulus above 1, not counting the event's own
        kappa          cos theta of the pair of a Neimark-Sacker point, else NaN
        frequency      frequency of the pair of exponents that crosses the axis at a Hopf point, else NaN; only without
                       a force
        period         period of the orbit at the event, which may be shorter than the branch's
        impacts_upper  its impacts at the upper stop
        impacts_lower  its impacts at the lower stop
        symmetric      True if it is its own mirror image
        cycle_period   period of a cycle without a force, in units of time
        leaving        branch of this table that forks off at the event, -1 for none
        """
        import pandas

        alone = ["frequency"][: self.system.definition.unforced]
        before = ["branch", "kind", self.along, *self.system.states, "unstable", "kappa", *alone]
        columns = [*before, *self._pattern, "leaving"]
        return pandas.DataFrame(list(self._events()), columns=columns)

    def gap_values(self, branch: "Branch") -> Iterator[NDArray[np.float64]]:
        """Yield the gap coordinate (N, n) at the n sections of each of a branch's N orbits, then of their mirror
        images, if any.
        """
        rows = machine.gap_rows(self.system, {**self.parameters, self.along: branch.values})
        for states in (branch.sections, branch.mirrored):
            if states is not None:
                yield np.einsum("ni,nki->nk", rows, states[..., : rows.shape[1]])

    def plotted_values(self, branch: "Branch") -> Iterator[NDArray[np.float64]]:
        """Yield the plotted values (N, K) of a branch, and of its mirror image if there is one; NaN for missing values.

        A row has the values of one orbit, a column one line of the plot.
        """
        if self.observable is None:
            yield from self.gap_values(branch)
            return
        from workers.cell.observables import observe_orbits

        parameters: dict[str, Any] = {**self.parameters, self.along: branch.values}
        periods = np.array([itinerary.periods for itinerary in branch.itineraries])
        if self.system.definition.unforced:
            cycles = [
                cycle_period(p, itinerary) for p, itinerary in zip(branch.run.points, branch.itineraries, strict=True)
            ]
            periods, parameters[OMEGA] = np.ones_like(periods), 2.0 * np.pi / np.array(cycles)
        parameter_values = {
            name: np.broadcast_to(value, periods.shape).astype(float) for name, value in parameters.items()
        }
        for states in (branch.sections, branch.mirrored):
            if states is not None:
                first, name = np.ascontiguousarray(states[:, 0]), self.observable.name
                observed = observe_orbits(self.system.definition, parameter_values, first, periods, name, MAX_VALUES)
                yield align_rows(observed[self.observable.variable], self.observable.modulus)

    def lines(self) -> Iterator[tuple[bool, NDArray[np.float64]]]:
        """Yield the lines (N, 2) of the plotted values over the parameter, each with True if its orbits are stable.

        Lines of mirror images are included.
        """
        jump = math.inf if self.observable is None else 0.5 * self.observable.modulus
        for branch in self.traced:
            for values in self.plotted_values(branch):
                for stable, part in branch.stability_parts:
                    for one in values[part].T:
                        line = np.column_stack([branch.values[part], one])
                        for piece in np.split(line, np.flatnonzero(~(np.abs(np.diff(one)) < jump)) + 1):
                            if len(piece) > 1:
                                yield stable, piece

    def event_places(self) -> Iterator[tuple[str, NDArray[np.float64]]]:
        """Yield the kind of each event and the positions (n, 2) at which it is plotted, also of its mirror image."""
        for branch in self.traced:
            for values in self.plotted_values(branch):
                for k, event in zip(branch.event_indices, branch.run.events, strict=True):
                    yield event.kind, np.column_stack([np.full(values.shape[1], branch.values[k]), values[k]])

    @property
    def identity(self) -> dict[str, Any]:
        """All that determines these branches: system, parameters, limits, and the first orbit."""
        start = self.traced[0].sections[0].tolist()
        where = {"parameters": dict(self.parameters), "along": self.along, "window": list(self.window)}
        return identity(self.system.to_resolved()) | where | {"start": start, "branches": len(self.traced)}

    @property
    def digest(self) -> str:
        """Digest of ``identity``, that is of all that determines these branches."""
        return digest_of(self.identity)

    def _points(self) -> Iterator[tuple[Any, ...]]:
        for number, branch in enumerate(self.traced):
            kinds = {id(event.point): event.kind for event in branch.run.events}
            for point, states, itinerary in zip(branch.run.points, branch.sections, branch.itineraries, strict=True):
                size, event = modulus(point, itinerary), kinds.get(id(point), "")
                values = self._pattern_values(point, itinerary)
                yield (number, float(point.values[0]), *states[0].tolist(), size, point.unstable, *values, event)

    @property
    def _pattern(self) -> tuple[str, ...]:
        return (*_PATTERN, CYCLE_PERIOD.name) if self.system.definition.unforced else _PATTERN

    def _pattern_values(self, point: "SolutionPoint", itinerary: "Itinerary") -> tuple[Any, ...]:
        """Return the values of the columns ``_pattern`` at a point: period, impacts, symmetry, a cycle's duration."""
        return (*pattern(itinerary), *[cycle_period(point, itinerary)][: self.system.definition.unforced])

    def _events(self) -> Iterator[tuple[Any, ...]]:
        from workers.continuation.equilibria import HOPF  # imports kernels, which pictures do without

        leaving = {id(event): number for number, b in enumerate(self.traced) for _, event in b.origins if event}
        for number, branch in enumerate(self.traced):
            for k, event in zip(branch.event_indices, branch.run.events, strict=True):
                point, state = event.point, branch.sections[k, 0].tolist()
                pattern_values = self._pattern_values(point, point.orbit.itinerary)
                left, alone = leaving.get(id(event), -1), list[float]()
                if self.system.definition.unforced:
                    alone = [2.0 * math.pi / pattern_values[-1] if event.kind == HOPF else math.nan]
                yield (
                    number, event.kind, float(point.values[0]), *state, point.unstable, event.kappa, *alone,
                    *pattern_values, left,
                )  # fmt: skip


MAX_VALUES = 256
"""Maximum number of values of an observable, such as impact phases, that are shown for one orbit."""


def align_rows(values: NDArray[np.float64], turn: float) -> NDArray[np.float64]:
    """Rotate the values (N, K) of consecutive orbits so that each column changes as little as possible from row to row.

    Row k has the values of an observable at the successive impacts of orbit k; rotating changes the impact that is
    first. Values are modulo ``turn`` if that is finite. A row with another number of values than the row before is
    unchanged.
    """
    rolled = values.copy()
    for k in range(1, len(rolled)):
        before, current_row = (row[np.isfinite(row)] for row in rolled[k - 1 : k + 1])
        if len(current_row) == len(before) > 1:
            away = [np.roll(current_row, -r) - before for r in range(len(current_row))]
            away = away if math.isinf(turn) else [np.remainder(shift + 0.5 * turn, turn) - 0.5 * turn for shift in away]
            rolled[k, : len(current_row)] = np.roll(
                current_row, -int(np.argmin([np.sum(np.abs(shift)) for shift in away]))
            )
    return rolled


_PATTERN = ("period", "impacts_upper", "impacts_lower", "symmetric")


def pattern(itinerary: "Itinerary") -> tuple[int, int, int, bool]:
    """Return period, impacts at the upper and at the lower stop, and symmetry of an orbit with this itinerary.

    An itinerary is a sequence of impacts and other events.
    """
    return itinerary.sections, itinerary.impacts(1), itinerary.impacts(-1), itinerary.symmetric


def orbit_name(itinerary: "Itinerary", system: System) -> str:
    """Return the name of an orbit of a system as text: n-p-q, and "symmetric" if it is.

    n is the period, p and q are the impacts at the upper and the lower stop. Without a force it is a cycle n-p-q, or an
    equilibrium, which has no impacts and no other events.
    """
    unforced = system.definition.unforced
    if unforced and not itinerary.sides:
        return system.regime.meaning(NO_IMPACT).text
    *counts, symmetric = pattern(itinerary)
    return ("cycle " if unforced else "") + motion_name(*counts) + (" symmetric" if symmetric else "")


def modulus(point: "SolutionPoint", itinerary: "Itinerary") -> float:
    """Return the largest modulus of the multipliers of an orbit over one repetition of an itinerary.

    An itinerary is a sequence of impacts and other events. The multipliers of a point are those of one turn, which is
    half of a symmetric orbit; the itinerary may repeat a shorter orbit. The modulus is inf if an impact has no speed.
    The multiplier 1 along a cycle without a force is left out.
    """
    with np.errstate(over="ignore"):
        return float(np.max(np.abs(point.multipliers), initial=0.0) ** _turns(point, itinerary))


def cycle_period(point: "SolutionPoint", itinerary: "Itinerary") -> float:
    """Return the period, in units of time, of a cycle over one repetition of an itinerary; NaN for other orbits."""
    return float(point.orbit.length) * _turns(point, itinerary)


def _turns(point: "SolutionPoint", itinerary: "Itinerary") -> float:
    """Return how many turns of a point's orbit make up one repetition of an itinerary.

    A turn is the stored part of an orbit, half of a symmetric one. An itinerary is a sequence of impacts and other
    events.
    """
    turn = point.orbit.itinerary
    if itinerary.is_cycle:
        return len(itinerary.sides) * (1 + itinerary.symmetric) / len(turn.sides)
    return itinerary.periods / turn.turn
