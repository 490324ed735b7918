"""Periodic orbits: Newton on the period map, Floquet exponents without forming the product, symmetry.

Where the gap is symmetric every orbit is sought as one of the half-period map G, G o G = P: period m under G
with m odd is a symmetric orbit of period m, m even an asymmetric one of period m / 2.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.frame import inner
from workers.jit import kernel, piece
from workers.oscillator import Oscillator
from workers.section import (
    LOST,
    RUNNING,
    STATUS,
    Motion,
    axes,
    mirror,
    motion_with,
    reset_frame,
    travel,
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


class Fixed(NamedTuple):
    """A fixed point of so many steps of the map: block state, its image, contact, Jacobian and |F(h) - h|."""

    h: Array
    image: Array
    contact: int
    jacobian: Array
    residual: float


@kernel
def image(osc, h, contact, V, growth, triangle, steps, half):
    """The motion that so many steps of the map, half periods or whole ones, make of block state h; see motion_with.

    Not RUNNING where it cannot get there.
    """
    motion = motion_with(h, contact, V, growth, triangle)
    for _ in range(steps):
        travel(osc, motion, 0.5 * osc.period if half else osc.period)
        if half:
            mirror(motion)
        if motion.tally[STATUS] != RUNNING:
            break
    return motion


@kernel
def energy_norm(lam, h):
    """sqrt(sum lam_j h_j^2 + h_j'^2) of block states (n, 2)."""
    total = 0.0
    for j in range(len(lam)):
        total += lam[j] * h[j, 0] ** 2 + h[j, 1] ** 2
    return math.sqrt(total)


@kernel
def separation(lam, h, g):
    """The energy norm of the difference of two block states (n, 2)."""
    total = 0.0
    for j in range(len(lam)):
        total += lam[j] * (h[j, 0] - g[j, 0]) ** 2 + (h[j, 1] - g[j, 1]) ** 2
    return math.sqrt(total)


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


@kernel
def moduli(matrix):
    """|eigenvalues| of a real matrix; infinity where it is not finite."""
    try:
        return np.abs(np.linalg.eigvals(matrix.astype(np.complex128)))
    except Exception:  # a kernel can catch no other
        return np.full(len(matrix), np.inf)


@kernel
def spectral_radius(matrix):
    """The largest |eigenvalue| of a real matrix; infinity where it is not finite."""
    return np.max(moduli(matrix))


@piece
def bare_image(osc, h, contact, steps, half):
    """The image of h alone, without tangent vectors."""
    return image(osc, h, contact, np.zeros((0, h.shape[0], 2)), np.zeros(0), np.zeros((0, 0)), steps, half)


@kernel
def jacobian_of(V):
    """The Jacobian (2n, 2n) that has tangent vectors V (2n, n, 2) for columns."""
    size = V.shape[0]
    J = np.empty((size, size))
    for i in range(size):
        for j in range(V.shape[1]):
            J[2 * j, i], J[2 * j + 1, i] = V[i, j, 0], V[i, j, 1]
    return J


@piece
def map_with_jacobian(osc, h, contact, steps, half):
    """The motion that so many steps of the map make of h, and the Jacobian (2n, 2n) of the map there."""
    motion = image(osc, h, contact, axes(h.shape[0]), np.zeros(0), np.zeros((0, 0)), steps, half)
    return motion, jacobian_of(motion.V)


@piece
def newton_steps(osc, start, contact, steps, half, scale, most):
    """See newton."""
    h = start.copy()
    lam = osc.gap.lam
    size = h.size
    best = Fixed(h, h, contact, np.zeros((size, size)), np.inf)
    spent = 0
    while spent < most:
        spent += 1
        motion, J = map_with_jacobian(osc, h, contact, steps, half)
        residual = separation(lam, motion.h, h)
        arrived = motion.tally[STATUS] == RUNNING and motion.contact[0] == contact
        if not (arrived and residual <= 0.5 * best.residual):
            break
        best = Fixed(h, motion.h, contact, J, residual)
        if residual > 0.3 * scale or residual < 1e-15 * scale or not spectral_radius(J) < HOPELESS:
            break
        h = corrected(h, motion.h, J)
    if best.residual >= 1e-10 * scale:
        best = Fixed(h, h, contact, np.zeros((size, size)), np.inf)
    return best, spent


@kernel
def newton(osc, start, contact, steps, half, scale, most):
    """The fixed point of the map near block state ``start``, to rounding, and the steps of Newton's method it took.

    h <- h - (J - I)^-1 (F(h) - h), at most ``most`` times, until the residual stops falling. It must end below 1e-10
    of ``scale``; the residual is infinite where none is found.
    """
    return newton_steps(osc, start, contact, steps, half, scale, most)


@kernel
def overlaps(lam, before, after):
    """The energy products of the vectors of two frames (m, n, 2): an orthogonal matrix where both span one space."""
    m = before.shape[0]
    products = np.empty((m, m))
    for i in range(m):
        for k in range(m):
            products[i, k] = inner(lam, before, i, after, k)
    return products


@kernel
def block_ends(rotation):
    """Where the diagonal blocks end into which an orthogonal matrix falls apart."""
    size = len(rotation)
    ends = np.empty(size, dtype=np.int64)
    count = 0
    for end in range(1, size + 1):
        coupling = 0.0
        for i in range(end, size):
            for k in range(end):
                coupling = max(coupling, abs(rotation[i, k]))
        if coupling < SETTLED:
            ends[count] = end
            count += 1
    return ends[:count]


@kernel
def spread_of(logs, ends):
    """The largest difference of logarithms within one block."""
    spread, start = 0.0, 0
    for end in ends:
        spread = max(spread, np.max(logs[start:end]) - np.min(logs[start:end]))
        start = end
    return spread


@kernel
def block_logs(rotation, growth, triangle, ends, size):
    """ln|eigenvalues| of rotation diag(exp(growth)) triangle, block by block, and the largest modulus of them.

    Scaled so that nothing overflows. Up to ``size`` they are -infinity: directions that are lost.
    """
    logs = np.full(size, -np.inf)
    largest, start = 0.0, 0
    for end in ends:
        top = np.max(growth[start:end])
        product = np.zeros((end - start, end - start))
        for i in range(start, end):
            for k in range(start, end):
                for j in range(start, end):
                    product[i - start, k - start] += rotation[i, j] * math.exp(growth[j] - top) * triangle[j, k]
        for modulus in moduli(product):
            logs[start] = top + math.log(modulus)
            largest = max(largest, abs(logs[start]))
            start += 1
    return logs, largest


@piece
def floquet(osc, point, steps, half, most):
    """(log moduli of the multipliers per turn, in any order; their rounding error; turns), 0 turns if ``most`` < 2.

    A frame is carried round the orbit until it splits into invariant subspaces; what QR took out of each is
    kept as logarithms, so that multipliers of any spread keep their digits. Blocks that do not split have
    multipliers of nearly one modulus, and their product can be formed. Lost directions are -infinity.
    """
    size = point.h.size
    frame = axes(point.h.shape[0])
    logs = np.full(size, -np.inf)
    rounding = np.inf
    turns = 0
    for turn in range(1, most + 1):
        m = frame.shape[0]
        motion = image(osc, point.h, point.contact, frame.copy(), np.zeros(m), np.eye(m), steps, half)
        if motion.tally[STATUS] != RUNNING:
            break
        reset_frame(osc, motion)
        rank = size - int(motion.tally[LOST])
        rotation = overlaps(osc.gap.lam, frame[:rank], motion.V[:rank])
        frame = motion.V[:rank].copy()
        if turn == 1:
            continue
        ends = block_ends(rotation)
        spread = spread_of(motion.growth, ends)
        if spread < NARROW or turn == most:
            logs, largest = block_logs(rotation, motion.growth, motion.triangle, ends, size)
            rounding = 1e-15 * (1.0 + largest) * math.exp(min(spread, 700.0))
            turns = turn
            break
    return logs, rounding, turns


@piece
def closes_earlier(osc, point, steps, half, scale):
    """Whether fewer steps close the orbit already, or as many under G if these are of P; and the steps taken to see.

    With an odd number of steps under G it is the symmetric orbit, whose turn under G was not accepted.
    """
    spent = 0
    mirrors = not half and steps % 2 == 1 and osc.b_upper == osc.b_lower
    for fewer in range(1, steps + 1):
        if steps % fewer == 0 and (fewer < steps or mirrors):
            trial = bare_image(osc, point.h, point.contact, fewer, half or fewer == steps)
            spent += fewer
            if separation(osc.gap.lam, trial.h, point.h) < 1e-6 * scale:
                return True, spent
    return False, spent


@kernel
def find_orbit(osc, h, contact, steps, half, scale, budget):
    """(found, Orbit with its exponents in any order, steps spent): see settle."""
    lam = osc.gap.lam
    turns_left = budget // steps - RESERVED_TURNS
    point, tried = newton_steps(osc, h, contact, steps, half, scale, min(NEWTON_STEPS, turns_left))
    spent = tried * steps
    orbit = Orbit(point.h, contact, steps, half, np.full(h.size, -np.inf), point.residual, 0.0)
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
        trial = bare_image(osc, h, contact, steps, half)
        spent += steps
        if not nonlinear_part(lam, h, trial.h, point) < 0.5 * -math.expm1(largest) * distance:
            return False, orbit, spent
    again, J = map_with_jacobian(osc, point.image, contact, steps, half)
    spent += steps
    if again.tally[STATUS] == RUNNING:
        rounding = max(rounding, 4.0 * abs(spectral_radius(J) / max(radius, 1e-300) - 1.0))
    periods = 0.5 * steps if half else 1.0 * steps
    orbit = Orbit(point.h, contact, steps, half, logs / periods, point.residual, rounding / periods)
    return largest < -rounding, orbit, spent  # else too near a bifurcation for these digits to tell


def settle(
    osc: Oscillator, motion: Motion, steps: int, half: bool, scale: float, budget: int
) -> tuple[Orbit | None, int]:
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
