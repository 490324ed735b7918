"""The linear oscillator of an orbit: a small record of its blocks, its forced response and its stops, and its flow.

Every field has an axis of oscillators in front, N of them: a step of Newton's method asks for several at once.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.model.oscillator import COLUMN, Oscillator, Signal
from workers.model.system import System
from workers.results import NO_REASON, REASONS

Array = NDArray[np.float64]


class Linear(NamedTuple):
    """N linear oscillators y = sum_j c_j . u_j + Y(t) with stops at y = upper and y = -lower.

    eta, lam   (N, n)     block j carries u = (h, h') with h'' + 2 eta h' + lam h = load; lam = 0 is a rigid mode
    c, k       (N, n, 2)  gap row and kick column, c.k = 0 and cA.k = 1; of a rigid mode c = (c, 0), k = (0, k)
    sin_part, cos_part  (N, H)  Y = sum_h sin_part_h sin(h phi) + cos_part_h cos(h phi), phi = omega t + tau
    load       (N, n)     constant load on each block
    upper, lower, omega, tau, R, trace  (N,)  an absent stop is at infinity; trace of M^-1 C
    """

    eta: Array
    lam: Array
    c: Array
    k: Array
    sin_part: Array
    cos_part: Array
    load: Array
    upper: Array
    lower: Array
    omega: Array
    tau: Array
    R: Array
    trace: Array


class NoOscillatorError(ValueError):
    """Parameters at which there is no oscillator."""


class Family(NamedTuple):
    """Oscillators over some free parameters, by name: ``model`` makes them of rows of values (N, free).

    It returns N linear oscillators and their N gap signals, for certified crossings; None where the kernel has no such
    signals: then whether orbits are admissible is not asked.
    """

    free: tuple[str, ...]
    model: Callable[[Array], tuple[Linear, Signal | None]]


def linear_of(oscillators: Oscillator) -> Linear:
    """The linear part of many oscillators, y counted from where it rests under the constant load."""
    gap, lam = oscillators.gap, np.asarray(oscillators.gap.lam)
    return Linear(
        eta=gap.eta,
        lam=lam,
        c=gap.row,
        k=oscillators.kick,
        sin_part=np.asarray(gap.sin_part),
        cos_part=np.asarray(gap.cos_part),
        load=np.asarray(gap.block)[..., COLUMN.load],
        upper=np.asarray(oscillators.b_upper),
        lower=np.asarray(oscillators.b_lower),
        omega=np.asarray(gap.omega),
        tau=np.asarray(oscillators.tau),
        R=np.asarray(oscillators.R),
        trace=np.asarray(oscillators.trace),
    )


def family_of(system: System, values: Mapping[str, float], free: tuple[str, ...]) -> Family:
    """A system over some of its parameters, the others fixed at ``values`` or at their defaults.

    Raises KeyError for unknown names; its model raises NoOscillatorError where there is none.
    """
    for name in (*values, *free):
        system.parameter(name)
    fixed = {p.name: float(values.get(p.name, p.default)) for p in system.parameters}

    def model(rows: Array) -> tuple[Linear, Signal | None]:
        given = {name: np.full(len(rows), value) for name, value in fixed.items()}
        given |= {name: np.ascontiguousarray(rows[:, i]) for i, name in enumerate(free)}
        oscillators, reasons = system.build_many(given)
        if np.any(reasons != NO_REASON):
            bad = int(np.flatnonzero(reasons != NO_REASON)[0])
            where = ", ".join(f"{name} = {rows[bad, i]:g}" for i, name in enumerate(free))
            raise NoOscillatorError(f"no oscillator at {where}: {REASONS[reasons[bad]].text}")
        return linear_of(oscillators), oscillators.gap

    return Family(free, model)


def taken(lin: Linear, rows: NDArray[np.int64]) -> Linear:
    """These rows of a record of many, any of them more than once."""
    return Linear(*(field[rows] for field in lin))


def rigid_mode(lin: Linear) -> int | None:
    """Which block is a rigid mode, lam = 0; None where none is. ValueError where there are two, which no gap sees."""
    rigid = np.flatnonzero(lin.lam[0] == 0.0)
    if len(rigid) > 1:
        raise ValueError(f"{len(rigid)} rigid modes; one gap coordinate sees only one: leave out what it does not see")
    return int(rigid[0]) if len(rigid) else None


def flow_entries(eta: Array, lam: Array, s: Array) -> tuple[Array, Array, Array, Array]:
    """The flow of h'' + 2 eta h' + lam h = 0 over s: (f11, f12, f21, f22), (h, h') -> f (h, h').

    f = e^(-eta s) (C + eta S, S, -lam S, C - eta S), as kernel.flight.flow_entries, for arrays that broadcast.
    """
    d = lam - eta * eta
    w = np.sqrt(np.abs(d))
    x = d * s * s
    series, fast = np.abs(x) < 0.1, np.broadcast_to(d < 0.0, x.shape)
    angle = w * s
    decay = np.exp(-eta * s)
    unit = np.where(w > 0.0, w, 1.0)
    S, C = np.sin(angle) / unit, np.cos(angle)
    if np.any(series):
        small = np.where(series, x, 0.0)
        S, C = np.where(series, s * _sinc(small), S), np.where(series, _cosine(small), C)
    f11, f12, f22 = decay * (C + eta * S), decay * S, decay * (C - eta * S)
    over = fast & ~series
    if np.any(over):
        quick = eta + w
        slow = lam / np.where(quick > 0.0, quick, 1.0)
        e_slow = np.exp(np.where(over, -slow * s, 0.0))
        ratio = np.exp(np.where(over, -2.0 * w * s, 0.0))
        half = 0.5 * e_slow / unit
        f11 = np.where(over, half * (quick - slow * ratio), f11)
        f12 = np.where(over, -half * np.expm1(np.where(over, -2.0 * w * s, 0.0)), f12)
        f22 = np.where(over, half * (quick * ratio - slow), f22)
    return f11, f12, -lam * f12, f22


def _cosine(x: Array) -> Array:
    """cos(sqrt x) for |x| < 0.1, its series."""
    total: Any = 1.0
    for n in (12, 10, 8, 6, 4, 2):
        total = 1.0 - x * total / (n * (n - 1))
    return np.asarray(total)


def _sinc(x: Array) -> Array:
    """sin(sqrt x) / sqrt x for |x| < 0.1, its series."""
    total: Any = 1.0
    for n in (13, 11, 9, 7, 5, 3):
        total = 1.0 - x * total / (n * (n - 1))
    return np.asarray(total)


def forced(lin: Linear, t: Array) -> tuple[Array, Array, Array, Array]:
    """Y and its first three derivatives at times t (N, K), the rest position under constant load included."""
    order = np.arange(1.0, lin.sin_part.shape[1] + 1.0)
    phase = (lin.omega[:, None] * t + lin.tau[:, None])[..., None] * order
    rate = lin.omega[:, None, None] * order
    sin, cos, a, b = np.sin(phase), np.cos(phase), lin.sin_part[:, None, :], lin.cos_part[:, None, :]
    value, slope = a * sin + b * cos, rate * (a * cos - b * sin)
    return (
        value.sum(-1) + rest_position(lin)[:, None],
        slope.sum(-1),
        -(rate * rate * value).sum(-1),
        -(rate * rate * slope).sum(-1),
    )


def rest_position(lin: Linear) -> Array:
    """Where y (N,) rests under the constant load: sum_j c_j load_j / lam_j over the elastic modes."""
    elastic = lin.lam > 0.0
    return np.asarray(
        np.sum(np.where(elastic, lin.c[..., 0] * lin.load / np.where(elastic, lin.lam, 1.0), 0.0), axis=1)
    )
