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

from workers.flight import (
    REFRESH,
    ROUNDING,
    TINY,
    block_bounds,
    block_output,
    flow_entries,
    forced,
    forced_bounds,
    meets,
    safe_step,
)
from workers.frame import graded_flow, orthonormalise
from workers.impact import is_rebound, load_at_rest, saltation
from workers.jit import kernel
from workers.lyapunov import add_growth
from workers.oscillator import Oscillator
from workers.section import (
    EVALUATIONS,
    LOST,
    LOWER,
    MAX_SPREAD,
    MIN_SPEED,
    SPREAD,
    UPPER,
    WORK,
    impact_spread,
    spread_rate,
)

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
#   OMEGA...LAM_1    constants of the signal, stops, impact law and section; forced part there, spread rate, lam_1
#   T, PHASE, S      time since the section and phase at the flight's start, time in flight; FLOWN: of the last flight
#   MODE, OWN        what is reached at S; the stop that the flight starts on until its first step is taken
#   COUNT            evaluations of this flight
#   FRESH, RENEW     1 where a flight starts, 1 where the bounds are to be computed anew
#   FORCED...M4      the forced part, the signal with its derivatives and scale of rounding, bounds of its derivatives
#   DV, DY, RATIO    change of velocity and position at an impact, and its a / v
#   HITS_UP...COST   impacts per stop, slowest one, evaluations; evaluations of this period
#   WIDTH, WIDE      log-spread of the frame; 1 where this flight takes it too far for the passes
#   C_V, CA_V        c.V and cA.V of the tangent vector that is being carried through an impact
_HEAD = 47
(OMEGA, SIN_PART, COS_PART, AMPLITUDE, UP, DOWN, R, CA2K, PERIOD, TAU, Y_TAU, V_TAU, RATE, LAM_1,
 T, PHASE, S, FLOWN, MODE, OWN, COUNT, FRESH, RENEW,
 FORCED, DFORCED, Y, V, A, J, SCALE, M0, M2, M3, M4, DV, DY, RATIO,
 HITS_UP, HITS_DOWN, SLOWEST, EVALS, COST, REQUEST, WIDTH, WIDE, C_V, CA_V,
 ) = (k * STRIDE for k in range(_HEAD))  # fmt: skip
CONSTANTS = 14
"""Fields that the oscillator sets, the first ones."""

# Fields of a block of a lane: those of Block, c and cA (C, D), k and A k (K, L); its state at the flight's start (H)
# and at S (G), the flow between them (F).
_BLOCK = 24
(ETA, LAM, D, W, INV_W, SLOW, FAST, INV_LAM, C0, C1, D0, D1, K0, K1, L0, L1,
 H0, H1, G0, G1, F11, F12, F21, F22) = (k * STRIDE for k in range(_BLOCK))  # fmt: skip
BLOCK_CONSTANTS = 16


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
        osc.period, osc.tau, y, v, spread_rate(gap.block), gap.lam[0],
    ])  # fmt: skip
    rows = zip(gap.block, gap.row, gap.row1, osc.kick, osc.kick1, strict=True)
    return head, np.array([[x for part in row for x in part] for row in rows])


@kernel
def fields_of(a, j):
    """The fields of block j."""
    return a[(_HEAD + j * _BLOCK) * STRIDE : (_HEAD + (j + 1) * _BLOCK) * STRIDE]


@kernel
def vector_of(frames, index):
    """The two fields of one block of one tangent vector."""
    return frames[index * 2 * STRIDE : (index + 1) * 2 * STRIDE]


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


@kernel
def block_pass(a, q, n):
    """Flow one block (q: its fields) to the time S and add its share of the signal."""
    for i in range(n):
        eta, lam = q[ETA + i], q[LAM + i]
        f11, f12, f21, f22 = flow_entries(
            a[S + i], eta, lam, q[D + i], q[W + i], q[INV_W + i], q[SLOW + i], q[FAST + i]
        )
        h0 = f11 * q[H0 + i] + f12 * q[H1 + i]
        h1 = f21 * q[H0 + i] + f22 * q[H1 + i]
        q0, q1, q2, q3 = block_output(h0, h1, eta, lam, q[C0 + i], q[C1 + i], q[D0 + i], q[D1 + i])
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
        ratio = acceleration / v
        a[RATIO + i] = ratio
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
        before_flight = a[WIDTH + i]
        width = before_flight + s * a[RATE + i]
        jump = impact_spread(ratio, a[LAM_1 + i])
        a[WIDE + i] = 1.0 if event and width > MAX_SPREAD else 0.0
        width = width + jump if hit else width
        a[WIDTH + i] = width if event else before_flight
        a[MODE + i] = LEFT if hit and (not rebound or spent > LONGEST_PERIOD) else side


