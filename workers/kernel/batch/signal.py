"""The signal y(t) of every lane with its derivatives, and bounds of them for all later times: sums over blocks.

Each function is a loop over the first n lanes; a holds the fields of all lanes, q those of one block (see layout.py).
"""

from workers.kernel.batch.layout import BLOCK, BLOCK_SIZE, LANE, LANE_SIZE
from workers.kernel.flight import (
    amplitude_bounds,
    block_bounds,
    block_output,
    flow_entries,
    forced,
    forced_bounds,
    oscillating_flow,
)
from workers.kernel.fma import fma
from workers.kernel.jit import inlined, kernel


@kernel
def fields_of(a, j):
    """The fields of block j of all lanes."""
    return a[LANE_SIZE + j * BLOCK_SIZE : LANE_SIZE + (j + 1) * BLOCK_SIZE]


@kernel
def forced_pass(a, n):
    """Begin the sums of the signal and its derivatives at LANE.time with the forced part."""
    for i in range(n):
        w = a[LANE.omega + i]
        y, v = forced(fma(w, a[LANE.time + i], a[LANE.flight_phase + i]), w, a[LANE.sin_part + i], a[LANE.cos_part + i])
        a[LANE.forced + i] = y
        a[LANE.forced_rate + i] = v
        a[LANE.y + i] = y
        a[LANE.v + i] = v
        a[LANE.a + i] = -w * w * y
        a[LANE.jerk + i] = -w * w * v
        a[LANE.scale + i] = abs(y)


@inlined
def output_of(q, i, h0, h1):
    """flight.block_output of a state of one block of lane i."""
    eta, lam = q[BLOCK.eta + i], q[BLOCK.lam + i]
    c0, c1, cA0, cA1 = q[BLOCK.c0 + i], q[BLOCK.c1 + i], q[BLOCK.cA0 + i], q[BLOCK.cA1 + i]
    return block_output(h0, h1, eta, lam, c0, c1, cA0, cA1)


@inlined
def keep_flow(a, q, i, flow):
    """Take the state of one block of lane i to LANE.time by its flow and add its share of the signal."""
    f11, f12, f21, f22 = flow
    start0, start1 = q[BLOCK.start0 + i], q[BLOCK.start1 + i]
    h0, h1 = fma(f11, start0, f12 * start1), fma(f21, start0, f22 * start1)
    q0, q1, q2, q3 = output_of(q, i, h0, h1)
    q[BLOCK.f11 + i] = f11
    q[BLOCK.f12 + i] = f12
    q[BLOCK.f21 + i] = f21
    q[BLOCK.f22 + i] = f22
    q[BLOCK.h0 + i] = h0
    q[BLOCK.h1 + i] = h1
    a[LANE.y + i] += q0
    a[LANE.v + i] += q1
    a[LANE.a + i] += q2
    a[LANE.jerk + i] += q3
    a[LANE.scale + i] += abs(q0)


@kernel
def oscillating_block_pass(a, q, n):
    """Take one block to LANE.time and add its share of the signal; it is underdamped in every lane."""
    for i in range(n):
        eta, lam, w, inv_w = q[BLOCK.eta + i], q[BLOCK.lam + i], q[BLOCK.w + i], q[BLOCK.inv_w + i]
        keep_flow(a, q, i, oscillating_flow(a[LANE.time + i], eta, lam, w, inv_w))


@kernel
def block_pass(a, q, n):
    """Take one block to LANE.time and add its share of the signal, whatever its damping."""
    for i in range(n):
        eta, lam, d, w, inv_w = q[BLOCK.eta + i], q[BLOCK.lam + i], q[BLOCK.d + i], q[BLOCK.w + i], q[BLOCK.inv_w + i]
        keep_flow(a, q, i, flow_entries(a[LANE.time + i], eta, lam, d, w, inv_w, q[BLOCK.slow + i], q[BLOCK.fast + i]))


