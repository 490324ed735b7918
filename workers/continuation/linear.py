"""The linear oscillator of an orbit: a small record of its blocks, its forced response and its stops, and its flow.

Every field has an axis of oscillators in front, N of them: a step of Newton's method asks for several at once.
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.kernel.jit import kernel
from workers.model.family import FreeMotions, Motions
from workers.model.free import phase_of
from workers.model.oscillator import COLUMN, Mode, Oscillator
from workers.model.system import System
from workers.results import NO_REASON, REASONS

Array = NDArray[np.float64]


class ModalOscillator(NamedTuple):
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
    model: Callable[[Array], tuple[ModalOscillator, Mode | None]]


def linear_of(oscillators: Oscillator) -> ModalOscillator:
    """The linear part of many oscillators, y counted from where it rests under the constant load."""
    gap, lam = oscillators.gap, np.asarray(oscillators.gap.lam)
    return ModalOscillator(
        eta=gap.eta,
        lam=lam,
        c=gap.row,
        k=oscillators.gap.kick,
        sin_part=np.asarray(gap.sin_part),
        cos_part=np.asarray(gap.cos_part),
        load=np.asarray(gap.blocks)[..., COLUMN.load],
        upper=np.asarray(oscillators.b_upper),
        lower=np.asarray(oscillators.b_lower),
        omega=np.asarray(gap.omega),
        tau=np.asarray(oscillators.tau),
        R=np.asarray(oscillators.R),
        trace=np.asarray(oscillators.trace),
    )


def _linear_of(found: Motions) -> ModalOscillator:
    """The same of free motion alone."""
    machines, frame, free = found.machines, found.frame, found.free
    return ModalOscillator(
        eta=frame.modes.eta,
        lam=frame.modes.lam,
        c=frame.row,
        k=free.gap.kick,
        sin_part=free.gap.sin_part,
        cos_part=free.gap.cos_part,
        load=free.driven.load,
        upper=free.b_upper,
        lower=free.b_lower,
        omega=machines.omega,
        tau=phase_of(machines.tau),
        R=machines.R,
        trace=frame.trace,
    )


def family_of(system: System, values: Mapping[str, float], free: tuple[str, ...]) -> Family:
    """A system over some of its parameters, the others fixed at ``values`` or at their defaults.

    Raises KeyError for unknown names; its model raises NoOscillatorError where there is none.
    """
    for name in (*values, *free):
        system.parameter(name)
    motions = FreeMotions(system, values, free)

    def model(rows: Array) -> tuple[ModalOscillator, Mode | None]:
        found = motions(rows)
        if np.any(found.reasons != NO_REASON):
            bad = int(np.flatnonzero(found.reasons != NO_REASON)[0])
            where = ", ".join(f"{name} = {rows[bad, i]:g}" for i, name in enumerate(free))
            raise NoOscillatorError(f"no oscillator at {where}: {REASONS[found.reasons[bad]].text}")
        return _linear_of(found), found.free.gap

    return Family(free, model)


def taken(lin: ModalOscillator, rows: NDArray[np.int64]) -> ModalOscillator:
    """These rows of a record of many, any of them more than once."""
    return ModalOscillator(*(field[rows] for field in lin))


def rigid_mode(lin: ModalOscillator) -> int | None:
    """Which block is a rigid mode, lam = 0; None where none is. ValueError where there are two, which no gap sees."""
    rigid = np.flatnonzero(lin.lam[0] == 0.0)
    if len(rigid) > 1:
        raise ValueError(f"{len(rigid)} rigid modes; one gap coordinate sees only one: leave out what it does not see")
    return int(rigid[0]) if len(rigid) else None


@kernel
def flow_entries(eta, lam, s):
    """The flow of h'' + 2 eta h' + lam h = 0 over s: (f11, f12, f21, f22), (h, h') -> f (h, h').

    f = e^(-eta s) (C + eta S, S, -lam S, C - eta S), as kernel.flow.flow_entries, for any s.
    """
    d = lam - eta * eta
    w = math.sqrt(abs(d))
    x = d * s * s
    if d < 0.0 and x <= -0.1:
        quick = eta + w
        slow = lam / quick
        half, ratio = 0.5 * math.exp(-slow * s) / w, math.exp(-2.0 * w * s)
        f12 = -half * math.expm1(-2.0 * w * s)
        return half * (quick - slow * ratio), f12, -lam * f12, half * (quick * ratio - slow)
    if abs(x) < 0.1:
        C, S = _cosine(x), s * _sinc(x)
    else:
        C, S = math.cos(w * s), math.sin(w * s) / w
    decay = math.exp(-eta * s)
    return decay * (C + eta * S), decay * S, -lam * decay * S, decay * (C - eta * S)


@kernel
def _cosine(x):
    """cos(sqrt x) for |x| < 0.1, its series."""
    total = 1.0
    for n in (12, 10, 8, 6, 4, 2):
        total = 1.0 - x * total / (n * (n - 1))
    return total


@kernel
def _sinc(x):
    """sin(sqrt x) / sqrt x for |x| < 0.1, its series."""
    total = 1.0
    for n in (13, 11, 9, 7, 5, 3):
        total = 1.0 - x * total / (n * (n - 1))
    return total


@kernel
def forced(lin, r, t):
    """Y and its first three derivatives at time t of oscillator r, the rest position under constant load included."""
    value, speed, bend, jerk = rest_of(lin, r), 0.0, 0.0, 0.0
    phase = lin.omega[r] * t + lin.tau[r]
    for h in range(lin.sin_part.shape[1]):
        order = h + 1.0
        sin, cos, rate = math.sin(order * phase), math.cos(order * phase), order * lin.omega[r]
        here = lin.sin_part[r, h] * sin + lin.cos_part[r, h] * cos
        slope = rate * (lin.sin_part[r, h] * cos - lin.cos_part[r, h] * sin)
        value, speed, bend, jerk = value + here, speed + slope, bend - rate * rate * here, jerk - rate * rate * slope
    return value, speed, bend, jerk


@kernel
def rest_of(lin, r):
    """Where y of oscillator r rests under the constant load: sum_j c_j load_j / lam_j over the elastic modes."""
    total = 0.0
    for j in range(lin.lam.shape[1]):
        if lin.lam[r, j] > 0.0:
            total += lin.c[r, j, 0] * lin.load[r, j] / lin.lam[r, j]
    return total
