"""Microseconds per forcing period of the solver, as a ratio to a general integrator measured in the same run.

The cells are those of Figs 3, 4 and 5 of Li & Tan (2011); one or all four Lyapunov exponents. The reference is
scipy's DOP853 (rtol 1e-10, atol 1e-12) with event location at the stops, the variational equations beside the
state, the saltation matrix at every impact and one QR per period. It is measured twice: plain, with the right-hand
side in numpy and scipy's own first step after each impact; and tuned, with a right-hand side compiled by Numba and the
step size kept across impacts.

All are timed in processor time on one core, best of several: the solver as the difference of two lengths of the same
run, so that start-up and transient cancel, the reference after its transient. Each prints the exponents it found.

Usage: .venv/bin/python scripts/bench_kernel.py [--light] [--json]
"""

import argparse
import json
import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from workers import Settings, solve_tile

Array = NDArray[np.float64]

_FIG = {"tau": math.pi, "R": 0.8}
FIGURES = {
    "3": {**_FIG, "mu_k": 5.0, "mu_m": 2.0, "zeta": 0.05, "f2": 0.0, "omega": 4.0, "b": 0.1},
    "4": {**_FIG, "mu_k": 4.0, "mu_m": 6.0, "zeta": 0.5, "f2": 2.0, "omega": 1.0, "b": 0.2},
    "5": {**_FIG, "mu_k": 2.0, "mu_m": 2.0, "zeta": 0.5, "f2": 5.0, "omega": 3.0, "b": 0.2},
}
SETTINGS_NAME = {1: "largest", 4: "spectrum"}


def numpy_rates(t: float, flat: Array, A: Array, force: Array, omega: float, tau: float) -> Array:
    """d/dt of (x1, x2, v1, v2) and of the tangent vectors stored beside it as columns."""
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
    ``growth`` the sums of the logarithms of their stretching and ``periods`` how many periods went into it.
    ``keep_step``: start each flight with the largest step of the one before, instead of scipy's own choice.
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
        """Advance by that many periods, orthonormalising after each, and add up the logarithms."""
        for _ in range(periods):
            self.frame, upper_triangle = np.linalg.qr(self.one_period(self.frame))
            self.growth += np.log(np.abs(np.diag(upper_triangle)))
        self.periods += periods

    def restart_average(self) -> None:
        """Forget the growth so far, keep state and frame."""
        self.growth, self.periods, self.impacts = np.zeros(self.vectors), 0, 0

    @property
    def exponents(self) -> Array:
        """Averages per forcing period, largest first."""
        return np.sort(self.growth / self.periods)[::-1]


def processor_seconds(work: Callable[[], object]) -> float:
    """Processor time that a call takes."""
    start = time.process_time()
    work()
    return time.process_time() - start


@dataclass(frozen=True)
class Schedule:
    """How long to measure: periods of the solver's two runs, the reference's transient and average, repetitions."""

    short: int
    long: int
    warm: int
    periods: int
    repeats: int


FULL = Schedule(short=2000, long=42000, warm=30, periods=50, repeats=5)
LIGHT = Schedule(short=100, long=2100, warm=5, periods=5, repeats=2)
TRANSIENT = 200


def solver_cost(params: dict[str, float], exponents: int, schedule: Schedule) -> tuple[float, list[float]]:
    """The solver's microseconds per period, and the exponents it found."""

    def run(periods: int) -> dict[str, NDArray[Any]]:
        name = SETTINGS_NAME[exponents]
        settings = Settings(method="fixed", exponents=name, transient_periods=TRANSIENT, periods=periods)
        return solve_tile("two-mass", params, settings)

    found = run(schedule.long)  # compiles, or loads what an earlier run compiled
    long = min(processor_seconds(lambda: run(schedule.long)) for _ in range(schedule.repeats))
    short = min(processor_seconds(lambda: run(schedule.short)) for _ in range(schedule.repeats))
    averages = found["spectrum"] if exponents > 1 else found["largest"]
    return 1e6 * (long - short) / (schedule.long - schedule.short), np.atleast_1d(averages).tolist()


def reference_cost(integrator: GeneralIntegrator, schedule: Schedule) -> tuple[float, list[float]]:
    """The reference's microseconds per period after a transient, and the exponents over the same periods."""
    integrator.run(schedule.warm)
    integrator.restart_average()
    seconds = min(processor_seconds(lambda: integrator.run(schedule.periods)) for _ in range(schedule.repeats))
    return 1e6 * seconds / schedule.periods, integrator.exponents.tolist()


def measure(schedule: Schedule) -> list[dict[str, Any]]:
    """One row per figure and number of exponents."""
    rows = []
    for figure, params in FIGURES.items():
        for exponents in (1, 4):
            ours, found = solver_cost(params, exponents, schedule)
            plain, check = reference_cost(GeneralIntegrator(params, exponents, numpy_rates), schedule)
            tuned, _ = reference_cost(GeneralIntegrator(params, exponents, compiled_rates, keep_step=True), schedule)
            rows.append(
                {
                    "figure": figure,
                    "exponents": exponents,
                    "solver_us_per_period": ours,
                    "dop853_us_per_period": plain,
                    "dop853_tuned_us_per_period": tuned,
                    "ratio": plain / ours,
                    "ratio_tuned": tuned / ours,
                    "solver_exponents": found,
                    "dop853_exponents": check,
                }
            )
    return rows


def one_core() -> None:
    """Stay on one core, so that both sides run on the same one."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--light", action="store_true", help="short runs: seconds, rough numbers")
    parser.add_argument("--json", action="store_true", help="one JSON list on standard output, nothing else")
    options = parser.parse_args()
    one_core()
    rows = measure(LIGHT if options.light else FULL)
    if options.json:
        print(json.dumps(rows))
        return
    print("                 microseconds per forcing period    times faster than   exponents per forcing period:")
    print("Fig. exponents    solver     DOP853      tuned     DOP853    tuned     solver (DOP853, fewer periods)")
    for row in rows:
        ours, check = ("  ".join(f"{x:.3f}" for x in row[f"{side}_exponents"]) for side in ("solver", "dop853"))
        print(
            f"{row['figure']:>4} {row['exponents']:>9}  {row['solver_us_per_period']:>8.3f}   "
            f"{row['dop853_us_per_period']:>8.0f}   {row['dop853_tuned_us_per_period']:>8.0f}   "
            f"{row['ratio']:>8.0f} {row['ratio_tuned']:>8.0f}     {ours}  ({check})"
        )


if __name__ == "__main__":
    main()
