"""Machines with modes in the form for kernels: their elements, and a table of the modes built so far.

A mode is a set of linear equations of motion between two events, see hybrid_modes.py. It is built when a motion first
reaches it.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.model.block_decomposition import FREE as RIGID
from workers.model.block_decomposition import apply_stacked, interleaved, symmetric, undamped_modes
from workers.model.free_flight import grows_unseen, phase_of, turns_too_far
from workers.model.hybrid_modes import OF_PIECES, OPEN, HybridModes, ModeCode, build_modes, code_of, null_space
from workers.model.machines import (
    Machines,
    about_centre,
    along_contacts,
    definite,
    faults,
    is_mirror_symmetric,
)
from workers.model.oscillator import (
    COLUMN,
    NUMBER,
    Array,
    GuardedFlow,
    Mask,
    Oscillator,
    OscillatorScalars,
    Rows,
    at_rows,
    empty,
    finite,
    growth_of,
    make_blocks,
    rates_of,
)
from workers.results import LONG_PERIOD, NO_REASON, OUT_OF_DOUBLES, UNSTABLE


class ContactElements(NamedTuple):
    """Contacts and friction of N machines as compiled kernels need them: fields of Machines, and derived fields.

    kick               (N, C, n) M^-1 g / (g M^-1 g), the direction of an impact, g the weights of displacements
    weight             (N, C) 1 / (g M^-1 g) of each contact
    friction_kick      (N, F, n) as kick, of each friction's row
    static_is_kinetic  (N, P, F, 2) 1 if static = kinetic, else 0, for v < 0 and v > 0
    along              (N, F, C) the factor a if a friction's row is a times a contact's row, else 0
    turned             (N, C) see ``_turned``
    depths             (N, C, 2, S) starts of the segments of contact laws, infinite if missing
    speeds             (N, F, 2, S') starts of the segments of friction laws, infinite if missing
    """

    row: Array
    kick: Array
    weight: Array
    stops: Array
    R: Array
    soft: Array
    friction_rows: Array
    friction_kick: Array
    belt: Array
    static_is_kinetic: Array
    along: Array
    starts: Array
    counted: Array
    turned: Array
    depths: Array
    speeds: Array


def elements_of(machines: Machines) -> ContactElements:
    """Return the contacts and friction of machines as the compiled kernels need them."""
    inverse_mass = apply_stacked(np.linalg.inv, machines.mass.shape, machines.mass)

    def along(rows: Array) -> Array:
        pulled = (inverse_mass[:, None] @ rows[..., None])[..., 0]
        return np.ascontiguousarray(pulled / np.vecdot(rows, pulled)[..., None])

    kick = along(machines.row)
    weight = 1.0 / np.vecdot(machines.row, (inverse_mass[:, None] @ machines.row[..., None])[..., 0])
    even = np.ascontiguousarray(
        (machines.friction_constants[..., 0] == machines.friction_constants[..., 1]).astype(np.float64)
    )
    return ContactElements(
        machines.row, kick, weight, machines.stops, machines.R, machines.soft,
        machines.friction_rows, along(machines.friction_rows), machines.belt, even, along_contacts(machines),
        machines.starts,
        machines.counted, _turned(machines, kick),
        *(np.ascontiguousarray(of[..., 0]) for of in (machines.contact_laws, machines.friction_laws)),
    )  # fmt: skip


def _turned(machines: Machines, kick: Array) -> Array:
    """Return logs (N, C) of the condition numbers of x -> x - (1 + R) kick (row . x), the effect of an impact.

    kick  (N, C, n) see ContactElements

    It is 1 for soft contacts. Besides the plane of ``kick`` and ``row`` nothing changes; in it the squares of both
    stretches add up to the square of the Frobenius norm, and their product is R.
    """
    R = np.where(machines.soft > 0.0, 1.0, np.maximum(machines.R, 1e-300))
    uneven = np.vecdot(kick, kick) * np.vecdot(machines.row, machines.row) - 1.0
    squares = 1.0 + R * R + np.where(machines.soft > 0.0, 0.0, (1.0 + R) ** 2 * np.maximum(uneven, 0.0))
    return np.asarray(np.arccosh(np.maximum(squares / (2.0 * R), 1.0)))


class ModeTable(NamedTuple):
    """The modes of N machines built so far, at most K for each machine.

    codes     (N, K) numbers of the modes, see ModeCode, -1 for free slots
    wrong     (N, K) faults of the modes, see ``hybrid_modes.build_modes``
    missing   (N, 1) number of the mode that a motion needs next, -1 if there is none
    pieces    the modes, with an axis (K) after the first
    elements  contacts and friction
    omega     (N,) forcing frequency
    tau       (N,) phase at a section, see free_flight.phase_of
    drifts    (N,) 1 if a coordinate may drift, else 0
    machines  the machines; kernels do not see them

    A mode is a set of linear equations of motion between two events. A section is an instant t = k T, T the forcing
    period.
    """

    codes: NDArray[np.int64]
    wrong: NDArray[np.int64]
    missing: NDArray[np.int64]
    pieces: HybridModes
    elements: ContactElements
    omega: Array
    tau: Array
    drifts: Array
    machines: Machines

    def without_modes(self, N: int) -> "ModeTable":
        """Return the table of N machines with one rigid contact, which has no room for modes; see ``no_table``."""
        return no_table(N)

    def build_missing(self, rows: Rows) -> Rows:
        """Build the mode that each of these machines misses, and return the rows for which a mode was built.

        A mode is a set of linear equations between two events. Machines with a full table stay without the mode.
        """
        rows = rows[self.missing[rows, 0] >= 0]
        if not len(rows):
            return rows
        number, used = self.missing[rows, 0], np.sum(self.codes[rows] >= 0, axis=1)
        rows, number, used = (field[used < self.codes.shape[1]] for field in (rows, number, used))
        for needed in np.unique(number).tolist():
            some, slots = rows[number == needed], used[number == needed]
            code = code_of(needed, *self.machines.sizes[1:], *self.machines.segments)
            pieces, wrong = build_modes(at_rows(self.machines, some), code)
            self.codes[some, slots], self.wrong[some, slots], self.missing[some, 0] = needed, wrong, -1
            for field, new in zip(self.pieces, pieces, strict=True):
                field[some, slots] = new
        return rows


_OF_ELEMENTS = ContactElements._make([3, 3, 2, 3, 2, 2, 3, 3, 2, 4, 3, 2, 2, 2, 4, 4])
_AXES = ModeTable._make([2, 2, 2, OF_PIECES, _OF_ELEMENTS, 1, 1, 1, None])
"""Number of axes of each field of a ModeTable, for many machines."""


@lru_cache(maxsize=64)
def no_table(N: int) -> ModeTable:
    """Return an empty table for N machines with one rigid contact; it is shared and must not be written to.

    Only other machines have modes, sets of linear equations between two events.
    """
    table: ModeTable = empty(_AXES, N)
    codes = np.zeros((N, 0), dtype=np.int64)
    return table._replace(codes=codes, wrong=codes.copy(), missing=np.full((N, 1), -1))


MODE_TABLE_SIZE = 64
"""Maximum number of modes, sets of linear equations, in the table of a machine; each segment of its force laws adds
two."""

MODES_OF_PHASE = 4
"""Maximum number of modes for each phase, if this allows more modes than MODE_TABLE_SIZE."""


@np.errstate(all="ignore")
def build_hybrid(machines: Machines) -> tuple[Oscillator, NDArray[np.int8]]:
    """Return machines with modes in the form for compiled kernels, and codes (N,) of the reasons why one is invalid.

    The code of a valid machine is NO_REASON. No mode, a set of linear equations between two events, is built yet.
    """
    (N, n), (P, C, F), H = machines.load[:, 0].shape, machines.sizes, machines.force_sin.shape[2]
    mass, stiffness = _measuring(machines.mass), _measuring(machines.stiffness[:, 0])
    mass = np.where(definite(mass)[:, None, None], mass, np.eye(n))
    lam, modes = _section_modes(mass, stiffness, machines.drifting)
    lam = np.where(np.abs(lam) <= RIGID * np.max(np.abs(lam), axis=1, initial=0.0)[:, None], 0.0, np.abs(lam))
    turned = np.ascontiguousarray(modes.swapaxes(1, 2))
    metric = np.where(lam == 0.0, machines.omega[:, None] ** 2, lam)
    to_blocks = interleaved(turned @ mass)
    to_physical = np.ascontiguousarray(interleaved(turned).swapaxes(1, 2))
    if machines.drifting >= 0:
        _count_from_drift(to_blocks, to_physical, machines.drifting, machines.omega)
        metric[:, -1] = 1.0
    still, wrong = build_modes(machines, ModeCode(0, (OPEN,) * C, (1,) * F))
    others = [build_modes(machines, ModeCode(p, (OPEN,) * C, (1,) * F))[0] for p in range(1, P)]
    flows = [pieces.blocks[:, 0] for pieces in (still, *others)]
    growth = np.max([growth_of(flow) for flow in flows], axis=0)
    shares = np.diff(machines.starts, axis=1)
    eta = np.sum(shares * np.stack([_slowest(flow, growth, machines.drifting) for flow in flows], axis=1), axis=1)
    trace = np.sum(shares * np.stack([pieces.trace for pieces in (still, *others)], axis=1), axis=1)
    blocks = make_blocks(np.repeat(eta[:, None], n, axis=1), lam)
    blocks[..., COLUMN.metric] = metric
    too_far = [turns_too_far(flow[..., COLUMN.d], flow[..., COLUMN.w], machines.omega) for flow in flows]
    size = np.sum(np.hypot(still.forced[..., 0], still.forced[..., 1]), axis=-1).reshape(N, 2 * n, 1)
    swing = (np.abs(to_blocks) @ (np.abs(still.to_physical) @ size)).reshape(N, n, 2)
    elements = elements_of(machines)
    forced = np.any(swing > 0.0, axis=(1, 2))[:, None, None]
    known = forced & (wrong == 0)[:, None, None] & np.isfinite(swing)
    swing = np.where(known, swing, _unforced_swing(machines, lam, modes, elements.weight))
    blocks[..., COLUMN.swing0 : COLUMN.swing1 + 1] = np.where(np.isfinite(swing), swing, 0.0)
    # The effect of a soft contact, not yet included, is zero if its force depends on its depth alone.
    keeps = np.all(
        (machines.soft == 0.0) | ((machines.by_force == 0.0) & np.all(machines.contact_constants[..., 1] == 0.0, 1)), 1
    )
    none, endless, has_gap = np.zeros(N), np.full(N, np.inf), bool(np.any(machines.counted[:, :1] > 0.0))
    head = OscillatorScalars(
        top=-endless, bottom=endless, R=none + 1.0, cA2k=none, period=2.0 * np.pi / machines.omega,
        time_unit=1.0 / np.sqrt(np.min(metric, axis=1)), symmetric=none,
        upper=machines.stops[:, 0, 1] if has_gap else endless, lower=machines.stops[:, 0, 0] if has_gap else -endless,
        gap_mass=np.where(keeps, 1.0, np.nan), trace=trace, growth=growth,
    )  # fmt: skip
    numbers = np.zeros((N, len(NUMBER)))
    numbers[:, NUMBER.omega] = machines.omega
    pushes = np.any(np.isfinite(elements.depths) & np.isfinite(machines.stops)[..., None], axis=0)  # (C, 2, S)
    sides = np.sum(pushes, axis=(1, 2)) * np.where(machines.by_force.any(axis=0), 2, 1)
    slides = np.isfinite(elements.speeds).any(axis=0).sum(axis=(1, 2))
    most = max(MODE_TABLE_SIZE, MODES_OF_PHASE * P)
    most += 2 * int(np.sum(sides)) + int(np.sum(slides)) if machines.segments != (1, 1) else 0
    room = min(most, P * math.prod([*(1 + slides).tolist(), *(1 + sides).tolist()]))  # all modes, or ``most``
    table = ModeTable(
        np.full((N, room), -1), np.zeros((N, room), dtype=np.int64), np.full((N, 1), -1),
        HybridModes(*(np.zeros((N, room, *field.shape[1:])) for field in still)),
        elements, machines.omega, phase_of(machines.tau),
        np.where(machines.drift >= 0.0, 1.0, 0.0), machines,
    )  # fmt: skip
    row = machines.row[:, 0] if has_gap else np.tile(np.eye(1, n), (N, 1))
    oscillators = Oscillator(
        gap=GuardedFlow(blocks, np.zeros((N, H, 2)), numbers, np.zeros((N, n, 2, H, 2))),
        to_physical=to_physical,
        to_blocks=to_blocks,
        gap_row=np.ascontiguousarray(row),
        head=np.stack(head, axis=-1),
        tau=table.tau,
        sticking=empty(OF_PIECES, N),
        table=table,
    )
    reasons = faults(machines)
    reasons[(reasons == NO_REASON) & np.any(too_far, axis=0)] = LONG_PERIOD
    if P == 1:
        reasons[(reasons == NO_REASON) & (wrong == 0) & _unheld(machines, still)] = UNSTABLE
    fit = finite(
        (to_blocks, to_physical, blocks, *table.elements._replace(stops=none, depths=none, speeds=none, turned=none))
    )
    fit &= np.all(elements.weight > 0.0, axis=1)  # else the inverse is infinite: no contact moves anything
    return oscillators, np.where((reasons == NO_REASON) & ~fit, np.int8(OUT_OF_DOUBLES), reasons)


def is_symmetric(oscillators: Oscillator) -> Mask:
    """Return the mask (N,) of machines that are their own mirror images half a period later."""
    if oscillators.has_modes:
        return is_mirror_symmetric(about_centre(oscillators.table.machines)[0])
    return np.asarray(oscillators.symmetric > 0.0)


def _measuring(matrices: Array) -> Array:
    """Return the symmetric parts of ``matrices`` (N, n, n), with which states of machines are measured."""
    even = symmetric(matrices)[:, None, None]
    return matrices if np.all(even) else np.where(even, matrices, 0.5 * matrices + 0.5 * matrices.swapaxes(1, 2))


def _slowest(flow: Array, growth: Array, drifting: int) -> Array:
    """Return the decay rate (N,) of the slowest of the decoupled equations ``flow``, 0 if one has no damping.

    flow      (N, n, columns) the equations, see oscillator.Block
    growth    (N,) largest growth rate
    drifting  the coordinate that may drift, -1 if there is none

    A drifting position does not decay and is left out. In machines that grow, ``growth`` > 0, the rate is the least
    rate of growth or decay, 0 if there is none.
    """
    rates = -rates_of(flow).real.reshape(len(flow), -1)
    least = np.min(np.where(rates != 0.0, np.abs(rates), np.inf), axis=1, initial=np.inf)
    decays = np.maximum(np.sort(rates, axis=1)[:, 1 if drifting >= 0 else 0], 0.0)
    return np.where(growth > 0.0, np.where(np.isfinite(least), least, 0.0), decays)


def _unheld(machines: Machines, open_pieces: HybridModes) -> Mask:
    """Return the mask (N,) of machines with a growing motion that no contact and no friction sees.

    Such a motion moves no contact's coordinate and slides no friction. ``open_pieces`` are the equations of motion with
    all contacts open and nothing sticking.
    """
    row, slide = machines.row, machines.friction_rows
    rows = np.concatenate([np.pad(row, ((0, 0), (0, 0), (0, row.shape[2]))),
                           np.pad(slide, ((0, 0), (0, 0), (slide.shape[2], 0)))], axis=1)  # fmt: skip
    return grows_unseen(open_pieces.blocks[:, 0], open_pieces.to_physical, rows)


def _unforced_swing(machines: Machines, lam: Array, modes: Array, weight: Array) -> Array:
    """Return the typical sizes (N, n, 2) of h and h' in each decoupled equation of machines without a force.

    lam     (N, n) squared frequencies of the undamped modes
    modes   (N, n, n) the modes in columns
    weight  (N, C) see ContactElements

    The size is the displacement by loads and friction in a radian of the mode, or of the natural period if that is
    faster. Without loads and friction it is the displacement that takes a contact to its nearest stop.
    """
    rate = np.sqrt(np.maximum(lam, machines.omega[:, None] ** 2))
    loads = np.max(np.abs(machines.load @ modes), axis=1)
    static = np.max(machines.friction_constants[..., 1], axis=(1, 3))
    reach = (loads + np.sum(np.abs(machines.friction_rows @ modes) * static[..., None], axis=1)) / rate**2
    rooms = np.abs(machines.stops) * np.sqrt(weight)[..., None]
    nearest = np.min(np.where(rooms > 0.0, rooms, np.inf), axis=(1, 2), initial=np.inf)
    nearest = np.where(np.isfinite(nearest), nearest, 0.0)[:, None]
    reach = np.where(np.any(reach > 0.0, axis=1)[:, None], reach, nearest)
    swing = np.stack([reach, rate * reach], axis=-1)
    if machines.drifting >= 0:  # the last block holds the drift velocity and the position, which is always reset
        swing[:, -1, 0], swing[:, -1, 1] = swing[:, -1, 1].copy(), 0.0
    return swing


def _section_modes(mass: Array, stiffness: Array, drifting: int) -> tuple[Array, Array]:
    """Return squared frequencies and undamped modes of vibration; the free motion of a drifting coordinate comes last.

    That motion is orthogonal to all other modes. ``drifting`` is the coordinate that may drift, -1 if there is none.
    """
    if drifting < 0:
        return undamped_modes(mass, stiffness)
    momentum = mass[:, drifting]  # of the velocities
    null = null_space(momentum[:, None])
    across = np.ascontiguousarray(null.swapaxes(1, 2))
    lam, modes = undamped_modes(across @ mass @ null, across @ stiffness @ null)
    free = np.zeros_like(mass[..., :1])
    free[:, drifting, 0] = 1.0 / np.sqrt(momentum[:, drifting])
    return np.pad(lam, ((0, 0), (0, 1))), np.concatenate([null @ modes, free], axis=2)


def _count_from_drift(to_blocks: Array, to_physical: Array, drifting: int, omega: Array) -> None:
    """Change the transformations of states in place: their last number becomes omega times the drifting coordinate.

    No other number of a state then depends on that coordinate.
    """
    to_blocks[:, -2], to_blocks[:, -1] = to_blocks[:, -1].copy(), 0.0
    to_blocks[:, -1, drifting] = omega
    to_physical[:, :, -2], to_physical[:, :, -1] = to_physical[:, :, -1].copy(), 0.0
    to_physical[:, drifting] = 0.0
    to_physical[:, drifting, -1] = 1.0 / omega
