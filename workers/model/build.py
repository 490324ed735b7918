"""From the matrices of machines to the oscillators that the kernels run on.

What one oscillator is made of does not depend on the others, to the bit.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.model.modes import Modes, split, stacked
from workers.model.oscillator import (
    COLUMN,
    LARGEST_ANGLE,
    Array,
    Held,
    Machines,
    Oscillator,
    Signal,
    each,
    make_blocks,
    one_of,
)
from workers.results import (
    COUPLED_DAMPING,
    LONG_PERIOD,
    NO_REASON,
    OUT_OF_DOUBLES,
    RESONANCE,
    RIGID_MODE,
    UNSTABLE,
    InvalidError,
)

UNSEEN = 1e-9
"""Share of a rigid mode in the gap coordinate, of what the mode could have at most, below which the gap misses it."""


class _Driven(NamedTuple):
    """Blocks with what force and load do to them.

    modes; metric and load (N, n), rest (N, n, 2); forced (N, n, 2, H, 2); resonant (N,).
    """

    modes: Modes
    metric: Array
    load: Array
    rest: Array
    forced: Array
    resonant: NDArray[np.bool_]


def build_one(machine: Machines) -> Oscillator:
    """The oscillator of the only machine; InvalidError where there is a reason against it."""
    oscillators, reasons = build(machine)
    if reasons[0] != NO_REASON:
        raise InvalidError(int(reasons[0]))
    return one_of(oscillators, 0)


def build(machines: Machines) -> tuple[Oscillator, NDArray[np.int8]]:
    """The oscillators of many machines, and the reason why there is none, or NO_REASON, of each.

    Reasons are a rigid mode that the gap does not see, or more than one; motion that grows; damping whose planes cannot
    be told apart in double precision; undamped resonance, where no periodic forced response exists; a forcing period
    of more free oscillations than double precision keeps the phase of; and numbers beyond its range.
    """
    with np.errstate(all="ignore"):
        found = _build(Machines(*(np.ascontiguousarray(field) for field in machines)))
    return found


def _build(machines: Machines) -> tuple[Oscillator, NDArray[np.int8]]:
    mass, damping, stiffness, gap_row, force_sin, force_cos, load, omega, tau, upper, lower, R = machines
    N, n = gap_row.shape
    H = force_sin.shape[1]
    orders = np.arange(1.0, H + 1.0)
    force = force_sin + 1j * force_cos  # of e^(i k phi), whose imaginary part counts
    accelerance = stacked(np.linalg.solve, (N, n, 1), mass, gap_row[..., None])[..., 0]
    softness = dot(gap_row, accelerance)
    d = accelerance / softness[:, None]
    modes = split(mass, damping, stiffness)
    free = _driven(modes, stacked(np.linalg.inv, (N, n, n), mass), force, load, omega, orders)
    row = _times(np.concatenate([gap_row, np.zeros((N, n))], axis=1), modes.to_physical).reshape(N, n, 2)
    column = np.concatenate([np.zeros((N, n)), d], axis=1)
    kick = (modes.to_blocks @ column[..., None])[..., 0].reshape(N, n, 2)
    free, unseen = _centred(free, row, gap_row, accelerance, upper, lower)
    gap = _signal(modes, free, row)
    y0 = np.sum(row * free.rest, axis=(1, 2))
    no_force = np.zeros((N, H), dtype=np.complex128)
    held, held_lost, held_resonant = _held(machines, free, accelerance, d, force, orders)
    period = 2.0 * np.pi / omega
    turns = np.where(gap.block[..., COLUMN.d] > 0.0, gap.block[..., COLUMN.w], 0.0) * period[:, None]
    phase = np.fmod(tau, 2.0 * np.pi)
    even = np.any(force[:, 1::2] != 0.0, axis=(1, 2))
    b_upper, b_lower = upper - y0, y0 - lower
    oscillators = Oscillator(
        gap=_with_force(gap, free.forced, no_force, omega, orders),
        kick=kick,
        kick1=np.stack([kick[..., 1], -modes.lam * kick[..., 0] - 2.0 * modes.eta * kick[..., 1]], axis=-1),
        cA2k=np.sum(gap.row2 * kick, axis=(1, 2)),
        forced=free.forced,
        swing=np.sum(np.hypot(free.forced[..., 0], free.forced[..., 1]), axis=-1),
        rest=free.rest,
        to_physical=modes.to_physical,
        to_blocks=modes.to_blocks,
        gap_row=gap_row,
        upper=upper,
        lower=lower,
        b_upper=b_upper,
        b_lower=b_lower,
        symmetric=np.where((b_upper == b_lower) & ~even & np.all(free.load == 0.0, axis=1), 1.0, 0.0),
        R=R,
        gap_mass=1.0 / softness,
        time_unit=1.0 / np.sqrt(np.min(free.metric, axis=1)),
        period=period,
        tau=np.where(np.abs(phase) > np.pi, phase - np.copysign(2.0 * np.pi, phase), phase),
        trace=2.0 * np.sum(modes.eta, axis=1),
        held=held,
    )
    reasons = np.full(N, NO_REASON, dtype=np.int8)
    near = oscillators._replace(upper=R, lower=R, b_upper=R, b_lower=R)  # a stop may be infinitely far away
    finite = _finite(near) & ~(np.isnan(upper) | np.isnan(lower))
    for reason, holds in (
        (OUT_OF_DOUBLES, ~finite),
        (LONG_PERIOD, np.max(turns, axis=1) > LARGEST_ANGLE),
        (RESONANCE, free.resonant | held_resonant),
        (COUPLED_DAMPING, modes.inseparable | held_lost.inseparable),
        (RIGID_MODE, unseen | (modes.rigid > 1) | (held_lost.rigid > 0)),
        (UNSTABLE, modes.unstable | held_lost.unstable),
    ):
        reasons[holds] = reason
    return each(oscillators, lambda field: np.array(field, order="C")), reasons


def _driven(modes: Modes, flexibility: Array, force: Any, load: Array, omega: Array, orders: Array) -> _Driven:
    """The blocks with the forced response and the rest position that force (N, H, n) and load (N, n) give them.

    Both enter a block as (h0, h1)' = A (h0, h1) + (l0, l1). flexibility is M^-1.
    """
    N, n = modes.eta.shape
    into = modes.to_blocks[:, :, n:] @ flexibility  # (N, 2n, n)
    drive = (into[:, None] @ force[..., None])[..., 0].reshape(N, len(orders), n, 2)
    steady = (into @ load[..., None])[..., 0].reshape(N, n, 2)
    rigid = modes.lam == 0.0
    l0, l1 = steady[..., 0], steady[..., 1]
    p = l1 + 2.0 * modes.eta * l0
    at_rest = np.where(rigid, 0.0, p / np.where(rigid, 1.0, modes.lam))
    forced, resonant = _response(modes, drive, omega, orders)
    return _Driven(
        modes=modes,
        metric=np.where(rigid, omega[:, None] ** 2, modes.lam),
        load=np.where(rigid, p, 0.0),
        rest=np.stack([at_rest, -l0], axis=-1),
        forced=forced,
        resonant=resonant,
    )


def _response(modes: Modes, drive: Any, omega: Array, orders: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Forced response (N, n, 2, H, 2) of blocks to complex amplitudes (N, H, n, 2) of e^(i k phi); resonance (N,).

    Z = (l1 + (2 eta + i w) l0) / (lam - w^2 + 2 i eta w) with w = k omega, and i w Z - l0 of the velocity.
    """
    w = omega[:, None, None] * orders[None, :, None]
    eta, lam = modes.eta[:, None], modes.lam[:, None]
    l0, l1 = drive[..., 0], drive[..., 1]
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


