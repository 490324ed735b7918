"""The certified search for impacts in all lanes at once: the next time of each lane before which it passes no stop.

A lane is a slot of the loops that holds one cell. Each function is a loop over the first n lanes, and together they are
one step of the loop of crossing.next_crossing. ``a`` holds the fields of all lanes, see ``layout.py``. Work for few
lanes is gathered in ``c``, see GapFields.
"""

import numpy as np

from workers.kernel.crossing import GAP_ROUNDING, MIN_STEP, arrival, bracket, certain_crossing, close_in, curvature
from workers.kernel.jit import inline_always, inlined, kernel
from workers.kernel.lanes.layout import AT_SECTION, FLYING, GAP, LANE, LEFT, VECTOR_WIDTH

MAX_MARCH_STEPS = 64
"""Maximum number of steps of one flight; then the kernels of one cell take over the lane."""

LANE_TRIALS = 2
"""Number of trial lengths at the end of a safe step. Except at a graze, crossing.TRIALS trials cost more than they
save."""


@kernel
def approach_pass(a, n):
    """Set, for the stop toward which each mass moves, the time of certain contact; if it is unknown, a safe time.

    In a safe time the stop is certainly not reached. The distance of the stop and the limit of the safe time are set
    too. ``a`` are the fields of n lanes, which hold one cell each.
    """
    for i in range(n):
        upper, lower = a[LANE.upper + i], a[LANE.lower + i]
        ahead = 1.0 if a[LANE.v + i] > 0.0 else -1.0
        stop = upper if ahead > 0.0 else lower
        reach = a[LANE.bound0 + i] * (1.0 + 1e-12)
        room = a[LANE.period + i] - a[LANE.flight_start + i] - a[LANE.time + i]
        g = ahead * (stop - a[LANE.y + i])
        g = 0.0 if a[LANE.own_stop + i] == ahead else g
        v, push, jerk = ahead * a[LANE.v + i], ahead * a[LANE.a + i], ahead * a[LANE.jerk + i]
        M2, M3, M4 = a[LANE.bound2 + i], a[LANE.bound3 + i], a[LANE.bound4 + i]
        contact = certain_crossing(g, v, push, jerk, M3, M4, GAP_ROUNDING * (a[LANE.scale + i] + abs(stop)), room)
        contact = contact if reach - ahead * stop >= 0.0 else np.inf
        g = max(g, 0.0)
        a[LANE.side + i] = ahead
        a[LANE.gap + i] = g
        a[LANE.contact_time + i] = contact
        a[LANE.step + i] = room
        a[LANE.searched + i] = 1.0 if reach - ahead * stop >= 0.0 and contact == np.inf else 0.0
        a[LANE.safe_time + i], a[LANE.limit + i] = bracket(g, v, push, jerk, M2, M3, M4, room)


@kernel
def retreat_pass(a, n):
    """Set, for the stop from which each mass moves away, its distance and a safe time, in which it is not reached.

    Return how many lanes seek a longer safe time. ``a`` are the fields of n lanes, which hold one cell each.
    """
    count = 0
    for i in range(n):
        step, ahead, upper, lower = a[LANE.step + i], a[LANE.side + i], a[LANE.upper + i], a[LANE.lower + i]
        reach = a[LANE.bound0 + i] * (1.0 + 1e-12)
        behind = lower if ahead > 0.0 else upper
        g = ahead * (a[LANE.y + i] - behind)
        g = max(0.0 if a[LANE.own_stop + i] == -ahead else g, 0.0)
        v, push, jerk = -ahead * a[LANE.v + i], -ahead * a[LANE.a + i], -ahead * a[LANE.jerk + i]
        K = curvature(push, jerk, a[LANE.bound2 + i], a[LANE.bound3 + i], a[LANE.bound4 + i], step)
        L = min(step, arrival(g, v, K))
        a[LANE.side + i] = -ahead
        a[LANE.gap + i] = g
        a[LANE.safe_time + i] = L
        seek = reach + ahead * behind >= 0.0 and step > L and a[LANE.contact_time + i] == np.inf
        a[LANE.searched + i] = 1.0 if seek else 0.0
        count += int(seek)
    return count


