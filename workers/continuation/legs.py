"""One turn of an orbit over its legs and events, with its tangents, for single shooting.

A leg is the motion in one mode, a set of linear equations; it ends at an event or at a change of phase. A turn begins
just before its first event. States are physical, z = (x, v), between legs, and those of decoupled equations within a
leg. N is the number of machines, K of modes and L of legs.
"""

import math

import numpy as np

from workers.kernel.by_reference import by_reference, row_in
from workers.kernel.flow import flow_with_tangent
from workers.kernel.hybrid.motion import first_event
from workers.kernel.hybrid.state import (
    enter,
    guard_rate,
    guard_value,
    harmonics_at,
    leave,
    product,
    reset,
    right_hand_side,
)
from workers.kernel.jit import kernel
from workers.kernel.linalg import copy_into
from workers.kernel.motion import NOTHING_COUNTED, RUNNING, STATUS, WORK, WORK_OF_A_TRIAL
from workers.model.hybrid_modes import SIGNALS

MODE, EVENT, SIGNAL, END, ACT, PLAN = range(6)
"""Columns of a leg (motion between two events) in the table of a turn's legs, the plan. MODE: index of its mode, the
linear equations. EVENT: the event at its end, NO_EVENT if the phase changes or the turn ends. SIGNAL: the number
computed from the state that reaches an end of its range there. END: which end, 0 for the lower one. ACT: act of the
event on the velocity. PLAN: number of columns."""

NO_EVENT = -1

AT_ONCE = 4.0 * float(np.finfo(np.float64).eps)
"""Rounding of times, as a share of them: turns are added to times and subtracted again."""

NOTHING, REBOUNDS, RESTS, SLOWS = range(4)
"""Acts of an event on the velocity: none, a rigid contact rebounds, a rigid contact comes to rest, friction begins to
stick."""


@kernel
def fly_leg(modes, k, s, before, after, z, W, h, V):
    """Advance a state z (2n,) and tangents W (m, 2n) by the time s in mode k, in place.

    A mode is a set of linear equations of motion. ``before`` and ``after`` are the harmonics of the force at both ends,
    see hybrid.state.harmonics_at; h and V are scratch arrays.
    """
    if s != 0.0:
        enter(modes, k, z, W, before, h, V)
        flow_with_tangent(modes.blocks[k, 0], s, h, V)
        leave(modes, k, h, V, after, z, W)


@kernel
def act_on(elements, r, act, signal, z, W):
    """Apply the jump of the velocity at an event to a state z (2n,) and to tangents W (m, 2n), in place.

    elements  contacts and friction of the machines
    r         row of the machine
    act       what happens to the velocity: NOTHING, REBOUNDS, RESTS or SLOWS
    signal    index of the signal, a number computed from the state, whose event it is: it tells the contact or friction
    """
    n = elements.row.shape[2]
    if act in (REBOUNDS, RESTS):
        c = signal // SIGNALS
        row, kick, share = elements.row[r, c], elements.kick[r, c], 1.0 if act == RESTS else 1.0 + elements.R[r, c]
        reset(z, n, row, kick, 0.0, share)
        for e in range(len(W)):
            reset(W[e], n, row, kick, 0.0, share)
    elif act == SLOWS:
        f = signal - SIGNALS * elements.row.shape[1]
        row, kick = elements.friction_rows[r, f], elements.friction_kick[r, f]
        reset(z, n, row, kick, elements.belt[r, f], 1.0)
        for e in range(len(W)):
            reset(W[e], n, row, kick, 0.0, 1.0)


@kernel
def saltate(modes, elements, plan, leg, r, omega, z, turn, minimum, D, P):
    """Apply the saltation matrix of the event at the end of a leg to tangents D (m, 2n) at a fixed time, in place.

    modes, elements  modes (linear equations) of the orbit, and contacts and friction of the machines
    plan, leg        legs of the turn, and the leg, a motion between two events, that ends at the event
    r, omega         row and frequency of the machine
    z, turn          (2n,) state before the event, and harmonics of the force then
    minimum          rate below which friction begins to stick at rate 0
    D, P             (m, 2n) tangents, (3, 2n) scratch space

    S w = R w + (f+ - R f-) (r . w) / r'. All terms are taken where the guard, the number that decides the event, is at
    its end, next to z if z itself is not there. The map of a turn is thus smooth off the orbit too, however slowly a
    contact is reached. S = R if friction begins to stick at a rate below ``minimum``.
    """
    k, g, act, n = plan[leg, MODE], plan[leg, SIGNAL], plan[leg, ACT], len(z) // 2
    row, at, f, late = modes.rows[k, g, : 2 * n], P[0], P[1:2], P[2]
    value, _ = guard_value(modes, k, g, z, turn)
    miss, length = value - modes.ends[k, g, plan[leg, END]], product(row, row, 0)
    for j in range(2 * n):
        at[j] = z[j] - miss / length * row[j]
    right_hand_side(modes, k, at, turn, f[0])
    rate, shares = guard_rate(modes, k, g, f[0], omega, turn), np.empty(len(D))
    for e in range(len(D)):
        shares[e] = 0.0 if act == SLOWS and abs(rate) < minimum else product(row, D[e], 0) / rate
    act_on(elements, r, act, g, at, f)
    right_hand_side(modes, plan[leg + 1, MODE], at, turn, late)
    act_on(elements, r, act, g, at, D)
    for e in range(len(D)):
        for j in range(2 * n):
            D[e, j] += shares[e] * (late[j] - f[0, j])


