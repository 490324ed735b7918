"""Orbits of random cells against the independent simulator of the tests: no crossing missed, states to rounding."""

import math
from dataclasses import dataclass

import numpy as np
from mpmath import mp
from numpy.typing import NDArray

from scripts.stress_cells import POSITION, Findings, Params, draw, frequencies
from tests.oracle import dense_violation, simulate
from tests.oracle.model import model
from tests.oracle.simulate import first_hit
from workers.kernel.motion import BEYOND, LOWER, RECORDED, RUNNING, STATUS, STUCK, UPPER, Motion, motion_at
from workers.kernel.stroboscopic import advance, blocks_to_physical, motion_from, propagate
from workers.model.oscillator import Oscillator
from workers.model.system import find_system
from workers.orbit.map import map_with_jacobian

Array = NDArray[np.float64]

EPS = float(np.finfo(np.float64).eps)
FLIGHTS = 12
"""Flights of one cell, from its start on, that are sampled densely."""
FAST_CYCLES = 30.0
"""Cycles of the fastest time scale for which one flight is sampled; a longer one is followed so far."""
ORBIT_COST = 800.0
"""Periods of an orbit in multiprecision are limited to this many radians of the fastest time scale."""
ORBIT_IMPACTS = 300
"""... and to about this many impacts."""
ORBIT_PERIODS = 20
COMPARABLE = 1e-3
"""eps times the Jacobian's norm up to which two orbits can be compared."""
DIFFERS = 1e4
"""Multiple of eps times the Jacobian's norm (and of the speed of rounding in time) above which a cell is listed."""


@dataclass(frozen=True)
class _Flight:
    """A free flight: physical state and time since the section at its start, duration, impact side at its end."""

    state: Array
    start: float
    duration: float
    side: int


def recheck(seed: int, number: int, orbit: bool) -> Findings:
    """Densely sample the first flights of one cell, compare positions at its impacts, and its orbit if asked."""
    found = Findings()
    params = draw(seed, number)
    osc, start = _build(params)
    if osc is None or motion_from(osc, start).contact[0] == BEYOND:
        return found
    found.checked["cells re-evaluated"] += 1
    _recheck_flights(found, number, params, osc, start)
    if orbit:
        _recheck_orbit(found, number, params, osc, start)
    return found


def _build(params: Params) -> tuple[Oscillator | None, Array]:
    system = find_system("two-mass")
    start = np.array([params[name] for name in system.states])
    try:
        return system.build(params), start
    except ValueError:
        return None, start


def _scale(osc: Oscillator, h: Array) -> float:
    """Size of the terms that add up to the gap coordinate."""
    return float(np.sum(np.abs(np.array(osc.gap.row) * h))) + osc.gap.amplitude + osc.b_upper


def _gap(osc: Oscillator, h: Array, t: float) -> float:
    """The gap coordinate, nothing taken off."""
    phase = osc.tau + osc.gap.omega * t
    forced = float(osc.gap.sin_part[0]) * math.sin(phase) + float(osc.gap.cos_part[0]) * math.cos(phase)
    return float(np.sum(np.array(osc.gap.row) * h)) + forced


def _physical(osc: Oscillator, h: Array, t: float) -> Array:
    """Physical state (4,) of block coordinates at a time since the section."""
    phase = osc.tau + osc.gap.omega * t
    full = h + np.array(osc.forced)[:, :, 0] @ [math.sin(phase), math.cos(phase)]
    return np.asarray(np.array(osc.to_physical) @ full.ravel())


def _flights(found: Findings, number: int, params: Params, osc: Oscillator, start: Array) -> list[_Flight]:
    """The free flights of the first periods; positions at their ends are checked on the way."""
    flights: list[_Flight] = []
    section = motion_from(osc, start)
    for _ in range(3):
        motion = motion_at(section.h, int(section.contact[0]), record=FLIGHTS + 1)
        advance(osc, motion)
        if motion.tally[STATUS] != RUNNING:
            break
        t, state = 0.0, blocks_to_physical(osc, section)
        held = abs(int(section.contact[0])) == 1
        rows = motion.impacts[: int(motion.tally[RECORDED])].copy()
        for time, side, speed in rows:
            there = motion_at(section.h, int(section.contact[0]))
            propagate(osc, there, float(time))
            beyond = side * _gap(osc, there.h, float(time)) - osc.b_upper
            found.checked["impact positions"] += 1
            rounding = 2e-15 * _scale(osc, there.h)
            found.record("impact position beyond the stop / rounding of its terms", beyond / rounding, number, params)
            if beyond > POSITION * osc.b_upper + rounding:
                found.note("position beyond a stop", f"impact at t = {time!r}: {beyond:.2e}", number, params)
            # A rest between two impacts hides its release: flights that began with it are not rebuilt here.
            rested = there.tally[STUCK] > _stuck_until(osc, section, t)
            if not held and not rested:
                flights.append(_Flight(state, t, float(time) - t, int(side)))
            held = False
            t = float(time)
            state = _physical(osc, there.h, t)
            state[0] = side * osc.b_upper
            state[2] = -osc.R * side * float(speed)
        if not rows.size and not held and motion.tally[STUCK] == 0.0:
            flights.append(_Flight(state, t, osc.period - t, 0))
        if len(flights) >= FLIGHTS:
            break
        section = motion
    return flights[:FLIGHTS]


