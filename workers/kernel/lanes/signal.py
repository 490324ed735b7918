"""The gap coordinate y(t) of every lane with its derivatives, and bounds of them for all later times.

A lane is a slot of vectorised loops that holds one cell. Each function is a loop over the first n lanes. y is a sum
over the harmonics of the force and over blocks, the decoupled equations of motion. ``a`` holds the fields of all lanes,
``q`` those of one block, see ``layout.py``.
"""

from workers.kernel.flow import fall, flow_entries, oscillating_flow
from workers.kernel.fma import fma
from workers.kernel.jit import inline_always, inlined, kernel
from workers.kernel.lanes.layout import BLOCK, BLOCK_SIZE, HARMONIC, HARMONIC_SIZE, LANE, LANE_SIZE
from workers.kernel.signal import amplitude_bounds, block_bounds, block_output, forced, loaded_output


@kernel
def fields_of(a, j):
    """Return the part of the array a, the fields of all cells, that belongs to block j, a decoupled equation."""
    return a[LANE_SIZE + j * BLOCK_SIZE : LANE_SIZE + (j + 1) * BLOCK_SIZE]


@kernel
def fields_of_harmonic(a, blocks, k):
    """Return the part of the array a, the fields of all cells, that belongs to harmonic k + 2 of the force.

    It lies behind the fields of all ``blocks``, the number of decoupled equations.
    """
    first = LANE_SIZE + blocks * BLOCK_SIZE
    return a[first + k * HARMONIC_SIZE : first + (k + 1) * HARMONIC_SIZE]


@kernel
def forced_pass(a, n):
    """Set the gap coordinate of each of n cells, with its derivatives, to the part of the force's first harmonic.

    The time is LANE.time. Contributions of other harmonics and of blocks, the decoupled equations, are added
    afterwards.
    """
    for i in range(n):
        w = a[LANE.omega + i]
        phase = fma(w, a[LANE.time + i], a[LANE.flight_phase + i])
        y, v, second, third = forced(phase, w, a[LANE.sin_part + i], a[LANE.cos_part + i])
        a[LANE.forced + i] = y
        a[LANE.forced_rate + i] = v
        a[LANE.forced_second + i] = second
        a[LANE.forced_third + i] = third
        a[LANE.y + i] = y
        a[LANE.v + i] = v
        a[LANE.a + i] = second
        a[LANE.jerk + i] = third
        a[LANE.scale + i] = abs(y)


@inlined
def absent(q, n):
    """Return True if none of the first n cells has this harmonic of the force; ``q`` are the fields of the harmonic.

    A force lacks most orders below its highest.
    """
    for i in range(n):  # noqa: SIM110 - a kernel has no generators
        if q[HARMONIC.sin_part + i] != 0.0 or q[HARMONIC.cos_part + i] != 0.0:
            return False
    return True


@kernel
def harmonic_pass(a, q, order, n):
    """Add the contribution of a harmonic of the force, of this order, to the gap coordinate of each of n cells.

    ``q`` are the fields of the harmonic. Derivatives are included.
    """
    if absent(q, n):
        return
    for i in range(n):
        w = order * a[LANE.omega + i]
        phase = order * fma(a[LANE.omega + i], a[LANE.time + i], a[LANE.flight_phase + i])
        y, v, second, third = forced(phase, w, q[HARMONIC.sin_part + i], q[HARMONIC.cos_part + i])
        a[LANE.forced + i] += y
        a[LANE.forced_rate + i] += v
        a[LANE.forced_second + i] += second
        a[LANE.forced_third + i] += third
        a[LANE.y + i] += y
        a[LANE.v + i] += v
        a[LANE.a + i] += second
        a[LANE.jerk + i] += third
        a[LANE.scale + i] += abs(y)


@inlined
def output_of(q, i, h0, h1):
    """Return the contribution of a block in the state (h0, h1) to the gap coordinate in lane i, with three derivatives.

    A lane holds one cell. A block is a decoupled equation of motion, with fields q. See signal.block_output.
    """
    eta, lam = q[BLOCK.eta + i], q[BLOCK.lam + i]
    c0, c1, cA0, cA1 = q[BLOCK.c0 + i], q[BLOCK.c1 + i], q[BLOCK.cA0 + i], q[BLOCK.cA1 + i]
    return block_output(h0, h1, eta, lam, c0, c1, cA0, cA1)


@inlined
def loaded_output_of(q, i, h0, h1):
    """Return ``output_of`` for a block that may bear a load, see signal.loaded_output.

    It is the contribution of a block, a decoupled equation of motion, to the gap coordinate.
    """
    eta, lam, load = q[BLOCK.eta + i], q[BLOCK.lam + i], q[BLOCK.load + i]
    c0, c1, cA0, cA1 = q[BLOCK.c0 + i], q[BLOCK.c1 + i], q[BLOCK.cA0 + i], q[BLOCK.cA1 + i]
    return loaded_output(h0, h1, eta, lam, c0, c1, cA0, cA1, load)


