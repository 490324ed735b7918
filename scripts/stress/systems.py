"""Random cells of random systems: any linear machine with one gap, as a definition table for ``solve_tile``."""

import math
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from mpmath import mp

from scripts.stress.cells import log_uniform
from scripts.stress.findings import Params, RandomCell
from tests.support.oracle import OracleMachine
from tests.support.oracle.machines import random_machine

SIZES = (1, 2, 3, 8)
"""Numbers of masses."""
CELLS = 20
"""Cells per system, which differ in omega, tau, R, the stops and the initial state."""


@lru_cache(maxsize=64)
def system(seed: int, index: int) -> tuple[dict[str, Any], OracleMachine]:
    """System ``index`` of a seed, as a table of numbers, and as an equal machine for the oracle.

    Masses, springs and dashpots as ``random_machine`` draws them: full matrices; no damping, proportional, general or
    internal; rigid modes with and without a load; one stop or two. Half of the systems are measured in units of
    length, time and mass that are powers of two away from 1.
    """
    rng = np.random.default_rng([seed, 1, index])
    drawn = random_machine(rng, int(rng.choice(SIZES)))
    machine = _in_units(drawn, *(2.0**k for k in _exponents(rng)))
    n = len(machine.gap_row)
    table: dict[str, Any] = {
        "name": f"random-{index}",
        "coordinates": [f"x{i + 1}" for i in range(n)],
        "mass": _rows(machine.mass),
        "damping": _rows(machine.damping),
        "stiffness": _rows(machine.stiffness),
        "harmonics": [
            {
                "order": k,
                "force": [math.hypot(s, c) for s, c in zip(sine, cosine, strict=True)],
                "phase": [math.atan2(c, s) for s, c in zip(sine, cosine, strict=True)],
            }
            for k, (sine, cosine) in enumerate(zip(_rows(machine.force_sin), _rows(machine.force_cos), strict=True), 1)
        ],
        "load": _list(machine.load),
        "gap": _list(machine.gap_row),
        "restitution": "R",
        "parameters": {"omega": {"default": float(machine.omega)}, "R": {"default": float(machine.R)}},
    }
    for name, stop in (("upper", float(machine.upper)), ("lower", float(machine.lower))):
        if math.isfinite(stop):
            table[name] = name
            table["parameters"][name] = {"default": stop}
    return table, _with_forces_of(machine, table["harmonics"])


