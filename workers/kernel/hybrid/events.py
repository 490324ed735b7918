"""Events of a machine, the jump of the state there, and the law of motion that follows.

A mode is one set of linear equations of motion. It ends where a signal of the state, its guard, reaches an end of its
range. The reset map is the jump of the state there.

An event at guard r, reached at the rate r', takes a tangent vector w to

    S w = R w + (f+ - R f-) (r . w) / r',

with f- and f+ the right-hand sides before and after the event and R the linear part of the reset map. ``signal_starts``
holds, for each signal, the end of its range at which it starts in the next mode. The modulus is the order of its first
nonzero derivative there, see crossing.next_crossing.
"""

import numpy as np

from workers.kernel.chatter import chatter_left
from workers.kernel.contact import REBOUND, load_at_rest, outcome
from workers.kernel.crossing import UNCLEAR
from workers.kernel.hybrid.state import (
    damping_along,
    guard_value,
    number_of,
    product,
    reset,
    right_hand_side,
    slip_of,
    slot_of,
)
from workers.kernel.jit import inlined, kernel
from workers.kernel.signal import evaluate
from workers.model.hybrid_modes import DETACHED, ON, OPEN, RESONANT, SIGNALS

MISSING, WRONG, ENDLESS, RESONATES = -1, -2, -3, -4
"""Values in place of a mode. MISSING: not built yet. WRONG: no valid mode. ENDLESS: an endless chain of changes.
RESONATES: undamped resonance."""

JUMPED = 1e-12
"""Minimum overshoot of a signal beyond its range, as a share of its terms, that counts as caused by a jump."""

CHANGES = 4
"""Maximum number of simultaneous changes of mode per element; a longer chain counts as endless."""


@inlined
def mode_of(table, states, slips, phase_index):
    """Return the slot and the number of the mode that belongs to given states of contacts and frictions.

    table        the modes built so far
    states (C,)  state of each contact
    slips (F,)   state of each friction: 0 while it sticks, else the sign of the slip
    phase_index  phase of the machine, a part of the forcing period with constants of its own

    A mode is one set of linear equations between two events. Its number encodes phase, contacts and slips, see
    ``hybrid_modes.ModeCode``. Its slot is its index in the table. The slot is negative if the mode cannot be used:
    MISSING if it is not built, WRONG or RESONATES if it is at fault.
    """
    number = number_of(table.elements, states, slips, phase_index)
    k = slot_of(table.codes, number)
    if k >= 0 and table.wrong[k] != 0:
        k = RESONATES if table.wrong[k] == RESONANT else WRONG
    return k, number


@inlined
def follow_jumps(table, states, slips, phase_index, z, harmonics, signal_starts):
    """Return the slot and the number of the mode in which a motion continues after its state has jumped.

    A mode is one set of linear equations; a signal at an end of its range ends it. A jump may leave signals beyond
    their ranges. Friction then begins to slip and contacts that are pushed engage, one at a time, until all signals are
    in range. The states (C,) of contacts, the slips (F,) of frictions and ``signal_starts`` (G,) change in place. The
    slot is the index of the mode in the table, or a negative code, see ``mode_of``.
    """
    number = np.int64(0)
    for _ in range(CHANGES * (len(states) + len(slips) + 1)):
        k, number = mode_of(table, states, slips, phase_index)
        if k < 0 or not follow_one(
            table.pieces, table.elements, k, phase_index, states, slips, z, harmonics, signal_starts
        ):
            return k, number
    return ENDLESS, number


@inlined
def follow_one(modes, elements, k, phase_index, states, slips, z, harmonics, signal_starts):
    """Find the first signal of mode k that is beyond its range, and change the state of its contact or friction.

    Return True if a signal is beyond its range. States (C,), slips (F,) and ``signal_starts`` (G,) change in place. A
    mode is one set of linear equations between two events.
    """
    C, ends = len(states), modes.ends[k]
    for g in range(SIGNALS * C + len(slips)):
        low, high = ends[g, 0], ends[g, 1]
        if signal_starts[g] != 0 or (low == -np.inf and high == np.inf):
            continue
        value, size = guard_value(modes, k, g, z, harmonics)
        above, below = value > high + JUMPED * size, value < low - JUMPED * size
        if not (above or below):
            continue
        side = 1 if above else -1
        c = g // SIGNALS
        if g >= SIGNALS * C:
            f = g - SIGNALS * C
            before = slips[f]
            slips[f] = -side if before == 0 else slip_of(elements, f, value)
            signal_starts[g] = -slips[f] if abs(slips[f]) == 1 and before * slips[f] <= 0 else 0
            return True
        if g % SIGNALS == 1:
            states[c] = other_push(states[c])
            return True
        if abs(states[c]) == ON and elements.soft[c] == 0.0:
            release(
                elements, g, c, phase_index, states, slips, signal_starts, np.int64(2)
            )  # after a jump the load is not zero
            return True
    return False


