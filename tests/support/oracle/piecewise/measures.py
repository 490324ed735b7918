"""Measures of a motion: shares of time, losses, extremes; integrals of the legs' Taylor polynomials."""

import math
from collections import defaultdict
from typing import Any

import numpy as np
from mpmath import mp
from numpy.typing import NDArray

from tests.support.oracle.linear import Number, Row, TaylorSeries
from tests.support.oracle.piecewise.machine import PiecewiseMachine, Vector
from tests.support.oracle.piecewise.mode_law import ModeLaw, ModeLaws, PiecewiseMode, side_of
from tests.support.oracle.piecewise.motion import PiecewiseRun, simulate

Array = NDArray[np.float64]

POINTS = 32  # on a leg, among which a maximum is sought


def measures(
    machine: PiecewiseMachine, state: Vector, periods: int = 1, *, mode: PiecewiseMode | None = None, digits: int = 40
) -> dict[str, Any]:
    """Shares of time, energies per forcing period and extremes over a motion of this many periods.

    ``contact_fraction`` (a contact) and ``stick_fraction`` (a friction element); ``rms`` (n,) of x;
    ``max_penetration`` and ``max_force`` over all soft contacts; ``stop_loss``, ``friction_loss`` and ``damper_loss``
    per period, and the ``work`` of forces and load; ``progress`` (n,) of x per period, its ``low`` and ``high`` ends.
    """
    with mp.workdps(digits):
        meter = _Meter(machine)
        run = simulate(machine, state, periods, mode=mode, digits=digits, observe=meter.leg)
        return meter.result(run, periods)


def _integral(p: Array, q: Array, u: float) -> float:
    """Integral of p q from 0 to u."""
    product = np.convolve(p, q)
    return float(u * np.polynomial.polynomial.polyval(u, product / np.arange(1, len(product) + 1)))


def _maximum(p: Array, u: float) -> float:
    """Largest value of p on [0, u], which has few maxima: the best of POINTS, then Newton's method on the slope."""
    value = np.polynomial.polynomial.polyval
    slope = np.arange(1, len(p)) * p[1:]
    curve = np.arange(1, len(slope)) * slope[1:]
    points = u * np.arange(POINTS + 1) / POINTS
    s = best = points[np.argmax(value(points, p))]
    for _ in range(8):
        bend = value(s, curve)
        if bend >= 0.0:
            break
        s = min(max(s - value(s, slope) / bend, 0.0), u)
    return float(max(value(s, p), value(best, p)))


class _Meter:
    def __init__(self, machine: PiecewiseMachine) -> None:
        self.machine = machine
        self.sums: dict[Any, float] = defaultdict(float)
        self.most: dict[str, float] = defaultdict(float)
        self.ends: dict[tuple[int, int], float] = defaultdict(lambda: -math.inf)

    def leg(
        self, laws: ModeLaws, mode: PiecewiseMode, law: ModeLaw, series: TaylorSeries, flown: Number, whole: Number
    ) -> None:
        """Add one leg, flown to a share of its whole step; its polynomials are exact, what is made of them doubles."""
        machine, n, u, step = laws.machines[mode.phase], self.machine.n, float(flown), float(whole)
        time = u * step

        def along(functional: Row) -> Array:
            return np.array(series.of(functional)[0], dtype=np.float64)

        self.sums["time"] += time
        velocities = [along({n + i: mp.one}) for i in range(n)]
        for i in range(n):
            x = along({i: mp.one})
            self.sums["square", i] += step * _integral(x, x, u)
            for side in (1, -1):
                self.ends[i, side] = max(self.ends[i, side], _maximum(side * x, u))
            applied: Row = {laws.size - 1: mp.mpf(machine.load[i])}
            for force in machine.forces:
                at = 2 * n + 2 * laws.orders.index(force.order)
                applied |= {at: mp.mpf(force.sin[i]), at + 1: mp.mpf(force.cos[i])}
            self.sums["work"] += step * _integral(along(applied), velocities[i], u)
        for i, row in enumerate(machine.damping):
            for j, entry in enumerate(row):
                if entry:
                    self.sums["damper"] += float(entry) * step * _integral(velocities[i], velocities[j], u)
        for i, (contact, state) in enumerate(zip(machine.contacts, mode.contacts, strict=True)):
            if state == "open" or contact.restitution is not None:
                continue
            side = side_of(state)
            depth = along(laws.position(contact.row, contact.stops[side], side))
            self.most["depth"] = max(self.most["depth"], _maximum(depth, u))
            if state[:-1] == "engaged":
                push, speed = along(laws.push(contact, side)), along(laws.velocity(contact.row, 0, side))
                self.sums["contact", i] += time
                self.sums["stop"] += step * _integral(push, speed, u)
                self.most["force"] = max(self.most["force"], _maximum(push, u))
        for i, (friction, state) in enumerate(zip(machine.friction, mode.friction, strict=True)):
            if state == "stick":
                self.sums["stick", i] += time
                continue
            speed = along(laws.velocity(friction.row, friction.belt, side_of(state)))
            self.sums["friction"] += float(friction.kinetic) * step * _integral(speed, np.ones(1), u)
            self.sums["friction"] += float(friction.slope) * step * _integral(speed, speed, u)

    def result(self, run: PiecewiseRun, periods: int) -> dict[str, Any]:
        """The measures of the motion."""
        machine, sums, time = self.machine, self.sums, self.sums["time"]
        laws = ModeLaws(machine)
        for event in run.events:
            if event.kind == "impact":
                contact = machine.contacts[event.index]
                row = mp.matrix([mp.mpf(value) for value in contact.row])
                mass = 1 / (row.T * laws.inverse * row)[0]
                sums["stop"] += float((1 - mp.mpf(contact.restitution) ** 2) * mass * event.value**2 / 2)
        start, end = run.sections[0], run.sections[-1]
        return {
            "contact_fraction": [sums["contact", i] / time for i in range(len(machine.contacts))],
            "stick_fraction": [sums["stick", i] / time for i in range(len(machine.friction))],
            "rms": [math.sqrt(sums["square", i] / time) for i in range(machine.n)],
            "max_penetration": self.most["depth"],
            "max_force": self.most["force"],
            "stop_loss": sums["stop"] / periods,
            "friction_loss": sums["friction"] / periods,
            "damper_loss": sums["damper"] / periods,
            "work": sums["work"] / periods,
            "low": [-self.ends[i, -1] for i in range(machine.n)],
            "high": [self.ends[i, 1] for i in range(machine.n)],
            "progress": [float((end[i] - start[i]) / periods) for i in range(machine.n)],
        }


__all__ = ["measures"]
