"""The motion between impacts: blocks, forced response, rest position, and the gap coordinate as a signal of the blocks.

Each oscillator depends on its own machine only, to the bit.
"""

from typing import Any, NamedTuple

import numpy as np

from workers.model.block_decomposition import BlockDecomposition, apply_stacked, split
from workers.model.machines import Machines
from workers.model.memoize import memoize_arrays
from workers.model.oscillator import (
    COLUMN,
    LARGEST_ANGLE,
    OF_FLOW,
    OF_GUARD,
    Array,
    GuardedFlow,
    Mask,
    make_blocks,
    rates_of,
)
from workers.results import COUPLED_DAMPING, LONG_PERIOD, RESONANCE, RIGID_MODE, UNSTABLE

UNSEEN = 1e-9
"""Share of a rigid or growing motion in the gap coordinate below which the motion counts as leaving the gap unchanged.
The share is relative to its largest possible value."""

RESONANT = 1e-8
"""Share of its terms below which the dynamic stiffness at the forcing frequency counts as resonance. The forced
response is then so large that motion growing for thousands of periods seems to close beside it.
"""

ULPS = 8.0
"""Relative errors of a machine's entries, in units in the last place: the rounding of a few operations."""


class BlockFlow(NamedTuple):
    """Linear motion of N machines without a force, as decoupled equations of motion, the blocks.

    modes         decoupled equations for the matrices
    inverse_mass  (N, n, n) M^-1
    blocks        (N, n, columns) constants of the blocks, see Block, without a load, with the metric of elastic blocks

    Mass, damping, stiffness and the weights of the guard, the displacement that ends the motion, decide all fields.
    """

    modes: BlockDecomposition
    inverse_mass: Array
    blocks: Array


class BlockLoading(NamedTuple):
    """Effect of force and load on the decoupled equations, the blocks, of N machines, for any forcing frequency.

    waves       (N, H, n, 2) complex amplitudes of e^(i k phi) that the force adds to d/dt (h, h')
    load, rest  (N, n), (N, n, 2) load of rigid motions, and (h, h') at rest, see oscillator.Block
    """

    waves: Any
    load: Array
    rest: Array


class FlightStructure(NamedTuple):
    """The part of the free flight of N machines that does not depend on the forcing frequency.

    flow, loading     decoupled equations of motion, and the effect of force and load on them
    accelerance       (N, n) M^-1 g of the gap row g
    inverse_gap_mass  (N,) g.M^-1 g
    unheld            (N,) mask of machines with a growing motion that leaves the gap unchanged, see grows_unseen
    """

    flow: BlockFlow
    loading: BlockLoading
    accelerance: Array
    inverse_gap_mass: Array
    unheld: Mask

    def gap(self, blocks: Array) -> Array:
        """Return the gap coordinate y (N,) at states ``blocks`` (N, n, 2) of the decoupled equations."""
        return np.asarray(np.sum(self.flow.blocks[..., COLUMN.c0 : COLUMN.c1 + 1] * blocks, axis=(1, 2)))


class RestState(NamedTuple):
    """The rest positions of N machines, from which their states are counted.

    loading           effect of force and load, with rest positions midway between the stops for balanced machines
    b_upper, b_lower  (N,) the gaps to the stops at rest
    unseen            (N,) mask of machines with a rigid mode that leaves the gap unchanged
    """

    loading: BlockLoading
    b_upper: Array
    b_lower: Array
    unseen: Mask


def structure_of(machines: Machines) -> FlightStructure:
    """Return the part of the free flight of machines that does not depend on the forcing frequency.

    The guard, the number whose ends of range end the flight, is the gap coordinate. An impact moves the velocities
    along M^-1 g / (g.M^-1 g), with g the gap row.
    """
    return _structure_of(*machines.of_flight)