@inlined
def state_after(q, i, flow):
    """Return the state of one block, a decoupled equation, in lane i after the flow since the start of the flight.

    A lane holds one cell.

    flow  four numbers of the flow's matrix, see flow.flow_entries; they are stored
    """
    f11, f12, f21, f22 = flow
    q[BLOCK.f11 + i] = f11
    q[BLOCK.f12 + i] = f12
    q[BLOCK.f21 + i] = f21
    q[BLOCK.f22 + i] = f22
    start0, start1 = q[BLOCK.start0 + i], q[BLOCK.start1 + i]
    return fma(f11, start0, f12 * start1), fma(f21, start0, f22 * start1)


@inlined
def add_share(a, q, i, h0, h1, share):
    """Store the state (h0, h1) of a block, and add its contribution ``share`` to the gap coordinate in lane i.

    A lane holds one cell. A block is a decoupled equation of motion. ``share`` has the value and three derivatives.
    """
    q0, q1, q2, q3 = share
    q[BLOCK.h0 + i] = h0
    q[BLOCK.h1 + i] = h1
    a[LANE.y + i] += q0
    a[LANE.v + i] += q1
    a[LANE.a + i] += q2
    a[LANE.jerk + i] += q3
    a[LANE.scale + i] += abs(q0)


@kernel
def oscillating_block_pass(a, q, n):
    """Do ``block_pass`` for a block that is underdamped in every cell and bears no load.

    A block is a decoupled equation of motion.
    """
    for i in range(n):
        eta, lam, w, inv_w = q[BLOCK.eta + i], q[BLOCK.lam + i], q[BLOCK.w + i], q[BLOCK.inv_w + i]
        h0, h1 = state_after(q, i, oscillating_flow(a[LANE.time + i], eta, lam, w, inv_w))
        add_share(a, q, i, h0, h1, output_of(q, i, h0, h1))


@kernel
def block_pass(a, q, n):
    """Advance one block, a decoupled equation of motion, to LANE.time in each of n cells, and add it to y.

    y is the gap coordinate, with its derivatives. Any damping and load are allowed.
    """
    for i in range(n):
        s, load = a[LANE.time + i], q[BLOCK.load + i]
        eta, lam, d, w, inv_w = q[BLOCK.eta + i], q[BLOCK.lam + i], q[BLOCK.d + i], q[BLOCK.w + i], q[BLOCK.inv_w + i]
        flow = flow_entries(s, eta, lam, d, w, inv_w, q[BLOCK.slow + i], q[BLOCK.fast + i])
        h0, h1 = state_after(q, i, flow)
        h0, h1 = fma(load, fall(s, eta), h0), fma(load, flow[1], h1)
        add_share(a, q, i, h0, h1, loaded_output_of(q, i, h0, h1))


@kernel
def restart_pass(a, n):
    """Reset the sums that make up the gap coordinate and its bounds, in each of n cells where they are computed anew.

    The gap coordinate is reset at the start of a flight, and begins with the forced part. Its bounds are reset at
    renewals as well, and begin with those of the forced part. Other cells keep their values.
    """
    for i in range(n):
        y, v, second, third = (
            a[LANE.forced + i],
            a[LANE.forced_rate + i],
            a[LANE.forced_second + i],
            a[LANE.forced_third + i],
        )
        fresh, renew = a[LANE.starts + i] > 0.0, a[LANE.renews + i] > 0.0
        y_, v_, a_, j_, scale = a[LANE.y + i], a[LANE.v + i], a[LANE.a + i], a[LANE.jerk + i], a[LANE.scale + i]
        m0, m2, m3, m4 = a[LANE.bound0 + i], a[LANE.bound2 + i], a[LANE.bound3 + i], a[LANE.bound4 + i]
        a[LANE.y + i] = y if fresh else y_
        a[LANE.v + i] = v if fresh else v_
        a[LANE.a + i] = second if fresh else a_
        a[LANE.jerk + i] = third if fresh else j_
        a[LANE.scale + i] = abs(y) if fresh else scale
        b0, b2, b3, b4 = a[LANE.amplitude + i], a[LANE.swing2 + i], a[LANE.swing3 + i], a[LANE.swing4 + i]
        a[LANE.bound0 + i] = b0 if renew else m0
        a[LANE.bound2 + i] = b2 if renew else m2
        a[LANE.bound3 + i] = b3 if renew else m3
        a[LANE.bound4 + i] = b4 if renew else m4


