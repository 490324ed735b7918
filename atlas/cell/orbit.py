"""One cell's motion in detail: its path from impact to impact, its section, its exponents as they converge."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.spec.resolved import digest_of
from atlas.spec.spec import checked_parameters, given_settings
from atlas.spec.system import checked_system, impacts_of
from atlas.text import plural
from workers import Settings
from workers.model.oscillator import one_of
from workers.model.system import DEFAULT, System, identity
from workers.results import (
    CHAOTIC,
    CYCLE_PERIOD,
    LOCKING,
    NO_IMPACT,
    PER_TIME,
    PERIODIC,
    QUASIPERIODIC,
    REASON,
    REGIME,
    in_words,
)

Array = NDArray[np.float64]

SAMPLES, OF_HARMONIC = 400, 50
"""Points of the path per forcing period, and at least per period of the fastest harmonic of the force."""
OPEN_PATH = 40
"""Forcing periods of the path of a motion that does not close; a closed one is shown once around."""
LONGEST_PATH = 200
"""The most such periods of a torus, whose path is to show its modulation."""
SECTION_STATES = 4000
"""Section states of a motion that does not close."""
CONVERGENCE = (8000, 1000, 100, 10)
"""Forcing periods over which exponents are averaged: as many as in Li & Tan (2011), or fewer where they cost much."""
_RECORD = 4096


@dataclass(frozen=True)
class CellOrbit:
    """The motion of one cell on its attractor.

    settings    how it was solved
    cell        every result of solve_tile, by name; ``regime`` is a code
    period      forcing period T; without a force that of the cycle, or a natural one where there is no cycle
    stops       gap coordinate at the lower and at the upper stop; infinite where there is none
    times       (N,)     time since a section, along the path; twice where an impact makes a velocity jump
    states      (N, 2n)  physical states along the path (displacements, then velocities)
    impacts     (K, 3)   time, side (+1 upper, -1 lower) and speed before it, of every impact on the path;
                         speed 0 where a rest begins, see ``workers.trace``
    section     (S, 2n)  section states, t = k T
    running     (P, 2n)  means of the exponents per period over the first 1, 2, ... periods on the attractor
    """

    system: System
    parameters: Mapping[str, float]
    settings: Settings
    cell: Mapping[str, Any]
    period: float
    stops: tuple[float, float]
    times: Array
    states: Array
    impacts: Array
    section: Array
    running: Array

    @property
    def unit(self) -> float:
        """The time that pictures count in: a forcing period, or 1 without a force."""
        return 1.0 if self.system.definition.unforced else self.period

    @property
    def cycle(self) -> float | None:
        """The period of a cycle without a force; None for other motions."""
        value = float(self.cell.get(CYCLE_PERIOD.name, math.nan))
        return value if math.isfinite(value) else None

    @property
    def exact(self) -> bool:
        """Whether the exponents are exact, as those of an orbit, and not averages."""
        return int(self.cell[REGIME.name]) in (NO_IMPACT, PERIODIC, LOCKING)

    @cached_property
    def gap_row(self) -> Array:
        """The row g of the gap coordinate y = g . x, (n,)."""
        return np.array(self.system.build(self.parameters).gap_row)

    def gap(self, states: Array) -> Array:
        """The gap coordinate (N,) of states (N, 2n)."""
        return np.asarray(states[:, : self.gap_row.size] @ self.gap_row)

    @property
    def decided_by(self) -> dict[str, Any]:
        """All that decides these numbers, as a spec without axes: the system, the parameters, the settings."""
        others = {"parameters": dict(self.parameters), "axes": [], "solve": asdict(self.settings)}
        return identity(self.system.resolved()) | others

    @property
    def digest(self) -> str:
        """Digest of all that decides these numbers, made as a spec's."""
        return digest_of(self.decided_by)


