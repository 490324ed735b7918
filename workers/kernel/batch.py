"""Many cells side by side: the stroboscopic map as passes over flat arrays, which compile to vector instructions.

A lane holds one cell. Each round evaluates every lane once, at the time that its last step led to, and either
takes its next certified step or carries it through the impact or section that it has reached. A lane that ends
takes the next cell of the queue. The arithmetic is that of ``section.advance``, operation by operation, so the
results are the same bits, whatever the neighbours; what is rare (rest on a stop, the end of chatter, a march
of many steps) ends a lane at its last section, for ``section`` to go on from.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.kernel.averages import add_growth
from workers.kernel.flight import (
    LEAST_STEP,
    REFRESH,
    ROUNDING,
    TINY,
    amplitude_bounds,
    arrival,
    block_bounds,
    block_output,
    bracket,
    close_in,
    curvature,
    flow_entries,
    forced,
    forced_bounds,
    meets,
    oscillating_flow,
)
from workers.kernel.frame import graded_flow, log_length, orthonormalise, orthonormalise_pass
from workers.kernel.impact import is_rebound, load_at_rest
from workers.kernel.jit import inlined, kernel
from workers.kernel.stroboscopic import (
    EVALUATIONS,
    LOST,
    LOWER,
    MAX_SPREAD,
    MIN_SPEED,
    SPREAD,
    UPPER,
    WORK,
    impact_spread,
    loss_spread,
    needs_reset,
    spread_rate,
)
from workers.model.oscillator import Oscillator

Array = NDArray[np.float64]

LANES = 128
"""Cells side by side: their fields stay in the processor's nearest caches."""

WIDTH_OF_VECTORS = 8
"""Numbers in the longest vectors of today's processors: passes run over multiples, or what is over would be scalar."""

STRIDE = LANES + WIDTH_OF_VECTORS
"""Numbers from one field to the next; a power of two would put all fields of a lane into the same few cache lines."""

RENEWAL = float(REFRESH)

LONGEST_MARCH = 64
"""Steps of one flight after which a lane is left to ``section``."""

LONGEST_PERIOD = 2000.0
"""Evaluations in one period after which a lane is left to ``section``, which sees to it that every period ends."""

FLYING, AT_SECTION, LEFT = 0.0, 2.0, 3.0
"""What a lane has reached, +-1 being an impact at that stop; LEFT: what ``section`` has to take over."""

# Fields of a lane. The offsets are constants, STRIDE apart, so that the compiler sees that no two overlap.
#   OMEGA...LOSS     constants of signal, stops, impact law and section; forced part there; for the spread of the frame
#   T, PHASE, S      time since the section and phase at the flight's start, time in flight; FLOWN: of the last flight
#   MODE, OWN        what is reached at S; the stop that the flight starts on until its first step is taken
#   COUNT            evaluations of this flight
#   FRESH, RENEW     1 where a flight starts, 1 where the bounds are to be computed anew
#   FORCED...M4      the forced part, the signal with its derivatives and scale of rounding, bounds of its derivatives
#   DV, DY           change of velocity and position at an impact; RATIO its a / v, JUMP how far it spreads the frame
#   HITS_UP...COST   impacts per stop, slowest one, evaluations; evaluations of this period
#   SIDE...SEEK      the stop looked at, the gap to it, the time to meet it, bounds of a safe time, 1 where it is sought
#   WIDTH, LENGTH    spread of the frame; log of the length of its first vector at the last section
_HEAD = 53
(OMEGA, SIN_PART, COS_PART, AMPLITUDE, UP, DOWN, R, CA2K, PERIOD, TAU, Y_TAU, V_TAU, RATE, UNIT, LOSS,
 T, PHASE, S, FLOWN, MODE, OWN, COUNT, FRESH, RENEW,
 FORCED, DFORCED, Y, V, A, J, SCALE, M0, M2, M3, M4, DV, DY, RATIO, JUMP,
 HITS_UP, HITS_DOWN, SLOWEST, EVALS, COST, REQUEST, WIDTH, LENGTH,
 SIDE, GAP, REST, LOW, STEP, SEEK,
 ) = (k * STRIDE for k in range(_HEAD))  # fmt: skip
CONSTANTS = 15
"""Fields that the oscillator sets, the first ones."""

