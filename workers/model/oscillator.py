"""From mass, damping and stiffness matrices to the blocks, rows and columns that the kernels run on.

The records hold arrays whose shapes tell the number of masses. Many oscillators are one record with another axis in
front of every field; what one of them is made of does not depend on the others, to the bit.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.results import (
    COUPLED_DAMPING,
    LONG_PERIOD,
    NO_OSCILLATOR,
    NO_REASON,
    OUT_OF_DOUBLES,
    RESONANCE,
    RIGID_MODE,
    InvalidError,
)

Array = NDArray[np.float64]

LARGEST_ANGLE = 3e7
"""Radians of free oscillation in a forcing period up to which elementary.sin_cos reduces angles exactly."""


class Block(NamedTuple):
    """h'' + 2 eta h' + lam h = 0 with what its flow and its bounds need: columns of Signal.block.

    d = lam - eta^2; w = sqrt|d| and its inverse (0 for w = 0); the decay rates, both eta unless overdamped.
    tilt, weight and grow2...grow4 are those of flight.amplitude_bounds.
    """

    eta: Any
    lam: Any
    d: Any
    w: Any
    inv_w: Any
    slow: Any
    fast: Any
    tilt: Any
    weight: Any
    grow2: Any
    grow3: Any
    grow4: Any


COLUMN = Block(*range(len(Block._fields)))
"""Columns of Signal.block by name."""


def make_blocks(eta: Array, lam: Array) -> Array:
    """Blocks (..., columns) of that damping and stiffness (...), lam > 0.

    The k-th derivative of an oscillation is at most sqrt(lam)^k times its amplitude; near critical damping, where that
    is large, its energy and q'' = -2 eta q' - lam q bound it better.
    """
    d = lam - eta * eta
    w = np.sqrt(np.abs(d))
    fast = np.where(d < 0.0, eta + w, eta)
    slow = np.where(d < 0.0, lam / np.where(d < 0.0, fast, 1.0), eta)
    root = np.sqrt(lam)
    weak = d > 0.05 * lam
    tilt, weight, twice = np.where(weak, eta, 0.0), 1.0 / np.where(weak, d, lam), np.where(weak, 0.0, 2.0 * eta)
    grow2 = lam + twice * root
    grow3 = lam * root + twice * grow2
    grow4 = lam * grow2 + twice * grow3
    inv_w = np.where(w > 0.0, 1.0 / np.where(w > 0.0, w, 1.0), 0.0)
    return np.stack([eta, lam, d, w, inv_w, slow, fast, tilt, weight, grow2, grow3, grow4], axis=-1)


class Signal(NamedTuple):
    """A scalar output of a damped linear oscillator: offset + sum_j row_j . u_j(t) + Y(t).

    Block j carries u_j = (h, h') with h'' + 2 eta h' + lam h = 0; Y = sin_part sin(phi) + cos_part cos(phi)
    is the forced part at the forcing phase phi = omega t + tau, of the given amplitude |Y|.
    ``block`` (n, columns) holds the constants of each, see Block; ``row``, ``row1`` and ``row2`` (n, 2) give the
    homogeneous part of the signal, of its first and of its second derivative.
    """

    eta: Array
    lam: Array
    block: Array
    row: Array
    row1: Array
    row2: Array
    sin_part: Any
    cos_part: Any
    amplitude: Any
    omega: Any
    offset: Any


class Held(NamedTuple):
    """The motion while the impacting coordinate rests on a stop at y = y_s: n - 1 blocks of its own.

    down (n-1, n) takes free block coordinates to held ones, its transpose goes back.
    static (n-1,) is the rest displacement per unit y_s; forced (n-1, 2, 2) the forced response
    [block, (h, h'), (sin, cos)]; release is the free acceleration of the gap coordinate per unit offset y_s.
    """

    down: Array
    static: Array
    forced: Array
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
    kick: Array
    kick1: Array
    cA2k: Any
    forced: Array
    to_physical: Array
    to_blocks: Array
    gap_row: Array
    b_upper: Any
    b_lower: Any
    R: Any
    period: Any
    tau: Any
    trace: Any
    held: Held


class Machines(NamedTuple):
    """Oscillators M x'' + C x' + K x = load + force with stops on y = gap_row . x, N of them, each with n coordinates.

    mass, damping, stiffness    (N, n, n)
    gap_row                     (N, n)
    force_sin, force_cos        (N, H, n): the force is the sum over k = 1, ..., H of
                                force_sin[:, k - 1] sin(k phi) + force_cos[:, k - 1] cos(k phi), phi = omega t + tau
    load                        (N, n)
    omega, tau                  (N,)
    upper, lower                (N,): lower <= y <= upper; an infinite one is no stop
    R                           (N,)
    """

    mass: Array
    damping: Array
    stiffness: Array
    gap_row: Array
    force_sin: Array
    force_cos: Array
    load: Array
    omega: Array
    tau: Array
    upper: Array
    lower: Array
    R: Array


def each(record: Any, act: Callable[[Any], Any]) -> Any:
    """The same record with something done to every field, those of the records in it too."""
    done = [each(field, act) if isinstance(field, tuple) else act(field) for field in record]
    return type(record)(*done)


def one_of(oscillators: Oscillator, k: int) -> Oscillator:
    """Oscillator k of many."""
    found: Oscillator = each(oscillators, lambda field: field[k].copy() if field.ndim > 1 else float(field[k]))
    return found


def many_of(osc: Oscillator) -> Oscillator:
    """One oscillator as a record of many."""
    found: Oscillator = each(osc, lambda field: np.asarray(field, dtype=np.float64)[None])
    return found


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

    Raises InvalidError, a ValueError in one line, for what ``build`` has a reason for.
    """
    force, none = np.atleast_2d(force), np.zeros_like(force)
    fields = (mass, damping, stiffness, gap_row, force, 0.0 * force, none, omega, tau, b_upper, -b_lower, R)
    return build_one(Machines(*(np.asarray(field, dtype=np.float64)[None] for field in fields)))


def build_one(machine: Machines) -> Oscillator:
    """The oscillator of the only machine; InvalidError where there is a reason against it."""
    oscillators, reasons = build(machine)
    if reasons[0] != NO_REASON:
        raise InvalidError(int(reasons[0]))
    return one_of(oscillators, 0)


def build(machines: Machines) -> tuple[Oscillator, NDArray[np.int8]]:
    """The oscillators of many machines, and the reason why there is none, or NO_REASON, of each.

    The damping must be classical (diagonal in the undamped modes), as proportional damping is. Reasons are a free rigid
    mode, damping that is not classical, undamped resonance, where no periodic forced response exists, a forcing period
    of more free oscillations than double precision keeps the phase of, and numbers beyond its range.
    """
    with np.errstate(all="ignore"):
        found = _build(Machines(*(np.ascontiguousarray(field) for field in machines)))
    return found


def _build(machines: Machines) -> tuple[Oscillator, NDArray[np.int8]]:
    mass, damping, stiffness, gap_row, force_sin, force_cos, load, omega, tau, b_upper, lower, R = machines
    N, n = gap_row.shape
    force, b_lower = np.ascontiguousarray(force_sin[:, 0]), -lower
    beyond = np.any(force_cos != 0.0, axis=(1, 2)) | np.any(force_sin[:, 1:] != 0.0, axis=(1, 2)) | load.any(axis=1)
    lam, modes = _modes(mass, stiffness)
    eta, coupled = _modal_damping(modes, damping)
    accelerance = _stacked(np.linalg.solve, (N, n, 1), mass, gap_row[..., None])[..., 0]
    participation = _row_times(gap_row, modes)
    softness = _dot(gap_row, accelerance)
    gap = _signal(lam, eta, np.stack([participation, np.zeros((N, n))], axis=-1))
    kick = np.stack([np.zeros((N, n)), participation / softness[:, None]], axis=-1)
    # The motion with y fixed: x = N q + d y_s, with N spanning the null space of the gap row.
    d = accelerance / softness[:, None]
    null = _null_space(gap_row)
    across = np.ascontiguousarray(null.swapaxes(1, 2))
    held_lam, psi = _modes(across @ mass @ null, across @ stiffness @ null)
    shapes = null @ psi
    held_eta, held_coupled = _modal_damping(psi, across @ damping @ null)
    pulls, drags = _row_times(accelerance, stiffness), _row_times(accelerance, damping)
    static = -_row_times(_row_times(d, stiffness), shapes) / held_lam
    release = _signal(held_lam, held_eta, np.stack([-_row_times(pulls, shapes), -_row_times(drags, shapes)], axis=-1))
    offset = -_dot(pulls, d + (shapes @ static[..., None])[..., 0])
    # What the force does
    forced, resonant = _response(gap, _row_times(force, modes), omega)
    held_forced, held_resonant = _response(release, _row_times(force, shapes), omega)
    period = 2.0 * np.pi / omega
    turns = np.where(gap.block[..., COLUMN.d] > 0.0, gap.block[..., COLUMN.w], 0.0) * period[:, None]
    phase = np.fmod(tau, 2.0 * np.pi)
    oscillators = Oscillator(
        gap=_with_force(gap, forced, np.zeros(N), omega),
        kick=kick,
        kick1=np.stack([kick[..., 1], -2.0 * eta * kick[..., 1]], axis=-1),
        cA2k=_dot(gap.row2[..., 1], kick[..., 1]),
        forced=forced,
        to_physical=modes,
        to_blocks=np.ascontiguousarray(modes.swapaxes(1, 2)) @ mass,
        gap_row=gap_row,
        b_upper=b_upper,
        b_lower=b_lower,
        R=R,
        period=period,
        tau=np.where(np.abs(phase) > np.pi, phase - np.copysign(2.0 * np.pi, phase), phase),
        trace=2.0 * _dot(eta, np.ones((N, n))),
        held=Held(
            down=np.ascontiguousarray(shapes.swapaxes(1, 2)) @ mass @ modes,
            static=static,
            forced=held_forced,
            release=_with_force(release._replace(offset=offset), held_forced, _dot(accelerance, force), omega),
        ),
    )
    rigid = np.any(lam <= 0.0, axis=1) | np.any(held_lam <= 0.0, axis=1)
    reasons = np.full(N, NO_REASON, dtype=np.int8)
    finite = _finite(
        oscillators._replace(b_upper=np.zeros(N), b_lower=np.zeros(N))
    )  # a stop may be infinitely far away
    for reason, holds in (
        (OUT_OF_DOUBLES, ~finite),
        (LONG_PERIOD, np.max(turns, axis=1) > LARGEST_ANGLE),
        (RESONANCE, resonant | held_resonant),
        (COUPLED_DAMPING, coupled | held_coupled),
        (RIGID_MODE, rigid),
        (NO_OSCILLATOR, beyond),
    ):
        reasons[holds] = reason
    return each(oscillators, lambda field: np.array(field, order="C")), reasons


def _finite(record: Any) -> NDArray[np.bool_]:
    """Which of many records hold finite numbers only."""
    fields = (_finite(f) if isinstance(f, tuple) else np.isfinite(f).all(axis=tuple(range(1, f.ndim))) for f in record)
    return np.asarray(np.logical_and.reduce(list(fields)))


def _stacked(act: Callable[..., Any], shape: tuple[int, ...], *matrices: Array) -> Any:
    """numpy.linalg's function of many matrices; NaN (of this shape) for those that alone it refuses."""
    try:
        return act(*matrices)
    except np.linalg.LinAlgError:
        pass
    found = np.full(shape, np.nan)
    for k, one in enumerate(zip(*matrices, strict=True)):
        try:
            found[k] = act(*one)
        except np.linalg.LinAlgError:
            continue
    return found


def _modes(mass: Array, stiffness: Array) -> tuple[Array, Array]:
    """Squared frequencies and mass-normalised modes: modes.T M modes = I, modes.T K modes = diag(lam)."""
    shape = mass.shape
    half = _stacked(np.linalg.cholesky, shape, mass)
    scaled = _stacked(np.linalg.solve, shape, half, stiffness).swapaxes(1, 2)
    both = _stacked(_values_and_vectors, (shape[0], shape[1] + 1, shape[1]),
                    _stacked(np.linalg.solve, shape, half, np.ascontiguousarray(scaled)))  # fmt: skip
    modes = _stacked(np.linalg.solve, shape, half.swapaxes(1, 2), np.ascontiguousarray(both[:, 1:]))
    return np.ascontiguousarray(both[:, 0]), np.ascontiguousarray(modes)


def _values_and_vectors(matrix: Array) -> Array:
    """Eigenvalues and, below them, eigenvectors of symmetric matrices."""
    values, vectors = np.linalg.eigh(matrix)
    return np.concatenate([values[..., None, :], vectors], axis=-2)


def _modal_damping(modes: Array, damping: Array) -> tuple[Array, NDArray[np.bool_]]:
    """eta_j = phi_j.T C phi_j / 2 of classical damping, and where it is not classical."""
    modal = np.ascontiguousarray(modes.swapaxes(1, 2)) @ damping @ modes
    eta = np.diagonal(modal, axis1=1, axis2=2) / 2.0
    beside = np.abs(modal) * (1.0 - np.eye(modal.shape[1]))
    limit = 1e-9 * np.max(np.abs(modal), axis=(1, 2), initial=0.0)
    return np.maximum(eta, 0.0), np.max(beside, axis=(1, 2), initial=0.0) > limit


def _response(signal: Signal, force: Array, omega: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Forced response f Im(e^(i phi) / (lam - omega^2 + 2 i eta omega)) of blocks and their velocities; resonance."""
    w = omega[:, None]
    re, im = signal.lam - w**2, 2.0 * signal.eta * w
    size = np.maximum(np.abs(re), np.abs(im))
    unit = np.where(size > 0.0, size, 1.0)
    re, im = re / unit, im / unit
    square = re * re + im * im
    resonant = (force != 0.0) & (size * np.sqrt(square) < 1e-13 * (signal.lam + w**2))
    share = np.where(force != 0.0, force / (square * unit), 0.0)
    sin, cos = share * re, -share * im
    response = np.stack([np.stack([sin, cos], axis=-1), np.stack([-w * cos, w * sin], axis=-1)], axis=-2)
    return response, np.any(resonant, axis=1)


def _with_force(signal: Signal, response: Array, direct: Array, omega: Array) -> Signal:
    """The signal with its forced part, row . response + direct sin(phi)."""
    N, n = signal.row.shape[:2]
    parts = (signal.row.reshape(N, 1, 2 * n) @ response.reshape(N, 2 * n, 2))[:, 0]
    sin_part, cos_part = direct + parts[:, 0], parts[:, 1].copy()
    return signal._replace(sin_part=sin_part, cos_part=cos_part, amplitude=np.hypot(sin_part, cos_part), omega=omega)


def _signal(lam: Array, eta: Array, row: Array) -> Signal:
    """The signal row . blocks without a force, its derivative rows from row -> row A."""
    row1 = _derivative(row, lam, eta)
    none = np.zeros(len(lam))
    return Signal(
        eta, lam, make_blocks(eta, lam), row, row1, _derivative(row1, lam, eta),
        sin_part=none, cos_part=none, amplitude=none, omega=none, offset=none,
    )  # fmt: skip


def _derivative(row: Array, lam: Array, eta: Array) -> Array:
    """row A, block by block: d/dt (r1 h + r2 h') = -lam r2 h + (r1 - 2 eta r2) h'."""
    return np.stack([-lam * row[..., 1], row[..., 0] - 2.0 * eta * row[..., 1]], axis=-1)


def _row_times(row: Array, matrix: Array) -> Array:
    """row @ matrix of each of many."""
    return np.asarray((row[:, None, :] @ matrix)[:, 0])


def _dot(row: Array, other: Array) -> Array:
    """row . other of each of many."""
    return np.asarray((row[:, None, :] @ other[:, :, None])[:, 0, 0])


def _null_space(row: Array) -> Array:
    """Orthonormal bases (N, n, n - 1) of the vectors that the rows send to zero, from reflections of e_1 to them."""
    length = np.sqrt(_dot(row, row))
    v = row.copy()
    v[:, 0] += np.copysign(length, row[:, 0])
    reflection = np.eye(row.shape[1]) - 2.0 * v[:, :, None] * v[:, None, :] / _dot(v, v)[:, None, None]
    return np.ascontiguousarray(reflection[:, :, 1:])
