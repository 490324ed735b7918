"""The motion between impacts: blocks, forced response, rest position, and the gap coordinate as their signal.

What one oscillator is made of does not depend on the others, to the bit.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.model.modes import Modes, split, stacked
from workers.model.oscillator import COLUMN, LARGEST_ANGLE, OF_FLOW, Array, Machines, Mode, make_blocks
from workers.results import COUPLED_DAMPING, LONG_PERIOD, RESONANCE, RIGID_MODE, UNSTABLE

UNSEEN = 1e-9
"""Share of a rigid mode in the gap coordinate, of what the mode could have at most, below which the gap misses it."""


ULPS = 8.0
"""Units in the last place by which entries of a machine may be wrong: what a few operations leave of exact ones."""


class Frame(NamedTuple):
    """What mass, damping, stiffness and gap row alone decide, of N machines.

    modes; inverse_mass M^-1 (N, n, n); accelerance M^-1 g and inverse_gap_mass g.M^-1 g of the gap row g; columns, see
    ``columns_of``; trace (N,), see Oscillator.
    """

    modes: Modes
    inverse_mass: Array
    accelerance: Array
    inverse_gap_mass: Array
    columns: Array
    trace: Array

    @property
    def row(self) -> Array:
        """c (N, n, 2)."""
        return self.columns[..., :2]


class Loading(NamedTuple):
    """What force and load are to the blocks of N machines, whatever the forcing frequency.

    waves (N, H, n, 2): what complex amplitudes of e^(i k phi) add to (h, h')'; load (N, n), rest (N, n, 2), see
    Oscillator; block (N, n, columns), see Mode, whose metric is that of elastic blocks.
    """

    waves: Any
    load: Array
    rest: Array
    block: Array


class Driven(NamedTuple):
    """Blocks with what force and load do to them.

    modes; metric and load (N, n), rest (N, n, 2), block (N, n, columns); forced (N, n, 2, H, 2); resonant (N,).
    """

    modes: Modes
    metric: Array
    load: Array
    rest: Array
    block: Array
    forced: Array
    resonant: NDArray[np.bool_]


class Free(NamedTuple):
    """The free motion of N machines: its blocks, the gap signal, the stops seen from rest, and whether a rigid mode is
    one that the gap does not see.
    """

    driven: Driven
    gap: Mode
    b_upper: Array
    b_lower: Array
    unseen: NDArray[np.bool_]


def frame_of(mass: Array, damping: Array, stiffness: Array, gap_row: Array) -> Frame:
    """The frame of matrices (N, n, n) and gap rows (N, n)."""
    N, n = gap_row.shape
    accelerance = stacked(np.linalg.solve, (N, n, 1), mass, gap_row[..., None])[..., 0]
    inverse_gap_mass = dot(gap_row, accelerance)
    d = accelerance / inverse_gap_mass[:, None]
    modes = split(mass, damping, stiffness)
    row = times(np.concatenate([gap_row, np.zeros((N, n))], axis=1), modes.to_physical).reshape(N, n, 2)
    column = np.concatenate([np.zeros((N, n)), d], axis=1)
    kick = (modes.to_blocks @ column[..., None])[..., 0].reshape(N, n, 2)
    return Frame(
        modes=modes,
        inverse_mass=stacked(np.linalg.inv, (N, n, n), mass),
        accelerance=accelerance,
        inverse_gap_mass=inverse_gap_mass,
        columns=columns_of(row, kick, modes),
        trace=2.0 * np.sum(modes.eta, axis=1),
    )


def loading_of(modes: Modes, inverse_mass: Array, force: Any, load: Array) -> Loading:
    """What force (N, H, n) and load (N, n) are to blocks; inverse_mass is M^-1.

    Both enter a block as (h0, h1)' = A (h0, h1) + (l0, l1).
    """
    N, n = modes.eta.shape
    into = modes.to_blocks[:, :, n:] @ inverse_mass  # (N, 2n, n)
    waves = (into[:, None] @ force[..., None])[..., 0].reshape(N, force.shape[1], n, 2)
    steady = (into @ load[..., None])[..., 0].reshape(N, n, 2)
    rigid = modes.lam == 0.0
    l0, l1 = steady[..., 0], steady[..., 1]
    p = l1 + 2.0 * modes.eta * l0
    at_rest = np.where(rigid, 0.0, p / np.where(rigid, 1.0, modes.lam))
    loads = np.where(rigid, p, 0.0)
    return Loading(
        waves=waves,
        load=loads,
        rest=np.stack([at_rest, -l0], axis=-1),
        block=make_blocks(modes.eta, modes.lam, modes.lam, loads),
    )


def free_motion(frame: Frame, push: Loading, machines: Machines) -> Free:
    """The free motion of machines of that frame under that push."""
    push, b_upper, b_lower, unseen = centred(push, frame, machines)
    driven = drive(frame.modes, push, machines.omega)
    none = np.zeros(push.waves.shape[:2], dtype=np.complex128)
    gap = mode_of(driven, frame.columns, none, machines.omega)
    return Free(driven, gap, b_upper, b_lower, unseen)


def faults_of(free: Free) -> list[tuple[int, NDArray[np.bool_]]]:
    """The reasons why free motion may be none, and where they hold (N,), the weightiest last."""
    modes, block = free.driven.modes, free.gap.blocks
    turns = np.where(block[..., COLUMN.d] > 0.0, block[..., COLUMN.w], 0.0) * (2.0 * np.pi / free.gap.omega)[:, None]
    return [
        (LONG_PERIOD, np.max(turns, axis=1) > LARGEST_ANGLE),
        (RESONANCE, free.driven.resonant),
        (COUPLED_DAMPING, modes.inseparable),
        (RIGID_MODE, free.unseen | (modes.rigid > 1)),
        (UNSTABLE, modes.unstable),
    ]


def phase_of(tau: Array) -> Array:
    """The forcing phase at a section, between -pi and pi."""
    phase = np.fmod(tau, 2.0 * np.pi)
    return np.where(np.abs(phase) > np.pi, phase - np.copysign(2.0 * np.pi, phase), phase)


def complex_force(machines: Machines) -> Any:
    """The force (N, H, n) as amplitudes of e^(i k phi), whose imaginary part counts."""
    return machines.force_sin + 1j * machines.force_cos


def orders_of(force: Any) -> Array:
    """The orders k (H,) of the harmonics of a force (N, H, ...)."""
    return np.arange(1.0, force.shape[1] + 1.0)


def drive(modes: Modes, push: Loading, omega: Array) -> Driven:
    """The blocks with the forced response and the rest position that a push gives them."""
    metric = modes.lam
    block, rigid = push.block, modes.lam == 0.0
    if np.any(rigid):
        metric = np.where(rigid, omega[:, None] ** 2, modes.lam)
        block = block.copy()
        block[..., COLUMN.metric] = metric
    forced, resonant = _response(modes, push.waves, omega)
    return Driven(modes, metric, push.load, push.rest, block, forced, resonant)


def _response(modes: Modes, waves: Any, omega: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Forced response (N, n, 2, H, 2) of blocks to waves (N, H, n, 2); resonance (N,).

    Z = (l1 + (2 eta + i w) l0) / (lam - w^2 + 2 i eta w) with w = k omega, and i w Z - l0 of the velocity.
    """
    w = omega[:, None, None] * orders_of(waves)[None, :, None]
    eta, lam = modes.eta[:, None], modes.lam[:, None]
    l0, l1 = waves[..., 0], waves[..., 1]
    push = l1 + (2.0 * eta + 1j * w) * l0
    re, im = lam - w**2, 2.0 * eta * w
    size = np.maximum(np.abs(re), np.abs(im))
    unit = np.where(size > 0.0, size, 1.0)
    re, im = re / unit, im / unit
    square = re * re + im * im
    resonant = (push != 0.0) & (size * np.sqrt(square) < 1e-13 * (lam + w**2))
    Z = np.where(push != 0.0, push / (square * unit), 0.0) * (re - 1j * im)
    rate = 1j * w * Z - l0
    response = np.stack([np.stack([z.real, z.imag], axis=-1) for z in (Z, rate)], axis=-2)  # (N, H, n, 2, 2)
    return np.ascontiguousarray(np.moveaxis(response, 1, 3)), np.any(resonant, axis=(1, 2))


def centred(push: Loading, frame: Frame, machines: Machines) -> tuple[Loading, Array, Array, NDArray[np.bool_]]:
    """The push with rest positions midway between the stops where machines are balanced; the stops seen from rest; and
    where a rigid mode is one that the gap does not see.

    A rigid mode's position is counted from between the stops, or from the only one.
    """
    upper, lower, modes = machines.upper, machines.lower, frame.modes
    rigid, even = modes.lam == 0.0, balanced(machines)
    moving = np.any(rigid, axis=1)
    share = np.sum(np.where(rigid, frame.row[..., 0], 0.0), axis=1)
    unseen = moving & (np.abs(share) < UNSEEN * np.sqrt(frame.inverse_gap_mass))
    middle = np.where(np.isfinite(upper) & np.isfinite(lower), 0.5 * (upper + lower), np.where(
        np.isfinite(upper), upper, np.where(np.isfinite(lower), lower, 0.0)))  # fmt: skip
    rest, load, block = push.rest.copy(), push.load, push.block
    move = np.where(moving & ~unseen, (middle - _at_rest(frame, rest)) / np.where(share != 0.0, share, 1.0), 0.0)
    rest[..., 0] += np.where(rigid, move[:, None], 0.0)
    rounding = np.where(even, middle - _at_rest(frame, rest), 0.0)
    if np.any(rounding != 0.0):
        d = frame.accelerance / frame.inverse_gap_mass[:, None] * rounding[:, None]
        rest += (modes.to_blocks[:, :, : d.shape[1]] @ d[..., None])[..., 0].reshape(rest.shape)
    if np.any(load[even] != 0.0):
        load, block = np.where(even[:, None], 0.0, load), block.copy()
        block[..., COLUMN.load] = load
    y0, half = _at_rest(frame, rest), 0.5 * (upper - lower)
    b_upper, b_lower = np.where(even, half, upper - y0), np.where(even, half, y0 - lower)
    return push._replace(rest=rest, load=load, block=block), b_upper, b_lower, unseen


def _at_rest(frame: Frame, rest: Array) -> Array:
    """y (N,) at rest."""
    return np.asarray(np.sum(frame.row * rest, axis=(1, 2)))


def balanced(machines: Machines) -> NDArray[np.bool_]:
    """Whether y rests midway between both stops, or anywhere, to rounding: motion is symmetric where the force is.

    That is where no force f holds y in their middle m, K x + f g = load and g . x = m: where |f| is at most what ULPS
    of each entry make of it. With K v + s g = 0 and g . v = 1 they change it by
    |v| . (|load| + |K| |x|) + |s| (|g| . |x| + |upper| + |lower|).
    """
    stiffness, row, load = machines.stiffness, machines.gap_row, machines.load
    middle = 0.5 * (machines.upper + machines.lower)
    found = np.isnan(middle) | (~np.any(load != 0.0, axis=1) & (middle == 0.0))  # NaN: both are infinitely far away
    rows = np.flatnonzero(~found & np.isfinite(middle))
    K, g, n = stiffness[rows], row[rows], row.shape[1]
    size = np.max(np.abs(K), axis=(1, 2), initial=0.0)
    size = np.where(size > 0.0, size, 1.0)[:, None]  # for the border to be of the size of the rest
    matrix, right = np.zeros((len(rows), n + 1, n + 1)), np.zeros((len(rows), n + 1, 2))
    matrix[:, :n, :n] = K
    matrix[:, :n, n] = matrix[:, n, :n] = size * g
    right[:, :n, 0], right[:, n, 0], right[:, n, 1] = load[rows], middle[rows] * size[:, 0], size[:, 0]
    both = stacked(np.linalg.solve, right.shape, matrix, right)
    x, v = np.abs(both[:, :n, 0]), np.abs(both[:, :n, 1])
    f, s = np.abs(size * both[:, n]).T
    ends = np.abs(machines.upper[rows]) + np.abs(machines.lower[rows])
    change = dot(v, np.abs(load[rows]) + (np.abs(K) @ x[..., None])[..., 0]) + s * (dot(np.abs(g), x) + ends)
    found[rows] = f <= ULPS * np.finfo(np.float64).eps * change
    return found


def finite(record: Any) -> NDArray[np.bool_]:
    """Which of many records hold finite numbers only."""
    fields = (finite(field) if isinstance(field, tuple) else _finite(field) for field in record)
    return np.asarray(np.logical_and.reduce(list(fields)))


def _finite(field: Array) -> NDArray[np.bool_]:
    """Which rows are finite; to ask of all at once, which is the rule, costs a tenth."""
    known = np.isfinite(field)
    all_known = np.ones(len(field), dtype=np.bool_)
    return all_known if known.all() else np.asarray(known.all(axis=tuple(range(1, field.ndim))))


def mode_of(driven: Driven, columns: Array, direct: Any, omega: Array) -> Mode:
    """The mode of these blocks whose guard is c . blocks + direct sin(k phi); direct (N, H).

    columns (N, n, COLUMN - OF_FLOW) are those that the flow does not decide, see Block.
    """
    (N, n), H = columns.shape[:2], direct.shape[1]
    row = columns[..., :2]
    parts = (row.reshape(N, 1, 2 * n) @ driven.forced.reshape(N, 2 * n, 2 * H)).reshape(N, H, 2)
    waves = np.stack([direct.real + parts[..., 0], direct.imag + parts[..., 1]], axis=-1)
    sizes = np.hypot(waves[..., 0], waves[..., 1])
    w = omega[:, None] * orders_of(direct)
    numbers = (omega, *(np.sum(size, axis=1) for size in (sizes, sizes * w**2, sizes * w**3, sizes * w**4)))
    blocks = driven.block.copy()
    blocks[..., OF_FLOW:] = columns
    return Mode(blocks, driven.metric, waves, np.stack(numbers, axis=-1), driven.forced)


def columns_of(row: Array, kick: Array, modes: Modes) -> Array:
    """The columns of Block that the flow does not decide, of rows c (N, n, 2) and columns k (N, n, 2)."""
    row1 = derivative(row, modes)
    kick1 = np.stack([kick[..., 1], -modes.lam * kick[..., 0] - 2.0 * modes.eta * kick[..., 1]], axis=-1)
    return np.concatenate([row, row1, kick, kick1, derivative(row1, modes)], axis=-1)


def derivative(row: Array, modes: Modes) -> Array:
    """row A, block by block: d/dt (r1 h + r2 h') = -lam r2 h + (r1 - 2 eta r2) h'."""
    return np.stack([-modes.lam * row[..., 1], row[..., 0] - 2.0 * modes.eta * row[..., 1]], axis=-1)


def times(row: Array, matrix: Array) -> Array:
    """row @ matrix of each of many."""
    return np.asarray((row[:, None, :] @ matrix)[:, 0])


def dot(row: Array, other: Array) -> Array:
    """row . other of each of many."""
    return np.asarray((row[:, None, :] @ other[:, :, None])[:, 0, 0])