# Fields of a block of a lane: those of Block, c and cA (C, D), k and A k (K, L); its state at the flight's start (H)
# and at S (G), the flow between them (F).
_BLOCK = 28
(ETA, LAM, D, W, INV_W, SLOW, FAST, TILT, WEIGHT, GROW2, GROW3, GROW4, C0, C1, D0, D1, K0, K1, L0, L1,
 H0, H1, G0, G1, F11, F12, F21, F22) = (k * STRIDE for k in range(_BLOCK))  # fmt: skip
BLOCK_CONSTANTS = 20

# Fields of what is gathered of some lanes: the gap, how it closes, the bounds, and between which times to look.
_GATHERED = 9
C_GAP, C_V, C_A, C_J, C_M2, C_M3, C_M4, C_LOW, C_HIGH = (k * STRIDE for k in range(_GATHERED))


class Batch(NamedTuple):
    """Cells that are to go on by some periods each: N requests, every field stacked along its first axis.

    head       (N, CONSTANTS)           what the oscillators say, and
    blocks     (N, n, BLOCK_CONSTANTS)  of each block: Block, rows c and cA, columns k and A k
    periods    (N,)                     wanted; done (N,) completed, before and after
    left       (N,)                     set where ``section`` has to take over
    h          (N, n, 2), V (N, m, n, 2), growth (N, m), tally (N, TALLIES): as in Motion
    levels     (N, LEVELS, 4), weighted (N, 2): as in Averages
    sections   (N, K, n, 2)             the last K states
    """

    head: Array
    blocks: Array
    periods: NDArray[np.int64]
    done: NDArray[np.int64]
    left: NDArray[np.bool_]
    h: Array
    V: Array
    growth: Array
    tally: Array
    levels: Array
    weighted: Array
    sections: Array


def constants(osc: Oscillator) -> tuple[Array, Array]:
    """The rows of Batch.head and Batch.blocks of an oscillator."""
    gap = osc.gap
    y, v = forced(osc.tau, gap.omega, gap.sin_part, gap.cos_part)
    head = np.array([
        gap.omega, gap.sin_part, gap.cos_part, gap.amplitude, osc.b_upper, -osc.b_lower, osc.R, osc.cA2k,
        osc.period, osc.tau, y, v, spread_rate(gap.block), 1.0 / math.sqrt(gap.lam[0]), loss_spread(osc.R),
    ])  # fmt: skip
    rows = zip(gap.block, gap.row, gap.row1, osc.kick, osc.kick1, strict=True)
    return head, np.array([[x for part in row for x in part] for row in rows])


@kernel
def fields_of(a, j):
    """The fields of block j."""
    return a[(_HEAD + j * _BLOCK) * STRIDE : (_HEAD + (j + 1) * _BLOCK) * STRIDE]


@kernel
def forced_pass(a, n):
    """Start the sum of the signal and its derivatives with the forced part."""
    for i in range(n):
        w = a[OMEGA + i]
        y, v = forced(a[PHASE + i] + w * a[S + i], w, a[SIN_PART + i], a[COS_PART + i])
        a[FORCED + i] = y
        a[DFORCED + i] = v
        a[Y + i] = y
        a[V + i] = v
        a[A + i] = -w * w * y
        a[J + i] = -w * w * v
        a[SCALE + i] = abs(y)


@inlined
def keep_flow(a, q, i, flow):
    """Take the state of one block to the time S and add its share of the signal."""
    f11, f12, f21, f22 = flow
    h0 = f11 * q[H0 + i] + f12 * q[H1 + i]
    h1 = f21 * q[H0 + i] + f22 * q[H1 + i]
    q0, q1, q2, q3 = block_output(h0, h1, q[ETA + i], q[LAM + i], q[C0 + i], q[C1 + i], q[D0 + i], q[D1 + i])
    q[F11 + i] = f11
    q[F12 + i] = f12
    q[F21 + i] = f21
    q[F22 + i] = f22
    q[G0 + i] = h0
    q[G1 + i] = h1
    a[Y + i] += q0
    a[V + i] += q1
    a[A + i] += q2
    a[J + i] += q3
    a[SCALE + i] += abs(q0)


