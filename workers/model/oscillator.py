"""The records that the kernels run on: blocks, rows and columns of a linear oscillator with one gap.

They hold arrays whose shapes tell the number of masses and of harmonics. Many oscillators are one record with another
axis in front of every field.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LARGEST_ANGLE = 3e7
"""Radians of free oscillation in a forcing period up to which elementary.sin_cos reduces angles exactly."""


class Block(NamedTuple):
    """h'' + 2 eta h' + lam h = load with what its flow and its bounds need: columns of Signal.block.

    d = lam - eta^2; w = sqrt|d| and its inverse (0 for w = 0); the decay rates, both eta unless overdamped.
    tilt, weight and grow2...grow4 are those of signal.amplitude_bounds. metric weighs h^2 against h'^2 where states are
    compared: lam, so that undamped flight keeps the norm, or omega^2 for a rigid mode, lam = 0, which alone has a load:
    that of any other mode moves its rest position.
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
    metric: Any
    load: Any


COLUMN = Block(*range(len(Block._fields)))
"""Columns of Signal.block by name."""


def make_blocks(eta: Array, lam: Array, metric: Array | None = None, load: Array | None = None) -> Array:
    """Blocks (..., columns) of that damping and stiffness (...), lam >= 0.

    The k-th derivative of an oscillation is at most sqrt(lam)^k times its amplitude; near critical damping, where that
    is large, its energy and q'' = -2 eta q' - lam q bound it better.
    """
    d = lam - eta * eta
    w = np.sqrt(np.abs(d))
    fast = np.where(d < 0.0, eta + w, eta)
    slow = np.where(d < 0.0, lam / np.where(d < 0.0, fast, 1.0), eta)
    root = np.sqrt(lam)
    weak = d > 0.05 * lam
    bounded = np.where(weak, d, lam)
    tilt, twice = np.where(weak, eta, 0.0), np.where(weak, 0.0, 2.0 * eta)
    weight = np.where(bounded > 0.0, 1.0 / np.where(bounded > 0.0, bounded, 1.0), 0.0)
    grow2 = lam + twice * root
    grow3 = lam * root + twice * grow2
    grow4 = lam * grow2 + twice * grow3
    inv_w = np.where(w > 0.0, 1.0 / np.where(w > 0.0, w, 1.0), 0.0)
    metric = lam if metric is None else metric
    load = np.zeros_like(lam) if load is None else load
    columns = Block(eta, lam, d, w, inv_w, slow, fast, tilt, weight, grow2, grow3, grow4, metric, load)
    return np.stack(columns, axis=-1)


class Signal(NamedTuple):
    """A scalar output of a damped linear oscillator: sum_j row_j . u_j(t) + Y(t).

    Block j carries u_j = (h, h') with h'' + 2 eta h' + lam h = load. Y = sum_k sin_part_k sin(k phi) + cos_part_k
    cos(k phi), k = 1...H, is the forced part at the forcing phase phi = omega t + tau; its modulus is at most
    ``amplitude``, equal to it where H = 1, and that of its second to fourth derivative at most ``swing`` (3,).
    ``block`` (n, columns) holds the constants of each, see Block; ``row``, ``row1`` and ``row2`` (n, 2) give the
    homogeneous part of the signal, of its first and of its second derivative.
    """

    eta: Array
    lam: Array
    metric: Array
    block: Array
    row: Array
    row1: Array
    row2: Array
    sin_part: Array
    cos_part: Array
    amplitude: Any
    swing: Array
    omega: Any


class Held(NamedTuple):
    """The motion while the impacting coordinate rests on a stop: n - 1 blocks of its own.

    down (2n-2, 2n) takes free block coordinates to held ones, up (2n, 2n-2) takes those back.
    into (2, n-1, 2) and out (2, n, 2), for the upper and the lower stop, are what the rest positions add on either way.
    forced (n-1, 2, H, 2) is the forced response [block, (h, h'), harmonic, (sin, cos)]. The free acceleration of the
    gap coordinate is ``release`` + push, push (2,) for either stop.
    """

    down: Array
    up: Array
    into: Array
    out: Array
    forced: Array
    release: Signal
    push: Array


class Oscillator(NamedTuple):
    """A linear oscillator whose gap coordinate y moves between two stops, or one.

    gap             the signal y(t) - y0, seen from rest_y = y0; its rows are c, cA and cA^2
    kick            (n, 2): the column k that an impact kicks along, cA.k = 1, c.k = 0
    kick1           (n, 2): A k
    cA2k            cA^2.k, minus the damping rate that the gap coordinate feels
    forced          (n, 2, H, 2): forced response of the blocks, [block, (h, h'), harmonic, (sin, cos)]
    swing           (n, 2): bound of its moduli
    rest            (n, 2): what the constant load adds to the blocks
    to_physical     (2n, 2n): (displacements, velocities) of block coordinates (h_1, h_1', h_2, ...)
    to_blocks       (2n, 2n): its inverse
    gap_row         (n,): y = gap_row . displacements
    upper, lower    positions of the stops, infinite where there is none
    b_upper, b_lower  upper - y0 and y0 - lower
    symmetric       1 where z(t) -> -z(t + T/2) takes motions to motions: equal gaps and odd harmonics; else 0
    gap_mass        1 / (g M^-1 g^T), g the gap row: an impact at speed v loses the energy (1 - R^2) gap_mass v^2 / 2
    time_unit       1 / sqrt(least metric)
    period, tau     forcing period 2 pi / omega and forcing phase at a section
    trace           trace of M^-1 C, the rate at which a flight contracts volume
    """

    gap: Signal
    kick: Array
    kick1: Array
    cA2k: Any
    forced: Array
    swing: Array
    rest: Array
    to_physical: Array
    to_blocks: Array
    gap_row: Array
    upper: Any
    lower: Any
    b_upper: Any
    b_lower: Any
    symmetric: Any
    R: Any
    gap_mass: Any
    time_unit: Any
    period: Any
    tau: Any
    trace: Any
    held: Held


class Machines(NamedTuple):
    """N machines M x'' + C x' + K x = force + load with stops on y = gap_row . x, lower <= y <= upper.

    The force is sum_k force_sin_k sin(k phi) + force_cos_k cos(k phi), k = 1...H, with phi = omega t + tau.
    mass, damping, stiffness (N, n, n), gap_row and load (N, n), force_sin and force_cos (N, H, n), all else (N,).
    A stop at infinity is none.
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


def taken(record: Any, rows: NDArray[np.int64]) -> Any:
    """These rows of a record of many, in their order."""
    return each(record, lambda field: np.take(field, rows, axis=0))


def one_of(oscillators: Oscillator, k: int) -> Oscillator:
    """Oscillator k of many."""
    found: Oscillator = each(oscillators, lambda field: field[k].copy() if field.ndim > 1 else float(field[k]))
    return found


def many_of(osc: Oscillator) -> Oscillator:
    """One oscillator as a record of many."""
    found: Oscillator = each(osc, lambda field: np.asarray(field, dtype=np.float64)[None])
    return found
