"""Measures of an attracting orbit that follow from its linearised map: return time, reactivity, amplification.

An orbit of p forcing periods T has states z_1, ..., z_p at t = k T, and Jacobians J_k = DP(z_k) of the map P over one
period: a small deviation dz of z_k is J_k dz one period later. In the norm |W dz| of ``norm.weights_of``:

    return time     -1 / lambda_1 in forcing periods, lambda_1 the largest Lyapunov exponent per period
    reactivity      max_k ln |W J_k W^-1|, the fastest growth over one period; above 0 a deviation can grow before it
                    decays
    amplification   max_m max_k |W J_{k+m-1} ... J_k W^-1|, m = 0, 1, ...: the largest growth ever, at least 1

The amplification is exact. If every product of m matrices has a norm below 1, then no longer product exceeds the
largest of the shorter ones, since |A B| <= |A| |B|. The search ends at the first such m.

Neubert & Caswell, Ecology 78 (1997) 653; Krakovska, Kuehn & Longo, Eur. J. Appl. Math. 35 (2024) 155.
"""

from typing import NamedTuple

import numpy as np

from atlas.robustness.norm import weight_matrices
from workers.attractors.attractor import STABLE, Attractor
from workers.attractors.cell_attractors import FIRST
from workers.kernel.cell_loops import physical_states
from workers.kernel.hybrid.state import guard_value, harmonics_at, mode_number_of_state, slot_of
from workers.kernel.motion import NEUTRAL, RUNNING, STATUS, Motion, axes, motions_at
from workers.model.hybrid_modes import SIGNALS, code_of
from workers.model.oscillator import Array, Oscillator, take_one
from workers.orbit.map import iterate, jacobian_of

MAX_PRODUCTS = 100_000
"""Maximum number of matrix products in the search for the growth of deviations."""

AT_SECTION = 1e-9
"""Share of a period before and after t = k T within which an impact counts as an impact at t = k T."""

ENDLESS = 1e-10
"""Decay per forcing period below which a deviation is considered persistent."""

EVEN = 1e-12
"""Relative excess of a force over kinetic friction up to which both count as equal."""

NO_ORBIT, TOUCHES, STICKS, DRIFTS, LASTING, LONG, LOST, JUMPS = (
    "chaos or a torus: there is no orbit to linearise about",
    "the orbit touches a stop at the section, where the map is not smooth",
    "friction makes the orbit stick: deviations there persist",
    "a coordinate drifts: deviations of the coordinate persist",
    "a deviation in some direction does not decay",
    f"deviations may still grow after {MAX_PRODUCTS} products of Jacobians",
    "one turn of the orbit could not be followed",
    "friction sticks at the section under a force above the kinetic one: the map jumps there",
)
"""Reasons why a measure of an attractor is unknown."""
UNMEASURED = {NO_ORBIT: 0, TOUCHES: 1, STICKS: 2, DRIFTS: 3, LASTING: 4, LONG: 5, LOST: 6, JUMPS: 7}
"""Codes of the reasons in a store; a new reason gets a new code."""
FLAGS = ("no_orbit", "touches_stop", "sticks", "drifts", "lasting", "long", "lost", "jumps")
"""Names of the reasons in a store, by code."""


class OrbitPhases(NamedTuple):
    """A periodic orbit at t = k T, the start of each of its p forcing periods T.

    states (p, 2n)         states in physical coordinates
    jacobians (p, 2n, 2n)  Jacobians of the map over one forcing period at these states
    """

    states: Array
    jacobians: Array


class LinearMeasures(NamedTuple):
    """The measures of an orbit that follow from its linearisation, with the names that they have in a store.

    return_time      return time in forcing periods; NaN if unknown
    reactivity       largest log growth of a deviation over one period; NaN if unknown
    amplification    largest growth of a deviation over any number of periods; NaN if unknown
    amplified_after  number of periods m of the amplification; -1 if unknown
    reason           reason why a measure is unknown; empty if all are known
    """

    return_time: float = np.nan
    reactivity: float = np.nan
    amplification: float = np.nan
    amplified_after: int = -1
    reason: str = ""


def measures_of(oscillator: Oscillator, attractor: Attractor, weights: Array) -> LinearMeasures:
    """Return the return time, reactivity and amplification of an attractor, in the norm with ``weights`` (2n,).

    ``oscillator`` is a record with one machine, that of the attractor.
    """
    if attractor.regime not in STABLE:
        return LinearMeasures(reason=NO_ORBIT)
    largest = float(attractor.result["largest"])
    time = np.inf if largest >= -ENDLESS else -1.0 / largest
    phases = phases_of(oscillator, attractor)
    if isinstance(phases, str):
        return LinearMeasures(time, reason=phases)
    matrices = weight_matrices(phases.jacobians, weights)
    fastest = reactivity(matrices)
    if largest >= -ENDLESS:
        return LinearMeasures(time, fastest, reason=LASTING)
    growth = amplification(matrices)
    return LinearMeasures(time, fastest, reason=LONG) if growth is None else LinearMeasures(time, fastest, *growth)


