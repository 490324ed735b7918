"""From mass, damping and stiffness matrices to the blocks, rows and columns that the kernels run on.

The records hold plain tuples: Numba keeps those in registers and unrolls the loops over blocks, where an
array inside a record costs a reference count at every use.
"""

import math
from collections.abc import Callable, Iterable
from functools import lru_cache, wraps
from typing import Any, NamedTuple, ParamSpec

import numpy as np
from numpy.typing import NDArray

from workers.results import COUPLED_DAMPING, LONG_PERIOD, OUT_OF_DOUBLES, RESONANCE, RIGID_MODE, InvalidError

Array = NDArray[np.float64]
Row = tuple[float, ...]
Rows = tuple[Row, ...]
_P = ParamSpec("_P")

LARGEST_ANGLE = 3e7
"""Radians of free oscillation in a forcing period up to which elementary.sin_cos reduces angles exactly."""


class Block(NamedTuple):
    """h'' + 2 eta h' + lam h = 0 with what its flow and its bounds need.

    d = lam - eta^2; w = sqrt|d| and its inverse (0 for w = 0); the decay rates, both eta unless overdamped.
    tilt, weight and grow2...grow4 are those of flight.amplitude_bounds.
    """

    eta: float
    lam: float
    d: float
    w: float
    inv_w: float
    slow: float
    fast: float
    tilt: float
    weight: float
    grow2: float
    grow3: float
    grow4: float


def make_block(eta: float, lam: float) -> Block:
    """The block of that damping and stiffness, lam > 0.

    The k-th derivative of an oscillation is at most sqrt(lam)^k times its amplitude; near critical damping, where that
    is large, its energy and q'' = -2 eta q' - lam q bound it better.
    """
    d = lam - eta * eta
    w = math.sqrt(abs(d))
    fast = eta + (w if d < 0.0 else 0.0)
    slow = lam / fast if d < 0.0 else eta
    root = math.sqrt(lam)
    weak = d > 0.05 * lam
    tilt, weight, twice = (eta, 1.0 / d, 0.0) if weak else (0.0, 1.0 / lam, 2.0 * eta)
    grow2 = lam + twice * root
    grow3 = lam * root + twice * grow2
    grow4 = lam * grow2 + twice * grow3
    return Block(eta, lam, d, w, 1.0 / w if w > 0.0 else 0.0, slow, fast, tilt, weight, grow2, grow3, grow4)


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