@inlined
def release(elements, g, c, phase_index, states, slips, signal_starts, order):
    """Release contact c from its rigid stop: its state becomes OPEN, in place.

    g              signal of the contact
    phase_index    phase of the machine, a part of the forcing period with constants of its own
    states, slips  states of contacts and frictions
    signal_starts  start of each signal, see the head of this module
    order          order of the first nonzero derivative of the gap coordinate after the release

    Friction that also held the mass slides. Its force jumps if the static level is above the kinetic one.
    """
    side = states[c]
    for e in range(len(slips)):
        if slips[e] == 0 and elements.along[e, c] != 0.0:
            slips[e] = -np.int64(np.sign(side * elements.along[e, c]))
            if elements.static_is_kinetic[phase_index, e, 1 if slips[e] > 0 else 0] == 0.0:
                order = 2
            signal_starts[SIGNALS * len(states) + e] = -slips[e] * (order - 1)
    states[c] = OPEN
    signal_starts[g] = side * order


@inlined
def go_on(signal_starts, g, side):
    """Let signal g begin the next mode at the end ``side`` of its range, with the rate that it has now; nothing jumps.

    A mode is a set of linear equations, and a signal at an end of its range ends it. The start is written to
    ``signal_starts``. If the signal also left the mode before it in no time, rounding hides its derivatives and the
    start is UNCLEAR. Otherwise a signal at rest on its end would change the mode for ever.
    """
    signal_starts[g] = side * (UNCLEAR if signal_starts[g] * side < 0 else 1)


@kernel
def friction_event(table, g, e, side, states, slips, phase_index, z, f, W, harmonics, signal_starts):
    """Carry a motion through an event of friction e: begin of a slip, end of a slide, or another segment of the law.

    g, side    the signal of the friction, and the end of its range that is reached
    z (2n,)    physical state, changed in place with the right-hand side f (2n,) and the tangent vectors W (m, 2n)

    Friction that stops sliding sticks if it can, else it slides the other way. Nothing jumps between segments. Return
    index and number of the mode with sticking friction, see ``mode_of``; a mode is a set of linear equations. A
    negative index means that the mode must be built before the event can be decided.
    """
    elements, sign = table.elements, 1 if slips[e] > 0 else -1
    if slips[e] != 0 and (slips[e] != sign or side == sign):  # the next or the previous segment of a law
        slips[e] += side
        go_on(signal_starts, g, -side)
        return np.int64(0), np.int64(0)
    if slips[e] == 0:
        slips[e] = -side
        signal_starts[g] = side * (
            2 if elements.static_is_kinetic[phase_index, e, 1 if side < 0 else 0] > 0.0 else 1
        )  # with static = kinetic the force is continuous
        return np.int64(0), np.int64(0)
    slips[e] = 0
    k, number = mode_of(table, states, slips, phase_index)
    if k < 0:
        return k, number
    n, row, brake = len(z) // 2, elements.friction_rows[e], elements.friction_kick[e]
    force, _ = guard_value(table.pieces, k, g, z, harmonics)
    if table.pieces.ends[k, g, 0] <= force <= table.pieces.ends[k, g, 1]:
        reset(z, n, row, brake, elements.belt[e], 1.0)
        reset(f, n, row, brake, 0.0, 1.0)
        for i in range(W.shape[0]):
            reset(W[i], n, row, brake, 0.0, 1.0)
        signal_starts[g] = (
            0  # the velocity may have turned at this instant: friction begins to stick here, not to slide back
        )
    else:
        slips[e] = -1 if force > 0.0 else 1
        signal_starts[g] = -slips[e]
    return k, number


@inlined
def other_push(state):
    """Return the opposite state of a soft contact that can only push: pushing becomes detached, and detached pushing.

    In segments of a law, odd numbers push, see hybrid_modes.ON.
    """
    return state + (1 if state > 0 else -1) * (1 if state % 2 != 0 else -1)


@inlined
def soft_event(g, c, side, states, signal_starts):
    """Change the state of soft contact c in ``states``, in place, at an event of the contact; nothing jumps.

    g, side        signal that is reached, and the end of its range
    signal_starts  start of each signal, see the head of this module

    The contact engages or opens, enters another segment of its law, or begins or ceases to push.
    """
    state = states[c]
    go_on(signal_starts, g, -side)
    if g % SIGNALS == 1:
        states[c] = other_push(state)
    elif state == OPEN:
        states[c] = side
    elif side * state < 0 and abs(state) <= DETACHED:
        states[c] = OPEN
    else:
        states[c] += 2 * side