def _centred(
    free: _Driven, row: Array, gap_row: Array, accelerance: Array, upper: Array, lower: Array
) -> tuple[_Driven, NDArray[np.bool_]]:
    """The blocks with a rigid mode's position counted from between the stops, or from the only one; and where it is
    one that the gap does not see.
    """
    rigid = free.modes.lam == 0.0
    moving = np.any(rigid, axis=1)
    share = np.sum(np.where(rigid, row[..., 0], 0.0), axis=1)
    softness = dot(gap_row, accelerance)
    unseen = moving & (np.abs(share) < UNSEEN * np.sqrt(softness))
    middle = np.where(np.isfinite(upper) & np.isfinite(lower), 0.5 * (upper + lower), np.where(
        np.isfinite(upper), upper, np.where(np.isfinite(lower), lower, 0.0)))  # fmt: skip
    y0 = np.sum(row * free.rest, axis=(1, 2))
    move = np.where(moving & ~unseen, (middle - y0) / np.where(share != 0.0, share, 1.0), 0.0)
    rest = free.rest.copy()
    rest[..., 0] += np.where(rigid, move[:, None], 0.0)
    return free._replace(rest=rest), unseen


def _held(
    machines: Machines, free: _Driven, accelerance: Array, d: Array, force: Any, orders: Array
) -> tuple[Held, Modes, NDArray[np.bool_]]:
    """The motion with y fixed, x = d y + N q with N spanning the null space of the gap row; its modes; resonance."""
    mass, damping, stiffness, gap_row, load, omega = (
        machines.mass, machines.damping, machines.stiffness, machines.gap_row, machines.load, machines.omega
    )  # fmt: skip
    N, n = gap_row.shape
    null = _null_space(gap_row)
    across = np.ascontiguousarray(null.swapaxes(1, 2))
    inner = across @ mass @ null
    modes = split(inner, across @ damping @ null, across @ stiffness @ null)
    flexibility = stacked(np.linalg.inv, inner.shape, inner)
    none = np.zeros((N, n - 1))
    held = _driven(modes, flexibility, force @ null, none, omega, orders)
    # from (q, q') to (x, x') and back: q = (N.T M N)^-1 N.T M x
    spread, gather = np.zeros((N, 2 * n, 2 * n - 2)), np.zeros((N, 2 * n - 2, 2 * n))
    spread[:, :n, : n - 1] = spread[:, n:, n - 1 :] = null
    gather[:, : n - 1, :n] = gather[:, n - 1 :, n:] = flexibility @ across @ mass
    down = modes.to_blocks @ gather @ free.modes.to_physical
    up = free.modes.to_blocks @ spread @ modes.to_physical
    pulls, drags = _times(accelerance, stiffness), _times(accelerance, damping)
    rows = _times(-np.concatenate([_times(pulls, null), _times(drags, null)], axis=1), modes.to_physical)
    into, out, push = np.zeros((N, 2, n - 1, 2)), np.zeros((N, 2, n, 2)), np.zeros((N, 2))
    into_rest = (down @ free.rest.reshape(N, 2 * n, 1))[..., 0].reshape(N, n - 1, 2)
    for side, position in enumerate((machines.upper, machines.lower)):
        y = np.where(np.isfinite(position), position, 0.0)[:, None]
        pull = load - _times(d, stiffness) * y  # K is symmetric
        q = stacked(np.linalg.solve, (N, n - 1, 1), across @ stiffness @ null, (across @ pull[..., None]))[..., 0]
        at_rest = (modes.to_blocks[:, :, : n - 1] @ q[..., None])[..., 0].reshape(N, n - 1, 2)
        lifted = (free.modes.to_blocks[:, :, :n] @ (d * y)[..., None])[..., 0].reshape(N, n, 2)
        into[:, side] = into_rest - at_rest
        out[:, side] = (up @ at_rest.reshape(N, 2 * n - 2, 1))[..., 0].reshape(N, n, 2) + lifted - free.rest
        push[:, side] = dot(accelerance, load) - dot(pulls, d * y + (null @ q[..., None])[..., 0])
    direct = (force @ accelerance[..., None])[..., 0]
    release = _with_force(_signal(modes, held, rows.reshape(N, n - 1, 2)), held.forced, direct, omega, orders)
    return Held(down, up, into, out, held.forced, release, push), modes, held.resonant


