"""A periodic orbit with m impacts as 2m equations for their times and speeds, and these linearised.

    y(t_i) = +upper or -lower,  y'(t_i^-) = v_i,  with  y(t) = Y(t) - (1 + R) sum_j v_j g(t - t_j)

A rigid mode adds the offset of y, and (1 + R) k sum_i v_i = load span. Of a symmetric orbit, y(t + L/2) = -y(t), only
the impacts of one half are unknown: a turn is half the orbit, and kicks change sign from turn to turn.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.orbit.green import answer, green
from workers.orbit.linear import Linear, forced, rigid_mode

Array = NDArray[np.float64]
Table = NDArray[Any]
"""Real numbers, complex ones where z is."""


class Itinerary(NamedTuple):
    """What is fixed while an orbit is followed: its stops in order, +1 upper and -1 lower, and its length.

    sides (m,) of one turn; periods of the force in the whole orbit; symmetric: a turn is half the orbit.
    """

    sides: tuple[int, ...]
    periods: int
    symmetric: bool = False

    @property
    def sign(self) -> int:
        """What kicks are multiplied by from turn to turn: -1 for symmetric orbits, else +1."""
        return -1 if self.symmetric else 1

    def span(self, lin: Linear) -> Array:
        """The length (N,) of a turn."""
        return (0.5 if self.symmetric else 1.0) * self.periods * 2.0 * math.pi / lin.omega

    def impacts(self, side: int) -> int:
        """Impacts at this stop in the whole orbit."""
        return len(self.sides) if self.symmetric else self.sides.count(side)


class Orbit(NamedTuple):
    """A periodic orbit: times (m,) of its impacts in one turn after a section, signed speeds (m,) before them.

    ``offset`` of y is that of a rigid mode, 0 without one.
    """

    itinerary: Itinerary
    times: Array
    speeds: Array
    offset: float = 0.0


class Impacts(NamedTuple):
    """Times and signed speeds (N, m) of the impacts of N orbits of one itinerary, and their offsets (N,)."""

    t: Array
    v: Array
    offset: Array


def in_one_turn(orbit: Orbit, span: float) -> Orbit:
    """The same orbit with its times in the turn that begins at the section, 0 <= t < span, in order."""
    if not len(orbit.times):
        return orbit
    turns = np.floor(orbit.times / span)
    flips = np.where(turns % 2 == 0, 1, orbit.itinerary.sign)
    times = orbit.times - turns * span
    order = np.argsort(times, kind="stable")
    sides = (flips * np.array(orbit.itinerary.sides))[order]
    itinerary = orbit.itinerary._replace(sides=tuple(int(side) for side in sides))
    return Orbit(itinerary, times[order], (flips * orbit.speeds)[order], orbit.offset)


def impacts_of(orbit: Orbit) -> Impacts:
    """One orbit as one of many."""
    return Impacts(orbit.times[None], orbit.speeds[None], np.array([orbit.offset]))


def check_orbits(lin: Linear, itinerary: Itinerary) -> None:
    """ValueError, in one line, where these equations do not hold: R = 0, stops that are not there, false symmetry."""
    if np.any(lin.R <= 0.0):
        raise ValueError(
            "R = 0: an impact without rebound may rest on its stop, which these orbits exclude; take R > 0"
        )
    for side, name, stop in ((1, "upper", lin.upper), (-1, "lower", lin.lower)):
        if side in itinerary.sides and not np.all(np.isfinite(stop)):
            raise ValueError(f"an impact at the {name} stop, which is not there: b_{name} = {stop[0]}")
    if itinerary.periods < 1 or any(side not in (1, -1) for side in itinerary.sides):
        raise ValueError(f"itinerary {itinerary}: sides must be +1 or -1 and periods at least 1")
    if not itinerary.symmetric:
        return
    if itinerary.periods % 2 == 0:
        raise ValueError(f"a symmetric orbit takes an odd number of periods, found {itinerary.periods}")
    even = np.any(lin.sin_part[:, 1::2]) or np.any(lin.cos_part[:, 1::2])
    if even or np.any(lin.load) or not np.array_equal(lin.upper, lin.lower):
        raise ValueError("a symmetric orbit needs equal stops, no constant load and odd harmonics only")


def unknown_offset(lin: Linear, itinerary: Itinerary) -> bool:
    """Whether the offset of y is an unknown: a rigid mode, and an orbit that is not symmetric."""
    return not itinerary.symmetric and rigid_mode(lin) is not None


def since(span: Array, t: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Times (N, m, m) from the latest impact j before impact i, its own one turn ago; and whether that was a turn ago.

    Impacts are ordered as in the itinerary, so that this is smooth in the times whatever they are.
    """
    m = t.shape[1]
    before = np.arange(m)[:, None] <= np.arange(m)
    return t[:, :, None] - t[:, None, :] + span[:, None, None] * before, before


def pair_answers(lin: Linear, itinerary: Itinerary, t: Array, z: complex) -> list[Table]:
    """g, g', g'' (N, m, m) at impact i of the kicks at impact j, those growing by z from turn to turn."""
    N, m = t.shape
    span, zeta = itinerary.span(lin), itinerary.sign * z
    s, before = since(span, t)
    factor = np.where(before, 1.0 / zeta, 1.0)
    return [factor * g.reshape(N, m, m) for g in green(lin, span, zeta, s.reshape(N, m * m))[:3]]


