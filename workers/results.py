"""What a cell's solution consists of: the one table of result variables and of regimes."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from workers.settings import Settings


@dataclass(frozen=True)
class Regime:
    """A class of motion: its code in the data, its name, and the colour that pictures give it."""

    code: int
    name: str
    color: str


PENDING, NO_IMPACT, PERIODIC, QUASIPERIODIC, CHAOTIC, UNDETERMINED, INVALID, FAILED, APERIODIC = range(-1, 8)

REGIMES = (
    Regime(PENDING, "pending", "#ffffff"),
    Regime(NO_IMPACT, "no_impact", "#dddddd"),
    Regime(PERIODIC, "periodic", "#4477aa"),
    Regime(QUASIPERIODIC, "quasiperiodic", "#228833"),
    Regime(CHAOTIC, "chaotic", "#cc3311"),
    Regime(UNDETERMINED, "undetermined", "#a3ff0d"),
    Regime(INVALID, "invalid", "#777777"),
    Regime(FAILED, "failed", "#000000"),
    Regime(APERIODIC, "aperiodic", "#f8f0d0"),
)


@dataclass(frozen=True)
class Reason:
    """Why a cell has no result, or an uncertain one: its code and its name in the data, its regime, and a sentence."""

    code: int
    name: str
    regime: int
    text: str


(
    NO_REASON, GAVE_UP, NOT_FINITE, ARITHMETIC, PROCESS_ENDED, COSTLY_PERIOD, WORK_SPENT,
    BEYOND_STOP, OUT_OF_RANGE, NO_OSCILLATOR, RESONANCE, LONG_PERIOD, RIGID_MODE, COUPLED_DAMPING,
    OUT_OF_DOUBLES, ENERGY_OUT_OF_DOUBLES, NOT_RELAXED, NOT_STATIONARY, UNSTABLE, RESTED,
) = range(20)  # fmt: skip

REASONS = (
    Reason(NO_REASON, "none", PENDING, ""),
    Reason(GAVE_UP, "gave_up", FAILED, "the time of the next impact could not be found"),
    Reason(NOT_FINITE, "not_finite", FAILED, "the state is no longer finite"),
    Reason(ARITHMETIC, "arithmetic", FAILED, "a calculation met an overflow, a zero divisor or a singular matrix"),
    Reason(PROCESS_ENDED, "process_ended", FAILED, "the process that solved its tile died"),
    Reason(
        COSTLY_PERIOD,
        "costly_period",
        UNDETERMINED,
        "one forcing period takes more than a million evaluations of the motion",
    ),
    Reason(WORK_SPENT, "work_spent", UNDETERMINED, "its budget of evaluations of the motion is spent"),
    Reason(BEYOND_STOP, "beyond_stop", INVALID, "the initial state lies beyond a stop"),
    Reason(OUT_OF_RANGE, "out_of_range", INVALID, "a parameter lies outside its valid range"),
    Reason(NO_OSCILLATOR, "no_oscillator", INVALID, "the parameters make no oscillator"),
    Reason(RESONANCE, "resonance", INVALID, "undamped resonance: no periodic forced response exists"),
    Reason(LONG_PERIOD, "long_period", INVALID, "a forcing period spans too many radians of a free oscillation"),
    Reason(
        RIGID_MODE, "rigid_mode", INVALID, "masses can drift freely without changing the gap, or in more than one way"
    ),
    Reason(
        COUPLED_DAMPING, "coupled_damping", INVALID, "damping couples two modes that double precision cannot tell apart"
    ),
    Reason(OUT_OF_DOUBLES, "out_of_doubles", INVALID, "the parameters lead beyond the range of double precision"),
    Reason(
        ENERGY_OUT_OF_DOUBLES,
        "energy_out_of_doubles",
        INVALID,
        "the energy of the motion is beyond the range of double precision",
    ),
    Reason(
        NOT_RELAXED,
        "not_relaxed",
        CHAOTIC,
        "the budget ended early: the exponent may still depend on the initial state",
    ),
    Reason(
        NOT_STATIONARY,
        "not_stationary",
        CHAOTIC,
        "the last two averages of the exponent still differed when the budget ended; the error bar covers both",
    ),
    Reason(UNSTABLE, "unstable", INVALID, "motion grows: stiffness or damping is negative in some direction"),
    Reason(RESTED, "rested", UNDETERMINED, "its one mass rests and repeats from there on; its period is not known"),
)
"""Codes are stored: a new reason goes to the end, and none is ever given another meaning."""


class InvalidError(ValueError):
    """Parameters that make no sense; ``reason`` is the code of why."""

    def __init__(self, reason: int) -> None:
        super().__init__(REASONS[reason].text)
        self.reason = reason


@dataclass(frozen=True)
class Variable:
    """One result array: name, numpy type, value of a cell without a result, CF long_name and units.

    ``extra`` names dimensions after the cell's own: "attractor" (how many are kept), "exponent" (2n), "state" (2n),
    "sample" (section_samples).
    ``sparse``: most tiles have nothing but fill values of it, and are stored without a chunk.
    """

    name: str
    dtype: str
    fill: float | int | bool
    long_name: str
    units: str
    extra: tuple[str, ...] = ()
    sparse: bool = False


_NAN = float("nan")
_PER_PERIOD = "1/period"

LARGEST = Variable("largest", "float64", _NAN, "largest Lyapunov exponent per forcing period", _PER_PERIOD)
ERROR = Variable("error", "float64", _NAN, "error of the largest Lyapunov exponent", _PER_PERIOD)
SPECTRUM = Variable(
    "spectrum", "float64", _NAN, "Lyapunov exponents per forcing period, largest first", _PER_PERIOD, ("exponent",)
)
AVERAGE = Variable(
    "average", "float64", _NAN, "mean growth of tangent vectors per forcing period over the schedule", _PER_PERIOD
)
_ALL_AVERAGES = replace(AVERAGE, long_name=f"{AVERAGE.long_name}, largest first", extra=("exponent",))
KAPLAN_YORKE = Variable(
    "kaplan_yorke", "float64", _NAN, "Kaplan-Yorke dimension of the attractor of the stroboscopic map", "1"
)
SUM_LAW_DEFECT = Variable("sum_law_defect", "float64", _NAN, "sum of the exponents minus its exact value", _PER_PERIOD)
SECTION = Variable("section", "float64", _NAN, "last section states", "1", ("sample", "state"))

_ALWAYS = (
    Variable("period", "int32", 0, "forcing periods per orbit; 0 unless periodic or without impact", "1"),
    Variable("impacts_upper", "int32", 0, "impacts at the upper stop per orbit period; -1 where it sticks", "1"),
    Variable("impacts_lower", "int32", 0, "impacts at the lower stop per orbit period; -1 where it sticks", "1"),
    Variable("impacts_per_period", "float64", _NAN, "mean number of impacts per forcing period", _PER_PERIOD),
    Variable("symmetric", "bool", False, "orbit is symmetric under (x, t) -> (-x, t + T/2); false unless known", "1"),
    Variable("sticks", "bool", False, "the mass rests on a stop for part of the time; false unless known", "1"),
    Variable("stuck_fraction", "float64", _NAN, "share of the time at rest on a stop", "1"),
    Variable("min_impact_speed", "float64", _NAN, "slowest impact seen on the attractor; 0 where it sticks", "1"),
    Variable("mean_impact_speed", "float64", _NAN, "mean speed before an impact; NaN where it sticks", "1"),
    Variable("max_impact_speed", "float64", _NAN, "fastest impact seen on the attractor", "1"),
    Variable("impact_energy", "float64", _NAN, "energy lost at impacts per forcing period", _PER_PERIOD),
    Variable(
        "peak_to_peak",
        "float64",
        _NAN,
        "peak to peak of the gap coordinate; outside orbits over 64 periods, unless both stops are hit",
        "1",
    ),
    Variable("periods_used", "int32", 0, "forcing periods simulated", "1"),
    Variable("survived", "int32", 0, "forcing periods seen chaotic, or aperiodic, after the transient", "1"),
    Variable("state", "float64", _NAN, "physical section state on the attractor", "1", ("state",)),
)
REASON = Variable(
    "reason", "int8", NO_REASON, "why the cell is invalid, failed, given up or uncertain", "1", sparse=True
)
REGIME = Variable("regime", "int8", PENDING, "regime of motion", "1")


ATTRACTOR = "attractor"
"""The dimension along the attractors of a cell, the one with the largest share first."""


def _of_each(name: str, dtype: str, fill: float | int | bool, long_name: str) -> Variable:
    return Variable(name, dtype, fill, long_name, "1", (ATTRACTOR,))


_COEXISTENCE = (
    Variable("attractors", "int32", 0, "attractors found", "1"),
    Variable("starts", "int32", 0, "initial states solved, those beyond a stop left out", "1"),
    Variable("own", "int32", -1, "attractor that the spec's own initial state reaches; -1 if none is kept", "1"),
    Variable("undecided", "int32", 0, "initial states whose attractor is not known", "1"),
    Variable("left", "int32", 0, "initial states on attractors that are not kept", "1"),
    Variable("unseen_share", "float64", _NAN, "share of an attractor that 5 % of such cells miss", "1"),
    _of_each("share", "float64", _NAN, "share of the initial states that reach the attractor"),
    _of_each("share_error", "float64", _NAN, "standard error of the share, of Wilson's interval"),
    _of_each("share_low", "float64", _NAN, "lower end of the 95 % Wilson interval of the share"),
    _of_each("share_high", "float64", _NAN, "upper end of the 95 % Wilson interval of the share"),
    _of_each("mirror", "int32", -1, "attractor that is its mirror image; itself where it is symmetric; -1 if none"),
    _of_each("exact", "bool", False, "initial states are told to reach it exactly, not by statistics"),
    _of_each("lumped", "int32", 0, "initial states put to it by statistics"),
    _of_each("lumped_distance", "float64", _NAN, "largest distance of those from it, in standard errors"),
)


UNKNOWN_LABEL, BEYOND_TABLE = -1, -2
LABEL = Variable("label", "int32", UNKNOWN_LABEL, "attractor that the initial state reaches; -1 if not known", "1")
SETTLED = Variable("settled", "int32", 0, "forcing periods until the motion is on the attractor", "1")


def result_variables(settings: Settings, attractors: bool = False, basins: bool = False) -> tuple[Variable, ...]:
    """The variables that a solution with these settings has; ``regime`` is the last, as it is the last written.

    With ``attractors`` those of all attractors of each cell: every result but the cost has the dimension ``attractor``.
    With ``basins`` those of initial states that are told by the attractors that they reach.
    """
    found = _of_one(settings)
    if basins:
        return (LABEL, SETTLED, *found)
    if not attractors:
        return found
    many = [v if v.name == "periods_used" else replace(v, extra=(ATTRACTOR, *v.extra)) for v in found]
    return (*_COEXISTENCE, *many)


def _of_one(settings: Settings) -> tuple[Variable, ...]:
    chosen: list[Variable] = []
    if settings.exponents != "none":
        chosen += [LARGEST, ERROR]
        if settings.method == "fixed":
            chosen.append(AVERAGE if settings.exponents == "largest" else _ALL_AVERAGES)
    if settings.exponents == "spectrum":
        chosen += [SPECTRUM, SUM_LAW_DEFECT, KAPLAN_YORKE]
    chosen += _ALWAYS
    if settings.section_samples:
        chosen.append(SECTION)
    return (*chosen, REASON, REGIME)


def of_one(variable: Variable) -> Variable:
    """The variable as it is of one attractor of a cell."""
    return replace(variable, extra=tuple(dim for dim in variable.extra if dim != ATTRACTOR))


def leading(variables: tuple[Variable, ...], arrays: Mapping[str, Any], dims: int) -> dict[str, Any]:
    """Arrays over cells of so many dimensions, those of all attractors as of the first: views, not copies."""
    many = {variable.name for variable in variables if ATTRACTOR in variable.extra}
    first = (slice(None),) * dims + (0,)
    return {name: values[first] if name in many else values for name, values in arrays.items()}


def reason_counts(codes: np.ndarray) -> dict[str, int]:
    """Cells by reason, each as its sentence, from an array of codes; those without a reason are left out."""
    found, counts = np.unique(codes[codes != NO_REASON], return_counts=True)
    return {REASONS[code].text: count for code, count in zip(found.tolist(), counts.tolist(), strict=True)}


def empty_results(
    variables: tuple[Variable, ...], shape: tuple[int, ...], sizes: dict[str, int]
) -> dict[str, np.ndarray]:
    """Arrays of the given cell shape, each filled with its variable's value for a cell without a result."""
    return {v.name: np.full(shape + tuple(sizes[dim] for dim in v.extra), v.fill, dtype=v.dtype) for v in variables}