@kernel
def impact(table, k, g, c, side, rate, h, states, slips, phase_index, z, f, W, phase, harmonics, signal_starts):
    """Carry a motion through an impact on a rigid contact.

    Return the outcome, and the remaining time if the impact is one of a chatter.

    k, g         index of the mode (set of linear equations) before the impact, and its signal that reached the stop
    c, side      the contact and the side of its stop
    rate         velocity of the gap coordinate y
    h (n, 2)     block state, (h, h') of each decoupled equation of the mode
    z (2n,)      physical state, changed in place with the right-hand side f (2n,) and the tangent vectors W (m, 2n)
    harmonics    (H, 2) of the force, see state.harmonics_at

    For the outcomes see contact.outcome. Friction that the impact jerks slides afterwards. The end of chatter is to
    leading order one impact with R = 0. After R = 0 a load that pulls away releases at once, see ``follow_one``.
    """
    elements, pieces, n = table.elements, table.pieces, len(z) // 2
    row, kick, R, stop = elements.row[c], elements.kick[c], elements.R[c], elements.stops[c, 1 if side > 0 else 0]
    cA2k, w = damping_along(pieces.acceleration[k], row, kick), R * abs(rate)
    load, jerk, scale = load_at_rest(side, rate, product(row, f, n), cA2k), 0.0, 0.0
    if load > 0.0 and 0.0 < R < 1.0:  # else the mass certainly rebounds, or R = 0 decides
        _, _, _, jerk, scale = evaluate(pieces.blocks[k, g], pieces.waves[k, g], table.omega, h, 0.0, phase, 0.0)
        scale += abs(stop) + abs(pieces.offset[k, g])
    following = outcome(load, rate, R, scale, 2.0 * np.pi / table.omega)
    reset(z, 0, row, kick, stop, 1.0)  # else rounding would add up over many impacts
    rests = following != REBOUND
    share = 1.0 if rests else 1.0 + R
    reset(z, n, row, kick, 0.0 if rests else -R * rate, 1.0)
    reset(f, n, row, kick, 0.0, share)
    for i in range(W.shape[0]):
        reset(W[i], n, row, kick, 0.0, share)
    remaining = 0.0
    if load > 0.0 and 0.0 < R < 1.0:
        away = load_away(table, c, side, load, states, slips, phase_index, z, harmonics)
        even = away == load
        remaining = chatter_left(load, side * jerk, cA2k, w, R) if even else uneven_chatter(away, load, w, R)
    if rests:
        states[c] = side
    else:
        signal_starts[g] = side
    for e in range(len(slips)):
        sliding = product(elements.friction_rows[e], z, n) - elements.belt[e]
        if product(elements.friction_rows[e], kick, 0) != 0.0 and sliding != 0.0:
            slips[e] = slip_of(elements, e, sliding)
            signal_starts[SIGNALS * len(states) + e] = 0
        if rests and elements.along[e, c] != 0.0 and elements.belt[e] == 0.0:
            slips[e] = 0
    return following, remaining


@kernel
def load_away(table, c, side, load, states, slips, phase_index, z, harmonics):
    """Return the acceleration toward stop ``side`` of contact c while the mass moves away from the stop in a hop.

    It differs from ``load``, that of the mass moving toward the stop, if friction turns at each hop.
    """
    n, kick, turned = len(z) // 2, table.elements.kick[c], slips.copy()
    for e in range(len(slips)):
        along = product(table.elements.friction_rows[e], kick, 0)
        if along != 0.0 and product(table.elements.friction_rows[e], z, n) - table.elements.belt[e] == 0.0:
            turned[e] = -np.int64(np.sign(side * along))
    if np.all(turned == slips):
        return load
    k, _ = mode_of(table, states, turned, phase_index)
    if k < 0:
        return load
    f = np.empty(2 * n)
    right_hand_side(table.pieces, k, z, harmonics, f)
    return side * product(table.elements.row[c], f, n)


@kernel
def uneven_chatter(away, back, w, R):
    """Return the duration of chatter after a rebound at speed w, if the accelerations on both halves of a hop differ.

    away, back  acceleration toward the stop while the mass moves away from the stop, and back to it
    R           coefficient of restitution

    Hops last w / away + w / sqrt(away back); the speed ratio of successive hops is R sqrt(back / away).
    """
    both = np.sqrt(away * back)
    return w * (1.0 / away + 1.0 / both) / (1.0 - R * both / away)


@kernel
def strikes_while_held(elements, c, states):
    """Return True if an impact on contact c also moves another contact that rests on a rigid stop.

    These are two impacts at once. ``states`` (C,) are the states of the contacts.
    """
    if elements.soft[c] > 0.0 or states[c] != OPEN:
        return False
    for other in range(len(states)):
        closed = states[other] != OPEN and elements.soft[other] == 0.0
        if closed and other != c and abs(product(elements.row[other], elements.kick[c], 0)) > JUMPED:
            return True
    return False
