"""Self-excited stick-slip of an undamped mass on a belt, with no force but friction and the spring.

The mass sticks until the spring pulls as strongly as static friction, x = 1, and slides about x = r, the kinetic
friction, on a circle of radius rho = sqrt((1 - r)^2 + u^2) in (x, x'), until its velocity is that of the belt, u, again
at x = 2 r - 1. It sticks for 2 (1 - r) / u and slides for 2 pi - 2 arctan((1 - r) / u).
"""

from math import atan2, hypot, pi

from scripts.published.entry import PublishedEntry, Statement
from scripts.published.helpers import cell
from workers import Settings

SETTINGS = Settings(survival=0, max_periods=4000, observe="maximum:x")
CASES = ((0.4, 0.5), (0.4, 0.2), (0.7, 0.3))
"""Kinetic over static friction r, velocity u of the belt."""


def sticking(r: float, u: float) -> float:
    """Time of sticking in a cycle."""
    return 2.0 * (1.0 - r) / u


def cycle(r: float, u: float) -> float:
    """Period of the cycle."""
    return sticking(r, u) + 2.0 * pi - 2.0 * atan2(1.0 - r, u)


def statements() -> list[Statement]:
    """The cycle of cells without a force, from the packaged initial state."""
    found = []
    for r, u in CASES:
        solved, where = cell("belt", {"zeta": 0.0, "r": r, "u": u}, SETTINGS), f"r = {r}, u = {u}"
        found += [
            Statement(f"{where}: regime", "periodic", solved["regime"]),
            Statement(f"{where}: period of the cycle", cycle(r, u), solved["cycle_period"]),
            Statement(f"{where}: share of the cycle that sticks", sticking(r, u) / cycle(r, u),
                      solved["stuck_fraction"]),
            Statement(f"{where}: largest x", r + hypot(1.0 - r, u), solved["maximum_x"][0]),
        ]  # fmt: skip
    return found


ENTRY = PublishedEntry(
    name="popp-stelter-1990",
    work="K. Popp and P. Stelter, Phil. Trans. R. Soc. A 332 (1990) 89",
    place="the self-excited limit cycle of the mass on a belt, here without damping, which has a closed form",
    title="Stick-slip on a belt",
    machine="System `belt`, zeta = 0.",
    example="belt",
    statements=statements,
    commands=("atlas point --system belt --set zeta=0 --set u=0.5",),
)
