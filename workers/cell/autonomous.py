"""Cells of machines without a force: their cycles, equilibria, tori and chaos, with results in units of time.

Such a machine has no forcing period. Its motion is simulated over natural periods like any other, and examined event by
event. It may be on a cycle if an event repeats in the same mode at nearly the same state. The cycle is then solved by
its equations, see continuation/cycles.py, and the event loop must close it. From then on the period of the cell is the
period of the cycle, so that all measures see an orbit of one period.
"""

import numpy as np

from workers.cell.cell_batch import CLOSING_DISTANCE, RETURNS, CellBatch, CellCycle
from workers.cell.event_trail import AT_ONE_TIME, EventTrail, passages, trails, turn_from
from workers.cell.exponents import kaplan_yorke
from workers.cell.interval import batch_of, begin, run
from workers.cell.orbits import end_on_orbits
from workers.cell.outcome import end_impact_free, put_averaged, put_contacts, put_periodic, put_regular, write_results
from workers.cell.schedule import SEARCHING, TORUS_RETURN, AdaptiveSchedule, Property, none_of
from workers.cell.vertex_rest import (
    Rest,
    is_at_equilibrium,
    put_rests,
    rest_beside,
    rest_of_turns,
    rest_without_events,
)
from workers.continuation.cycles import LimitCycle, cycle_near, cycle_through
from workers.continuation.itinerary import Itinerary, Orbit
from workers.continuation.orbit_from_motion import ASKED, reduce_symmetry
from workers.kernel.cell_loops import physical_states
from workers.kernel.hybrid.leg_record import LEG
from workers.kernel.motion import NOTHING_COUNTED, RUNNING, STATUS, STUCK, WORK, WORK_OF_A_TRIAL
from workers.model.family import NoOscillatorError, OrbitMachines
from workers.model.natural_period import set_period
from workers.model.oscillator import Array, Mask, Oscillator, Rows, at_rows
from workers.results import (
    APERIODIC,
    AT_EQUILIBRIUM,
    CENTRE,
    CHAOTIC,
    FREE_PHASE,
    NO_REASON,
    PER_TIME,
    QUASIPERIODIC,
    REGIME,
    REGULAR,
    UNDETERMINED,
    Variable,
)

NEAR_CYCLE = 1e-3
"""Maximum distance of a state from an earlier one, relative to the motion, at which the motion may have closed a cycle.
"""

STABLE = 1e-12
"""Minimum -ln|mu| of a multiplier mu that is certainly inside the unit circle, if its error is smaller."""

BRUSH = 1e-7
"""Maximum share of its period that a cycle rests on a stop and still counts as a graze that rounding has lengthened:
inside such a cycle motions swing forever."""

STEADY, MIN_TORUS_PERIODS = 15.0, 3000
"""Maximum logarithm of the shrinkage of a torus's second tangent vector, and minimum number of natural periods of
averaging."""


def course_of(cells: CellBatch, is_known: Property = none_of, must_leave: Property = none_of) -> AdaptiveSchedule:
    """Return the adaptive schedule for these cells, which decides how long each cell is simulated.

    is_known    predicate on cells at the end of an interval: the motion is recognised, and the cell ends
    must_leave  predicate on cells after their transients: they leave the schedule, to be judged elsewhere

    The class of the schedule suits the machines: with a force, with a force of amplitude 0, or without a force.
    """
    kind = AutonomousSchedule if cells.unforced else VertexCourse if np.any(without_force(cells)) else AdaptiveSchedule
    return kind(cells, is_known, must_leave)


def without_force(cells: CellBatch) -> Mask:
    """Return the mask (N,) of cells whose machine has neither a force nor phases, parts of the period that differ.

    The mask is False for machines that are solved by impacts on one rigid contact alone.
    """
    if not cells.oscillators.has_modes:
        return np.zeros(len(cells.periods_used), dtype=np.bool_)
    machines = cells.oscillators.table.machines
    still = np.all((machines.force_sin == 0.0) & (machines.force_cos == 0.0), axis=(1, 2, 3))
    return np.asarray(still & (machines.sizes[0] == 1))


