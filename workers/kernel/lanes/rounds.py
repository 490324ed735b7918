"""One round of a batch: each lane takes its next certified step, or passes an impact or the end of a period.

A lane is a slot of vectorised loops that holds one cell. A certified step is a time in which no stop can be reached. A
lane's results do not depend, to the bit, on the number and content of other lanes or on its position.
"""

import math

from workers.kernel.contact import is_rebound, load_at_rest
from workers.kernel.crossing import REFRESH, TINY
from workers.kernel.jit import inline_always, kernel
from workers.kernel.lanes.layout import AT_SECTION, FLYING, LANE, LEFT, padded_blocks
from workers.kernel.lanes.search import safe_steps, step_pass
from workers.kernel.lanes.signal import (
    block_pass,
    fields_of,
    fields_of_harmonic,
    forced_pass,
    harmonic_pass,
    oscillating_block_pass,
    renewal_pass,
)

RENEWAL = float(REFRESH)

MAX_EVALUATIONS_PER_PERIOD = 2000.0
"""Maximum number of evaluations of a lane in one period. Then the kernels of one cell take over; they complete every
period."""


@kernel
def arrival_pass(a, n):
    """Process the event that each of n lanes has reached: jump and counts of an impact, start of the next flight.

    A lane holds one cell; ``a`` are the fields of all lanes. Return two numbers. The first is how many lanes stop at
    the end of a period or are left to the kernels of one cell. The second is how many need new bounds of the gap
    coordinate.
    """
    stopping, renewing = 0, 0
    for i in range(n):
        side, s, y, acceleration = a[LANE.event + i], a[LANE.time + i], a[LANE.y + i], a[LANE.a + i]
        up, down, r, cA2k = a[LANE.upper + i], a[LANE.lower + i], a[LANE.restitution + i], a[LANE.cA2k + i]
        hit = abs(side) == 1.0
        event = side != FLYING
        at_section = side == AT_SECTION
        v = side * max(side * a[LANE.v + i], TINY)
        before, phase, tau = a[LANE.flight_start + i], a[LANE.flight_phase + i], a[LANE.tau + i]
        t, period = before + s, a[LANE.period + i]
        load = load_at_rest(side, v, acceleration, cA2k)
        rebound = is_rebound(load, v, r, cA2k, a[LANE.scale + i] + abs(y), period - t, period)
        stop = up if side > 0.0 else down
        a[LANE.kick + i] = -(1.0 + r) * v if hit else 0.0
        a[LANE.shift + i] = stop - y if hit else 0.0
        a[LANE.impacts_upper + i] += 1.0 if side == 1.0 else 0.0
        a[LANE.impacts_lower + i] += 1.0 if side == -1.0 else 0.0
        speed = abs(v)
        slowest, fastest = a[LANE.slowest_impact + i], a[LANE.fastest_impact + i]
        a[LANE.slowest_impact + i] = min(slowest, speed) if hit else slowest
        a[LANE.fastest_impact + i] = max(fastest, speed) if hit else fastest
        a[LANE.impact_speeds + i] += speed if hit else 0.0
        a[LANE.impact_loss + i] += (1.0 - r * r) * (speed * speed) if hit else 0.0
        count = a[LANE.flight_evaluations + i]
        cost = max(1.0, count)
        spent = a[LANE.period_cost + i]
        spent = spent + cost if event else spent
        a[LANE.evaluations + i] += count if event else 0.0
        a[LANE.period_cost + i] = spent
        a[LANE.flight_evaluations + i] = 0.0 if event else count
        a[LANE.starts + i] = 1.0 if event else 0.0
        renews = event or count == RENEWAL * math.floor(count * (1.0 / RENEWAL))
        a[LANE.renews + i] = 1.0 if renews else 0.0
        renewing += int(renews)
        phase_hit = phase + a[LANE.omega + i] * s
        phase = phase_hit if hit else phase
        a[LANE.flight_phase + i] = tau if at_section else phase
        t = t if hit else before
        a[LANE.flight_start + i] = 0.0 if at_section else t
        a[LANE.own_stop + i] = side if hit else 0.0
        a[LANE.flown + i] = s
        a[LANE.time + i] = 0.0 if event else s
        y_force, v_force = a[LANE.forced + i], a[LANE.forced_rate + i]
        y_tau, v_tau = a[LANE.forced_at_section + i], a[LANE.forced_rate_at_section + i]
        a[LANE.forced + i] = y_tau if at_section else y_force
        a[LANE.forced_rate + i] = v_tau if at_section else v_force
        a_force, j_force = a[LANE.forced_second + i], a[LANE.forced_third + i]
        a_tau, j_tau = a[LANE.forced_second_at_section + i], a[LANE.forced_third_at_section + i]
        a[LANE.forced_second + i] = a_tau if at_section else a_force
        a[LANE.forced_third + i] = j_tau if at_section else j_force
        leaves = hit and (not rebound or spent > MAX_EVALUATIONS_PER_PERIOD)
        a[LANE.event + i] = LEFT if leaves else side
        stops = leaves or side >= AT_SECTION
        a[LANE.stops + i] = 1.0 if stops else 0.0
        stopping += int(stops)
    return stopping, renewing


@inline_always
def run_round(a, blocks, harmonics, oscillates, renews, n, lane_list, c):
    """Take the first n lanes (one cell each) through one round: the next step, or an event.

    Return the counts of ``arrival_pass``.

    n is a multiple of VECTOR_WIDTH.

    a             fields of all lanes
    blocks        number of blocks, the decoupled equations of motion
    harmonics     number of harmonics after the first
    oscillates    whether all blocks of all cells are underdamped
    renews        whether a lane may need new bounds of its signal
    lane_list, c  overwritten
    """
    if renews:
        renewal_pass(a, blocks, oscillates, n)
    safe_steps(a, n, lane_list, c)
    step_pass(a, n)
    forced_pass(a, n)
    for k in range(harmonics):
        harmonic_pass(a, fields_of_harmonic(a, padded_blocks(blocks), k), k + 2.0, n)
    for j in range(blocks):
        if oscillates:
            oscillating_block_pass(a, fields_of(a, j), n)
        else:
            block_pass(a, fields_of(a, j), n)
    return arrival_pass(a, n)
