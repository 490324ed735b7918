"""A free mass in a shaken box that hits both walls in turn, half a period apart.

Between impacts the mass moves at constant speed V. With mu = (1 - R) / (1 + R) and the box at alpha sin(theta) at an
impact, symmetry asks for alpha omega cos(theta) = mu V, and the way to the other wall for

    nu / alpha = (pi / mu) cos(theta) + 2 sin(theta),

which has solutions up to nu / alpha = sqrt(4 + (pi / mu)^2), a fold. The derivative of the map from wall to wall,
mirrored, has the determinant R^2 and the trace 2 R + (1 - R^2) (pi / 2) tan(theta), so that a multiplier of it is -1,
and the symmetric orbit loses its symmetry, at tan(theta) = -2 / (pi mu):

    nu / alpha = (pi - 4 / pi) / sqrt(mu^2 + 4 / pi^2).
"""

from math import atan2, cos, hypot, pi, sin
from pathlib import Path

from scipy.optimize import brentq

from scripts.published.entry import PublishedEntry, Statement
from scripts.published.helpers import cell, event
from scripts.published.picture import plane_with_bounds


def mu(R: float) -> float:
    """(1 - R) / (1 + R)."""
    return (1.0 - R) / (1.0 + R)


def longest(R: float) -> float:
    """Nu / alpha at the fold."""
    return hypot(2.0, pi / mu(R))


def breaking(R: float) -> float:
    """Nu / alpha at the symmetry breaking."""
    return (pi - 4.0 / pi) / hypot(mu(R), 2.0 / pi)


def speed(R: float, nu: float) -> float:
    """Relative speed before an impact of the stable symmetric orbit, at alpha = omega = 1."""
    theta = brentq(lambda theta: pi / mu(R) * cos(theta) + 2.0 * sin(theta) - nu, -pi / 2, atan2(2.0, pi / mu(R)))
    return 2.0 * cos(theta) / (mu(R) * (1.0 + R))


def statements() -> list[Statement]:
    """Both ends of the stable stretch and a speed, for three R."""
    found = []
    for R, nu in ((0.6, 3.0), (0.75, 4.0), (0.9, 5.0)):
        given, window = {"R": R, "nu": nu}, (0.8, 2.0 * longest(R))
        solved = cell("impact-pair", given)
        found += [
            Statement(f"R = {R}, nu = {nu:g}: impacts at each wall in a period", "1 and 1",
                      f"{solved['impacts_upper']} and {solved['impacts_lower']}"),
            Statement(f"R = {R}, nu = {nu:g}: speed before an impact", speed(R, nu), solved["max_impact_speed"]),
            Statement(f"R = {R}: largest nu / alpha of the symmetric orbits", longest(R),
                      event("impact-pair", given, "nu", window, "fold")),
            Statement(f"R = {R}: nu / alpha below which they are unstable", breaking(R),
                      event("impact-pair", given, "nu", window, "symmetry_breaking")),
        ]  # fmt: skip
    return found


def draw(path: Path) -> None:
    """A plane of clearance and R, with the closed forms."""
    bounds = {"symmetry breaking": ("-", breaking), "fold": ("--", longest)}
    plane_with_bounds(path, "bapat-1983", bounds)


ENTRY = PublishedEntry(
    name="bapat-1983",
    work="C. N. Bapat, N. Popplewell and K. McLachlan, J. Sound Vib. 87 (1983) 19",
    place="existence and stability of the motion with two impacts half a period apart",
    title="Impact pair",
    machine="System `impact-pair`, alpha = omega = 1, no drag.",
    statements=statements,
    example="bapat-1983",
    commands=("atlas branch --system impact-pair --set R=0.6 --set nu=3 --along nu --from 0.8 --to 20",),
    picture=draw,
    caption="The lines are closed forms. Between them the symmetric orbit with two impacts in a period is stable. Other"
    " motions coexist with it. Left of the solid line period 1 is asymmetric.",
)
