"""Equilibria of machines without a force along a parameter, in closed form, and their Hopf points.

A mode is a set of linear equations that holds between two events. In the mode of an equilibrium x'' = A x + B x' + a,
and sticking rigid contacts are at their stops, G x = s:

    [A; G] x = [-a; s],  x' = 0;    exponents: the eigenvalues of [[0, 1], [A, B]] where G x = G x' = 0

The sliding velocity decides the segment of a friction law, the depth the segment of a spring or soft contact. An
equilibrium continues from segment to segment, and its exponents jump there.
"""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.continuation.branches import EDGE, MAX_POINTS, RESOLUTION, BranchRun, bounds_of
from workers.continuation.events import Event, SolutionPoint
from workers.continuation.extended_system import Condition
from workers.continuation.families import Family, machine_of
from workers.continuation.itinerary import Itinerary, Leg, Orbit
from workers.model.family import NoOscillatorError
from workers.model.hybrid_modes import ON, OPEN, SIGNALS, ZERO_SHARE, ModeCode, null_space
from workers.model.oscillator import Array
from workers.model.system import System
from workers.orbit.recorded_legs import mode_code_of_state

HOPF, FOLD, BORDER = "hopf", "fold", "border"
"""Kinds of events. HOPF: a pair of exponents crosses the imaginary axis. FOLD: one exponent crosses 0. BORDER: the
equilibrium ends, since contacts or friction have no state in which it continues."""

OF_EQUILIBRIA = HOPF, FOLD, BORDER

HELD = "found one of a continuum of equilibria at which friction sticks, must be an isolated equilibrium"

MAX_MODES = 200
"""Maximum number of modes, sets of linear equations, that are tried for an equilibrium."""

HALVINGS = 60
"""Number of halvings of a step that locate an event to rounding."""


class Equilibrium(NamedTuple):
    """An equilibrium of a machine.

    values     (free,) parameters
    code       mode of the equilibrium, the set of linear equations that holds there
    state      (2n,) its state
    exponents  exponents per unit of time, fastest growth first
    omega      frequency of the machine's natural period
    """

    values: Array
    code: ModeCode
    state: Array
    exponents: NDArray[np.complex128]
    omega: float

    @property
    def unstable(self) -> int:
        """Number of exponents with a positive real part, above rounding: directions in which disturbances grow."""
        return int(np.sum(self.exponents.real > ZERO_SHARE * np.max(np.abs(self.exponents), initial=0.0)))

    def point(self, unstable: int) -> SolutionPoint:
        """Return the equilibrium as a solution point.

        Its orbit has no events, and its multipliers are those over a natural period.
        """
        lost = np.zeros(len(self.state) - len(self.exponents))
        multipliers = np.concatenate([np.exp(self.exponents * 2.0 * np.pi / self.omega), lost])
        return SolutionPoint(self.values, _orbit(self.code), np.zeros(0), multipliers, unstable)


class EquilibriumBranch(NamedTuple):
    """A branch of equilibria.

    run     the branch, its events and its ends, as of any other branch
    states  (N, 2n) states of its points
    """

    run: BranchRun
    states: Array


def equilibrium_of(system: System, values: Mapping[str, float], state: Array) -> Orbit:
    """Return the equilibrium of a cell with state (2n,), as an orbit without events.

    Raise ValueError if friction that sticks keeps the machine there.
    """
    code = mode_code_of_state(machine_of(system, values).elements, state)
    if 0 in code.slips:
        raise ValueError(HELD)
    return _orbit(code)


def is_equilibrium(orbit: Orbit, system: System) -> bool:
    """Return True if an orbit of a system is an equilibrium: it has no events, and no force acts on the system."""
    return system.definition.unforced and not orbit.itinerary.sides


def code_of(orbit: Orbit) -> ModeCode:
    """Return the mode of an equilibrium, the set of linear equations that holds there, from its orbit."""
    return orbit.itinerary.chains[0][0].code


def _orbit(code: ModeCode) -> Orbit:
    leg = Leg(code, (0,) * max(1, SIGNALS * len(code.contacts) + len(code.slips)), -1, 0)
    return Orbit(Itinerary((), 1, legs=((leg,),)).bare, np.zeros(0), np.zeros(0))


def equilibrium_near(family: Family, values: Array, code: ModeCode) -> Equilibrium | None:
    """Return the equilibrium at parameters (free,), in the mode ``code`` or in a mode that leads on from it.

    A mode is a set of linear equations between two events. Return None if there is no equilibrium without friction that
    sticks or turns round.
    """
    lin = family.model(values[None])
    elements, tried, signs = lin.elements, set[ModeCode](), np.sign(code.slips)
    rigid = elements.soft[0] == 0.0
    while code not in tried and len(tried) < MAX_MODES:
        tried.add(code)
        try:
            pieces = lin.mode(code)
        except NoOscillatorError:
            return None
        n = elements.row.shape[2]
        closed = [c for c, state in enumerate(code.contacts) if rigid[c] and state != OPEN]
        G, stops = elements.row[0, closed], [elements.stops[0, c, int(code.contacts[c] > 0)] for c in closed]
        (A, B), a = np.split(pieces.acceleration[0, :, : 2 * n], 2, axis=1), pieces.acceleration[0, :, 2 * n]
        x, _, rank, _ = np.linalg.lstsq(np.vstack([A, G]), np.concatenate([-a, stops]))
        if rank < n:
            return None
        z = np.concatenate([x, np.zeros(n)])
        after = _mode_at(
            code, mode_code_of_state(elements, z), rigid, pieces.rows[0] @ np.append(z, 1.0), pieces.ends[0]
        )
        if after == code:
            across = null_space(G[None])[0]
            flow = np.block([[np.zeros((across.shape[1],) * 2), np.eye(across.shape[1])],
                             [across.T @ A @ across, across.T @ B @ across]])  # fmt: skip
            exponents = np.linalg.eigvals(flow).astype(np.complex128)
            order = np.lexsort([-exponents.imag, -exponents.real])
            return Equilibrium(values, code, z, exponents[order], float(lin.omega[0]))
        code = after
        if np.any(np.sign(code.slips) != signs):
            return None
    return None


