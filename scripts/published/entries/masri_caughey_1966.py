"""A free mass that hits both walls of its container in turn, half a period apart, and so damps the container.

Between impacts the free mass moves at the speed U. An impact of relative speed w changes it by 2 U = (1 + R) w /
(1 + mu), and the main mass by J = 2 mu U. The free part of the main mass's motion, (u, u') after the impact at the
upper stop, satisfies (E + 1) (u, u') = (0, J), where E is the free flow over half a period, so that it is J (g0, g1).
With theta the phase of its forced part, of amplitude F, the clearance 1 and the times of flight give

    F sin theta = U pi / (2 omega) - 1 - J g0,    F cos theta = U (1 - 2 mu g1 + 2 mu - 2 (1 + mu) / (1 + R)) / omega,

a quadratic equation for U. The multipliers come from the derivative of half a turn.
"""

from collections.abc import Callable
from math import cos, exp, hypot, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import brentq

from scripts.published.entry import PublishedEntry, Statement
from scripts.published.helpers import cell, event

MU, ZETA, R = 0.02, 0.005, 0.65
Array = NDArray[np.float64]


def _free(omega: float) -> tuple[float, float]:
    """g0 and g1."""
    rate, half = sqrt(1.0 - ZETA**2), pi / omega
    decay, c, s = exp(-ZETA * half), cos(rate * half), sin(rate * half) / rate
    a11, a12, a21, a22 = 1.0 + decay * (c + ZETA * s), decay * s, -decay * s, 1.0 + decay * (c - ZETA * s)
    det = a11 * a22 - a12 * a21
    return -a12 / det, a11 / det


def orbit(omega: float, A: float) -> tuple[float, float, float]:
    """U of the faster symmetric orbit, F sin theta and F cos theta."""
    (g0, g1), F = _free(omega), A / hypot(1.0 - omega**2, 2.0 * ZETA * omega)
    a = pi / (2.0 * omega) - 2.0 * MU * g0
    b = (1.0 - 2.0 * MU * g1 + 2.0 * MU - 2.0 * (1.0 + MU) / (1.0 + R)) / omega
    U = (a + sqrt(a**2 - (a**2 + b**2) * (1.0 - F**2))) / (a**2 + b**2)
    return U, a * U - 1.0, b * U


def speed(omega: float, A: float) -> float:
    """Relative speed before an impact."""
    return 2.0 * (1.0 + MU) * orbit(omega, A)[0] / (1.0 + R)


def half_turn(omega: float, A: float) -> Array:
    """Derivative of the map from just after an impact to just after the next one, mirrored; (x1, x2, v1, v2)."""
    (U, sine, cosine), (_, g1) = orbit(omega, A), _free(omega)
    J, w = 2.0 * MU * U, speed(omega, A)
    flow = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, -2 * ZETA, 0], [0, 0, 0, 0]], dtype=float)
    kick = np.array([MU, -1.0]) * (1.0 + R) / (1.0 + MU)
    jump = np.eye(4)
    jump[2:, 2:] += np.outer(kick, [-1.0, 1.0])
    x1, v1 = sine + J * _free(omega)[0], omega * cosine + J * g1 - J
    force = (1.0 - omega**2) * sine + 2.0 * ZETA * omega * cosine
    before = np.array([v1, U, force - 2.0 * ZETA * v1 - x1, 0.0])
    after = np.array([v1 + J, -U, force - 2.0 * ZETA * (v1 + J) - x1, 0.0])
    saltation = jump + np.outer(after - jump @ before, [-1.0, 1.0, 0.0, 0.0]) / w
    return -saltation @ expm(flow * pi / omega)


def flutter(omega: float) -> float:
    """The amplitude of the force at which a pair of multipliers is on the unit circle, below the symmetry breaking."""

    def outside(A: float) -> float:
        return float(np.max(np.abs(np.linalg.eigvals(half_turn(omega, A))))) - 1.0

    return _root(outside, omega)


def breaking(omega: float) -> float:
    """The amplitude of the force at which a multiplier of the mirrored half turn is -1."""
    return _root(lambda A: float(np.linalg.det(half_turn(omega, A) + np.eye(4))), omega)


def _root(test: Callable[[float], float], omega: float) -> float:
    """The first zero along A, of amplitudes at which the orbit exists."""
    values = np.arange(0.012, 0.05, 0.0005)
    signs = [test(A) for A in values]
    k = next(k for k in range(len(values) - 1) if signs[k] * signs[k + 1] < 0.0)
    return float(brentq(test, values[k], values[k + 1], xtol=1e-14))


def statements() -> list[Statement]:
    """Speed and largest exponent of a symmetric orbit, and where it loses its symmetry."""
    found = []
    for omega, A in ((1.0, 0.025), (1.01, 0.025)):
        given = {"omega": omega, "A": A, "mu": MU, "zeta": ZETA, "R": R, "xi": 0.0}
        solved = cell("energy-sink", given)
        exponent = float(2.0 * np.log(np.abs(np.linalg.eigvals(half_turn(omega, A)))).max())
        where = f"omega = {omega}"
        found += [
            Statement(f"{where}, A = {A}: impacts at each wall in a period", "1 and 1",
                      f"{solved['impacts_upper']} and {solved['impacts_lower']}"),
            Statement(f"{where}, A = {A}: speed before an impact", speed(omega, A), solved["max_impact_speed"]),
            Statement(f"{where}, A = {A}: largest exponent", exponent, solved["largest"]),
            Statement(f"{where}: A at the symmetry breaking", breaking(omega),
                      event("energy-sink", given, "A", (0.01, 0.06), "symmetry_breaking")),
            Statement(f"{where}: A below which a pair of multipliers leaves the unit circle", flutter(omega),
                      event("energy-sink", given, "A", (0.01, 0.06), "neimark_sacker")),
        ]  # fmt: skip
    return found


ENTRY = PublishedEntry(
    name="masri-caughey-1966",
    work="S. F. Masri and T. K. Caughey, J. Appl. Mech. 33 (1966) 586",
    place="the steady motion with two impacts half a period apart, and its stability",
    title="Impact damper",
    machine=f"System `energy-sink`, mu = {MU}, zeta = {ZETA}, R = {R}, xi = 0.",
    statements=statements,
    commands=(
        "atlas branch --system energy-sink --set xi=0 --set omega=1 --set A=0.025 --along A --from 0.01 --to 0.06",
    ),
)
