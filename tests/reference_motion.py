"""One motion by matrix exponentials between the impacts of its trace: its range, and what feeds and drains it."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import brentq

from tests.support.oracle.free_mass import bouncing_ball_orbits
from tests.workers.model.test_systems import machine_of
from workers import Settings, solve_tile
from workers.history import trace
from workers.model.system import find_system

Array = NDArray[np.float64]

SAMPLES = 200
"""Points of a flight at which y' is looked at."""


@dataclass(frozen=True)
class Followed:
    """Of a motion over some periods: speeds and sides of impacts; least and greatest y; energy per period that the
    force puts in, that damping and that impacts take out.
    """

    speeds: Array
    sides: Array
    low: float
    high: float
    work: float
    damped: float
    lost: float


def ball_in_flight(A: float, R: float) -> dict[str, float]:
    """A bouncing ball on its stable orbit with one impact a period, at time 1 after the impact.

    At the impact itself the section would lie where the map is not smooth.
    """
    orbit = bouncing_ball_orbits(A, R)[0]
    phase, v = float(orbit.phase), float(orbit.after)
    return {
        "omega": 1.0, "A": A, "R": R, "tau": phase + 1.0,
        "y": v - 0.5 + A * (math.cos(phase) - math.sin(phase + 1.0) + math.sin(phase)),
        "v": v - 1.0 + A * (math.cos(phase) - math.cos(phase + 1.0)),
    }  # fmt: skip


def on_attractor(name: str, params: dict[str, float], settings: Settings | None = None) -> dict[str, float]:
    """The parameters with the state on the attractor in place of the initial one."""
    system = find_system(name)
    found = solve_tile(name, params, settings)
    return params | dict(zip(system.states, found["state"].tolist(), strict=True))


def follow(name: str, params: dict[str, float], periods: int) -> Followed:
    """The motion from its initial state over so many periods; it must not rest."""
    system = find_system(name)
    machine = machine_of(name, **params)
    n = machine.gap_row.size
    M, g = machine.mass, machine.gap_row
    inverse = np.linalg.inv(M)
    softness = float(g @ inverse @ g)
    # z = (x, x', sin, cos, 1)
    B = np.zeros((2 * n + 3, 2 * n + 3))
    B[:n, n : 2 * n] = np.eye(n)
    B[n : 2 * n, :n], B[n : 2 * n, n : 2 * n] = -inverse @ machine.stiffness, -inverse @ machine.damping
    B[n : 2 * n, 2 * n], B[n : 2 * n, 2 * n + 1] = inverse @ machine.force_sin[0], inverse @ machine.force_cos[0]
    B[n : 2 * n, 2 * n + 2] = inverse @ machine.load
    B[2 * n, 2 * n + 1], B[2 * n + 1, 2 * n] = machine.omega, -machine.omega
    phase = float(params.get("tau", next(p.default for p in system.parameters if p.name == "tau")))
    start = [params.get(s, next(p.default for p in system.parameters if p.name == s)) for s in system.states]
    z = np.array([*start, math.sin(phase), math.cos(phase), 1.0])
    row = np.zeros(2 * n + 3)
    row[n : 2 * n] = g
    position = np.roll(row, -n)
    T = 2.0 * math.pi / float(machine.omega)
    history = trace(name, params, periods, Settings(exponents="none"))
    ends = [*history.impacts[:, 0], periods * T]
    extremes: list[float] = []
    work = damped = lost = t = 0.0
    nodes, weights = np.polynomial.legendre.leggauss(40)
    for k, end in enumerate(ends):
        span = end - t
        flown = np.array([expm(B * s) @ z for s in np.linspace(0.0, span, SAMPLES)])
        v = flown @ row
        for i in np.flatnonzero(v[:-1] * v[1:] < 0.0):
            grid = np.linspace(0.0, span, SAMPLES)
            here = z.copy()
            at = brentq(lambda s, here=here: float(row @ expm(B * s) @ here), grid[i], grid[i + 1], xtol=1e-15)
            extremes.append(float(position @ expm(B * at) @ z))
        for node, weight in zip(nodes, weights, strict=True):
            state = expm(B * (0.5 * span * (node + 1.0))) @ z
            velocity, drive = state[n : 2 * n], state[2 * n : 2 * n + 2]
            force = machine.force_sin[0] * drive[0] + machine.force_cos[0] * drive[1] + machine.load
            work += 0.5 * span * weight * float(velocity @ force)
            damped += 0.5 * span * weight * float(velocity @ machine.damping @ velocity)
        z, t = expm(B * span) @ z, end
        if k < len(history.impacts):
            extremes.append(float(position @ z))
            approach = float(row @ z)
            before = 0.5 * z[n : 2 * n] @ M @ z[n : 2 * n]
            z[n : 2 * n] -= (1.0 + float(machine.R)) * approach * (inverse @ g) / softness
            lost += float(before - 0.5 * z[n : 2 * n] @ M @ z[n : 2 * n])
    return Followed(
        history.impacts[:, 2], history.impacts[:, 1], min(extremes), max(extremes),
        work / periods, damped / periods, lost / periods,
    )  # fmt: skip
