"""Periodic orbits: Newton on the period map, Floquet exponents without forming the product, symmetry.

Where the gap is symmetric every orbit is sought as one of the half-period map G, G o G = P: period m under G
with m odd is a symmetric orbit of period m, m even an asymmetric one of period m / 2.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.jit import kernel
from workers.oscillator import Oscillator
from workers.section import (
    LOST,
    RUNNING,
    STATUS,
    Motion,
    advance,
    half_advance,
    motion_at,
    reset_frame,
)

Array = NDArray[np.float64]

NEWTON_STEPS = 12
CYCLES = 60
"""Turns of the orbit that the Floquet frame may take to settle."""

HOPELESS = 30.0
"""Spectral radius of the Jacobian from which on no stable orbit is expected near: chaos that passes close to itself."""

RESERVED_TURNS = 6
"""Turns that the other tests of an orbit take: divisors (less than two), one under G, one of the motion, one for the
error of the multipliers, one last count."""

SETTLED = 1e-13
"""Coupling below which the Floquet frame has split into invariant subspaces."""

NARROW = 2.0
"""Log-spread of multipliers up to which their block's product may be formed: loses no digit that counts."""


class Orbit(NamedTuple):
    """A closed orbit of m steps of the map, with all that its multipliers tell.

    h (n, 2), contact   section state on it
    steps, half         m, and whether a step is half a period (map G)
    exponents           (2n,) ln|mu| / period, largest first; -infinity where structurally lost
    residual            |F(h) - h| in the energy norm
    digits              error of the exponents as far as rounding tells
    """

    h: Array
    contact: int
    steps: int
    half: bool
    exponents: Array
    residual: float
    digits: float

    @property
    def period(self) -> int:
        """Forcing periods per orbit."""
        return self.steps // 2 if self.half and self.steps % 2 == 0 else self.steps

    @property
    def symmetric(self) -> bool:
        """Whether (x, t) -> (-x, t + period / 2) maps the orbit to itself."""
        return self.half and self.steps % 2 == 1


@kernel
def step_many(osc, motion, steps, half):
    """Take so many steps of the map, half periods or whole ones; returns the steps completed."""
    for k in range(steps):
        if half:
            half_advance(osc, motion)
        else:
            advance(osc, motion)
        if motion.tally[STATUS] != RUNNING:
            return k
    return steps


def energy_norm(osc: Oscillator, h: Array) -> float:
    """sqrt(sum lam_j h_j^2 + h_j'^2) of block states (n, 2)."""
    return float(np.linalg.norm(_weights(osc) * h))


def _weights(osc: Oscillator) -> Array:
    """What block states (n, 2) are multiplied with for the energy norm."""
    return np.column_stack([np.sqrt(osc.gap.lam), np.ones(len(osc.gap.lam))])


def framed_motion(osc: Oscillator, h: Array, contact: int, frame: Array) -> Motion:
    """A motion from h with tangent vectors frame (m, n, 2) that also collects the triangle of its growth."""
    motion = motion_at(osc, h, contact)
    m = len(frame)
    return motion._replace(V=frame.copy(), growth=np.zeros(m), triangle=np.eye(m))


def map_with_jacobian(osc: Oscillator, h: Array, contact: int, steps: int, half: bool) -> tuple[Motion, Array] | None:
    """The motion after so many steps from h, and the Jacobian (2n, 2n) of the map; None if it cannot get there."""
    size = h.size
    motion = motion_at(osc, h, contact, vectors=size)._replace(growth=np.zeros(0))  # carried along as they are
    if step_many(osc, motion, steps, half) < steps:
        return None
    J = motion.V.reshape(size, size).T.copy()
    return (motion, J) if np.all(np.isfinite(J)) else None


class Fixed(NamedTuple):
    """A fixed point of so many steps of the map: block state, its image, contact, Jacobian and |F(h) - h|."""

    h: Array
    image: Array
    contact: int
    jacobian: Array
    residual: float


