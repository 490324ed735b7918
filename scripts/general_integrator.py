"""A general integrator with events, variational equations and saltation: the reference of the benchmarks."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]

_FIG = {"tau": math.pi, "R": 0.8}
FIGURES = {
    "3": {**_FIG, "mu_k": 5.0, "mu_m": 2.0, "zeta": 0.05, "f2": 0.0, "omega": 4.0, "b": 0.1},
    "4": {**_FIG, "mu_k": 4.0, "mu_m": 6.0, "zeta": 0.5, "f2": 2.0, "omega": 1.0, "b": 0.2},
    "5": {**_FIG, "mu_k": 2.0, "mu_m": 2.0, "zeta": 0.5, "f2": 5.0, "omega": 3.0, "b": 0.2},
}


def numpy_rates(t: float, flat: Array, A: Array, force: Array, omega: float, tau: float) -> Array:
    """d/dt of (x1, x2, v1, v2) and of the tangent vectors stored next to it as columns."""
    rates = A @ flat.reshape(4, -1)
    drive = math.sin(omega * t + tau)
    rates[2, 0] += force[0] * drive
    rates[3, 0] += force[1] * drive
    return rates.ravel()


@njit()
def compiled_rates(t: float, flat: Array, A: Array, force: Array, omega: float, tau: float) -> Array:
    """The same, entry by entry."""
    columns = flat.size // 4
    rates = np.zeros(flat.size)
    for row in range(4):
        for inner in range(4):
            entry = A[row, inner]
            if entry != 0.0:
                for column in range(columns):
                    rates[row * columns + column] += entry * flat[inner * columns + column]
    drive = math.sin(omega * t + tau)
    rates[2 * columns] += force[0] * drive
    rates[3 * columns] += force[1] * drive
    return rates


@dataclass
class GeneralIntegrator:
    """The reference: the two-mass oscillator by DOP853, event by event.

    ``state`` is (x1, x2, v1, v2) at the start of a forcing period, ``frame`` the orthonormal tangent vectors,
    ``growth`` the sums of the logarithms of their stretching over ``periods`` periods. ``keep_step``: start each flight
    with the largest step of the one before, instead of scipy's own choice.
    """

    params: dict[str, float]
    vectors: int
    rates: Callable[..., Array] = compiled_rates
    keep_step: bool = False
    state: Array = field(default_factory=lambda: np.zeros(4))
    growth: Array = field(init=False)
    periods: int = 0
    impacts: int = 0

    def __post_init__(self) -> None:
        p = self.params
        stiffness = np.array([[1.0, -1.0], [-1.0, 1.0 + p["mu_k"]]])
        inverse_mass = np.diag([1.0, 1.0 / p["mu_m"]])
        self.A = np.zeros((4, 4))
        self.A[:2, 2:] = np.eye(2)
        self.A[2:, :2] = -inverse_mass @ stiffness
        self.A[2:, 2:] = 2.0 * p["zeta"] * self.A[2:, :2]
        self.force = inverse_mass @ np.array([1.0 - p["f2"], p["f2"]])
        self.frame = np.eye(4)[:, : self.vectors]
        self.growth = np.zeros(self.vectors)
        self._step = 0.01  # used only where steps are kept
        clearance = p["b"]

        def upper(t: float, flat: Array, *_: Any) -> float:
            return float(flat[0]) - clearance

        def lower(t: float, flat: Array, *_: Any) -> float:
            return float(flat[0]) + clearance

        for event, direction in ((upper, 1.0), (lower, -1.0)):
            event.terminal = True  # type: ignore[attr-defined]
            event.direction = direction  # type: ignore[attr-defined]
        self._events = [upper, lower]

    def one_period(self, tangent: Array) -> Array:
        """Advance the state by one forcing period and return the tangent vectors (4, m) carried along."""
        p = self.params
        end = 2.0 * math.pi / p["omega"]
        arguments = (self.A, self.force, p["omega"], p["tau"])
        t, flat = 0.0, np.column_stack([self.state, tangent]).ravel()
        while t < end:
            flight = solve_ivp(
                self.rates,
                (t, end),
                flat,
                method="DOP853",
                events=self._events,
                args=arguments,
                rtol=1e-10,
                atol=1e-12,
                first_step=min(self._step, end - t) if self.keep_step else None,
            )
            t, flat = float(flight.t[-1]), flight.y[:, -1]
            if flight.t.size > 2:
                self._step = float(np.diff(flight.t).max())
            if flight.status == 1:
                flat = self._rebound(t, flat)
                self.impacts += 1
        columns = flat.reshape(4, -1)
        self.state = columns[:, 0].copy()
        return columns[:, 1:]

    def _rebound(self, t: float, flat: Array) -> Array:
        """Impact law for the state and saltation S = J + (f+ - J f-) c / (c.f-) for the tangent vectors."""
        p = self.params
        columns = flat.reshape(4, -1)
        before, tangent = columns[:, 0], columns[:, 1:]
        law = np.array([1.0, 1.0, -p["R"], 1.0])
        after = law * before
        after[0] = math.copysign(p["b"], before[0])
        arguments = (self.A, self.force, p["omega"], p["tau"])
        rates_before = self.rates(t, before, *arguments)
        correction = (self.rates(t, after, *arguments) - law * rates_before) / rates_before[0]
        return np.column_stack([after, law[:, None] * tangent + np.outer(correction, tangent[0])]).ravel()

    def run(self, periods: int) -> None:
        """Advance by this many periods, orthonormalising after each, and add up the logarithms."""
        for _ in range(periods):
            self.frame, upper_triangle = np.linalg.qr(self.one_period(self.frame))
            self.growth += np.log(np.abs(np.diag(upper_triangle)))
        self.periods += periods

    def restart_average(self) -> None:
        """Reset the growth; state and frame stay."""
        self.growth, self.periods, self.impacts = np.zeros(self.vectors), 0, 0

    @property
    def exponents(self) -> Array:
        """Averages per forcing period, largest first."""
        return np.sort(self.growth / self.periods)[::-1]
