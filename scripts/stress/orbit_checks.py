"""Orbits of random cells against the independent simulator: no crossing missed, states to rounding."""

import math
from dataclasses import dataclass, replace

import numpy as np
from mpmath import mp
from numpy.typing import NDArray

from scripts.stress.findings import RandomCell, StressFindings
from scripts.stress.result_checks import POSITION
from tests.support.oracle import first_hit, simulate
from tests.support.oracle.model import fastest_rate, machine_of
from workers.kernel.coordinates import blocks_to_physical, motion_from
from workers.kernel.motion import FLIGHT, LOWER, RECORDED, RUNNING, STATUS, STUCK, UPPER, Motion, motion_at
from workers.kernel.period import advance, propagate
from workers.model.hybrid_modes import ON
from workers.model.oscillator import Oscillator
from workers.model.system import find_system
from workers.orbit.map import map_with_jacobian

Array = NDArray[np.float64]

EPS = float(np.finfo(np.float64).eps)
FLIGHTS = 12
"""Flights of a cell, from its start on, that are checked."""
FAST_CYCLES = 30.0
"""Cycles of the fastest time scale followed of one flight; a longer one is followed up to there."""
ORBIT_COST = 800.0
"""Most radians of the fastest time scale, with two masses, in the periods of an orbit in multiprecision."""
ORBIT_IMPACTS = 300
"""... and most impacts, approximately."""
ORBIT_PERIODS = 20
COMPARABLE = 1e-3
"""Largest eps times the Jacobian's norm for which two orbits can be compared."""
DIFFERS = 1e4
"""Multiple of eps times the Jacobian's norm (and of the speed of rounding in time) from which on a cell is listed."""


@dataclass(frozen=True)
class _Flight:
    """A free flight: physical state and time since the section at its start, duration, impact side at its end."""

    state: Array
    start: float
    duration: float
    side: int


def recheck(cell: RandomCell, orbit: bool) -> StressFindings:
    """Follow the first flights of one cell, compare positions at its impacts, and its orbit if wanted."""
    findings = StressFindings()
    osc, start = _build(cell)
    if osc is None:
        return findings
    findings.checked[f"cells re-evaluated, {cell.kind}"] += 1
    _recheck_flights(findings, cell, osc, start)
    if orbit:
        _recheck_orbit(findings, cell, osc, start)
    return findings


def _build(cell: RandomCell) -> tuple[Oscillator | None, Array]:
    """The oscillator of a cell and its initial state; None if the cell has no motion."""
    system = find_system(cell.system)
    values = {p.name: p.default for p in system.parameters} | cell.params
    try:
        osc = system.build(values)
        motion_from(osc, np.array(cell.start))
        return osc, np.array(cell.start)
    except ValueError:
        return None, np.array(cell.start)


def _scale(osc: Oscillator, h: Array) -> float:
    """Size of the terms that add up to the gap coordinate."""
    gaps = [abs(b) for b in (osc.b_upper, osc.b_lower) if math.isfinite(b)]
    return float(np.sum(np.abs(np.array(osc.gap.row) * h))) + osc.gap.amplitude + max(gaps, default=0.0)


def _waves(osc: Oscillator, t: float) -> Array:
    """(sin k phi, cos k phi) (H, 2) at a time since the section."""
    phase = osc.tau + osc.gap.omega * t
    orders = np.arange(1, len(osc.gap.sin_part) + 1)
    return np.stack([np.sin(orders * phase), np.cos(orders * phase)], axis=-1)


def _gap(osc: Oscillator, h: Array, t: float) -> float:
    """The gap coordinate from its rest position, without correction of rounding."""
    parts = np.stack([osc.gap.sin_part, osc.gap.cos_part], axis=-1)
    return float(np.sum(np.array(osc.gap.row) * h)) + float(np.sum(parts * _waves(osc, t)))