@kernel
def restart_pass(a, n):
    """Begin the sums of signal and bounds anew: the signal where a flight starts, the bounds there and now and then."""
    for i in range(n):
        w, y, v, Y_ = a[LANE.omega + i], a[LANE.forced + i], a[LANE.forced_rate + i], a[LANE.amplitude + i]
        fresh, renew = a[LANE.starts + i] > 0.0, a[LANE.renews + i] > 0.0
        y_, v_, a_, j_, scale = a[LANE.y + i], a[LANE.v + i], a[LANE.a + i], a[LANE.jerk + i], a[LANE.scale + i]
        m0, m2, m3, m4 = a[LANE.bound0 + i], a[LANE.bound2 + i], a[LANE.bound3 + i], a[LANE.bound4 + i]
        a[LANE.y + i] = y if fresh else y_
        a[LANE.v + i] = v if fresh else v_
        a[LANE.a + i] = -w * w * y if fresh else a_
        a[LANE.jerk + i] = -w * w * v if fresh else j_
        a[LANE.scale + i] = abs(y) if fresh else scale
        b0, b2, b3, b4 = forced_bounds(w, Y_)
        a[LANE.bound0 + i] = b0 if renew else m0
        a[LANE.bound2 + i] = b2 if renew else m2
        a[LANE.bound3 + i] = b3 if renew else m3
        a[LANE.bound4 + i] = b4 if renew else m4


@inlined
def share_at_start(a, q, i):
    """A block's share of the signal where bounds are wanted; where a flight starts there, after the impact's kick."""
    fresh = a[LANE.starts + i] > 0.0
    g0, g1, start0, start1 = q[BLOCK.h0 + i], q[BLOCK.h1 + i], q[BLOCK.start0 + i], q[BLOCK.start1 + i]
    dv, dy = a[LANE.kick + i], a[LANE.shift + i]
    kicked0 = fma(dy, q[BLOCK.Ak0 + i], fma(dv, q[BLOCK.k0 + i], g0))
    kicked1 = fma(dy, q[BLOCK.Ak1 + i], fma(dv, q[BLOCK.k1 + i], g1))
    h0, h1 = kicked0 if fresh else g0, kicked1 if fresh else g1
    q[BLOCK.start0 + i] = h0 if fresh else start0
    q[BLOCK.start1 + i] = h1 if fresh else start1
    q0, q1, q2, q3 = output_of(q, i, h0, h1)
    a[LANE.y + i] = a[LANE.y + i] + q0 if fresh else a[LANE.y + i]
    a[LANE.v + i] = a[LANE.v + i] + q1 if fresh else a[LANE.v + i]
    a[LANE.a + i] = a[LANE.a + i] + q2 if fresh else a[LANE.a + i]
    a[LANE.jerk + i] = a[LANE.jerk + i] + q3 if fresh else a[LANE.jerk + i]
    a[LANE.scale + i] = a[LANE.scale + i] + abs(q0) if fresh else a[LANE.scale + i]
    return q0, q1


@inlined
def amplitude_factors(q, i):
    """What flight.amplitude_bounds needs of one block of lane i."""
    return q[BLOCK.tilt + i], q[BLOCK.weight + i], q[BLOCK.grow2 + i], q[BLOCK.grow3 + i], q[BLOCK.grow4 + i]


@inlined
def add_bounds(a, i, bounds):
    """Add a block's bounds to the sums where they are computed anew."""
    renew = a[LANE.renews + i] > 0.0
    b0, b2, b3, b4 = bounds
    a[LANE.bound0 + i] = a[LANE.bound0 + i] + b0 if renew else a[LANE.bound0 + i]
    a[LANE.bound2 + i] = a[LANE.bound2 + i] + b2 if renew else a[LANE.bound2 + i]
    a[LANE.bound3 + i] = a[LANE.bound3 + i] + b3 if renew else a[LANE.bound3 + i]
    a[LANE.bound4 + i] = a[LANE.bound4 + i] + b4 if renew else a[LANE.bound4 + i]


@kernel
def oscillating_bounds_pass(a, q, n):
    """Add one block's share to the sums that restart_pass began; underdamped in every lane."""
    for i in range(n):
        q0, q1 = share_at_start(a, q, i)
        tilt, weight, grow2, grow3, grow4 = amplitude_factors(q, i)
        add_bounds(a, i, amplitude_bounds(q0, q1, tilt, weight, grow2, grow3, grow4))


@kernel
def bounds_pass(a, q, n):
    """Add one block's share to the sums that restart_pass began, whatever its damping."""
    for i in range(n):
        q0, q1 = share_at_start(a, q, i)
        eta, lam, d, inv_w = q[BLOCK.eta + i], q[BLOCK.lam + i], q[BLOCK.d + i], q[BLOCK.inv_w + i]
        slow, fast = q[BLOCK.slow + i], q[BLOCK.fast + i]
        tilt, weight, grow2, grow3, grow4 = amplitude_factors(q, i)
        add_bounds(a, i, block_bounds(q0, q1, eta, lam, d, inv_w, slow, fast, tilt, weight, grow2, grow3, grow4))