def draw_of_system(seed: int, number: int) -> RandomCell:
    """Cell ``number`` of the systems of a seed; depends on these two alone.

    omega within a factor 3 of the system's, R anywhere in [0, 1] with R = 0, R = 1 and next to it mixed in, gaps from
    a twentieth to twice the system's; starts between the stops, on one where a state can lie on it exactly, beyond one.
    """
    table, base = system(seed, number // CELLS)
    rng = np.random.default_rng([seed, 2, number])
    upper, lower = _stops(rng, base)
    omega = float(base.omega) * log_uniform(rng, 1 / 3, 3.0)
    start = _start(rng, base, upper, lower)
    machine = replace(
        base, omega=omega, tau=float(rng.uniform(-math.pi, math.pi)), R=_restitution(rng, float(base.R)),
        upper=upper, lower=lower, start=start,
    )  # fmt: skip
    states = (*table["coordinates"], *(f"v{name[1:]}" for name in table["coordinates"]))
    params: Params = {"omega": omega, "tau": float(machine.tau), "R": float(machine.R)}
    params |= {name: stop for name, stop in (("upper", upper), ("lower", lower)) if math.isfinite(stop)}
    params |= dict(zip(states, start, strict=True))
    trace = float(np.trace(np.linalg.solve(np.asarray(base.mass), np.asarray(base.damping))))
    return RandomCell(number, table, params, machine, states, tuple(_list(base.gap_row)), upper, lower, trace)


def _exponents(rng: np.random.Generator) -> tuple[int, ...]:
    """Powers of two of the units of length, time and mass."""
    return tuple(int(k) for k in rng.integers(-12, 13, 3)) if rng.random() < 0.5 else (0, 0, 0)


def _in_units(machine: OracleMachine, length: float, time: float, mass: float) -> OracleMachine:
    """The machine in other units; powers of two change no digit."""
    force = mass * length / time**2
    x, v = np.split(np.asarray(machine.start), 2)
    return replace(
        machine,
        mass=np.asarray(machine.mass) * mass,
        damping=_symmetric(np.asarray(machine.damping)) * (mass / time),
        stiffness=np.asarray(machine.stiffness) * (mass / time**2),
        force_sin=np.asarray(machine.force_sin) * force,
        force_cos=np.asarray(machine.force_cos) * force,
        load=np.asarray(machine.load) * force,
        omega=float(machine.omega) / time,
        upper=float(machine.upper) * length,
        lower=float(machine.lower) * length,
        start=np.concatenate([x * length, v * (length / time)]),
    )


def _symmetric(matrix: Any) -> Any:
    """The matrix with its upper triangle, changed by rounding, copied from the lower one."""
    return np.tril(matrix) + np.tril(matrix, -1).T


def _with_forces_of(machine: OracleMachine, harmonics: list[dict[str, Any]]) -> OracleMachine:
    """The machine with exactly the forces of a table's amplitudes and phases."""
    with mp.workdps(40):
        parts = [
            [
                [mp.mpf(a) * of(mp.mpf(p)) for a, p in zip(harmonic["force"], harmonic["phase"], strict=True)]
                for harmonic in harmonics
            ]
            for of in (mp.cos, mp.sin)
        ]
    return replace(machine, force_sin=parts[0], force_cos=parts[1])


def _restitution(rng: np.random.Generator, usual: float) -> float:
    kind = rng.random()
    if kind < 0.3:
        return usual
    if kind < 0.38:
        return 0.0
    if kind < 0.46:
        return 1.0
    return 1.0 - log_uniform(rng, 1e-8, 1e-1) if kind < 0.5 else float(rng.random())


def _stops(rng: np.random.Generator, machine: OracleMachine) -> tuple[float, float]:
    """Stops about a common middle, each with its own gap; a single one shifted."""
    upper, lower = float(machine.upper), float(machine.lower)
    if math.isfinite(upper) and math.isfinite(lower):
        middle, half = (upper + lower) / 2, (upper - lower) / 2 * log_uniform(rng, 0.05, 2.0)
        other = half if upper == -lower or rng.random() < 0.5 else half * float(rng.uniform(0.2, 1.0))
        return (half, -half) if upper == -lower and rng.random() < 0.8 else (middle + half, middle - other)
    y = float(np.asarray(machine.gap_row) @ np.asarray(machine.start)[: len(machine.gap_row)])
    at = upper if math.isfinite(upper) else lower
    at += (at - y) * float(rng.uniform(-0.5, 1.0))
    return (at, lower) if math.isfinite(upper) else (upper, at)


def _start(rng: np.random.Generator, machine: OracleMachine, upper: float, lower: float) -> list[float]:
    """A state between the stops, at rest at zero, on a stop or beyond one; velocities of every size."""
    g, given = np.asarray(machine.gap_row, dtype=float), np.asarray(machine.start, dtype=float)
    n = len(g)
    x = given[:n] * rng.normal(size=n)
    v = given[n:] * rng.normal(size=n) * log_uniform(rng, 1e-2, 10.0)
    wide = upper - lower if math.isfinite(upper - lower) else abs(float(g @ given[:n])) + float(np.abs(g) @ np.abs(x))
    stop, inward = (
        (upper, -1.0) if math.isfinite(upper) and (rng.random() < 0.5 or lower == -math.inf) else (lower, 1.0)
    )
    x += g * (stop + inward * wide * float(rng.uniform(0.02, 0.98)) - g @ x) / (g @ g)
    kind = rng.random()
    if kind < 0.05:
        return [0.0] * (2 * n)
    if kind < 0.25 and np.count_nonzero(g) == 1 and np.max(g) == 1.0:
        at = int(np.argmax(g))
        x[at] = stop
        v[at] *= float(rng.integers(2))
    elif kind > 0.98:
        x -= g * inward * (wide * float(rng.uniform(1.0, 3.0))) / (g @ g)
    return _list(np.concatenate([x, v]))


def _list(values: Any) -> list[float]:
    return [float(value) for value in values]


def _rows(matrix: Any) -> list[list[float]]:
    return [_list(row) for row in matrix]
