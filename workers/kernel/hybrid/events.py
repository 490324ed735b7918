"""What happens where a guard of a hybrid machine falls to zero: its reset, and the mode that follows.

An event that a guard r reaches at its rate r' takes a tangent vector w to

    S w = R w + (f+ - R f-) (r . w) / r',

f the right-hand sides before and after it, R what it does to a state. ``begun`` holds which end of its range a signal
starts on in the next mode, and the order of its first derivative that is not zero there: see crossing.next_crossing.
"""

import numpy as np

from workers.kernel.chatter import chatter_left
from workers.kernel.contact import REBOUND, load_at_rest, outcome
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
"""In place of a mode: it is not built yet; it is none; the changes that lead to it have no end; it resonates."""

JUMPED = 1e-12
"""Share of its terms by which a signal has to be beyond its range for a jump to have taken it there."""

CHANGES = 4
"""Changes of mode at one time for each element, after which they are taken to have no end."""


@inlined
def mode_of(table, states, slips, where):
    """Where the mode of these contacts and slips in this phase is, MISSING, WRONG or RESONATES; and its number."""
    number = number_of(table.elements, states, slips, where)
    k = slot_of(table.codes, number)
    if k >= 0 and table.wrong[k] != 0:
        k = RESONATES if table.wrong[k] == RESONANT else WRONG
    return k, number


@inlined
def follow_jumps(table, states, slips, where, z, turn, begun):
    """Let what a jump has taken beyond its guard follow: what sticks slips, what pushes engages. See mode_of."""
    number = np.int64(0)
    for _ in range(CHANGES * (len(states) + len(slips) + 1)):
        k, number = mode_of(table, states, slips, where)
        if k < 0 or not follow_one(table.pieces, table.elements, k, where, states, slips, z, turn, begun):
            return k, number
    return ENDLESS, number


@inlined
def follow_one(pieces, elements, k, where, states, slips, z, turn, begun):
    """Change what the first signal of mode k that is beyond its range asks for; whether there is one."""
    C = len(states)
    for g in range(SIGNALS * C + len(slips)):
        low, high = pieces.ends[k, g, 0], pieces.ends[k, g, 1]
        if begun[g] != 0 or (low == -np.inf and high == np.inf):
            continue
        value, size = guard_value(pieces, k, g, z, turn)
        above, below = value > high + JUMPED * size, value < low - JUMPED * size
        if not (above or below):
            continue
        side = 1 if above else -1
        c = g // SIGNALS
        if g >= SIGNALS * C:
            f = g - SIGNALS * C
            before = slips[f]
            slips[f] = -side if before == 0 else slip_of(elements, f, value)
            begun[g] = -slips[f] if abs(slips[f]) == 1 and before * slips[f] <= 0 else 0
            return True
        if g % SIGNALS == 1:
            states[c] = other_push(states[c])
            return True
        if abs(states[c]) == ON and elements.soft[c] == 0.0:
            release(elements, g, c, where, states, slips, begun, np.int64(2))  # a jump: what pulls is not zero
            return True
    return False


@inlined
def release(elements, g, c, where, states, slips, begun, order):
    """A rigid stop lets go; ``order`` is that of the first derivative of y that is not zero then.

    Friction that held the mass there too slides, and what pulls jumps where its static level is above the kinetic one.
    """
    side = states[c]
    for e in range(len(slips)):
        if slips[e] == 0 and elements.along[e, c] != 0.0:
            if elements.even[where, e] == 0.0:
                order = 2
            slips[e] = -np.int64(np.sign(side * elements.along[e, c]))
            begun[SIGNALS * len(states) + e] = -slips[e] * (order - 1)
    states[c] = OPEN
    begun[g] = side * order


@kernel
def friction_event(table, g, e, side, states, slips, where, z, f, W, turn, begun):
    """Friction e begins to slip, or slides no more: then it sticks where it can, else it slides the other way. Or it
    goes on in another segment of its law, in which nothing jumps.

    Where the mode is in which it sticks and its number, as of mode_of: that has to be built to know.
    """
    elements, sign = table.elements, 1 if slips[e] > 0 else -1
    if slips[e] != 0 and (slips[e] != sign or side == sign):  # of a law, the next segment or the one before
        slips[e] += side
        begun[g] = -side
        return np.int64(0), np.int64(0)
    if slips[e] == 0:
        slips[e] = -side
        begun[g] = side * (2 if elements.even[where, e] > 0.0 else 1)  # with static = kinetic the force is continuous
        return np.int64(0), np.int64(0)
    slips[e] = 0
    k, number = mode_of(table, states, slips, where)
    if k < 0:
        return k, number
    n, row, brake = len(z) // 2, elements.slide[e], elements.brake[e]
    force, _ = guard_value(table.pieces, k, g, z, turn)
    if abs(force) <= table.pieces.ends[k, g, 1]:
        reset(z, n, row, brake, elements.belt[e], 1.0)
        reset(f, n, row, brake, 0.0, 1.0)
        for i in range(W.shape[0]):
            reset(W[i], n, row, brake, 0.0, 1.0)
        begun[g] = 0  # it may have turned in this instant: what begins now is a stick, not the slide after the turn
    else:
        slips[e] = -1 if force > 0.0 else 1
        begun[g] = -slips[e]
    return k, number