@kernel
def kick_pass(a, q, n):
    """The state of one block after what its lane has reached."""
    for i in range(n):
        event = a[FRESH + i] > 0.0
        dv, dy, h0, h1 = a[DV + i], a[DY + i], q[H0 + i], q[H1 + i]
        kicked0 = q[G0 + i] + dv * q[K0 + i] + dy * q[L0 + i]
        kicked1 = q[G1 + i] + dv * q[K1 + i] + dy * q[L1 + i]
        q[H0 + i] = kicked0 if event else h0
        q[H1 + i] = kicked1 if event else h1


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
        b0, _, b2, b3, b4 = forced_bounds(w, Y_)
        a[M0 + i] = b0 if renew else m0
        a[M2 + i] = b2 if renew else m2
        a[M3 + i] = b3 if renew else m3
        a[M4 + i] = b4 if renew else m4


@kernel
def bounds_pass(a, q, n):
    """Add one block's share to the sums that restart_pass began."""
    for i in range(n):
        fresh, renew = a[FRESH + i] > 0.0, a[RENEW + i] > 0.0
        eta, lam, h0, h1, g0, g1 = q[ETA + i], q[LAM + i], q[H0 + i], q[H1 + i], q[G0 + i], q[G1 + i]
        h0, h1 = h0 if fresh else g0, h1 if fresh else g1
        q0, q1, q2, q3 = block_output(h0, h1, eta, lam, q[C0 + i], q[C1 + i], q[D0 + i], q[D1 + i])
        a[Y + i] += q0 if fresh else 0.0
        a[V + i] += q1 if fresh else 0.0
        a[A + i] += q2 if fresh else 0.0
        a[J + i] += q3 if fresh else 0.0
        a[SCALE + i] += abs(q0) if fresh else 0.0
        b0, _, b2, b3, b4 = block_bounds(
            q0, q1, eta, lam, q[D + i], q[INV_W + i], q[SLOW + i], q[FAST + i], q[INV_LAM + i]
        )
        a[M0 + i] += b0 if renew else 0.0
        a[M2 + i] += b2 if renew else 0.0
        a[M3 + i] += b3 if renew else 0.0
        a[M4 + i] += b4 if renew else 0.0


@kernel
def step_pass(a, n):
    """The next time of each lane, certified or an arrival: one turn of the loop of flight.next_crossing."""
    for i in range(n):
        s, y = a[S + i], a[Y + i]
        m2, m3, m4 = a[M2 + i], a[M3 + i], a[M4 + i]
        reach = a[M0 + i] * (1.0 + 1e-12)
        upper, lower = a[UP + i], a[DOWN + i]
        excluded = reach < upper and -reach > lower
        H = a[PERIOD + i] - a[T + i]
        room = H - s
        own = a[OWN + i]
        ahead = 1.0 if a[V + i] > 0.0 else -1.0
        stop = upper if ahead > 0.0 else lower
        g = 0.0 if own == ahead else ahead * (stop - y)
        v, push, jerk = ahead * a[V + i], ahead * a[A + i], ahead * a[J + i]
        open_way = -ahead * stop + reach >= 0.0
        rest = meets(g, v, push, jerk, m3, m4, ROUNDING * (a[SCALE + i] + abs(stop)), room)
        met = open_way and rest < np.inf
        free = safe_step(max(g, 0.0), v, push, jerk, m2, m3, m4, room)
        step = free if open_way else room
        other = lower if ahead > 0.0 else upper
        g = 0.0 if own == -ahead else ahead * (y - other)
        open_way = ahead * other + reach >= 0.0
        free = safe_step(max(g, 0.0), -v, -push, -jerk, m2, m3, m4, step)
        step = free if open_way else step
        later = s + rest if met else s + step
        ends = excluded or (later >= H and not met)
        count = a[COUNT + i]
        count = count if excluded else count + 1.0
        stuck = not later > s or count >= LONGEST_MARCH
        mode = LEFT if stuck else FLYING
        mode = ahead if met else mode
        mode = AT_SECTION if ends else mode
        a[MODE + i] = mode
        a[S + i] = H if ends else later
        a[COUNT + i] = count
        a[OWN + i] = 0.0


@kernel
def flow_vector_pass(a, q, u, first, n):
    """Take one block of one tangent vector (u: its two fields) through the flight that a lane has just ended.

    Adds its share of c.V and cA.V, which begin with the ``first`` block.
    """
    for i in range(n):
        flows = a[FRESH + i] > 0.0 and a[WIDE + i] == 0.0
        u0, u1, cV, cAV = u[i], u[STRIDE + i], a[C_V + i], a[CA_V + i]
        w0 = q[F11 + i] * u0 + q[F12 + i] * u1
        w1 = q[F21 + i] * u0 + q[F22 + i] * u1
        w0, w1 = w0 if flows else u0, w1 if flows else u1
        u[i] = w0
        u[STRIDE + i] = w1
        a[C_V + i] = (0.0 if first else cV) + (q[C0 + i] * w0 + q[C1 + i] * w1)
        a[CA_V + i] = (0.0 if first else cAV) + (q[D0 + i] * w0 + q[D1 + i] * w1)


