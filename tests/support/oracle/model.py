"""A linear machine with one gap, as cells have it, and the same as a piecewise-linear machine for the simulator.

M x'' + C x' + K x = sum_k (force_sin[k] sin(k phi) + force_cos[k] cos(k phi)) + load,   phi = omega t + tau
lower <= y <= upper,   y = g.x;   an impact turns y' into -R y' by an impulse along M^-1 g
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpmath import mp
from numpy.typing import NDArray

from tests.support.oracle.linear import Number
from tests.support.oracle.piecewise.machine import HarmonicForce, PiecewiseContact, PiecewiseMachine
from tests.support.oracle.piecewise.mode_law import ModeLaws, PiecewiseMode

Vector = Sequence[Number] | NDArray[np.float64]
Rows = Sequence[Sequence[Number]] | NDArray[np.float64]

FLIGHT = PiecewiseMode(0, ("open",), ())
"""The mode between the stops."""

DOUBLE = 2.0**-52

NAMES = ("omega", "b", "R", "zeta", "mu_m", "mu_k", "f2", "tau")
STATES = ("x1", "x2", "v1", "v2")


@dataclass(frozen=True, eq=False)
class OracleMachine:
    """A machine and its state at t = 0; entries are doubles, taken as exact, or mpmath's numbers.

    ``mass``, ``damping``, ``stiffness`` (n, n), ``gap_row`` and ``load`` (n,); ``force_sin`` and ``force_cos`` (H, n),
    row k - 1 for the harmonic k; ``upper`` and ``lower`` positions of the stops, or infinite; ``start`` (2n,)
    displacements, then velocities, empty for rest at zero.
    """

    mass: Rows
    damping: Rows
    stiffness: Rows
    gap_row: Vector
    force_sin: Rows
    force_cos: Rows
    load: Vector
    omega: Number
    tau: Number
    upper: Number
    lower: Number
    R: Number
    start: Vector = ()


Cell = OracleMachine | Mapping[str, Any]
"""A machine, or the parameters of the two-mass oscillator with its initial state (x1, x2, v1, v2; default 0)."""


def two_mass(params: Mapping[str, float | Number]) -> OracleMachine:
    """The two-mass oscillator of Li & Tan (2011) with stops at +-b, in the working precision.

    x1'' = -(x1 - x2) - 2 zeta (x1' - x2') + (1 - f2) sin(omega t + tau)
    mu_m x2'' = x1 - (1 + mu_k) x2 + 2 zeta (x1' - (1 + mu_k) x2') + f2 sin(omega t + tau)
    """
    omega, b, R, zeta, mu_m, mu_k, f2, tau = (mp.mpf(params[name]) for name in NAMES)
    K = [[mp.one, -mp.one], [-mp.one, 1 + mu_k]]
    return OracleMachine(
        mass=[[1, 0], [0, mu_m]],
        damping=[[2 * zeta * entry for entry in row] for row in K],
        stiffness=K,
        gap_row=[1, 0],
        force_sin=[[1 - f2, f2]],
        force_cos=[[0, 0]],
        load=[0, 0],
        omega=omega,
        tau=tau,
        upper=b,
        lower=-b,
        R=R,
        start=[mp.mpf(params.get(name, 0)) for name in STATES],
    )


def machine_of(cell: Cell) -> OracleMachine:
    """The machine of a cell."""
    return cell if isinstance(cell, OracleMachine) else two_mass(cell)


def start_of(cell: Cell) -> list[Number]:
    """Displacements and velocities (2n,) at t = 0."""
    machine = machine_of(cell)
    return [mp.mpf(value) for value in machine.start] or [mp.zero] * (2 * len(machine.gap_row))


def pieces_of(cell: Cell, time: Number = 0, stops: bool = True) -> PiecewiseMachine:
    """The machine with its section at a time after t = 0; without ``stops`` they are noticed and do nothing."""
    machine = machine_of(cell)
    forces = []
    for k, (sine, cosine) in enumerate(zip(machine.force_sin, machine.force_cos, strict=True), start=1):
        angle = k * (mp.mpf(machine.omega) * time + mp.mpf(machine.tau))
        c, s = mp.cos(angle), mp.sin(angle)
        pairs = [(mp.mpf(a), mp.mpf(b)) for a, b in zip(sine, cosine, strict=True)]
        if any(a or b for a, b in pairs):
            forces.append(HarmonicForce(k, [a * c - b * s for a, b in pairs], [a * s + b * c for a, b in pairs]))
    upper, lower = (mp.mpf(stop) if mp.isfinite(stop) else None for stop in (machine.upper, machine.lower))
    gap = PiecewiseContact(list(machine.gap_row), upper, lower, machine.R if stops else None)
    mass, damping, stiffness = (
        [list(row) for row in rows] for rows in (machine.mass, machine.damping, machine.stiffness)
    )
    return PiecewiseMachine(mass, damping, stiffness, list(machine.load), machine.omega, tuple(forces), (gap,))


def on_stop(laws: ModeLaws, state: Sequence[Number]) -> list[Number]:
    """A state with its gap coordinate exactly on a stop on which it lies to within a double's rounding."""
    contact, z = laws.machine.contacts[0], [mp.mpf(value) for value in state]
    terms = [mp.mpf(entry) * x for entry, x in zip(contact.row, z, strict=False)]
    for stop in contact.stops.values():
        away = mp.fsum(terms) - stop
        if abs(away) <= 8 * DOUBLE * (mp.fsum(map(abs, terms)) + abs(stop)):
            moved = zip(z, laws.kick(contact.row), strict=False)
            return [x - away * entry for x, entry in moved] + z[laws.n :]
    return z


def fastest_rate(cell: Cell) -> float:
    """About the fastest rate of flight."""
    return float(ModeLaws(pieces_of(cell)).law(FLIGHT).system.rate)