@kernel
def turns_of_modes(pieces, elements, plan, ends, tau, omega, sign, t, start, minimum):
    """Return the results of one turn of N orbits, from states ``start`` (N, 2n) over events at times t (N, m).

    signals    (N, 3, m) value of the number that decides each event, its rate before the event, and its rate after it
    states     (N, L, 2n) states at which the legs, motions between two events each, begin
    residuals  (N, M) sign z(end) - start, and distance of these numbers from their ends, M = 2n + m
    tangents   (N, M, M) derivatives [[sign V, sign U], [Hz, Ht]] of the residuals by start and times
    shifts     (N, M, M) see below
    maps       (N, 2n, 2n) of a turn, of the state at the time of the first event

    plan (L, PLAN) are the legs, which end at ends (N, L). ``tangents`` lack the contribution of a later end and of the
    start itself to the first rows: -shifts. For ``minimum`` (N, m) see ``saltate``. A turn begins and ends with its
    first event, later if the event is later; sign is -1 for symmetric orbits.
    """
    (N, m), size, legs = t.shape, start.shape[1], len(plan)
    n, M = size // 2, size + m
    signals, states = np.zeros((N, 3, m)), np.empty((N, legs, size))
    residuals, tangents, shifts = np.empty((N, M)), np.zeros((N, M, M)), np.zeros((N, M, M))
    h, V, f, late = np.empty((n, 2)), np.empty((size + M, n, 2)), np.empty(size), np.empty(size)
    maps, room, harmonics = np.empty((N, size, size)), np.empty((3, size)), pieces.waves.shape[3]
    for r in range(N):
        modes, z, every = row_in(by_reference(pieces), r), start[r].copy(), np.zeros((size + M, size))
        D, W = every[:size], every[size:]
        for j in range(size):
            D[j, j], W[j, j] = 1.0, 1.0
        now, alive, k = 0.0 if m == 0 else t[r, 0], size if m == 0 else size + 1, plan[0, MODE]
        later = harmonics_at(tau[r] + omega[r] * now, harmonics)
        if m > 0:
            right_hand_side(modes, k, z, later, f)
            for j in range(size):
                W[size, j] = -f[j]
        for leg in range(legs):
            k, i, g, act = plan[leg, MODE], plan[leg, EVENT], plan[leg, SIGNAL], plan[leg, ACT]
            copy_into(states[r, leg], z)
            before, later = later, harmonics_at(tau[r] + omega[r] * ends[r, leg], harmonics)
            fly_leg(modes, k, ends[r, leg] - now, before, later, z, every[: size + alive], h, V[: size + alive])
            now = ends[r, leg]
            right_hand_side(modes, k, z, later, f)
            if i == NO_EVENT:
                continue
            saltate(modes, elements, plan, leg, r, omega[r], z, later, minimum[r, i], D, room)
            equation, row = size + i, modes.rows[k, g, :size]
            value, _ = guard_value(modes, k, g, z, later)
            signals[r, 0, i], signals[r, 1, i] = value, guard_rate(modes, k, g, f, omega[r], later)
            residuals[r, equation] = value - modes.ends[k, g, plan[leg, END]]
            for e in range(equation + 1):
                tangents[r, equation, e] = product(row, W[e], 0)
            tangents[r, equation, equation] += signals[r, 1, i]
            for j in range(size):
                W[equation, j] += f[j]
            alive = equation + 1
            act_on(elements, r, act, g, z, W[:alive])
            right_hand_side(modes, plan[leg + 1, MODE], z, later, late)
            for j in range(size):
                W[equation, j] -= late[j]
            signals[r, 2, i] = guard_rate(modes, k, g, late, omega[r], later)
        for j in range(size):
            residuals[r, j], shifts[r, j, j] = sign * z[j] - start[r, j], 1.0
            if m > 0:
                shifts[r, j, size] = -sign * f[j]
            for e in range(M):
                tangents[r, j, e] = sign * W[e, j]
            for e in range(size):
                maps[r, j, e] = sign * D[e, j]
    return signals, states, residuals, tangents, shifts, maps


