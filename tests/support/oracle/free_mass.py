"""Closed forms of a free mass on a shaken table and in a shaken box: periodic orbits and their bifurcations."""

from dataclasses import dataclass

from mpmath import mp

from tests.support.oracle.linear import Number


@dataclass(frozen=True)
class FreeOrbit:
    """An impact at this forcing ``phase``, speeds before and after it relative to the stop, and multipliers."""

    phase: Number
    before: Number
    after: Number
    multipliers: tuple[Number, Number]


def bouncing_ball_orbits(gamma: Number, R: Number) -> list[FreeOrbit]:
    """Orbits with one impact a period of ``machines.bouncing_ball``: the node or focus first, then the saddle.

    Table s = gamma sin t, gravity 1, T = 2 pi. The ball leaves with velocity u and comes back to the same height with
    u - T, so u = T/2. Relative to the table it comes with -V and leaves with R V, (1 + R) V = T. Hence the table's
    velocity u - R V = gamma cos(phase) = pi (1 - R)/(1 + R) = Gamma1.
    A change (dt, du) of an impact's time and of the velocity after it becomes at the next one
    dt' = dt + (1 + R) du and du' = R^2 du + (1 + R) s'' dt', for V = T/(1 + R). The determinant is R^2 and the trace
    1 + R^2 - (1 + R)^2 gamma sin(phase).
    """
    gamma, R = mp.mpf(gamma), mp.mpf(R)
    fold = bouncing_ball_fold(R)
    if gamma < fold:
        return []
    speed = 2 * mp.pi / (1 + R)
    phases = (mp.acos(fold / gamma), -mp.acos(fold / gamma))
    traces = [1 + R**2 - (1 + R) ** 2 * gamma * mp.sin(phase) for phase in phases]
    return [
        FreeOrbit(phase, speed, R * speed, _roots(trace, R**2)) for phase, trace in zip(phases, traces, strict=True)
    ]


def bouncing_ball_fold(R: Number) -> Number:
    """Gamma1 = pi (1 - R)/(1 + R), where the orbits appear: sin(phase) = 0, so the multipliers are 1 and R^2."""
    return mp.pi * (1 - mp.mpf(R)) / (1 + mp.mpf(R))


def bouncing_ball_doubling(R: Number) -> Number:
    """Gamma2, the period doubling of the stable orbit.

    Multipliers -1 and -R^2 have the trace -(1 + R^2): gamma sin(phase) = 2 (1 + R^2)/(1 + R)^2. With
    gamma cos(phase) = Gamma1, gamma is the root of the sum of the squares.
    """
    R = mp.mpf(R)
    return mp.hypot(bouncing_ball_fold(R), 2 * (1 + R**2) / (1 + R) ** 2)


def impact_pair_orbits(clearance: Number, R: Number) -> list[FreeOrbit]:
    """Symmetric orbits with one impact a side of ``machines.impact_pair``, the saddle last.

    Multipliers are of half a period and a mirror; those of the orbit are their squares.

    Box s = sin t, stops at s +- nu/2. The mass leaves the upper stop at the phase p with velocity u and arrives at the
    lower one half a period later: sin p + nu/2 + pi u = -sin p - nu/2. By symmetry it came with -u, so Newton's law
    u - w = -R (-u - w), w = cos p, gives u = rho w, rho = (1 + R)/(1 - R). Together
    2 sin p + pi rho cos p = -nu. The speed relative to the stop is -2 w/(1 - R) before the impact.
    A change (dt, du) becomes dt' = R dt - h du, h = pi (1 - R)/(2 w), and, mirrored,
    du' = -(1 + R) R sin(p) dt + (R + (1 + R) h sin p) du. The determinant is R^2 and the trace
    2 R + (1 - R^2) (pi/2) tan p.
    """
    nu, R = mp.mpf(clearance), mp.mpf(R)
    rho = (1 + R) / (1 - R)
    reach, shift = mp.hypot(2, mp.pi * rho), mp.atan2(mp.pi * rho, 2)
    if nu > reach:
        return []
    orbits = []
    for phase in (mp.asin(-nu / reach) - shift, mp.pi - mp.asin(-nu / reach) - shift):
        w = mp.cos(phase)
        if w < 0:  # otherwise the mass would come from beyond the stop
            trace = 2 * R + (1 - R**2) * (mp.pi / 2) * mp.tan(phase)
            orbits.append(FreeOrbit(phase, -2 * w / (1 - R), -2 * R * w / (1 - R), _roots(trace, R**2)))
    return sorted(orbits, key=lambda orbit: mp.re(sum(orbit.multipliers)))


def impact_pair_fold(R: Number) -> Number:
    """nu / alpha at the fold: a multiplier 1 needs tan p = 2/(pi rho), where 2 sin p + pi rho cos p is extreme."""
    R = mp.mpf(R)
    rho = (1 + R) / (1 - R)
    return mp.hypot(2, mp.pi * rho)


def impact_pair_symmetry_breaking(R: Number) -> Number:
    """nu / alpha where a multiplier of half a period is -1: tan p = -2 rho/pi, cos p = -1/sqrt(1 + 4 rho^2/pi^2)."""
    R = mp.mpf(R)
    rho = (1 + R) / (1 - R)
    return rho * (mp.pi - 4 / mp.pi) / mp.sqrt(1 + 4 * rho**2 / mp.pi**2)


def _roots(trace: Number, determinant: Number) -> tuple[Number, Number]:
    """The roots of x^2 - trace x + determinant, largest modulus first."""
    root = mp.sqrt(mp.mpc(trace**2 / 4 - determinant))
    first, second = sorted((trace / 2 + root, trace / 2 - root), key=abs, reverse=True)
    return first, second
