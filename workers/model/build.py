"""From the matrices of machines to the oscillators that the kernels run on.

What one oscillator is made of does not depend on the others, to the bit.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.model.free import (
    Frame,
    Loading,
    centred,
    columns_of,
    complex_force,
    dot,
    drive,
    faults_of,
    finite,
    frame_of,
    free_motion,
    loading_of,
    mode_of,
    phase_of,
    times,
)
from workers.model.modes import FREE, Modes, split, stacked
from workers.model.oscillator import COLUMN, HEAD, Array, Head, Held, Machines, Oscillator, each, one_of, taken
from workers.results import COUPLED_DAMPING, NO_REASON, OUT_OF_DOUBLES, RESONANCE, RIGID_MODE, UNSTABLE, InvalidError

OF_KIND = ("mass", "damping", "stiffness", "gap_row", "force_sin", "force_cos", "load", "upper", "lower")
"""The fields of machines that those of a kind have in common."""


class Clamped(NamedTuple):
    """The motion with y fixed, x = d y + N q with N spanning the null space of the gap row, whatever the forcing
    frequency: its modes and its push; the columns and the direct part of its guard; the rest as in Held.
    """

    modes: Modes
    push: Loading
    columns: Array
    direct: Any
    down: Array
    up: Array
    into: Array
    out: Array
    pushes: Array


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
    first, kind = _kinds(machines)
    few = taken(machines, first)
    force = complex_force(few)
    frame = frame_of(few.mass, few.damping, few.stiffness, few.gap_row)
    push = loading_of(frame.modes, frame.inverse_mass, force, few.load)
    clamped = _clamped(few, force, frame, push)
    even = np.any(force[:, 1::2] != 0.0, axis=(1, 2))[kind]
    frame, push, clamped = taken(frame, kind), taken(push, kind), taken(clamped, kind)
    free = free_motion(frame, push, machines)
    modes, driven, gap = frame.modes, free.driven, free.gap
    held, held_resonant = _held(clamped, machines.omega)
    head = Head(
        top=free.b_upper,
        bottom=-free.b_lower,
        R=machines.R,
        cA2k=np.sum(gap.row2 * gap.blocks[..., COLUMN.k0 : COLUMN.k1 + 1], axis=(1, 2)),
        period=2.0 * np.pi / machines.omega,
        time_unit=1.0 / np.sqrt(np.min(driven.metric, axis=1)),
        upper=machines.upper,
        lower=machines.lower,
        symmetric=np.where((free.b_upper == free.b_lower) & ~even & np.all(driven.load == 0.0, axis=1), 1.0, 0.0),
        gap_mass=1.0 / frame.inverse_gap_mass,
        trace=frame.trace,
    )
    oscillators = Oscillator(
        gap=gap,
        swing=np.sum(np.hypot(driven.forced[..., 0], driven.forced[..., 1]), axis=-1),
        rest=driven.rest,
        to_physical=modes.to_physical,
        to_blocks=modes.to_blocks,
        gap_row=machines.gap_row,
        head=np.stack(head, axis=-1),
        tau=phase_of(machines.tau),
        held=held,
    )
    reasons = np.full(len(head.R), NO_REASON, dtype=np.int8)
    near = oscillators.head.copy()
    near[:, [HEAD.top, HEAD.bottom, HEAD.upper, HEAD.lower]] = 0.0  # a stop may be infinitely far away
    unknown = np.isnan(head.upper) | np.isnan(head.lower)
    reasons[~finite(oscillators._replace(head=near)) | unknown] = OUT_OF_DOUBLES
    of_rest = {
        RESONANCE: held_resonant,
        COUPLED_DAMPING: clamped.modes.inseparable,
        RIGID_MODE: clamped.modes.rigid > 0,
        UNSTABLE: clamped.modes.unstable,
    }
    for reason, holds in faults_of(free):
        reasons[holds | of_rest.get(reason, False)] = reason
    return each(oscillators, lambda field: np.array(field, order="C")), reasons


def _kinds(machines: Machines) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The first machine of each kind, and of which kind each machine is.

    Machines of a kind differ at most in forcing frequency, phase and restitution: a plane has few kinds as a rule, and
    what is made of matrices is made once for each of them.
    """
    fields = [getattr(machines, name) for name in OF_KIND]
    bits = np.concatenate([field.reshape(len(field), math.prod(field.shape[1:])) for field in fields], axis=1)
    numbers: dict[bytes, int] = {}
    keys = bits.view(f"V{bits.itemsize * bits.shape[1]}")[:, 0].tolist()
    kind = np.array([numbers.setdefault(key, len(numbers)) for key in keys], dtype=np.int64)
    return np.unique(kind, return_index=True)[1], kind


