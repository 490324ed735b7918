"""Records of arrays that describe linear oscillators to the compiled kernels.

The equations of motion are decoupled into blocks, h'' + 2 eta h' + lam h = load. Array shapes give the numbers of
masses and harmonics. A record of many oscillators has one more leading axis in each field.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Given = TypeVar("Given")
Reasons = NDArray[np.int8]
Rows = NDArray[np.int64]
"""Indices of machines, motions or cells in arrays with a row for each, or a mask of them."""

LARGEST_ANGLE = 3e7
"""Largest rotation, in radians of free oscillation per forcing period, for which elementary.sin_cos is exact."""


class Block(NamedTuple):
    """One block of an oscillator: a decoupled equation of motion h'' + 2 eta h' + lam h = load, with its constants.

    d, w, inv_w     d = lam - eta^2, w = sqrt|d|, and the inverse of w, 0 for w = 0
    slow, fast      decay rates, both eta unless the eigenvalues are real; slow < 0 in a block that grows
    tilt ... grow4  see signal.amplitude_bounds
    metric          weight of h^2 beside h'^2 in the energy norm: lam, which undamped flight keeps, or omega^2 for a
                    rigid mode, lam = 0. In a block that grows it is the larger one of |lam| and eta^2
    load            load of a rigid mode; a load on any other mode moves its rest position instead
    c, cA, cAA      weights of (h, h') in the guard, the signal that ends the motion, and in its first two derivatives
    k, Ak           direction in which a reset, such as an impact, moves (h, h'), and its derivative
    swing           bounds of the forced response of h and h'; without a force, the size of displacements by a load,
                    friction, or the room between stops
    rest            (h, h') at rest under a constant load

    The fields are the columns of GuardedFlow.blocks.
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
    c0: Any
    c1: Any
    cA0: Any
    cA1: Any
    k0: Any
    k1: Any
    Ak0: Any
    Ak1: Any
    cAA0: Any
    cAA1: Any
    swing0: Any
    swing1: Any
    rest0: Any
    rest1: Any


COLUMN = Block(*range(len(Block._fields)))
"""Columns of GuardedFlow.blocks by name."""

PAIRS = {
    "row": COLUMN.c0, "row1": COLUMN.cA0, "row2": COLUMN.cAA0, "kick": COLUMN.k0, "kick1": COLUMN.Ak0,
    "swing": COLUMN.swing0, "rest": COLUMN.rest0,
}  # fmt: skip
"""First of the two columns, in GuardedFlow.blocks, of c, cA, cA^2, k, A k, swing and rest, each (n, 2)."""

OF_FLOW, OF_GUARD = COLUMN.c0, COLUMN.swing0
"""Index after the columns of GuardedFlow.blocks that the equations alone decide, and after those of guard and reset."""


def make_blocks(eta: Array, lam: Array) -> Array:
    """Return decoupled equations h'' + 2 eta h' + lam h, as blocks (..., columns), for given eta and lam (...).

    Load, guard, reset and forced response are zero. The metric is set except for rigid modes, lam = 0. The k-th
    derivative of an oscillation is at most sqrt(lam)^k times its amplitude. Near critical damping this bound is large,
    and the energy and q'' = -2 eta q' - lam q give better bounds. Both bounds hold for blocks that do not grow.
    """
    d = lam - eta * eta
    w = np.sqrt(np.abs(d))
    rises = (d < 0.0) & (eta < 0.0)
    larger = np.where(rises, w - eta, eta + w)  # the larger rate, without cancellation
    smaller = lam / np.where(d < 0.0, larger, 1.0)
    fast = np.where(d < 0.0, np.where(rises, -smaller, larger), eta)
    slow = np.where(d < 0.0, np.where(rises, -larger, smaller), eta)
    root = np.sqrt(np.maximum(lam, 0.0))
    weak = d > 0.05 * lam
    bounded = np.where(weak, d, lam)
    tilt, twice = np.where(weak, eta, 0.0), np.where(weak, 0.0, 2.0 * eta)
    weight = np.where(bounded > 0.0, 1.0 / np.where(bounded > 0.0, bounded, 1.0), 0.0)
    grow2 = lam + twice * root
    grow3 = lam * root + twice * grow2
    grow4 = lam * grow2 + twice * grow3
    inv_w = np.where(w > 0.0, 1.0 / np.where(w > 0.0, w, 1.0), 0.0)
    metric = np.where(slow < 0.0, np.maximum(np.abs(lam), eta * eta), lam)
    blocks = np.zeros((*lam.shape, len(COLUMN)))
    for column, field in enumerate((eta, lam, d, w, inv_w, slow, fast, tilt, weight, grow2, grow3, grow4, metric)):
        blocks[..., column] = field
    return blocks


def rates_of(blocks: Array) -> Any:
    """Return the complex rates (..., n, 2), the eigenvalues, of decoupled equations ``blocks`` (..., n, columns).

    Each motion in a block is a sum of e^(rate s).
    """
    eta, w, slow, fast = (blocks[..., k] for k in (COLUMN.eta, COLUMN.w, COLUMN.slow, COLUMN.fast))
    real = blocks[..., COLUMN.d] < 0.0
    return np.stack([np.where(real, -slow, -eta + 1j * w), np.where(real, -fast, -eta - 1j * w)], axis=-1)


def growth_of(blocks: Array) -> Array:
    """Return the largest growth rate (...) of decoupled equations (..., n, columns), 0 if no solution grows."""
    return np.asarray(np.max(-blocks[..., COLUMN.slow], axis=-1, initial=0.0))


class ForcedBounds(NamedTuple):
    """Bounds of the forced part of a guard, the signal that ends a motion: columns of GuardedFlow.numbers.

    omega                   forcing frequency
    amplitude               bound of the modulus of the forced part
    swing2, swing3, swing4  bounds of the moduli of its second, third and fourth derivative
    """

    omega: Any
    amplitude: Any
    swing2: Any
    swing3: Any
    swing4: Any


NUMBER = ForcedBounds(*range(len(ForcedBounds._fields)))
"""Columns of GuardedFlow.numbers by name."""


class GuardedFlow(NamedTuple):
    """A linear motion in decoupled equations, the blocks, and the guard that ends it: a signal linear in the state.

    Block j carries u_j = (h, h') with h'' + 2 eta h' + lam h = load. The guard is sum_j c_j . u_j(t) + Y(t). Its forced
    part is Y = sum_k sin_part_k sin(k phi) + cos_part_k cos(k phi), k = 1...H, at the phase phi = omega t + tau.

    blocks   (n, columns) constants of each block, see Block and PAIRS
    waves    (H, 2) sin_part and cos_part
    numbers  (NUMBER,) see ForcedBounds; the amplitude is reached if H = 1
    forced   (n, 2, H, 2) forced response of the blocks, [block, (h, h'), harmonic, (sin, cos)]
    """

    blocks: Array
    waves: Array
    numbers: Array
    forced: Array

    def __getattr__(self, name: str) -> Any:
        """Return columns of ``blocks``, ``numbers`` or ``waves`` by name, such as ``lam``, ``rest`` or ``sin_part``.

        The names are those of Block, PAIRS and ForcedBounds.
        """
        return _named(name, (self.blocks, _OF_BLOCK), (self.numbers, _OF_NUMBERS), (self.waves, _OF_WAVES))


_OF_BLOCK = COLUMN._asdict() | {name: slice(first, first + 2) for name, first in PAIRS.items()}
_OF_NUMBERS, _OF_WAVES = NUMBER._asdict(), {"sin_part": 0, "cos_part": 1}


def _named(name: str, *tables: tuple[Array, Mapping[str, Any]]) -> Any:
    """Return the columns ``name`` of the first array that has them; ``tables`` are arrays with their columns by name.

    Raise AttributeError if no array has such columns.
    """
    for table, columns in tables:
        if name in columns:
            return _plain(table[..., columns[name]])
    raise AttributeError(name)


def _plain(field: Array) -> Any:
    """Return an array, or the number in an array without axes."""
    return field if field.ndim else float(field)


class OscillatorScalars(NamedTuple):
    """Numbers of an oscillator: the columns of Oscillator.head. The numbers that loops over many cells need come first.

    top, bottom   stops of the gap counted from rest, upper - y0 and lower - y0
    R             coefficient of restitution
    cA2k          cA^2.k, minus the damping rate of the gap coordinate
    period        forcing period 2 pi / omega
    time_unit     1 / sqrt(least metric)
    upper, lower  positions of the stops, infinite if missing
    symmetric     1 if z(t) -> -z(t + T/2) takes motions to motions: equal gaps and odd harmonics; else 0
    gap_mass      1 / (g M^-1 g^T), g the gap row: an impact at speed v loses the energy (1 - R^2) gap_mass v^2 / 2
    trace         trace of M^-1 C, the rate at which a flight contracts volume; its mean over phases if there are any
    growth        largest growth rate while nothing sticks, 0 if nothing grows
    """

    top: Any
    bottom: Any
    R: Any
    cA2k: Any
    period: Any
    time_unit: Any
    upper: Any
    lower: Any
    symmetric: Any
    gap_mass: Any
    trace: Any
    growth: Any


HEAD = OscillatorScalars(*range(len(OscillatorScalars._fields)))
"""Columns of Oscillator.head by name."""

_OF_HEAD = HEAD._asdict()

OF_LANE = HEAD.upper
"""Number of columns of Oscillator.head, the first ones, that loops over many cells copy for each cell in progress."""


class Oscillator(NamedTuple):
    """A machine in the form for the compiled kernels: with one rigid contact, or with modes.

    gap          free flight. Its guard is y(t) - y0, with y0 the gap coordinate at rest. Its column k is the direction
                 of an impact, cA.k = 1, c.k = 0
    to_physical  (2n, 2n) (displacements, velocities) of block coordinates (h_1, h_1', h_2, ...)
    to_blocks    (2n, 2n) its inverse
    gap_row      (n,) y = gap_row . displacements
    head         (HEAD,) numbers, see OscillatorScalars; each is an attribute too
    tau          forcing phase at a section t = k T, T the forcing period
    sticking     the mode in which the upper stop of one rigid contact holds, a HybridModes of one mode and one signal,
                 the force by which the stop holds y. States are counted from rest. The lower stop holds in the same
                 mode while the signal is positive. Empty for machines with modes
    table        the ModeTable of a machine with modes; empty for machines with one rigid contact

    A mode is a set of linear equations of motion between two events; a block is one of its decoupled equations. The gap
    coordinate y of a machine with one rigid contact moves between two stops, or on one side of a single stop.

    In a machine with modes, states between periods are in the blocks of ``gap`` in any mode. They are the blocks of the
    undamped modes of the first phase with all contacts open, no force and no load, without a guard. Their eta is the
    decay rate of the slowest mode of the flow with contacts open. ``gap_row``, ``upper`` and ``lower`` belong to the
    first contact.

    A drifting coordinate times omega is the last number of the state, and the velocity of its free motion the last but
    one. Nothing depends on the drifting coordinate. It is reset to 0 at each section, so a motion closes when all other
    numbers do.
    """

    gap: GuardedFlow
    to_physical: Array
    to_blocks: Array
    gap_row: Array
    head: Array
    tau: Any
    sticking: Any
    table: Any

    def __getattr__(self, name: str) -> Any:
        """Return a number of ``head``, see OscillatorScalars, by its name."""
        return _named(name, (self.head, _OF_HEAD))

    @property
    def has_modes(self) -> bool:
        """True if the equations of motion change in other ways than by impacts on one rigid contact."""
        return bool(self.table.codes.shape[-1] > 0)

    @property
    def drifts(self) -> int:
        """1 if a coordinate of these machines may drift, else 0."""
        return int(np.max(self.table.drifts, initial=0.0))

    @property
    def contacts(self) -> tuple[Array, Array, Mask]:
        """Contacts of many machines: rows (N, C, n), lower and upper stops (N, C, 2), mask (C,) of rigid contacts.

        A row has the weights of the displacements in the coordinate that the stops limit.
        """
        if self.has_modes:
            machines = self.table.machines
            return machines.row, machines.stops, ~machines.soft.any(axis=0)
        return self.gap_row[:, None], np.stack([self.lower, self.upper], axis=-1)[:, None], np.ones(1, dtype=np.bool_)

    @property
    def rigid_stops(self) -> list[tuple[Array, Array, Array]]:
        """Row (N, n), upper stop (N,) and lower stop (N,) of each rigid contact of many machines.

        A row has the weights of the displacements in the coordinate that the stops limit.
        """
        rows, stops, rigid = self.contacts
        fields = [(rows[:, c], stops[:, c, 1], stops[:, c, 0]) for c in np.flatnonzero(rigid)]
        return [(np.ascontiguousarray(a), np.ascontiguousarray(b), np.ascontiguousarray(c)) for a, b, c in fields]

    def with_modes(self, act: Callable[[Rows], Any], rows: Rows) -> Any:
        """Call ``act`` for machines ``rows``, build modes that it found missing, and call it again for those machines.

        act   function of row indices that runs a kernel
        rows  rows of many machines

        A mode is a set of linear equations between two events. A kernel leaves a motion unchanged if a mode is missing.
        Return the result of the last call. ``act`` is called even without rows, which compiles its kernels.
        """
        result = act(rows)
        while len(rows := self.table.build_missing(rows)):
            result = act(rows)
        return result

    @property
    def b_upper(self) -> Any:
        """upper - y0, the gap to the upper stop at rest."""
        return _plain(self.head[..., HEAD.top])

    @property
    def b_lower(self) -> Any:
        """y0 - lower, the gap to the lower stop at rest."""
        return -_plain(self.head[..., HEAD.bottom])


def empty(axes: Any, N: int) -> Any:
    """Return a named tuple of arrays for N machines without numbers: every axis after the first has length 0.

    ``axes`` is such a tuple with the number of axes of each field; None stays None.
    """
    return map_fields(axes, lambda count: np.zeros((N, *(0,) * (count - 1))))


def map_fields(record: Any, act: Callable[[Any], Any]) -> Any:
    """Return a named tuple with ``act`` applied to every field of ``record``, also in nested ones; None stays None."""
    if isinstance(record, tuple):
        return type(record)(*(map_fields(field, act) for field in record))
    return None if record is None else act(record)


def at_rows(record: Any, rows: Rows) -> Any:
    """Return a named tuple like ``record`` with only these rows of every array, in this order."""

    def take(record: Any) -> Any:
        return map_fields(record, lambda field: field.take(rows, axis=0))

    if isinstance(record, Oscillator) and not record.has_modes:  # its table has half of all fields, which are empty
        return take(record._replace(table=None))._replace(table=record.table.without_modes(len(rows)))
    return take(record)


def take_one(oscillators: Any, k: int) -> Any:
    """Return oscillator k of a record of many oscillators.

    Its arrays are views of those of all. If a kernel notes in them that a mode, a set of linear equations, is missing,
    the table of all shows it too.
    """
    one: Any = map_fields(oscillators, lambda field: field[k] if field.ndim > 1 else float(field[k]))
    return one


def many_of(record: Given) -> Given:
    """Return one machine or motion as a record of many with a single row, with views of the same arrays."""
    many: Given = map_fields(record, lambda field: np.asarray(field)[None])
    return many


def finite(record: Any) -> Mask:
    """Return the mask (N,) of N items whose numbers are all finite; ``record`` has arrays with a row for each item."""
    arrays = arrays_in(record)
    if np.isfinite(np.concatenate([array.ravel() for array in arrays])).all():  # nearly always
        return np.ones(len(arrays[0]), dtype=np.bool_)
    return np.asarray(np.isfinite(numbers_of(record)).all(axis=1))


def numbers_of(record: Any) -> Array:
    """Return all numbers of N items as one array, a row (N, .) for each; ``record`` has arrays with N rows."""
    rows = [array.reshape(len(array), math.prod(array.shape[1:])) for array in arrays_in(record)]
    return np.concatenate(rows, axis=1)


def arrays_in(record: Any) -> list[Array]:
    """Return all arrays of a record, a named tuple of arrays and further records."""
    arrays = list[Array]()
    for field in record:
        if isinstance(field, tuple):
            arrays += arrays_in(field)
        elif field is not None:
            arrays.append(field)
    return arrays