@kernel
def oscillating_block_pass(a, q, n):
    """Flow one block (q: its fields) to the time S and add its share of the signal; underdamped in every lane."""
    for i in range(n):
        keep_flow(a, q, i, oscillating_flow(a[S + i], q[ETA + i], q[LAM + i], q[W + i], q[INV_W + i]))


@kernel
def block_pass(a, q, n):
    """Flow one block (q: its fields) to the time S and add its share of the signal, whatever its damping."""
    for i in range(n):
        eta, lam, d, w, inv_w = q[ETA + i], q[LAM + i], q[D + i], q[W + i], q[INV_W + i]
        keep_flow(a, q, i, flow_entries(a[S + i], eta, lam, d, w, inv_w, q[SLOW + i], q[FAST + i]))


@kernel
def arrival_pass(a, n):
    """What each lane has reached: the impact's kick and counts, and the start of the next flight."""
    for i in range(n):
        side, s, y, acceleration = a[MODE + i], a[S + i], a[Y + i], a[A + i]
        up, down, r, cA2k = a[UP + i], a[DOWN + i], a[R + i], a[CA2K + i]
        hit = abs(side) == 1.0
        event = side != FLYING
        at_section = side == AT_SECTION
        v = side * max(side * a[V + i], TINY)
        before, phase, tau = a[T + i], a[PHASE + i], a[TAU + i]
        t = before + s
        load = load_at_rest(side, v, acceleration, cA2k)
        rebound = is_rebound(load, v, r, cA2k, a[SCALE + i] + abs(y), a[PERIOD + i] - t)
        stop = up if side > 0.0 else down
        a[DV + i] = -(1.0 + r) * v if hit else 0.0
        a[DY + i] = stop - y if hit else 0.0
        a[HITS_UP + i] += 1.0 if side == 1.0 else 0.0
        a[HITS_DOWN + i] += 1.0 if side == -1.0 else 0.0
        slowest = a[SLOWEST + i]
        a[SLOWEST + i] = min(slowest, abs(v)) if hit else slowest
        count = a[COUNT + i]
        cost = max(1.0, count)
        spent = a[COST + i]
        spent = spent + cost if event else spent
        a[EVALS + i] += count if event else 0.0
        a[COST + i] = spent
        a[COUNT + i] = 0.0 if event else count
        a[FRESH + i] = 1.0 if event else 0.0
        a[RENEW + i] = 1.0 if event or count == RENEWAL * math.floor(count / RENEWAL) else 0.0
        phase_hit = phase + a[OMEGA + i] * s
        phase = phase_hit if hit else phase
        a[PHASE + i] = tau if at_section else phase
        t = t if hit else before
        a[T + i] = 0.0 if at_section else t
        a[OWN + i] = side if hit else 0.0
        a[FLOWN + i] = s
        a[S + i] = 0.0 if event else s
        y_force, v_force, y_tau, v_tau = a[FORCED + i], a[DFORCED + i], a[Y_TAU + i], a[V_TAU + i]
        a[FORCED + i] = y_tau if at_section else y_force
        a[DFORCED + i] = v_tau if at_section else v_force
        a[MODE + i] = LEFT if hit and (not rebound or spent > LONGEST_PERIOD) else side


@kernel
def restart_pass(a, n):
    """Begin the sums of signal and bounds anew: the signal where a flight starts, the bounds there and now and then."""
    for i in range(n):
        w, y, v, Y_ = a[OMEGA + i], a[FORCED + i], a[DFORCED + i], a[AMPLITUDE + i]
        fresh, renew = a[FRESH + i] > 0.0, a[RENEW + i] > 0.0
        y_, v_, a_, j_, scale = a[Y + i], a[V + i], a[A + i], a[J + i], a[SCALE + i]
        m0, m2, m3, m4 = a[M0 + i], a[M2 + i], a[M3 + i], a[M4 + i]
        a[Y + i] = y if fresh else y_
        a[V + i] = v if fresh else v_
        a[A + i] = -w * w * y if fresh else a_
        a[J + i] = -w * w * v if fresh else j_
        a[SCALE + i] = abs(y) if fresh else scale
        b0, b2, b3, b4 = forced_bounds(w, Y_)
        a[M0 + i] = b0 if renew else m0
        a[M2 + i] = b2 if renew else m2
        a[M3 + i] = b3 if renew else m3
        a[M4 + i] = b4 if renew else m4