def _seen_along(matrix: Array, null: Array) -> Array:
    """N' A N of matrices A (N, n, n), zero where it is so to rounding: a dashpot along y does not move the rest."""
    across = np.ascontiguousarray(null.swapaxes(1, 2))
    found = across @ matrix @ null
    terms = np.abs(across) @ np.abs(matrix) @ np.abs(null)
    return np.where(np.abs(found) <= FREE * matrix.shape[1] * terms, 0.0, found)


def _clamped(machines: Machines, force: Any, frame: Frame, push: Loading) -> Clamped:
    """What holds y of these machines, whose force, frame and push these are; see Clamped.

    Positions are counted from rest, so that what holds y at either stop is opposite where the stops are equally far.
    """
    push, b_upper, b_lower, _ = centred(push, frame, machines)
    mass, damping, stiffness, gap_row = machines.mass, machines.damping, machines.stiffness, machines.gap_row
    N, n = gap_row.shape
    accelerance, free = frame.accelerance, frame.modes
    d = accelerance / frame.inverse_gap_mass[:, None]
    null = _null_space(gap_row)
    across = np.ascontiguousarray(null.swapaxes(1, 2))
    inner = across @ mass @ null
    modes = split(inner, _seen_along(damping, null), _seen_along(stiffness, null))
    inverse_mass = stacked(np.linalg.inv, inner.shape, inner)
    # from (q, q') to (x, x') and back: q = (N.T M N)^-1 N.T M x
    spread, gather = np.zeros((N, 2 * n, 2 * n - 2)), np.zeros((N, 2 * n - 2, 2 * n))
    spread[:, :n, : n - 1] = spread[:, n:, n - 1 :] = null
    gather[:, : n - 1, :n] = gather[:, n - 1 :, n:] = inverse_mass @ across @ mass
    down = modes.to_blocks @ gather @ free.to_physical
    up = free.to_blocks @ spread @ modes.to_physical
    pulls, drags = times(accelerance, stiffness), times(accelerance, damping)
    rows = times(-np.concatenate([times(pulls, null), times(drags, null)], axis=1), modes.to_physical)
    into, out, pushes = np.zeros((N, 2, n - 1, 2)), np.zeros((N, 2, n, 2)), np.zeros((N, 2))
    drift = (free.to_physical[:, :, 1::2] @ push.load[..., None])[..., 0]  # what no rest position balances
    load = times(drift[:, n:], mass) + times(drift[:, :n], damping)  # both are symmetric
    coasts = (free.to_blocks[:, :, n:] @ drift[:, :n, None])[..., 0].reshape(N, n, 2)
    into_rest = (down @ coasts.reshape(N, 2 * n, 1))[..., 0].reshape(N, n - 1, 2)
    for side, position in enumerate((b_upper, -b_lower)):
        y = np.where(np.isfinite(position), position, 0.0)[:, None]
        pull = load - times(d, stiffness) * y  # K is symmetric
        q = stacked(np.linalg.solve, (N, n - 1, 1), across @ stiffness @ null, (across @ pull[..., None]))[..., 0]
        at_rest = (modes.to_blocks[:, :, : n - 1] @ q[..., None])[..., 0].reshape(N, n - 1, 2)
        lifted = (free.to_blocks[:, :, :n] @ (d * y)[..., None])[..., 0].reshape(N, n, 2)
        into[:, side] = into_rest - at_rest
        out[:, side] = (up @ at_rest.reshape(N, 2 * n - 2, 1))[..., 0].reshape(N, n, 2) + lifted - coasts
        pushes[:, side] = dot(accelerance, load) - dot(pulls, d * y + (null @ q[..., None])[..., 0])
    row = rows.reshape(N, n - 1, 2)
    return Clamped(
        modes=modes,
        push=loading_of(modes, inverse_mass, force @ null, np.zeros((N, n - 1))),
        columns=columns_of(row, np.zeros_like(row), modes),
        direct=(force @ accelerance[..., None])[..., 0],
        down=down,
        up=up,
        into=into,
        out=out,
        pushes=pushes,
    )


def _held(clamped: Clamped, omega: Array) -> tuple[Held, NDArray[np.bool_]]:
    """The motion with y fixed at forcing frequencies (N,); resonance."""
    driven = drive(clamped.modes, clamped.push, omega)
    mode = mode_of(driven, clamped.columns, clamped.direct, omega)
    return Held(mode, clamped.down, clamped.up, clamped.into, clamped.out, clamped.pushes), driven.resonant


def _null_space(row: Array) -> Array:
    """Orthonormal bases (N, n, n - 1) of the vectors that the rows send to zero, from reflections of e_1 to them."""
    length = np.sqrt(dot(row, row))
    v = row.copy()
    v[:, 0] += np.copysign(length, row[:, 0])
    reflection = np.eye(row.shape[1]) - 2.0 * v[:, :, None] * v[:, None, :] / dot(v, v)[:, None, None]
    return np.ascontiguousarray(reflection[:, :, 1:])
