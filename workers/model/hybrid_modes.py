"""The modes of hybrid machines, which have soft and rigid contacts, dry friction and phases.

    M x'' + C x' + K x = load + force(omega t + tau) + contacts + friction

A contact is one stop, or two, on y = row . x. Beyond a soft stop, at depth delta > 0, the force preload + stiffness
delta + damping delta' acts. A rigid stop turns y' into -R y'. Friction on v = row . x' - belt resists with kinetic +
slope |v|, and sticks, v = 0, up to ``static``. Phases change matrices, force, load and the constants of elements from
``start`` on, a share of the forcing period.

A mode is a set of linear equations of motion between two events, for one phase and one state of each contact and
friction. Sticking coordinates y = G x are eliminated: x = D y + N q, N spanning ker G, and y has a constant rate. The
equations of a mode are decoupled into blocks, where each y is a rigid motion without load, so all modes of a machine
have the same number of blocks.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.model.block_decomposition import FREE, apply_stacked, split, symmetric
from workers.model.free_flight import BlockFlow, BlockLoading, derivative_of, loading_of, sizes_of
from workers.model.free_flight import mode_of as motion_in
from workers.model.machines import Machines, along_contacts
from workers.model.memoize import memoize_arrays
from workers.model.oscillator import COLUMN, OF_FLOW, OF_GUARD, Array, Mask, Rows, at_rows, make_blocks

OPEN, ON, DETACHED = 0, 1, 2
"""States of a contact, with the sign of its side.

