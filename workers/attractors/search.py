"""Motions that are compared with known attractors on their way, and solved in full where they reach none of them."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.attractors.known import Known
from workers.attractors.same import (
    BATCH,
    DIFFERENT,
    FIRST_LOOK,
    REFERENCE,
    SECOND_LOOK,
    batch_moments,
    periods_to_settle,
)
from workers.cell.cells import Array, Cells, Mask, Rows
from workers.cell.course import NEAR_LATER, Course
from workers.cell.outcome import put_impact_free, put_periodic, put_stopped
from workers.cell.solve import begun
from workers.kernel.cells import impact_free, physical_states
from workers.model.oscillator import Oscillator, each
from workers.orbit.newton import Orbits
from workers.results import APERIODIC, CHAOTIC, NO_REASON, PENDING, QUASIPERIODIC, empty_results, result_variables
from workers.settings import Settings
from workers.tile import MEMORY_AT_ONCE

WATCHED_AT_ONCE = 1024
"""Periods of a stretch of watching."""

MOST_MOTIONS, LEAST_MOTIONS = 4096, 64
"""Motions under way together: as many as the memory for section states has room for, between these."""


def motions_at_once(settings: Settings, size: int) -> int:
    """How many motions of so many state components are searched for together."""
    room = MEMORY_AT_ONCE // (8 * size * (settings.max_period + settings.section_samples + 1))
    return int(np.clip(room, LEAST_MOTIONS, MOST_MOTIONS))


@dataclass(frozen=True)
class Found:
    """What N motions have come to.

    label        (N,) place of the known attractor that each has reached, -1 for none; then ``arrays`` has its results
    arrays       result arrays by name (N, ...); regime PENDING where a motion was recognised
    contact      (N,) that of the state among them
    orbits       where these are of an orbit
    used, flown  (N,) periods that it cost, and that its motion went through
    settled      (N,) periods until it was on the attractor: within a hundredth of the motion's scale where it was
                 recognised to reach an orbit, else as many as it went through
    distance     (N,) in standard errors from the attractor that it was put to by statistics
    reference    batches of a new chaos or torus, of others None
    state_after  (N, 2n) the physical state at which the motion was left, contact_after (N,) its contact
    flown_after  (N,) periods on the attractor
    again        (N,) whether a motion was counted before, None where none was
    """

    label: Rows
    arrays: dict[str, NDArray[Any]]
    contact: Rows
    orbits: Orbits
    used: Rows
    flown: Rows
    settled: Rows
    distance: Array
    reference: list[Array | None]
    state_after: Array
    contact_after: Rows
    flown_after: Rows
    again: Mask | None = None

    def result(self, r: int) -> dict[str, Any]:
        """The results of one motion."""
        return {name: values[r].copy() for name, values in self.arrays.items()}

    def left(self, r: int) -> tuple[Array, int]:
        """The physical state at which one motion was left, and its contact."""
        return self.state_after[r], int(self.contact_after[r])

    def survived(self, r: int) -> int:
        """Periods for which a motion was seen chaotic."""
        return int(self.arrays["survived"][r]) + int(self.flown_after[r])

    def only(self, rows: Rows) -> "Found":
        """These motions alone, which were counted before."""
        return Found(
            self.label[rows],
            {name: values[rows] for name, values in self.arrays.items()},
            self.contact[rows],
            each(self.orbits, lambda values: values[rows]),
            self.used[rows],
            self.flown[rows],
            self.settled[rows],
            self.distance[rows],
            [self.reference[r] for r in rows],
            self.state_after[rows],
            self.contact_after[rows],
            self.flown_after[rows],
            np.ones(len(rows), dtype=np.bool_),
        )


class _Search(Course):
    """A course on which motions that fall into known orbits are done, and others leave it to be compared."""

    def __init__(self, cells: Cells, known: Known, owner: Rows) -> None:
        super().__init__(cells)
        N = len(owner)
        self.known, self.owner = known, owner
        self.label = np.full(N, -1)
        self.settled = np.full(N, -1)
        self.left = np.zeros(N, dtype=np.bool_)
        self.distance = np.full(N, np.nan)
        self.compared = np.zeros(N, dtype=np.int64)
        self.state = np.full((N, cells.oscillators.to_physical.shape[1]), np.nan)
        self.contact = np.zeros(N, dtype=np.int64)

    def recognise(self, rows: Rows) -> Rows:
        """Those that fall into no known orbit."""
        cells = self.cells
        label = self.known.reached(cells, rows, self.owner)
        self.label[rows] = label
        done = rows[label >= 0]
        if len(done):
            self.settled[done] = periods_to_settle(
                cells.oscillators.gap.metric, cells.oscillators.swing, cells.batch.sections, cells.kept(), done,
                cells.flown, self.known.periods(label[label >= 0]),
            )  # fmt: skip
        return rows[label < 0]

    def leaves(self, rows: Rows) -> Mask:
        """Those of whose cell chaos or a torus is known."""
        left = self.known.has_reference(self.owner[rows])
        self.left[rows[left]] = True
        return left

    def advance(self, rows: Rows, periods: Rows | int) -> Rows:
        """Take these motions on by so many periods; those that have come to nothing that ends them."""
        cells = self.cells
        free = impact_free(cells.oscillators, cells.batch.motions, rows)
        put_impact_free(cells, rows[free], cells.batch.motions.h[rows[free]])
        rows, periods = rows[~free], np.broadcast_to(periods, len(rows))[~free]
        cells.aim(rows, periods)
        waiting = rows
        while len(waiting):
            waiting = np.setdiff1d(waiting, cells.run(waiting))
        rows = rows[~put_stopped(cells, rows)]
        rows = self.recognise(rows)
        least = cells.settings.max_periods
        budget = np.maximum(least + cells.settings.survival - cells.used, least)
        settled = cells.settle(rows, budget, np.full(len(cells.used), NEAR_LATER))
        put_periodic(cells, rows[settled])
        return rows[~settled]

    def sample(self, rows: Rows, batches: int) -> tuple[Rows, Array]:
        """Those motions that go on for so many batches, and the batches (rows, batches, 4n)."""
        n = self.cells.batch.sections.shape[2]
        means = np.full((len(self.owner), batches, 4 * n), np.nan)
        for k in range(batches):
            rows = self.advance(rows, BATCH)
            means[rows, k] = batch_moments(self.cells.batch.sections, rows, BATCH)
        self.compared[rows] += batches * BATCH
        self.leave_at(rows)
        return rows, means[rows]

    def leave_at(self, rows: Rows) -> None:
        """Keep where these motions are, for those that go on from there."""
        motions = self.cells.batch.motions
        self.state[rows] = physical_states(self.cells.oscillators, motions, rows)
        self.contact[rows] = motions.contact[rows, 0]

    def compare(self) -> None:
        """Put motions to the chaos or the torus that they are on; go on with those that are on none of them."""
        rows = np.flatnonzero(self.left)
        for batches in (FIRST_LOOK, SECOND_LOOK):
            rows, means = self.sample(rows, batches)
            away = np.full(len(rows), np.inf)
            for k, r in enumerate(rows):
                label, away[k] = self.known.nearest(int(self.owner[r]), means[k])
                if away[k] <= DIFFERENT:
                    self.label[r], self.distance[r] = label, away[k]
            rows = rows[away > DIFFERENT]
        self.compared[rows] = 0
        self.watched[rows] += (FIRST_LOOK + SECOND_LOOK) * BATCH  # they were to decide nothing
        self.observe(rows)
        self.take(rows)


def search(
    oscillators: Oscillator,
    reasons: NDArray[np.int8],
    states: Array,
    settings: Settings,
    known: Known,
    owner: Rows,
    references: bool = True,
) -> Found:
    """What N motions from physical states (N, 2n) come to; those with a reason have no oscillator.

    owner       (N,) the cell of each, whose known attractors it is compared with
    references  whether what is on a new chaos or torus goes on to tell what it is by
    """
    course, ready = _begun(oscillators, reasons, states, settings, known, owner)
    with np.errstate(all="ignore"):
        course.take(ready)
        course.compare()
        return _with_references(course) if references else _found(course, [None] * len(owner))


def watch(
    oscillators: Oscillator,
    states: Array,
    contact: Rows,
    periods: Rows,
    settings: Settings,
    known: Known,
    owner: Rows,
) -> Found:
    """What N motions come to in so many periods (N,): recognised, settled, or on as they were, regime PENDING.

    They go on from physical states (N, 2n) with contacts (N,).
    """
    reasons = np.full(len(owner), NO_REASON, dtype=np.int8)
    course, rows = _begun(oscillators, reasons, states, settings, known, owner, contact)
    cells = course.cells
    with np.errstate(all="ignore"):
        while len(rows):
            rows = course.advance(rows, np.minimum(periods[rows] - cells.flown[rows], WATCHED_AT_ONCE))
            rows = rows[cells.flown[rows] < periods[rows]]
        course.leave_at(np.arange(len(owner)))
    return _found(course, [None] * len(owner))


def sampled(
    oscillators: Oscillator, states: Array, contact: Rows, settings: Settings, known: Known, owner: Rows
) -> tuple[list[Array | None], Rows]:
    """The batches of N motions, None of one that settles, and the periods used.

    They go on from physical states (N, 2n) with contacts (N,).
    """
    reasons = np.full(len(owner), NO_REASON, dtype=np.int8)
    course, rows = _begun(oscillators, reasons, states, settings, known, owner, contact)
    with np.errstate(all="ignore"):
        going, means = course.sample(rows, REFERENCE)
    there = dict(zip(going.tolist(), means, strict=True))
    return [there.get(r) for r in range(len(owner))], course.cells.used


def _begun(
    oscillators: Oscillator,
    reasons: NDArray[np.int8],
    states: Array,
    settings: Settings,
    known: Known,
    owner: Rows,
    contact: Rows | None = None,
) -> tuple[_Search, Rows]:
    size = states.shape[1]
    sizes = {"exponent": size, "state": size, "sample": settings.section_samples}
    arrays = empty_results(result_variables(settings), (len(owner),), sizes)
    with np.errstate(all="ignore"):
        cells, ready = begun(oscillators, reasons, states, settings, arrays, contact)
    return _Search(cells, known, owner), ready


def _with_references(course: _Search) -> Found:
    """The motions as found; those that are on a chaos or torus that is not known go on, to tell what it is by.

    One that settles meanwhile is on an orbit.
    """
    cells = course.cells
    N, arrays = len(course.owner), cells.found
    references: list[Array | None] = [None] * N
    new = np.flatnonzero((course.label < 0) & np.isin(arrays["regime"], (CHAOTIC, QUASIPERIODIC, APERIODIC)))
    if len(new):
        before = {name: values[new].copy() for name, values in arrays.items()}
        for variable in result_variables(cells.settings):
            arrays[variable.name][new] = variable.fill
        cells.framed[new] = False
        going, means = course.sample(new, REFERENCE)
        label = dict(zip(going.tolist(), means, strict=True))
        for k, r in enumerate(new.tolist()):
            if r in label:
                references[r] = label[r]
                for name, values in arrays.items():
                    values[r] = before[name][k]
            elif course.label[r] < 0 and arrays["regime"][r] == PENDING:
                for name, values in arrays.items():
                    values[r] = before[name][k]
    return _found(course, references)


def _found(course: _Search, references: list[Array | None]) -> Found:
    cells = course.cells
    return Found(
        label=course.label,
        arrays=cells.found,
        contact=cells.contact,
        orbits=cells.orbits,
        used=cells.used.copy(),
        flown=cells.flown.copy(),
        settled=np.where(course.settled >= 0, course.settled, cells.flown),
        distance=course.distance,
        reference=references,
        state_after=course.state,
        contact_after=course.contact,
        flown_after=course.compared,
    )
