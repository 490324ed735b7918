"""Naive twins of the kernels: plain Python, numpy and mpmath, nothing shared with workers/ but its records."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from mpmath import mp
from numpy.typing import NDArray

from workers.model.oscillator import GuardedFlow, Oscillator
from workers.model.system import find_system

Array = NDArray[np.float64]


def two_mass(**params: float) -> tuple[Oscillator, Array]:
    """The two-mass oscillator with these parameters, and its physical initial state."""
    system = find_system("two-mass")
    values = {parameter.name: parameter.default for parameter in system.parameters} | params
    return system.build(values), np.array([values[name] for name in system.states])


FIGURES: dict[int, dict[str, float]] = {
    3: {"mu_k": 5.0, "mu_m": 2.0, "zeta": 0.05, "f2": 0.0, "omega": 4.0, "R": 0.8, "b": 0.1, "tau": math.pi},
    4: {"mu_k": 4.0, "mu_m": 6.0, "zeta": 0.5, "f2": 2.0, "omega": 1.0, "R": 0.8, "b": 0.2, "tau": math.pi},
    5: {"mu_k": 2.0, "mu_m": 2.0, "zeta": 0.5, "f2": 5.0, "omega": 3.0, "R": 0.8, "b": 0.2, "tau": math.pi},
}
"""Parameters of Figs 3, 4 and 5 of Li & Tan (2011)."""

STICKING = {"mu_k": 5.0, "mu_m": 2.0, "zeta": 0.05, "f2": 0.0, "omega": 1.0, "R": 0.3, "b": 0.15, "tau": math.pi}
"""A motion that rests on each stop in every period."""


def block_flow(eta: float, lam: float, s: float) -> Array:
    """exp(A s) of h'' + 2 eta h' + lam h = 0 (2, 2), from 60-digit arithmetic."""
    with mp.workdps(60):
        flow = mp.expm(mp.matrix([[0, 1], [-mp.mpf(lam), -2 * mp.mpf(eta)]]) * mp.mpf(s), method="pade")
        return np.array([[float(flow[i, j]) for j in range(2)] for i in range(2)])


@dataclass(frozen=True)
class Exponentials:
    """A signal as a sum of exponentials, y(t) = Re sum_i weights_i exp(rates_i t), t since the start of a flight."""

    weights: NDArray[np.complex128]
    rates: NDArray[np.complex128]

    @classmethod
    def of(cls, signal: GuardedFlow, h: Array, phase: float) -> "Exponentials":
        """The signal with block state h at a phase; no block may be critically damped."""
        weights, rates = [], []
        for eta, lam, row, (h0, h1) in zip(signal.eta, signal.lam, signal.row, h, strict=True):
            root = np.sqrt(complex(eta * eta - lam))
            first, second = -eta + root, -eta - root
            a = (h1 - second * h0) / (first - second)
            for weight, rate in ((a, first), (h0 - a, second)):
                weights.append(weight * (row[0] + row[1] * rate))
                rates.append(rate)
        for order, (sin_part, cos_part) in enumerate(zip(signal.sin_part, signal.cos_part, strict=True), start=1):
            weights.append((cos_part - 1j * sin_part) * np.exp(1j * order * phase))
            rates.append(1j * order * signal.omega)
        return cls(np.array(weights), np.array(rates))

    def at(self, t: Array, derivative: int = 0) -> Array:
        """y or one of its derivatives at times t."""
        return (np.exp(np.multiply.outer(t, self.rates)) @ (self.weights * self.rates**derivative)).real

    def fastest(self) -> float:
        """Largest rate, per time."""
        return float(np.max(np.abs(self.rates)))


def _bisect(inside: NDArray[np.bool_], low: Array, high: Array) -> tuple[Array, Array]:
    middle = 0.5 * (low + high)
    return np.where(inside, low, middle), np.where(inside, middle, high)


def peaks(signal: Exponentials, H: float, samples: int = 60) -> tuple[Array, Array, Array]:
    """Times (N + 1,) that cut [0, H] into pieces without a turning point inside, and y and y' there.

    The grid has ``samples`` points per 2 pi of the fastest rate; where y' changes sign the turning point is bisected.
    """
    count = max(64, math.ceil(H * signal.fastest() / (2 * math.pi) * samples))
    grid = np.linspace(0.0, H, count + 1)
    v = signal.at(grid, 1)
    turning = np.flatnonzero(v[:-1] * v[1:] < 0.0)
    low, high, sign = grid[turning], grid[turning + 1], np.sign(v[turning])
    for _ in range(60):
        low, high = _bisect(signal.at(0.5 * (low + high), 1) * sign < 0.0, low, high)
    times = np.sort(np.concatenate([grid, 0.5 * (low + high)]))
    return times, signal.at(times), signal.at(times, 1)


def first_crossing(signal: Exponentials, H: float, upper: float, lower: float) -> tuple[float, int]:
    """(time, side) of the first crossing of a stop in (0, H], or (H, 0): dense samples, turning points, bisection."""
    times, y, _ = peaks(signal, H)
    for k in range(1, len(times)):
        for side, stop in ((1, upper), (-1, lower)):
            if side * (y[k] - stop) >= 0.0 > side * (y[k - 1] - stop):
                low, high = times[k - 1], times[k]
                for _ in range(80):
                    middle = 0.5 * (low + high)
                    if side * (float(signal.at(np.array([middle]))[0]) - stop) >= 0.0:
                        high = middle
                    else:
                        low = middle
                return high, side
    return H, 0


def first_order(params: Mapping[str, float]) -> Array:
    """Matrix (6, 6) of z' = B z for z = (x1, x2, v1, v2, sin, cos), forcing included."""
    p = params
    mass = np.array([1.0, p["mu_m"]])
    K = np.array([[1.0, -1.0], [-1.0, 1.0 + p["mu_k"]]])
    B = np.zeros((6, 6))
    B[0, 2] = B[1, 3] = 1.0
    B[2:4, 0:2] = -K / mass[:, None]
    B[2:4, 2:4] = -2.0 * p["zeta"] * K / mass[:, None]
    B[2:4, 4] = np.array([1.0 - p["f2"], p["f2"]]) / mass
    B[4, 5], B[5, 4] = p["omega"], -p["omega"]
    return B


def blocking_error(values: Array, fewest: int) -> float:
    """Standard error of the mean of a correlated series, from at least ``fewest`` blocks of B = 1, 2, 4, ... values.

    The largest from the shortest blocks with B^3 > 2 N (e_B / e_1)^4 on (Lee et al. 2011), else of all.
    """
    errors, count, length, start = [], len(values), 1, None
    while len(values) >= fewest:
        errors.append(float(np.std(values, ddof=1) / math.sqrt(len(values))))
        if start is None and length**3 > 2 * count * (errors[-1] / errors[0]) ** 4:
            start = len(errors) - 1
        values = values[: len(values) // 2 * 2].reshape(-1, 2).mean(axis=1)
        length *= 2
    return max(errors[start or 0 :], default=math.nan)