def _mode_at(code: ModeCode, seen: ModeCode, rigid: NDArray[np.bool_], signals: Array, ends: Array) -> ModeCode:
    """Return the mode that holds at an equilibrium, which was solved in the mode ``code``.

    code     mode, a set of linear equations, in which the equilibrium was solved
    seen     mode in which the segments of laws are those of the equilibrium's state
    rigid    (C,) mask of rigid contacts
    signals  (G,) numbers computed from the state, such as displacements at contacts and forces on stops
    ends     (G, 2) ranges of the signals in the mode ``code``

    A rigid contact sticks if its displacement is beyond its stop, and opens if it would have to pull.
    """
    contacts = list(seen.contacts)
    for c in np.flatnonzero(rigid).tolist():
        value, (low, high), state = signals[SIGNALS * c], ends[SIGNALS * c], code.contacts[c]
        contacts[c] = state
        if state == OPEN and not low <= value <= high:
            contacts[c] = ON if value > high else -ON
        elif state != OPEN and not low <= value <= high:
            contacts[c] = OPEN
    return ModeCode(0, tuple(contacts), seen.slips)


def equilibria(
    family: Family, orbit: Orbit, value: float, window: tuple[float, float], *, resolution: float = RESOLUTION
) -> EquilibriumBranch:
    """Return the branch of an equilibrium in a family's one free parameter, in both directions, with its events.

    family      machines over one free parameter
    orbit       the equilibrium, see ``equilibrium_of``
    value       parameter of the start
    window      (low, high) of the parameter
    resolution  longest step, as a share of the window

    Events are located to rounding. They are Hopf points, folds at which an exponent crosses 0, and the end of the
    equilibrium. Hopf points and folds may lie where exponents jump from one segment of a law to the next. Raise
    ValueError if there is no equilibrium, or if friction that sticks keeps the machine there.
    """
    bounds = bounds_of(family.free, dict.fromkeys(family.free, window))[:, 0]
    first = equilibrium_near(family, np.array([value]), code_of(orbit))
    if first is None:
        raise ValueError(f"no equilibrium at {family.free[0]} = {value:g}")
    step = resolution * float(bounds[1] - bounds[0])
    sides = []
    for end in bounds[::-1]:
        count = min(int(np.ceil(abs(end - value) / step)), MAX_POINTS)
        sides.append(list(_towards(family, first, np.linspace(value, end, count + 1)[1:])))
    ahead, back = sides
    entries = [*back[::-1], (first, first.point(first.unstable), ""), *ahead]
    points, events = (
        [point for _, point, _ in entries],
        [Event(kind, (Condition(kind),), point) for _, point, kind in entries if kind],
    )
    ends = tuple(kind if (kind := side[-1][2] if side else "") == BORDER else EDGE for side in (back, ahead))
    return EquilibriumBranch(
        BranchRun(points, events, (ends[0], ends[1]), 0), np.stack([equilibrium.state for equilibrium, *_ in entries])
    )


def _towards(family: Family, first: Equilibrium, values: Array) -> Iterator[tuple[Equilibrium, SolutionPoint, str]]:
    """Yield (equilibrium, solution point, kind of event) along parameters ``values``, after the equilibrium ``first``.

    The kind is empty if there is no event.
    """
    current = first
    for value in values.tolist():
        candidate = equilibrium_near(family, np.array([value]), current.code)
        while candidate is None or candidate.unstable != current.unstable:
            near, far = _halved(family, current, candidate, value)
            if far is None:
                yield near, near.point(near.unstable), BORDER
                return
            low, high = sorted((near, far), key=lambda end: end.unstable)
            crossing = high.exponents[low.unstable]
            yield far, point_of_event(far, low.unstable, abs(crossing.imag)), HOPF if crossing.imag else FOLD
            current = far
        yield candidate, candidate.point(candidate.unstable), ""
        current = candidate


def _halved(
    family: Family, near: Equilibrium, far: Equilibrium | None, value: float
) -> tuple[Equilibrium, Equilibrium | None]:
    """Return the last equilibrium before the first change of stability on a step, and the equilibrium after it.

    near   equilibrium at the start of the step
    far    equilibrium at its end, None if there is none
    value  parameter at its end

    The second result is None if the equilibrium ends there.
    """
    for _ in range(HALVINGS):
        middle = 0.5 * (near.values + value)
        if middle[0] in (near.values[0], value):
            break
        between = equilibrium_near(family, middle, near.code)
        if between is not None and between.unstable == near.unstable:
            near = between
        else:
            far, value = between, float(middle[0])
    return near, far


def point_of_event(equilibrium: Equilibrium, unstable: int, frequency: float) -> SolutionPoint:
    """Return the solution point of an event of an equilibrium, with ``unstable`` growing exponents.

    ``frequency`` is that of a Hopf point, 0 for other events. The orbit of a Hopf point has the length of the limit
    cycle that begins there.
    """
    point = equilibrium.point(unstable)
    if not frequency:
        return point
    return point._replace(orbit=point.orbit._replace(length=np.array(2.0 * np.pi / frequency)))
