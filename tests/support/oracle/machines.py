"""Machines to simulate: single masses, a ball, a mass in a box, chains, and random machines of every kind."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tests.support.oracle.linear import Number
from tests.support.oracle.model import OracleMachine

Array = NDArray[np.float64]
Generator = np.random.Generator


def single_mass(
    *, damping: Number, stiffness: Number, force_sin: Number = 0, force_cos: Number = 0, load: Number = 0,
    omega: Number, R: Number, tau: Number = 0, upper: Number = math.inf, lower: Number = -math.inf,
    start: tuple[Number, ...] = (),
) -> OracleMachine:  # fmt: skip
    """x'' + damping x' + stiffness x = force_sin sin(phi) + force_cos cos(phi) + load with stops on x."""
    return OracleMachine(
        mass=[[1]],
        damping=[[damping]],
        stiffness=[[stiffness]],
        gap_row=[1],
        force_sin=[[force_sin]],
        force_cos=[[force_cos]],
        load=[load],
        omega=omega,
        tau=tau,
        upper=upper,
        lower=lower,
        R=R,
        start=start,
    )


def bouncing_ball(gamma: Number, R: Number, tau: Number = 0, start: tuple[Number, ...] = ()) -> OracleMachine:
    """Height y of a ball above a shaken table: y'' = -1 + gamma sin(t + tau), y >= 0.

    The table is at (A/g) sin(t + tau) in units of g / omega^2; gamma = A omega^2 / g.
    """
    return single_mass(damping=0, stiffness=0, force_sin=gamma, load=-1, omega=1, R=R, tau=tau, lower=0, start=start)


def impact_pair(clearance: Number, R: Number, tau: Number = 0, start: tuple[Number, ...] = ()) -> OracleMachine:
    """A free mass in a box shaken by alpha sin(omega t + tau): y'' = sin(t + tau), |y| <= clearance / 2.

    Lengths in units of alpha: clearance = nu / alpha, nu the distance between the stops.
    """
    half = clearance / 2
    return single_mass(damping=0, stiffness=0, force_sin=1, omega=1, R=R, tau=tau, upper=half, lower=-half, start=start)


DAMPINGS = ("none", "proportional", "general", "internal")
"""No damping; a K + b M; any semidefinite matrix, often of low rank; dashpots without effect on a rigid mode."""


def random_machine(
    rng: Generator,
    n: int,
    *,
    rigid: bool | None = None,
    damping: str | None = None,
    one_sided: bool | None = None,
    R: float | None = None,
) -> OracleMachine:
    """A machine of n masses with a state inside its stops; unspecified properties are drawn too.

    Mass and stiffness are full matrices. A ``rigid`` machine has one rigid mode, which the gap sees: its stiffness is
    singular in exact arithmetic. The force has up to four harmonics with phases of their own, half of the machines a
    load. Stops are equal, unequal or a single one. No runaway machines (a rigid mode that no load drives to the only
    stop), and none near an undamped resonance, free or held.
    """
    for _ in range(1000):
        drawn = _draw(
            rng,
            n,
            rigid=bool(rng.random() < 0.3) if rigid is None else rigid,
            damping=str(rng.choice(DAMPINGS, p=[0.1, 0.3, 0.4, 0.2])) if damping is None else damping,
            one_sided=bool(rng.random() < 0.4) if one_sided is None else one_sided,
            R=float(rng.choice([0.0, 0.3, 0.6, 0.8, 0.95, 1.0, rng.random()])) if R is None else R,
        )
        if drawn is not None and not _resonates(drawn):
            return drawn
    raise ArithmeticError("no sound machine in 1000 draws")


def rigid_mode(machine: OracleMachine) -> Array:
    """The displacement (n,) without effect on the springs, of unit length."""
    vector: Array = np.linalg.svd(np.asarray(machine.stiffness, dtype=float))[2][-1]
    return vector


def _draw(rng: Generator, n: int, *, rigid: bool, damping: str, one_sided: bool, R: float) -> OracleMachine | None:
    shape = np.eye(n) + np.tril(rng.choice([-0.5, 0.0, 0.5], (n, n)), -1)
    M = _positive(rng, n, 0.4, 4.0)
    K = _springs(rng, shape) if rigid else _positive(rng, n, 0.2, 20.0)
    H = int(rng.integers(1, 5))
    force = rng.normal(size=(2, H, n)) / np.arange(1, H + 1)[:, None]
    force *= rng.random((2, H, 1)) < 0.7
    machine = OracleMachine(
        mass=M,
        damping=_damping(rng, damping, shape, M, K),
        stiffness=K,
        gap_row=_gap_row(rng, n),
        force_sin=force[0],
        force_cos=force[1],
        load=rng.normal(size=n) if rng.random() < 0.5 else np.zeros(n),
        omega=float(rng.uniform(0.5, 4.0)),
        tau=float(rng.uniform(-math.pi, math.pi)),
        upper=math.inf,
        lower=-math.inf,
        R=R,
    )
    size = float(np.sum(np.abs(_response(machine))))
    if size < 1e-3:
        return None
    return _with_stops(rng, machine, size, rigid, one_sided)