class VertexCourse(AdaptiveSchedule):
    """The adaptive schedule, which decides how long each cell is simulated, if some forces have the amplitude 0."""

    def end_on_orbits(self, rows: Rows, budget: Rows, near: Array) -> Rows:
        """Write the results of cells that converge to an orbit or to an equilibrium at a vertex; return the others.

        rows    cells at the end of an interval
        budget  (N,) periods that may be spent on the search for orbits
        near    (N,) distance from a former state, relative to the motion, that counts as a return

        A vertex is a stop, or a corner of a piecewise linear law.
        """
        rests, still = dict[int, Rest](), without_force(self.cells)
        for r in rows[still[rows]].tolist():
            rest = rest_without_events(self.cells, r) or rest_of_turns(self.cells, r)
            rests |= {r: rest} if rest else {}
        put_rests(self.cells, rests)
        rows = super().end_on_orbits(rows[self.cells.is_active[rows]], budget, near)
        stands = [still[r] and _repeats(self.cells, r) and is_at_equilibrium(self.cells, r) for r in rows.tolist()]
        self.end_standing(rows[np.array(stands, dtype=np.bool_)])
        return rows[self.cells.is_active[rows]]

    def end_standing(self, rows: Rows) -> None:
        """Write the results of these cells, whose motion stands still in an equilibrium."""
        rests = {r: rest for r in rows.tolist() if (rest := rest_beside(self.cells, r)) is not None}
        put_rests(self.cells, rests)
        put_centres(self.cells, end_impact_free(self.cells, rows[self.cells.is_active[rows]]))


class AutonomousSchedule(VertexCourse):
    """The adaptive schedule, which decides how long each cell is simulated, for machines without a force."""

    def end_on_orbits(self, rows: Rows, budget: Rows, near: Array) -> Rows:
        """Write the results of cells that converge to a limit cycle or an equilibrium; return the cells that continue.

        rows    cells at the end of an interval
        budget  (N,) periods that may be spent on the search for orbits
        near    (N,) distance from a former state, relative to the motion, that counts as a return

        Cells whose motion is recognised end without results. An equilibrium is an orbit of the map over a natural
        period, without events. A motion that loses nothing is on its cycle from the beginning, and is not examined
        later.
        """
        known = self.is_known(rows)
        self.cells.is_active[rows[known]] = False
        rows, still = rows[~known], list[int]()
        looks = ~self.cells.conservative[rows] | (self.stage[rows] == SEARCHING)
        cycles, rests = dict[int, tuple[LimitCycle, Array]](), dict[int, Rest]()
        for r in rows[looks].tolist():
            cycle, quiet = self._look(r)
            if cycle is not None:
                cycles[r] = cycle
            elif quiet and (rest := rest_without_events(self.cells, r)) is not None:
                rests[r] = rest
            elif quiet:
                still.append(r)
        remaining = end_on_orbits(self.cells, np.array(still, dtype=np.int64), budget, near)
        for r in rows[looks & self.cells.is_active[rows]].tolist():
            if r not in cycles and r not in rests and (rest := rest_of_turns(self.cells, r)) is not None:
                rests[r] = rest
        put_rests(self.cells, rests)
        remaining = np.array(
            [r for r in remaining.tolist() if self.cells.is_active[r] and _repeats(self.cells, r)], dtype=np.int64
        )
        stands = np.array([is_at_equilibrium(self.cells, r) for r in remaining.tolist()], dtype=np.bool_)
        put_centres(self.cells, remaining[~stands])
        self.end_standing(remaining[stands])
        put_cycles(self.cells, cycles)
        return rows[self.cells.is_active[rows]]

    def end_on_long_orbits(self, rows: Rows) -> Rows:
        """Return the cells that continue; limit cycles of any length are sought after every interval already."""
        return rows[self.cells.is_active[rows]]

    def never_closes(self, rows: Rows) -> Mask:
        """Return the mask of cells that may be on a torus: they never returned, and tangent vectors did not shrink.

        A motion has not returned if its state was never near that at its last event, in RETURNS passages of this event.
        The logarithm of the second tangent vector's shrinkage is at most STEADY.
        """
        if not len(rows):
            return none_of(rows)
        motions, periods = self.cells.batch.motions, self.cells.periods_flown[rows] - self.cells.began[rows]
        endless = (motions.growth[rows, 1] > -STEADY) & (periods >= MIN_TORUS_PERIODS)
        for k in np.flatnonzero(endless).tolist():
            endless[k] = self._returns_far(int(rows[k]))
        return np.asarray(endless)

    def _returns_far(self, r: int) -> bool:
        trail = None
        for trail in trails(self.cells, r):
            if np.sum(trail.keys == trail.keys[-1:]) > RETURNS:
                break
        if trail is None or np.sum(trail.keys == trail.keys[-1:]) <= RETURNS:
            return False
        last = len(trail.keys) - 1
        same = np.flatnonzero(trail.keys[:-1] == trail.keys[-1])[-RETURNS:]
        return min(trail.distance_between(last, int(k)) for k in same) > TORUS_RETURN

    def _look(self, r: int) -> tuple[tuple[LimitCycle, Array] | None, bool]:
        """Return the limit cycle to which motion r converges, None without one, and whether the motion has no events.

        The cycle comes with the times of its rarest event, the event with the fewest passages in a turn.
        """
        tried, trail, most = set[int](), None, 4 * self.settings.max_period
        machine = at_rows(self.cells.oscillators, np.array([r]))
        for trail in trails(self.cells, r):
            for m in turns_of(trail):
                if m in tried:
                    continue
                tried.add(m)
                cycle = cycle_of(machine, trail, m)
                if cycle is not None:
                    return cycle, False
            if len(trail.keys) and np.max(np.bincount(trail.keys)) > most:
                break
        return None, trail is not None and not len(trail.keys)