@inlined
def share_at_start(a, q, i):
    """A block's share of the signal where bounds are wanted; where a flight starts there, after the impact's kick."""
    fresh = a[FRESH + i] > 0.0
    eta, lam, g0, g1, start0, start1 = q[ETA + i], q[LAM + i], q[G0 + i], q[G1 + i], q[H0 + i], q[H1 + i]
    dv, dy = a[DV + i], a[DY + i]
    kicked0, kicked1 = g0 + dv * q[K0 + i] + dy * q[L0 + i], g1 + dv * q[K1 + i] + dy * q[L1 + i]
    h0, h1 = kicked0 if fresh else g0, kicked1 if fresh else g1
    q[H0 + i] = h0 if fresh else start0
    q[H1 + i] = h1 if fresh else start1
    q0, q1, q2, q3 = block_output(h0, h1, eta, lam, q[C0 + i], q[C1 + i], q[D0 + i], q[D1 + i])
    a[Y + i] += q0 if fresh else 0.0
    a[V + i] += q1 if fresh else 0.0
    a[A + i] += q2 if fresh else 0.0
    a[J + i] += q3 if fresh else 0.0
    a[SCALE + i] += abs(q0) if fresh else 0.0
    return q0, q1


@inlined
def add_bounds(a, i, bounds):
    """Add a block's bounds to the sums where they are computed anew."""
    renew = a[RENEW + i] > 0.0
    b0, b2, b3, b4 = bounds
    a[M0 + i] += b0 if renew else 0.0
    a[M2 + i] += b2 if renew else 0.0
    a[M3 + i] += b3 if renew else 0.0
    a[M4 + i] += b4 if renew else 0.0


@kernel
def oscillating_bounds_pass(a, q, n):
    """Add one block's share to the sums that restart_pass began; underdamped in every lane."""
    for i in range(n):
        q0, q1 = share_at_start(a, q, i)
        tilt, weight, grow2, grow3, grow4 = q[TILT + i], q[WEIGHT + i], q[GROW2 + i], q[GROW3 + i], q[GROW4 + i]
        add_bounds(a, i, amplitude_bounds(q0, q1, tilt, weight, grow2, grow3, grow4))


@kernel
def bounds_pass(a, q, n):
    """Add one block's share to the sums that restart_pass began, whatever its damping."""
    for i in range(n):
        q0, q1 = share_at_start(a, q, i)
        eta, lam, d, inv_w, slow, fast = q[ETA + i], q[LAM + i], q[D + i], q[INV_W + i], q[SLOW + i], q[FAST + i]
        tilt, weight, grow2, grow3, grow4 = q[TILT + i], q[WEIGHT + i], q[GROW2 + i], q[GROW3 + i], q[GROW4 + i]
        add_bounds(a, i, block_bounds(q0, q1, eta, lam, d, inv_w, slow, fast, tilt, weight, grow2, grow3, grow4))


# The next time of each lane, certified or an arrival: one turn of the loop of flight.next_crossing. What most lanes can
# do without is done for those that need it, gathered side by side.


@kernel
def approach_pass(a, n):
    """The stop that each mass moves towards: the gap left, and the time after which it has certainly closed."""
    for i in range(n):
        upper, lower = a[UP + i], a[DOWN + i]
        ahead = 1.0 if a[V + i] > 0.0 else -1.0
        stop = upper if ahead > 0.0 else lower
        reach = a[M0 + i] * (1.0 + 1e-12)
        room = a[PERIOD + i] - a[T + i] - a[S + i]
        g = ahead * (stop - a[Y + i])
        g = 0.0 if a[OWN + i] == ahead else g
        v, push, jerk = ahead * a[V + i], ahead * a[A + i], ahead * a[J + i]
        rest = meets(g, v, push, jerk, a[M3 + i], a[M4 + i], ROUNDING * (a[SCALE + i] + abs(stop)), room)
        rest = rest if reach - ahead * stop >= 0.0 else np.inf
        a[SIDE + i] = ahead
        a[GAP + i] = max(g, 0.0)
        a[REST + i] = rest
        a[STEP + i] = room
        a[LOW + i] = 0.0
        a[SEEK + i] = 1.0 if reach - ahead * stop >= 0.0 and rest == np.inf else 0.0


