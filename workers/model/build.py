"""Conversion of machines with one rigid contact to the oscillators of the kernels.

Each oscillator depends on its own machine only, to the bit.
"""

from types import EllipsisType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.model.free_flight import (
    FlightStructure,
    RestState,
    against,
    centred,
    free_motion,
    phase_of,
    structure_of,
    unbalanced,
)
from workers.model.hybrid_modes import (
    ON,
    RESONANT,
    HybridModes,
    ModeCode,
    ModeStructure,
    at_frequencies,
    structure_of_mode,
)
from workers.model.machines import Machines, along_contacts, faults
from workers.model.memoize import memoize_arrays
from workers.model.mode_table import no_table
from workers.model.oscillator import (
    COLUMN,
    HEAD,
    Array,
    Mask,
    Oscillator,
    OscillatorScalars,
    Rows,
    at_rows,
    finite,
    growth_of,
    map_fields,
    numbers_of,
)  # fmt: skip
from workers.results import NO_OSCILLATOR, NO_REASON, OUT_OF_DOUBLES

Kinds = Rows | EllipsisType
"""Index of the kind of each machine, see ``_kinds``; an ellipsis for a single machine."""


@np.errstate(all="ignore")
def build(machines: Machines) -> tuple[Oscillator, NDArray[np.int8]]:
    """Return the oscillators of many machines, and codes (N,) of the reasons why one is invalid.

    The code of a valid oscillator is NO_REASON.

    The reasons are:

    RIGID_MODE       a rigid mode leaves the gap unchanged, or there is more than one rigid mode
    UNSTABLE         a growing motion leaves the gap unchanged
    COUPLED_DAMPING  invariant planes of the motion are inseparable in double precision
    RESONANCE        undamped resonance, without a periodic forced response
    LONG_PERIOD      a forcing period has more free oscillations than double precision can resolve in phase
    NO_OSCILLATOR    a push at the stop does not open the gap, g.M^-1 g <= 0
    OUT_OF_DOUBLES   numbers exceed the range of doubles

    Reasons of ``machines.faults``, which the numbers of a machine alone show, come first.
    """
    few, kind = _kinds(machines)
    structure = structure_of(few)
    at_rest = centred(structure, few)
    sticking, against_held = _sticking(few, structure, at_rest, kind, machines.omega)
    even = np.any((few.force_sin != 0.0) | (few.force_cos != 0.0), axis=(1, 3))[:, 1::2].any(axis=1)[kind]
    structure, at_rest = _of_kind(structure, kind), _of_kind(at_rest, kind)
    gap, against_free = free_motion(structure, at_rest, machines.omega)
    modes, b_upper, b_lower = structure.flow.modes, at_rest.b_upper, at_rest.b_lower
    head = OscillatorScalars(
        top=b_upper,
        bottom=-b_lower,
        R=machines.R[:, 0],
        cA2k=np.sum(gap.row2 * gap.kick, axis=(1, 2)),
        period=2.0 * np.pi / machines.omega,
        time_unit=1.0 / np.sqrt(np.min(gap.metric, axis=1)),
        upper=machines.stops[:, 0, 1],
        lower=machines.stops[:, 0, 0],
        symmetric=np.where((b_upper == b_lower) & ~even & np.all(at_rest.loading.load == 0.0, axis=1), 1.0, 0.0),
        gap_mass=1.0 / structure.inverse_gap_mass,
        trace=2.0 * np.sum(modes.eta, axis=1),
        growth=growth_of(gap.blocks),
    )
    oscillators = Oscillator(
        gap=gap,
        to_physical=modes.to_physical,
        to_blocks=modes.to_blocks,
        gap_row=machines.row[:, 0],
        head=np.stack(head, axis=-1),
        tau=phase_of(machines.tau),
        sticking=sticking,
        table=no_table(len(machines.omega)),
    )
    near = oscillators.head.copy()
    near[:, [HEAD.top, HEAD.bottom, HEAD.upper, HEAD.lower]] = 0.0  # an infinitely distant stop is valid
    near_ones = oscillators._replace(head=near, sticking=sticking._replace(ends=sticking.offset))
    reasons = np.where(finite(near_ones), NO_REASON, OUT_OF_DOUBLES).astype(np.int8)
    reasons[np.isinf(structure.inverse_gap_mass)] = OUT_OF_DOUBLES  # a push at the stop would move nothing
    reasons[structure.inverse_gap_mass <= 0.0] = NO_OSCILLATOR
    for reason, holds in against_free.items():
        reasons[holds | against_held.get(reason, False)] = reason
    wrong = faults(machines)
    return map_fields(oscillators, np.ascontiguousarray), np.where(wrong != NO_REASON, wrong, reasons)


