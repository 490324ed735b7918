"""What is known at a point of a branch or curve: its stability, test functions of events, whether it is admissible."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.continuation.admissible import Fault, first_fault
from workers.continuation.equations import Orbit, linearised
from workers.continuation.extended import ANGLE, CUSP, GRAZE, MINUS_ONE, PAIR, SPEED, UNIT, Condition, Extended
from workers.continuation.newton import Array
from workers.continuation.stability import multipliers, pair_near

Complex = NDArray[np.complex128]

FOLD, SYMMETRY_BREAKING, PERIOD_DOUBLING, NEIMARK_SACKER = (
    "fold", "symmetry_breaking", "period_doubling", "neimark_sacker",
)  # fmt: skip
GRAZING, IMPACT_LOST = "graze", "impact_lost"
"""Kinds of events with one condition."""

ANGLES = {1.0: "resonance_1_1", -1.0: "resonance_1_2", -0.5: "resonance_1_3", 0.0: "resonance_1_4"}
"""Strong resonances by cos theta."""


class Point(NamedTuple):
    """One orbit of a branch or curve, at parameters (free,).

    contacts (G,)      times at which it grazes
    multipliers (2n,)  of a turn, which is half the orbit where it is symmetric; unstable: how many have modulus above
                       1, besides those that the event itself fixes
    """

    values: Array
    orbit: Orbit
    contacts: Array
    multipliers: Complex
    unstable: int


class TestFunction(NamedTuple):
    """A number that changes sign at an event, as its sign and the logarithm of its modulus; the event's conditions."""

    sign: float
    log: float
    conditions: tuple[Condition, ...]


class TestFunctions(NamedTuple):
    """The test functions at a point, by name; the equations as they are bordered there; why it is not admissible."""

    equations: Extended
    point: Point
    functions: dict[str, TestFunction]
    fault: Fault | None


def point_of(equations: Extended, X: Array) -> Point:
    """The point of unknowns X (N,)."""
    mu = multipliers(*equations.motion(X))[0]
    unstable = int(np.sum(np.abs(_others(mu, equations)) > 1.0))
    return Point(equations.values(X).copy(), equations.orbit(X), equations.contacts(X[None])[0].copy(), mu, unstable)


def monitored(equations: Extended, X: Array) -> TestFunctions:
    """The test functions at unknowns X (N,) that solve equations, which are bordered there first."""
    equations = equations.at(X)
    point, motion, own = point_of(equations, X), equations.motion(X), equations.conditions
    kind = own[0].kind if own else None
    found = {}
    for name, z in ((UNIT, 1), (MINUS_ONE, -1)):
        if kind != name:
            sign, log = np.linalg.slogdet(linearised(*motion, z)[0])
            own_share = 2.0 - z * equations.totals[0] if kind == PAIR else 1.0  # (z - mu)(z - 1 / mu) / z
            found[name] = TestFunction(float(sign) * np.sign(own_share), float(log), (*own, Condition(name)))
    others = _others(point.multipliers, equations)
    if kind == UNIT:
        bend = float(equations.curvature(motion[0], motion[2])[0])
        found[CUSP] = _function(bend, (*own, Condition(CUSP)))
        found["double"] = _function(float(np.prod(1.0 - others).real), _resonance(1.0))
    if kind == MINUS_ONE:
        found["double"] = _function(float(np.prod(1.0 + others).real), _resonance(-1.0))
    if kind == PAIR:
        kappa = 0.5 * equations.totals[0]
        found |= {name: _function(kappa - angle, _resonance(angle)) for angle, name in ANGLES.items()}
    else:
        found[PAIR] = _pairs(others, own)
    return TestFunctions(equations, point, found, fault(equations, X))


def fault(equations: Extended, X: Array) -> Fault | None:
    """Why the orbit at unknowns X (N,) is not admissible, its own grazes and lost impacts allowed; None if it is."""
    if not equations.family.certified:
        return None
    lost = next((c.impact for c in equations.conditions if c.kind == SPEED), -1)
    return first_fault(*equations.motion(X), equations.contacts(X[None])[0], lost)


def name_of(conditions: tuple[Condition, ...], symmetric: bool) -> str:
    """The name of an event with these conditions, one or two."""
    kinds = [condition.kind for condition in conditions]
    if ANGLE in kinds:
        return ANGLES[conditions[kinds.index(ANGLE)].kappa]
    if CUSP in kinds:
        return "cusp"
    flip = SYMMETRY_BREAKING if symmetric else PERIOD_DOUBLING
    names = {UNIT: FOLD, MINUS_ONE: flip, PAIR: NEIMARK_SACKER, GRAZE: GRAZING, SPEED: IMPACT_LOST}
    if len(kinds) == 1:
        return names[kinds[0]]
    if set(kinds) == {UNIT, MINUS_ONE}:
        return "fold_flip"
    other = [names[kind] for kind in kinds if kind not in (GRAZE, SPEED)]
    if not other:
        return "double_graze"
    return f"graze_{other[0]}" if len(other) == 1 else "_".join(sorted(other))


def _others(mu: Complex, equations: Extended) -> Complex:
    """The finite multipliers besides those that the conditions fix."""
    left = mu[np.isfinite(mu)]
    for condition, total in zip(equations.conditions, equations.totals, strict=True):
        if condition.kind in (UNIT, MINUS_ONE) and len(left):
            left = np.delete(left, np.argmin(np.abs(left - (1.0 if condition.kind == UNIT else -1.0))))
        if condition.kind == PAIR and len(left) > 1:
            left = np.delete(left, pair_near(left[None], np.array([total]))[2][0])
    return left


def _pairs(others: Complex, own: tuple[Condition, ...]) -> TestFunction:
    """prod (mu_i mu_j - 1) over all pairs of multipliers: zero where one lies on the unit circle."""
    i, j = np.triu_indices(len(others), 1)
    with np.errstate(all="ignore"):
        products = others[i] * others[j]
        value = float(np.prod(products - 1.0).real)
    nearest = np.argmin(np.abs(products.real - 1.0)) if len(products) else None
    kappa = 0.0 if nearest is None else 0.5 * float((others[i] + others[j])[nearest].real)
    return _function(value, (*own, Condition(PAIR, kappa=kappa)))


def _resonance(kappa: float) -> tuple[Condition, ...]:
    return Condition(PAIR, kappa=kappa), Condition(ANGLE, kappa=kappa)


def _function(value: float, conditions: tuple[Condition, ...]) -> TestFunction:
    if not math.isfinite(value):
        return TestFunction(0.0, math.inf, conditions)
    return TestFunction(float(np.sign(value)), math.log(abs(value)) if value else -math.inf, conditions)
