"""Orbits of machines with modes to start from: their events and modes as the kernel's own motion passes them."""

import numpy as np

from workers.continuation.itinerary import Itinerary, Leg, Orbit
from workers.kernel.hybrid.motion import through_modes
from workers.kernel.hybrid.notes import LEG, LEG_STATE
from workers.kernel.motion import NOTHING_COUNTED, RUNNING, STATUS, WORK, WORK_OF_A_TRIAL
from workers.model.hybrid import build_hybrid
from workers.model.hybrid_machines import HybridMachines
from workers.model.hybrid_modes import ON, OPEN, Code, code_of
from workers.model.oscillator import Array, Oscillator, Rows, one_of

RECORD = 512
"""Events of one period that an orbit may have."""

AT_REST = 1e-10
"""Share of the largest displacement or velocity within which a state is on a stop, or slides on nothing."""

ALIKE = 1e-6
"""Share of a turn by which the events of both halves may differ and be mirror images."""


def recorded_modes(machines: HybridMachines, state: Array, periods: int) -> Orbit:
    """The orbit of one machine as its events are passed in some periods from a physical section state.

    A symmetric one where the second half is the mirror image of the first. ValueError where it cannot be followed.
    """
    hybrid, _ = build_hybrid(machines)
    state, number = np.array(state, dtype=np.float64), _shown(machines, np.asarray(state))
    period, rows = 2.0 * np.pi / float(machines.omega[0]), list[Array]()
    for k in range(periods):
        found, state, number = _one_period(hybrid, state, number)
        found[:, LEG.start] += k * period
        rows += list(found)
    C, F = machines.sizes[1:]
    codes = [code_of(int(row[LEG.number]), C, F) for row in rows]
    legs = [_leg(row, code, len(state)) for row, code in zip(rows, codes, strict=True)]
    phases = machines.sizes[0] > 1  # the section is nothing to a machine without them
    kept = [i for i, leg in enumerate(legs) if phases or leg.signal >= 0]
    first = next((i for i in kept if legs[i].signal >= 0), None)
    if first is None:
        return Orbit(Itinerary((), periods, legs=(tuple(legs[i] for i in kept or [0]),)), np.zeros(0), np.zeros(0))
    order = [*(i for i in kept if i >= first), *(i for i in kept if i < first)]
    chains, sides, times, speeds = list[list[Leg]](), list[int](), list[float](), list[float]()
    before = codes[first - 1] if first else codes[-1]
    for i in order:
        if legs[i].signal >= 0:
            chains.append([])
            sides.append(legs[i].label(before))
            times.append(float(rows[i][LEG.start]))
            speeds.append(float(np.copysign(rows[i][LEG.rate], sides[-1])))
        chains[-1].append(legs[i])
        before = codes[i]
    itinerary = Itinerary(tuple(sides), periods, legs=tuple(map(tuple, chains)))
    return halved(machines, Orbit(itinerary, np.array(times), np.array(speeds)))


def _leg(row: Array, code: Code, size: int) -> Leg:
    begun = tuple(int(each) for each in row[LEG_STATE + size :])
    return Leg(code, begun, int(row[LEG.signal]), int(row[LEG.side]))


def halved(machines: HybridMachines, orbit: Orbit, alike: float = ALIKE) -> Orbit:
    """The half of an orbit of one machine whose other half is its mirror image; else the orbit itself.

    Times of events of both halves may differ by the share ``alike`` of a turn.
    """
    (sides, periods, symmetric, legs), half = orbit.itinerary, len(orbit.times) // 2
    span = float(orbit.itinerary.span(machines)[0])
    if symmetric or not sides:
        return orbit
    if len(sides) % 2 or periods % 2 == 0 or not machines.mirrored[0] or not orbit.itinerary.repeats(half, -1):
        return orbit
    if np.max(np.abs(orbit.times[half:] - orbit.times[:half] - 0.5 * span)) > alike * span:
        return orbit
    itinerary = Itinerary(sides[:half], periods, True, legs[:half])
    return Orbit(itinerary, orbit.times[:half], orbit.speeds[:half])


def _shown(machines: HybridMachines, z: Array) -> int:
    """The number of the mode that a section state shows; what rounding leaves of rest or of sticking is rest."""
    n, own = len(z) // 2, machines
    x, v = z[:n], z[n:]
    far, fast = AT_REST * np.max(np.abs(z)) + 1e-300, AT_REST * np.max(np.abs(v)) + 1e-300
    contacts, slips = [], []
    for row, stops, soft in zip(own.row[0], own.stops[0], own.soft[0], strict=True):
        y, rate = float(row @ x), float(row @ v)
        side = 1 if y > 0.5 * (max(stops[0], -1e300) + min(stops[1], 1e300)) else -1
        depth = side * (y - stops[1 if side > 0 else 0])
        on = depth > 0.0 if soft else abs(depth) <= far and abs(rate) <= fast
        contacts.append(side * ON if on else OPEN)
    for row, belt in zip(own.slide[0], own.belt[0], strict=True):
        sliding = float(row @ v) - belt
        slips.append(int(np.sign(sliding)) if abs(sliding) > fast else 0)
    return Code(0, tuple(contacts), tuple(slips)).number


def _one_period(hybrid: Oscillator, state: Array, number: int) -> tuple[Array, Array, int]:
    """The legs of one period, and state and mode after it; modes are built as they are missing."""
    table = one_of(hybrid, 0).table
    legs = np.empty((RECORD, LEG_STATE + len(state) + table.pieces.ends.shape[1]))
    W, growth, triangle, hits = np.zeros((0, len(state))), np.zeros(0), np.zeros((0, 0)), np.zeros((0, 3))

    def followed(_: Rows) -> tuple[Array, Rows, Array]:
        z, code, tally = state.copy(), np.array([number]), NOTHING_COUNTED.copy()
        tally[WORK] = WORK_OF_A_TRIAL
        through_modes(table, z, W, code, growth, triangle, tally, hits, legs, 2.0 * np.pi / table.omega)
        return z, code, tally

    z, code, tally = hybrid.with_modes(followed, np.zeros(1, dtype=np.int64))
    known = legs[~np.isnan(legs[:, LEG.start])]
    if tally[STATUS] != RUNNING or len(known) == RECORD:
        raise ValueError("the motion cannot be followed through one period of the force")
    return known, z, int(code[0])
