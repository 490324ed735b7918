"""The motion of one cell in detail: its path through all impacts, its section states, and its exponents as they
converge.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.formatting import plural
from atlas.spec.resolved import digest_of
from atlas.spec.spec import given_settings, validate_parameters
from atlas.spec.system import impacts_of, parse_system
from workers import Settings
from workers.model.oscillator import take_one
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
    REGULAR,
    in_words,
)

Array = NDArray[np.float64]

SAMPLES, OF_HARMONIC = 400, 50
"""Number of points of the path per forcing period, and minimum number per period of the force's fastest harmonic."""
HISTORY_SAMPLES = 100
"""Default number of instants per period in the table of a time history."""
OPEN_PATH = 40
"""Number of forcing periods of the path of a motion that does not close; a closed path covers one period of the
orbit.
"""
MAX_PATH_PERIODS = 200
"""Maximum number of forcing periods of a torus's path, which should be long enough to show the modulation."""
SECTION_STATES = 4000
"""Number of section states, one per forcing period, that are stored of a motion that does not close."""
CONVERGENCE = (8000, 1000, 100, 10)
"""Numbers of forcing periods over which exponents may be averaged to show how they converge.

The first is that of Li & Tan (2011); a smaller one is used if the averages cost too much.
"""


@dataclass(frozen=True)
class CellTrajectory:
    """The motion of one cell on its attractor.

    system      the system
    parameters  all parameters of the cell
    settings    settings by which the cell was solved
    cell        every result of solve_tile, by name; ``regime`` is a code
    period      forcing period T; without a force that of the cycle, or a natural one if there is no cycle
    stops       gap coordinate at the lower and at the upper stop; infinite if there is no stop
    times       (N,) time since a section, along the path; twice at an impact at which a velocity jumps
    states      (N, 2n) physical states along the path: displacements, then velocities
    impacts     (K, 3) time, side (+1 upper, -1 lower) and speed before the impact, of every impact on the path; speed 0
                if sticking begins there, see ``workers.trace``
    section     (S, 2n) section states, t = k T
    running     (P, 2n) means of the exponents per period over the first 1, 2, ... periods on the attractor
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
        """The unit of time in pictures: a forcing period, or 1 without a force."""
        return 1.0 if self.system.definition.unforced else self.period

    @property
    def cycle(self) -> float | None:
        """The period of a cycle without a force; None for other motions."""
        value = float(self.cell.get(CYCLE_PERIOD.name, math.nan))
        return value if math.isfinite(value) else None

    @property
    def has_exact_exponents(self) -> bool:
        """True if the exponents are exact, as those of a periodic orbit, and not averages."""
        return int(self.cell[REGIME.name]) in (NO_IMPACT, PERIODIC, LOCKING, REGULAR)

    @cached_property
    def gap_row(self) -> Array:
        """The coefficients g (n,) of the gap coordinate y = g . x, on which the stops act, in the displacements x."""
        return np.array(self.system.build(self.parameters).gap_row)

    def gap(self, states: Array) -> Array:
        """Return the gap coordinate (N,), on which the stops act, of states (N, 2n)."""
        return np.asarray(states[:, : self.gap_row.size] @ self.gap_row)

    @property
    def identity(self) -> dict[str, Any]:
        """All that determines the numbers of this motion: system, parameters and settings, in the form of a spec
        without axes.
        """
        others = {"parameters": dict(self.parameters), "axes": [], "solve": asdict(self.settings)}
        return identity(self.system.to_resolved()) | others

    @property
    def digest(self) -> str:
        """Digest of ``identity``, that is of all that determines the numbers of this motion."""
        return digest_of(self.identity)


def cell_orbit(
    overrides: Mapping[str, Any],
    system: str | Mapping[str, Any] | System = DEFAULT,
    settings: Settings | None = None,
) -> CellTrajectory:
    """Return the trajectory of one cell; ``overrides`` are the parameters that differ from the defaults.

    All exponents and the section are computed for any ``settings``, with as many samples as the orbit needs. Raise
    InputError for parameters that do not exist or are out of range. Raise it also for a cell without a motion to show:
    invalid, failed, or given up for its cost.
    """
    from workers.tile import solve_tile

    record = parse_system(system)
    parameters = validate_parameters(record, overrides)
    settings = given_settings(settings)
    samples = max(SECTION_STATES, settings.section_samples)
    full_settings = replace(settings, exponents="spectrum", section_samples=samples)
    cell: dict[str, Any] = {name: array[()] for name, array in solve_tile(record, parameters, full_settings).items()}
    start = cell["state"]
    if not np.all(np.isfinite(start)):
        reason = in_words(cell).get(REASON.name, "its state is not known")
        raise InputError(f"this cell has no motion to show: {reason}")
    values = parameters | dict(zip(record.states, map(float, start), strict=True))
    cycle, closes = None, int(cell["period"])
    section = cell["section"][np.isfinite(cell["section"]).all(axis=-1)]
    section = section[-closes:] if closes else section
    if record.definition.unforced:
        closes = min(closes, 1)  # one period, the period of the cycle
        cycle = float(cell[CYCLE_PERIOD.name]) if np.isfinite(cell[CYCLE_PERIOD.name]) else None
    running = _running(record, values, full_settings, cycle)
    machines = {name: np.array([value]) for name, value in parameters.items()}
    osc = take_one(record.build_many(record.with_cycle(machines, cycle))[0], 0)
    gap = section[:, : osc.gap_row.size] @ osc.gap_row
    winds = int(cell[REGIME.name]) in (QUASIPERIODIC, REGULAR) and not closes
    long = math.ceil(2.0 * modulation(gap)) if winds else 0
    times, states, impacts = path_of(record, values, closes or min(max(OPEN_PATH, long), MAX_PATH_PERIODS), cycle)
    return CellTrajectory(
        system=record,
        parameters=parameters,
        settings=full_settings,
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
    """Return the number of forcing periods after which a torus returns to nearly the same state.

    It is 1 / |f - p / q|. Here f is the strongest frequency of the section values (S,) per forcing period, and p / q
    the fraction nearest to f with q at most 6. At f = 1/3 + 0.01 the state after three periods is nearly the same, and
    has drifted once around after a hundred. Return 1 if the section does not move.
    """
    x = section - section.mean()
    if x.size < 8 or np.ptp(x) == 0.0:
        return 1.0
    power = np.abs(np.fft.rfft(x * np.hanning(x.size), 8 * x.size))
    f = float(np.argmax(power)) / (8 * x.size)
    drifts = [abs(f - round(q * f) / q) for q in range(1, 7)]
    return 1.0 / max(min(drifts), 1.0 / x.size)


def samples_of(system: System) -> int:
    """Return the number of points of a path per forcing period."""
    return max(SAMPLES, OF_HARMONIC * system.definition.highest)


def _running(system: System, parameters: Mapping[str, float], settings: Settings, cycle: float | None) -> Array:
    """Return running means (P, 2n) of the exponents over 1, 2, ... periods, for as many periods as are affordable.

    ``cycle`` is the period of a limit cycle, None for other motions.
    """
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
    """Return times, states and impacts of a motion over ``periods`` periods, in even steps of time.

    It begins at the initial state that the parameters give. ``cycle`` is the period of a limit cycle, None for other
    motions. Impacts on rigid stops have two more states each, with the velocities before and after the impact.
    """
    from atlas.cell.motion import CellMotion

    motion = CellMotion.follow(system, parameters, periods, cycle)
    impacts = motion.followed.impacts
    times = np.linspace(0.0, motion.followed.times[-1], periods * samples_of(system) + 1)
    before, after, rigid = motion.states_at_impacts(impacts)
    places = np.repeat(np.maximum(np.searchsorted(times, impacts[rigid, 0]), 1), 2)
    both = np.stack([before[rigid], after[rigid]], axis=1).reshape(-1, before.shape[1])
    states = np.insert(motion.states_at(times), places, both, axis=0)
    return np.insert(times, places, np.repeat(impacts[rigid, 0], 2)), states, impacts


def describe(orbit: CellTrajectory) -> str:
    """Return the motion as text: ``periodic, period 2, impacts 2 above and 3 below``; for one stop ``2 impacts``."""
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
    words += [f"repeats after {orbit.cycle:.6g}"] if code == REGULAR and orbit.cycle is not None else []
    if cell["sticks"]:
        how = "at rest on a stop" if np.isnan(cell["impacts_per_period"]) else "sticking"
        words.append(f"{how} {100 * cell['stuck_fraction']:.3g} % of the time")
    if code == CHAOTIC:
        words.append(f"largest exponent {cell['largest']:.3g} ± {cell['error']:.1g}")
    return ", ".join(words)
