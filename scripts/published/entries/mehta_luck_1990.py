"""A completely inelastic ball on a shaken table, where it rests until the table falls away.

Lengths and times are such that omega = 1; a = A omega^2 / g. The ball leaves at the phase sin(theta) = 1 / a with the
speed of the table and lands at the first zero of its height. It rests in every period up to a = sqrt(1 + pi^2). From
there on it lands where the table already falls faster than the ball would, and leaves at once: a turn takes exactly one
period, its only multiplier is 1 - sqrt(a^2 - pi^2), and this is -1 at a = sqrt(4 + pi^2).
"""

from math import asin, cos, log, pi, sin, sqrt

from scipy.optimize import brentq

from scripts.published.entry import PublishedEntry, Statement
from scripts.published.helpers import cell


def flight(a: float) -> float:
    """Time of the flight after a rest, at g = 1 and omega = 1: the first zero of the height over the table."""
    leave = asin(1.0 / a)

    def height(t: float) -> float:
        return a * sin(leave) + a * cos(leave) * t - 0.5 * t**2 - a * sin(leave + t)

    step = 1e-3
    t = 0.1
    while height(t + step) > 0.0:
        t += step
    return float(brentq(height, t, t + step, xtol=1e-14))


def statements() -> list[Statement]:
    """Resting times of the ball, the multiplier of the motion without rest, and its period doubling."""
    rows = []
    for a in (1.3, 2.25, 3.1):
        solved = cell("bouncing-ball", {"omega": 1.0, "g": 1.0, "A": a, "R": 0.0})
        rows.append(Statement(f"a = {a}: share of the period at rest", 1.0 - flight(a) / (2.0 * pi),
                               solved["stuck_fraction"]))  # fmt: skip
    for a in (3.35, 3.6):
        solved = cell("bouncing-ball", {"omega": 1.0, "g": 1.0, "A": a, "R": 0.0})
        rows += [
            Statement(f"a = {a}: period, impacts, rest", "1, 1, no",
                      f"{solved['period']}, {solved['impacts_lower']}, {'yes' if solved['sticks'] else 'no'}"),
            Statement(f"a = {a}: largest exponent", log(abs(1.0 - sqrt(a**2 - pi**2))), solved["largest"]),
        ]  # fmt: skip
    border = sqrt(1.0 + pi**2)
    rests = [cell("bouncing-ball", {"omega": 1.0, "g": 1.0, "A": share * border, "R": 0.0})["sticks"]
             for share in (0.999, 1.001)]  # fmt: skip
    rows.append(Statement("rest 0.1 % below and above a = sqrt(1 + pi²)", "yes, no",
                           ", ".join("yes" if rest else "no" for rest in rests)))  # fmt: skip
    sides = [cell("bouncing-ball", {"omega": 1.0, "g": 1.0, "A": share * sqrt(4.0 + pi**2), "R": 0.0})["period"]
             for share in (0.999, 1.001)]  # fmt: skip
    rows.append(Statement("period 0.1 % below and above a = sqrt(4 + pi²)", "1, 2", ", ".join(map(str, sides))))
    return rows


ENTRY = PublishedEntry(
    name="mehta-luck-1990",
    work="A. Mehta and J. M. Luck, Phys. Rev. Lett. 65 (1990) 393",
    place="the completely inelastic ball: rest, flight and the motion without rest",
    title="Completely inelastic ball",
    machine="System `bouncing-ball`, R = 0, omega = g = 1.",
    statements=statements,
    commands=("atlas point --system bouncing-ball --set omega=1 --set A=2.25 --set R=0",),
)
