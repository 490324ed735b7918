"""Flights and rests of a machine by one matrix exponential, in displacements and velocities: a twin of the oracle's."""

from typing import Any

from mpmath import mp

from tests.support.oracle.linear import Number
from tests.support.oracle.model import OracleMachine


def rates(machine: OracleMachine, held: bool) -> Any:
    """Matrix of z' = B z for z = (x, v, sin k phi..., cos k phi..., 1); held: without acceleration of the gap.

    Held, x'' = P M^-1 (F - C x' - K x), P = 1 - M^-1 g g^T / (g M^-1 g): the stop's force has no other effect.
    """
    n, H = len(machine.gap_row), len(machine.force_sin)
    M, C, K = (mp.matrix([list(map(mp.mpf, row)) for row in rows])
               for rows in (machine.mass, machine.damping, machine.stiffness))  # fmt: skip
    g = mp.matrix([mp.mpf(value) for value in machine.gap_row])
    forces = mp.zeros(n, 2 * H + 1)
    for k in range(H):
        for i in range(n):
            forces[i, k], forces[i, H + k] = mp.mpf(machine.force_sin[k][i]), mp.mpf(machine.force_cos[k][i])
    for i in range(n):
        forces[i, 2 * H] = mp.mpf(machine.load[i])
    softness = mp.lu_solve(M, g)
    P = mp.eye(n) - softness * g.T / (g.T * softness)[0] if held else mp.eye(n)
    accelerations = P * mp.inverse(M)
    B = mp.zeros(2 * n + 2 * H + 1)
    for i in range(n):
        B[i, n + i] = 1
    blocks = (-accelerations * K, -accelerations * C, accelerations * forces)
    for first, block in zip((0, n, 2 * n), blocks, strict=True):
        for i in range(n):
            for j in range(block.cols):
                B[n + i, first + j] = block[i, j]
    for k in range(H):
        sine, cosine = 2 * n + k, 2 * n + H + k
        B[sine, cosine], B[cosine, sine] = (k + 1) * mp.mpf(machine.omega), -(k + 1) * mp.mpf(machine.omega)
    return B


def flown(machine: OracleMachine, state: Any, span: Number, start: Number = 0, held: bool = False) -> list[Number]:
    """Displacements and velocities a time span after ``state``, which is at the time ``start`` since the section."""
    n, H = len(machine.gap_row), len(machine.force_sin)
    phi = machine.omega * mp.mpf(start) + machine.tau
    drive = [f(k * phi) for f in (mp.sin, mp.cos) for k in range(1, H + 1)]
    z = mp.matrix([*(mp.mpf(value) for value in state), *drive, mp.one])
    return list(mp.expm(rates(machine, held) * span) * z)[: 2 * n]
