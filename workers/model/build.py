"""Conversion of machines with one rigid contact to the oscillators of the kernels.

Each oscillator depends on its own machine only, to the bit.
"""

from types import EllipsisType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.model.elements import NO_STOP
from workers.model.free_flight import (
    OF_STRUCTURE,
    FlightStructure,
    RestState,
    against,
    centred,
    finite,
    free_motion,
    numbers_of,
    phase_of,
    structure_of,
    unbalanced,
)
from workers.model.hybrid_machines import GREATEST_R, along_contacts, with_one_contact
from workers.model.hybrid_modes import (
    ON,
    RESONANT,
    HybridModes,
    ModeCode,
    ModeStructure,
    at_frequencies,
    structure_of_mode,
)
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
    SingleContactMachines,
    at_rows,
    growth_of,
    map_fields,
)  # fmt: skip
from workers.results import NO_OSCILLATOR, NO_REASON, OUT_OF_DOUBLES, OUT_OF_RANGE

OF_KIND = (*OF_STRUCTURE, "upper", "lower")
"""Fields of SingleContactMachines in which all machines of one kind, see ``_kinds``, are equal."""

Kinds = Rows | EllipsisType
"""Index of the kind of each machine, see ``_kinds``; an ellipsis for a single machine."""


@np.errstate(all="ignore")
def build(machines: SingleContactMachines) -> tuple[Oscillator, NDArray[np.int8]]:
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

    ``faults`` reports further reasons, which are not repeated here.
    """
    few, kind = _kinds(machines)
    structure = structure_of(few)
    at_rest = centred(structure, few)
    sticking, against_held = _sticking(few, structure, at_rest, kind, machines.omega)
    even = np.any(few.force[:, 1::2] != 0.0, axis=(1, 2))[kind]
    structure, at_rest = _of_kind(structure, kind), _of_kind(at_rest, kind)
    gap, against_free = free_motion(structure, at_rest, machines.omega)
    modes, b_upper, b_lower = structure.flow.modes, at_rest.b_upper, at_rest.b_lower
    head = OscillatorScalars(
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
    return map_fields(oscillators, np.ascontiguousarray), reasons


def faults(machines: SingleContactMachines) -> NDArray[np.int8]:
    """Return the code (N,) of why a machine is invalid, as far as its fields alone show; NO_REASON if it is valid.

    The lower stop must be below the upper one, 0 <= R <= GREATEST_R, and all other fields must be finite.
    """
    reasons = np.full(machines.omega.size, NO_REASON, dtype=np.int8)
    reasons[~((machines.lower < machines.upper) & (machines.R >= 0.0) & (machines.R <= GREATEST_R))] = OUT_OF_RANGE
    others = [getattr(machines, name) for name in SingleContactMachines._fields if name not in NO_STOP]
    reasons[np.isnan(machines.upper) | np.isnan(machines.lower)] = OUT_OF_DOUBLES  # infinite stops are valid
    reasons[~finite(others)] = OUT_OF_DOUBLES
    return reasons


def _kinds(machines: SingleContactMachines) -> tuple[SingleContactMachines, Kinds]:
    """Return the first machine of each kind, and the index of the kind of each machine.

    Machines of a kind differ at most in forcing frequency, phase and restitution. The machines of a map are usually of
    few kinds, and all results that depend on matrices are computed once per kind.
    """
    if len(machines.omega) == 1:
        return machines, ...
    bits = numbers_of([getattr(machines, name) for name in OF_KIND])
    keys = bits.view(f"V{bits.itemsize * bits.shape[1]}")[:, 0]
    _, first, kind = np.unique(keys, return_index=True, return_inverse=True)
    return at_rows(machines, first), kind


def _of_kind(record: Any, kind: Kinds) -> Any:
    """Return a record with a row for each machine, from ``record`` with a row for each kind of machines.

    ``kind`` has the index of the kind of each machine.
    """
    return record if isinstance(kind, EllipsisType) else at_rows(record, kind)


@memoize_arrays
def _sticking_structure(
    mass: Array, damping: Array, stiffness: Array, gap_row: Array, force_sin: Array, force_cos: Array, load: Array
) -> ModeStructure:
    """Return the equations of motion of machines that stick to their upper stop, apart from the forcing frequency.

    The arguments are the fields OF_STRUCTURE of the machines.
    """
    none = np.zeros(len(mass))
    machines = SingleContactMachines(
        mass, damping, stiffness, gap_row, force_sin, force_cos, load, none, none, none, none, none
    )
    hybrid = with_one_contact(machines, load, np.zeros((len(mass), 2)))
    structure = structure_of_mode(hybrid, ModeCode(0, (ON,), ()), along_contacts(hybrid), {})
    one = {name: getattr(structure, name)[:, :1] for name in ("rows", "direct", "ends")}  # signals that end it
    return structure._replace(**one)


def _sticking(
    machines: SingleContactMachines, structure: FlightStructure, at_rest: RestState, kind: Kinds, omega: Array
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
    n, moves = machines.gap_row.shape[1], np.any(at_rest.loading.load)
    load, velocities = unbalanced(structure, at_rest, machines) if moves else (np.zeros_like(machines.load), None)
    sticking = _of_kind(_sticking_structure(*(getattr(machines, name) for name in OF_STRUCTURE[:-1]), load), kind)
    pieces, wrong = at_frequencies(sticking, omega)
    if moves:
        moving = (pieces.to_blocks[:, :, n:] @ _of_kind(velocities, kind)[..., None])[..., 0]
        pieces.blocks[..., COLUMN.rest0 :] -= moving.reshape(len(omega), 1, n, 2)
    modes = sticking.flow.modes
    return HybridModes(*(field[:, None] for field in pieces)), against(modes, wrong == RESONANT, modes.rigid > 0)
