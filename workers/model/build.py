"""Matrices of machines converted to the oscillators of the kernels.

An oscillator does not depend on the others, to the bit.
"""

from collections.abc import Collection
from functools import lru_cache
from types import EllipsisType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.model.elements import NO_STOP
from workers.model.free import (
    OF_STRUCTURE,
    AtRest,
    Flow,
    Loading,
    Structure,
    against,
    centred,
    finite,
    flow_of,
    free_motion,
    loading_of,
    mode_of,
    numbers_of,
    phase_of,
    structure_of,
    times,
)
from workers.model.hybrid import no_table
from workers.model.modes import FREE, stacked, symmetric
from workers.model.oscillator import (
    HEAD,
    Array,
    Head,
    Held,
    Machines,
    Mask,
    Oscillator,
    Rows,
    at_rows,
    growth_of,
    map_fields,
)  # fmt: skip
from workers.results import NO_OSCILLATOR, NO_REASON, OUT_OF_DOUBLES, OUT_OF_RANGE

OF_KIND = (*OF_STRUCTURE, "upper", "lower")
"""The fields that are equal in machines of a kind."""

Kinds = Rows | EllipsisType
"""The kind of each machine; an ellipsis for a machine by itself."""

STRUCTURES_KEPT = 64
"""Structures kept for further cells solved one by one."""


class HeldStructure(NamedTuple):
    """Motion of N machines at a stop, x = d y + null q, as far as matrices, gap row and force decide it.

    flow of q, its loading by the force, and direct (N, H): share of the force in the acceleration of y itself; null (N,
    n, n - 1), d (N, n); down, up: see Held, without the rest positions; pulls (N, n), the acceleration of y per
    displacement, pushes (N, n) per force, g M^-1.
    """

    flow: Flow
    loading: Loading
    direct: Any
    null: Array
    d: Array
    down: Array
    up: Array
    pulls: Array
    pushes: Array


@np.errstate(all="ignore")
def build(machines: Machines) -> tuple[Oscillator, NDArray[np.int8]]:
    """The oscillators of many machines, and the reason against each, NO_REASON if there is none.

    Reasons: a rigid mode invisible in the gap, or more than one; growing motion invisible in the gap; planes
    inseparable in double precision; undamped resonance, without a periodic forced response; a forcing period of more
    free oscillations than double precision can follow in phase; a gap that a push at the stop does not open, g.M^-1 g
    <= 0; numbers beyond the range of doubles. ``faults`` alone reports its own reasons.
    """
    few, kind = _kinds(machines)
    structure, held_structure = _structures_of(few)
    at_rest = centred(structure, few)
    held, against_held = _held(few, structure, held_structure, at_rest, kind, machines.omega)
    even = np.any(few.force[:, 1::2] != 0.0, axis=(1, 2))[kind]
    structure, at_rest = _of_kind(structure, kind), _of_kind(at_rest, kind)
    gap, against_free = free_motion(structure, at_rest, machines.omega)
    modes, b_upper, b_lower = structure.flow.modes, at_rest.b_upper, at_rest.b_lower
    head = Head(
        top=b_upper,
        bottom=-b_lower,
        R=machines.R,
        cA2k=np.sum(gap.row2 * gap.kick, axis=(1, 2)),
        period=2.0 * np.pi / machines.omega,
        time_unit=1.0 / np.sqrt(np.min(gap.metric, axis=1)),
        upper=machines.upper,
        lower=machines.lower,
        symmetric=np.where((b_upper == b_lower) & ~even & np.all(at_rest.loading.load == 0.0, axis=1), 1.0, 0.0),
        gap_mass=1.0 / structure.inverse_gap_mass,
        trace=2.0 * np.sum(modes.eta, axis=1),
        growth=growth_of(gap.blocks),
    )
    oscillators = Oscillator(
        gap=gap,
        to_physical=modes.to_physical,
        to_blocks=modes.to_blocks,
        gap_row=machines.gap_row,
        head=np.stack(head, axis=-1),
        tau=phase_of(machines.tau),
        held=held,
        table=no_table(len(machines.omega)),
    )
    near = oscillators.head.copy()
    near[:, [HEAD.top, HEAD.bottom, HEAD.upper, HEAD.lower]] = 0.0  # an infinitely distant stop is valid
    reasons = np.where(finite(oscillators._replace(head=near)), NO_REASON, OUT_OF_DOUBLES).astype(np.int8)
    reasons[structure.inverse_gap_mass <= 0.0] = NO_OSCILLATOR
    for reason, holds in against_free.items():
        reasons[holds | against_held.get(reason, False)] = reason
    return map_fields(oscillators, np.ascontiguousarray), reasons