def in_double_precision(build: Callable[_P, Oscillator]) -> Callable[_P, Oscillator]:
    """The same builder of an oscillator; InvalidError where a number of it leaves double precision."""

    @wraps(build)
    def checked(*args: _P.args, **kwargs: _P.kwargs) -> Oscillator:
        try:
            with np.errstate(over="raise", divide="raise", invalid="raise"):
                osc = build(*args, **kwargs)
            within = _is_finite(osc._replace(b_upper=0.0, b_lower=0.0))  # a stop may be infinitely far away
        except (ArithmeticError, np.linalg.LinAlgError):
            within = False
        if not within:
            raise InvalidError(OUT_OF_DOUBLES)
        return osc

    return checked


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
    Raises InvalidError, a ValueError in one line, for a free rigid mode, for damping that is not classical, for
    undamped resonance, where no periodic forced response exists, and for a forcing period of more free oscillations
    than double precision keeps the phase of. What leaves the range of floats is left to ``in_double_precision``.
    """
    structure = _structure(_tuples(mass), _tuples(damping), _tuples(stiffness), _tuples(gap_row))
    free, held = structure.unforced, structure.unforced.held
    loads = tuple(float(f) for f in force)
    modal = _projected(free.to_physical, loads)
    forced = _response(free.gap.block, modal, omega)
    held_forced = _response(held.release.block, _projected(structure.held_modes, loads), omega)
    period = 2.0 * math.pi / omega
    if max((block.w for block in free.gap.block if block.d > 0.0), default=0.0) * period > LARGEST_ANGLE:
        raise InvalidError(LONG_PERIOD)
    acceleration = _total(a * f for a, f in zip(structure.accelerance, loads, strict=True))
    return free._replace(
        gap=_with_force(free.gap, forced, 0.0, omega),
        forced=forced,
        b_upper=b_upper,
        b_lower=b_lower,
        R=R,
        period=period,
        tau=math.remainder(tau, 2.0 * math.pi),
        held=held._replace(forced=held_forced, release=_with_force(held.release, held_forced, acceleration, omega)),
    )


class _Structure(NamedTuple):
    """What masses, dampers and springs make of an oscillator, whatever forces it and wherever its stops are.

    held_modes (n, n - 1) are mass-normalised; accelerance = M^-1 gap_row is the acceleration of the gap coordinate per
    unit force.
    """

    unforced: Oscillator
    held_modes: Rows
    accelerance: Row


@lru_cache(maxsize=1024)
def _structure(mass_rows: Rows, damping_rows: Rows, stiffness_rows: Rows, gap: Row) -> _Structure:
    """Kept, since the cells of a plane often share their structure: its modes cost more than all else of a cell."""
    mass, damping, stiffness = np.array(mass_rows), np.array(damping_rows), np.array(stiffness_rows)
    gap_row = np.array(gap)
    n = len(gap)
    lam, modes = _modes(mass, stiffness)
    eta = _modal_damping(modes, damping)
    accelerance = np.linalg.solve(mass, gap_row)
    participation = gap_row @ modes
    signal = _signal(lam, eta, np.column_stack([participation, np.zeros(n)]), 0.0)
    kick = np.column_stack([np.zeros(n), participation / float(gap_row @ accelerance)])
    held, held_modes = _held(mass, damping, stiffness, gap_row, accelerance, modes)
    unforced = Oscillator(
        gap=signal,
        kick=_tuples(kick),
        kick1=_tuples(np.column_stack([kick[:, 1], -2.0 * eta * kick[:, 1]])),
        cA2k=float(np.sum(np.array(signal.row2) * kick)),
        forced=_tuples(np.zeros((n, 2, 2))),
        to_physical=_tuples(modes),
        to_blocks=_tuples(modes.T @ mass),
        gap_row=gap,
        b_upper=math.inf,
        b_lower=math.inf,
        R=math.nan,
        period=math.nan,
        tau=0.0,
        trace=float(2.0 * np.sum(eta)),
        held=held,
    )
    return _Structure(unforced, _tuples(held_modes), _tuples(accelerance))


def _held(
    mass: Array, damping: Array, stiffness: Array, gap_row: Array, accelerance: Array, modes: Array
) -> tuple[Held, Array]:
    """The oscillator with y fixed and its modes: x = N q + d y_s, with N spanning the null space of the gap row."""
    d = accelerance / (gap_row @ accelerance)
    null = _null_space(gap_row)
    lam, psi = _modes(null.T @ mass @ null, null.T @ stiffness @ null)
    shapes = null @ psi
    eta = _modal_damping(psi, null.T @ damping @ null)
    static = -(shapes.T @ stiffness @ d) / lam
    row = np.column_stack([-(accelerance @ stiffness @ shapes), -(accelerance @ damping @ shapes)])
    offset = -float(accelerance @ stiffness @ (d + shapes @ static))
    held = Held(
        down=_tuples(shapes.T @ mass @ modes),
        static=_tuples(static),
        forced=_tuples(np.zeros((len(lam), 2, 2))),
        release=_signal(lam, eta, row, offset),
    )
    return held, shapes


def _modes(mass: Array, stiffness: Array) -> tuple[Array, Array]:
    """Squared frequencies and mass-normalised modes: modes.T M modes = I, modes.T K modes = diag(lam)."""
    if len(mass) == 0:
        return np.zeros(0), np.zeros((0, 0))
    half = np.linalg.cholesky(mass)
    lam, vectors = np.linalg.eigh(np.linalg.solve(half, np.linalg.solve(half, stiffness).T))
    if not lam[0] > 0.0:
        raise InvalidError(RIGID_MODE)
    return lam, np.linalg.solve(half.T, vectors)


def _modal_damping(modes: Array, damping: Array) -> Array:
    """eta_j = phi_j.T C phi_j / 2 of classical damping."""
    modal = modes.T @ damping @ modes
    eta = np.diag(modal) / 2.0
    if np.any(np.abs(modal - np.diag(2.0 * eta)) > 1e-9 * np.max(np.abs(modal), initial=0.0)):
        raise InvalidError(COUPLED_DAMPING)
    return np.maximum(eta, 0.0)


def _projected(modes: Rows, force: Row) -> Row:
    """modes.T @ force."""
    return tuple(_total(m * f for m, f in zip(mode, force, strict=True)) for mode in zip(*modes, strict=True))


def _response(blocks: tuple[Block, ...], force: Row, omega: float) -> tuple[Rows, ...]:
    """Forced response f Im(e^(i phi) / (lam - omega^2 + 2 i eta omega)) of each block and its velocity."""
    found = []
    for block, f in zip(blocks, force, strict=True):
        stiffness = complex(block.lam - omega**2, 2.0 * block.eta * omega)
        if f != 0.0 and abs(stiffness) < 1e-13 * (block.lam + omega**2):
            raise InvalidError(RESONANCE)
        H = f / stiffness if f != 0.0 else 0j
        found.append(((H.real, H.imag), (-omega * H.imag, omega * H.real)))
    return tuple(found)


def _with_force(signal: Signal, response: tuple[Rows, ...], direct: float, omega: float) -> Signal:
    """The signal with its forced part, row . response + direct sin(phi)."""
    pairs = [pair for row, block in zip(signal.row, response, strict=True) for pair in zip(row, block, strict=True)]
    sin_part = _total([direct, *(weight * sin for weight, (sin, _) in pairs)])
    cos_part = _total(weight * cos for weight, (_, cos) in pairs)
    amplitude = math.hypot(sin_part, cos_part)
    return signal._replace(sin_part=sin_part, cos_part=cos_part, amplitude=amplitude, omega=omega)


def _signal(lam: Array, eta: Array, row: Array, offset: float) -> Signal:
    """The signal row . blocks without a force, its derivative rows from row -> row A."""
    row1 = _derivative(row, lam, eta)
    return Signal(
        eta=_tuples(eta),
        lam=_tuples(lam),
        block=tuple(make_block(float(e), float(k)) for e, k in zip(eta, lam, strict=True)),
        row=_tuples(row),
        row1=_tuples(row1),
        row2=_tuples(_derivative(row1, lam, eta)),
        sin_part=0.0,
        cos_part=0.0,
        amplitude=0.0,
        omega=math.nan,
        offset=offset,
    )


def _derivative(row: Array, lam: Array, eta: Array) -> Array:
    """row A, block by block: d/dt (r1 h + r2 h') = -lam r2 h + (r1 - 2 eta r2) h'."""
    return np.column_stack([-lam * row[:, 1], row[:, 0] - 2.0 * eta * row[:, 1]])


def _total(terms: Iterable[float]) -> float:
    """The sum, rounded once; OverflowError where a term is not finite, for which math.fsum has errors of its own."""
    found = list(terms)
    if not _is_finite(tuple(found)):
        raise OverflowError
    return math.fsum(found)


def _is_finite(value: Any) -> bool:
    """Whether a float, or every one in nested tuples, is finite."""
    return all(map(_is_finite, value)) if isinstance(value, tuple) else math.isfinite(value)


def _null_space(row: Array) -> Array:
    """An orthonormal basis (n, n - 1) of the vectors that the row sends to zero."""
    _, _, vh = np.linalg.svd(row[None, :])
    return np.asarray(vh[1:].T)


def _tuples(values: Array) -> Any:
    """Nested tuples of floats."""
    return tuple(float(v) if np.ndim(v) == 0 else _tuples(v) for v in values)
