"""Machines of the oracle in the solver's form, and single motions of the solver with their full record.

``machines_of``  machines of tests/support/oracle/pieces as rows of Machines
``follow``       one motion through any number of periods, with missing modes built
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tests.support.oracle.piecewise import PiecewiseContact, PiecewiseMachine, PiecewiseMode
from workers.continuation.admissibility import first_fault
from workers.continuation.equations import motion_of
from workers.continuation.itinerary import many_orbits
from workers.continuation.orbit_from_motion import record_orbit
from workers.kernel.hybrid.leg_record import LEG_STATE
from workers.kernel.hybrid.motion import through_modes
from workers.kernel.hybrid.state import mode_number_of_state
from workers.kernel.motion import MODE_MISSING, NOTHING_COUNTED, RECORDED, RUNNING, STATUS, WORK, WORK_OF_A_TRIAL
from workers.model.family import with_modes
from workers.model.hybrid_modes import DETACHED, ON, OPEN, SIGNALS, ModeCode
from workers.model.machines import Machines
from workers.model.mode_table import build_hybrid
from workers.model.oscillator import Oscillator, take_one
from workers.results import NO_REASON

Array = NDArray[np.float64]

EVENTS = 2000
"""Most events of a period that are recorded."""

STATES = {"open": OPEN, "held": ON, "engaged": ON, "detached": DETACHED}
SLIPS = {"slip+": 1, "slip-": -1, "stick": 0}


def machines_of(machines: Sequence[PiecewiseMachine], drift: int | None = None) -> Machines:
    """Machines of equal numbers of coordinates and elements, with contacts soft or rigid alike, forced with tau = 0.

    drift: the coordinate of all of them that may drift.
    """
    H = max([1, *(f.order for m in machines for p in m.phases for f in m.during(p).forces)])
    rows = [(*_fields_of(machine, H), -1.0 if drift is None else drift) for machine in machines]
    return Machines(*(np.ascontiguousarray(field, dtype=np.float64) for field in zip(*rows, strict=True)))


def _fields_of(machine: PiecewiseMachine, H: int) -> tuple[Any, ...]:
    n, C, F = machine.n, len(machine.contacts), len(machine.friction)
    laws = [machine.during(phase) for phase in machine.phases]
    P = len(laws)
    forces = np.zeros((2, P, H, n))
    for p, law in enumerate(laws):
        for force in law.forces:
            forces[0, p, force.order - 1] += np.array(force.sin, float)
            forces[1, p, force.order - 1] += np.array(force.cos, float)
    stops = [[c.stops.get(-1, -math.inf), c.stops.get(1, math.inf)] for c in machine.contacts]
    pads = [[[0.0] * 3 if c.restitution is not None else [c.stiffness, c.damping, c.preload] for c in law.contacts]
            for law in laws]  # fmt: skip
    return (
        machine.mass, [law.damping for law in laws], [law.stiffness for law in laws], [law.load for law in laws],
        forces[0], forces[1], machine.omega, 0.0, [*(phase.start for phase in machine.phases), 1.0],
        np.reshape([c.row for c in machine.contacts], (C, n)), np.reshape(stops, (C, 2)),
        [1.0 if c.restitution is None else c.restitution for c in machine.contacts],
        [float(c.restitution is None) for c in machine.contacts],
        [float(c.restitution is None and c.release == "force") for c in machine.contacts],
        np.reshape(pads, (P, C, 3)),
        np.reshape([f.row for f in machine.friction], (F, n)), [f.belt for f in machine.friction],
        np.reshape([[[[f.kinetic, f.static, f.slope]] * 2 for f in law.friction] for law in laws], (P, F, 2, 3)),
        np.zeros((C, 2, 1, 3)), np.zeros((F, 2, 1, 3)), np.ones(C),
    )  # fmt: skip


def built(machine: PiecewiseMachine) -> Oscillator:
    """A machine as kernels run it, without a mode yet; it must be valid."""
    oscillators, reasons = build_hybrid(machines_of([machine]))
    assert reasons[0] == NO_REASON
    return oscillators


def code_in(mode: PiecewiseMode) -> ModeCode:
    """A mode of the oracle as a Code of the solver; the oracle's "edge" has none."""
    contacts = tuple(STATES[name.rstrip("+-")] * (-1 if name.endswith("-") else 1) for name in mode.contacts)
    return ModeCode(mode.phase, contacts, tuple(SLIPS[name] for name in mode.friction))