def _finite(record: Any) -> NDArray[np.bool_]:
    """Which of many records hold finite numbers only."""
    fields = (_finite(f) if isinstance(f, tuple) else np.isfinite(f).all(axis=tuple(range(1, f.ndim))) for f in record)
    return np.asarray(np.logical_and.reduce(list(fields)))


def _signal(modes: Modes, driven: _Driven, row: Array) -> Signal:
    """The signal row . blocks without a force, its derivative rows from row -> row A."""
    row1 = _derivative(row, modes)
    none = np.zeros(len(row))
    return Signal(
        modes.eta, modes.lam, driven.metric, make_blocks(modes.eta, modes.lam, driven.metric, driven.load),
        row, row1, _derivative(row1, modes), sin_part=none, cos_part=none, amplitude=none, swing=none, omega=none,
    )  # fmt: skip


def _with_force(signal: Signal, response: Array, direct: Any, omega: Array, orders: Array) -> Signal:
    """The signal with its forced part, row . response + direct sin(k phi)."""
    N, n = signal.row.shape[:2]
    H = len(orders)
    parts = (signal.row.reshape(N, 1, 2 * n) @ response.reshape(N, 2 * n, 2 * H)).reshape(N, H, 2)
    sin_part, cos_part = direct.real + parts[..., 0], direct.imag + parts[..., 1]
    sizes = np.hypot(sin_part, cos_part)
    w = omega[:, None] * orders
    powers = [sizes * w**k for k in (2, 3, 4)]
    return signal._replace(
        sin_part=sin_part, cos_part=cos_part, amplitude=np.sum(sizes, axis=1),
        swing=np.stack([np.sum(power, axis=1) for power in powers], axis=-1), omega=omega,
    )  # fmt: skip


def _derivative(row: Array, modes: Modes) -> Array:
    """row A, block by block: d/dt (r1 h + r2 h') = -lam r2 h + (r1 - 2 eta r2) h'."""
    return np.stack([-modes.lam * row[..., 1], row[..., 0] - 2.0 * modes.eta * row[..., 1]], axis=-1)


def _times(row: Array, matrix: Array) -> Array:
    """row @ matrix of each of many."""
    return np.asarray((row[:, None, :] @ matrix)[:, 0])


def dot(row: Array, other: Array) -> Array:
    """row . other of each of many."""
    return np.asarray((row[:, None, :] @ other[:, :, None])[:, 0, 0])


def _null_space(row: Array) -> Array:
    """Orthonormal bases (N, n, n - 1) of the vectors that the rows send to zero, from reflections of e_1 to them."""
    length = np.sqrt(dot(row, row))
    v = row.copy()
    v[:, 0] += np.copysign(length, row[:, 0])
    reflection = np.eye(row.shape[1]) - 2.0 * v[:, :, None] * v[:, None, :] / dot(v, v)[:, None, None]
    return np.ascontiguousarray(reflection[:, :, 1:])
