"""The symmetric orbit with one impact a side, by linear algebra only."""

from collections.abc import Mapping
from dataclasses import dataclass

from mpmath import mp

from tests.oracle.linear import Number
from tests.oracle.model import SIN, V1, model


@dataclass(frozen=True)
class SymmetricOrbit:
    """An impact at the upper stop every n periods, and its mirror image half way.

    ``time`` of the upper impact since the section, in [0, T); ``before`` and ``after`` are (x1, x2, v1, v2) around
    it; ``exponents`` per forcing period, largest first. Nothing here says that the flight stays between the stops.
    """

    time: Number
    before: list[Number]
    after: list[Number]
    exponents: list[Number]


def symmetric_orbit(params: Mapping[str, float | Number], n: int = 1, digits: int = 40) -> list[SymmetricOrbit]:
    """The candidates (none or two, with an outward velocity at the stop) for an odd period n.

    With E = exp(A n T/2), rho = diag(1, 1, -R, 1) and the forced response z_p, half a period takes the state after an
    impact to the mirror image of the state before one:  z+ = (1 + rho E)^-1 rho (1 + E) z_p(theta), and x1 = b gives
    the phase theta. Multipliers are the squared eigenvalues of S E, S the saltation matrix.
    """
    with mp.workdps(digits):
        made = model(params)
        A = mp.matrix(4)
        load = mp.matrix(4, 1)
        for i, row in enumerate(made.free.rows[:4]):
            for j, entry in row.items():
                if j < 4:
                    A[i, j] = entry
                elif j == SIN:
                    load[i] = entry
        one = mp.eye(4)
        E = mp.expm(A * (n * made.period / 2))
        rho = mp.diag([1, 1, -made.R, 1])
        # z_p = sine part * sin + cosine part * cos solves z' = A z + load sin
        cosine = -made.omega * mp.lu_solve(A * A + made.omega**2 * one, load)
        sine = A * cosine / made.omega
        to_after = mp.inverse(one + rho * E) * rho * (one + E)
        after_sine, after_cosine = to_after * sine, to_after * cosine
        size, shift = mp.hypot(after_sine[0], after_cosine[0]), mp.atan2(after_cosine[0], after_sine[0])
        if size < made.b:
            return []
        orbits = []
        for theta in (mp.asin(made.b / size) - shift, mp.pi - mp.asin(made.b / size) - shift):
            after = after_sine * mp.sin(theta) + after_cosine * mp.cos(theta)
            before = (one + E) * (sine * mp.sin(theta) + cosine * mp.cos(theta)) - E * after
            if before[V1] <= 0:
                continue
            before[0] = after[0] = made.b  # theta was chosen so; now without its rounding
            drive = load * mp.sin(theta)
            jump = (A * after + drive) - rho * (A * before + drive)
            saltation = rho.copy()
            for i in range(4):
                saltation[i, 0] += jump[i] / before[V1]
            multipliers = mp.eig(saltation * E, left=False, right=False)
            exponents = sorted((2 * mp.log(abs(value)) / n for value in multipliers), reverse=True)
            time = (theta - made.tau) / made.omega
            time -= made.period * mp.floor(time / made.period)
            orbits.append(SymmetricOrbit(time, list(before), list(after), exponents))
        return orbits
