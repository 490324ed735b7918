"""The ball on a shaken table that bounces once in n periods of the table.

The table is A sin(omega t + tau), a = A omega^2 / g. Both bounces of a turn are at the same height, so that the flight
takes n periods T if the relative speed before the impact is g n T / (1 + R). The speed of the table is then
(g n T / 2) (1 - R) / (1 + R), which its amplitude has to allow:

    a >= n pi (1 - R) / (1 + R).

With the exact times of flight the derivative of the map from bounce to bounce has the determinant R^2 and the trace
1 + R^2 - (1 + R)^2 a sin(phase), so that a multiplier is -1 at

    a^2 = (n pi (1 - R) / (1 + R))^2 + (2 (1 + R^2) / (1 + R)^2)^2.

Holmes neglects the motion of the table during the flight. His map has the same orbits, and 1 for the last bracket.
"""

from functools import partial
from math import acos, hypot, log, pi
from pathlib import Path

import numpy as np

from atlas.spec.spec import Spec
from scripts.published.entry import PublishedEntry, Statement
from scripts.published.helpers import PERIODIC, cell, event
from scripts.published.picture import plane_with_bounds
from workers import solve_tile

CASES = ((0.5, 1, 1.3), (0.9, 1, 0.5), (0.9, 2, 0.7))
"""R, n and an acceleration at which that orbit is stable."""


def least(R: float, n: int) -> float:
    """The acceleration at which the orbits of n periods are born."""
    return n * pi * (1.0 - R) / (1.0 + R)


def doubling(R: float, n: int) -> float:
    """The acceleration at which the period doubles."""
    return hypot(least(R, n), 2.0 * (1.0 + R**2) / (1.0 + R) ** 2)


def doubling_of_holmes(R: float, n: int) -> float:
    """The same of his map."""
    return hypot(least(R, n), 1.0)


def speed(R: float, n: int) -> float:
    """Relative speed before an impact, at omega = g = 1."""
    return 2.0 * pi * n / (1.0 + R)


def start(R: float, n: int, A: float) -> dict[str, float]:
    """Parameters of a cell, which starts just after the bounce of its orbit."""
    return {"omega": 1.0, "g": 1.0, "R": R, "A": A, "tau": acos(least(R, n) / A), "y": 0.0, "v": R * speed(R, n)}


def statements() -> list[Statement]:
    """Birth, speed and period doubling of three orbits, and the doubling by the map of Holmes."""
    found = []
    for R, n, A in CASES:
        given, where = start(R, n, A), f"R = {R}, n = {n}"
        solved = cell("bouncing-ball", given)
        window = (0.1, 3.0)
        ours = event("bouncing-ball", given, "A", window, "period_doubling")
        found += [
            Statement(f"{where}: period at a = {A}", n, solved["period"]),
            Statement(f"{where}: speed before the impact", speed(R, n), solved["max_impact_speed"]),
            Statement(f"{where}: exponent ln R / n at a = {A}", log(R) / n, solved["largest"]),
            Statement(f"{where}: a at birth", least(R, n), event("bouncing-ball", given, "A", window, "fold")),
            Statement(
                f"{where}: a at the period doubling, by the map of Holmes", doubling_of_holmes(R, n), ours, 1e-3,
                "approximation for high bounces",
                "The map of Holmes neglects the motion of the table during the flight. It is better the closer R is to"
                " 1 and the larger n is.",
            ),
            Statement(f"{where}: a at the period doubling, exact times of flight", doubling(R, n), ours),
        ]  # fmt: skip
    return found + scan()


def scan() -> list[Statement]:
    """Cells of the packaged plane with R of at most 0.5, inside and outside the two limits for n = 1."""
    spec = Spec.from_toml("holmes-1982")
    axes = {axis.name: np.array(axis.values) for axis in spec.axes}
    A, R = np.meshgrid(axes["A"], axes["R"][axes["R"] <= 0.5])
    inside = (np.vectorize(least)(R, 1) < A) & (np.vectorize(doubling)(R, 1) > A)
    cells = solve_tile(spec.system, {**spec.parameters, "A": A, "R": R}, PERIODIC)
    once = (cells["period"] == 1) & (cells["impacts_lower"] == 1) & ~cells["sticks"]
    outside, share = int((once & ~inside).sum()), float(once[inside].mean())
    limits = "limits for n = 1, that bounce once in a period"
    return [
        Statement(f"cells of the plane below with R <= 0.5, outside the {limits}", 0, outside),
        Statement(f"share of cells with R <= 0.5, inside the {limits}", 1.0, share, 0.01, "all but coexisting motions"),
    ]


def draw(path: Path) -> None:
    """A plane of accelerations and R, with the closed forms for n = 1."""
    laws = {"birth": ("-", least), "doubling": ("--", doubling), "doubling, Holmes": (":", doubling_of_holmes)}
    bounds = {label: (style, partial(law, n=1)) for label, (style, law) in laws.items()}
    plane_with_bounds(path, "holmes-1982", bounds)


ENTRY = PublishedEntry(
    name="holmes-1982",
    work="P. J. Holmes, J. Sound Vib. 84 (1982) 173",
    place="existence and stability of the orbits with one bounce in n periods of the table",
    title="Ball on a shaken table",
    machine="System `bouncing-ball`, omega = g = 1, so that A is a = A omega² / g.",
    statements=statements,
    example="holmes-1982",
    commands=("atlas branch --system bouncing-ball --set A=1.3 --set v=2 --set y=0.5 --along A --from 0.5 --to 2",),
    picture=draw,
    caption="The lines are closed forms. Between birth and doubling the ball may bounce once in a period (period 1)."
    " Up to R = 0.55 nearly all cells do so from this start, and the doubling is the border of period 2. Left of the"
    " birth it comes to rest on the table in every period, which is period 1 too.",
)
