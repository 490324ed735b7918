"""A linear machine with one gap, and the linear system for the simulator's Taylor series.

M x'' + C x' + K x = sum_k (force_sin[k] sin(k phi) + force_cos[k] cos(k phi)) + load,   phi = omega t + tau
lower <= y <= upper,   y = g.x;   an impact turns y' into -R y' by an impulse along M^-1 g

The series are those of q = T x: q[0] = y, and the others u_j = x_j - y k_j, k = M^-1 g / (g M^-1 g), of all coordinates
but the one with the largest entry in g. The force of a stop has no effect on u: an impact changes only y', and while y
rests on a stop u obeys the equations of free flight.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpmath import mp
from numpy.typing import NDArray

from tests.support.oracle.linear import LinearSystem, Number, Row

Vector = Sequence[Number] | NDArray[np.float64]
Rows = Sequence[Sequence[Number]] | NDArray[np.float64]

Y = 0  # index of the gap coordinate in q

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


@dataclass(frozen=True)
class OracleModel:
    """A machine in the working precision at its construction.

    A state of ``free`` is (q, q', drive), the drive (sin k phi, cos k phi for each of ``harmonics``, 1).
    """

    n: int
    omega: Number
    tau: Number
    R: Number
    stops: dict[int, Number]  # position by side, of the finite ones
    harmonics: tuple[int, ...]
    free: LinearSystem
    gap_row: tuple[Number, ...]
    to_gap: Any  # T, an mpmath matrix
    from_gap: Any  # its inverse
    start: tuple[Number, ...]

    @property
    def period(self) -> Number:
        """2 pi / omega."""
        return 2 * mp.pi / self.omega

    @property
    def acceleration(self) -> Row:
        """The free acceleration of the gap coordinate, as a functional of the state."""
        return self.free.rows[self.n + Y]

    def drive(self, time: Number) -> list[Number]:
        """The drive at a time since the section."""
        angle = self.omega * time + self.tau
        return [f(k * angle) for k in self.harmonics for f in (mp.sin, mp.cos)] + [mp.one]

    def state(self, physical: Sequence[Number], time: Number) -> list[Number]:
        """The state of displacements and velocities (2n,) at a time since the section."""
        x, v = (mp.matrix([mp.mpf(value) for value in half]) for half in (physical[: self.n], physical[self.n :]))
        return [*(self.to_gap * x), *(self.to_gap * v), *self.drive(time)]

    def physical(self, state: Sequence[Number]) -> list[Number]:
        """Displacements and velocities (2n,) of a state."""
        q, rates = mp.matrix(state[: self.n]), mp.matrix(state[self.n : 2 * self.n])
        return [*(self.from_gap * q), *(self.from_gap * rates)]

    def held(self) -> LinearSystem:
        """The motion with the gap coordinate at rest in its place."""
        rows = [{} if i in (Y, self.n + Y) else row for i, row in enumerate(self.free.rows)]
        return LinearSystem.of(rows, self.free.weights)


def model(cell: Cell) -> OracleModel:
    """The machine of a cell, ready for simulation."""
    machine = machine_of(cell)
    n = len(machine.gap_row)
    g, load = _vector(machine.gap_row), _vector(machine.load)
    M, C, K = (_matrix(rows) for rows in (machine.mass, machine.damping, machine.stiffness))
    omega = mp.mpf(machine.omega)
    inverse = mp.inverse(M)
    T = _to_gap(inverse, g)
    from_gap = mp.inverse(T)
    stiffness, damping = T * inverse * K * from_gap, T * inverse * C * from_gap
    forces, harmonics = [], []
    for k, pair in enumerate(zip(machine.force_sin, machine.force_cos, strict=True), start=1):
        sine, cosine = (_vector(force) for force in pair)
        if any(sine) or any(cosine):
            forces += [T * inverse * sine, T * inverse * cosine]
            harmonics.append(k)
    forces.append(T * inverse * load)
    rows: list[Row] = [{n + i: mp.one} for i in range(n)]
    for i in range(n):
        entries = [-stiffness[i, j] for j in range(n)] + [-damping[i, j] for j in range(n)] + [f[i] for f in forces]
        rows.append({j: entry for j, entry in enumerate(entries) if entry != 0})
    for index, k in enumerate(harmonics):
        sine_at = 2 * n + 2 * index
        rows += [{sine_at + 1: k * omega}, {sine_at: -k * omega}]
    rows.append({})
    sides = {1: mp.mpf(machine.upper), -1: mp.mpf(machine.lower)}
    return OracleModel(
        n=n,
        omega=omega,
        tau=mp.mpf(machine.tau),
        R=mp.mpf(machine.R),
        stops={side: stop for side, stop in sides.items() if mp.isfinite(stop)},
        harmonics=tuple(harmonics),
        free=LinearSystem.of(rows, _weights(rows, n, omega)),
        gap_row=tuple(g),
        to_gap=T,
        from_gap=from_gap,
        start=tuple(mp.mpf(value) for value in machine.start) or (mp.zero,) * (2 * n),
    )


def _vector(values: Vector) -> Any:
    return mp.matrix([mp.mpf(value) for value in values])


def _matrix(rows: Rows) -> Any:
    return mp.matrix([[mp.mpf(value) for value in row] for row in rows])


def _to_gap(inverse_mass: Any, g: Any) -> Any:
    """T: the gap row first, then the rows of u_j."""
    n = len(g)
    k = inverse_mass * g
    k /= (g.T * k)[0]
    eliminated = max(range(n), key=lambda j: abs(g[j]))
    T = mp.zeros(n)
    T[Y, :] = g.T
    for row, j in enumerate((j for j in range(n) if j != eliminated), start=1):
        for column in range(n):
            T[row, column] = -k[j] * g[column]
        T[row, j] += 1
    return T


def _weights(rows: Sequence[Row], n: int, omega: Number) -> list[Number]:
    """Weights that make the norm of B about the fastest rate in the system, for few steps; any weights are valid.

    Weights of (q, q') approximate the inverse of the Perron vector of |A| by a few steps of power iteration; weights of
    the drive make its share in the norm a tenth.
    """
    A = np.zeros((2 * n, 2 * n))
    for i, row in enumerate(rows[: 2 * n]):
        for j, entry in row.items():
            if j < 2 * n:
                A[i, j] = abs(float(entry))
    rate = max(float(np.sqrt(A[n:, :n].sum(axis=1).max())), float(omega))
    A[n:, :n] = np.maximum(A[n:, :n], float(omega) ** 2 * np.eye(n))
    shape = np.array([1.0] * n + [rate] * n)
    for _ in range(12):
        shape = A @ shape + rate * shape
        shape /= shape[0]
    weights = [1 / mp.mpf(value) for value in shape]
    count = len(rows) - 2 * n
    felt = max(
        (abs(entry) * weights[i] for i in range(n, 2 * n) for j, entry in rows[i].items() if j >= 2 * n),
        default=mp.zero,
    )
    return weights + [10 * count * max(felt, mp.mpf("1e-30")) / mp.mpf(rate)] * count
