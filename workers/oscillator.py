"""From mass, damping and stiffness matrices to the blocks, rows and columns that the kernels run on.

The records hold plain tuples: Numba keeps those in registers and unrolls the loops over blocks, where an
array inside a record costs a reference count at every use.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Row = tuple[float, ...]
Rows = tuple[Row, ...]

LARGEST_ANGLE = 3e7
"""Radians of free oscillation in a forcing period up to which elementary.sin_cos reduces angles exactly."""


class Block(NamedTuple):
    """h'' + 2 eta h' + lam h = 0 with what its flow needs.

    d = lam - eta^2; w = sqrt|d| and its inverse (0 for w = 0); the decay rates, both eta unless overdamped; 1 / lam.
    """

    eta: float
    lam: float
    d: float
    w: float
    inv_w: float
    slow: float
    fast: float
    inv_lam: float


def make_block(eta: float, lam: float) -> Block:
    """The block of that damping and stiffness, lam > 0."""
    d = lam - eta * eta
    w = math.sqrt(abs(d))
    fast = eta + (w if d < 0.0 else 0.0)
    slow = lam / fast if d < 0.0 else eta
    return Block(eta, lam, d, w, 1.0 / w if w > 0.0 else 0.0, slow, fast, 1.0 / lam)


class Signal(NamedTuple):
    """A scalar output of a damped linear oscillator: offset + sum_j row_j . u_j(t) + Y(t).

    Block j carries u_j = (h, h') with h'' + 2 eta h' + lam h = 0; Y = sin_part sin(phi) + cos_part cos(phi)
    is the forced part at the forcing phase phi = omega t + tau, of the given amplitude |Y|.
    ``row``, ``row1`` and ``row2`` (n, 2) give the homogeneous part of the signal, of its first and of its
    second derivative.
    """

    eta: Row
    lam: Row
    block: tuple[Block, ...]
    row: Rows
    row1: Rows
    row2: Rows
    sin_part: float
    cos_part: float
    amplitude: float
    omega: float
    offset: float


class Held(NamedTuple):
    """The motion while the impacting coordinate rests on a stop at y = y_s: n - 1 blocks of its own.

    down (n-1, n) takes free block coordinates to held ones, its transpose goes back.
    static (n-1,) is the rest displacement per unit y_s; forced (n-1, 2, 2) the forced response
    [block, (h, h'), (sin, cos)]; release is the free acceleration of the gap coordinate per unit offset y_s.
    """

    down: Rows
    static: Row
    forced: tuple[Rows, ...]
    release: Signal


class Oscillator(NamedTuple):
    """A linear oscillator whose gap coordinate y moves between stops at -b_lower and +b_upper.

    gap            the signal y(t); its rows are c, cA and cA^2
    kick           (n, 2): the column k that an impact kicks along, cA.k = 1, c.k = 0
    kick1          (n, 2): A k
    cA2k           cA^2.k, minus the damping rate that the gap coordinate feels
    forced         (n, 2, 2): forced response of the blocks, [block, (h, h'), (sin, cos)]
    to_physical    (n, n): displacements = to_physical @ h, velocities = to_physical @ h'
    to_blocks      (n, n): its inverse
    gap_row        (n,): y = gap_row . displacements
    period, tau    forcing period 2 pi / omega and forcing phase at a section
    trace          trace of M^-1 C, the rate at which a flight contracts volume
    """

    gap: Signal
    kick: Rows
    kick1: Rows
    cA2k: float
    forced: tuple[Rows, ...]
    to_physical: Rows
    to_blocks: Rows
    gap_row: Row
    b_upper: float
    b_lower: float
    R: float
    period: float
    tau: float
    trace: float
    held: Held


def mass_spring(
    *,
    mass: Array,
    damping: Array,
    stiffness: Array,
    gap_row: Array,
    force: Array,
    omega: float,
    tau: float,
    b_upper: float,
    b_lower: float,
    R: float,
) -> Oscillator:
    """The oscillator M x'' + C x' + K x = force sin(omega t + tau) with stops on y = gap_row . x.

    The damping must be classical (diagonal in the undamped modes), as proportional damping is.
    Raises ValueError, in one line, for a free rigid mode, for damping that is not classical, for undamped
    resonance, where no periodic forced response exists, and for a forcing period of more free oscillations than
    double precision keeps the phase of.
    """
    n = len(gap_row)
    lam, modes = _modes(mass, stiffness)
    eta = _modal_damping(modes, damping)
    mobility = float(gap_row @ np.linalg.solve(mass, gap_row))
    response = _response(lam, eta, modes.T @ force, omega)
    participation = gap_row @ modes
    gap = _signal(lam, eta, np.column_stack([participation, np.zeros(n)]), response, (0.0, 0.0), omega, 0.0)
    period = 2.0 * math.pi / omega
    if max((block.w for block in gap.block if block.d > 0.0), default=0.0) * period > LARGEST_ANGLE:
        raise ValueError(f"a forcing period spans more than {LARGEST_ANGLE:g} radians of a free oscillation")
    kick = np.column_stack([np.zeros(n), participation / mobility])
    return Oscillator(
        gap=gap,
        kick=_tuples(kick),
        kick1=_tuples(np.column_stack([kick[:, 1], -2.0 * eta * kick[:, 1]])),
        cA2k=float(np.sum(np.array(gap.row2) * kick)),
        forced=_tuples(response),
        to_physical=_tuples(modes),
        to_blocks=_tuples(modes.T @ mass),
        gap_row=_tuples(gap_row),
        b_upper=b_upper,
        b_lower=b_lower,
        R=R,
        period=period,
        tau=math.remainder(tau, 2.0 * math.pi),
        trace=float(2.0 * np.sum(eta)),
        held=_held(mass, damping, stiffness, gap_row, force, omega, modes),
    )


def _held(
    mass: Array, damping: Array, stiffness: Array, gap_row: Array, force: Array, omega: float, modes: Array
) -> Held:
    """The oscillator with y fixed: x = N q + d y_s, with N spanning the null space of the gap row."""
    mass_inv_gap = np.linalg.solve(mass, gap_row)
    d = mass_inv_gap / (gap_row @ mass_inv_gap)
    null = _null_space(gap_row)
    lam, psi = _modes(null.T @ mass @ null, null.T @ stiffness @ null)
    shapes = null @ psi
    eta = _modal_damping(psi, null.T @ damping @ null)
    response = _response(lam, eta, shapes.T @ force, omega)
    static = -(shapes.T @ stiffness @ d) / lam
    row = np.column_stack([-(mass_inv_gap @ stiffness @ shapes), -(mass_inv_gap @ damping @ shapes)])
    offset = -float(mass_inv_gap @ stiffness @ (d + shapes @ static))
    return Held(
        down=_tuples(shapes.T @ mass @ modes),
        static=_tuples(static),
        forced=_tuples(response),
        release=_signal(lam, eta, row, response, (float(mass_inv_gap @ force), 0.0), omega, offset),
    )


def _modes(mass: Array, stiffness: Array) -> tuple[Array, Array]:
    """Squared frequencies and mass-normalised modes: modes.T M modes = I, modes.T K modes = diag(lam)."""
    if len(mass) == 0:
        return np.zeros(0), np.zeros((0, 0))
    half = np.linalg.cholesky(mass)
    lam, vectors = np.linalg.eigh(np.linalg.solve(half, np.linalg.solve(half, stiffness).T))
    if not lam[0] > 0.0:
        raise ValueError("the stiffness leaves a free rigid mode")
    return lam, np.linalg.solve(half.T, vectors)


def _modal_damping(modes: Array, damping: Array) -> Array:
    """eta_j = phi_j.T C phi_j / 2 of classical damping."""
    modal = modes.T @ damping @ modes
    eta = np.diag(modal) / 2.0
    if np.any(np.abs(modal - np.diag(2.0 * eta)) > 1e-9 * np.max(np.abs(modal), initial=0.0)):
        raise ValueError("the damping is not classical: it couples the undamped modes")
    return np.maximum(eta, 0.0)


def _response(lam: Array, eta: Array, force: Array, omega: float) -> Array:
    """Forced response f Im(e^(i phi) / (lam - omega^2 + 2 i eta omega)) of each block and its velocity."""
    stiffness = (lam - omega**2) + 2j * eta * omega
    if np.any((np.abs(stiffness) < 1e-13 * (lam + omega**2)) & (force != 0.0)):
        raise ValueError("undamped resonance: no periodic forced response exists")
    H = np.where(force == 0.0, 0.0, force) / np.where(stiffness == 0.0, 1.0, stiffness)
    displacement = np.column_stack([H.real, H.imag])
    velocity = omega * np.column_stack([-H.imag, H.real])
    return np.stack([displacement, velocity], axis=1)


def _signal(
    lam: Array, eta: Array, row: Array, response: Array, direct: tuple[float, float], omega: float, offset: float
) -> Signal:
    """The signal row . (free + forced blocks) + direct . (sin, cos), its derivative rows from row -> row A."""
    sin_part, cos_part = np.einsum("jk,jkp->p", row, response) + np.asarray(direct)
    row1 = _derivative(row, lam, eta)
    return Signal(
        eta=_tuples(eta),
        lam=_tuples(lam),
        block=tuple(make_block(float(e), float(k)) for e, k in zip(eta, lam, strict=True)),
        row=_tuples(row),
        row1=_tuples(row1),
        row2=_tuples(_derivative(row1, lam, eta)),
        sin_part=float(sin_part),
        cos_part=float(cos_part),
        amplitude=math.hypot(sin_part, cos_part),
        omega=omega,
        offset=offset,
    )


def _derivative(row: Array, lam: Array, eta: Array) -> Array:
    """row A, block by block: d/dt (r1 h + r2 h') = -lam r2 h + (r1 - 2 eta r2) h'."""
    return np.column_stack([-lam * row[:, 1], row[:, 0] - 2.0 * eta * row[:, 1]])


def _null_space(row: Array) -> Array:
    """An orthonormal basis (n, n - 1) of the vectors that the row sends to zero."""
    _, _, vh = np.linalg.svd(row[None, :])
    return np.asarray(vh[1:].T)


def _tuples(values: Array) -> Any:
    """Nested tuples of floats."""
    return tuple(float(v) if np.ndim(v) == 0 else _tuples(v) for v in values)
