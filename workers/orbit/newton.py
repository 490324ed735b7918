"""Periodic orbits of the stroboscopic map: near returns, Newton's method, attraction, symmetry.

P is the map over one forcing period. For a symmetric gap an orbit of odd period m is first sought as an orbit of the
half-period map G, which mirrors the state so that G o G = P. An orbit that closes after m steps of G is symmetric with
period m. The maps take states from period to period, at instants near which the motion meets no stop, see
``orbit.section``. Results refer to the instants t = k T.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.kernel.borrow import row_of
from workers.kernel.by_reference import by_reference
from workers.kernel.cell_loops import scale_of
from workers.kernel.jit import inline_always, kernel
from workers.kernel.linalg import copy_into, highest, solution, sort_down, spectral_radius
from workers.kernel.motion import FLIGHT, NEUTRAL, RUNNING, STATUS, TALLIES
from workers.model.oscillator import HEAD, Array
from workers.orbit.attraction import deviation, falls_into, shrinking_norm, stays_nearer
from workers.orbit.floquet import floquet
from workers.orbit.map import FixedPoint, iterate_alone, map_with_jacobian, separation, squares
from workers.orbit.rest import is_followed
from workers.orbit.section import back_at_section, quiet_section, seen_later

PROOF_STEPS = 12
CYCLES = 60
"""Maximum number of turns of the orbit within which the Floquet frame must settle."""

UNDERFLOWS = 1e-290
"""Spectral radius below which the product of an orbit's Jacobians has lost its digits."""

HOPELESS = 30.0
"""Spectral radius of the Jacobian from which on no stable orbit is near: chaos returned close to itself."""

ON_ORBIT = 1e-9
"""Distance from an orbit, relative to the motion's scale, up to which a motion is on the orbit."""

RESERVED_TURNS = 7
"""Number of turns reserved for the other tests of an orbit: divisors (less than three, or less than two and one under
G), two of the motion, one for the error of the multipliers, one last count."""


NO_ORBIT, UNPROVED, PROVED = range(3)
"""Outcomes of the search. NO_ORBIT: no stable orbit. UNPROVED: a stable orbit that is not proved to attract the motion.
PROVED: a stable orbit that is."""


class PeriodicOrbit(NamedTuple):
    """A periodic orbit that closes after m steps of the map, with its multipliers mu.

    h          (n, 2) state of the decoupled equations on the orbit, at t = k T
    mode       number of the mode there, the set of linear equations that holds
    steps      m
    half       True if a step is half a period (map G), else a period
    exponents  (2n,) ln|mu| / period, in any order; -infinity in directions that are structurally lost
    error      rounding error of the exponents
    """

    h: Array
    mode: int
    steps: int
    half: bool
    exponents: Array
    error: float


