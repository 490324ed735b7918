"""Coefficients that vary smoothly with the phase of a period, as phases of constant coefficients.

A step of the period has the coefficients A1 and A2 at its Gauss points, 1/2 -+ sqrt(3)/6 of the step. Its two halves
are phases with

    (A1 + A2) / 2 + (A1 - A2) / sqrt 3   and then   (A1 + A2) / 2 - (A1 - A2) / sqrt 3,

the commutator-free Magnus rule of fourth order, CF4:2 of Blanes & Moan, Appl. Numer. Math. 56 (2006) 1519. Mean and
first moment over the step are those of the coefficients, so a force between them may stay exact. Within a step the
flow is of second order only, which speeds at stops show.
"""

from collections.abc import Callable

import numpy as np

from workers.model.block_decomposition import apply_stacked
from workers.model.entries import DefinitionError
from workers.model.machines import MIDWAY, Machines
from workers.model.oscillator import Array

SMOOTH_PHASES = 64
"""Maximum number of phases of a period with smooth coefficients."""

STEPS = 2
"""Least number of steps. It is even, so that half a period ends a step and mirror images have the same phases."""

FINER, FINEST = 4, 64
"""Number of steps in the place of one, and least number of steps, of the flow that stands for the truth."""

TERMS, SMALL = 12, 0.25
"""Number of terms of the exponential series, and largest norm of a matrix in it."""


def gauss_angles(starts: Array, steps: int) -> Array:
    """Return the phase (2 steps * N,) at the Gauss points of the steps of a phase, in order, each for all N machines.

    ``starts`` (N, 2) are the starts of this phase and of the next.
    """
    inside = 0.5 + np.array([-1.0, 1.0]) * np.sqrt(3.0) / 6.0
    shares = (np.arange(steps)[:, None] + inside).ravel() / steps
    return np.asarray(2.0 * np.pi * (starts[:, 0] + shares[:, None] * (starts[:, 1] - starts[:, 0])).ravel())