def at_impacts(lin: Linear, itinerary: Itinerary, points: Impacts) -> tuple[Array, Array, Array]:
    """y, y' and y'' (N, m) just before each impact."""
    q = 1.0 + lin.R[:, None]
    Y = forced(lin, points.t)
    pairs = pair_answers(lin, itinerary, points.t, 1)
    y, v, a = (Y[k] - q * np.einsum("nij,nj->ni", pairs[k], points.v) for k in range(3))
    return y + points.offset[:, None], v, a


def residual(lin: Linear, itinerary: Itinerary, points: Impacts) -> Array:
    """The equations (N, 2m): y(t_i) - stop_i, then y'(t_i^-) - v_i; (N, 2m + 1) where the offset is unknown."""
    y, v, _ = at_impacts(lin, itinerary, points)
    parts = [y - stops(lin, itinerary), v - points.v]
    if unknown_offset(lin, itinerary):
        parts.append(_balance(lin, itinerary, points)[:, None])
    return np.concatenate(parts, axis=1)


def stops(lin: Linear, itinerary: Itinerary) -> Array:
    """Positions (N, m) of the stops of the impacts."""
    if not itinerary.sides:
        return np.zeros((len(lin.omega), 0))
    return np.stack([lin.upper if side > 0 else -lin.lower for side in itinerary.sides], axis=1)


def linearised(lin: Linear, itinerary: Itinerary, points: Impacts, z: complex = 1) -> Table:
    """J_z: the equations linearised for perturbations of times and speeds that grow by z from turn to turn.

    z = 1 is the Jacobian (N, M, M) of ``residual`` by times, speeds and offset. Where perturbed kicks are the same each
    turn, a rigid mode adds the perturbed offset and the balance of the kicks; without that

        det J_z = prod_i (-v_i) det(z I - DP) / det(z I - e^(A span)):

    zero where z is a multiplier, and without poles.
    """
    q, m = 1.0 + lin.R[:, None, None], points.t.shape[1]
    _, v, a = at_impacts(lin, itinerary, points)
    g0, g1, g2 = pair_answers(lin, itinerary, points.t, z)
    bordered = itinerary.sign * z == 1 and rigid_mode(lin) is not None
    size = 2 * m + bordered
    J = np.zeros((len(v), size, size), dtype=g0.dtype)
    i = np.arange(m)
    speeds = points.v[:, None, :]
    J[:, :m, :m], J[:, :m, m : 2 * m] = q * g1 * speeds, -q * g0
    J[:, m : 2 * m, :m], J[:, m : 2 * m, m : 2 * m] = q * g2 * speeds, -q * g1
    J[:, i, i] += v
    J[:, m + i, i] += a
    J[:, m + i, m + i] -= 1.0
    if bordered:
        J[:, :m, -1] = 1.0
        J[:, -1, m : 2 * m] = q[:, 0] * lin.k[:, rigid_mode(lin), 1, None]
    return J


def _balance(lin: Linear, itinerary: Itinerary, points: Impacts) -> Array:
    """(1 + R) k sum_i v_i - load span of the rigid mode."""
    j = rigid_mode(lin)
    kicks = (1.0 + lin.R) * lin.k[:, j, 1] * points.v.sum(1)
    return np.asarray(kicks - lin.load[:, j] * itinerary.span(lin))


def motion_at(lin: Linear, itinerary: Itinerary, points: Impacts, s: Array) -> tuple[Array, Array, Array, Array]:
    """y and its first three derivatives at times s (N, K), any times but those of impacts."""
    weight, since_kick, flip = _turns(lin, itinerary, points, s)
    N, K, m = since_kick.shape
    found = list(forced(lin, s))
    if m:
        span = itinerary.span(lin)
        for k, g in enumerate(green(lin, span, itinerary.sign, since_kick.reshape(N, K * m))):
            found[k] = found[k] - np.einsum("nkm,nm->nk", weight * g.reshape(N, K, m), points.v)
    found[0] = found[0] + points.offset[:, None] * flip
    return found[0], found[1], found[2], found[3]


def block_state(lin: Linear, itinerary: Itinerary, points: Impacts, s: Array) -> tuple[Array, Array]:
    """Block coordinates h, h' (N, n, K) at times s (N, K), forced response and rest position taken off."""
    weight, since_kick, flip = _turns(lin, itinerary, points, s)
    N, K, m = since_kick.shape
    h = np.zeros((N, lin.eta.shape[1], K))
    if m == 0:
        return h, h.copy()
    parts = answer(lin, itinerary.span(lin), itinerary.sign, since_kick.reshape(N, K * m))
    h, rate = (-np.einsum("njkm,nkm,nm->njk", part.reshape(N, -1, K, m), weight, points.v) for part in parts)
    j = rigid_mode(lin)
    if j is not None:
        h[:, j] += points.offset[:, None] * flip / lin.c[:, j, 0, None]
    return h, rate


def _turns(lin: Linear, itinerary: Itinerary, points: Impacts, s: Array) -> tuple[Array, Array, Array]:
    """Weights (1 + R) sign^turns and times (N, K, m) since the latest kick of each impact; sign^turns (N, K) of s."""
    span = itinerary.span(lin)[:, None, None]
    first = points.t[:, :1] if points.t.shape[1] else np.zeros((len(s), 1))
    turns = np.floor((s - first) / span[:, 0])
    local = s - turns * span[:, 0]
    before = local[:, :, None] < points.t[:, None, :]
    sign = float(itinerary.sign)
    flip = sign ** np.abs(turns)
    weight = (1.0 + lin.R)[:, None, None] * flip[..., None] * np.where(before, sign, 1.0)
    return weight, local[:, :, None] - points.t[:, None, :] + span * before, flip
