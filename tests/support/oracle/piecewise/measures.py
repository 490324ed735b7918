"""Measures of a motion: shares of time, losses, extremes; integrals of the legs' Taylor polynomials."""

from collections import defaultdict
from typing import Any

from mpmath import mp

from tests.support.oracle.linear import Number, Row, TaylorSeries
from tests.support.oracle.piecewise.machine import PiecewiseMachine, Vector
from tests.support.oracle.piecewise.mode_law import ModeLaw, ModeLaws, PiecewiseMode, side_of
from tests.support.oracle.piecewise.motion import PiecewiseRun, simulate

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


class _Meter:
    def __init__(self, machine: PiecewiseMachine) -> None:
        self.machine = machine
        self.sums: dict[Any, Number] = defaultdict(lambda: mp.zero)
        self.most: dict[str, Number] = defaultdict(lambda: mp.zero)
        self.ends: dict[tuple[int, int], Number] = defaultdict(lambda: -mp.inf)

    def leg(
        self, laws: ModeLaws, mode: PiecewiseMode, law: ModeLaw, series: TaylorSeries, u: Number, step: Number
    ) -> None:
        """Add one leg, flown to u of its step."""
        machine, n, time = laws.machines[mode.phase], self.machine.n, u * step

        def along(functional: Row) -> list[Number]:
            return series.of(functional)[0]

        self.sums["time"] += time
        velocities = [along({n + i: mp.one}) for i in range(n)]
        for i in range(n):
            x = along({i: mp.one})
            self.sums["square", i] += step * _integral(x, x, u)
            for side in (1, -1):
                self.ends[i, side] = max(self.ends[i, side], _maximum([side * a for a in x], u))
            applied: Row = {laws.size - 1: mp.mpf(machine.load[i])}
            for force in machine.forces:
                at = 2 * n + 2 * laws.orders.index(force.order)
                applied |= {at: mp.mpf(force.sin[i]), at + 1: mp.mpf(force.cos[i])}
            self.sums["work"] += step * _integral(along(applied), velocities[i], u)
        for i, row in enumerate(machine.damping):
            for j, entry in enumerate(row):
                if entry:
                    self.sums["damper"] += mp.mpf(entry) * step * _integral(velocities[i], velocities[j], u)
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
            self.sums["friction"] += mp.mpf(friction.kinetic) * step * _integral(speed, [mp.one], u)
            self.sums["friction"] += mp.mpf(friction.slope) * step * _integral(speed, speed, u)

    def result(self, run: PiecewiseRun, periods: int) -> dict[str, Any]:
        """The measures of the motion."""
        machine, sums, time = self.machine, self.sums, self.sums["time"]
        laws = ModeLaws(machine)
        for event in run.events:
            if event.kind == "impact":
                contact = machine.contacts[event.index]
                row = mp.matrix([mp.mpf(value) for value in contact.row])
                mass = 1 / (row.T * laws.inverse * row)[0]
                sums["stop"] += (1 - mp.mpf(contact.restitution) ** 2) * mass * event.value**2 / 2
        start, end = run.sections[0], run.sections[-1]
        return {
            "contact_fraction": [float(sums["contact", i] / time) for i in range(len(machine.contacts))],
            "stick_fraction": [float(sums["stick", i] / time) for i in range(len(machine.friction))],
            "rms": [float(mp.sqrt(sums["square", i] / time)) for i in range(machine.n)],
            "max_penetration": float(self.most["depth"]),
            "max_force": float(self.most["force"]),
            "stop_loss": float(sums["stop"] / periods),
            "friction_loss": float(sums["friction"] / periods),
            "damper_loss": float(sums["damper"] / periods),
            "work": float(sums["work"] / periods),
            "low": [-float(self.ends[i, -1]) for i in range(machine.n)],
            "high": [float(self.ends[i, 1]) for i in range(machine.n)],
            "progress": [float((end[i] - start[i]) / periods) for i in range(machine.n)],
        }


def _integral(p: list[Number], q: list[Number], u: Number) -> Number:
    """Integral of p q from 0 to u."""
    powers = [u]
    for _ in range(len(p) + len(q)):
        powers.append(powers[-1] * u)
    return mp.fsum(mp.fdot((a * powers[i + j] / (i + j + 1), b) for j, b in enumerate(q)) for i, a in enumerate(p) if a)


def _maximum(p: list[Number], u: Number) -> Number:
    """Largest value of p on [0, u], which has few maxima: the best of POINTS, then Newton's method on the slope."""
    slope = [k * a for k, a in enumerate(p)][1:]
    curve = [k * a for k, a in enumerate(slope)][1:]
    best = max((u * k / POINTS for k in range(POINTS + 1)), key=lambda s: _value(p, s))
    s = best
    for _ in range(8):
        bend = _value(curve, s)
        if bend >= 0:
            break
        s = min(max(s - _value(slope, s) / bend, mp.zero), u)
    return max(_value(p, s), _value(p, best))


def _value(p: list[Number], s: Number) -> Number:
    """p(s), the coefficients in ascending order."""
    result = mp.zero
    for coefficient in reversed(p):
        result = result * s + coefficient
    return result


__all__ = ["measures"]