@memoize_arrays
def _structure_of(
    mass: Array, damping: Array, stiffness: Array, gap_row: Array, force_sin: Array, force_cos: Array, load: Array
) -> FlightStructure:
    """Return ``structure_of`` for machines with these arrays ``Machines.of_flight``."""
    accelerance = apply_stacked(np.linalg.solve, (*gap_row.shape, 1), mass, gap_row[..., None])[..., 0]
    inverse_gap_mass = np.vecdot(gap_row, accelerance)
    none = np.zeros_like(gap_row)
    row = np.concatenate([gap_row, none], axis=1)
    kick = np.concatenate([none, accelerance / inverse_gap_mass[:, None]], axis=1)
    flow = flow_of(mass, damping, stiffness, row, kick)
    unheld = grows_unseen(flow.blocks, flow.modes.to_physical, row[:, None])
    loading = loading_of(flow, force_sin + 1j * force_cos, load)
    return FlightStructure(flow, loading, accelerance, inverse_gap_mass, unheld)


def grows_unseen(blocks: Array, to_physical: Array, rows: Array) -> Mask:
    """Return the mask (N,) of machines with a growing motion that leaves given displacements and velocities unchanged.

    blocks       (N, n, columns) decoupled equations, see Block
    to_physical  (N, 2n, 2n) (x, x') of states of the decoupled equations
    rows         (N, R, 2n) weights of (x, x') in each displacement or velocity

    The motion is h = e^(r s), h' = r h in one decoupled equation. A sum weighted by a row changes with it unless the
    sum is small beside that of the moduli of its terms.
    """
    N, n = blocks.shape[:2]
    rates = rates_of(blocks)
    unseen = np.zeros(N, dtype=np.bool_)
    (some,) = np.nonzero(np.any(rates.real > 0.0, axis=(1, 2)))
    if len(some):
        terms = rows[some, :, :, None] * to_physical[some, None]
        shares, sizes = (of.reshape(len(some), rows.shape[1], n, 2, 1) for of in (terms.sum(2), np.abs(terms).sum(2)))
        rate = rates[some, None]
        seen = np.abs(shares[..., 0, :] + rate * shares[..., 1, :])
        most = sizes[..., 0, :] + np.abs(rate) * sizes[..., 1, :]
        missed = np.all(seen <= UNSEEN * most, axis=1)
        unseen[some] = np.any(missed & (rates[some].real > 0.0), axis=(1, 2))
    return unseen


def flow_of(mass: Array, damping: Array, stiffness: Array, row: Array, kick: Array) -> BlockFlow:
    """Return the decoupled equations of motion, without force and load, for matrices (N, n, n).

    row   (N, 2n) weights of displacements and velocities in the guard, the signal that ends the motion
    kick  (N, 2n) direction in which a reset, such as an impact, moves displacements and velocities
    """
    modes, shape = split(mass, damping, stiffness), (*mass.shape[:2], 2)
    c = times(row, modes.to_physical).reshape(shape)
    k = (modes.to_blocks @ kick[..., None])[..., 0].reshape(shape)
    c1 = derivative(c, modes)
    k1 = np.stack([k[..., 1], -modes.lam * k[..., 0] - 2.0 * modes.eta * k[..., 1]], axis=-1)
    blocks = make_blocks(modes.eta, modes.lam)
    blocks[..., OF_FLOW:OF_GUARD] = np.concatenate([c, c1, k, k1, derivative(c1, modes)], axis=-1)
    return BlockFlow(modes, apply_stacked(np.linalg.inv, mass.shape, mass), blocks)


def loading_of(flow: BlockFlow, force: Any, load: Array) -> BlockLoading:
    """Return the effect of a force (N, H, n) and of a constant load (N, n) on the decoupled equations ``flow``.

    Both enter a block as (h0, h1)' = A (h0, h1) + (l0, l1).
    """
    modes, (N, n) = flow.modes, load.shape
    into = modes.to_blocks[:, :, n:] @ flow.inverse_mass  # (N, 2n, n)
    waves = (into[:, None] @ force[..., None])[..., 0].reshape(N, force.shape[1], n, 2)
    steady = (into @ load[..., None])[..., 0].reshape(N, n, 2)
    rigid = modes.lam == 0.0
    l0, l1 = steady[..., 0], steady[..., 1]
    p = l1 + 2.0 * modes.eta * l0
    at_rest = np.where(rigid, 0.0, p / np.where(rigid, 1.0, modes.lam)) + 0.0  # avoids -0.0
    return BlockLoading(waves, np.where(rigid, p, 0.0), np.stack([at_rest, -l0], axis=-1))