def cell_orbit(
    given: Mapping[str, Any],
    system: str | Mapping[str, Any] | System = DEFAULT,
    settings: Settings | None = None,
) -> CellOrbit:
    """The orbit of one cell; ``given`` are the parameters that differ from the defaults.

    All exponents and the section are computed whatever ``settings`` say of them; a section with fewer samples than
    the orbit needs is filled up. Raises InputError for parameters that do not exist or are out of range, and for a
    cell without a motion to show: invalid, failed, or given up for its cost.
    """
    from workers.tile import solve_tile

    record = checked_system(system)
    parameters = checked_parameters(record, given)
    settings = given_settings(settings)
    samples = max(SECTION_STATES, settings.section_samples)
    asked = replace(settings, exponents="spectrum", section_samples=samples)
    cell: dict[str, Any] = {name: array[()] for name, array in solve_tile(record, parameters, asked).items()}
    start = cell["state"]
    if not np.all(np.isfinite(start)):
        reason = in_words(cell).get(REASON.name, "its state is not known")
        raise InputError(f"this cell has no motion to show: {reason}")
    here = parameters | dict(zip(record.states, map(float, start), strict=True))
    cycle, closes = None, int(cell["period"])
    section = cell["section"][np.isfinite(cell["section"]).all(axis=-1)]
    section = section[-closes:] if closes else section
    if record.definition.unforced:
        closes = min(closes, 1)  # one period, that of the cycle
        cycle = float(cell[CYCLE_PERIOD.name]) if np.isfinite(cell[CYCLE_PERIOD.name]) else None
    running = _running(record, here, asked, cycle)
    osc = one_of(record.build_many(_given(record, parameters, cycle))[0], 0)
    gap = section[:, : osc.gap_row.size] @ osc.gap_row
    long = math.ceil(2.0 * modulation(gap)) if int(cell[REGIME.name]) == QUASIPERIODIC else 0
    times, states, impacts = path_of(record, here, closes or min(max(OPEN_PATH, long), LONGEST_PATH), cycle)
    return CellOrbit(
        system=record,
        parameters=parameters,
        settings=asked,
        cell=cell,
        period=osc.period,
        stops=(osc.lower, osc.upper),
        times=times,
        states=states,
        impacts=impacts,
        section=section,
        running=running,
    )


def modulation(section: Array) -> float:
    """Forcing periods after which a torus comes back to nearly the same state, from section values (S,).

    1 / |f - p / q| with f the strongest frequency of the section per forcing period and p / q the fraction nearest to
    it with q at most 6: at f = 1/3 + 0.01 the state after three periods is nearly the same, and has drifted once
    around after a hundred. 1 where the section does not move.
    """
    x = section - section.mean()
    if x.size < 8 or np.ptp(x) == 0.0:
        return 1.0
    power = np.abs(np.fft.rfft(x * np.hanning(x.size), 8 * x.size))
    f = float(np.argmax(power)) / (8 * x.size)
    drifts = [abs(f - round(q * f) / q) for q in range(1, 7)]
    return 1.0 / max(min(drifts), 1.0 / x.size)


def samples_of(system: System) -> int:
    """Points of a path per forcing period."""
    return max(SAMPLES, OF_HARMONIC * system.definition.highest)


def _given(system: System, parameters: Mapping[str, float], cycle: float | None) -> dict[str, Array]:
    """Parameters as arrays of one machine, which is followed over cycles of this length if it has no force."""
    return system.with_cycle({name: np.array([value]) for name, value in parameters.items()}, cycle)


def _running(system: System, parameters: Mapping[str, float], settings: Settings, cycle: float | None) -> Array:
    """Running means of the exponents, over as many periods as can be afforded."""
    from workers import trace

    reason = ""
    for periods in CONVERGENCE:
        try:
            return trace(system, parameters, periods, settings, cycle).exponents
        except ValueError as error:
            reason = str(error)
    raise InputError(f"this cell cannot be followed: {reason}")