@kernel
def between_events(pieces, plan, begins, states, tau, omega, sign, span, signal, mirror, s):
    """Return the states (N, K, 2n) at times s (N, K), and value, rate and ends (4, N, K) of one signal then.

    A signal is a number computed from the state, with an event at each end of its range. ``begins`` (N, L) are the
    times at which the legs of a turn, motions between two events each, begin, ``states`` their states. An event at such
    a time, up to rounding, counts as past. States and signal are multiplied by ``sign`` and ``mirror`` from turn to
    turn.
    """
    (N, K), legs, size = s.shape, len(plan), states.shape[2]
    moments, values = np.empty((N, K, size)), np.empty((4, N, K))
    h, V, f, none = np.empty((size // 2, 2)), np.empty((0, size // 2, 2)), np.empty(size), np.empty((0, size))
    for r, i in np.ndindex(N, K):
        modes = row_in(by_reference(pieces), r)
        rounding = AT_ONCE * (abs(s[r, i]) + span[r])
        turn = math.floor((s[r, i] + rounding - begins[r, 0]) / span[r])
        time, leg = s[r, i] - turn * span[r], 0
        while leg + 1 < legs and begins[r, leg + 1] <= time + rounding:
            leg += 1
        z, k = states[r, leg].copy(), plan[leg, MODE]
        before = harmonics_at(tau[r] + omega[r] * begins[r, leg], modes.waves.shape[2])
        later = harmonics_at(tau[r] + omega[r] * time, modes.waves.shape[2])
        fly_leg(modes, k, time - begins[r, leg], before, later, z, none, h, V)
        right_hand_side(modes, k, z, later, f)
        values[0, r, i], _ = guard_value(modes, k, signal, z, later)
        values[1, r, i] = guard_rate(modes, k, signal, f, omega[r], later)
        low, high = modes.ends[k, signal, 0], modes.ends[k, signal, 1]
        values[2, r, i], values[3, r, i] = low, high
        odd = turn % 2 != 0
        for j in range(size):
            moments[r, i, j] = sign * z[j] if odd else z[j]
        if odd:
            for j in range(2):
                values[j, r, i] *= mirror
            if mirror < 0.0:
                values[2, r, i], values[3, r, i] = -high, -low
    return moments, values


@kernel
def event_of_leg(pieces, r, k, z, phase, signal_starts, H):
    """Return (time, signal, side) of the first event within the time H, from a state z (2n,) in mode k.

    pieces         modes, sets of linear equations, of N machines
    r              row of the machine
    phase          phase of the force at the start
    signal_starts  (G,) end of its range, +-, at which each signal starts, 0 for none

    At an event a signal, a number computed from the state, reaches an end of its range. The signal is -1 if there is no
    event, and -2 if that is undecidable.
    """
    modes, n = row_in(by_reference(pieces), r), len(z) // 2
    h, V, none, tally = np.empty((n, 2)), np.empty((0, n, 2)), np.empty((0, 2 * n)), NOTHING_COUNTED.copy()
    tally[WORK] = WORK_OF_A_TRIAL
    enter(modes, k, z, none, harmonics_at(phase, modes.waves.shape[2]), h, V)
    s, hit, side = first_event(modes, k, h, phase, signal_starts, H, np.empty((n, 2)), tally)
    return s, hit if tally[STATUS] == RUNNING else -2, side


@kernel
def beyond_range(pieces, r, k, signal_starts, z, phase, share):
    """Return (signal, side) of the first signal that is out of its range at a state z (2n,); (-1, 0) if none is.

    pieces         modes, sets of linear equations, of N machines
    r, k           row of the machine, and index of its mode
    signal_starts  (G,) end of its range, +-, at which each signal starts, 0 for none; signals with 0 are checked
    phase          phase of the force
    share          distance from the end, as a share of the signal's terms, from which on a signal is out of range

    A signal is a number computed from the state; an event occurs at each end of its range.
    """
    modes = row_in(by_reference(pieces), r)
    turn = harmonics_at(phase, modes.waves.shape[2])
    for g in range(modes.ends.shape[1]):
        value, size = guard_value(modes, k, g, z, turn)
        if signal_starts[g] == 0 and value > modes.ends[k, g, 1] + share * size:
            return g, 1
        if signal_starts[g] == 0 and value < modes.ends[k, g, 0] - share * size:
            return g, -1
    return -1, 0
