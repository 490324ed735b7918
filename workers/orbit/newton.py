"""Periodic orbits: near returns, Newton on the period map, what makes a fixed point the orbit that attracts, symmetry.

Where the gap is symmetric every orbit is sought as one of the half-period map G, G o G = P: period m under G
with m odd is a symmetric orbit of period m, m even an asymmetric one of period m / 2.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.kernel.jit import kernel, piece
from workers.kernel.stroboscopic import RUNNING, STATUS, Motion
from workers.model.oscillator import Oscillator
from workers.orbit.floquet import floquet, spectral_radius
from workers.orbit.map import FixedPoint, iterate_alone, map_with_jacobian, separation

Array = NDArray[np.float64]

NEWTON_STEPS = 12
CYCLES = 60
"""Turns of the orbit that the Floquet frame may take to settle."""

HOPELESS = 30.0
"""Spectral radius of the Jacobian from which on no stable orbit is expected near: chaos that passes close to itself."""

RESERVED_TURNS = 6
"""Turns that the other tests of an orbit take: divisors (less than two), one under G, one of the motion, one for the
error of the multipliers, one last count."""


class PeriodicOrbit(NamedTuple):
    """A closed orbit of m steps of the map, with what its multipliers show.

    h (n, 2), contact   section state on it
    steps, half         m, and whether a step is half a period (map G)
    exponents           (2n,) ln|mu| / period, largest first; -infinity where structurally lost
    residual            |F(h) - h| in the energy norm
    error               rounding error of the exponents
    """

    h: Array
    contact: int
    steps: int
    half: bool
    exponents: Array
    residual: float
    error: float

    @property
    def period(self) -> int:
        """Forcing periods per orbit."""
        return self.steps // 2 if self.half and self.steps % 2 == 0 else self.steps

    @property
    def symmetric(self) -> bool:
        """Whether (x, t) -> (-x, t + period / 2) maps the orbit to itself."""
        return self.half and self.steps % 2 == 1


@kernel
def nonlinear_part(lam, h, image, point):
    """|F(h) - h* - J (h - h*)| in the energy norm: what the linear map at a fixed point does not explain."""
    J = point.jacobian
    total = 0.0
    for row in range(len(J)):
        rest = image[row // 2, row % 2] - point.h[row // 2, row % 2]
        for k in range(len(J)):
            rest -= J[row, k] * (h[k // 2, k % 2] - point.h[k // 2, k % 2])
        total += rest * rest * (lam[row // 2] if row % 2 == 0 else 1.0)
    return math.sqrt(total)


@kernel
def corrected(h, image, J):
    """One step of Newton's method, h - (J - I)^-1 (F(h) - h); NaN where the matrix is singular."""
    size = len(J)
    matrix, right = J.copy(), np.empty(size)
    for k in range(size):
        matrix[k, k] -= 1.0
        right[k] = image[k // 2, k % 2] - h[k // 2, k % 2]
    try:
        change = np.linalg.solve(matrix, right)
    except Exception:  # a kernel can catch no other
        change = np.full(size, np.nan)
    better = np.empty(h.shape)
    for k in range(size):
        better[k // 2, k % 2] = h[k // 2, k % 2] - change[k]
    return better


@piece
def newton(osc, start, contact, steps, half, scale, most):
    """The fixed point of the map near block state ``start``, to rounding, and the steps of Newton's method it took.

    h <- h - (J - I)^-1 (F(h) - h), at most ``most`` times, until the residual stops falling. It must end below 1e-10
    of ``scale``; the residual is infinite where none is found.
    """
    h = start.copy()
    lam = osc.gap.lam
    size = h.size
    best = FixedPoint(h, h, contact, np.zeros((size, size)), np.inf)
    spent = 0
    while spent < most:
        spent += 1
        motion, J = map_with_jacobian(osc, h, contact, steps, half)
        residual = separation(lam, motion.h, h)
        arrived = motion.tally[STATUS] == RUNNING and motion.contact[0] == contact
        if not (arrived and residual <= 0.5 * best.residual):
            break
        best = FixedPoint(h, motion.h, contact, J, residual)
        if residual > 0.3 * scale or residual < 1e-15 * scale or not spectral_radius(J) < HOPELESS:
            break
        h = corrected(h, motion.h, J)
    if best.residual >= 1e-10 * scale:
        best = FixedPoint(h, h, contact, np.zeros((size, size)), np.inf)
    return best, spent


@piece
def closes_earlier(osc, point, steps, half, scale):
    """Whether fewer steps close the orbit already, or as many under G if these are of P; and the steps taken to see.

    With an odd number of steps under G it is the symmetric orbit, whose turn under G was not accepted.
    """
    spent = 0
    mirrors = not half and steps % 2 == 1 and osc.b_upper == osc.b_lower
    for fewer in range(1, steps + 1):
        if steps % fewer == 0 and (fewer < steps or mirrors):
            trial = iterate_alone(osc, point.h, point.contact, fewer, half or fewer == steps)
            spent += fewer
            if separation(osc.gap.lam, trial.h, point.h) < 1e-6 * scale:
                return True, spent
    return False, spent


@kernel
def find_orbit(osc, h, contact, steps, half, scale, budget):
    """(found, PeriodicOrbit with its exponents in any order, steps spent): see settle."""
    lam = osc.gap.lam
    turns_left = budget // steps - RESERVED_TURNS
    point, tried = newton(osc, h, contact, steps, half, scale, min(NEWTON_STEPS, turns_left))
    spent = tried * steps
    orbit = PeriodicOrbit(point.h, contact, steps, half, np.full(h.size, -np.inf), point.residual, 0.0)
    if point.residual == np.inf:
        return False, orbit, spent
    radius = spectral_radius(point.jacobian)
    if radius > 1.001:
        return False, orbit, spent
    closed, tried_steps = closes_earlier(osc, point, steps, half, scale)
    spent += tried_steps
    if closed:
        return False, orbit, spent
    logs, rounding, turns = floquet(osc, point, steps, half, min(CYCLES, turns_left - tried))
    spent += turns * steps
    largest = np.max(logs)
    if turns == 0 or not largest < 0.0:
        return False, orbit, spent
    distance = separation(lam, h, point.h)
    if distance > 1e-9 * scale:
        trial = iterate_alone(osc, h, contact, steps, half)
        spent += steps
        if not nonlinear_part(lam, h, trial.h, point) < 0.5 * -math.expm1(largest) * distance:
            return False, orbit, spent
    again, J = map_with_jacobian(osc, point.image, contact, steps, half)
    spent += steps
    if again.tally[STATUS] == RUNNING:
        rounding = max(rounding, 4.0 * abs(spectral_radius(J) / max(radius, 1e-300) - 1.0))
    periods = 0.5 * steps if half else 1.0 * steps
    orbit = PeriodicOrbit(point.h, contact, steps, half, logs / periods, point.residual, rounding / periods)
    return largest < -rounding, orbit, spent  # else too near a bifurcation for these digits


def settle(
    osc: Oscillator, motion: Motion, steps: int, half: bool, scale: float, budget: int
) -> tuple[PeriodicOrbit | None, int]:
    """The stable orbit of so many steps that the motion is falling into, if any, and the steps spent.

    Shown: a fixed point (Newton), minimal (no divisor closes), all multipliers inside the unit circle, and
    the motion either on it or so near that its deviation shrinks: what the linear map does not explain of
    one turn is less than half of the contraction, |F(h) - h* - J (h - h*)| < (1 - |mu|) / 2 |h - h*|.
    At most ``budget`` steps are spent.
    """
    if budget // steps <= RESERVED_TURNS:
        return None, 0
    found, orbit, spent = find_orbit(osc, motion.h, int(motion.contact[0]), steps, half, scale, budget)
    return (orbit._replace(exponents=np.sort(orbit.exponents)[::-1]) if found else None), spent


def _weights(osc: Oscillator) -> Array:
    """What block states (n, 2) are multiplied with for the energy norm."""
    return np.column_stack([np.sqrt(osc.gap.lam), np.ones(len(osc.gap.lam))])


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