def turns_of(trail: EventTrail) -> list[int]:
    """Return numbers of events after which a motion nearly returned to its last state; each may be a turn of a cycle.

    At each of these returns the motion came nearer than one turn before. There are at most three, and each is ten times
    nearer than any shorter one.
    """
    turns, last, record = list[int](), len(trail.keys) - 1, NEAR_CYCLE
    distances = np.max(np.abs(trail.states[-1:] - trail.states[last - last // 2 : last]), axis=1)[::-1]
    for m in (1 + np.flatnonzero(distances < NEAR_CYCLE)).tolist():
        away = float(distances[m - 1])
        if away < record and np.array_equal(trail.keys[last - m + 1 :], trail.keys[last - 2 * m + 1 : last - m + 1]):
            if away <= trail.distance_between(last - m, last - 2 * m) or away < CLOSING_DISTANCE:
                turns.append(m)
            record = 0.1 * away
    return turns[:3]


def cycle_of(machine: Oscillator, trail: EventTrail, m: int) -> tuple[LimitCycle, Array] | None:
    """Return the cycle near the last m events of a motion, and times (p,) of its rarest event; None without a cycle.

    machine  the machine, as the only row of a batch
    trail    the events of the motion
    m        number of events of a turn

    The cycle is stable, or the motion is on the cycle and a multiplier of the cycle is 1. The rarest event is the event
    with the fewest passages in a turn; of several the one with the smallest key is taken. A turn begins there, but not
    among the hops that end a chatter: these would count as rest.
    """
    keys = trail.keys[-m:]
    counts = np.bincount(keys)
    rarest = int(np.flatnonzero(counts == counts[counts > 0].min())[0])
    first = min(np.flatnonzero(keys == rarest), key=lambda i: tuple(trail.states[len(trail.keys) - m + i]))
    chatter = trail.legs[trail.first[-m:], LEG.chatter]
    while np.any(chatter == 0.0) and chatter[first] != 0.0:
        first = (first + 1) % m
    turn_machine, turn, keys = turn_from(machine, trail, m, int(first))
    returns = trail.distance_between(len(trail.keys) - 1, len(trail.keys) - 1 - m) < CLOSING_DISTANCE
    try:
        half = reduce_symmetry(turn_machine, turn, ASKED)
        cycle = cycle_near(turn_machine, half) if half is not turn else None
        cycle = cycle or cycle_near(turn_machine, turn)
        if cycle is None and returns:
            cycle = cycle_through(turn_machine, turn)
            return (cycle, cycle.motion.times[0]) if is_neutral(cycle) and cycle.error < CLOSING_DISTANCE else None
        cycle = once_round(turn_machine, cycle) if cycle is not None and is_stable(cycle) else cycle
    except NoOscillatorError:
        return None
    if cycle is None or not (is_stable(cycle) or (is_neutral(cycle) and returns)):
        return None
    times = cycle.motion.times[0]
    if cycle.motion.itinerary.symmetric:
        times = np.concatenate([times, times + 0.5 * cycle.period])
    return cycle, times[keys[: len(times)] == rarest]


def is_stable(cycle: LimitCycle) -> bool:
    """Return True if all multipliers of a cycle are certainly inside the unit circle."""
    return bool(cycle.logs[0] < -max(STABLE, cycle.error))


def is_neutral(cycle: LimitCycle) -> bool:
    """Return True if the largest multiplier of a cycle is 1 within its error."""
    return bool(abs(cycle.logs[0]) <= max(STABLE, cycle.error))


def once_round(machine: OrbitMachines, cycle: LimitCycle) -> LimitCycle | None:
    """Return one turn of a cycle whose given turn may be several: a motion may seem to return after two turns first.

    Return None if Newton's method does not converge to that turn.
    """
    motion, times = cycle.motion, cycle.motion.times[0]
    itinerary, states, span = motion.itinerary, motion.turn.states[0, 1:], float(motion.span[0])
    sign, chains, count = itinerary.sign, itinerary.chains, len(times)
    first = np.flatnonzero(np.diff(times, prepend=-span) > AT_ONE_TIME * span)
    last = np.append(first, count)[1:] - 1
    several = [sorted(itinerary.sides[i : j + 1]) for i, j in zip(first, last, strict=True)]
    modes = [chains[j][-1] for j in last]
    for k in range(1, len(first) // 2 + 1):
        turns = len(first) // k
        if len(first) % k or (itinerary.symmetric and turns % 2 == 0):
            continue
        alike = all(several[i] == sorted(sign * side for side in several[i - k]) for i in range(k, len(first)))
        before = [leg if sign > 0 else leg.mirrored for leg in modes]
        alike = alike and all(modes[i].code == before[i - k].code for i in range(k, len(first)))
        late = np.abs(times[first[k:]] - times[first[:-k]] - span / turns).max()
        away = np.abs(states[last[k:]] - sign * states[last[:-k]]).max()
        if alike and late <= CLOSING_DISTANCE * span and away <= CLOSING_DISTANCE * np.abs(states).max():
            end = int(first[k])
            one = Itinerary(itinerary.sides[:end], itinerary.periods, itinerary.symmetric, itinerary.legs[:end])
            return cycle_near(machine, Orbit(one, times[:end], motion.orbits.speeds[0, :end], np.array(span / turns)))
    return cycle


def _repeats(cells: CellBatch, r: int) -> bool:
    """Return True if a motion has the same state at all sections t = k T that are known of its last interval."""
    sections = cells.known_sections(r)
    return len(sections) > 1 and float(np.ptp(sections, axis=0).max()) <= CLOSING_DISTANCE * float(
        np.abs(sections).max()
    )


def put_centres(cells: CellBatch, rows: Rows) -> None:
    """Write the results of cells whose states at all sections t = k T are equal, although they attract nothing.

    Such motions stand in an equilibrium, or swing about a centre without damping. If the machine loses nothing,
    such a swing is regular motion.
    """
    if not len(rows):
        return
    stands = np.array([is_at_equilibrium(cells, r) for r in rows.tolist()])
    swings = rows[~stands & cells.conservative[rows]]
    put_regular(cells, swings)
    put_contacts(cells, swings, np.tile(NOTHING_COUNTED, (len(swings), 1)), np.ones_like(swings), np.zeros(len(swings)))
    write_results(cells, swings, cycle_period=cells.oscillators.period[swings], period=1)
    rows, stands = rows[cells.is_active[rows]], stands[cells.is_active[rows]]
    reasons = np.where(stands, np.int8(AT_EQUILIBRIUM), np.int8(CENTRE))
    put_averaged(cells, rows)
    write_results(cells, rows, regime=UNDETERMINED, error=np.nan, reason=reasons)


def put_cycles(cells: CellBatch, cycles_of: dict[int, tuple[LimitCycle, Array]]) -> None:
    """Write the results of cells that are on limit cycles or converge to them.

    ``cycles_of`` has the cycle of each cell by row, with the times of the cycle's rarest event. On a cycle of a machine
    that loses nothing the motion is regular; in others a multiplier of 1 is that of a free phase.
    """
    counts = {r: bool(cells.conservative[r]) or is_stable(cycle) for r, (cycle, _) in cycles_of.items()}
    free = np.array([r for r in cycles_of if not counts[r]], dtype=np.int64)
    put_averaged(cells, free)
    write_results(cells, free, regime=UNDETERMINED, error=np.nan, reason=FREE_PHASE)
    cycles_of = {r: passage for r, passage in cycles_of.items() if counts[r]}
    if not cycles_of:
        return
    rows, every = np.array(list(cycles_of), dtype=np.int64), np.arange(len(cycles_of))
    cycles = [cycle for cycle, _ in cycles_of.values()]
    periods = np.array([cycle.period for cycle in cycles])
    natural = cells.oscillators.period[rows].copy()
    set_period(cells.oscillators, rows, periods)
    begins = [_after_first(cycle) for cycle in cycles]
    machines = at_rows(cells.oscillators, rows)
    codes = [cycle.motion.plan.legs[k][0].code for cycle, k in zip(cycles, begins, strict=True)]
    segments = machines.table.machines.segments
    mode = np.array([code.number_of(*segments) for code in codes])
    states = np.stack([cycle.motion.turn.states[0, k] for cycle, k in zip(cycles, begins, strict=True)])
    motions, reasons = begin(machines, np.full(len(rows), NO_REASON, dtype=np.int8), states, mode)
    start, batch = motions.h.copy(), batch_of(machines, motions)
    motions.tally[:, WORK], batch.periods[:] = WORK_OF_A_TRIAL, 1
    run(batch, every)
    after = physical_states(machines, motions, every)
    size = np.abs(states).max(axis=1)
    closes = (motions.tally[:, STATUS] == RUNNING) & (reasons == NO_REASON) & (motions.mode[:, 0] == mode)
    closes &= np.abs(after - states).max(axis=1) <= CLOSING_DISTANCE * size
    stuck = motions.tally[:, STUCK]
    edge = closes & (stuck > 0.0) & (stuck <= BRUSH * periods)
    closes &= ~edge
    set_period(cells.oscillators, rows[~closes], natural[~closes])
    put_centres(cells, rows[edge])
    closing = np.flatnonzero(closes)
    rows, orbits = rows[closing], cells.orbits
    for r in rows.tolist():
        cycle, times = cycles_of[r]
        cells.cycles[r] = _as_passed(machines, cycle, times)
        orbits.exponents[r] = -np.sort(-np.append(cycle.logs, 0.0))
        orbits.symmetric[r], orbits.error[r] = cycle.motion.itinerary.symmetric, 1e-14 * (1.0 + abs(cycle.logs[0]))
    orbits.h[rows], orbits.mode[rows, 0], orbits.period[rows] = start[closing], mode[closing], 1
    orbits.tally[rows] = motions.tally[closing]
    put_periodic(cells, rows)
    largest = np.array([cycles_of[r][0].logs[0] for r in rows.tolist()])
    write_results(cells, rows, largest=largest)  # without the 0 along the cycle
    write_results(cells, rows[np.isneginf(largest)], error=0.0)
    write_results(cells, rows[cells.conservative[rows]], regime=REGULAR, largest=0.0, spectrum=0.0)


def _after_first(cycle: LimitCycle) -> int:
    """Return the index of the leg that begins after the first event, and after all events at the same time.

    A leg is the motion between two events.
    """
    lengths = (cycle.motion.ends - cycle.motion.begins)[0, 1:]
    return 1 + int(np.argmax(lengths > AT_ONE_TIME * cycle.period))


def _as_passed(machines: Oscillator, cycle: LimitCycle, times: Array) -> CellCycle:
    """Return a limit cycle in the form that cells keep, with its states at ``times`` (p,).

    The times are the passages of the rarest event of the cycle. ``machines`` determine how modes, the sets of linear
    equations, are numbered.
    """
    motion, segments = cycle.motion, machines.table.machines.segments
    legs, states = [leg for leg, _ in motion.plan.legs[1:]], motion.turn.states[0, 1:]
    if motion.itinerary.symmetric:
        legs, states = legs + [leg.mirrored for leg in legs], np.concatenate([states, -states])
    numbers = np.array([leg.code.number_of(*segments) for leg in legs])
    return CellCycle(cycle.period, motion.states_at(times[None])[0][0], states, numbers)


def convert_to_time(cells: CellBatch, variables: tuple[Variable, ...]) -> None:
    """Convert the results of all cells from periods to units of time, and write the periods of cycles.

    The exponent along a motion is set to 0, its exact value: of chaos the exponent nearest to 0, of a torus the second.
    The sections, the states that a map shows, are those at the passages of an event, if there are any.
    """
    results = cells.results
    for variable in variables:
        if PER_TIME in variable.long_name:
            values = results[variable.name]
            values /= cells.oscillators.period.reshape(-1, *[1] * (values.ndim - 1))
    for r, cycle in cells.cycles.items():
        results["cycle_period"][r], results["period"][r] = cycle.period, len(cycle.section)
        if "section" in results:
            results["section"][r] = cycle.section[np.arange(results["section"].shape[1]) % len(cycle.section)]
    for r in np.flatnonzero(np.isin(results[REGIME.name], (CHAOTIC, QUASIPERIODIC, APERIODIC, REGULAR))).tolist():
        if r in cells.cycles:
            continue
        if "section" in results and np.isfinite(seen := passages(cells, r, results["section"].shape[1])).any():
            results["section"][r] = seen
        if "spectrum" in results:
            spectrum = results["spectrum"][r]
            torus = results[REGIME.name][r] == QUASIPERIODIC  # the first exponent of a torus is 0, too
            spectrum[1 if torus else np.argmin(np.abs(spectrum))] = 0.0
            known = np.where(torus & (np.arange(len(spectrum)) == 0), 0.0, spectrum)
            results["kaplan_yorke"][r] = kaplan_yorke(-np.sort(-known))
