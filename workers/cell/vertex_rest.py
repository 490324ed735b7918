"""Equilibria at the end of a signal's range, such as rest at a stop or at a corner, or vertex, of a force law.

A signal is a number computed from the state, and its end is an event. A motion that shrinks to such an equilibrium has
no scale: each turn multiplies it by the same factor, through ever the same events. One turn gives the exponents. A
motion that comes from one side, without events, shrinks by its slowest decay.
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from workers.cell.cell_batch import CLOSING_DISTANCE, CellBatch
from workers.cell.event_trail import MIN_EXAMINED_PERIODS, EventTrail, trails, turn_from
from workers.cell.outcome import put_periodic, write_results
from workers.continuation.floquet import multipliers
from workers.continuation.legs import END, EVENT, MODE, NO_EVENT, SIGNAL
from workers.continuation.shooting import OrbitMotion
from workers.kernel.cell_loops import physical_states
from workers.kernel.hybrid.leg_record import LEG, LEG_STATE
from workers.kernel.motion import CONTRACTION, NOTHING_COUNTED
from workers.model.family import NoOscillatorError
from workers.model.hybrid_modes import HybridModes
from workers.model.oscillator import COLUMN, Array, Mask, Oscillator, at_rows, rates_of
from workers.orbit.recorded_legs import mode_code_of_state
from workers.results import NO_IMPACT

VERTEX, SAME_RAY = 1e-12, 1e-6
"""Rounding of rates and signals in an equilibrium, as a share of their terms; and maximum change of the direction from
an equilibrium in a turn round it, as a share of the distance."""

PUSH_DISTANCE, FEW_TURNS = 1e-4, 8
"""Distance from an equilibrium, relative to its displacement, at which a motion is started; number of natural periods
for which it is followed."""


class Rest(NamedTuple):
    """An equilibrium at a vertex, a stop or a corner of a law, where a motion shrinks by one factor in each turn.

    state      (2n,) its physical state
    number     number of a mode there, a set of linear equations between two events
    exponents  (2n,) exponents of the motion per unit of time
    error      error of the exponents
    """

    state: Array
    number: int
    exponents: Array
    error: float


def rest_of_turns(cells: CellBatch, r: int) -> Rest | None:
    """Return the equilibrium at a vertex round which a cell's motion shrinks, from its first stored state on.

    A vertex is a stop, or a corner of a piecewise linear law.

    Return None if there is no such equilibrium.
    """
    sections = cells.known_states(r)
    if len(sections) < 8:
        return None
    quarters = [float(np.ptp(quarter, axis=0).max()) for quarter in np.array_split(sections, 4)]
    if not quarters[0] > quarters[3] or np.any(np.diff(quarters) > 0.0):
        return None  # the motion does not shrink
    return _rest_from(cells, r, sections[0], min(len(sections), MIN_EXAMINED_PERIODS))


def rest_beside(cells: CellBatch, r: int) -> Rest | None:
    """Return the equilibrium at a vertex in which the only mass of a cell stands; None if there is none.

    A vertex is a stop, or a corner of a piecewise linear law. A motion that starts near the equilibrium must shrink
    round it; motion from all sides then does so.
    """
    if cells.directions > 2:
        return None
    state = physical_states(cells.oscillators, cells.batch.motions, np.array([r]))[0]
    push = PUSH_DISTANCE * (1.0 + abs(state[0])) * 2.0 * np.pi / cells.oscillators.period[r]
    rest = _rest_from(cells, r, state + np.array([0.0, push]), FEW_TURNS)
    return rest if rest is not None and abs(rest.state[0] - state[0]) <= CLOSING_DISTANCE * abs(state[0]) else None


def _rest_from(cells: CellBatch, r: int, state: Array, periods: int) -> Rest | None:
    """Return the equilibrium at a vertex round which a motion from ``state`` (2n,) shrinks; None if there is none.

    A vertex is a stop, or a corner of a piecewise linear law. The motion of cell r is followed event by event for at
    most ``periods`` natural periods.
    """
    machine, (number,) = at_rows(cells.oscillators, np.array([r])), numbers_of(cells, r, state[None])
    last = deque(trails(cells, r, (state, int(number)), periods), maxlen=1)
    count, rests = len(last[0].keys) if last else 0, list[Rest]()
    while count > 2:  # rounding hides the last turns round a rest away from the origin
        rest = rest_of(machine, last[0].until(count))
        rests += [rest] if rest else []
        count //= 2
    return min(rests, key=lambda rest: rest.error, default=None)


def numbers_of(cells: CellBatch, r: int, states: Array) -> NDArray[np.int64]:
    """Return the numbers (K,) of the modes that hold at physical states (K, 2n) of cell r.

    A mode is a set of linear equations of motion between two events.
    """
    table = cells.oscillators.table
    elements = at_rows(table.elements, np.array([r]))
    return np.array([mode_code_of_state(elements, z).number_of(*table.machines.segments) for z in states])


def rest_without_events(cells: CellBatch, r: int) -> Rest | None:
    """Return the equilibrium at a stop, or a corner of a law, to which a motion converges in one mode; else None.

    A mode is a set of linear equations between two events. The motion of cell r comes from one side, by its slowest
    decay.
    """
    sections = cells.known_states(r)
    numbers = numbers_of(cells, r, sections)
    machine = at_rows(cells.oscillators, np.array([r]))
    rests = (_rest_in_mode(machine, sections, numbers == number, number) for number in dict.fromkeys(numbers.tolist()))
    return next((rest for rest in rests if rest is not None), None)


def _rest_in_mode(machine: Oscillator, sections: Array, inside: Mask, number: int) -> Rest | None:
    """Return the equilibrium of ``rest_without_events`` in the mode of this number; None if there is none.

    sections  (K, 2n) states of the motion at sections t = k T
    inside    (K,) mask of sections in that mode, a set of linear equations
    """
    slot, size = np.flatnonzero(machine.table.codes[0] == number), sections.shape[1]
    if not len(slot) or machine.table.pieces.lost[0, slot[0]] > 0.0:
        return None
    pieces, period = HybridModes(*(field[0, slot[0]] for field in machine.table.pieces)), float(machine.period[0])
    rest = _rest_of_mode(pieces.to_physical, pieces.blocks[0])
    logs = np.sort(rates_of(pieces.blocks[0]).real.reshape(-1))[::-1]
    away, decay = sections - rest, math.exp(min(logs[0], 0.0) * period)
    linear = away[:-1] @ expm(_rates(pieces.acceleration) * period).T
    x, v = np.split(np.abs(away[:-1]), 2, axis=1)
    far = np.maximum(x.max(axis=1), v.max(axis=1) * period / (2.0 * np.pi))
    misses = np.maximum(np.abs(linear - decay * away[:-1]), np.abs(away[1:] - decay * away[:-1])).max(axis=1)
    straight = (misses <= SAME_RAY * decay * far) & inside[:-1] & inside[1:]
    if not (logs[0] < 0.0 and np.any(straight)):
        return None
    direction = away[int(np.argmax(straight))]
    rows, (low, high) = pieces.rows, pieces.ends.T
    value, change = rows[:, :size] @ rest + rows[:, size], rows[:, :size] @ direction
    rounding = VERTEX * (np.abs(rows[:, :size]) @ (np.abs(rest) + np.abs(direction)) + np.abs(rows[:, size]))
    within = (value + change < high + rounding) & (value + change > low - rounding)
    within &= (value <= high + rounding) & (value >= low - rounding)
    rest[size // 2 :] = 0.0
    ends = np.abs(np.stack([value - low, value - high])) <= rounding
    return Rest(rest, number, logs, 1e-15 * abs(logs[0])) if np.all(within) and np.any(ends) else None


def _rest_of_mode(to_physical: Array, blocks: Array) -> Array:
    """Return the state (2n,) in which a mode, a set of linear equations, is at rest.

    ``blocks`` (n, columns) are its decoupled equations, and ``to_physical`` (2n, 2n) transforms their states.
    """
    return np.asarray(to_physical @ blocks[:, COLUMN.rest0 : COLUMN.rest1 + 1].reshape(-1))


def _rates(acceleration: Array) -> Array:
    """Return the matrix (2n, 2n) of z' = A z about a rest position, from its accelerations.

    ``acceleration`` (n, 2n + 1) has the weights of (x, v, 1) in x''.
    """
    n = len(acceleration)
    return np.concatenate([np.eye(n, 2 * n, n), acceleration[:, : 2 * n]])


def rest_of(machine: Oscillator, trail: EventTrail) -> Rest | None:
    """Return the equilibrium to which a motion shrinks through ever the same events; None if there is none.

    ``machine`` is a single machine in a batch, ``trail`` the events of its motion. Suppose that all linear equations,
    or modes, of a turn are at rest in one state, and all events lie there. Then the motion round it has no scale. A
    factor by which one turn multiplies the motion then applies to every turn. Motion along itself grows by this factor,
    and so does the distance; the map of the turn has the other multipliers.
    """
    last, size = len(trail.keys) - 1, trail.states.shape[1]
    again = last - np.flatnonzero(trail.keys[:-1] == trail.keys[-1:])[::-1]
    turns = (int(m) for m in again if 2 * m <= last and np.array_equal(trail.keys[-m:], trail.keys[-2 * m : -m]))
    m = next(turns, 0)
    if m == 0:
        return None
    turn_machine, orbit, _ = turn_from(machine, trail, m, 0)
    begins = trail.legs[np.append(trail.first, len(trail.legs))[[last - m + 1, last + 1]] - 1]
    before, after = begins[:, LEG_STATE : LEG_STATE + size]
    try:
        motion = OrbitMotion(turn_machine, orbit.itinerary, orbit.times[None], before[None])
        rest = _state_at_rest(motion, _sizes(trail.legs[trail.first[last - m] :], 0.0, orbit.length, size))
    except NoOscillatorError:
        return None
    if rest is None or motion.plan.slows:
        return None
    scale = _sizes(trail.legs[trail.first[last - m] :], rest, orbit.length, size)
    offset, back = (before - rest) / scale, (after - rest) / scale
    factor = float(offset @ back / (offset @ offset))
    turned = float(np.max(np.abs(back - factor * offset))) / abs(factor)
    if not (0.0 < factor < 1.0 - SAME_RAY and turned <= SAME_RAY):
        return None
    flight = trail.legs[trail.first[last - m + 1], LEG.start] - begins[0, LEG.start]
    rate = _rates(motion.pieces.acceleration[0, motion.plan.table[0, MODE]])
    start = rest + expm(rate * flight) @ (before - rest)
    others = np.abs(multipliers(OrbitMotion(turn_machine, orbit.itinerary, orbit.times[None], start[None]))[0])
    if not np.all(others <= factor * (1.0 + SAME_RAY)):
        return None  # rounding leads away from such a turn
    logs = np.log(np.sort(np.append(others, factor)))[::-1]
    rounding = float(np.max(np.abs(rest) / scale)) / factor
    error = turned + 1e-14 * (1.0 + abs(logs[0]) + rounding)
    return Rest(rest, int(begins[1, LEG.number]), logs / orbit.span(turn_machine), error / orbit.span(turn_machine))


def _sizes(legs: Array, rest: Array | float, length: float | Array, size: int) -> Array:
    """Return the size (2n,) of a turn's states about ``rest``, equal for all displacements and for all velocities.

    It is the largest distance at the starts of ``legs``, motions in one mode each. ``length`` is the duration of the
    turn, and ``size`` the number of components of a state.
    """
    x, v = np.split(np.max(np.abs(legs[:, LEG_STATE : LEG_STATE + size] - rest), axis=0), 2)
    omega = 2.0 * np.pi / float(length)
    far = max(x.max(), v.max() / omega)
    return np.repeat([far, omega * far], size // 2)


def _state_at_rest(motion: OrbitMotion, size: Array) -> Array | None:
    """Return the state (2n,) at which all modes of a turn are at rest and all its events lie; None if there is none.

    A mode is a set of linear equations between two events. ``size`` (2n,) is the size of states in the turn.
    """
    pieces, plan, n = motion.pieces, motion.plan.table, len(size) // 2
    events = plan[plan[:, EVENT] != NO_EVENT]
    modes, signals, ends = events[:, MODE], events[:, SIGNAL], events[:, END]
    for k in range(pieces.lost.shape[1]):
        rest = _rest_of_mode(pieces.to_physical[0, k], pieces.blocks[0, k, 0])
        augmented, most = np.append(rest, 1.0), np.append(np.maximum(np.abs(rest), size), 1.0)
        forces, terms = pieces.acceleration[0] @ augmented, np.abs(pieces.acceleration[0]) @ most
        rows, end = pieces.rows[0, modes, signals], pieces.ends[0, modes, signals, ends]
        misses, sizes = rows @ augmented - end, np.abs(rows) @ most + np.abs(end)
        still = np.all(np.abs(rest[n:]) <= VERTEX * size[n:]) and np.all(np.abs(forces) <= VERTEX * terms)
        if still and np.all(np.abs(misses) <= VERTEX * sizes):
            rest[n:] = 0.0
            return rest
    return None


def put_rests(cells: CellBatch, rests: dict[int, Rest]) -> None:
    """Write the results of cells that shrink to an equilibrium at a stop or a corner of a law.

    ``rests`` has the equilibria by row.
    """
    if not rests:
        return
    rows, orbits = np.array(list(rests), dtype=np.int64), cells.orbits
    for r, rest in rests.items():
        period = cells.oscillators.period[r]
        orbits.h[r] = (cells.oscillators.to_blocks[r] @ rest.state).reshape(orbits.h[r].shape)
        orbits.mode[r, 0], orbits.period[r] = rest.number, 1
        orbits.exponents[r], orbits.error[r] = rest.exponents * period, rest.error * period
        orbits.tally[r] = NOTHING_COUNTED
        orbits.tally[r, CONTRACTION] = np.nan  # no turn was followed
    put_periodic(cells, rows)
    write_results(cells, rows, regime=NO_IMPACT)


def is_at_equilibrium(cells: CellBatch, r: int) -> bool:
    """Return True if nothing moves or accelerates in the present state of cell r."""
    motions, table = cells.batch.motions, cells.oscillators.table
    state = physical_states(cells.oscillators, motions, np.array([r]))[0]
    slot = np.flatnonzero(table.codes[r] == motions.mode[r, 0])
    if np.any(state[len(state) // 2 :] != 0.0) or not len(slot):
        return False
    rows, augmented = table.pieces.acceleration[r, slot[0]], np.append(state, 1.0)
    return bool(np.all(np.abs(rows @ augmented) <= VERTEX * (np.abs(rows) @ np.abs(augmented))))