class SolverEvent(NamedTuple):
    """An event ``t`` after the start, at the end of the range of a signal.

    The signal is that of a contact (its position or, ``force``, its push) or of a friction; with side and rate. See
    hybrid.Pieces.
    """

    t: float
    element: str
    index: int  # type: ignore[assignment]
    side: int
    rate: float
    force: bool


@dataclass
class SolverMotion:
    """A motion from one section to another.

    The state (x, v) at the end, its derivative by the initial state, the number of its mode and of the mode at each
    section,
    its events, contacts (time, +-(1 + contact), speed) and counts.
    """

    state: Array
    jacobian: Array
    number: int
    numbers: list[int]
    sections: list[Array]
    events: list[SolverEvent]
    hits: Array
    tally: Array
    growth: Array

    @property
    def status(self) -> int:
        """RUNNING, or the reason of an early end."""
        return int(self.tally[STATUS])


def shown(hybrid: Oscillator, state: Array | Sequence[float]) -> int:
    """The number of the mode of a section state."""
    elements = take_one(hybrid, 0).table.elements
    return int(mode_number_of_state(elements, np.array(state, dtype=np.float64)))


def follow(
    hybrid: Oscillator,
    state: Array | Sequence[float],
    number: int | None = None,
    periods: int = 1,
    *,
    duration: float | None = None,
    frame: Array | None = None,
    framed: bool = False,
) -> SolverMotion:
    """Follow the first machine from a section through some periods, or for a ``duration`` <= one period.

    number: of the initial mode; by default that of the state. frame (m, 2n): tangent vectors, by default the axes;
    framed: they are made orthonormal on the way, and their growth is counted.
    """
    z = np.array(state, dtype=np.float64)
    W = np.eye(len(z)) if frame is None else frame
    period = 2.0 * math.pi / hybrid.table.machines.omega[0]
    start = shown(hybrid, z) if number is None else number
    growth = np.zeros(len(W) if framed else 0)
    motion = SolverMotion(z, W.T, start, [start], [z], [], np.zeros((0, 3)), NOTHING_COUNTED.copy(), growth)
    for k in range(periods):
        _go_on(hybrid, motion, k * period, period if duration is None else duration)
        if motion.status != RUNNING:
            break
    return motion


def _go_on(hybrid: Oscillator, motion: SolverMotion, since: float, duration: float) -> None:
    """Advance a motion from a section; repeated from there whenever a mode had to be built."""
    table = take_one(hybrid, 0).table
    going = True
    while going:
        z, W, growth, tally = (array.copy() for array in (motion.state, motion.jacobian.T, motion.growth, motion.tally))
        W, code = np.ascontiguousarray(W), np.array([motion.number])
        hits, events = np.zeros((EVENTS, 3)), np.empty((EVENTS, LEG_STATE + len(z) + table.pieces.ends.shape[1]))
        tally[WORK], tally[RECORDED] = WORK_OF_A_TRIAL, 0.0
        through_modes(table, z, W, code, growth, np.zeros((0, 0)), tally, hits, events, duration)
        going = tally[STATUS] == MODE_MISSING and len(hybrid.table.build_missing(np.zeros(1, dtype=np.int64))) > 0
    hits = hits[: int(tally[RECORDED])]
    hits[:, 0] += since
    motion.state, motion.jacobian, motion.number, motion.tally, motion.growth = z, W.T, int(code[0]), tally, growth
    motion.numbers.append(motion.number)
    motion.sections.append(z)
    motion.hits = np.concatenate([motion.hits, hits])
    motion.events += [_event(hybrid, row, since) for row in events[events[:, 1] >= 0.0]]


def _event(hybrid: Oscillator, row: Array, since: float) -> SolverEvent:
    t, signal, side, rate = row[:4].tolist()
    first_friction = SIGNALS * hybrid.table.machines.sizes[1]
    if signal >= first_friction:
        return SolverEvent(since + t, "friction", int(signal) - first_friction, int(side), rate, False)
    index, force = divmod(int(signal), SIGNALS)
    return SolverEvent(since + t, "contact", index, int(side), rate, bool(force))


def warm_up() -> None:
    """Compile the loop through modes by itself, as tests call it: once for all processes of a test run."""
    mass = PiecewiseMachine(
        [[1.0]], [[0.1]], [[1.0]], [0.0], 1.0, (), (PiecewiseContact([1.0], 1.0, None, stiffness=1.0),)
    )
    follow(built(mass), [0.0, 0.0])
    machines = with_modes(machines_of([mass]))
    motion = motion_of(machines, many_orbits([record_orbit(machines, np.array([2.0, 0.0]), 1)]))
    motion.states_at(np.array([[0.0]]))
    first_fault(motion)
