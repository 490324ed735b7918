"""Test functions at points of branches and curves, and events between two points as solutions of square systems."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.continuation.admissibility import AdmissibilityFault, Graze, first_fault, name_of_touch
from workers.continuation.extended_system import (
    ANGLE,
    CUSP,
    ENDS,
    GRAZE,
    MEETS,
    MINUS_ONE,
    ONSET,
    PAIR,
    SPEED,
    UNIT,
    Condition,
    ExtendedSystem,
    solve,
)
from workers.continuation.floquet import multipliers, pair_near
from workers.continuation.itinerary import Itinerary, Orbit
from workers.continuation.legs import ACT, SLOWS
from workers.continuation.orbit_equality import difference, is_minimal, reduce_orbit, reductions
from workers.continuation.pseudo_arclength import ContinuationStep
from workers.model.family import NoOscillatorError
from workers.model.oscillator import Array

Complex = NDArray[np.complex128]

FOLD, SYMMETRY_BREAKING, PERIOD_DOUBLING, NEIMARK_SACKER = (
    "fold", "symmetry_breaking", "period_doubling", "neimark_sacker",
)  # fmt: skip
GRAZING, IMPACT_LOST, CONTACT_LOST = "graze", "impact_lost", "contact_lost"
LOST = IMPACT_LOST, CONTACT_LOST
STICK_ONSET, STICK_END, GRAZING_SLIDING, EXCHANGE = "stick_onset", "stick_end", "grazing_sliding", "exchange"
"""Kinds of events with one condition."""

ANGLES = {1.0: "resonance_1_1", -1.0: "resonance_1_2", -0.5: "resonance_1_3", 0.0: "resonance_1_4"}
"""Names of the strong resonances by cos theta."""

NEAR_HALVES = 1e-2
"""Maximum difference of both halves of an orbit at which a stalled branch counts as meeting the orbit of half the turn.
The unit is radians of the force for times; speeds are relative."""

SURE = 1e-3
"""Distance of a multiplier from 1 or -1 within which it is the multiplier of a fold or of a doubling."""

TRIES = 4
"""Maximum number of halvings of a step that help to locate the zero of a test function."""


BORDERS = (GRAZE, SPEED, ONSET, ENDS, MEETS)
"""Conditions of events at which an orbit ceases to be admissible."""


class SolutionPoint(NamedTuple):
    """One orbit of a branch or curve.

    values       (free,) parameters
    orbit        the orbit
    contacts     (G,) times of its grazes
    multipliers  (2n,) multipliers of a turn, which is half of a symmetric orbit
    unstable     number of multipliers with a modulus above 1, without the multipliers that the event fixes
    """

    values: Array
    orbit: Orbit
    contacts: Array
    multipliers: Complex
    unstable: int


class TestFunction(NamedTuple):
    """The value of a test function, a number that changes sign at an event.

    sign        sign of the value
    log         logarithm of its modulus
    conditions  conditions of the event
    """

    sign: float
    log: float
    conditions: tuple[Condition, ...]


class MonitoredPoint(NamedTuple):
    """A solution point with its test functions.

    equations  extended system, bordered at the point
    point      the solution point
    functions  test functions by name
    fault      why the orbit is not admissible; None if it is
    """

    equations: ExtendedSystem
    point: SolutionPoint
    functions: dict[str, TestFunction]
    fault: AdmissibilityFault | None


def _point(equations: ExtendedSystem, X: Array) -> tuple[SolutionPoint, Complex]:
    """Return the solution point at unknowns X (N,), and its finite multipliers that no condition fixes."""
    mu = multipliers(equations.motion(X))[0]
    others = mu[np.isfinite(mu)]
    for condition, total in zip(equations.conditions, equations.totals, strict=True):
        if condition.kind in (UNIT, MINUS_ONE) and len(others):
            nearest = np.argmin(np.abs(others - (1.0 if condition.kind == UNIT else -1.0)))
            others = others[np.arange(len(others)) != nearest]
        if condition.kind == PAIR and len(others) > 1:
            others = np.delete(others, pair_near(others[None], np.array([total]))[2][0])
    unstable, contacts = int(np.sum(np.abs(others) > 1.0)), equations.contacts(X).copy()
    return SolutionPoint(equations.values(X).copy(), equations.orbit(X), contacts, mu, unstable), others


def monitor_point(equations: ExtendedSystem, X: Array) -> MonitoredPoint:
    """Return the solution point at unknowns X (N,) with its test functions, numbers that change sign at events.

    The equations, which X solves, are bordered at X first.
    """
    equations = equations.rebordered(X)
    (point, others), motion, conditions = _point(equations, X), equations.motion(X), equations.conditions
    kind = conditions[0].kind if conditions else None
    functions = {}
    for name, z in ((UNIT, 1), (MINUS_ONE, -1)):
        if kind == SPEED:  # J_z is singular there for any z
            functions[name] = _function(float(np.prod(others - z).real), (*conditions, Condition(name)))
        elif kind != name:
            sign, log = np.linalg.slogdet(motion.linearised(z)[0])
            own_share = 2.0 - z * equations.totals[0] if kind == PAIR else 1.0  # (z - mu)(z - 1 / mu) / z
            functions[name] = TestFunction(float(sign) * np.sign(own_share), float(log), (*conditions, Condition(name)))
    if kind == UNIT:
        functions[CUSP] = _function(float(equations.curvature(motion)[0]), (*conditions, Condition(CUSP)))
        functions["double"] = _function(float(np.prod(1.0 - others).real), _resonance(1.0))
    if kind == MINUS_ONE:
        functions["double"] = _function(float(np.prod(1.0 + others).real), _resonance(-1.0))
    if kind == PAIR:
        kappa = 0.5 * equations.totals[0]
        functions |= {name: _function(kappa - angle, _resonance(angle)) for angle, name in ANGLES.items()}
    else:
        functions[PAIR] = _pairs(others, conditions)
    return MonitoredPoint(equations, point, functions, fault(equations, X))


def fault(equations: ExtendedSystem, X: Array) -> AdmissibilityFault | None:
    """Return why the orbit at unknowns X (N,) is not admissible; None if it is admissible.

    The grazes and the lost impact that the conditions of ``equations`` demand are allowed.
    """
    if not equations.family.certified:
        return None
    lost = next((c.impact for c in equations.conditions if c.kind == SPEED), -1)
    return first_fault(equations.motion(X), touches(equations, X), lost)


def touches(equations: ExtendedSystem, X: Array) -> list[Graze]:
    """Return the grazing contacts of a solution X (N,) that are conditions of its equations."""
    grazes = (condition for condition in equations.conditions if condition.kind == GRAZE)
    return [Graze(float(t), c.signal, c.side) for t, c in zip(equations.contacts(X), grazes, strict=True)]


def name_of(conditions: tuple[Condition, ...], symmetric: bool) -> str:
    """Return the name of an event whose orbit, symmetric or not, meets these conditions, one or two."""
    kinds = [condition.kind for condition in conditions]
    if ANGLE in kinds:
        return ANGLES[conditions[kinds.index(ANGLE)].kappa]
    if CUSP in kinds:
        return "cusp"
    flip = SYMMETRY_BREAKING if symmetric else PERIOD_DOUBLING
    names = {
        UNIT: FOLD, MINUS_ONE: flip, PAIR: NEIMARK_SACKER, GRAZE: GRAZING, SPEED: IMPACT_LOST,
        ONSET: STICK_ONSET, ENDS: STICK_END, MEETS: EXCHANGE,
    }  # fmt: skip
    if len(kinds) == 1:
        return names[kinds[0]]
    if set(kinds) == {UNIT, MINUS_ONE}:
        return "fold_flip"
    other = [names[kind] for kind in kinds if kind not in (GRAZE, SPEED)]
    if not other:
        return "double_graze"
    return f"graze_{other[0]}" if len(other) == 1 else "_".join(sorted(other))


def _pairs(others: Complex, conditions: tuple[Condition, ...]) -> TestFunction:
    """Return prod (mu_i mu_j - 1) over all pairs of multipliers: zero if a pair lies on the unit circle."""
    i, j = np.triu_indices(len(others), 1)
    with np.errstate(all="ignore"):
        products = others[i] * others[j]
        value = float(np.prod(products - 1.0).real)
    nearest = np.argmin(np.abs(products.real - 1.0)) if len(products) else None
    kappa = 0.0 if nearest is None else 0.5 * float((others[i] + others[j])[nearest].real)
    return _function(value, (*conditions, Condition(PAIR, kappa=kappa)))


def _resonance(kappa: float) -> tuple[Condition, ...]:
    return Condition(PAIR, kappa=kappa), Condition(ANGLE, kappa=kappa)


def _function(value: float, conditions: tuple[Condition, ...]) -> TestFunction:
    if not math.isfinite(value):
        return TestFunction(0.0, math.inf, conditions)
    return TestFunction(float(np.sign(value)), math.log(abs(value)) if value else -math.inf, conditions)


class Event(NamedTuple):
    """An event of a branch or curve.

    kind        kind of the event
    conditions  conditions that its orbit meets
    point       solution point of the event
    kappa       cos theta of a pair on the unit circle, else NaN
    last        kind of the last condition alone, such as "graze" of a graze_fold on a curve of folds
    """

    kind: str
    conditions: tuple[Condition, ...]
    point: SolutionPoint
    kappa: float = math.nan
    last: str = ""


class LocatedEvent(NamedTuple):
    """An event, and the share of a continuation step, from 0 to 1, at which it lies."""

    share: float
    event: Event


def sign_changes(before: MonitoredPoint, after: MonitoredPoint) -> list[str]:
    """Return the names of the test functions that changed their sign."""
    return [name for name, b in after.functions.items() if before.functions[name].sign * b.sign < 0.0]


def locate_event(
    step: ContinuationStep, before: MonitoredPoint, after: MonitoredPoint, name: str, exists: bool = False
) -> LocatedEvent | None:
    """Return the event at which the test function ``name`` changed its sign.

    Return None if no event lies there: at a pole of the function, and at a real pair of multipliers of product 1. With
    ``exists`` the orbit of the event must be admissible, since orbits cease on the step.
    """
    a, b = before.functions[name], after.functions[name]
    low, high, guess = 0.0, 1.0, 1.0 / (1.0 + math.exp(min(b.log - a.log, 50.0)))
    for _ in range(TRIES):
        solved = solve_on_step(step, step.guess(guess), b.conditions, exists=exists)
        if solved is not None:
            return solved
        guess = 0.5 * (low + high)
        middle = step.solution(guess)
        if not middle.converged:
            return None
        passed = monitor_point(step.equations, middle.X).functions[name].sign == b.sign
        low, high = (low, guess) if passed else (guess, high)
        guess = 0.5 * (low + high)
    return None


def find_origin(step: ContinuationStep, to: Itinerary) -> Event | None:
    """Return the symmetry breaking or period doubling at which a branch becomes an orbit of half the turn.

    ``to`` is the itinerary, the sequence of events, of that orbit. The search also works on a curve of grazes. Return
    None on other curves, and if the event is not found.
    """
    eq = step.equations
    grazes = tuple(condition for condition in eq.conditions if condition.kind == GRAZE)
    if grazes != eq.conditions:
        return None
    a, b = (float(np.linalg.norm(difference(eq.motion(X), to))) + 1e-300 for X in (step.start, step.end))
    guess = step.guess(a / (a + b))
    solved = solution(eq, reduce_orbit(eq.orbit(guess), to), (*grazes, Condition(MINUS_ONE)), eq.contacts(guess), guess)
    return None if solved is None else event_of(*solved)


def halves_met(step: ContinuationStep) -> Itinerary | None:
    """Return the sequence of events of an orbit of half the period that a step passes; None if there is no such orbit.

    On both sides of that orbit the branch has nearly repeated orbits: the first half of one is the second half of the
    other. If no step converged, so that both ends of the step are equal, return that of the nearest such orbit.
    """
    for to in reductions(step.equations.itinerary):
        if 2 * len(to.sides) == step.equations.m:
            a, b = (difference(step.equations.motion(X), to) for X in (step.start, step.end))
            if a @ b <= 0.0 or (step.start is step.end and np.max(np.abs(a)) < NEAR_HALVES):
                return to
    return None


def solve_on_step(
    step: ContinuationStep,
    guess: Array,
    conditions: tuple[Condition, ...],
    contact: tuple[float, ...] = (),
    exists: bool = False,
) -> LocatedEvent | None:
    """Return the event with these conditions near a guess; None if it is not on the step.

    step        step on which the event lies
    guess       (N,) unknowns near the event
    conditions  conditions of the event
    contact     time of a new graze, empty if there is no new graze
    exists      True if the orbit must be admissible

    At an event at which orbits cease the orbit must be admissible in any case; its own grazes are allowed.
    """
    eq = step.equations
    solved = solution(eq, eq.orbit(guess), conditions, np.append(eq.contacts(guess), contact), guess)
    share = None if solved is None else step.share_of(solved[1])
    if solved is None or share is None or not is_minimal(solved[0].motion(solved[1])):
        return None
    if (exists or conditions[-1].kind in BORDERS) and fault(*solved):
        return None
    if conditions[-1].kind in (UNIT, MINUS_ONE) and not _has_multiplier(*solved):
        return None
    event = event_of(*solved)
    kappa = abs(event.kappa)
    return None if (len(conditions) == 1 and kappa >= 1.0) or kappa > 1.0 + 1e-9 else LocatedEvent(share, event)


def _has_multiplier(square: ExtendedSystem, X: Array) -> bool:
    """Return True if 1 or -1, as in the last condition of a solution, is a multiplier of its orbit.

    If friction begins to stick at zero rate, the equations are singular too, although no multiplier has this value.
    """
    motion, value = square.motion(X), 1.0 if square.conditions[-1].kind == UNIT else -1.0
    return bool(np.min(np.abs(multipliers(motion)[0] - value)) < SURE)


def solution(
    equations: ExtendedSystem, orbit: Orbit, conditions: tuple[Condition, ...], contacts: Array, guess: Array
) -> tuple[ExtendedSystem, Array] | None:
    """Return the square system of these conditions, and its solution near an orbit and the parameters of a guess.

    Return None if Newton's method does not converge.
    """
    values = equations.values(guess)
    square = ExtendedSystem(equations.family, orbit, conditions, values, equations.width)
    X = square.pack(orbit, contacts, values)
    try:
        square = square.rebordered(X)
        solved = solve(square, X)
    except (NoOscillatorError, np.linalg.LinAlgError):
        return None
    return (square.rebordered(solved.X), solved.X) if solved.converged else None


def event_of(square: ExtendedSystem, X: Array) -> Event:
    """Return the event that a solution X (N,) of a square extended system describes."""
    totals = (total for c, total in zip(square.conditions, square.totals, strict=True) if c.kind == PAIR)
    conditions, symmetric, motion = square.conditions, square.itinerary.symmetric, square.motion(X)
    last = name_of(conditions[-1:], symmetric)
    if last == IMPACT_LOST and motion.plan.reached[conditions[-1].impact, ACT] == SLOWS:
        last = GRAZING_SLIDING
    if last == GRAZING:
        last = name_of_touch(motion, touches(square, X)[-1])
    kind = last if len(conditions) == 1 else name_of(conditions, symmetric)
    return Event(kind, conditions, _point(square, X)[0], 0.5 * next(totals, math.nan), last)
