"""Self-excited stick-slip of an undamped mass on a belt, with no force but friction and the spring.

The mass sticks until the spring pulls as strongly as static friction, x = 1, and slides about x = r, the kinetic
friction, on a circle of radius rho = sqrt((1 - r)^2 + u^2) in (x, x'), until its velocity is that of the belt, u, again
at x = 2 r - 1. It sticks for 2 (1 - r) / u and slides for 2 pi - 2 arctan((1 - r) / u).
"""

from math import atan2, hypot, pi

from rig.published.entry import Entry, Statement
from rig.published.finding import cell
from workers import trace

CASES = ((0.4, 0.5), (0.4, 0.2), (0.7, 0.3))
"""Kinetic over static friction r, velocity u of the belt."""


def sticking(r: float, u: float) -> float:
    """Time of sticking in a cycle."""
    return 2.0 * (1.0 - r) / u


def cycle(r: float, u: float) -> float:
    """Period of the cycle."""
    return sticking(r, u) + 2.0 * pi - 2.0 * atan2(1.0 - r, u)


def turning(given: dict[str, float], r: float, u: float) -> float:
    """Our x at velocity zero, beyond the start of sliding: a section at its time."""
    arrival = (1.0 - r) / u + atan2(u, 1.0 - r)
    return float(trace("stick-slip", given | {"omega": 2.0 * pi / arrival}, 1).states[1, 0])


def statements() -> list[Statement]:
    """The cycle, in a cell whose forcing period is that of the cycle, with a force of zero.

    Such a cell is undetermined, because the cycle is not tied to the period: its phase neither grows nor shrinks.
    """
    found = []
    for r, u in CASES:
        given = {"omega": 2.0 * pi / cycle(r, u), "A": 0.0, "zeta": 0.0, "r": r, "u": u, "x": r, "v": u}
        solved, where = cell("stick-slip", given), f"r = {r}, u = {u}"
        found += [
            Statement(f"{where}: share of the cycle that sticks", sticking(r, u) / cycle(r, u),
                      solved["stuck_fraction"]),
            Statement(f"{where}: x after {solved['periods_used']} cycles, begun at r", r, solved["state"][0]),
            Statement(f"{where}: largest x", r + hypot(1.0 - r, u), turning(given, r, u)),
        ]  # fmt: skip
    return found


ENTRY = Entry(
    name="popp-stelter-1990",
    work="K. Popp and P. Stelter, Phil. Trans. R. Soc. A 332 (1990) 89",
    place="the self-excited limit cycle of the mass on a belt, here without damping, which has a closed form",
    title="Stick-slip on a belt",
    machine="System `stick-slip`, A = 0, zeta = 0, started at rest on the belt. The cell itself is undetermined:"
    " nothing ties the phase of the cycle to the forcing period.",
    statements=statements,
    commands=("atlas point --system stick-slip --set A=0 --set zeta=0 --set omega=0.90652468 --set v=0.5",),
)