@kernel
def saltate_vector_pass(a, q, u, n):
    """Take one block of one tangent vector through the impact that a lane has just had: see impact.saltation."""
    for i in range(n):
        hit = a[OWN + i] != 0.0 and a[WIDE + i] == 0.0
        r1, cV, cAV, ratio = 1.0 + a[R + i], a[C_V + i], a[CA_V + i], a[RATIO + i]
        along_k = -r1 * (cAV - ratio * cV)
        along_Ak = -r1 * cV
        u0, u1 = u[i], u[STRIDE + i]
        w0 = u0 + (along_k * q[K0 + i] + along_Ak * q[L0 + i])
        w1 = u1 + (along_k * q[K1 + i] + along_Ak * q[L1 + i])
        u[i] = w0 if hit else u0
        u[STRIDE + i] = w1 if hit else u1


@kernel
def read_frame(frames, i, frame):
    """Tangent vectors (m, n, 2) of lane i."""
    for k in range(frame.shape[0]):
        for j in range(frame.shape[1]):
            at = (k * frame.shape[1] + j) * 2 * STRIDE + i
            frame[k, j, 0], frame[k, j, 1] = frames[at], frames[at + STRIDE]


@kernel
def write_frame(frames, i, frame):
    """Set the tangent vectors of lane i."""
    for k in range(frame.shape[0]):
        for j in range(frame.shape[1]):
            at = (k * frame.shape[1] + j) * 2 * STRIDE + i
            frames[at], frames[at + STRIDE] = frame[k, j, 0], frame[k, j, 1]


@kernel
def carry_wide_frame(a, i, block, frame, growth, no_triangle, rank):
    """What the vector passes leave out: a flight that spreads the frame too far, and a frame that is too far spread."""
    lam = block[:, 1]
    if a[WIDE + i] > 0.0:
        graded_flow(block, a[FLOWN + i], frame, growth, no_triangle, rank)
        orthonormalise(lam, frame, growth, no_triangle, rank)
        a[WIDTH + i] = 0.0
        if a[OWN + i] != 0.0:
            row, row1, kick, kick1 = block[:, 8:10], block[:, 10:12], block[:, 12:14], block[:, 14:16]
            saltation(row, row1, kick, kick1, a[R + i], frame, a[RATIO + i])
            a[WIDTH + i] = impact_spread(a[RATIO + i], lam[0])
    if a[OWN + i] != 0.0 and a[WIDTH + i] > MAX_SPREAD:
        orthonormalise(lam, frame, growth, no_triangle, rank)
        a[WIDTH + i] = 0.0


@kernel
def load(a, i, r, head, blocks, h, tally):
    """Put the state of request r into lane i, at its section."""
    for f in range(CONSTANTS):
        a[f * STRIDE + i] = head[r, f]
    for j in range(h.shape[1]):
        b = (_HEAD + j * _BLOCK) * STRIDE + i
        for f in range(BLOCK_CONSTANTS):
            a[b + f * STRIDE] = blocks[r, j, f]
        a[b + H0], a[b + H1] = h[r, j, 0], h[r, j, 1]
        a[b + G0], a[b + G1] = h[r, j, 0], h[r, j, 1]
    a[T + i], a[PHASE + i], a[S + i], a[OWN + i], a[COUNT + i] = 0.0, a[TAU + i], 0.0, 0.0, 0.0
    a[MODE + i], a[FRESH + i], a[RENEW + i] = FLYING, 1.0, 1.0
    a[FORCED + i], a[DFORCED + i] = a[Y_TAU + i], a[V_TAU + i]
    a[HITS_UP + i], a[HITS_DOWN + i], a[SLOWEST + i] = tally[r, UPPER], tally[r, LOWER], tally[r, MIN_SPEED]
    a[EVALS + i], a[COST + i], a[WIDTH + i], a[WIDE + i] = tally[r, EVALUATIONS], 0.0, tally[r, SPREAD], 0.0
    a[REQUEST + i] = r


