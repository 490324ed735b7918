"""What happens where a guard of a hybrid machine falls to zero: its reset, and the mode that follows.

An event that a guard r reaches at its rate r' takes a tangent vector w to

    S w = R w + (f+ - R f-) (r . w) / r',

f the right-hand sides before and after it, R what it does to a state. ``begun`` holds which end of its range a signal
starts on in the next mode, and the order of its first derivative that is not zero there: see crossing.next_crossing.
"""

import numpy as np

from workers.kernel.contact import REST, impact_outcome, load_at_rest
from workers.kernel.hybrid.state import damping_along, guard_value, number_of, product, reset, slot_of
from workers.kernel.jit import kernel
from workers.kernel.signal import derivative_bounds
from workers.model.hybrid_modes import DETACHED, ON, OPEN, SIGNALS

MISSING, WRONG, ENDLESS = -1, -2, -3
"""In place of a mode: it is not built yet; it is none; the changes that lead to it have no end."""

JUMPED = 1e-12
"""Share of its terms by which a signal has to be beyond its range for a jump to have taken it there."""

CHANGES = 4
"""Changes of mode at one time for each element, after which they are taken to have no end."""


@kernel
def mode_of(table, states, slips, where):
    """Where the mode of these contacts and slips in this phase is, MISSING or WRONG; and its number."""
    number = number_of(states, slips, where)
    k = slot_of(table.codes, number)
    return (WRONG if k >= 0 and table.wrong[k] else k), number


@kernel
def follow_jumps(table, states, slips, where, z, phase, begun):
    """Let what a jump has taken beyond its guard follow: what sticks slips, what pushes engages. See mode_of."""
    number = np.int64(0)
    for _ in range(CHANGES * (len(states) + len(slips) + 1)):
        k, number = mode_of(table, states, slips, where)
        if k < 0 or not follow_one(table.pieces, table.elements, k, where, states, slips, z, phase, begun):
            return k, number
    return ENDLESS, number


@kernel
def follow_one(pieces, elements, k, where, states, slips, z, phase, begun):
    """Change what the first signal of mode k that is beyond its range asks for; whether there is one."""
    C = len(states)
    for g in range(SIGNALS * C + len(slips)):
        if begun[g] != 0:
            continue
        value, size = guard_value(pieces, k, g, z, phase)
        above = value > pieces.ends[k, g, 1] + JUMPED * size
        below = value < pieces.ends[k, g, 0] - JUMPED * size
        if not (above or below):
            continue
        side = 1 if above else -1
        c = g // SIGNALS
        if g >= SIGNALS * C:
            f = g - SIGNALS * C
            slips[f] = -side if slips[f] == 0 else -slips[f]
            begun[g] = -slips[f]
            return True
        if g % SIGNALS == 1:
            states[c] = (DETACHED if abs(states[c]) == ON else ON) * np.sign(states[c])
            return True
        if abs(states[c]) == ON and elements.soft[c] == 0.0:
            release(elements, g, c, where, states, slips, begun, 2)  # a jump: what pulls is not zero
            return True
    return False


@kernel
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
def friction_event(table, g, e, side, states, slips, where, z, f, W, phase, begun):
    """Friction e begins to slip, or slides no more: then it sticks where it can, else it slides the other way.

    Where the mode is in which it sticks and its number, as of mode_of: that has to be built to know.
    """
    elements = table.elements
    if slips[e] == 0:
        slips[e] = -side
        begun[g] = side * (2 if elements.even[where, e] > 0.0 else 1)  # with static = kinetic the force is continuous
        return np.int64(0), np.int64(0)
    slips[e] = 0
    k, number = mode_of(table, states, slips, where)
    if k < 0:
        return k, number
    n, row, brake = len(z) // 2, elements.slide[e], elements.brake[e]
    force, _ = guard_value(table.pieces, k, g, z, phase)
    if abs(force) <= table.pieces.ends[k, g, 1]:
        reset(z, n, row, brake, elements.belt[e], 1.0)
        reset(f, n, row, brake, 0.0, 1.0)
        for i in range(W.shape[0]):
            reset(W[i], n, row, brake, 0.0, 1.0)
    else:
        slips[e] = -1 if force > 0.0 else 1
        begun[g] = -slips[e]
    return k, number


@kernel
def soft_event(g, c, side, states, begun):
    """A soft contact engages or opens, or its force begins or ceases to push. Nothing jumps."""
    state = states[c]
    if g % SIGNALS == 1:
        states[c] = (DETACHED if abs(state) == ON else ON) * np.sign(state)
        begun[g] = -side
    elif state == OPEN:
        states[c] = side
        begun[g] = -side
    else:
        states[c] = OPEN
        begun[g] = np.sign(state)


@kernel
def impact(table, k, g, c, side, rate, remaining, h, states, slips, z, f, W, begun):
    """A rigid contact is reached at this rate of y, see contact.outcome; whether it comes to rest.

    Friction that it jerks slides from then on. Complete chatter is to leading order one impact with R = 0.
    """
    elements, n = table.elements, len(z) // 2
    row, kick, R, stop = elements.row[c], elements.kick[c], elements.R[c], elements.stops[c, 1 if side > 0 else 0]
    scale = abs(stop)
    for i in range(n):
        scale += abs(row[i] * z[i])
    M3 = derivative_bounds(table.pieces.blocks[k, g], table.pieces.numbers[k, g], h)[2]
    for e in range(len(slips)):
        if product(elements.slide[e], kick, 0) != 0.0:
            M3 = np.inf  # friction turns at each hop: chatter is followed until its hops are below rounding
    cA2k = damping_along(table.pieces.acceleration[k], row, kick)
    load = load_at_rest(side, rate, product(row, f, n), cA2k)
    scale = max(scale, abs(load) / table.omega**2)  # a stop may lie at 0
    following = impact_outcome(load, rate, R, cA2k, scale, remaining, M3)
    reset(z, 0, row, kick, stop, 1.0)  # or rounding would add up over many impacts
    rests = R == 0.0 or following == REST  # a load that pulls away lets go at once, see follow_one
    share = 1.0 if rests else 1.0 + R
    reset(z, n, row, kick, 0.0, share)
    reset(f, n, row, kick, 0.0, share)
    for i in range(W.shape[0]):
        reset(W[i], n, row, kick, 0.0, share)
    if rests:
        states[c] = side
    else:
        begun[g] = side
    for e in range(len(slips)):
        sliding = product(elements.slide[e], z, n) - elements.belt[e]
        if product(elements.slide[e], kick, 0) != 0.0 and sliding != 0.0:
            slips[e] = np.sign(sliding)
            begun[SIGNALS * len(states) + e] = 0
        if rests and elements.along[e, c] != 0.0 and elements.belt[e] == 0.0:
            slips[e] = 0
    return rests


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
