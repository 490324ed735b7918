"""What a point of a branch or curve shows: its stability, what it is watched for, and whether it is admissible."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.continuation.admissible import Fault, first_fault
from workers.continuation.equations import linearised
from workers.continuation.extended import ANGLE, CUSP, GRAZE, MINUS_ONE, PAIR, SPEED, UNIT, Condition, Extended
from workers.continuation.stability import multipliers

Array = NDArray[np.float64]

FOLD, SYMMETRY_BREAKING, PERIOD_DOUBLING, NEIMARK_SACKER = (
    "fold",
    "symmetry_breaking",
    "period_doubling",
    "neimark_sacker",
)
GRAZING, IMPACT_LOST = "graze", "impact_lost"
"""Kinds of events with one condition."""

ANGLES = {1.0: "resonance_1_1", -1.0: "resonance_1_2", -0.5: "resonance_1_3", 0.0: "resonance_1_4"}
"""Strong resonances by cos theta."""


class TestFunction(NamedTuple):
    """A number that changes sign at an event, as its sign and the logarithm of its modulus; the event's conditions."""

    sign: float
    log: float
    conditions: tuple[Condition, ...]


class TestFunctions(NamedTuple):
    """multipliers (2n,) of a turn; how many of them are unstable, the event's own left out; what is watched; fault."""

    multipliers: NDArray[np.complex128]
    unstable: int
    watched: dict[str, TestFunction]
    fault: Fault | None


def view(equations: Extended, X: Array) -> TestFunctions:
    """What unknowns X (N,) show."""
    lin = equations.model(equations.values(X))[0]
    points, itinerary = equations.points(X[None]), equations.itinerary
    equations.follow(X)
    mu = multipliers(lin, itinerary, points)[0]
    others = without_own(mu, equations.conditions, equations.totals)
    own = equations.conditions
    kind = own[0].kind if own else None
    found = {}
    for name, z in ((UNIT, 1), (MINUS_ONE, -1)):
        if kind != name:
            sign, log = np.linalg.slogdet(linearised(lin, itinerary, points, z)[0])
            own_share = 2.0 - z * equations.totals[0] if kind == PAIR else 1.0  # (z - mu)(z - 1 / mu) / z
            found[name] = TestFunction(float(sign) * np.sign(own_share), float(log), (*own, Condition(name)))
    if kind == UNIT:
        found[CUSP] = TestFunction(*_size(float(equations.curvature(lin, points)[0])), (*own, Condition(CUSP)))
        found["double"] = TestFunction(*_size(float(np.prod(1.0 - others).real)), _resonance(1.0))
    if kind == MINUS_ONE:
        found["double"] = TestFunction(*_size(float(np.prod(1.0 + others).real)), _resonance(-1.0))
    if kind == PAIR:
        kappa = 0.5 * equations.totals[0]
        for angle, name in ANGLES.items():
            found[name] = TestFunction(*_size(kappa - angle), _resonance(angle))
    else:
        i, j = np.triu_indices(len(others), 1)
        with np.errstate(all="ignore"):
            products = (others[i] * others[j]).real if len(i) else np.ones(0)
            pairs = np.prod(others[i] * others[j] - 1.0).real if len(i) else 1.0
        nearest = int(np.argmin(np.abs(products - 1.0))) if len(i) else 0
        kappa = 0.5 * float((others[i] + others[j])[nearest].real) if len(i) else 0.0
        found[PAIR] = TestFunction(*_size(float(pairs)), (*own, Condition(PAIR, kappa=kappa)))
    return TestFunctions(mu, int(np.sum(np.abs(others) > 1.0)), found, fault(equations, X))


def fault(equations: Extended, X: Array) -> Fault | None:
    """Why the orbit at unknowns X (N,) is not admissible, its own grazes and lost impacts allowed; None if it is."""
    lin, signal = equations.model(equations.values(X))
    if signal is None:
        return None
    lost = next((c.impact for c in equations.conditions if c.kind == SPEED), -1)
    grazes = equations.contacts(X[None])[0]
    return first_fault(signal, lin, equations.itinerary, equations.points(X[None]), grazes, lost)


def without_own(
    mu: NDArray[np.complex128], conditions: tuple[Condition, ...], totals: list[float]
) -> NDArray[np.complex128]:
    """The multipliers besides those that the conditions fix."""
    left = list(mu[np.isfinite(mu)])
    for condition, total in zip(conditions, totals, strict=True):
        if condition.kind in (UNIT, MINUS_ONE) and left:
            target = 1.0 if condition.kind == UNIT else -1.0
            left.pop(int(np.argmin([abs(value - target) for value in left])))
        if condition.kind == PAIR and len(left) > 1:
            i, j = np.triu_indices(len(left), 1)
            values = np.array(left)
            miss = np.abs(values[i] + values[j] - total) + np.abs(values[i] * values[j] - 1.0)
            pick = int(np.argmin(miss))
            left = [value for k, value in enumerate(left) if k not in (i[pick], j[pick])]
    return np.array(left, dtype=np.complex128)


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
    touching = [kind for kind in kinds if kind in (GRAZE, SPEED)]
    if len(touching) == 2:
        return "double_graze"
    other = [names[kind] for kind in kinds if kind not in (GRAZE, SPEED)]
    return f"graze_{other[0]}" if touching else "_".join(sorted(other))


def _resonance(kappa: float) -> tuple[Condition, ...]:
    return Condition(PAIR, kappa=kappa), Condition(ANGLE, kappa=kappa)


def _size(value: float) -> tuple[float, float]:
    """The sign of a number and the logarithm of its modulus."""
    if not math.isfinite(value):
        return 0.0, math.inf
    return float(np.sign(value)), math.log(abs(value)) if value else -math.inf