def faults(machines: Machines, fields: Collection[str] = Machines._fields) -> NDArray[np.int8]:
    """The reason against each of N machines, or NO_REASON, as far as these fields show it.

    The lower stop must be below the upper one, and 0 <= R <= 1.
    """
    reasons = np.full(machines.omega.size, NO_REASON, dtype=np.int8)
    if not {"upper", "lower", "R"}.isdisjoint(fields):
        reasons[~((machines.lower < machines.upper) & (machines.R >= 0.0) & (machines.R <= 1.0))] = OUT_OF_RANGE
    others = [getattr(machines, name) for name in fields if name not in NO_STOP]
    reasons[np.isnan(machines.upper) | np.isnan(machines.lower)] = OUT_OF_DOUBLES  # infinite stops are valid
    if others:
        reasons[~finite(others)] = OUT_OF_DOUBLES
    return reasons


def _kinds(machines: Machines) -> tuple[Machines, Kinds]:
    """The first machine of each kind, and the kind of each machine.

    Machines of a kind differ at most in forcing frequency, phase and restitution. A plane has few kinds as a rule, and
    everything made of matrices is made once per kind.
    """
    if len(machines.omega) == 1:
        return machines, ...
    bits = numbers_of([getattr(machines, name) for name in OF_KIND])
    whole = bits.view(f"V{bits.itemsize * bits.shape[1]}")[:, 0]
    _, first, kind = np.unique(whole, return_index=True, return_inverse=True)
    return at_rows(machines, first), kind


def _of_kind(record: Any, kind: Kinds) -> Any:
    """The record of each machine, from the records of kinds."""
    return record if isinstance(kind, EllipsisType) else at_rows(record, kind)


def _seen_along(matrix: Array, null: Array) -> Array:
    """N' A N of matrices A (N, n, n), zero if it is zero to rounding: a dashpot along y does not move the rest."""
    across = np.ascontiguousarray(null.swapaxes(1, 2))
    seen = across @ matrix @ null
    terms = np.abs(across) @ np.abs(matrix) @ np.abs(null)
    return np.where(np.abs(seen) <= FREE * matrix.shape[1] * terms, 0.0, seen)


def _structures_of(machines: Machines) -> tuple[Structure, HeldStructure]:
    """The structure of machines in free flight and at a stop; that of a single machine is kept for the next."""
    if len(machines.omega) > 1:
        return _made(machines)
    fields = [getattr(machines, name) for name in OF_STRUCTURE]
    return _kept(tuple(field.shape for field in fields), tuple(field.tobytes() for field in fields))


@lru_cache(STRUCTURES_KEPT)
def _kept(shapes: tuple[tuple[int, ...], ...], bits: tuple[bytes, ...]) -> tuple[Structure, HeldStructure]:
    """The structure of the machine whose fields OF_STRUCTURE have these shapes and bits."""
    fields = {
        name: np.frombuffer(raw).reshape(shape) for name, raw, shape in zip(OF_STRUCTURE, bits, shapes, strict=True)
    }
    none = np.zeros(1)
    return _made(Machines(**fields, omega=none, tau=none, upper=none, lower=none, R=none))


def _made(machines: Machines) -> tuple[Structure, HeldStructure]:
    structure = structure_of(machines)
    return structure, _held_structure(machines, structure)