def _stuck_until(osc: Oscillator, section: Motion, t: float) -> float:
    if t == 0.0:
        return 0.0
    there = motion_at(section.h, int(section.contact[0]))
    propagate(osc, there, t)
    return float(there.tally[STUCK])


def _recheck_flights(found: Findings, number: int, params: Params, osc: Oscillator, start: Array) -> None:
    rate = float(model(params).free.rate)
    for flight in _flights(found, number, params, osc, start):
        reach = min(flight.duration, FAST_CYCLES * 2.0 * math.pi / rate)
        found.checked["flights sampled densely"] += 1
        found.checked["flights sampled to their end"] += reach == flight.duration
        excess = float(dense_violation(params, [flight.state], [flight.start], [reach])[0])
        size = abs(flight.state[0]) + osc.gap.amplitude + (abs(flight.state[2]) + abs(flight.state[3])) / rate
        if excess <= POSITION * osc.b_upper + 1e-14 * (1.0 + rate * reach) * (size + abs(flight.state[1])):
            continue
        # What rounding may have made of a crossing is for multiprecision to say.
        hit = first_hit(params, flight.state.tolist(), flight.start, reach * (1.0 - 1e-9))
        if hit is not None and float(hit.t) < reach * (1.0 - 1e-6):
            found.note(
                "crossing missed", f"at {float(hit.t)!r} of a flight of {reach!r}, speed {float(hit.speed):.2e}",
                number, params,
            )  # fmt: skip


def _recheck_orbit(found: Findings, number: int, params: Params, osc: Oscillator, start: Array) -> None:
    """Compare section states; deviations in units of eps, state size and the largest norm of a partial Jacobian."""
    rate = max(float(model(params).free.rate), float(frequencies(params)[1]))
    periods = min(ORBIT_PERIODS, int(ORBIT_COST / (rate * osc.period)))
    weights = np.column_stack([np.sqrt(osc.gap.metric), np.ones(len(osc.gap.metric))])
    forced = float(np.linalg.norm(np.array(osc.swing) * weights))
    motion = motion_from(osc, start)
    states, norms, scales = [], [], []
    partial: list[Array] = []
    for _ in range(periods):
        _, jacobian = map_with_jacobian(osc, motion.h, int(motion.contact[0]), 1, False)
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
        found.checked["orbits too costly in multiprecision, or not comparable"] += 1
        return
    try:
        true = simulate(params, len(states), digits=30)
    except ArithmeticError:
        found.checked["orbits too costly in multiprecision, or not comparable"] += 1
        return
    kind = "sticking" if true.stuck else "free"
    found.checked[f"orbits compared, {kind}"] += 1
    found.sample("periods compared", float(len(states)))
    to_blocks = np.array(osc.to_blocks)
    worst = 0.0
    for k, state in enumerate(states):
        with mp.workdps(30):
            away = np.array([float(mp.mpf(a) - b) for a, b in zip(state.tolist(), true.sections[k + 1], strict=True)])
        size = float(np.linalg.norm(weights * (to_blocks @ away).reshape(-1, 2)))
        worst = max(worst, size / (EPS * max(scales[: k + 1]) * norms[k]))
    found.sample(f"deviation, {kind}", worst)
    found.sample(f"deviation per radian, {kind}", worst / (1.0 + rate * osc.period))
    found.record(f"deviation, {kind}", worst, number, params)
    if worst > DIFFERS * (1.0 + rate * osc.period):
        found.note(f"orbit differs, {kind}", f"{worst:.2e} eps |J|, |J| = {norms[-1]:.1e}", number, params)
