"""One mass on a spring, with a contact and friction whose laws are tables, by DOP853 from event to event.

    x'' + c x' + k x = A cos omega t - push - rub

push = law(d) + damping d' beyond ``stop`` by d > 0, never below 0; rub = law(|v|) sgn v at v = x' - belt, up to
``static`` at v = 0. Shares nothing with the solver, nor with the multiprecision simulator.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

CLOSE: dict[str, Any] = {"rtol": 1e-12, "atol": 1e-13, "max_step": 0.05}
"""Longest step: no guard rises and falls within it; sticking is exact at any step."""

Table = Sequence[tuple[float, float]]


@dataclass(frozen=True)
class SegmentedMass:
    """The numbers of the equation; an empty table means no contact or no friction."""

    c: float
    k: float
    A: float
    omega: float
    contact: Table = ()
    stop: float = 0.0
    damping: float = 0.0
    friction: Table = ()
    static: float = 0.0
    belt: float = 0.0


def simulate(
    mass: SegmentedMass, state: Sequence[float], periods: int
) -> tuple[NDArray[np.float64], list[tuple[float, str]]]:
    """The state after some periods of the force, and the events with their times."""
    t, end, z = 0.0, periods * 2.0 * np.pi / mass.omega, np.array(state, float)
    depth = z[0] - mass.stop
    touch, rub = ("open", 0) if not mass.contact or depth <= 0.0 else ("on", _segment(mass.contact, depth)), ("none", 0)
    if mass.friction:
        sliding = z[1] - mass.belt
        rub = ("+" if sliding > 0.0 else "-", _segment(mass.friction, abs(sliding)))
    happened = []
    while t < end:
        events = [*_of_contact(mass, *touch), *_of_friction(mass, *rub, touch)]
        held = touch, rub

        def rate(t: float, z: Any, held: Any = held) -> list[float]:
            return [z[1], 0.0 if held[1][0] == "stick" else _force(mass, t, z, *held)]

        for guard, _ in events:
            guard.terminal, guard.direction = True, 1.0  # type: ignore[attr-defined]
        solution = solve_ivp(rate, (t, end), z, "DOP853", events=[guard for guard, _ in events], **CLOSE)
        t, z = float(solution.t[-1]), solution.y[:, -1]
        for (_, name), times in zip(events, solution.t_events or (), strict=True):
            if len(times) and t < end:
                happened.append((t, name))
                touch, rub = _after(mass, name, touch, rub, t, z)
                if rub[0] == "stick":
                    z[1] = mass.belt
                    needed = _force(mass, t, z, touch, rub)
                    if name not in ("stop", "slip+", "slip-") and abs(needed) > mass.static:  # a contact has jumped
                        rub = "+" if needed > 0.0 else "-", 0
                break
    return z, happened


def _segment(table: Table, at: float) -> int:
    return max(0, sum(x < at for x, _ in table[:-1]) - 1)


def _law(table: Table, j: int, at: float) -> float:
    (x, F), (x1, F1) = table[j], table[j + 1]
    return F + (F1 - F) / (x1 - x) * (at - x)


def _push(mass: SegmentedMass, j: int, z: Any) -> float:
    return _law(mass.contact, j, z[0] - mass.stop) + mass.damping * float(z[1])


def _force(mass: SegmentedMass, t: float, z: Any, touch: tuple[str, int], rub: tuple[str, int]) -> float:
    """The acceleration; for sticking without the friction that holds it."""
    total = mass.A * np.cos(mass.omega * t) - mass.c * z[1] - mass.k * z[0]
    if touch[0] == "on":
        total -= _push(mass, touch[1], z)
    if rub[0] in "+-":
        sign = 1.0 if rub[0] == "+" else -1.0
        total -= sign * _law(mass.friction, rub[1], sign * (z[1] - mass.belt))
    return float(total)


Guards = list[tuple[Callable[[float, Any], float], str]]


def _of_contact(mass: SegmentedMass, state: str, j: int) -> Guards:
    """Functions that rise through 0 where the contact changes."""
    if not mass.contact:
        return []
    if state == "open":
        return [(lambda _, z: z[0] - mass.stop, "hit")]
    guards: Guards = [(lambda _, z: mass.stop + mass.contact[j][0] - z[0], "open" if j == 0 else "shallower")]
    if j + 2 < len(mass.contact):
        guards.append((lambda _, z: z[0] - mass.stop - mass.contact[j + 1][0], "deeper"))
    sign = -1.0 if state == "on" else 1.0
    return [*guards, (lambda _, z: sign * _push(mass, j, z), "detach" if state == "on" else "engage")]


def _of_friction(mass: SegmentedMass, state: str, j: int, touch: tuple[str, int]) -> Guards:
    """Functions that rise through 0 where friction changes."""
    if not mass.friction:
        return []
    if state == "stick":

        def needed(t: float, z: Any) -> float:
            return _force(mass, t, z, touch, ("stick", 0))

        return [(lambda t, z: needed(t, z) - mass.static, "slip+"), (lambda t, z: -needed(t, z) - mass.static, "slip-")]
    sign, table = (1.0 if state == "+" else -1.0), mass.friction
    guards: Guards = [(lambda _, z: table[j][0] - sign * (z[1] - mass.belt), "stop" if j == 0 else "slower")]
    if j + 2 < len(table):
        guards.append((lambda _, z: sign * (z[1] - mass.belt) - table[j + 1][0], "faster"))
    return guards


def _after(
    mass: SegmentedMass, name: str, touch: tuple[str, int], rub: tuple[str, int], t: float, z: Any
) -> tuple[tuple[str, int], tuple[str, int]]:
    """States of contact and friction after an event."""
    if name in ("hit", "open"):
        return ("on" if name == "hit" else "open", 0), rub
    if name in ("shallower", "deeper"):
        return (touch[0], touch[1] + (1 if name == "deeper" else -1)), rub
    if name in ("detach", "engage"):
        return ("off" if name == "detach" else "on", touch[1]), rub
    if name in ("slower", "faster"):
        return touch, (rub[0], rub[1] + (1 if name == "faster" else -1))
    if name in ("slip+", "slip-"):
        return touch, (name[-1], 0)
    needed = _force(mass, t, z, touch, ("stick", 0))
    if abs(needed) <= mass.static:
        return touch, ("stick", 0)
    return touch, ("+" if needed > 0.0 else "-", 0)


__all__ = ["SegmentedMass", "simulate"]