def mode_of(flow: BlockFlow, loading: BlockLoading, omega: Array, direct: Any = 0.0) -> tuple[GuardedFlow, Mask]:
    """Return the linear equations of free flight of N machines, with their guard, and a mask (N,) of resonance.

    flow, loading  the decoupled equations of motion, and the force on them, see BlockFlow and BlockLoading
    omega          (N,) forcing frequencies
    direct         (N, H) complex amplitudes of e^(i k phi) that the guard has besides c . blocks

    The guard is the number whose ends of range end the flight. Resonance is undamped.
    """
    N, H, n = loading.waves.shape[:3]
    w = omega[:, None] * np.arange(1.0, H + 1.0)
    forced, resonant = _response(flow.modes, loading.waves, w)
    blocks, lam = flow.blocks.copy(), flow.modes.lam
    rigid = (lam == 0.0) & (blocks[..., COLUMN.slow] >= 0.0)
    blocks[..., COLUMN.metric] = np.where(rigid, omega[:, None] ** 2, blocks[..., COLUMN.metric])
    blocks[..., COLUMN.load] = loading.load
    swing = np.sum(np.hypot(forced[..., 0], forced[..., 1]), axis=-1)
    still = ~np.any(swing > 0.0, axis=(1, 2))[:, None, None]
    fallen = np.abs(loading.load)[..., None] / np.stack([omega**2, omega], axis=-1)[:, None]
    blocks[..., COLUMN.swing0 : COLUMN.swing1 + 1] = np.where(still, fallen, swing)
    blocks[..., COLUMN.rest0 :] = loading.rest
    row = blocks[..., COLUMN.c0 : COLUMN.c1 + 1].reshape(N, 1, 2 * n)
    parts = (row @ forced.reshape(N, 2 * n, 2 * H)).reshape(N, H, 2)
    waves = np.empty((N, H, 2))
    waves[..., 0], waves[..., 1] = direct.real + parts[..., 0], direct.imag + parts[..., 1]
    return GuardedFlow(blocks, waves, sizes_of(waves, w), forced), resonant


def sizes_of(waves: Array, w: Array) -> Array:
    """Return bounds (..., 5), see ForcedBounds, of sums of harmonics and of their derivatives.

    waves  (..., H, 2) sine and cosine parts
    w      (..., H) frequencies, multiples of the first one
    """
    sizes = np.hypot(waves[..., 0], waves[..., 1])
    numbers = np.empty((*sizes.shape[:-1], 5))
    numbers[..., 0] = w[..., 0]
    numbers[..., 1:] = np.stack([sizes, sizes * w**2, sizes * w**3, sizes * w**4], axis=-2).sum(axis=-1)
    return numbers


def _response(modes: BlockDecomposition, waves: Any, frequencies: Array) -> tuple[Array, Mask]:
    """Return the forced response (N, n, 2, H, 2) of decoupled equations, and the mask (N,) of resonance.

    modes        the decoupled equations
    waves        (N, H, n, 2) complex amplitudes of the loading
    frequencies  (N, H)

    Z = (l1 + (2 eta + i w) l0) / (lam - w^2 + 2 i eta w), and i w Z - l0 of the velocity.
    """
    w, eta, lam = frequencies[:, :, None], modes.eta[:, None], modes.lam[:, None]
    l0, l1 = waves[..., 0], waves[..., 1]
    push = l1 + (2.0 * eta + 1j * w) * l0
    re, im = lam - w**2, 2.0 * eta * w
    size = np.maximum(np.abs(re), np.abs(im))
    unit = np.where(size > 0.0, size, 1.0)
    re, im = re / unit, im / unit
    square = re * re + im * im
    resonant = (push != 0.0) & (size * np.sqrt(square) < RESONANT * (np.abs(lam) + w**2))
    Z = np.where(push != 0.0, push / (square * unit), 0.0) * (re - 1j * im)
    rate = 1j * w * Z - l0
    response = np.empty((len(w), lam.shape[2], 2, w.shape[1]), dtype=np.complex128)
    response[:, :, 0], response[:, :, 1] = Z.swapaxes(1, 2), rate.swapaxes(1, 2)
    return response.view(np.float64).reshape(*response.shape, 2), np.any(resonant, axis=(1, 2))