@kernel
def newton_step(h, image, J):
    """Return the state (n, 2) after one step of Newton's method for a fixed point of a map F, from state h (n, 2).

    It is h - (J - I)^-1 (F(h) - h), with ``image`` = F(h) and J (2n, 2n) the Jacobian. It is not finite if J - I is
    singular. The states are those of the decoupled equations of motion.
    """
    matrix, better = J.copy(), h.copy()
    for k in range(len(J)):
        matrix[k, k] -= 1.0
    change = solution(matrix, deviation(image, h))
    for k in range(len(J)):
        better[k // 2, k % 2] -= change[k]
    return better


@kernel
def is_hopeless(J):
    """Return True if no stable orbit is near a state with this Jacobian: its spectral radius is HOPELESS or more.

    Mostly its bound, the Frobenius norm, suffices.
    """
    return not squares(J) < HOPELESS * HOPELESS and not spectral_radius(J) < HOPELESS


@inline_always
def newton(oscillator, start, mode, steps, half, scale, limit):
    """Return a FixedPoint of the map near a state ``start`` (n, 2), to rounding, and the number of Newton steps.

    steps, half  number of steps of the map; a step is a period, or with ``half`` the half-period map
    scale        size of the motion, see scale_of
    limit        maximum number of Newton steps

    The states are those of the decoupled equations of motion. h <- h - (J - I)^-1 (F(h) - h) is repeated until the
    residual stops falling. The residual must end below 1e-10 of ``scale``; without a fixed point it is infinite.
    """
    h = start.copy()
    blocks = oscillator.gap.blocks
    size = h.size
    best = FixedPoint(h, h, mode, np.zeros((size, size)), np.inf)
    spent = 0
    while spent < limit:
        spent += 1
        motion, J = map_with_jacobian(oscillator, h, mode, steps, half)
        residual = separation(blocks, motion.h, h)
        arrived = motion.tally[STATUS] == RUNNING and motion.mode[0] == mode
        if not (arrived and residual <= 0.5 * best.residual):
            break
        best = FixedPoint(h, motion.h, mode, J, residual)
        if residual > 0.3 * scale or residual < 1e-15 * scale or is_hopeless(J):
            break
        h = newton_step(h, motion.h, J)
    if best.residual >= 1e-10 * scale:
        best = FixedPoint(h, h, mode, np.zeros((size, size)), np.inf)
    return best, spent


@inline_always
def least_turn(oscillator, point, steps, half, scale):
    """Return (steps, half) of the shortest turn after which an orbit closes, and the number of half periods simulated.

    point        fixed point of the orbit
    steps, half  a turn after which it closes: number of steps, each a period or with ``half`` the half-period map
    scale        size of the motion

    A motion returns only after several turns if an impact alternates between both sides of the instant t = k T.
    """
    spent = 0
    for fewer in range(1, steps + 1):
        for halved in (True, False):
            same_kind = halved == half and fewer < steps
            mirrors = halved and not half and fewer % 2 == 1 and oscillator.head[HEAD.symmetric] > 0.0
            if steps % fewer != 0 or not (same_kind or mirrors):
                continue
            trial = iterate_alone(oscillator, point.h, point.mode, fewer, halved)
            spent += fewer if halved else 2 * fewer
            arrived = trial.tally[STATUS] == RUNNING
            if arrived and separation(oscillator.gap.blocks, trial.h, point.h) < 1e-6 * scale:
                return fewer, halved, spent
    return steps, half, spent


@inline_always
def approaches(oscillator, point, h, steps, half, contraction, scale, limit):
    """Return True if a motion at state h (n, 2) surely converges to an orbit, and the number of turns simulated.

    point        fixed point of the orbit
    steps, half  its turn: number of steps, each a period or with ``half`` the half-period map
    contraction  1 - |mu|, with mu the largest multiplier
    scale        size of the motion
    limit        maximum number of turns

    h is the state of the decoupled equations of motion. Every turn must pass the test of ``orbit.attraction`` until the
    motion stays nearer to the orbit, and in one more turn. A motion that reaches the orbit passes as well.
    """
    blocks, norm = oscillator.gap.blocks, shrinking_norm(oscillator.gap.blocks, point.jacobian, contraction)
    begun, at, nearer = separation(blocks, h, point.h), h, False
    for turn in range(1, limit + 1):
        trial = iterate_alone(oscillator, at, point.mode, steps, half)
        image, arrived = trial.h, trial.tally[STATUS] == RUNNING
        if not (arrived and falls_into(norm, point.jacobian, contraction, point.h, at, image)):
            return False, turn
        if nearer or separation(blocks, image, point.h) <= ON_ORBIT * scale:
            return True, turn
        nearer = stays_nearer(blocks, norm, point.jacobian, point.h, image, begun)
        at = image
    return False, limit


@inline_always
def find_orbit(oscillator, h, mode, steps, half, scale, budget):
    """Return (verdict, PeriodicOrbit, half periods spent) of the periodic orbit near a state h (n, 2).

    h is the state of the decoupled equations of motion. The verdict is NO_ORBIT, UNPROVED or PROVED, see ``settle``. At
    most ``budget`` half periods are simulated. The orbit closes after ``steps`` or a divisor of this number. A step is
    a period, or with ``half`` the half-period map. ``scale`` is the size of the motion.
    """
    guess, spent = h, 0
    while True:
        unit = steps if half else 2 * steps
        turns_left = (budget - spent) // unit - RESERVED_TURNS
        point, tried = newton(oscillator, guess, mode, steps, half, scale, min(PROOF_STEPS, turns_left))
        spent += tried * unit
        orbit = PeriodicOrbit(point.h, mode, steps, half, np.full(h.size, -np.inf), 0.0)
        if point.residual == np.inf:
            return NO_ORBIT, orbit, spent
        radius = spectral_radius(point.jacobian)
        if radius > 1.001:
            return NO_ORBIT, orbit, spent
        fewer, halved, flown = least_turn(oscillator, point, steps, half, scale)
        spent += flown
        if fewer == steps and halved == half:
            break
        steps, half, guess = fewer, halved, point.h
    logs, rounding, turns = floquet(oscillator, point, steps, half, min(CYCLES, turns_left - tried))
    spent += turns * unit
    largest = highest(logs, 0, len(logs))
    if turns == 0 or not largest < 0.0:
        return NO_ORBIT, orbit, spent
    if separation(oscillator.gap.blocks, h, point.h) > ON_ORBIT * scale:
        most = min(CYCLES, turns_left - tried - turns + 2)
        falls, flown = approaches(oscillator, point, h, steps, half, -math.expm1(largest), scale, most)
        spent += flown * unit
        if not falls:
            return UNPROVED, orbit, spent
    again, J = map_with_jacobian(oscillator, point.image, mode, steps, half)
    spent += unit
    if again.tally[STATUS] == RUNNING and radius > UNDERFLOWS:
        rounding = max(rounding, 4.0 * abs(spectral_radius(J) / radius - 1.0))
    periods = 0.5 * unit
    orbit = PeriodicOrbit(point.h, mode, steps, half, logs / periods, rounding / periods)
    # an exponent within its error is too near a bifurcation for double precision
    return PROVED if largest < -rounding else NO_ORBIT, orbit, spent


@kernel
def recurrence(blocks, sections, near, longest):
    """Return the numbers of periods after which a motion nearly returned to its last state, the closest return first.

    sections  (K, n, 2) its states of the decoupled equations at the last instants t = k T
    near      largest distance of a return, in the energy norm of ``blocks``
    longest   maximum number of periods p

    A return is ten times closer than any for shorter p. There are at most three. ``settle`` decides whether a return
    belongs to an orbit.
    """
    closest = np.empty(3, dtype=np.int64)
    count, last = 0, len(sections) - 1
    record = near
    for p in range(1, min(last, longest) + 1):
        distance = separation(blocks, sections[last], sections[last - p])
        if distance < record:
            closest[2], closest[1], closest[0] = closest[1], closest[0], p
            count = min(count + 1, 3)
            record = 0.1 * distance
        if record < 1e-10 * near:
            break
    return closest[:count]


@kernel
def far_from_closing(blocks, h, sections, cells, returns, limit):
    """Return the mask of the cells whose motion has not come near its last state in the last ``returns`` periods.

    h         (N, n, 2) states of the decoupled equations, for the sizes of the motions
    sections  (N, K, n, 2) block states at the last instants t = k T
    limit     largest distance of a return, relative to the size of the motion

    The number of returns is fixed, since on a torus more returns come nearer.
    """
    far = np.empty(len(cells), dtype=np.bool_)
    last = sections.shape[1] - 1
    for e in range(len(cells)):
        r = cells[e]
        nearest = np.inf
        for k in range(last - returns, last):
            nearest = min(nearest, separation(blocks[r], sections[r, last], sections[r, k]))
        far[e] = nearest > limit * scale_of(blocks[r], h[r])
    return far


@inline_always
def settle(oscillator, motion, sections, near, longest, budget):
    """Return (verdict, PeriodicOrbit, shift, periods spent) of the stable periodic orbit to which a motion converges.

    sections  (K, n, 2) its states of the decoupled equations at the last instants t = k T
    near      largest distance of a return, relative to the size of the motion
    longest   maximum number of periods of a return
    budget    maximum number of periods to simulate

    The verdict is NO_ORBIT, UNPROVED or PROVED.

    PROVED: the motion converges to the stable orbit returned.

    UNPROVED: its states return near a stable orbit, but convergence is not proved.

    The proof has four parts. Newton's method finds a fixed point on the section t = (k + shift) T. The orbit is
    minimal: no shorter turn closes. All multipliers lie inside the unit circle. The motion is on the orbit, or so near
    that its deviation shrinks: see ``orbit.attraction``.

    States return if the last one is within ``near`` of an earlier one, see ``recurrence``.
    """
    scale = scale_of(oscillator.gap.blocks, motion.h)
    returns = recurrence(oscillator.gap.blocks, sections, near * scale, longest)
    shift, h, mode, flown = 0.0, motion.h.copy(), motion.mode[0], 0
    if len(returns) > 0 and budget > RESERVED_TURNS:
        shift, h, mode, flown = quiet_section(oscillator, motion.h, motion.mode[0])
    shifted = seen_later(oscillator, shift)
    none = PeriodicOrbit(h, mode, 1, False, np.full(h.size, -np.inf), 0.0)
    spent, nearest = 2 * flown, NO_ORBIT
    for p in returns:
        for half in (True, False):
            remaining = 2 * budget - spent
            halves = oscillator.head[HEAD.symmetric] > 0.0 and p % 2 == 1
            if (half and not halves) or remaining // (p if half else 2 * p) <= RESERVED_TURNS:
                continue
            verdict, orbit, half_periods = find_orbit(shifted, h, mode, p, half, scale, remaining)
            spent += half_periods + half_periods % 2
            if verdict == PROVED:
                return PROVED, orbit, shift, spent // 2
            nearest = max(nearest, verdict)
    return nearest, none, shift, spent // 2


class PeriodicOrbits(NamedTuple):
    """Periodic orbits of N cells: the fields of PeriodicOrbit needed in results, and the counts of one turn.

    h          (N, n, 2) states of the decoupled equations at t = k T, after any impact at that time
    mode       (N, 1) numbers of the modes there, the sets of linear equations that hold
    period     (N,) number of forcing periods of a turn
    symmetric  (N,) mask of symmetric orbits
    exponents  (N, 2n) exponents, largest first
    error      (N,) rounding error of the exponents
    tally      (N, TALLIES) counts of one turn, see Motion
    shift      (N,) shift of the section of the proof, in periods
    near       (N,) mask of motions with an UNPROVED orbit at some time, see ``settle``
    """

    h: Array
    mode: NDArray[np.int64]
    period: NDArray[np.int64]
    symmetric: NDArray[np.bool_]
    exponents: Array
    error: Array
    tally: Array
    shift: Array
    near: NDArray[np.bool_]


def no_orbits(count: int, n: int) -> PeriodicOrbits:
    """Return PeriodicOrbits of ``count`` cells to be filled in, with all numbers 0 and period 1.

    n  number of blocks, the decoupled equations of motion
    """
    return PeriodicOrbits(
        h=np.zeros((count, n, 2)),
        mode=np.full((count, 1), FLIGHT),
        period=np.ones(count, dtype=np.int64),
        symmetric=np.zeros(count, dtype=np.bool_),
        exponents=np.zeros((count, 2 * n)),
        error=np.zeros(count),
        tally=np.zeros((count, TALLIES)),
        shift=np.zeros(count),
        near=np.zeros(count, dtype=np.bool_),
    )


@kernel
def settle_cells(oscillators, motions, sections, counts, near, longest, budgets, cells, orbits, spent):
    """Find and prove the stable periodic orbits to which these cells converge, see ``settle``.

    sections  (N, K, n, 2) states of the decoupled equations at the last instants t = k T
    counts    (N,) number of these states that are known, the last ones
    near      (N,) largest distance of a return, relative to the size of the motion
    longest   maximum number of periods of a return
    budgets   (N,) maximum number of periods to simulate
    orbits    PeriodicOrbits, whose rows of these cells are written
    spent     (N,) number of periods simulated, written

    An orbit that rests on a stop and keeps no direction counts if doubles can follow it from rest to rest. Return the
    mask of the cells with a proved orbit.
    """
    oscillators, motions, orbits = by_reference(oscillators), by_reference(motions), by_reference(orbits)
    settled = np.empty(len(cells), dtype=np.bool_)
    for e in range(len(cells)):
        r = cells[e]
        osc = row_of(oscillators, r)
        known = sections[r, sections.shape[1] - counts[r] :]
        result, orbit, shift, spent[r] = settle(osc, row_of(motions, r), known, near[r], longest, budgets[r])
        shifted = seen_later(osc, shift)
        settled[e] = result == PROVED
        if settled[e] and highest(orbit.exponents, 0, len(orbit.exponents)) == -np.inf:
            settled[e] = is_followed(shifted, orbit.h, orbit.mode, orbit.steps)
        orbits.near[r] |= result == UNPROVED
        if not settled[e]:
            continue
        turn = iterate_alone(shifted, orbit.h, orbit.mode, orbit.steps, np.bool_(False))  # typed, as in run_batch
        back = back_at_section(osc, shift, orbit.h, orbit.mode)
        orbits.mode[r, 0], orbits.period[r], orbits.error[r] = back.mode[0], orbit.steps, orbit.error
        orbits.symmetric[r], orbits.shift[r] = orbit.half, shift
        for _ in range(int(turn.tally[NEUTRAL])):
            least = 0
            for k in range(1, len(orbit.exponents)):
                least = k if orbit.exponents[k] < orbit.exponents[least] else least
            orbit.exponents[least] = 0.0
        sort_down(orbit.exponents)
        copy_into(orbits.h[r], back.h)
        copy_into(orbits.tally[r], turn.tally)
        copy_into(orbits.exponents[r], orbit.exponents)
    return settled