OPEN is open. ON is sticking on a rigid stop, or engaged with a soft one. DETACHED is inside a soft stop that can only
push and does not. In segment j of a law the states are ON + 2 j and DETACHED + 2 j; odd numbers push.
"""

ZERO_SHARE = 1e-12
"""Largest share of the terms of a sum, or of the largest eigenvalue, that counts as rounding of zero."""

NO_FORM, RESONANT = 1, 2
"""Faults of a mode, a set of linear equations: no motion in closed form; undamped resonance. A mode without a fault has
0."""

SIGNALS = 2
"""Number of signals of a contact, the numbers whose ends of range are events. The first is y, or the contact force
while it sticks; the second is the force of a soft contact that is released by force."""


class ModeCode(NamedTuple):
    """The code of a mode, the set of linear equations that holds between two events.

    The code has the phase, the state of each contact, and the sign of each slip, which is 0 while the friction sticks.
    In segment j = 0, 1, ... of a piecewise linear law the slip is +-(1 + j).
    """

    phase: int
    contacts: tuple[int, ...]
    slips: tuple[int, ...]

    @property
    def number(self) -> int:
        """The code as one number, the phase first, for a machine without laws."""
        return self.number_of(1, 1)

    def number_of(self, segments: int, slip_segments: int) -> int:
        """Return the code as one number, for a machine whose laws have room for these numbers of segments."""
        number = self.phase
        for state in self.contacts:
            number = (4 * segments + 1) * number + state + 2 * segments
        for sign in self.slips:
            number = (2 * slip_segments + 1) * number + sign + slip_segments
        return number


FLYING = ModeCode(0, (OPEN,), ())
"""Code of the free flight of a machine with one rigid contact."""


def code_of(number: int, contacts: int, slips: int, segments: int = 1, slip_segments: int = 1) -> ModeCode:
    """Return the code of the mode, a set of linear equations, that ``number`` stands for, see ``ModeCode.number_of``.

    contacts, slips          numbers of contacts and of frictions
    segments, slip_segments  maximum numbers of segments in their force laws
    """
    signs, states = [], []
    for _ in range(slips):
        number, digit = divmod(number, 2 * slip_segments + 1)
        signs.append(digit - slip_segments)
    for _ in range(contacts):
        number, digit = divmod(number, 4 * segments + 1)
        states.append(digit - 2 * segments)
    return ModeCode(number, tuple(reversed(states)), tuple(reversed(signs)))


def pushing(machines: Machines, p: int, c: int, state: int) -> tuple[Array, Array, Array]:
    """Return stiffness, damping and preload (N,) of a soft contact's force.

    machines  the machines
    p, c      phase and contact
    state     state of the contact, which decides the segment of its force law
    """
    stiffness, damping, preload = machines.contact_constants[:, p, c].T
    _, slope, level = machines.contact_laws[:, c, 1 if state > 0 else 0, (abs(state) - 1) // 2].T
    return stiffness + slope, damping, preload + level


def resisting(machines: Machines, p: int, f: int, sign: int) -> tuple[Array, Array]:
    """Return kinetic level and slope (N,) of the force of friction f while it slides in phase p.

    ``sign`` is the slip's number in ModeCode, which decides the segment of the friction law.
    """
    side = 1 if sign > 0 else 0
    kinetic, _, slope = machines.friction_constants[:, p, f, side].T
    _, more, level = machines.friction_laws[:, f, side, abs(sign) - 1].T
    return kinetic + level, slope + more


def _segment(starts: Array, i: int) -> tuple[Array, Array]:
    """Return start and end (N,) of segment i, for segments that begin at ``starts`` (N, S); the last one has no end."""
    return starts[:, i], starts[:, i + 1] if i + 1 < starts.shape[1] else np.full(len(starts), np.inf)


class HybridModes(NamedTuple):
    """A mode, a set of linear equations of motion, of N machines with n blocks, G signals and H harmonics.

    A mode holds between two events. A block is a decoupled equation. A signal is a number computed from the state, with
    an event at each end of its range.

    blocks        (N, G, n, columns) constants of the blocks, and the weights of each signal, see oscillator.Block
    waves         (N, G, H, 2) forced part of each signal, see oscillator.GuardedFlow
    numbers       (N, G, NUMBER) see oscillator.ForcedBounds
    forced        (N, n, 2, H, 2) forced response of the blocks
    rows          (N, G, 2n + 1) each signal as weights of (x, v, 1)
    direct        (N, G, H, 2) part of each signal that is the force itself
    offset        (N, G) value of each signal with the blocks at rest
    ends          (N, G, 2) range of each signal in this mode, infinite without an end
    to_blocks     (N, 2n, 2n) blocks of (x, v), counted from their rest
    to_physical   (N, 2n, 2n) its inverse
    acceleration  (N, n, 2n + 1) x'' as weights of (x, v, 1)
    drive         (N, n, H, 2) part of x'' that is the force itself
    lost          (N,) number of dimensions of the state that sticking removes
    trace         (N,) trace of M^-1 C of the mode, its contraction of volume
    skew          (N,) see ``_skew``
    """

    blocks: Array
    waves: Array
    numbers: Array
    forced: Array
    rows: Array
    direct: Array
    offset: Array
    ends: Array
    to_blocks: Array
    to_physical: Array
    acceleration: Array
    drive: Array
    lost: Array
    trace: Array
    skew: Array


OF_PIECES = HybridModes._make([5, 5, 4, 6, 4, 5, 3, 4, 4, 4, 4, 5, 2, 2, 2])
"""Number of axes of each field of a record of several modes of many machines, one more than in HybridModes."""


class ModeStructure(NamedTuple):
    """The part of a mode, the linear equations between two events, that does not depend on the forcing frequency.

    flow, loading  decoupled equations of the coordinates that do not stick, and the effect of force and load on them
    still          (N, r, columns) blocks of sticking coordinates
    undriven       (N,) mask of machines in which a load or a belt drives a free motion: no closed form exists

    All other fields are those of HybridModes, for N machines.
    """

    flow: BlockFlow
    loading: BlockLoading
    still: Array
    rows: Array
    direct: Array
    ends: Array
    to_blocks: Array
    to_physical: Array
    acceleration: Array
    drive: Array
    lost: Array
    undriven: Mask


@np.errstate(all="ignore")
def build_modes(machines: Machines, code: ModeCode) -> tuple[HybridModes, NDArray[np.int64]]:
    """Return the mode ``code``, a set of linear equations between two events, of machines, and its faults (N,).

    A fault is 0 if the mode is valid. RESONANT is undamped resonance. NO_FORM means that sticking rows depend on each
    other, invariant planes cannot be separated, or a load drives a free motion that the sticking coordinates leave.
    """
    return build_modes_at(structures_of(machines, code), machines.omega)


@np.errstate(all="ignore")
def structures_of(machines: Machines, code: ModeCode) -> list[tuple[Rows, ModeStructure]]:
    """Return a list of (rows, structure): the part of a mode that does not depend on the forcing frequency.

    A mode is a set of linear equations between two events; ``rows`` are the machines with the same structure. Machines
    are grouped by the friction that sticks on the row of a sticking contact, since the contact forces differ.
    """
    along = along_contacts(machines)
    resting, kind = _resting(machines, code, along)
    if len(resting) == 1:
        return [(np.arange(len(kind)), structure_of_mode(machines, code, along, resting[0]))]
    groups = [(np.flatnonzero(kind == i), some) for i, some in enumerate(resting)]
    return [(rows, structure_of_mode(at_rows(machines, rows), code, along[rows], some)) for rows, some in groups]


@np.errstate(all="ignore")
def build_modes_at(groups: list[tuple[Rows, ModeStructure]], omega: Array) -> tuple[HybridModes, NDArray[np.int64]]:
    """Return a mode, a set of linear equations, at forcing frequencies (N,), and its faults (N,), see ``build_modes``.

    ``groups`` has the rest of the equations, which does not depend on the frequency, see ``structures_of``.
    """
    if len(groups) == 1:
        return at_frequencies(groups[0][1], omega)
    parts = [at_frequencies(structure, omega[rows]) for rows, structure in groups]
    order = np.argsort(np.concatenate([rows for rows, _ in groups]), kind="stable")
    return (
        HybridModes(*(np.concatenate(fields)[order] for fields in zip(*(pieces for pieces, _ in parts), strict=True))),
        np.concatenate([wrong for _, wrong in parts])[order],
    )


def structure_of_mode(machines: Machines, code: ModeCode, along: Array, resting: dict[int, int]) -> ModeStructure:
    """Return the linear equations of a mode without the effect of the forcing frequency, for equal ``resting``.

    machines, code  the machines and the mode, with phase, contacts and friction
    along           (N, F, C) see along_contacts
    resting         index of the sticking contact for each friction that sticks on the contact's row, see ``_resting``
    """
    p, mass = code.phase, machines.mass
    N, n = machines.load.shape[0], machines.load.shape[2]
    damping, stiffness, load = (field[:, p].copy() for field in (machines.damping, machines.stiffness, machines.load))
    force = machines.force_sin[:, p] + 1j * machines.force_cos[:, p]
    closed_rows = []
    for c, state in enumerate(code.contacts):
        row = machines.row[:, c]
        if abs(state) == ON and not machines.soft[:, c].any():
            closed_rows.append(row)
        elif state % 2:
            (k, d, preload), stop = pushing(machines, p, c, state), machines.stops[:, c, 1 if state > 0 else 0]
            square = row[:, :, None] * row[:, None, :]
            stiffness += k[:, None, None] * square
            damping += d[:, None, None] * square
            load += (k * stop - np.sign(state) * preload)[:, None] * row
    stuck = [machines.friction_rows[:, f] for f, sign in enumerate(code.slips) if sign == 0 and f not in resting]
    for f, sign in enumerate(code.slips):
        if sign != 0:
            row, (kinetic, slope) = machines.friction_rows[:, f], resisting(machines, p, f, sign)
            damping += slope[:, None, None] * row[:, :, None] * row[:, None, :]
            load += (slope * machines.belt[:, f] - np.sign(sign) * kinetic)[:, None] * row
    belts = [machines.belt[:, f] for f, sign in enumerate(code.slips) if sign == 0 and f not in resting]
    G, moves = np.zeros((N, 0, n)), np.zeros((N, 0), np.bool_)
    if closed_rows or stuck:
        G, moves = (
            np.stack([*closed_rows, *stuck], axis=1),
            np.stack([*[np.zeros(N)] * len(closed_rows), *belts], axis=1) != 0.0,
        )
    inverse_mass = apply_stacked(np.linalg.inv, mass.shape, mass)
    D, hold = _holding(G, inverse_mass, symmetric(mass))
    forces = np.concatenate([-stiffness, -damping, load[:, :, None]], axis=2)  # rows on (x, v, 1)
    free = inverse_mass - D @ G @ inverse_mass  # along sticking rows nothing accelerates
    acceleration, drive = free @ forces, force @ np.ascontiguousarray(free.swapaxes(1, 2))
    multipliers, driven = -hold @ forces, -force @ np.ascontiguousarray(hold.swapaxes(1, 2))  # of sticking coordinates
    rows, direct, ends = _signals(machines, code, resting, along, multipliers, driven)
    flow, loading, to_blocks, to_physical, undriven = _reduced(mass, damping, stiffness, load, force, G, D, moves)
    drive = np.ascontiguousarray(np.stack([drive.real, drive.imag], axis=-1).swapaxes(1, 2))
    lost = np.full(N, float(2 * len(closed_rows) + len(stuck)))
    still = make_blocks(*np.zeros((2, N, G.shape[1])))
    return ModeStructure(
        flow, loading, still, rows, direct, ends, to_blocks, to_physical, acceleration, drive, lost, undriven
    )  # fmt: skip


def at_frequencies(structure: ModeStructure, omega: Array) -> tuple[HybridModes, NDArray[np.int64]]:
    """Return a mode, a set of linear equations, at forcing frequencies (N,), and its faults (N,), see ``build_modes``.

    ``structure`` has the part of the equations that does not depend on the frequency.
    """
    rows, to_blocks, to_physical = structure.rows, structure.to_blocks, structure.to_physical
    (N, every), n, r = rows.shape[:2], to_blocks.shape[1] // 2, structure.still.shape[1]
    moving, resonant = motion_in(structure.flow, structure.loading, omega)
    flow = np.concatenate([moving.blocks, structure.still], axis=1)
    flow[:, n - r :, COLUMN.metric] = omega[:, None] ** 2
    forced = np.concatenate([moving.forced, np.zeros((N, r, *moving.forced.shape[2:]))], axis=1)
    blocks: Array = np.repeat(flow[:, None], every, axis=1)
    seen0 = (rows[:, :, : 2 * n] @ to_physical).reshape(N, every, n, 2)
    eta, lam = flow[:, None, :, COLUMN.eta], flow[:, None, :, COLUMN.lam]
    seen1 = derivative_of(seen0, eta, lam)
    blocks[..., OF_FLOW : COLUMN.k0] = np.concatenate([seen0, seen1], axis=-1)
    blocks[..., COLUMN.cAA0 : OF_GUARD] = derivative_of(seen1, eta, lam)
    H = structure.direct.shape[2]
    parts = (seen0.reshape(N, every, 2 * n) @ forced.reshape(N, 2 * n, 2 * H)).reshape(N, every, H, 2)
    waves = parts + structure.direct
    w = omega[:, None, None] * np.arange(1.0, H + 1.0)
    rest = flow[..., COLUMN.rest0 :].reshape(N, 2 * n, 1)
    offset = (rows[:, :, : 2 * n] @ (to_physical @ rest))[..., 0] + rows[:, :, 2 * n]
    pieces = HybridModes(
        blocks, waves, sizes_of(waves, w), forced, rows, structure.direct, offset, structure.ends, to_blocks,
        to_physical, structure.acceleration, structure.drive, structure.lost,
        np.sum(2.0 * flow[..., COLUMN.eta], axis=1), _skew(to_blocks, to_physical, flow[..., COLUMN.metric], omega),
    )  # fmt: skip
    wrong = structure.undriven | structure.flow.modes.inseparable
    wrong |= ~resonant & ~(np.isfinite(to_blocks) & np.isfinite(to_physical)).all(axis=(1, 2))
    return HybridModes(*map(np.ascontiguousarray, pieces)), np.where(wrong, NO_FORM, np.where(resonant, RESONANT, 0))


def _skew(to_blocks: Array, to_physical: Array, metric: Array, omega: Array) -> Array:
    """Return logs (N,) of bounds of the condition number of a change of norm: how unevenly it stretches states.

    The change is from (omega x, v), of Euclidean norm, to the energy norm of the blocks, with weights ``metric`` (N, n)
    of h^2. A condition number is at most what its Frobenius norms, with the equal shares of 2n - 2 directions taken
    out, give for two directions.
    """
    (N, n), one = metric.shape, np.ones_like(metric)
    energy = np.stack([np.sqrt(metric), one], axis=2).reshape(N, 2 * n)
    speed = np.concatenate([one * omega[:, None], one], axis=1)
    to_energy = np.sum((to_blocks * energy[:, :, None] / speed[:, None]) ** 2, axis=(1, 2))
    from_energy = np.sum((to_physical * speed[:, :, None] / energy[:, None]) ** 2, axis=(1, 2))
    return np.asarray(np.arccosh(np.maximum(0.5 * (np.sqrt(to_energy * from_energy) - (2 * n - 2)), 1.0)))


def _resting(machines: Machines, code: ModeCode, along: Array) -> tuple[list[dict[int, int]], NDArray[np.int64]]:
    """Return groups of machines with equal friction on sticking contacts, and the group (N,) of each machine.

    A group is a mapping: from each friction that sticks on the row of a sticking rigid contact to that contact. Whether
    rows agree is seen in ``along``, see along_contacts.
    """
    closed = [c for c, state in enumerate(code.contacts) if abs(state) == ON and not machines.soft[:, c].any()]
    stuck = [f for f, sign in enumerate(code.slips) if sign == 0]
    pairs = [(f, c) for f in stuck for c in closed]
    if not pairs or not len(along):
        return [{}], np.zeros(len(along), dtype=np.int64)
    of_each = np.stack([along[:, f, c] != 0.0 for f, c in pairs], axis=1)
    kinds, kind = np.unique(of_each, axis=0, return_inverse=True)
    return [{f: c for (f, c), holds in zip(pairs, flags, strict=True) if holds} for flags in kinds], kind.reshape(-1)


def _holding(G: Array, inverse_mass: Array, even: Mask) -> tuple[Array, Array]:
    """Return D = M^-1 G' (G M^-1 G')^-1 (N, n, r) and (G M^-1 G')^-1 G M^-1 (N, r, n), G (N, r, n) the sticking rows.

    The second gives the forces that hold y = G x, the first the displacements x that go with y. For symmetric M the two
    are transposes of each other. ``even`` is the mask (N,) of symmetric M.
    """
    turned = np.ascontiguousarray(G.swapaxes(1, 2))
    compliance = G @ inverse_mass @ turned
    hold = apply_stacked(np.linalg.solve, (*G.shape,), compliance, G @ inverse_mass)
    D = hold
    if not np.all(even):
        mirrored = (np.ascontiguousarray(of.swapaxes(1, 2)) for of in (compliance, inverse_mass @ turned))
        D = np.where(even[:, None, None], hold, apply_stacked(np.linalg.solve, (*G.shape,), *mirrored))
    return np.ascontiguousarray(D.swapaxes(1, 2)), hold


def _signals(
    machines: Machines, code: ModeCode, resting: dict[int, int], along: Array, multipliers: Array, driven: Any
) -> tuple[Array, Array, Array]:
    """Return the signals of a mode: weights (N, G, 2n + 1), force parts (N, G, H, 2) and ranges (N, G, 2).

    machines, code  the machines and the mode, a set of linear equations
    resting, along  see ``_resting`` and along_contacts
    multipliers     (N, r, 2n + 1) contact and friction forces that make r displacements stick, as weights of (x, v, 1);
                    contacts come first
    driven          (N, H, r) part of these forces that is the force itself

    A signal is a sum of weighted (x, v, 1) and harmonics of the force; an event occurs at each end of its range.
    """
    p, (_, C, F), (N, H) = code.phase, machines.sizes, driven.shape[:2]
    n, count = machines.load.shape[2], max(1, SIGNALS * C + F)  # the blocks of a single signal are those of the flow
    rows, direct, ends = np.zeros((N, count, 2 * n + 1)), np.zeros((N, count, H, 2)), np.empty((N, count, 2))
    ends[:, :, 0], ends[:, :, 1] = -np.inf, np.inf
    forces = iter(range(multipliers.shape[1]))

    def hold(k: int) -> None:
        i = next(forces)
        rows[:, k] = multipliers[:, i]
        direct[:, k, :, 0], direct[:, k, :, 1] = driven[..., i].real, driven[..., i].imag

    for c, state in enumerate(code.contacts):
        k, side, row = SIGNALS * c, np.sign(state), machines.row[:, c]
        inner, outer = (0, 1) if side > 0 else (1, 0)
        if abs(state) == ON and not machines.soft[:, c].any():
            hold(k)  # the contact force; a pull is possible up to the level of friction that also sticks
            helping = []
            for f in (f for f, at in resting.items() if at == c):
                back, ahead = machines.friction_constants[:, p, f, :, 1].T  # it would slide away from the stop
                level = np.where(side * along[:, f, c] > 0.0, back, ahead)
                helping.append(level * np.abs(along[:, f, c]))
            ends[:, k, outer] = side * sum(helping, np.zeros(N))
            continue
        rows[:, k, :n] = row
        if state == OPEN:
            ends[:, k] = machines.stops[:, c]
            continue
        stop = machines.stops[:, c, outer]
        begins, over = _segment(machines.contact_laws[:, c, outer, :, 0], (abs(state) - 1) // 2)
        ends[:, k, inner], ends[:, k, outer] = stop + side * begins, stop + side * over
        if machines.by_force[:, c].any():
            stiffness, damping, preload = pushing(machines, p, c, state)
            rows[:, k + 1, :n], rows[:, k + 1, n : 2 * n] = (side * f[:, None] * row for f in (stiffness, damping))
            rows[:, k + 1, 2 * n] = preload - side * stiffness * stop
            ends[:, k + 1, 0 if state % 2 else 1] = 0.0
    for f, sign in enumerate(code.slips):
        k = SIGNALS * C + f
        if f in resting:
            continue
        if sign == 0:
            hold(k)
            back, ahead = machines.friction_constants[:, p, f, :, 1].T
            ends[:, k, 0], ends[:, k, 1] = -ahead, back
            continue
        rows[:, k, n : 2 * n], rows[:, k, 2 * n] = machines.friction_rows[:, f], -machines.belt[:, f]
        begins, over = _segment(machines.friction_laws[:, f, 1 if sign > 0 else 0, :, 0], abs(sign) - 1)
        ends[:, k] = np.stack([begins, over] if sign > 0 else [-over, -begins], axis=1)
    return rows, direct, ends


@memoize_arrays
def _reduced(
    mass: Array,
    damping: Array,
    stiffness: Array,
    load: Array,
    force: Any,
    G: Array,
    D: Array,
    moves: Mask,
) -> tuple[BlockFlow, BlockLoading, Array, Array, Mask]:
    """Return the equations of motion while coordinates stick: (flow, loading, to_blocks, to_physical, undriven).

    G      (N, r, n) sticking rows: y = G x are the r displacements that stick
    D      (N, n, r) see ``_holding``
    moves  (N, r) mask of rows with a moving belt

    The results are the decoupled equations, the effect of force and load on them, the transformations (N, 2n, 2n) of
    the states, and a mask (N,) of machines in which a belt drags at a motion without restoring force. The motion is x =
    D y + N q, N spanning the null space of G. With u = y' constant, q = h + rest + a y + b u: a = -(N'KN)^-1 N'K D, b =
    -(N'KN)^-1 N'C (D + N a).
    """
    # Forces along the sticking rows, M x'' + C x' + K x = f + G'p, and y'' = G x'' = 0 give
    # p = -(G M^-1 G')^-1 G M^-1 (f - C x' - K x). With D = M^-1 G' (G M^-1 G')^-1 is G D = 1 and N'M D = N'G' ... = 0,
    # so that N' times the equation, x = D y + N q, has neither p nor y'':
    #     N'MN q'' + N'CN q' + N'KN q = N'f - N'K D y - N'C D u.
    # The right side is linear in time, y = y(0) + u t, and a y + b u is its solution: the terms with y give a, those
    # with u, where q' = a u, give b. The force and the load remain in h.
    N, n = load.shape
    r = G.shape[1]
    free = n - r
    null = null_space(G)
    across = np.ascontiguousarray(null.swapaxes(1, 2))
    m, c, k = across @ mass @ null, _seen_along(damping, across, null), _seen_along(stiffness, across, null)
    modes = split(m, c, k)
    flow = BlockFlow(modes, apply_stacked(np.linalg.inv, m.shape, m), make_blocks(modes.eta, modes.lam))
    loading = loading_of(flow, force @ null, (across @ load[..., None])[..., 0])
    a, b = np.zeros((2, N, free, r))
    undriven = np.zeros(N, dtype=np.bool_)
    if r and free:
        rigid = modes.rigid > 0
        # No spring pulls at a rigid motion, K x = 0: the least solution is taken there.
        a = -_solved(k, rigid, across @ stiffness @ D)
        drags = np.where(moves[:, None], across @ damping @ (D + null @ a), 0.0)
        b = -_solved(k, rigid, drags)
        undone = np.abs(k @ b + drags) > ZERO_SHARE * (np.abs(k) @ np.abs(b) + np.abs(drags))
        undriven = rigid & np.any(undone, axis=(1, 2))  # a belt drags at a motion without restoring force
    gather = flow.inverse_mass @ across @ mass if free else np.zeros((N, 0, n))
    down = np.zeros((N, 2 * n, 2 * n))
    q_rows = np.zeros((N, 2 * free, 2 * n))
    q_rows[:, :free, :n], q_rows[:, :free, n:] = gather - a @ G, -b @ G
    q_rows[:, free:, n:] = gather - a @ G
    down[:, : 2 * free] = modes.to_blocks @ q_rows
    up = np.zeros((N, 2 * n, 2 * n))
    up[:, :n, : 2 * free] = null @ modes.to_physical[:, :free]
    up[:, n:, : 2 * free] = null @ modes.to_physical[:, free:]
    for i in range(r):
        down[:, 2 * free + 2 * i, :n] = down[:, 2 * free + 2 * i + 1, n:] = G[:, i]
        carried = D[:, :, i] + (null @ a[:, :, i, None])[..., 0]
        up[:, :n, 2 * free + 2 * i] = up[:, n:, 2 * free + 2 * i + 1] = carried
        up[:, :n, 2 * free + 2 * i + 1] = (null @ b[:, :, i, None])[..., 0]
    return flow, loading, down, up, undriven


def _seen_along(matrix: Array, across: Array, null: Array) -> Array:
    """Return N'A N of matrices A (N, n, n), zero where it is zero to rounding; ``across`` is N', ``null`` is N.

    N spans the motions that do not stick. A dashpot along a displacement that sticks moves nothing else.
    """
    seen = across @ matrix @ null
    terms = np.abs(across) @ np.abs(matrix) @ np.abs(null)
    return np.where(np.abs(seen) <= FREE * matrix.shape[1] * terms, 0.0, seen)


def _solved(matrix: Array, singular: Mask, right: Array) -> Array:
    """Return X (N, m, r) of matrix X = right; for singular matrices the least X by least squares."""
    safe = np.where(singular[:, None, None], np.eye(matrix.shape[1]), matrix)
    X = np.asarray(apply_stacked(np.linalg.solve, right.shape, safe, right))
    if np.any(singular):
        some, even = matrix[singular], symmetric(matrix[singular])
        inverse = np.linalg.pinv(np.where(even[:, None, None], some, 0.0), rcond=ZERO_SHARE, hermitian=True)
        if not np.all(even):
            inverse[~even] = np.linalg.pinv(some[~even], rcond=ZERO_SHARE)
        X[singular] = inverse @ right[singular]
    return X


def null_space(G: Array) -> Array:
    """Return orthonormal bases (N, n, n - r) of the null spaces of matrices G (N, r, n)."""
    if not G.shape[1]:
        return np.repeat(np.eye(G.shape[2])[None], len(G), axis=0)
    return np.ascontiguousarray(
        np.linalg.qr(np.ascontiguousarray(G.swapaxes(1, 2)), mode="complete")[0][:, :, G.shape[1] :]
    )