def against(modes: BlockDecomposition, resonant: Mask, rigid: Mask) -> dict[int, Mask]:
    """Return masks (N,) of machines whose motion cannot be solved, by code of the reason, the weightiest one last.

    modes     decoupled equations of the machines
    resonant  (N,) mask of undamped resonance
    rigid     (N,) mask of machines with an invalid rigid mode
    """
    return {RESONANCE: resonant, COUPLED_DAMPING: modes.inseparable, RIGID_MODE: rigid}


def free_motion(structure: FlightStructure, at_rest: RestState, omega: Array) -> tuple[GuardedFlow, dict[int, Mask]]:
    """Return the free flight of machines at forcing frequencies (N,), and masks of machines that cannot be solved.

    The masks (N,) are given by the code of the reason, see ``against``.
    """
    modes = structure.flow.modes
    gap, resonant = mode_of(structure.flow, at_rest.loading, omega)
    too_long = {LONG_PERIOD: turns_too_far(gap.d, gap.w, omega)}
    rigid = at_rest.unseen | (modes.rigid > 1)
    return gap, too_long | against(modes, resonant, rigid) | {UNSTABLE: structure.unheld}


def turns_too_far(d: Array, w: Array, omega: Array) -> Mask:
    """Return the mask (N,) of machines with an oscillation so fast that rounding loses its phase in a forcing period.

    d, w   (N, n) constants of the decoupled equations, see Block
    omega  (N,) forcing frequencies

    Such an oscillation turns by more than LARGEST_ANGLE in a forcing period.
    """
    turns = np.where(d > 0.0, w, 0.0) * (2.0 * np.pi / omega)[:, None]
    return np.asarray(np.max(turns, axis=1) > LARGEST_ANGLE)


def phase_of(tau: Array) -> Array:
    """Return the forcing phase ``tau`` reduced by whole turns to the interval from -pi to pi."""
    phase = np.fmod(tau, 2.0 * np.pi)
    return np.where(np.abs(phase) > np.pi, phase - np.copysign(2.0 * np.pi, phase), phase)


def centred(structure: FlightStructure, machines: Machines) -> RestState:
    """Return the rest positions of machines with this free flight; balanced machines rest midway between their stops.

    The position of a rigid mode is counted from midway between the stops, or from the only stop.
    """
    (lower, upper), modes, loading = machines.stops[:, 0].T, structure.flow.modes, structure.loading
    rigid, even, unseen = modes.lam == 0.0, balanced(machines), np.zeros(len(upper), dtype=np.bool_)
    middle = np.where(np.isfinite(upper) & np.isfinite(lower), 0.5 * (upper + lower), np.where(
        np.isfinite(upper), upper, np.where(np.isfinite(lower), lower, 0.0)))  # fmt: skip
    rest = loading.rest.copy()
    y0 = structure.gap(rest)
    if np.any(rigid):  # skipped for others, whose bits it would change
        moving = np.any(rigid, axis=1)
        share = np.sum(np.where(rigid, structure.flow.blocks[..., COLUMN.c0], 0.0), axis=1)
        unseen = moving & (np.abs(share) < UNSEEN * np.sqrt(structure.inverse_gap_mass))
        move = np.where(moving & ~unseen, (middle - y0) / np.where(share != 0.0, share, 1.0), 0.0)
        rest[..., 0] = np.where(rigid, rest[..., 0] + move[:, None], rest[..., 0])
        y0 = structure.gap(rest)
    rounding = np.where(even, middle - y0, 0.0)
    if np.any(rounding != 0.0):
        d = structure.accelerance / structure.inverse_gap_mass[:, None] * rounding[:, None]
        centred = rest + (modes.to_blocks[:, :, : d.shape[1]] @ d[..., None])[..., 0].reshape(rest.shape)
        rest = np.where((rounding != 0.0)[:, None, None], centred, rest)
        y0 = structure.gap(rest)
    load = np.where(even[:, None], 0.0, loading.load)
    half = 0.5 * (upper - lower)
    b_upper, b_lower = np.where(even, half, upper - y0), np.where(even, half, y0 - lower)
    return RestState(loading._replace(rest=rest, load=load), b_upper, b_lower, unseen)