def path_of(
    system: System, parameters: Mapping[str, float], periods: int, cycle: float | None
) -> tuple[Array, Array, Array]:
    """Times, states and impacts from the parameters' initial state on, by the solver's own motion in short pieces."""
    from workers.kernel.coordinates import blocks_to_physical, motion_from
    from workers.kernel.motion import RECORDED, RUNNING, STATUS, WORK, WORK_OF_A_TRIAL
    from workers.kernel.period import propagate

    if system.has_modes:
        return _path_through_modes(system, parameters, periods, cycle)
    osc = system.build(parameters)
    start = np.array([parameters[name] for name in system.states])
    motion = motion_from(osc, start, record=_RECORD)
    times, states, impacts = [0.0], [start], []
    samples = samples_of(system)
    piece = osc.period / samples
    for i in range(periods * samples):
        # A piece of a period is a short motion from a section at another phase of the force.
        begins = osc._replace(tau=osc.tau + (i % samples) * piece * osc.gap.omega)
        ends = osc._replace(tau=osc.tau + (i % samples + 1) * piece * osc.gap.omega)
        motion.tally[RECORDED], motion.tally[WORK] = 0.0, WORK_OF_A_TRIAL
        propagate(begins, motion, piece)
        if motion.tally[STATUS] != RUNNING:
            raise InputError(f"period {i // samples}: this cell cannot be followed")
        found = motion.impacts[: int(motion.tally[RECORDED])].copy()
        before, after = states[-1], blocks_to_physical(ends, motion)
        for t, side, speed in found[found[:, 2] > 0.0]:
            mean = before + (after - before) * t / piece
            for velocity in (side * speed, -osc.R * side * speed):
                times.append(i * piece + t)
                states.append(_at_stop(osc, mean, side, velocity))
        found[:, 0] += i * piece
        impacts.append(found)
        times.append((i + 1) * piece)
        states.append(after)
    return np.array(times), np.array(states), np.concatenate(impacts)


def _path_through_modes(
    system: System, parameters: Mapping[str, float], periods: int, cycle: float | None
) -> tuple[Array, Array, Array]:
    """The same of a machine whose law changes."""
    from workers.history import trace, within_periods

    followed = trace(system, parameters, periods, cycle=cycle)
    oscillators, _ = system.build_many(_given(system, parameters, cycle))
    samples = samples_of(system)
    since = oscillators.period[0] / samples * np.arange(1.0, samples + 1.0)
    states = within_periods(oscillators, followed.states[:-1], since)
    times = followed.times[:-1, None] + since
    states = np.concatenate([followed.states[:1], states.reshape(-1, states.shape[-1])])
    return np.concatenate([followed.times[:1], times.ravel()]), states, followed.impacts


def _at_stop(osc: Any, state: Array, side: float, velocity: float) -> Array:
    """The state with its gap coordinate on a stop and moving with this velocity, all else as it is."""
    row = np.array(osc.gap_row)
    n = row.size
    stop = osc.upper if side > 0 else osc.lower
    # What an impact changes the velocities along.
    kick = (np.array(osc.to_physical) @ np.array(osc.gap.kick).ravel())[n:]
    on_stop = state.copy()
    on_stop[:n] += row / (row @ row) * (stop - row @ state[:n])
    on_stop[n:] += kick * (velocity - row @ state[n:])
    return on_stop


def describe(orbit: CellOrbit) -> str:
    """The motion in a few words: ``periodic, period 2, impacts 2 above and 3 below``, of one stop ``2 impacts``."""
    cell = orbit.cell
    code = int(cell[REGIME.name])
    words = [orbit.system.regime.meaning(code).text]
    if code == PERIODIC:
        n, p, q = (int(cell[name]) for name in ("period", "impacts_upper", "impacts_lower"))
        if orbit.cycle is not None:
            words.append(f"cycle of {orbit.cycle:.6g}")
        words += [f"period {n}"] if n > 1 or not orbit.system.definition.unforced else []
        if len(orbit.system.definition.contacts) > 1:
            words.append(f"contacts {impacts_of(orbit.system, cell)}")
        elif p >= 0:
            one_stop = not np.all(np.isfinite(orbit.stops))
            words.append(plural(p + q, "impact") if one_stop else f"impacts {p} above and {q} below")
        words += ["symmetric"] if cell["symmetric"] else []
    elif np.isfinite(cell["impacts_per_period"]) and cell["impacts_per_period"] > 0:
        per = PER_TIME if orbit.system.definition.unforced else "per period"
        words.append(f"{cell['impacts_per_period']:.3g} impacts {per}")
    words += ["its period unknown"] if code == LOCKING else []
    if cell["sticks"]:
        how = "at rest on a stop" if np.isnan(cell["impacts_per_period"]) else "sticking"
        words.append(f"{how} {100 * cell['stuck_fraction']:.3g} % of the time")
    if code == CHAOTIC:
        words.append(f"largest exponent {cell['largest']:.3g} ± {cell['error']:.1g}")
    return ", ".join(words)