@inlined
def other_push(state):
    """A soft contact that pushes detaches, and one that is detached pushes."""
    return state + (1 if state > 0 else -1) * (1 if state % 2 != 0 else -1)


@inlined
def soft_event(g, c, side, states, begun):
    """A soft contact engages or opens, its law has another segment, or it begins or ceases to push. Nothing jumps."""
    state = states[c]
    begun[g] = -side
    if g % SIGNALS == 1:
        states[c] = other_push(state)
    elif state == OPEN:
        states[c] = side
    elif side * state < 0 and abs(state) <= DETACHED:
        states[c] = OPEN
    else:
        states[c] += 2 * side


@kernel
def impact(table, k, g, c, side, rate, h, states, slips, where, z, f, W, phase, turn, begun):
    """A rigid contact is reached at this rate of y: what follows, see contact.outcome; what is left of a chatter.

    Friction that it jerks slides from then on. The end of chatter is to leading order one impact with R = 0; a load
    that pulls away from R = 0 lets go at once, see follow_one.
    """
    elements, pieces, n = table.elements, table.pieces, len(z) // 2
    row, kick, R, stop = elements.row[c], elements.kick[c], elements.R[c], elements.stops[c, 1 if side > 0 else 0]
    _, _, _, jerk, scale = evaluate(pieces.blocks[k, g], pieces.waves[k, g], table.omega, h, 0.0, phase, 0.0)
    scale += abs(stop) + abs(pieces.offset[k, g])
    cA2k, w = damping_along(pieces.acceleration[k], row, kick), R * abs(rate)
    load = load_at_rest(side, rate, product(row, f, n), cA2k)
    following = outcome(load, rate, R, scale, 2.0 * np.pi / table.omega)
    reset(z, 0, row, kick, stop, 1.0)  # or rounding would add up over many impacts
    rests = following != REBOUND
    share = 1.0 if rests else 1.0 + R
    reset(z, n, row, kick, 0.0 if rests else -R * rate, 1.0)
    reset(f, n, row, kick, 0.0, share)
    for i in range(W.shape[0]):
        reset(W[i], n, row, kick, 0.0, share)
    left = 0.0
    if load > 0.0 and 0.0 < R < 1.0:
        away = load_away(table, c, side, load, states, slips, where, z, turn)
        even = away == load
        left = chatter_left(load, side * jerk, cA2k, w, R) if even else uneven_chatter(away, load, w, R)
    if rests:
        states[c] = side
    else:
        begun[g] = side
    for e in range(len(slips)):
        sliding = product(elements.slide[e], z, n) - elements.belt[e]
        if product(elements.slide[e], kick, 0) != 0.0 and sliding != 0.0:
            slips[e] = slip_of(elements, e, sliding)
            begun[SIGNALS * len(states) + e] = 0
        if rests and elements.along[e, c] != 0.0 and elements.belt[e] == 0.0:
            slips[e] = 0
    return following, left


@kernel
def load_away(table, c, side, load, states, slips, where, z, turn):
    """The load on stop ``side`` while the mass moves away from it: other than ``load``, if friction turns at hops."""
    n, kick, turned = len(z) // 2, table.elements.kick[c], slips.copy()
    for e in range(len(slips)):
        along = product(table.elements.slide[e], kick, 0)
        if along != 0.0 and product(table.elements.slide[e], z, n) - table.elements.belt[e] == 0.0:
            turned[e] = -np.int64(np.sign(side * along))
    if np.all(turned == slips):
        return load
    k, _ = mode_of(table, states, turned, where)
    if k < 0:
        return load
    f = np.empty(2 * n)
    right_hand_side(table.pieces, k, z, turn, f)
    return side * product(table.elements.row[c], f, n)


@kernel
def uneven_chatter(away, back, w, R):
    """The time that chatter takes after a rebound at speed w, under these loads away from the stop and back to it.

    Hops last w / away + w / sqrt(away back), and each speed is R sqrt(back / away) times the last one.
    """
    both = np.sqrt(away * back)
    return w * (1.0 / away + 1.0 / both) / (1.0 - R * both / away)


@kernel
def strikes_while_held(elements, c, states):
    """Whether rigid contact c is struck and moves another one that is held: two impacts at once."""
    if elements.soft[c] > 0.0 or states[c] != OPEN:
        return False
    for other in range(len(states)):
        held = states[other] != OPEN and elements.soft[other] == 0.0
        if held and other != c and abs(product(elements.row[other], elements.kick[c], 0)) > JUMPED:
            return True
    return False
