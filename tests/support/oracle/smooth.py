"""One mass whose spring, contact and friction have smooth laws, by DOP853 from event to event.

    x'' + c x' + spring(x) = load + A sin(omega t + phase) - push(x - stop) - rub(|v|) sgn v,   v = x' - belt

The stop is rigid, x' -> -R x', or soft with the law push; at v = 0 friction holds up to rub(0). It does not use the
package's segments of such laws.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

CLOSE: dict[str, Any] = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14, "max_step": 0.05}
"""Longest step: no guard rises and falls within it."""

Array = NDArray[np.float64]
Law = Callable[[float], float]
Happened = list[tuple[float, str, float]]


@dataclass(frozen=True)
class SmoothMass:
    """The numbers and laws of the equation; without ``rub`` there is no friction."""

    omega: float
    c: float
    A: float
    phase: float = 0.0
    load: float = 0.0
    spring: Law = float
    stop: float = float("inf")
    R: float | None = None
    push: Law | None = None
    rub: Law | None = None
    belt: float = 0.0

    def pull(self, t: float, z: Any, engaged: bool, slide: int) -> float:
        """The acceleration; while sticking, slide 0, without the friction that holds it."""
        acceleration = self.load + self.A * np.sin(self.omega * t + self.phase) - self.c * z[1] - self.spring(z[0])
        if engaged and self.push:
            acceleration -= self.push(max(0.0, z[0] - self.stop))
        if slide and self.rub:
            acceleration -= slide * self.rub(max(0.0, slide * (z[1] - self.belt)))
        return float(acceleration)


def simulate(mass: SmoothMass, state: Sequence[float] | Array, periods: int = 1) -> tuple[Array, Happened]:
    """The state after some periods of the force, and the events on the way: time, name, speed before it.

    Names: hit, open, stick, slip, and cross for a reversal of sliding.
    """
    t, end, z = 0.0, periods * 2.0 * np.pi / mass.omega, np.array(state, float)
    engaged, slide, happened = mass.push is not None and z[0] > mass.stop, 0, Happened()
    if mass.rub:
        v = z[1] - mass.belt
        slide = int(np.sign(v)) if v else _held(mass, t, z, engaged)
    while t < end:
        away, most = -1.0 if engaged else 1.0, mass.rub(0.0) if mass.rub else 0.0

        def stop(t: float, z: Any, away: float = away) -> float:
            return float(away * (z[0] - mass.stop))

        def still(t: float, z: Any, slide: int = slide) -> float:
            return float(-slide * (z[1] - mass.belt))

        def more(t: float, z: Any, on: bool = engaged, most: float = most) -> float:
            return abs(mass.pull(t, z, on, 0)) - most

        guards: dict[str, Callable[..., float]] = {"stop": stop}
        if mass.rub:
            guards |= {"still": still} if slide else {"more": more}
        for guard in guards.values():
            guard.terminal, guard.direction = True, 1.0  # type: ignore[attr-defined]

        def rate(t: float, z: Any, on: bool = engaged, slide: int = slide) -> list[float]:
            return [z[1], 0.0 if mass.rub and not slide else mass.pull(t, z, on, slide)]

        solution = solve_ivp(rate, (t, end), z, events=list(guards.values()), **CLOSE)
        t, z = float(solution.t[-1]), solution.y[:, -1]
        name = next((name for name, at in zip(guards, solution.t_events, strict=True) if len(at)), "")
        speed = float(z[1])
        if name == "stop" and mass.R is not None:
            z[1] *= -mass.R
            happened.append((t, "hit", speed))
        elif name == "stop":
            engaged = not engaged
            happened.append((t, "hit" if engaged else "open", speed))
        elif name == "more":
            slide = int(np.sign(mass.pull(t, z, engaged, 0)))
            happened.append((t, "slip", speed))
        elif name:
            slide, z[1] = _held(mass, t, z, engaged), mass.belt
            happened.append((t, "cross" if slide else "stick", speed))
    return z, happened


def _held(mass: SmoothMass, t: float, z: Array, engaged: bool) -> int:
    """0 if friction holds a mass that does not slide, else the side to which it goes."""
    assert mass.rub
    force = mass.pull(t, [z[0], mass.belt], engaged, 0)
    return 0 if abs(force) < mass.rub(0.0) else int(np.sign(force))


def orbit(mass: SmoothMass, start: Sequence[float] | Array, periods: int = 1) -> tuple[Array, Array, Happened]:
    """State and derivative (2, 2) of the periodic motion near a start, by Newton's method, and its events."""
    z, step = np.array(start, float), 1e-5
    for _ in range(12):
        ends = [simulate(mass, z + sign * step * row, periods)[0] for row in np.eye(2) for sign in (1.0, -1.0)]
        J = np.stack([(a - b) / (2.0 * step) for a, b in zip(ends[::2], ends[1::2], strict=True)], axis=1)
        end, happened = simulate(mass, z, periods)
        away = np.linalg.solve(np.eye(2) - J, end - z)
        z = z + away
        if np.max(np.abs(away)) < 1e-12:
            break
    return z, J, happened


__all__ = ["Happened", "SmoothMass", "orbit", "simulate"]