@inlined
def state_at_start(a, q, i):
    """Return the state of a block in lane i from which new bounds follow: its state now, after the kick of an impact.

    A lane holds one cell. A block is a decoupled equation of motion. An impact has just kicked it if a flight starts.
    The state at the start of the flight is then stored.
    """
    fresh = a[LANE.starts + i] > 0.0
    g0, g1, start0, start1 = q[BLOCK.h0 + i], q[BLOCK.h1 + i], q[BLOCK.start0 + i], q[BLOCK.start1 + i]
    dv, dy = a[LANE.kick + i], a[LANE.shift + i]
    kicked0 = fma(dy, q[BLOCK.Ak0 + i], fma(dv, q[BLOCK.k0 + i], g0))
    kicked1 = fma(dy, q[BLOCK.Ak1 + i], fma(dv, q[BLOCK.k1 + i], g1))
    h0, h1 = kicked0 if fresh else g0, kicked1 if fresh else g1
    q[BLOCK.start0 + i] = h0 if fresh else start0
    q[BLOCK.start1 + i] = h1 if fresh else start1
    return h0, h1


@inlined
def share_at_start(a, i, share):
    """Add a block's contribution ``share`` to the gap coordinate in lane i, if a flight starts there.

    A lane holds one cell. A block is a decoupled equation of motion. ``share`` has the value and three derivatives.
    """
    fresh = a[LANE.starts + i] > 0.0
    q0, q1, q2, q3 = share
    a[LANE.y + i] = a[LANE.y + i] + q0 if fresh else a[LANE.y + i]
    a[LANE.v + i] = a[LANE.v + i] + q1 if fresh else a[LANE.v + i]
    a[LANE.a + i] = a[LANE.a + i] + q2 if fresh else a[LANE.a + i]
    a[LANE.jerk + i] = a[LANE.jerk + i] + q3 if fresh else a[LANE.jerk + i]
    a[LANE.scale + i] = a[LANE.scale + i] + abs(q0) if fresh else a[LANE.scale + i]


@inlined
def amplitude_factors(q, i):
    """Return the constants of one block, a decoupled equation with fields q, that signal.amplitude_bounds needs."""
    return q[BLOCK.tilt + i], q[BLOCK.weight + i], q[BLOCK.grow2 + i], q[BLOCK.grow3 + i], q[BLOCK.grow4 + i]


@inlined
def add_bounds(a, i, bounds):
    """Add the bounds of a block, a decoupled equation, to those of the gap coordinate in lane i.

    A lane holds one cell. Nothing is added in lanes whose bounds are not renewed.
    """
    renew = a[LANE.renews + i] > 0.0
    b0, b2, b3, b4 = bounds
    a[LANE.bound0 + i] = a[LANE.bound0 + i] + b0 if renew else a[LANE.bound0 + i]
    a[LANE.bound2 + i] = a[LANE.bound2 + i] + b2 if renew else a[LANE.bound2 + i]
    a[LANE.bound3 + i] = a[LANE.bound3 + i] + b3 if renew else a[LANE.bound3 + i]
    a[LANE.bound4 + i] = a[LANE.bound4 + i] + b4 if renew else a[LANE.bound4 + i]


@kernel
def oscillating_bounds_pass(a, q, n):
    """Do ``bounds_pass`` for a block, a decoupled equation of motion, that is underdamped in every cell."""
    for i in range(n):
        h0, h1 = state_at_start(a, q, i)
        share = output_of(q, i, h0, h1)
        share_at_start(a, i, share)
        tilt, weight, grow2, grow3, grow4 = amplitude_factors(q, i)
        add_bounds(a, i, amplitude_bounds(share[0], share[1], tilt, weight, grow2, grow3, grow4))


@kernel
def bounds_pass(a, q, n):
    """Add the contribution of one block, a decoupled equation of motion, to the sums that ``restart_pass`` has reset.

    The sums are the gap coordinate at the start of a flight, and its bounds, in each of n cells.
    """
    for i in range(n):
        h0, h1 = state_at_start(a, q, i)
        share = loaded_output_of(q, i, h0, h1)
        share_at_start(a, i, share)
        q0, q1, pull = share[0], share[1], q[BLOCK.c0 + i] * q[BLOCK.load + i]
        eta, lam, d, inv_w = q[BLOCK.eta + i], q[BLOCK.lam + i], q[BLOCK.d + i], q[BLOCK.inv_w + i]
        slow, fast = q[BLOCK.slow + i], q[BLOCK.fast + i]
        tilt, weight, grow2, grow3, grow4 = amplitude_factors(q, i)
        add_bounds(a, i, block_bounds(q0, q1, pull, eta, lam, d, inv_w, slow, fast, tilt, weight, grow2, grow3, grow4))


@inline_always
def renewal_pass(a, blocks, oscillates, n):
    """Compute the gap coordinate anew at the start of a flight, and its bounds there and at renewals, in n cells.

    a           fields of all cells
    blocks      number of blocks, the decoupled equations of motion
    oscillates  whether all are underdamped in all cells
    """
    restart_pass(a, n)
    for j in range(blocks):
        if oscillates:
            oscillating_bounds_pass(a, fields_of(a, j), n)
        else:
            bounds_pass(a, fields_of(a, j), n)