def phases_of(oscillator: Oscillator, orbit: Attractor) -> OrbitPhases | str:
    """Return a periodic orbit with its Jacobians at t = k T, or the reason why a Jacobian does not exist.

    ``oscillator`` is a record with one machine, that of the orbit.
    """
    if oscillator.drifts:
        return DRIFTS
    h, mode = orbit.h, orbit.mode
    states, jacobians = list[Array](), list[Array]()
    for _ in range(orbit.period):
        start = motions_at(h[None], np.array([[mode]]))
        states.append(physical_states(oscillator, start, np.zeros(1, dtype=np.int64))[0])
        motion, jacobian = one_period(oscillator, h, mode)
        if motion.tally[STATUS] != RUNNING:
            return LOST
        if motion.tally[NEUTRAL] > 0.0:
            return STICKS
        jacobians.append(jacobian)
        h, mode = motion.h, int(motion.mode[0])
    phases = OrbitPhases(np.array(states), np.array(jacobians))
    return not_smooth(oscillator, phases.states) or phases


def one_period(oscillator: Oscillator, h: Array, mode: int) -> tuple[Motion, Array]:
    """Return the motion after one forcing period, and the Jacobian (2n, 2n) of the map over this period.

    oscillator   record with one machine
    h (n, 2)     state at the start of the period, in the coordinates in which the equations are decoupled
    mode         number of the law of motion at the start, by which contacts are open and which frictions slide

    The Jacobian is that of physical states.
    """
    none, one = (np.zeros(0), np.zeros((0, 0))), (1, np.bool_(False))
    osc = take_one(oscillator, 0)
    motion: Motion = oscillator.with_modes(lambda _: iterate(osc, h, mode, axes(len(h)), *none, *one), FIRST)
    return motion, np.asarray(oscillator.to_physical[0] @ jacobian_of(motion.V) @ oscillator.to_blocks[0])


def not_smooth(oscillator: Oscillator, states: Array) -> str:
    """Return why the map over a forcing period has no derivative at one of these states (p, 2n); empty if it has."""
    if touches_a_stop(oscillator, states):
        return TOUCHES
    return JUMPS if slips_at_a_push(oscillator, states) else ""


def touches_a_stop(oscillator: Oscillator, states: Array) -> bool:
    """Return True if one of these states (p, 2n), at the start of a period, lies on a rigid stop.

    A state counts as on the stop if the motion reaches it within AT_SECTION periods.
    """
    n, period = states.shape[1] // 2, float(oscillator.period[0])
    for row, *stops in oscillator.rigid_stops:
        y, v = states[:, :n] @ row[0], states[:, n:] @ row[0]
        for stop in stops:
            near = AT_SECTION * (period * np.abs(v) + np.abs(states[:, :n]) @ np.abs(row[0]))
            if np.isfinite(stop[0]) and np.any(np.abs(y - stop[0]) <= near):
                return True
    return False


def slips_at_a_push(oscillator: Oscillator, states: Array) -> bool:
    """Return True if friction sticks at one of these states (p, 2n) under a force above the kinetic friction.

    A push along the force, however small, then starts sliding; a push against the force does not. The states must be
    those of a motion of this machine at the start of a forcing period.
    """
    if not oscillator.has_modes:
        return False
    table, machines = take_one(oscillator, 0).table, oscillator.table.machines
    _, C, F = machines.sizes
    for state in states:
        number = int(mode_number_of_state(table.elements, state))
        k, turn = int(slot_of(table.codes, number)), harmonics_at(table.tau, table.pieces.waves.shape[2])
        for e, sign in enumerate(code_of(number, C, F, *machines.segments).slips if k >= 0 else ()):
            force, _ = guard_value(table.pieces, k, SIGNALS * C + e, state, turn)
            if sign == 0 and abs(force) > (1.0 + EVEN) * machines.friction_constants[0, 0, e, int(force < 0.0), 0]:
                return True
    return False


def reactivity(matrices: Array) -> float:
    """Return the largest log growth that one of the matrices (p, d, d) can give a vector, by its 2-norm.

    The result is -infinity if all matrices are zero.
    """
    with np.errstate(divide="ignore"):
        return float(np.log(np.linalg.norm(matrices, 2, axis=(1, 2)).max()))


def amplification(matrices: Array, limit: int = MAX_PRODUCTS) -> tuple[float, int] | None:
    """Return the largest 2-norm of products of consecutive matrices (p, d, d), cyclic, and its number of factors.

    The result is (1, 0) if no product has a norm above 1, and None if the largest is not known after ``limit``
    products.
    """
    p = len(matrices)
    products, best = np.broadcast_to(np.eye(matrices.shape[1]), matrices.shape), (1.0, 0)
    for m in range(1, limit // p + 1):
        products = matrices[(np.arange(p) + m - 1) % p] @ products
        size = float(np.linalg.norm(products, 2, axis=(1, 2)).max())
        if size < 1.0:
            return best
        if size > best[0]:
            best = (size, m)
    return None