def _positive(rng: Generator, n: int, low: float, high: float) -> Array:
    """A symmetric matrix with random eigenvectors, and eigenvalues in this range."""
    Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    matrix = Q @ np.diag(np.exp(rng.uniform(math.log(low), math.log(high), n))) @ Q.T
    return (matrix + matrix.T) / 2


def _springs(rng: Generator, shape: Array) -> Array:
    """Springs among the coordinates shape @ x, none to the ground: dyadic numbers, for exact singularity."""
    n = len(shape)
    laplacian = np.zeros((n, n))
    for i in range(1, n):
        for j in {int(rng.integers(0, i)), int(rng.integers(0, i))}:
            ends = np.eye(n)[i] - np.eye(n)[j]
            laplacian += rng.integers(4, 128) / 16 * np.outer(ends, ends)
    return shape.T @ laplacian @ shape


def _damping(rng: Generator, kind: str, shape: Array, M: Array, K: Array) -> Array:
    n = len(M)
    strength = math.exp(rng.uniform(math.log(0.01), math.log(1.0)))
    if kind == "none":
        return np.zeros((n, n))
    if kind == "proportional":
        return strength * (rng.choice([0.0, 1.0]) * M + rng.uniform(0.1, 1.0) * K)
    if kind == "internal":
        return round(64 * strength + 1) / 64 * _springs(rng, shape) / 8
    dashpots = rng.normal(size=(n, int(rng.integers(1, n + 1))))
    return strength * dashpots @ dashpots.T


def _gap_row(rng: Generator, n: int) -> Array:
    kind = rng.integers(3)
    if kind == 0:
        return rng.normal(size=n)
    ends: Array = np.eye(n)[rng.integers(n)]
    return ends if kind == 1 else ends - np.eye(n)[rng.integers(n)] * (0.5 if n == 1 else 1.0)


def _response(machine: OracleMachine) -> NDArray[np.complex128]:
    """Complex amplitudes (H,) of the gap coordinate's forced motion without stops."""
    M, C, K, g = (np.asarray(part) for part in (machine.mass, machine.damping, machine.stiffness, machine.gap_row))
    amplitudes = []
    for k, (sine, cosine) in enumerate(zip(machine.force_sin, machine.force_cos, strict=True), start=1):
        w = k * machine.omega
        try:
            amplitudes.append(
                g @ np.linalg.solve(K - w**2 * M + 1j * w * C, np.asarray(cosine) - 1j * np.asarray(sine))
            )
        except np.linalg.LinAlgError:
            return np.zeros(1, dtype=complex)
    return np.array(amplitudes)


def _with_stops(
    rng: Generator, machine: OracleMachine, size: float, rigid: bool, one_sided: bool
) -> OracleMachine | None:
    """Stops about the static position or about 0, and a state between them."""
    g, load = np.asarray(machine.gap_row), np.asarray(machine.load)
    side = int(rng.choice([1, -1]))
    middle = 0.0
    if rigid:
        mode = rigid_mode(machine)
        seen = g @ mode
        if abs(seen) < 0.2 * np.linalg.norm(g):
            return None
        if one_sided:
            push = load @ mode * np.sign(seen)
            if abs(push) < 0.2:
                return None
            side = int(np.sign(push))
    elif rng.random() < 0.7:
        middle = float(g @ np.linalg.solve(machine.stiffness, load))
    wide, narrow = rng.uniform(0.1, 0.9, 2) * size
    if one_sided:
        stop = middle + side * size * rng.uniform(-0.3, 0.9)
        ends = (-math.inf, stop) if side > 0 else (stop, math.inf)
        y = stop - side * size * rng.uniform(0.05, 1.0)
    else:
        ends = (middle - wide, middle + (wide if rng.random() < 0.4 else narrow))
        y = ends[0] + (ends[1] - ends[0]) * rng.uniform(0.05, 0.95)
    x = 0.3 * size * rng.normal(size=len(g))
    x += g * (y - g @ x) / (g @ g)
    v = 0.3 * size * machine.omega * rng.normal(size=len(g))
    return replace(machine, load=load, lower=ends[0], upper=ends[1], start=np.concatenate([x, v]))


def _resonates(machine: OracleMachine) -> bool:
    """Whether a root of the free or the held motion lies within a twentieth of a forcing harmonic."""
    M, C, K, g = (np.asarray(part) for part in (machine.mass, machine.damping, machine.stiffness, machine.gap_row))
    across = np.linalg.svd(g[None])[2][1:].T  # displacements that leave the gap unchanged
    active = np.flatnonzero(np.any(np.concatenate([machine.force_sin, machine.force_cos], axis=1), axis=1)) + 1
    for basis in (np.eye(len(g)), across):
        m, c, k = (basis.T @ matrix @ basis for matrix in (M, C, K))
        n = len(m)
        A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(m, k), -np.linalg.solve(m, c)]])
        away = np.abs(np.subtract.outer(np.linalg.eigvals(A), 1j * active * machine.omega))
        if np.any(away < 0.05 * active * machine.omega):
            return True
    return False