@kernel
def save(a, i, r, h, tally):
    """Write the section state of lane i back to its request."""
    for j in range(h.shape[1]):
        b = (_HEAD + j * _BLOCK) * STRIDE + i
        h[r, j, 0], h[r, j, 1] = a[b + H0], a[b + H1]
    tally[r, UPPER], tally[r, LOWER], tally[r, MIN_SPEED] = a[HITS_UP + i], a[HITS_DOWN + i], a[SLOWEST + i]
    tally[r, EVALUATIONS], tally[r, SPREAD] = a[EVALS + i], a[WIDTH + i]
    tally[r, WORK] -= a[COST + i]
    a[COST + i] = 0.0


@kernel
def keep_section(h, r, k, periods, sections):
    """Keep the state after period k if it is one of the last that are asked for."""
    row = k - (periods - sections.shape[1])
    if row >= 0:
        for j in range(h.shape[1]):
            sections[r, row, j, 0], sections[r, row, j, 1] = h[r, j, 0], h[r, j, 1]


@kernel
def keep_frame(frame, growths, i, V, growth, r):
    """Write the tangent vectors of lane i and their growth back to request r."""
    for k in range(frame.shape[0]):
        growth[r, k] = growths[i, k]
        for j in range(frame.shape[1]):
            V[r, k, j, 0], V[r, k, j, 1] = frame[k, j, 0], frame[k, j, 1]


@kernel
def move_lane(a, source, target, frames, growths):
    """Copy a lane."""
    for fields in (a, frames):
        for f in range(len(fields) // STRIDE):
            fields[f * STRIDE + target] = fields[f * STRIDE + source]
    for k in range(growths.shape[1]):
        growths[target, k] = growths[source, k]


@kernel
def park(a, i, frames):
    """Give a lane that no cell needs a mass that nothing moves, for the passes to run over."""
    for fields in (a, frames):
        for f in range(len(fields) // STRIDE):
            fields[f * STRIDE + i] = 0.0
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
    frames, growths = np.zeros(m * n * 2 * STRIDE), np.zeros((LANES, m))
    frame, no_triangle = np.zeros((m, n, 2)), np.zeros((0, 0))
    for i in range(LANES):
        park(a, i, frames)
    active = queued = np.int64(0)  # no literal, or Numba compiles for it what is called with it
    while True:
        while active < LANES and queued < N:
            load(a, active, queued, head, blocks, h, tally)
            if m > 0:
                write_frame(frames, active, V[queued])
                for k in range(m):
                    growths[active, k] = growth[queued, k]
            if m < 2:  # one vector cannot spread
                a[RATE + active], a[LAM_1 + active] = 0.0, np.inf
            if done[queued] == 0:
                weighted[queued, 0] = weighted[queued, 1] = 0.0
            active, queued = active + 1, queued + 1
        if active == 0:
            return
        ending = active < enough
        padded = -(-active // WIDTH_OF_VECTORS) * WIDTH_OF_VECTORS
        restart_pass(a, padded)
        for j in range(n):
            bounds_pass(a, fields_of(a, j), padded)
        step_pass(a, padded)
        forced_pass(a, padded)
        for j in range(n):
            block_pass(a, fields_of(a, j), padded)
        arrival_pass(a, padded)
        for j in range(n):
            kick_pass(a, fields_of(a, j), padded)
        for k in range(m):
            for j in range(n):
                flow_vector_pass(a, fields_of(a, j), vector_of(frames, k * n + j), j == 0, padded)
            for j in range(n):
                saltate_vector_pass(a, fields_of(a, j), vector_of(frames, k * n + j), padded)
        for i in range(active - 1, -1, -1):  # from the last one: what moves into a place that falls free is done with
            ended = a[MODE + i] == LEFT
            at_section = a[MODE + i] == AT_SECTION
            r = int(a[REQUEST + i])
            if ended:
                left[r] = True
            elif a[WIDE + i] > 0.0 or a[WIDTH + i] > MAX_SPREAD:
                read_frame(frames, i, frame)
                carry_wide_frame(a, i, blocks[r], frame, growths[i], no_triangle, 2 * n - int(tally[r, LOST]))
                write_frame(frames, i, frame)
            if at_section:
                k = done[r]
                if m > 0:
                    read_frame(frames, i, frame)
                    orthonormalise(blocks[r, :, 1], frame, growths[i], no_triangle, 2 * n - int(tally[r, LOST]))
                    write_frame(frames, i, frame)
                    a[WIDTH + i] = 0.0
                    add_growth(levels[r], weighted[r], growths[i, 0] - growth[r, 0], k, periods[r])
                    keep_frame(frame, growths, i, V, growth, r)
                save(a, i, r, h, tally)
                keep_section(h, r, k, periods[r], sections)
                done[r] = k + 1
                ended = ending or k + 1 == periods[r] or tally[r, WORK] < 0.0
            if ended:
                active -= 1
                move_lane(a, active, i, frames, growths)
                park(a, active, frames)
