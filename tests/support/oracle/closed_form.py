"""Orbits with one impact, alone or with its mirror image half way, of machines with one harmonic: by linear algebra."""

from dataclasses import dataclass
from typing import Any

from mpmath import mp

from tests.support.oracle.linear import Number
from tests.support.oracle.model import FLIGHT, Cell, pieces_of
from tests.support.oracle.piecewise.mode_law import ModeLaws


@dataclass(frozen=True)
class ImpactOrbit:
    """An impact at one stop every n periods, and its mirror image half way if the orbit is symmetric.

    ``time`` of the impact since the section, in [0, T); ``before`` and ``after`` are (displacements, velocities)
    around it; ``multipliers`` of the whole orbit, largest first; ``exponents`` per forcing period, in the same order.
    The flight may leave the stops: this is not checked.
    """

    time: Number
    before: list[Number]
    after: list[Number]
    multipliers: list[Number]
    exponents: list[Number]


def symmetric_orbit(cell: Cell, n: int = 1, digits: int = 40) -> list[ImpactOrbit]:
    """The candidates (none or two, with an outward velocity at the stop) for an odd period n and stops at +-b.

    Half a period takes the state after an impact to the mirror image of the state before one, see ``_orbits``.
    Multipliers are the squared eigenvalues of half a period.
    """
    with mp.workdps(digits):
        return _orbits(ModeLaws(pieces_of(cell)), 1, n, mirrored=True)


def one_sided_orbit(cell: Cell, n: int = 1, side: int = 1, digits: int = 40) -> list[ImpactOrbit]:
    """The candidates (none or two) with one impact, at the stop of that side, in n periods; K must be regular."""
    with mp.workdps(digits):
        return _orbits(ModeLaws(pieces_of(cell)), side, n, mirrored=False)


def _orbits(laws: ModeLaws, side: int, n: int, mirrored: bool) -> list[ImpactOrbit]:
    """Orbits with one impact, or one and its mirror image, in n periods.

    With E = exp(A t) over the flight, rho = diag(1, ..., -R, ...) and the forced response z_p(theta), the free flight
    is z(t) - z_p(theta + omega t) = E (z+ - z_p(theta)), and z_p changes its sign over half a period. So with s = -1
    for the mirrored orbit and 1 for the other one

        z- = z_p + s E (z+ - z_p),   z+ = rho z-   give   z+ = (1 - s rho E)^-1 rho (1 - s E) z_p(theta),

    and y = stop gives the phase theta. A flight's derivative is E, an impact's the saltation matrix S = rho + (z+' -
    rho z-') (gap row) / y'-; their product times s is the map of one flight.
    """
    size, s = 2 * laws.n, -1 if mirrored else 1
    contact, rows = laws.machine.contacts[0], laws.law(FLIGHT).system.rows
    if len(laws.orders) != 1 or (mirrored and laws.orders[0] % 2 == 0):
        raise ValueError("one harmonic is needed, an odd one for a symmetric orbit")
    columns = [[row.get(size + k, mp.zero) for row in rows[:size]] for k in range(3)]
    load_sine, load_cosine, load = (mp.matrix(column) for column in columns)
    stop, opposite = contact.stops[side], contact.stops.get(-side)
    if mirrored and (mp.norm(load) > 0 or opposite != -stop):
        raise ValueError("a symmetric orbit needs stops at +-b and no load")
    A = mp.matrix([[row.get(j, mp.zero) for j in range(size)] for row in rows[:size]])
    rate = laws.orders[0] * laws.omega
    one, none = mp.eye(size), [mp.zero] * laws.n
    place, speed = (mp.matrix([row]) for row in ([*contact.row, *none], [*none, *contact.row]))
    E = mp.expm(A * (n * laws.period / (2 if mirrored else 1)))
    rho = one - (1 + mp.mpf(contact.restitution)) * mp.matrix([*none, *laws.kick(contact.row)]) * speed
    # z_p = rest + sine part * sin + cosine part * cos solves z' = A z + load_sine sin + load_cosine cos + load
    sine = mp.lu_solve(A * A + rate**2 * one, rate * load_cosine - A * load_sine)
    cosine = mp.lu_solve(A * A + rate**2 * one, -rate * load_sine - A * load_cosine)
    rest = mp.lu_solve(A, -load) if mp.norm(load) > 0 else mp.zeros(size, 1)
    to_after = mp.inverse(one - s * rho * E) * rho * (one - s * E)
    after_rest, after_sine, after_cosine = to_after * rest, to_after * sine, to_after * cosine
    height = stop - (place * after_rest)[0]
    reaches = [(place * part)[0] for part in (after_sine, after_cosine)]
    reach, shift = mp.hypot(*reaches), mp.atan2(reaches[1], reaches[0])
    if reach < abs(height):
        return []
    orbits = []
    for theta in (mp.asin(height / reach) - shift, mp.pi - mp.asin(height / reach) - shift):
        after = after_rest + after_sine * mp.sin(theta) + after_cosine * mp.cos(theta)
        forced = rest + sine * mp.sin(theta) + cosine * mp.cos(theta)
        before = forced + s * E * (after - forced)
        velocity = (speed * before)[0]
        if side * velocity <= 0:
            continue
        drive = load + load_sine * mp.sin(theta) + load_cosine * mp.cos(theta)
        jump = (A * after + drive) - rho * (A * before + drive)
        values = mp.eig(s * (rho + jump * place / velocity) * E, left=False, right=False)
        multipliers = sorted((value**2 if mirrored else value for value in values), key=abs, reverse=True)
        time = theta / rate
        time -= laws.period * mp.floor(time / laws.period)
        orbits.append(ImpactOrbit(time, list(before), list(after), multipliers, _exponents(multipliers, n)))
    return orbits


def _exponents(multipliers: list[Any], n: int) -> list[Number]:
    return [mp.log(abs(value)) / n if value != 0 else -mp.inf for value in multipliers]