def unbalanced(structure: FlightStructure, at_rest: RestState, machines: Machines) -> tuple[Array, Array]:
    """Return the part of the load that no rest position balances, and the velocities of the motion under this part.

    The load (N, n) drives a rigid mode. The constant velocities (N, n) belong to the damped motion from which states of
    flight are counted.
    """
    n, modes = machines.load.shape[2], structure.flow.modes
    drift = (modes.to_physical[:, :, 1::2] @ at_rest.loading.load[..., None])[..., 0]
    mass, damping = (np.ascontiguousarray(of.swapaxes(1, 2)) for of in (machines.mass, machines.damping[:, 0]))
    return times(drift[:, n:], mass) + times(drift[:, :n], damping), drift[:, :n]


def balanced(machines: Machines) -> Mask:
    """Return the mask (N,) of machines in which y rests midway between both stops, or anywhere, to rounding.

    Symmetric motion needs such a rest. No force f is then needed to hold y in the middle m:

        K x + f g = load,  g . x = m

    The modulus of f is then at most its change by ULPS of each entry. With K v + s g = 0 and g . v = 1 the change is

        |v| . (|load| + |K| |x|) + |s| (|g| . |x| + |upper| + |lower|)
    """
    _, _, stiffness, row, *_, load = machines.of_flight
    lower, upper = machines.stops[:, 0].T
    middle = 0.5 * (upper + lower)
    balances = np.isnan(middle) | (~np.any(load != 0.0, axis=1) & (middle == 0.0))  # NaN: both are infinite
    rows = np.flatnonzero(~balances & np.isfinite(middle))
    if not rows.size:
        return balances
    K, g, n = stiffness[rows], row[rows], row.shape[1]
    size = np.max(np.abs(K), axis=(1, 2), initial=0.0)
    size = np.where(size > 0.0, size, 1.0)[:, None]  # scales the border to the size of the matrix
    matrix, right = np.zeros((len(rows), n + 1, n + 1)), np.zeros((len(rows), n + 1, 2))
    matrix[:, :n, :n] = K
    matrix[:, :n, n] = matrix[:, n, :n] = size * g
    right[:, :n, 0], right[:, n, 0], right[:, n, 1] = load[rows], middle[rows] * size[:, 0], size[:, 0]
    both = apply_stacked(np.linalg.solve, right.shape, matrix, right)
    x, v = np.abs(both[:, :n, 0]), np.abs(both[:, :n, 1])
    f, s = np.abs(size * both[:, n]).T
    ends = np.abs(upper[rows]) + np.abs(lower[rows])
    change = np.vecdot(v, np.abs(load[rows]) + (np.abs(K) @ x[..., None])[..., 0]) + s * (
        np.vecdot(np.abs(g), x) + ends
    )
    balances[rows] = f <= ULPS * np.finfo(np.float64).eps * change
    return balances


def derivative(row: Array, modes: BlockDecomposition) -> Array:
    """Return the weights of (h, h') in the time derivative of a signal with weights ``row``, see ``derivative_of``.

    ``modes`` has the decoupled equations of motion on whose states the weights act.
    """
    return derivative_of(row, modes.eta, modes.lam)


def derivative_of(row: Array, eta: Array, lam: Array) -> Array:
    """Return the weights (..., 2) of (h, h') in the time derivative of a signal r1 h + r2 h', ``row`` being (r1, r2).

    d/dt (r1 h + r2 h') = -lam r2 h + (r1 - 2 eta r2) h' for h'' + 2 eta h' + lam h = 0.
    """
    return np.stack([-lam * row[..., 1], row[..., 0] - 2.0 * eta * row[..., 1]], axis=-1)


def times(row: Array, matrix: Array) -> Array:
    """Return row @ matrix for each of N rows (N, n) and matrices (N, n, m)."""
    return np.asarray((row[:, None, :] @ matrix)[:, 0])