@inlined
def padded_count(count):
    """Return the next multiple of VECTOR_WIDTH from ``count`` on: the number of cells over which loops run."""
    return -(-count // VECTOR_WIDTH) * VECTOR_WIDTH


@kernel
def list_lanes(a, field, n, lane_list):
    """Write the numbers of the lanes whose field is positive to ``lane_list``, and return how many they are.

    A lane holds one cell. ``field`` is the offset of the field in the array a of all lanes' fields; the first n lanes
    count. The loop is branch-free, since the processor would often mispredict a branch.
    """
    count = 0
    for i in range(n):
        lane_list[count] = i
        count += int(a[field + i] > 0.0)
    return count


@inline_always
def gather(a, lane_list, count, c):
    """Copy the gaps between cells and their stops to contiguous arrays in c, for the cells in lanes lane_list[:count].

    For the arrays see GapFields. Return the number of cells over which loops on c run.
    """
    for e in range(count):
        i = lane_list[e]
        side = a[LANE.side + i]
        c[GAP.gap + e] = a[LANE.gap + i]
        v, push, jerk = side * a[LANE.v + i], side * a[LANE.a + i], side * a[LANE.jerk + i]
        bound2, bound3, bound4 = a[LANE.bound2 + i], a[LANE.bound3 + i], a[LANE.bound4 + i]
        c[GAP.v + e], c[GAP.a + e], c[GAP.jerk + e] = v, push, jerk
        c[GAP.bound2 + e], c[GAP.bound3 + e], c[GAP.bound4 + e] = bound2, bound3, bound4
        c[GAP.low + e], c[GAP.high + e] = a[LANE.safe_time + i], a[LANE.step + i]
    return padded_count(count)


@kernel
def advance_pass(a, n):
    """Set the step of each of n lanes (one cell each) to the longest time found to be safe from the stop ahead.

    It lies between the bounds that ``approach_pass`` has set. Lanes that need no search keep their step.
    """
    for i in range(n):
        ahead, g, L, U = a[LANE.side + i], a[LANE.gap + i], a[LANE.safe_time + i], a[LANE.limit + i]
        v, push, jerk = ahead * a[LANE.v + i], ahead * a[LANE.a + i], ahead * a[LANE.jerk + i]
        h = close_in(L, U, g, v, push, jerk, a[LANE.bound2 + i], a[LANE.bound3 + i], a[LANE.bound4 + i], LANE_TRIALS)
        a[LANE.step + i] = h if a[LANE.searched + i] > 0.0 else a[LANE.step + i]


@kernel
def close_in_pass(c, n):
    """Set the longest time found for which each of n gathered gaps stays open, between its bounds; see GapFields."""
    for e in range(n):
        g, v, push, jerk = c[GAP.gap + e], c[GAP.v + e], c[GAP.a + e], c[GAP.jerk + e]
        M2_, M3_, M4_ = c[GAP.bound2 + e], c[GAP.bound3 + e], c[GAP.bound4 + e]
        c[GAP.low + e] = close_in(c[GAP.low + e], c[GAP.high + e], g, v, push, jerk, M2_, M3_, M4_, LANE_TRIALS)


@inline_always
def scatter(a, lane_list, count, c):
    """Set the steps, the times by which the lanes lane_list[:count] advance, to the safe times gathered in c.

    A lane holds one cell.
    """
    for e in range(count):
        a[LANE.step + lane_list[e]] = c[GAP.low + e]


@inline_always
def safe_steps(a, n, lane_list, c):
    """Set a step in which neither stop is reached, for each of n lanes (one cell each) without certain contact."""
    approach_pass(a, n)
    advance_pass(a, n)
    if retreat_pass(a, n) > 0:
        count = list_lanes(a, LANE.searched, n, lane_list)
        close_in_pass(c, gather(a, lane_list, count, c))
        scatter(a, lane_list, count, c)


@kernel
def step_pass(a, n):
    """Set the next event and time of each of n lanes (one cell each), from its step or its time of certain contact."""
    for i in range(n):
        s, step, contact, ahead = a[LANE.time + i], a[LANE.step + i], a[LANE.contact_time + i], -a[LANE.side + i]
        reach = a[LANE.bound0 + i] * (1.0 + 1e-12)
        H = a[LANE.period + i] - a[LANE.flight_start + i]
        met = contact < np.inf
        excluded = reach < a[LANE.upper + i] and -reach > a[LANE.lower + i]
        later = s + contact if met else s + step
        ends = excluded or (later >= H and not met)
        count = a[LANE.flight_evaluations + i]
        count = count if excluded else count + 1.0
        stuck = not later > s + MIN_STEP * H or count >= MAX_MARCH_STEPS
        mode = LEFT if stuck else FLYING
        mode = ahead if met else mode
        mode = AT_SECTION if ends else mode
        a[LANE.event + i] = mode
        a[LANE.time + i] = H if ends else later
        a[LANE.flight_evaluations + i] = count
        a[LANE.own_stop + i] = 0.0