@kernel
def retreat_pass(a, n):
    """The stop that each mass moves away from: the gap, and a time that is safe from it."""
    for i in range(n):
        step, ahead, upper, lower = a[STEP + i], a[SIDE + i], a[UP + i], a[DOWN + i]
        reach = a[M0 + i] * (1.0 + 1e-12)
        behind = lower if ahead > 0.0 else upper
        g = ahead * (a[Y + i] - behind)
        g = max(0.0 if a[OWN + i] == -ahead else g, 0.0)
        v, push, jerk = -ahead * a[V + i], -ahead * a[A + i], -ahead * a[J + i]
        L = min(step, arrival(g, v, curvature(push, jerk, a[M2 + i], a[M3 + i], a[M4 + i], step)))
        a[SIDE + i] = -ahead
        a[GAP + i] = g
        a[LOW + i] = L
        a[SEEK + i] = 1.0 if reach + ahead * behind >= 0.0 and step > L and a[REST + i] == np.inf else 0.0


@kernel
def list_lanes(a, field, n, chosen):
    """How many lanes have this field set, and which: without a branch, which the processor would often mispredict."""
    count = 0
    for i in range(n):
        chosen[count] = i
        count += int(a[field + i] != 0.0)
    return count


@kernel
def gather(a, chosen, count, c):
    """What lanes chosen[:count] know of the stop on their SIDE, side by side in c; how far passes have to run."""
    for e in range(count):
        i = chosen[e]
        side = a[SIDE + i]
        c[C_GAP + e] = a[GAP + i]
        c[C_V + e], c[C_A + e], c[C_J + e] = side * a[V + i], side * a[A + i], side * a[J + i]
        c[C_M2 + e], c[C_M3 + e], c[C_M4 + e] = a[M2 + i], a[M3 + i], a[M4 + i]
        c[C_LOW + e], c[C_HIGH + e] = a[LOW + i], a[STEP + i]
    return -(-count // WIDTH_OF_VECTORS) * WIDTH_OF_VECTORS


@kernel
def bracket_pass(c, n):
    """Bounds of the time for which the gap stays open."""
    for e in range(n):
        g, v, push, jerk = c[C_GAP + e], c[C_V + e], c[C_A + e], c[C_J + e]
        L, U = bracket(g, v, push, jerk, c[C_M2 + e], c[C_M3 + e], c[C_M4 + e], c[C_HIGH + e])
        c[C_LOW + e] = L
        c[C_HIGH + e] = U


@kernel
def close_in_pass(c, n):
    """The time for which the gap stays open, from bounds of it."""
    for e in range(n):
        g, v, push, jerk = c[C_GAP + e], c[C_V + e], c[C_A + e], c[C_J + e]
        M2_, M3_, M4_ = c[C_M2 + e], c[C_M3 + e], c[C_M4 + e]
        c[C_LOW + e] = close_in(c[C_LOW + e], c[C_HIGH + e], g, v, push, jerk, M2_, M3_, M4_)


@kernel
def scatter(a, chosen, count, c):
    """Take the times found as the lanes' steps."""
    for e in range(count):
        a[STEP + chosen[e]] = c[C_LOW + e]


@kernel
def safe_steps(a, n, chosen, c):
    """A time that is safe from both stops, for every lane that is not certain to meet one."""
    approach_pass(a, n)
    count = list_lanes(a, SEEK, n, chosen)
    padded = gather(a, chosen, count, c)
    bracket_pass(c, padded)
    close_in_pass(c, padded)
    scatter(a, chosen, count, c)
    retreat_pass(a, n)
    count = list_lanes(a, SEEK, n, chosen)
    close_in_pass(c, gather(a, chosen, count, c))
    scatter(a, chosen, count, c)


@kernel
def step_pass(a, n):
    """What each lane does next."""
    for i in range(n):
        s, step, rest, ahead = a[S + i], a[STEP + i], a[REST + i], -a[SIDE + i]
        reach = a[M0 + i] * (1.0 + 1e-12)
        H = a[PERIOD + i] - a[T + i]
        met = rest < np.inf
        excluded = reach < a[UP + i] and -reach > a[DOWN + i]
        later = s + rest if met else s + step
        ends = excluded or (later >= H and not met)
        count = a[COUNT + i]
        count = count if excluded else count + 1.0
        stuck = not later > s + LEAST_STEP * H or count >= LONGEST_MARCH
        mode = LEFT if stuck else FLYING
        mode = ahead if met else mode
        mode = AT_SECTION if ends else mode
        a[MODE + i] = mode
        a[S + i] = H if ends else later
        a[COUNT + i] = count
        a[OWN + i] = 0.0


@kernel
def take_round(a, blocks, oscillates, n, chosen, c):
    """One round of the first n lanes, a multiple of WIDTH_OF_VECTORS; which blocks are underdamped in all of them."""
    restart_pass(a, n)
    for j in range(blocks):
        if oscillates[j]:
            oscillating_bounds_pass(a, fields_of(a, j), n)
        else:
            bounds_pass(a, fields_of(a, j), n)
    safe_steps(a, n, chosen, c)
    step_pass(a, n)
    forced_pass(a, n)
    for j in range(blocks):
        if oscillates[j]:
            oscillating_block_pass(a, fields_of(a, j), n)
        else:
            block_pass(a, fields_of(a, j), n)
    arrival_pass(a, n)


@inlined
def flow_frame(a, i, frames):
    """Take the tangent vectors of lane i, frames[i] (m, n, 2), through the flight that it has just ended."""
    for j in range(frames.shape[2]):
        b = (_HEAD + j * _BLOCK) * STRIDE + i
        f11, f12, f21, f22 = a[b + F11], a[b + F12], a[b + F21], a[b + F22]
        for k in range(frames.shape[1]):
            u0, u1 = frames[i, k, j, 0], frames[i, k, j, 1]
            frames[i, k, j, 0] = f11 * u0 + f12 * u1
            frames[i, k, j, 1] = f21 * u0 + f22 * u1


@inlined
def saltate_frame(blocks, r, restitution, ratio, frames, i):
    """Take the tangent vectors of lane i through an impact, as impact.saltation does; blocks[r]: see Batch."""
    for k in range(frames.shape[1]):
        dy, dv = 0.0, 0.0
        for j in range(frames.shape[2]):
            u0, u1 = frames[i, k, j, 0], frames[i, k, j, 1]
            dy += blocks[r, j, C0 // STRIDE] * u0 + blocks[r, j, C1 // STRIDE] * u1
            dv += blocks[r, j, D0 // STRIDE] * u0 + blocks[r, j, D1 // STRIDE] * u1
        along_k = -(1.0 + restitution) * (dv - ratio * dy)
        along_Ak = -(1.0 + restitution) * dy
        for j in range(frames.shape[2]):
            frames[i, k, j, 0] += along_k * blocks[r, j, K0 // STRIDE] + along_Ak * blocks[r, j, L0 // STRIDE]
            frames[i, k, j, 1] += along_k * blocks[r, j, K1 // STRIDE] + along_Ak * blocks[r, j, L1 // STRIDE]


class Bench(NamedTuple):
    """Where the frames of some lanes are made orthonormal: see frame.orthonormalise_pass; which lanes they are."""

    lam: Array
    rank: Array
    frames: Array
    norms: Array
    work: Array
    lanes: NDArray[np.uint32]


@kernel
def reset_together(a, count, blocks, tally, frames, growths, bench):
    """Make the frames of the ``count`` lanes orthonormal that bench.lanes begins with."""
    lam, rank, U, norms, work, lanes = bench
    m, n = frames.shape[1], frames.shape[2]
    for e in range(count):
        i = lanes[e]
        r = int(a[REQUEST + i])
        rank[e] = 2 * n - tally[r, LOST]
        for j in range(n):
            lam[j, e] = blocks[r, j, LAM // STRIDE]
            for k in range(m):
                U[k, j, 0, e], U[k, j, 1, e] = frames[i, k, j, 0], frames[i, k, j, 1]
    orthonormalise_pass(lam, rank, U, norms, work, -(-count // WIDTH_OF_VECTORS) * WIDTH_OF_VECTORS)
    for e in range(count):
        i = lanes[e]
        for k in range(m):
            growths[i, k] += math.log(norms[k, e])
            for j in range(n):
                frames[i, k, j, 0], frames[i, k, j, 1] = U[k, j, 0, e], U[k, j, 1, e]


@kernel
def fly_frame_far(a, i, blocks, tally, frames, growths):
    """As flow_frame, for a flight that spreads the frame far."""
    r = int(a[REQUEST + i])
    rank = 2 * frames.shape[2] - int(tally[r, LOST])
    no_triangle = np.zeros((0, 0))
    graded_flow(blocks[r], a[FLOWN + i], frames[i], growths[i], no_triangle, rank)
    orthonormalise(blocks[r, :, LAM // STRIDE], frames[i], growths[i], no_triangle, rank)
    a[WIDTH + i] = 0.0


@kernel
def move_frames(a, events, blocks, tally, frames, growths, bench):
    """Take the tangent vectors of these lanes through the flights and impacts that they end, as section.travel does."""
    lanes, count = bench.lanes, np.int64(0)  # no literal, or Numba compiles for it what is called with it
    for i in events:
        side = a[MODE + i]
        ratio = a[A + i] / (side * max(side * a[V + i], TINY))
        jump = impact_spread(ratio, a[UNIT + i], a[LOSS + i]) if abs(side) == 1.0 else 0.0
        a[RATIO + i], a[JUMP + i] = ratio, jump
        due = side != LEFT and needs_reset(a[WIDTH + i], a[FLOWN + i] * a[RATE + i] + jump)
        lanes[count] = i
        count += int(due)
        a[WIDTH + i] = 0.0 if due else a[WIDTH + i]
    reset_together(a, count, blocks, tally, frames, growths, bench)
    for i in events:
        spread = a[FLOWN + i] * a[RATE + i]
        if a[MODE + i] == LEFT:
            continue
        if a[WIDTH + i] + spread > MAX_SPREAD:
            fly_frame_far(a, i, blocks, tally, frames, growths)
        else:
            flow_frame(a, i, frames)
            a[WIDTH + i] += spread
        if a[MODE + i] == AT_SECTION:
            continue
        saltate_frame(blocks, int(a[REQUEST + i]), a[R + i], a[RATIO + i], frames, i)
        a[WIDTH + i] += a[JUMP + i]


@inlined
def copy_frame(V, growth, source, W, increase, target):
    """W[target] = V[source], with its growth (m,)."""
    for k in range(V.shape[1]):
        increase[target, k] = growth[source, k]
        for j in range(V.shape[2]):
            W[target, k, j, 0], W[target, k, j, 1] = V[source, k, j, 0], V[source, k, j, 1]


@kernel
def load(a, i, r, head, blocks, h, tally):
    """Put the state of request r into lane i, at its section."""
    for f in range(CONSTANTS):
        a[f * STRIDE + i] = head[r, f]
    for j in range(h.shape[1]):
        b = (_HEAD + j * _BLOCK) * STRIDE + i
        for f in range(BLOCK_CONSTANTS):
            a[b + f * STRIDE] = blocks[r, j, f]
        a[b + G0], a[b + G1] = h[r, j, 0], h[r, j, 1]
    a[T + i], a[PHASE + i], a[S + i], a[OWN + i], a[COUNT + i] = 0.0, a[TAU + i], 0.0, 0.0, 0.0
    a[MODE + i], a[FRESH + i], a[RENEW + i] = FLYING, 1.0, 1.0
    a[FORCED + i], a[DFORCED + i], a[DV + i], a[DY + i] = a[Y_TAU + i], a[V_TAU + i], 0.0, 0.0
    a[HITS_UP + i], a[HITS_DOWN + i], a[SLOWEST + i] = tally[r, UPPER], tally[r, LOWER], tally[r, MIN_SPEED]
    a[EVALS + i], a[COST + i], a[WIDTH + i] = tally[r, EVALUATIONS], 0.0, tally[r, SPREAD]
    a[REQUEST + i] = r


@inlined
def save(a, i, r, h, tally):
    """Write the section state of lane i back to its request."""
    for j in range(h.shape[1]):
        b = (_HEAD + j * _BLOCK) * STRIDE + i
        h[r, j, 0], h[r, j, 1] = a[b + G0], a[b + G1]
    tally[r, UPPER], tally[r, LOWER], tally[r, MIN_SPEED] = a[HITS_UP + i], a[HITS_DOWN + i], a[SLOWEST + i]
    tally[r, EVALUATIONS], tally[r, SPREAD] = a[EVALS + i], a[WIDTH + i]
    tally[r, WORK] -= a[COST + i]
    a[COST + i] = 0.0


@inlined
def keep_section(h, r, k, periods, sections):
    """Keep the state after period k if it is one of the last that are asked for."""
    row = k - (periods - sections.shape[1])
    if row >= 0:
        for j in range(h.shape[1]):
            sections[r, row, j, 0], sections[r, row, j, 1] = h[r, j, 0], h[r, j, 1]


@kernel
def move_lane(a, source, target):
    """Copy a lane."""
    for f in range(len(a) // STRIDE):
        a[f * STRIDE + target] = a[f * STRIDE + source]


@kernel
def park(a, i):
    """Give a lane that no cell needs a mass that nothing moves, for the passes to run over."""
    for f in range(len(a) // STRIDE):
        a[f * STRIDE + i] = 0.0
    a[UP + i], a[DOWN + i], a[PERIOD + i] = 1.0, -1.0, 1.0


@kernel
def run_lanes(batch, enough):
    """Advance every request of a batch by its periods, or to where ``section`` has to take over; see Batch.

    Once fewer than ``enough`` are under way each stops at its next section.
    """
    # Taken out once: a field of a record costs a reference count at every use.
    head, blocks, periods, done, left, h, V, growth, tally, levels, weighted, sections = batch
    N, n, m = h.shape[0], h.shape[1], V.shape[1]
    a = np.zeros((_HEAD + n * _BLOCK) * STRIDE)
    gathered, chosen = np.zeros(_GATHERED * STRIDE), np.zeros(LANES, dtype=np.uint32)
    frames, growths = np.zeros((LANES, m, n, 2)), np.zeros((LANES, m))
    bench = Bench(
        lam=np.zeros((n, STRIDE)),
        rank=np.zeros(STRIDE),
        frames=np.zeros((m, n, 2, STRIDE)),
        norms=np.zeros((m, STRIDE)),
        work=np.zeros((2, STRIDE)),
        lanes=np.zeros(LANES, dtype=np.uint32),
    )
    oscillates = np.ones(n, dtype=np.bool_)
    for r in range(N):
        for j in range(n):
            oscillates[j] &= blocks[r, j, D // STRIDE] > 0.0
    for i in range(LANES):
        park(a, i)
    active = queued = np.int64(0)  # no literal, or Numba compiles for it what is called with it
    while True:
        while active < LANES and queued < N:
            load(a, active, queued, head, blocks, h, tally)
            copy_frame(V, growth, queued, frames, growths, active)
            if m > 0:
                a[LENGTH + active] = log_length(blocks[queued, :, LAM // STRIDE], V[queued], growth[queued])
            if done[queued] == 0:
                weighted[queued, 0] = weighted[queued, 1] = 0.0
            active, queued = active + 1, queued + 1
        if active == 0:
            return
        ending = active < enough
        padded = -(-active // WIDTH_OF_VECTORS) * WIDTH_OF_VECTORS
        take_round(a, n, oscillates, padded, chosen, gathered)
        count = list_lanes(a, MODE, active, chosen)
        if m > 0:
            move_frames(a, chosen[:count], blocks, tally, frames, growths, bench)
        for e in range(count - 1, -1, -1):  # from the last one: what moves into a place that falls free is done with
            i = chosen[e]
            ended = a[MODE + i] == LEFT
            r = int(a[REQUEST + i])
            if ended:
                left[r] = True
            elif a[MODE + i] == AT_SECTION:
                k = done[r]
                if m > 0:
                    length = log_length(blocks[r, :, LAM // STRIDE], frames[i], growths[i])
                    add_growth(levels[r], weighted[r], length - a[LENGTH + i], k, periods[r])
                    a[LENGTH + i] = length
                    copy_frame(frames, growths, i, V, growth, r)
                save(a, i, r, h, tally)
                keep_section(h, r, k, periods[r], sections)
                done[r] = k + 1
                ended = ending or k + 1 == periods[r] or tally[r, WORK] < 0.0
            if ended:
                active -= 1
                move_lane(a, active, i)
                copy_frame(frames, growths, active, frames, growths, i)
                park(a, active)
