"""The two-mass oscillator of Li & Tan (2011) as linear systems: free, and with mass 1 held on a stop.

x1'' = -(x1 - x2) - 2 zeta (x1' - x2') + (1 - f2) sin(omega t + tau)
mu_m x2'' = x1 - (1 + mu_k) x2 + 2 zeta (x1' - (1 + mu_k) x2') + f2 sin(omega t + tau)
"""

from collections.abc import Mapping
from dataclasses import dataclass

from mpmath import mp

from tests.oracle.linear import LinearSystem, Number, Row

X1, X2, V1, V2, SIN, COS = range(6)  # free state: displacements, velocities, sine and cosine of the forcing's phase
H_X2, H_V2, H_SIN, H_COS, H_ONE = range(5)  # held state: mass 2, the forcing, and the constant 1

NAMES = ("omega", "b", "R", "zeta", "mu_m", "mu_k", "f2", "tau")
STATES = ("x1", "x2", "v1", "v2")


@dataclass(frozen=True)
class Model:
    """The oscillator at one set of parameters, in the working precision of the moment it was made."""

    omega: Number
    b: Number
    R: Number
    tau: Number
    free: LinearSystem
    held_rows: tuple[Row, ...]
    held_weights: tuple[Number, ...]
    acceleration: Row  # of mass 1, on the free state

    @property
    def period(self) -> Number:
        """2 pi / omega."""
        return 2 * mp.pi / self.omega

    def phase(self, time: Number) -> tuple[Number, Number]:
        """Sine and cosine of the forcing's phase at a time since the section."""
        angle = self.omega * time + self.tau
        return mp.sin(angle), mp.cos(angle)

    def held(self, side: int) -> LinearSystem:
        """Mass 2 while mass 1 rests on the stop at side * b."""
        rows = (self.held_rows[0], {**self.held_rows[1], H_ONE: side * self.held_rows[1][H_ONE]}, *self.held_rows[2:])
        return LinearSystem.of(rows, self.held_weights)

    def held_acceleration(self, side: int) -> Row:
        """Acceleration that mass 1 would have if it were let go, on the held state."""
        a = self.acceleration
        return {H_ONE: a[X1] * side * self.b, H_X2: a[X2], H_V2: a[V2], H_SIN: a[SIN]}


def model(params: Mapping[str, float | Number]) -> Model:
    """The oscillator from its parameters; doubles are taken as the exact numbers that they are."""
    omega, b, R, zeta, mu_m, mu_k, f2, tau = (mp.mpf(params[name]) for name in NAMES)
    one, stiff = mp.one, 1 + mu_k
    first = {X1: -one, X2: one, V1: -2 * zeta, V2: 2 * zeta, SIN: 1 - f2}
    second = {X1: 1 / mu_m, X2: -stiff / mu_m, V1: 2 * zeta / mu_m, V2: -2 * zeta * stiff / mu_m, SIN: f2 / mu_m}
    oscillation = [{COS: omega}, {SIN: -omega}]
    # Weights of about the natural frequencies: they make the norm of B about the fastest rate in the system.
    fast = mp.sqrt(max(2 * one, (1 + stiff) / mu_m))
    drive = 10 * max(abs(1 - f2), abs(f2) / mu_m, mp.mpf("1e-30")) / fast**2
    weights = (one, one, 1 / fast, 1 / fast, drive, drive)
    held_rows: tuple[dict[int, Number], ...] = (
        {H_V2: one},
        {H_X2: second[X2], H_V2: second[V2], H_SIN: second[SIN], H_ONE: b / mu_m},
        {H_COS: omega},
        {H_SIN: -omega},
        {},
    )
    return Model(
        omega=omega,
        b=b,
        R=R,
        tau=tau,
        free=LinearSystem.of([{V1: one}, {V2: one}, first, second, *oscillation], weights),
        held_rows=held_rows,
        held_weights=(one, 1 / fast, drive, drive, 10 * b / mu_m / fast**2),
        acceleration=first,
    )
