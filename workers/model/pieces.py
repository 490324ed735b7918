"""Machines whose law changes: soft and rigid contacts, dry friction, phases; each law they can be under is a mode.

    M x'' + C x' + K x = load + force(omega t + tau) + contacts + friction

A contact is a stop, or two, on y = row . x. Beyond a soft one, at depth delta > 0, acts preload + stiffness delta +
damping delta'; a rigid one turns y' into -R y'. Friction on v = row . x' - belt resists with kinetic + slope |v|, and
holds v = 0 up to ``static``. Phases change matrices, force, load and the constants of elements from ``start`` on, a
share of the forcing period.

A mode is an affine linear flow between events: which phase it is, what each contact does and each friction. What is held
or sticks leaves the flow: x = D y + N q with y = G x, which goes at a constant rate, and N spanning what G sends to
zero. In blocks y is a rigid mode without a load, so that all modes of a machine have the same number of blocks.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.model.free import Flow, Mask, loading_of, phase_of, stacked
from workers.model.free import mode_of as motion_in
from workers.model.modes import split
from workers.model.oscillator import COLUMN, OF_FLOW, Array, make_blocks

OPEN, ON, DETACHED = 0, 1, 2
"""What a contact does, with the sign of its side: it is open; held by a rigid stop or engaged by a soft one; or within
a soft one that can only push and does not."""

SIGNALS = 2
"""Signals of a contact: y, or its force while it holds; and the force of a soft one that is released by it."""


class Contact(NamedTuple):
    """A contact of N machines: row (N, n), all else (N,).

    A stop at infinity is none. soft: whether stiffness, damping and preload count, or R; by_force: whether a soft one
    lets go where its force falls to zero, or where its depth does.
    """

    row: Array
    upper: Array
    lower: Array
    R: Array
    stiffness: Array
    damping: Array
    preload: Array
    soft: bool
    by_force: bool


class Friction(NamedTuple):
    """Dry friction in N machines: row (N, n), all else (N,)."""

    row: Array
    kinetic: Array
    static: Array
    belt: Array
    slope: Array


class Law(NamedTuple):
    """What holds in a phase that begins at this share (N,) of a period: matrices (N, n, n), load (N, n), force
    (N, H, n) as amplitudes of e^(i k phi), whose imaginary part counts, and the elements.
    """

    start: Array
    damping: Array
    stiffness: Array
    load: Array
    force: Any
    contacts: tuple[Contact, ...]
    frictions: tuple[Friction, ...]


class PieceMachines(NamedTuple):
    """N machines: mass (N, n, n), omega and tau (N,), and the law of each phase."""

    mass: Array
    omega: Array
    tau: Array
    laws: tuple[Law, ...]


class Code(NamedTuple):
    """Which mode it is: the phase, what each contact does and the sign of each slip, 0 while it sticks."""

    phase: int
    contacts: tuple[int, ...]
    slips: tuple[int, ...]

    @property
    def number(self) -> int:
        """The code as one number: digits of base 5 for contacts and of base 3 for slips, the phase first."""
        found = self.phase
        for state in self.contacts:
            found = 5 * found + state + 2
        for sign in self.slips:
            found = 3 * found + sign + 1
        return found


def code_of(number: int, contacts: int, slips: int) -> Code:
    """The code of a number, of a machine with so many contacts and frictions."""
    signs, states = [], []
    for _ in range(slips):
        number, digit = divmod(number, 3)
        signs.append(digit - 1)
    for _ in range(contacts):
        number, digit = divmod(number, 5)
        states.append(digit - 2)
    return Code(number, tuple(reversed(states)), tuple(reversed(signs)))


class Piece(NamedTuple):
    """A mode of N machines with n blocks, G signals and H harmonics.

    blocks       (N, G, n, columns)    flow of the blocks, and the row of each signal, see oscillator.Block
    metric       (N, n)                their column of that name
    waves        (N, G, H, 2)          forced part of each signal, see oscillator.Mode
    numbers      (N, G, NUMBER)        see oscillator.Numbers
    forced       (N, n, 2, H, 2)       forced response of the blocks
    rows         (N, G, 2n + 1)        each signal as a row on (x, v, 1)
    direct       (N, G, H, 2)          and what the force adds to it
    offset       (N, G)                what it is while the blocks are at rest
    ends         (N, G, 2)             the values between which it stays in this mode, infinite where nothing ends it
    to_blocks    (N, 2n, 2n)           blocks of (x, v), from ``rest`` on; to_physical the way back
    rest         (N, 2n)               blocks at rest, the forced response taken off
    acceleration (N, n, 2n + 1)        x'' as rows on (x, v, 1), drive (N, n, H, 2) and what the force adds to it
    lost         (N,)                  dimensions that the flow does not have
    """

    blocks: Array
    metric: Array
    waves: Array
    numbers: Array
    forced: Array
    rows: Array
    direct: Array
    offset: Array
    ends: Array
    to_blocks: Array
    to_physical: Array
    rest: Array
    acceleration: Array
    drive: Array
    lost: Array


@np.errstate(all="ignore")
def piece(machines: PieceMachines, code: Code) -> tuple[Piece, Mask]:
    """A mode of machines, and of which of them it is none.

    That is where held rows depend on each other, motion grows or resonates undamped, planes cannot be told apart, or a
    load drives a free motion that what is held leaves.
    """
    law, mass, omega = machines.laws[code.phase], machines.mass, machines.omega
    N, n = law.load.shape
    damping, stiffness, load = law.damping.copy(), law.stiffness.copy(), law.load.copy()
    for contact, state in zip(law.contacts, code.contacts, strict=True):
        if contact.soft and abs(state) == ON:
            square = contact.row[:, :, None] * contact.row[:, None, :]
            stop = contact.upper if state > 0 else contact.lower
            stiffness += contact.stiffness[:, None, None] * square
            damping += contact.damping[:, None, None] * square
            load += (contact.stiffness * stop - state * contact.preload)[:, None] * contact.row
    for friction, sign in zip(law.frictions, code.slips, strict=True):
        if sign != 0:
            damping += friction.slope[:, None, None] * friction.row[:, :, None] * friction.row[:, None, :]
            load += (friction.slope * friction.belt - sign * friction.kinetic)[:, None] * friction.row
    held = [c.row for c, state in zip(law.contacts, code.contacts, strict=True) if not c.soft and abs(state) == ON]
    stuck = [f.row for f, sign in zip(law.frictions, code.slips, strict=True) if sign == 0]
    G = np.stack([*held, *stuck], axis=1) if held or stuck else np.zeros((N, 0, n))
    inverse_mass = np.linalg.inv(mass)
    D, hold = _holding(G, inverse_mass)
    forces = np.concatenate([-stiffness, -damping, load[:, :, None]], axis=2)  # rows on (x, v, 1)
    kept = inverse_mass - D @ G @ inverse_mass
    acceleration, drive = kept @ forces, law.force @ np.ascontiguousarray(kept.swapaxes(1, 2))
    multipliers, driven = -hold @ forces, -law.force @ np.ascontiguousarray(hold.swapaxes(1, 2))  # of what is held
    rows, direct, ends = _signals(law, code, multipliers, driven)
    reduced, to_blocks, to_physical, rest, wrong = _reduced(mass, damping, stiffness, load, law.force, G, D, omega)
    flow, forced = reduced
    every = rows.shape[1]
    blocks, metric = np.repeat(flow[:, None], every, axis=1), flow[..., COLUMN.metric].copy()
    c = (rows[:, :, : 2 * n] @ to_physical).reshape(N, every, n, 2)
    eta, lam = flow[:, None, :, COLUMN.eta], flow[:, None, :, COLUMN.lam]
    c1 = _derivative(c, eta, lam)
    blocks[..., OF_FLOW : COLUMN.k0] = np.concatenate([c, c1], axis=-1)
    blocks[..., COLUMN.cAA0 :] = _derivative(c1, eta, lam)
    H = law.force.shape[1]
    parts = (c.reshape(N, every, 2 * n) @ forced.reshape(N, 2 * n, 2 * H)).reshape(N, every, H, 2)
    waves = parts + direct
    w = omega[:, None, None] * np.arange(1.0, H + 1.0)
    sizes = np.hypot(waves[..., 0], waves[..., 1])
    numbers = np.stack([np.repeat(omega[:, None], every, axis=1),
                        *(np.sum(sizes * w**power, axis=2) for power in (0, 2, 3, 4))], axis=-1)  # fmt: skip
    offset = (rows[:, :, : 2 * n] @ (to_physical @ rest[..., None]))[..., 0] + rows[:, :, 2 * n]
    found = Piece(
        blocks, metric, waves, numbers, forced, rows, direct, offset, ends, to_blocks, to_physical, rest, acceleration,
        np.ascontiguousarray(np.stack([drive.real, drive.imag], axis=-1).swapaxes(1, 2)),
        np.full(N, float(2 * len(held) + len(stuck))),
    )  # fmt: skip
    return Piece(*map(np.ascontiguousarray, found)), wrong


def _holding(G: Array, inverse_mass: Array) -> tuple[Array, Array]:
    """D (N, n, r) = M^-1 G' (G M^-1 G')^-1 and (G M^-1 G')^-1 G M^-1 (N, r, n) of rows G (N, r, n) that are held."""
    turned = np.ascontiguousarray(G.swapaxes(1, 2))
    compliance = G @ inverse_mass @ turned
    hold = stacked(np.linalg.solve, (*G.shape,), compliance, G @ inverse_mass)
    return np.ascontiguousarray(hold.swapaxes(1, 2)), hold


def _signals(law: Law, code: Code, multipliers: Array, driven: Any) -> tuple[Array, Array, Array]:
    """Rows (N, G, 2n + 1), what the force adds (N, G, H, 2) and ends (N, G, 2) of the signals of a mode.

    multipliers (N, r, 2n + 1) and driven (N, H, r): the forces of what is held, in the order of contacts and friction.
    """
    N, n = law.load.shape
    count = max(1, SIGNALS * len(law.contacts) + len(law.frictions))  # the blocks of one are those of the flow
    rows, direct = np.zeros((N, count, 2 * n + 1)), np.zeros((N, count, law.force.shape[1], 2))
    ends = np.empty((N, count, 2))
    ends[:, :, 0], ends[:, :, 1] = -np.inf, np.inf
    held = 0

    def hold(k: int) -> None:
        nonlocal held
        rows[:, k] = multipliers[:, held]
        direct[:, k, :, 0], direct[:, k, :, 1] = driven[..., held].real, driven[..., held].imag
        held += 1

    for c, (contact, state) in enumerate(zip(law.contacts, code.contacts, strict=True)):
        k, side = SIGNALS * c, float(np.sign(state))
        stop = contact.upper if state > 0 else contact.lower
        if not contact.soft and abs(state) == ON:
            hold(k)
            ends[:, k, 1 if side > 0 else 0] = 0.0
            continue
        rows[:, k, :n] = contact.row
        if state == OPEN:
            ends[:, k, 0], ends[:, k, 1] = contact.lower, contact.upper
            continue
        ends[:, k, 0 if side > 0 else 1] = stop
        if contact.by_force:
            stiffness, damping = side * contact.stiffness[:, None], side * contact.damping[:, None]
            rows[:, k + 1, :n], rows[:, k + 1, n : 2 * n] = stiffness * contact.row, damping * contact.row
            rows[:, k + 1, 2 * n] = contact.preload - side * contact.stiffness * stop
            ends[:, k + 1, 0 if abs(state) == ON else 1] = 0.0
    for f, (friction, sign) in enumerate(zip(law.frictions, code.slips, strict=True)):
        k = SIGNALS * len(law.contacts) + f
        if sign == 0:
            hold(k)
            ends[:, k, 0], ends[:, k, 1] = -friction.static, friction.static
            continue
        rows[:, k, n : 2 * n], rows[:, k, 2 * n] = friction.row, -friction.belt
        ends[:, k, 0 if sign > 0 else 1] = 0.0
    return rows, direct, ends


def _reduced(
    mass: Array, damping: Array, stiffness: Array, load: Array, force: Any, G: Array, D: Array, omega: Array
) -> tuple[tuple[Array, Array], Array, Array, Array, Mask]:
    """The flow while rows G (N, r, n) are held: its blocks and their forced response, the ways between them and
    (x, v), the blocks at rest, and of which machines there is none.

    With y = G x and u = y' constant, q = h + rest + a y + b u: a = -(N'KN)^-1 N'K D, b = -(N'KN)^-1 N'C (D + N a).
    """
    N, n = load.shape
    r = G.shape[1]
    free = n - r
    null = _null(G)
    across = np.ascontiguousarray(null.swapaxes(1, 2))
    m, c, k = across @ mass @ null, across @ damping @ null, across @ stiffness @ null
    modes = split(m, c, k)
    flow = Flow(modes, stacked(np.linalg.inv, m.shape, m), make_blocks(modes.eta, modes.lam))
    push = loading_of(flow, force @ null, (across @ load[..., None])[..., 0])
    mode, resonant = motion_in(flow, push, omega)
    a, b = np.zeros((2, N, free, r))
    if r and free:
        rigid = modes.rigid > 0  # nothing pulls such a motion back: what is held must not pull at it either
        safe = np.where(rigid[:, None, None], np.eye(free), k)
        a = -stacked(np.linalg.solve, a.shape, safe, across @ stiffness @ D)
        b = -stacked(np.linalg.solve, a.shape, safe, across @ damping @ (D + null @ a))
        pulls = np.any(np.abs(a) > 1e-12, axis=(1, 2)) | np.any(np.abs(b) > 1e-12, axis=(1, 2))
        resonant = resonant | (rigid & pulls)
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
    still = make_blocks(np.zeros((N, r)), np.zeros((N, r)))
    still[..., COLUMN.metric] = omega[:, None] ** 2
    blocks = np.concatenate([mode.blocks, still], axis=1)
    forced = np.concatenate([mode.forced, np.zeros((N, r, *mode.forced.shape[2:]))], axis=1)
    rest = np.concatenate([push.rest.reshape(N, 2 * free), np.zeros((N, 2 * r))], axis=1)
    wrong = resonant | modes.unstable | modes.inseparable | ~np.isfinite(down).all(axis=(1, 2))
    return (blocks, forced), down, up, rest, wrong | ~np.isfinite(up).all(axis=(1, 2))


def _null(G: Array) -> Array:
    """Orthonormal bases (N, n, n - r) of what rows (N, r, n) send to zero."""
    if not G.shape[1]:
        return np.repeat(np.eye(G.shape[2])[None], len(G), axis=0)
    return np.ascontiguousarray(np.linalg.qr(np.ascontiguousarray(G.swapaxes(1, 2)), mode="complete")[0][:, :, G.shape[1] :])


def _derivative(row: Array, eta: Array, lam: Array) -> Array:
    """row A, block by block: see free.derivative."""
    return np.stack([-lam * row[..., 1], row[..., 0] - 2.0 * eta * row[..., 1]], axis=-1)


class Elements(NamedTuple):
    """Contacts and friction of N machines as the kernels need them, C contacts, F frictions and P phases.

    row (N, C, n), kick (N, C, n) M^-1 g / (g M^-1 g), stops (N, C, 2) the lower and the upper, R, soft and by_force
    (N, C); slide (N, F, n) row and brake (N, F, n) M^-1 row / (row M^-1 row), belt (N, F); starts (N, P + 1) of phases,
    shares of the period, 1 at the end; forced (N, F): friction with static = kinetic in some phase
    """

    row: Array
    kick: Array
    stops: Array
    R: Array
    soft: Array
    by_force: Array
    slide: Array
    brake: Array
    belt: Array
    even: Array
    starts: Array


def elements(machines: PieceMachines) -> Elements:
    """The elements of machines."""
    law, N, n = machines.laws[0], len(machines.omega), machines.mass.shape[1]
    inverse_mass = np.linalg.inv(machines.mass)

    def along(row: Array) -> Array:
        pulled = (inverse_mass @ row[..., None])[..., 0]
        return np.asarray(pulled / np.vecdot(row, pulled)[:, None])

    def stack(fields: list[Array], *shape: int) -> Array:
        return np.ascontiguousarray(np.stack(fields, axis=1)) if fields else np.zeros((N, 0, *shape))

    contacts, frictions = law.contacts, law.frictions
    return Elements(
        row=stack([c.row for c in contacts], n),
        kick=stack([along(c.row) for c in contacts], n),
        stops=stack([np.stack([c.lower, c.upper], axis=-1) for c in contacts], 2),
        R=stack([c.R for c in contacts]),
        soft=stack([np.full(N, float(c.soft)) for c in contacts]),
        by_force=stack([np.full(N, float(c.by_force)) for c in contacts]),
        slide=stack([f.row for f in frictions], n),
        brake=stack([along(f.row) for f in frictions], n),
        belt=stack([f.belt for f in frictions]),
        even=stack([(f.static == f.kinetic).astype(np.float64) for f in frictions]),
        starts=stack([*(each.start for each in machines.laws), np.ones(N)]),
    )


class Table(NamedTuple):
    """The modes of N machines that are built so far, K at most of each: codes (N, K), -1 for none, and their pieces.

    wrong (N, K): those that are no modes. elements; omega, tau (N,)
    """

    codes: NDArray[np.int64]
    wrong: Mask
    piece: Piece
    elements: Elements
    omega: Array
    tau: Array


def empty_table(machines: PieceMachines, room: int = 4) -> Table:
    """A table with room for some modes, and none in it."""
    N = len(machines.omega)
    one, _ = piece(machines, Code(0, (OPEN,) * len(machines.laws[0].contacts), (1,) * len(machines.laws[0].frictions)))
    fields = [np.zeros((N, room, *field.shape[1:])) for field in one]
    return Table(np.full((N, room), -1), np.zeros((N, room), np.bool_), Piece(*fields), elements(machines),
                 machines.omega.copy(), phase_of(machines.tau))  # fmt: skip


def with_mode(machines: PieceMachines, table: Table, number: int, rows: NDArray[np.int64]) -> Table:
    """The table with this mode of some machines, which do not have it yet; larger where they have no room for it."""
    law = machines.laws[0]
    used = np.sum(table.codes[rows] >= 0, axis=1)
    if np.any(used == table.codes.shape[1]):
        def grown(field: Array, fill: float = 0.0) -> Array:
            return np.concatenate([field, np.full_like(field, fill)], axis=1)

        table = table._replace(codes=grown(table.codes, -1), wrong=grown(table.wrong), piece=Piece(*map(grown, table.piece)))
    made, wrong = piece(_of(machines, rows), code_of(number, len(law.contacts), len(law.frictions)))
    table.codes[rows, used], table.wrong[rows, used] = number, wrong
    for field, new in zip(table.piece, made, strict=True):
        field[rows, used] = new
    return table


def _of(machines: Any, rows: NDArray[np.int64]) -> Any:
    """These machines of many."""
    if isinstance(machines, np.ndarray):
        return machines[rows]
    if isinstance(machines, tuple):
        parts = [_of(field, rows) for field in machines]
        return type(machines)(*parts) if hasattr(machines, "_fields") else tuple(parts)
    return machines