def newton(osc: Oscillator, start: Motion, steps: int, half: bool, scale: float, most: int) -> tuple[Fixed | None, int]:
    """The fixed point of the map near a motion, to rounding, or None where Newton finds none; and the steps it took.

    h <- h - (J - I)^-1 (F(h) - h), at most so many times, until the residual stops falling; it must end
    below 1e-10 of ``scale``.
    """
    h, contact = start.h.copy(), int(start.contact[0])
    best: Fixed | None = None
    spent = 0
    while spent < most:
        spent += 1
        mapped = map_with_jacobian(osc, h, contact, steps, half)
        if mapped is None or mapped[0].contact[0] != contact:
            break
        motion, J = mapped
        difference = motion.h - h
        residual = energy_norm(osc, difference)
        if best is not None and residual > 0.5 * best.residual:
            break
        best = Fixed(h, motion.h, contact, J, residual)
        if residual > 0.3 * scale or residual < 1e-15 * scale or _spectral_radius(J) > HOPELESS:
            break
        try:
            change = np.linalg.solve(J - np.eye(h.size), -difference.ravel())
        except np.linalg.LinAlgError:
            break
        h = h + change.reshape(h.shape)
    return (best if best is not None and best.residual < 1e-10 * scale else None), spent


def floquet(osc: Oscillator, point: Fixed, steps: int, half: bool, most: int) -> tuple[Array, float, int] | None:
    """(log moduli of the multipliers per turn, their rounding error, turns), largest first; None without ``most`` > 1.

    A frame is carried round the orbit until it splits into invariant subspaces; what QR took out of each is
    kept as logarithms, so that multipliers of any spread keep their digits. Blocks that do not split have
    multipliers of nearly one modulus, and their product can be formed. Lost directions are -infinity.
    """
    frame = np.eye(point.h.size).reshape(point.h.size, *point.h.shape)
    weights = _weights(osc)
    for turn in range(1, most + 1):
        motion = framed_motion(osc, point.h, point.contact, frame)
        if step_many(osc, motion, steps, half) < steps:
            return None
        reset_frame(osc, motion)
        rank = point.h.size - int(motion.tally[LOST])
        before = (frame * weights).reshape(len(frame), -1)[:rank]
        after = (motion.V * weights).reshape(len(frame), -1)[:rank]
        frame = motion.V[:rank].copy()
        if turn == 1:
            continue
        rotation = before @ after.T
        blocks = _blocks(rotation)
        logs = motion.growth[:rank]
        spread = max((float(np.ptp(logs[b])) for b in blocks), default=0.0)
        if spread < NARROW or turn == most:
            moduli = [_block_moduli(rotation[b, b], logs[b], motion.triangle[b, b]) for b in blocks]
            found = np.sort(np.concatenate([*moduli, np.zeros(0)]))[::-1]
            lost = np.full(point.h.size - rank, -np.inf)
            rounding = 1e-15 * (1.0 + float(np.max(np.abs(found), initial=0.0))) * math.exp(min(spread, 700.0))
            return np.concatenate([found, lost]), rounding, turn
    return None


def _blocks(rotation: Array) -> list[slice]:
    """The diagonal blocks into which an orthogonal matrix falls apart."""
    cuts = [0]
    for i in range(1, len(rotation)):
        if np.max(np.abs(rotation[i:, :i])) < SETTLED:
            cuts.append(i)
    return [slice(a, b) for a, b in zip(cuts, [*cuts[1:], len(rotation)], strict=True) if b > a]


def _block_moduli(rotation: Array, logs: Array, triangle: Array) -> Array:
    """ln|eigenvalues| of rotation diag(exp(logs)) triangle, scaled so that nothing under- or overflows."""
    top = float(np.max(logs))
    product = rotation @ (np.exp(logs - top)[:, None] * triangle)
    with np.errstate(divide="ignore"):
        return top + np.log(np.abs(np.linalg.eigvals(product)))