def _held_structure(machines: Machines, structure: Structure) -> HeldStructure:
    """The null space of the gap row, the flow in it, and the transformations to and from it."""
    mass, damping, stiffness, gap_row = machines.mass, machines.damping, machines.stiffness, machines.gap_row
    N, n = gap_row.shape
    accelerance, free = structure.accelerance, structure.flow.modes
    null = _null_space(gap_row)
    across = np.ascontiguousarray(null.swapaxes(1, 2))
    pushes = _left(mass, gap_row, accelerance)
    pulls, drags = times(pushes, stiffness), times(pushes, damping)
    flow = flow_of(
        across @ mass @ null,
        _seen_along(damping, null),
        _seen_along(stiffness, null),
        row=-np.concatenate([times(pulls, null), times(drags, null)], axis=1),
        kick=np.zeros((N, 2 * n - 2)),
    )
    # from (q, q') to (x, x') and back: q = (N.T M N)^-1 N.T M x
    spread, gather = np.kron(np.eye(2), null), np.kron(np.eye(2), flow.inverse_mass @ across @ mass)
    return HeldStructure(
        flow=flow,
        loading=loading_of(flow, machines.force @ null, np.zeros((N, n - 1))),
        direct=(machines.force @ pushes[..., None])[..., 0],
        null=null,
        d=accelerance / structure.inverse_gap_mass[:, None],
        down=flow.modes.to_blocks @ gather @ free.to_physical,
        up=free.to_blocks @ spread @ flow.modes.to_physical,
        pulls=pulls,
        pushes=pushes,
    )


def _left(mass: Array, row: Array, accelerance: Array) -> Array:
    """row M^-1 (N, n) for rows whose M^-1 row is the accelerance: the same for symmetric M."""
    if np.all(symmetric(mass)):
        return accelerance
    return np.asarray(stacked(np.linalg.solve, (*row.shape, 1), _turned(mass), row[..., None])[..., 0])


def _turned(matrix: Array) -> Array:
    """The transposes of matrices (N, n, n), in the order of the matrices."""
    return np.ascontiguousarray(matrix.swapaxes(1, 2))


def _held(
    machines: Machines,
    structure: Structure,
    held: HeldStructure,
    at_rest: AtRest,
    kind: Kinds,
    omega: Array,
) -> tuple[Held, dict[int, Mask]]:
    """Motion at the stops of machines of these kinds (N,) at forcing frequencies (N,), and the reasons against it.

    y is fixed: x = d y + N q with N spanning the null space of the gap row. Positions are counted from rest, so the
    forces that hold y at two equally distant stops are opposite.
    """
    mass, damping, stiffness = machines.mass, machines.damping, machines.stiffness
    N, n = machines.gap_row.shape
    free = structure.flow.modes
    flow, loading, direct, null, d, down, up, pulls, pushed = held
    across = np.ascontiguousarray(null.swapaxes(1, 2))
    drift = (free.to_physical[:, :, 1::2] @ at_rest.loading.load[..., None])[..., 0]  # unbalanced by any rest
    load = times(drift[:, n:], _turned(mass)) + times(drift[:, :n], _turned(damping))
    coasts = free.to_blocks[:, :, n:] @ drift[:, :n, None]
    position = np.array([at_rest.b_upper, -at_rest.b_lower])  # of the two stops; likewise all that follows
    y = np.where(np.isfinite(position), position, 0.0)[..., None]
    pull = load - times(d, _turned(stiffness)) * y
    held_by = np.array([across @ stiffness @ null] * 2).reshape(2 * N, n - 1, n - 1)
    q = stacked(np.linalg.solve, (2 * N, n - 1, 1), held_by, (across @ pull[..., None]).reshape(2 * N, n - 1, 1))
    q = q.reshape(2, N, n - 1, 1)
    rest = flow.modes.to_blocks[:, :, : n - 1] @ q
    into = down @ coasts - rest
    out = up @ rest + free.to_blocks[:, :, :n] @ (d * y)[..., None] - coasts
    pushes = np.vecdot(pushed, load) - np.vecdot(pulls, d * y + (null @ q)[..., 0])
    flow = _of_kind(flow, kind)
    mode, resonant = mode_of(flow, _of_kind(loading, kind), omega, direct[kind])
    ways = np.concatenate([down, *into], axis=2), np.concatenate([up, *out], axis=2)
    held_motion = Held(mode, *(field[kind] for field in (*ways, pushes.T)))
    return held_motion, against(flow.modes, resonant, flow.modes.rigid > 0)


def _null_space(row: Array) -> Array:
    """Orthonormal bases (N, n, n - 1) of the null spaces of the rows, from reflections of e_1 to them."""
    length = np.sqrt(np.vecdot(row, row))
    v = row.copy()
    v[:, 0] += np.copysign(length, row[:, 0])
    reflection = np.eye(row.shape[1]) - 2.0 * v[:, :, None] * v[:, None, :] / np.vecdot(v, v)[:, None, None]
    return np.ascontiguousarray(reflection[:, :, 1:])