def _kinds(machines: Machines) -> tuple[Machines, Kinds]:
    """Return the first machine of each kind, and the index of the kind of each machine.

    Machines of a kind differ at most in forcing frequency, phase and restitution. The machines of a map are usually of
    few kinds, and all results that depend on matrices are computed once per kind.
    """
    if len(machines.omega) == 1:
        return machines, ...
    bits = numbers_of((*machines.of_flight, machines.stops))
    keys = bits.view(f"V{bits.itemsize * bits.shape[1]}")[:, 0]
    _, first, kind = np.unique(keys, return_index=True, return_inverse=True)
    return at_rows(machines, first), kind


def _of_kind(record: Any, kind: Kinds) -> Any:
    """Return a record with a row for each machine, from ``record`` with a row for each kind of machines.

    ``kind`` has the index of the kind of each machine.
    """
    return record if isinstance(kind, EllipsisType) else at_rows(record, kind)


@memoize_arrays
def _sticking_structure(*fields: Array) -> ModeStructure:
    """Return the equations of motion of machines that stick to their upper stop, apart from the forcing frequency.

    The arguments are the fields of the machines.
    """
    machines = Machines(*fields)
    structure = structure_of_mode(machines, ModeCode(0, (ON,), ()), along_contacts(machines), {})
    one = {name: getattr(structure, name)[:, :1] for name in ("rows", "direct", "ends")}  # signals that end it
    return structure._replace(**one)


def _sticking(
    machines: Machines, structure: FlightStructure, at_rest: RestState, kind: Kinds, omega: Array
) -> tuple[HybridModes, dict[int, Mask]]:
    """Return ``Oscillator.sticking`` of machines of these kinds, and masks (N,) of invalid machines by reason.

    machines            the first machine of each kind
    structure, at_rest  free flight and rest positions of the kinds
    kind                (N,) kind of each machine
    omega               (N,) forcing frequencies

    ``Oscillator.sticking`` has the linear equations of motion while the mass sticks to a stop. States are counted from
    rest. A load that no rest balances drives a rigid mode. States between impacts are then counted from damped motion
    under that load, with constant velocities, which ``rest`` of the decoupled equations removes.
    """
    n, moves = machines.load.shape[2], np.any(at_rest.loading.load)
    load, velocities = unbalanced(structure, at_rest, machines) if moves else (np.zeros_like(machines.load[:, 0]), None)
    none = np.zeros_like(machines.omega)
    stops, R = np.zeros_like(machines.stops), np.zeros_like(machines.R)
    still = machines._replace(load=load[:, None], stops=stops, R=R, omega=none, tau=none)
    sticking = _of_kind(_sticking_structure(*still), kind)
    pieces, wrong = at_frequencies(sticking, omega)
    if moves:
        moving = (pieces.to_blocks[:, :, n:] @ _of_kind(velocities, kind)[..., None])[..., 0]
        pieces.blocks[..., COLUMN.rest0 :] -= moving.reshape(len(omega), 1, n, 2)
    modes = sticking.flow.modes
    return HybridModes(*(field[:, None] for field in pieces)), against(modes, wrong == RESONANT, modes.rigid > 0)
