"""The tables of result variables, of regimes (classes of motion) and of reasons for missing or uncertain results."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from workers.settings import Settings


@dataclass(frozen=True)
class CodeMeaning:
    """Meaning of an integer code in a result array.

    ``name`` stands in data and commands, ``text`` on pictures and pages.
    """

    code: int
    name: str
    text: str


(
    PENDING, NO_IMPACT, PERIODIC, QUASIPERIODIC, CHAOTIC, UNDETERMINED, INVALID, FAILED, APERIODIC, LOCKING, REGULAR,
) = range(-1, 10)  # fmt: skip

REGIMES = tuple(CodeMeaning(code, name, name.replace("_", " ")) for code, name in enumerate((
    "pending", "no_impact", "periodic", "quasiperiodic", "chaotic", "undetermined", "invalid", "failed", "aperiodic",
    "locking", "regular",
), PENDING))  # fmt: skip
"""Classes of motion."""


@dataclass(frozen=True)
class Reason(CodeMeaning):
    """A reason why a cell has no result, or an uncertain one.

    ``text`` is a sentence, and ``regime`` the code of the regime of the cells with this reason.
    """

    regime: int


(
    NO_REASON, GAVE_UP, NOT_FINITE, ARITHMETIC, COSTLY_PERIOD, WORK_SPENT,
    BEYOND_STOP, OUT_OF_RANGE, NO_OSCILLATOR, RESONANCE, LONG_PERIOD, RIGID_MODE, COUPLED_DAMPING,
    OUT_OF_DOUBLES, ENERGY_OUT_OF_DOUBLES, NOT_RELAXED, NOT_STATIONARY, UNSTABLE, RESTED,
    MANY_MODES, NO_MODE, ENDLESS_EVENTS, TWO_IMPACTS, RUNS_AWAY, PERIODS_SPENT, NEVER_RECURS, CENTRE,
    FREE_PHASE, AT_EQUILIBRIUM, CONSERVATIVE, DIES_AWAY, FLIES_OFF,
) = range(32)  # fmt: skip

REASONS = tuple(Reason(code, name, text, regime) for code, (name, regime, text) in enumerate((
    ("none", PENDING, ""),
    ("gave_up", FAILED, "the time of the next impact could not be found"),
    ("not_finite", FAILED, "the state is no longer finite"),
    ("arithmetic", FAILED, "a calculation met an overflow, a zero divisor or a singular matrix"),
    ("costly_period", UNDETERMINED, "one forcing period takes more than a million evaluations of the motion"),
    ("work_spent", UNDETERMINED, "its budget of evaluations of the motion is spent"),
    ("beyond_stop", INVALID, "the initial state lies beyond a stop"),
    ("out_of_range", INVALID, "a parameter lies outside its valid range"),
    ("no_oscillator", INVALID, "the parameters make no oscillator"),
    ("resonance", INVALID, "undamped resonance: no periodic forced response exists, or none that doubles resolve"),
    ("long_period", INVALID, "a forcing period spans too many radians of a free oscillation"),
    ("rigid_mode", INVALID, "masses can drift freely without changing the gap, or in more than one way"),
    ("coupled_damping", INVALID, "two modes, coupled by damping or stiffness, that doubles cannot tell apart"),
    ("out_of_doubles", INVALID, "the parameters lead beyond the range of double precision"),
    ("energy_out_of_doubles", INVALID, "the energy of the motion is beyond the range of double precision"),
    ("not_relaxed", CHAOTIC, "the budget ended early: the exponent may still depend on the initial state"),
    ("not_stationary", CHAOTIC,
     "the last two averages of the exponent still differed when the budget ended; the error bar covers both"),
    ("unstable", INVALID,
     "motion grows that no contact or friction sees, so that nothing can hold it"),
    ("rested", LOCKING,
     "the motion after a rest repeats, but rounding grows too far from rest to rest to tell its period"),
    ("many_modes", FAILED, "the motion goes through more modes than there is room for"),
    ("no_mode", FAILED, "contacts and friction hold it in a way for which there is no motion in closed form"),
    ("endless_events", FAILED, "contacts and friction change without end at one time"),
    ("two_impacts", FAILED, "a rigid contact is struck while another one is held: the outcome is not defined"),
    ("runs_away", FAILED, "motion grows without bound: damping, friction and contacts do not stop it"),
    ("periods_spent", UNDETERMINED, "its budget of forcing periods is spent before its class is certain"),
    ("never_recurs", UNDETERMINED, "its energy still rises or falls when its budget ends: it has not come back"),
    ("centre", UNDETERMINED,
     "it swings about a centre without damping: one motion of a continuum, none of which attracts"),
    ("free_phase", UNDETERMINED,
     "it repeats, but a multiplier is 1 within its error: neighbours repeat too, and none is known to attract"),
    ("at_equilibrium", UNDETERMINED,
     "it stands in an equilibrium that is not known to attract motion nearby: move the initial state off it"),
    ("conservative", UNDETERMINED,
     "nothing in the machine loses energy, and its budget ends before its motion is clearly regular or chaotic"),
    ("dies_away", UNDETERMINED, "nothing drives it: its motion dies away, but is not at rest when its budget ends"),
    ("flies_off", UNDETERMINED, "it moves off at a constant speed, with no stop ahead: it never comes back"),
)))  # fmt: skip
"""All reasons by code. Codes are stored: new reasons are appended, and a code never changes its meaning."""


class InvalidError(ValueError):
    """Error for parameters or an initial state without a motion; ``reason`` is the code of the reason."""

    def __init__(self, reason: int) -> None:
        super().__init__(REASONS[reason].text)
        self.reason = reason


SOLVED = frozenset(regime.code for regime in REGIMES) - {PENDING}
OF_MOTIONS = frozenset({NO_IMPACT, PERIODIC, QUASIPERIODIC, CHAOTIC, LOCKING, REGULAR})
"""Codes of the regimes whose cells have exponents. SOLVED has the codes of all regimes except pending."""


@dataclass(frozen=True)
class Variable:
    """A result variable: name, type and meaning of an array with one entry for each cell.

    name              name in the store
    dtype             numpy type
    fill              value of a cell without a result
    long_name, units  CF attributes
    extra_dims        dimensions after the dimensions of the cells: "attractor" (number of attractors kept), "exponent"
                      (2n), "state" (2n), "sample" (section_samples)
    sparse            True if most blocks of cells have only the fill value; such blocks are not stored
    label             short words for tables and lists; empty if the name suffices
    regimes           codes of the regimes in which cells have this result
    allows_infinite   True if a negative value stands for infinitely many, at rest on a stop
    codes             meanings of the values, if the values are codes
    """

    name: str
    dtype: str
    fill: float | int | bool
    long_name: str
    units: str = "1"
    extra_dims: tuple[str, ...] = ()
    sparse: bool = False
    label: str = ""
    regimes: frozenset[int] = SOLVED
    allows_infinite: bool = False
    codes: tuple[CodeMeaning, ...] = ()

    @property
    def words(self) -> str:
        """The label of the variable, or its name with spaces if it has no label."""
        return self.label or self.name.replace("_", " ")

    def meaning(self, code: int) -> CodeMeaning:
        """Return the meaning of a code that occurs among the values of this variable."""
        return next(meaning for meaning in self.codes if meaning.code == code)

    def code_of(self, name: str) -> int:
        """Return the code of this variable whose meaning has the name ``name``."""
        return next(meaning.code for meaning in self.codes if meaning.name == name)


PER_PERIOD = "per forcing period"
"""Ending of ``long_name`` for quantities per forcing period. Their unit is 1, since a period has no unit."""
PER_TIME = "per unit time"
"""Ending of ``long_name`` for quantities per unit time, as for all rates of a machine without a force."""
ATTRACTOR = "attractor"
"""Dimension along the attractors of a cell; the attractor with the largest share comes first."""


def _number(name: str, long_name: str, *extra: str, label: str = "", regimes: frozenset[int] = SOLVED) -> Variable:
    return Variable(name, "float64", float("nan"), long_name, extra_dims=extra, label=label, regimes=regimes)


def _count(name: str, long_name: str, *extra: str, fill: int = 0, label: str = "") -> Variable:
    return Variable(name, "int32", fill, long_name, extra_dims=extra, label=label)


def count_of_orbit(name: str, long_name: str, label: str = "", endless: bool = True) -> Variable:
    """Return the Variable of a count along a periodic orbit, which only periodic cells have.

    name, long_name, label  see Variable
    endless                 True if the count may be infinite, as the number of impacts may
    """
    return Variable(name, "int32", 0, long_name, label=label, regimes=frozenset({PERIODIC}), allows_infinite=endless)


def _flag(name: str, long_name: str, *extra: str, label: str = "") -> Variable:
    return Variable(name, "bool", False, long_name, extra_dims=extra, label=label)


LARGEST = _number("largest", f"largest Lyapunov exponent {PER_PERIOD}", label="largest exponent", regimes=OF_MOTIONS)
ERROR = _number("error", f"error of the largest Lyapunov exponent {PER_PERIOD}", regimes=OF_MOTIONS)
SPECTRUM = _number("spectrum", f"Lyapunov exponents {PER_PERIOD}, largest first", "exponent")
AVERAGE = _number("average", f"mean growth of tangent vectors {PER_PERIOD} over the schedule")
_ALL_AVERAGES = replace(AVERAGE, long_name=f"{AVERAGE.long_name}, largest first", extra_dims=("exponent",))
KAPLAN_YORKE = _number(
    "kaplan_yorke", "Kaplan-Yorke dimension of the attractor of the stroboscopic map", label="Kaplan–Yorke dimension"
)
SUM_LAW_DEFECT = _number(
    "sum_law_defect", f"sum of the exponents minus its exact value, {PER_PERIOD}", label="defect of the sum"
)
DRIFT_PER_PERIOD = _number("drift_per_period", f"mean advance of what drifts {PER_PERIOD}")
SECTION = _number("section", "last section states", "sample", "state")
CYCLE_PERIOD = _number("cycle_period", "time that a cycle takes; NaN unless the motion repeats")
ENERGY_ERROR = _number(
    "energy_error", "change of the energy of a machine that loses nothing, as a share of it; NaN for other machines"
)
PERIOD = count_of_orbit("period", "forcing periods per orbit; 0 unless periodic or without impact", endless=False)
_ALWAYS = (
    PERIOD,
    count_of_orbit(
        "impacts_upper", "impacts at the upper stop per orbit period; -1 where it rests on a stop", "impacts above"
    ),
    count_of_orbit(
        "impacts_lower", "impacts at the lower stop per orbit period; -1 where it rests on a stop", "impacts below"
    ),
    _number("impacts_per_period", f"mean number of impacts {PER_PERIOD}"),
    _flag("symmetric", "orbit is symmetric under (x, t) -> (-x, t + T/2); false unless known"),
    _flag("sticks", "the mass rests on a stop for part of the time; false unless known", label="rests on a stop"),
    _number("stuck_fraction", "share of the time at rest on a stop", label="share of time at rest"),
    _number(
        "min_impact_speed", "slowest impact seen on the attractor; 0 where it rests on a stop", label="slowest impact"
    ),
    _number("mean_impact_speed", "mean speed before an impact; NaN where it rests on a stop"),
    _number("max_impact_speed", "fastest impact seen on the attractor", label="fastest impact"),
    _number("impact_energy", f"energy lost at impacts {PER_PERIOD}", label="energy lost per period"),
    _number(
        "peak_to_peak", "peak to peak of the gap coordinate; outside orbits over 64 periods, unless both stops are hit"
    ),
    _count("periods_used", "forcing periods simulated", label="periods simulated"),
    _count("survived", "forcing periods seen chaotic, or aperiodic, after the transient", label="periods seen chaotic"),
    _number("state", "physical section state on the attractor", "state"),
)
REASON = Variable(
    "reason", "int8", NO_REASON, "why the cell is invalid, failed, given up or uncertain", sparse=True, codes=REASONS
)
REGIME = Variable("regime", "int8", PENDING, "regime of motion", codes=REGIMES)
_COEXISTENCE = (
    _count("attractors", "attractors found"),
    _count("starts", "initial states solved, those beyond a stop left out"),
    _count("own_attractor", "attractor that the spec's own initial state reaches; -1 if none is kept", fill=-1),
    _count("undecided", "initial states whose attractor is not known"),
    _count("starts_unstored", "initial states on attractors that are not kept"),
    _number("unseen_share", "share of an attractor that 5 % of such cells miss"),
    _number("share", "share of the initial states that reach the attractor", ATTRACTOR),
    _number("share_error", "standard error of the share, of Wilson's interval", ATTRACTOR),
    _number("share_low", "lower end of the 95 % Wilson interval of the share", ATTRACTOR),
    _number("share_high", "upper end of the 95 % Wilson interval of the share", ATTRACTOR),
    _count(
        "mirror", "attractor that is its mirror image; itself where it is symmetric; -1 if none", ATTRACTOR, fill=-1
    ),
    _flag("exact", "initial states are assigned exactly, by orbits, not by statistics", ATTRACTOR),
    _count("starts_by_statistics", "initial states assigned to it by statistics", ATTRACTOR),
    _number("statistical_distance", "largest distance of these initial states from it, in standard errors", ATTRACTOR),
)
UNKNOWN_LABEL, BEYOND_TABLE = -1, -2
LABEL = _count("label", "attractor that the initial state reaches; -1 if not known", fill=UNKNOWN_LABEL)
SETTLED = _count("settled", "forcing periods until the motion is on the attractor")


_BY_NAME = {
    variable.name: variable
    for variable in (
        LARGEST, ERROR, AVERAGE, SPECTRUM, SUM_LAW_DEFECT, KAPLAN_YORKE, SECTION, DRIFT_PER_PERIOD, ENERGY_ERROR,
        *_ALWAYS, *_COEXISTENCE, LABEL, SETTLED, REASON, REGIME,
    )
}  # fmt: skip


def result_named(name: str) -> Variable:
    """Return the result variable of this name, or that of a plain float64 number if the name is not known."""
    return _BY_NAME.get(name) or _number(name, name)


def in_words(values: Mapping[str, Any]) -> dict[str, str]:
    """Return the regime and the reason of a cell as texts, by the names of the variables ``regime`` and ``reason``.

    ``values`` has the codes of the cell by the same names. The regime becomes its name, the reason its sentence. A cell
    without a reason has no entry for it.
    """
    reason = int(values.get(REASON.name, NO_REASON))
    why = {REASON.name: REASONS[reason].text} if reason != NO_REASON else {}
    return {REGIME.name: REGIME.meaning(int(values[REGIME.name])).name} | why


def result_variables(
    settings: Settings, attractors: bool = False, basins: bool = False, own_variables: tuple[Variable, ...] = ()
) -> tuple[Variable, ...]:
    """Return the variables of a solution with these settings; ``regime`` comes last, since it is written last.

    settings       see Settings
    attractors     True if each cell lists all its attractors: every result except ``periods_used`` has the dimension
                   ``attractor``
    basins         True if each cell is an initial state and has the label of the attractor that the state reaches
    own_variables  variables that only this machine has, see ``model.measures``
    """
    variables = [LABEL, SETTLED] if basins else []
    if settings.exponents != "none":
        variables += [LARGEST, ERROR]
        if settings.method == "fixed":
            variables.append(AVERAGE if settings.exponents == "largest" else _ALL_AVERAGES)
    if settings.exponents == "spectrum":
        variables += [SPECTRUM, SUM_LAW_DEFECT, KAPLAN_YORKE]
    variables += _ALWAYS
    if settings.section_samples:
        variables.append(SECTION)
    variables += own_variables
    variables += [REASON, REGIME]
    if basins or not attractors:
        return tuple(variables)
    of_each = [v if v.name == "periods_used" else replace(v, extra_dims=(ATTRACTOR, *v.extra_dims)) for v in variables]
    return (*_COEXISTENCE, *of_each)


_IN_TIME = {
    "period": "passages of its rarest event in a cycle; 0 unless periodic or at rest",
    "kaplan_yorke": "Kaplan-Yorke dimension of the attractor",
    "symmetric": "cycle is symmetric under (x, t) -> (-x, t + T/2), T its period; false unless known",
    "periods_used": "natural periods simulated, of the slowest undamped mode",
    "settled": "natural periods until the motion is on the attractor",
    "survived": "natural periods seen chaotic, or aperiodic, after the transient",
    "energy_loss": "energy lost in a cycle, or in a natural period of other motion",
}
"""Meanings of results that differ for a machine without a force, by name."""


def in_time(variable: Variable) -> Variable:
    """Return the variable as it is for a machine without a force: rates per unit time in place of per forcing period.

    In such a machine motion without impact is at rest, or slides for ever. The regime ``no_impact`` is therefore called
    equilibrium.
    """
    meaning = variable.long_name.replace(PER_PERIOD, PER_TIME)
    still = variable.name == REGIME.name
    codes = tuple(replace(c, text="equilibrium") if still and c.code == NO_IMPACT else c for c in variable.codes)
    return replace(variable, long_name=_IN_TIME.get(variable.name, meaning), codes=codes)


_STICKING = {
    True: {
        "sticks": ("the mass rests on a stop or sticks for part of the time; false unless known", "rests or sticks"),
        "stuck_fraction": ("share of the time at rest on a stop or sticking", "share of time at rest"),
    },
    False: {
        "sticks": ("friction sticks for part of the time; false unless known", "sticks"),
        "stuck_fraction": ("share of the time that friction sticks", "share of time sticking"),
    },
}
"""Meanings and labels of results of a machine with friction, by name; the key is True if it has a rigid stop."""


def of_friction(variable: Variable, stops: bool) -> Variable:
    """Return the variable with its meaning and label for a machine with friction, which may stick.

    ``stops`` is True if the machine has a rigid stop.
    """
    meaning, label = _STICKING[stops].get(variable.name, (variable.long_name, variable.label))
    return replace(variable, long_name=meaning, label=label)


def of_one(variable: Variable) -> Variable:
    """Return the variable without its dimension ``attractor``, for a cell with a single attractor."""
    return replace(variable, extra_dims=tuple(dim for dim in variable.extra_dims if dim != ATTRACTOR))


def leading(variables: tuple[Variable, ...], arrays: Mapping[str, Any], dims: int) -> dict[str, Any]:
    """Return the arrays reduced to the first attractor of each cell, as views.

    variables  result variables
    arrays     arrays by name, whose first ``dims`` axes are those of the cells
    """
    many = {variable.name for variable in variables if ATTRACTOR in variable.extra_dims}
    first = (slice(None),) * dims + (0,)
    return {name: values[first] if name in many else values for name, values in arrays.items()}


def reason_counts(codes: np.ndarray) -> dict[str, int]:
    """Return the number of cells with each reason, by the sentence of the reason; ``codes`` are the cells' reasons.

    Cells without a reason are left out.
    """
    present, counts = np.unique(codes[codes != NO_REASON], return_counts=True)
    return {REASONS[code].text: count for code, count in zip(present.tolist(), counts.tolist(), strict=True)}


def empty_results(
    variables: tuple[Variable, ...], shape: tuple[int, ...], sizes: dict[str, int]
) -> dict[str, np.ndarray]:
    """Return an array for each variable, filled with the value that stands for no result.

    ``shape`` is the shape of the cells. ``sizes`` has the length of each further dimension by name.
    """
    return {
        v.name: np.full(shape + tuple(sizes[dim] for dim in v.extra_dims), v.fill, dtype=v.dtype) for v in variables
    }