def of_halves(field: Array, odd: bool = False) -> Array:
    """Return coefficients (N, P, ...) of half steps from those at Gauss points.

    Coefficients that differ half a period later by rounding alone are made equal, or opposite if ``odd``.
    """
    first, second = field[:, 0::2], field[:, 1::2]
    mean, change = 0.5 * (first + second), (first - second) / np.sqrt(3.0)
    halves = np.stack([mean + change, mean - change], axis=2).reshape(field.shape)
    later = np.roll(halves, -(field.shape[1] // 2), axis=1) * (-1.0 if odd else 1.0)
    near = np.abs(halves - later) <= MIDWAY * np.max(np.abs(halves), axis=1, keepdims=True)
    return np.where(near, 0.5 * (halves + later), halves)


def starts_of_halves(starts: Array, steps: int) -> Array:
    """Return the starts (N, 2 steps P + 1) of half steps of phases with starts (N, P + 1)."""
    shares = np.arange(2 * steps) / (2 * steps)
    inner = starts[:, :-1, None] + np.diff(starts, axis=1)[..., None] * shares
    return np.concatenate([inner.reshape(len(starts), -1), starts[:, -1:]], axis=1)


def fewest_steps(make: Callable[[int], Machines], phases: int, within: float) -> int:
    """Return the least number of steps in each phase for which ``errors`` of machines are within a bound.

    ``make`` returns the machines, of which the first is that of the defaults, for a number of steps. Machines without
    an error, such as those with an infinite coefficient, are left out. Raise DefinitionError if there is no such
    number.
    """
    worst, steps = np.nan, STEPS
    for steps in range(STEPS, SMOOTH_PHASES // (2 * phases) + 1, 2):
        every = errors(make, steps)
        worst = float(np.nanmax(every)) if np.isfinite(every[0]) else np.nan
        if worst <= within:
            return steps
    if np.isnan(worst):
        raise DefinitionError("system.within: an entry has no finite value at some phase; give finite expressions")
    raise DefinitionError(
        f"system.within: found {within:g}, takes more than {SMOOTH_PHASES} phases; {steps} steps, two phases each, are "
        f"off by {worst:.2g}: give at least {1.1 * worst:.2g}; a jump must begin a phase, see [[system.phases]]"
    )


@np.errstate(all="ignore")
def errors(make: Callable[[int], Machines], steps: int) -> Array:
    """Return the error (N,) of the linear machines of ``make`` with this number of steps in each phase.

    The linear machines are those with all contacts open, and with all soft contacts closed while friction slides. The
    error is the largest of three: that of the map of a period, as a share of its largest entry; and, of motions from
    unit displacements and velocities, or by the load from rest, those with which they pass a stop at their greatest
    speed: of the time, as a share of the period, and of the speed, as a share of it.
    """
    finer = max(FINER, 2 * -(-FINEST // (2 * steps)))
    few, many = make(steps), make(finer * steps)
    n, stiffness = few.load.shape[2], np.abs(many.stiffness).max(axis=1)
    inverse_mass = apply_stacked(np.linalg.inv, few.mass.shape, few.mass)
    rate = np.sqrt(few.omega**2 + np.max(np.abs(inverse_mass) @ stiffness, axis=(1, 2)))
    worst = np.zeros(len(rate))
    for closed in (False, True):
        rough, true = (_flows(machines, inverse_mass, rate, closed) for machines in (few, many))
        off, true = rough - true[:, finer - 1 :: finer], true[:, finer - 1 :: finer]
        for columns in (slice(0, 2 * n), slice(2 * n, 2 * n + 1)):
            size, change = (np.abs(flow[:, -1, : 2 * n, columns]).max(axis=(1, 2)) for flow in (true, off))
            worst = np.maximum(worst, np.where(size > 0.0, change / size, change))
        distance, change, speed = (
            np.abs(few.row[:, None] @ flow[:, :, part]).max(axis=1)
            for flow, part in ((off, slice(0, n)), (off, slice(n, 2 * n)), (true, slice(n, 2 * n)))
        )
        passing = np.maximum(distance * (few.omega / (2.0 * np.pi * rate))[:, None, None], change)
        worst = np.maximum(worst, np.where(speed > 0.0, passing / speed, 0.0).max(axis=(1, 2), initial=0.0))
    return worst


def _flows(machines: Machines, inverse_mass: Array, rate: Array, closed: bool) -> Array:
    """Return the flows (N, P, 2n + 1, 2n + 1) of (x, v / rate, 1) from the section to the end of each phase."""
    K, C, load = machines.stiffness, machines.damping, machines.load
    n, scale = load.shape[2], rate[:, None, None, None]
    if closed:
        for c in np.flatnonzero(machines.soft.any(axis=0)).tolist():
            row, upper = machines.row[:, None, c], np.isfinite(machines.stops[:, c, 1])
            square, (k, d, preload) = row[..., None] * row[..., None, :], np.moveaxis(machines.contact_constants, 3, 0)
            k, sign = k[:, :, c] + machines.contact_laws[:, c, 1, :1, 1], np.where(upper, 1.0, -1.0)[:, None]
            stop = np.where(upper, machines.stops[:, c, 1], machines.stops[:, c, 0])[:, None]
            K, C = K + k[..., None, None] * square, C + d[:, :, c, None, None] * square
            load = load + (k * np.where(np.isfinite(stop), stop, 0.0) - sign * preload[:, :, c])[..., None] * row
        row = machines.friction_rows[:, None]
        kinetic, _, slope = np.moveaxis(machines.friction_constants[..., 1, :], 3, 0)  # forward
        C = C + row.swapaxes(2, 3) @ (slope[..., None] * row)
        load = load + ((slope * machines.belt[:, None] - kinetic)[:, :, None] @ row)[:, :, 0]
    A = np.zeros((*load.shape[:2], 2 * n + 1, 2 * n + 1))
    A[..., :n, n : 2 * n] = scale * np.eye(n)
    forces = np.concatenate([-K / scale, -C, load[..., None] / scale], axis=3)
    A[..., n : 2 * n, :] = inverse_mass[:, None] @ forces
    lengths = np.diff(machines.starts, axis=1) * (2.0 * np.pi / machines.omega)[:, None]
    steps = _exponential(A * lengths[..., None, None])
    flows = [steps[:, 0]]
    for p in range(1, steps.shape[1]):
        flows.append(steps[:, p] @ flows[-1])
    return np.stack(flows, axis=1)


def _exponential(matrices: Array) -> Array:
    """Return the exponentials of matrices (..., m, m), NaN where one is not finite."""
    norm = np.sum(np.abs(matrices), axis=-1).max(initial=0.0, where=np.isfinite(matrices).all(axis=-1))
    squarings = max(0, int(np.ceil(np.log2(max(norm, SMALL) / SMALL))))
    unit, small = np.eye(matrices.shape[-1]), matrices / 2.0**squarings
    power = np.broadcast_to(unit, matrices.shape)
    for k in range(TERMS, 0, -1):
        power = unit + small @ power / k
    for _ in range(squarings):
        power = power @ power
    return power