def _physical(osc: Oscillator, h: Array, t: float) -> Array:
    """Physical state (2n,) of block coordinates at a time since the section."""
    full = h + np.sum(np.array(osc.gap.forced) * _waves(osc, t), axis=(2, 3)) + osc.gap.rest
    return np.asarray(np.array(osc.to_physical) @ full.ravel())


def _rebound(cell: RandomCell, osc: Oscillator, state: Array, side: int, speed: float) -> Array:
    """A state at an impact: on the stop, with the velocity after it in the gap direction."""
    g, n = np.array(cell.gap), len(cell.gap)
    mass = np.array([[float(entry) for entry in row] for row in machine_of(cell.machine).mass])
    kick = np.linalg.solve(mass, g)
    x, v = state[:n].copy(), state[n:].copy()
    x += g / (g @ g) * ((cell.upper if side > 0 else cell.lower) - g @ x)
    v += kick / (g @ kick) * (-osc.R * side * speed - g @ v)
    return np.concatenate([x, v])


def _flights(findings: StressFindings, cell: RandomCell, osc: Oscillator, start: Array) -> list[_Flight]:
    """The free flights of the first periods, with checks of the positions at their ends."""
    flights: list[_Flight] = []
    section = motion_from(osc, start)
    for _ in range(3):
        motion = motion_at(section.h, int(section.mode[0]), record=FLIGHTS + 1)
        advance(osc, motion)
        if motion.tally[STATUS] != RUNNING:
            break
        t, state = 0.0, blocks_to_physical(osc, section)
        held = abs(int(section.mode[0]) - FLIGHT) == ON
        rows = motion.impacts[: int(motion.tally[RECORDED])].copy()
        for time, side, speed in rows:
            if speed == 0.0:  # the start of a rest after chatter: no flight leads there
                held, t = True, float(time)
                continue
            there = motion_at(section.h, int(section.mode[0]))
            propagate(osc, there, float(time))
            beyond = side * _gap(osc, there.h, float(time)) - (osc.b_upper if side > 0 else osc.b_lower)
            findings.checked["impact positions"] += 1
            rounding = 2e-15 * _scale(osc, there.h)
            findings.record(
                f"impact position beyond the stop / rounding of its terms, {cell.kind}", beyond / rounding, cell
            )
            if beyond > POSITION * cell.clearance + rounding:
                findings.record_trouble("position beyond a stop", f"impact at t = {time!r}: {beyond:.2e}", cell)
            # A rest between two impacts hides its release: flights after it are not rebuilt here.
            rested = there.tally[STUCK] > _stuck_until(osc, section, t)
            if not held and not rested:
                flights.append(_Flight(state, t, float(time) - t, int(side)))
            held = False
            t = float(time)
            state = _rebound(cell, osc, _physical(osc, there.h, t), int(side), float(speed))
        if not rows.size and not held and motion.tally[STUCK] == 0.0:
            flights.append(_Flight(state, t, osc.period - t, 0))
        if len(flights) >= FLIGHTS:
            break
        section = motion
    return flights[:FLIGHTS]


def _stuck_until(osc: Oscillator, section: Motion, t: float) -> float:
    if t == 0.0:
        return 0.0
    there = motion_at(section.h, int(section.mode[0]))
    propagate(osc, there, t)
    return float(there.tally[STUCK])


def _recheck_flights(findings: StressFindings, cell: RandomCell, osc: Oscillator, start: Array) -> None:
    machine, rate = machine_of(cell.machine), fastest_rate(cell.machine)
    g, n = np.array(cell.gap), len(cell.gap)
    for flight in _flights(findings, cell, osc, start):
        reach = min(flight.duration, FAST_CYCLES * 2.0 * math.pi / rate)
        findings.checked[f"flights checked, {cell.kind}"] += 1
        findings.checked["flights checked to their end"] += int(reach == flight.duration)
        size = osc.gap.amplitude + float(np.abs(g) @ (np.abs(flight.state[:n]) + np.abs(flight.state[n:]) / rate))
        spread = float(np.linalg.norm(g)) * float(np.linalg.norm(flight.state[:n]))
        spread += float(np.linalg.norm(g)) * float(np.linalg.norm(flight.state[n:])) / rate
        room = POSITION * cell.clearance + 1e-14 * (1.0 + rate * reach) * (size + spread)
        wider = replace(machine, upper=machine.upper + room, lower=machine.lower - room)
        hit = first_hit(wider, flight.state.tolist(), flight.start, reach)
        if hit is not None and float(hit.t) < reach * (1.0 - 1e-6):
            findings.record_trouble(
                "crossing missed", f"at {float(hit.t)!r} of a flight of {reach!r}, speed {float(hit.speed):.2e}", cell
            )