def settle(
    osc: Oscillator, motion: Motion, steps: int, half: bool, scale: float, budget: int
) -> tuple[Orbit | None, int]:
    """The stable orbit of so many steps that the motion is falling into, if any, and the steps spent.

    Shown: a fixed point (Newton), minimal (no divisor closes), all multipliers inside the unit circle, and
    the motion either on it or so near that its deviation shrinks: what the linear map does not explain of
    one turn is less than half of the contraction, |F(h) - h* - J (h - h*)| < (1 - |mu|) / 2 |h - h*|.
    At most ``budget`` steps are spent.
    """
    turns_left = budget // steps - RESERVED_TURNS
    if turns_left < 1:
        return None, 0
    point, tried = newton(osc, motion, steps, half, scale, min(NEWTON_STEPS, turns_left))
    turns_left -= tried
    spent = tried * steps
    if point is None:
        return None, spent
    if _spectral_radius(point.jacobian) > 1.001:
        return None, spent
    for divisor in range(1, steps):
        if steps % divisor == 0:
            trial = motion_at(osc, point.h, point.contact)
            step_many(osc, trial, divisor, half)
            spent += divisor
            if energy_norm(osc, trial.h - point.h) < 1e-6 * scale:
                return None, spent
    if not half and steps % 2 and osc.b_upper == osc.b_lower:
        trial = motion_at(osc, point.h, point.contact)
        step_many(osc, trial, steps, True)
        spent += steps
        if energy_norm(osc, trial.h - point.h) < 1e-6 * scale:
            return None, spent  # the symmetric orbit, whose turn under G was not accepted
    multipliers = floquet(osc, point, steps, half, min(CYCLES, turns_left))
    if multipliers is None:
        return None, spent
    logs, rounding, turns = multipliers
    spent += turns * steps
    if not logs[0] < 0.0:
        return None, spent
    away = motion.h - point.h
    distance = energy_norm(osc, away)
    if distance > 1e-9 * scale:
        trial = motion_at(osc, motion.h, int(motion.contact[0]))
        step_many(osc, trial, steps, half)
        spent += steps
        unexplained = trial.h - point.h - (point.jacobian @ away.ravel()).reshape(away.shape)
        if not energy_norm(osc, unexplained) < 0.5 * -math.expm1(logs[0]) * distance:
            return None, spent
    again = map_with_jacobian(osc, point.image, point.contact, steps, half)
    spent += steps
    if again is not None:
        rounding = max(rounding, 4.0 * abs(_spectral_radius(again[1]) / _spectral_radius(point.jacobian) - 1.0))
    if not logs[0] < -rounding:  # too near a bifurcation for these digits to tell
        return None, spent
    periods = steps / 2 if half else steps
    orbit = Orbit(point.h, point.contact, steps, half, logs / periods, point.residual, rounding / periods)
    return orbit, spent


def _spectral_radius(jacobian: Array) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(jacobian)), initial=1e-300))


def closest_return(osc: Oscillator, sections: Array) -> float:
    """Smallest distance, in the energy norm, of the last of the sections (K, n, 2) from those before it."""
    back = (sections[:-1] - sections[-1]) * _weights(osc)
    return float(np.sqrt(np.min(np.sum(back**2, axis=(1, 2)), initial=np.inf)))


def recurrence(osc: Oscillator, sections: Array, scale: float, longest: int) -> list[int]:
    """Periods p <= longest after which the last of the sections (K, n, 2) nearly returned, the closest first.

    Near is within 1e-2 of ``scale`` in the energy norm; of those, each p that came ten times closer than any
    shorter one, at most three. Whether it means anything, settle() finds out.
    """
    back = (sections[-2::-1][:longest] - sections[-1]) * _weights(osc)
    distance = np.sqrt(np.sum(back**2, axis=(1, 2)))
    found: list[int] = []
    record = 1e-2 * scale
    for p, here in enumerate(distance, start=1):
        if here < record:
            found.insert(0, p)
            record = 0.1 * float(here)
        if record < 1e-12 * scale:
            break
    return found[:3]