def _recheck_orbit(findings: StressFindings, cell: RandomCell, osc: Oscillator, start: Array) -> None:
    """Compare section states; deviations in units of eps, state size and the largest norm of a partial Jacobian."""
    rate = max(fastest_rate(cell.machine), float(np.sqrt(np.max(osc.gap.lam))))
    affordable = ORBIT_COST * min(1.0, (2.0 / len(cell.gap)) ** 2)
    periods = min(ORBIT_PERIODS, int(affordable / (rate * osc.period)))
    weights = np.column_stack([np.sqrt(osc.gap.metric), np.ones(len(osc.gap.metric))])
    forced = float(np.linalg.norm((np.array(osc.gap.swing) + np.abs(osc.gap.rest)) * weights))
    motion = motion_from(osc, start)
    states, norms, scales = [], [], []
    partial: list[Array] = []
    for _ in range(periods):
        _, jacobian = map_with_jacobian(osc, motion.h, int(motion.mode[0]), 1, False)
        scale = float(np.linalg.norm(motion.h * weights)) + forced
        advance(osc, motion)
        if motion.tally[STATUS] != RUNNING or not np.all(np.isfinite(jacobian)):
            break
        hops = 25.0 / max(-math.log(osc.R), 1e-6) if motion.tally[STUCK] > 0.0 and osc.R > 0.0 else 0.0
        if motion.tally[UPPER] + motion.tally[LOWER] + hops > ORBIT_IMPACTS:
            break
        J = weights.reshape(-1, 1) * jacobian / weights.reshape(1, -1)
        partial = [J @ earlier for earlier in [*partial, np.eye(len(J))]]
        norms.append(max(1.0, *(float(np.linalg.norm(one, 2)) for one in partial)))
        scales.append(scale)
        states.append(blocks_to_physical(osc, motion))
        if norms[-1] * EPS > COMPARABLE:
            break
    if not states:
        findings.checked["orbits too costly in multiprecision, or not comparable"] += 1
        return
    try:
        true = simulate(cell.machine, len(states), digits=30)
    except ArithmeticError:
        findings.checked["orbits too costly in multiprecision, or not comparable"] += 1
        return
    kind = f"{'sticking' if true.stuck else 'free'}, {cell.kind}"
    findings.checked[f"orbits compared, {kind}"] += 1
    findings.sample(f"periods compared, {cell.kind}", float(len(states)))
    to_blocks = np.array(osc.to_blocks)
    worst = 0.0
    for k, state in enumerate(states):
        with mp.workdps(30):
            away = np.array([float(mp.mpf(a) - b) for a, b in zip(state.tolist(), true.sections[k + 1], strict=True)])
        size = float(np.linalg.norm(weights * (to_blocks @ away).reshape(-1, 2)))
        worst = max(worst, size / (EPS * max(scales[: k + 1]) * norms[k]))
    findings.sample(f"deviation, {kind}", worst)
    findings.sample(f"deviation per radian, {kind}", worst / (1.0 + rate * osc.period))
    findings.record(f"deviation, {kind}", worst, cell)
    if worst > DIFFERS * (1.0 + rate * osc.period):
        findings.record_trouble(f"orbit differs, {kind}", f"{worst:.2e} eps |J|, |J| = {norms[-1]:.1e}", cell)
