"""COCO's example of an impact oscillator: x'' + c x' + k x = A cos(w t), x < d, with k = 1, c = 0.1, d = 1, e = 0.8.

Its demo starts from an orbit at A = w = 1 in two pieces, given to two digits: (x, x', phase) = (-0.98, -0.29, -pi) and,
after the impact, (1, -1.36, 0.076). It then lowers A until the orbit grazes, which it does where the amplitude of the
motion without impact is d, and follows the graze in A and w over the axes A from 0 to 1, w from 0 to 1.5.
"""

from math import pi
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from atlas.cell.trajectory import cell_orbit
from scripts.published.entry import PublishedEntry, Statement
from scripts.published.helpers import PERIODIC, cell, event, largest_difference
from scripts.published.one_impact import OneImpact
from scripts.published.picture import COLORS, in_house_style, save
from workers import trace

ZETA, R = 0.05, 0.8
GIVEN = {"omega": 1.0, "A": 1.0, "zeta": ZETA, "R": R, "b": 1.0, "tau": -pi / 2}
"""The phase w t of their cosine is -pi at t = 0."""
FREQUENCIES = (0.5, 0.7, 0.9, 1.1, 1.3)


def graze(omega: float) -> float:
    """The amplitude of the force at which the stop is grazed."""
    return 1.0 / OneImpact(omega, ZETA, R).response


def grazing(omega: float) -> float:
    """The same on the branch of the motion without impact."""
    given = GIVEN | {"omega": omega, "A": 0.5 * graze(omega)}
    return event("single-mass", given, "A", (0.1 * graze(omega), 3.0 * graze(omega)), "graze")


def statements() -> list[Statement]:
    """The orbit at the start, the graze, the fold beside it, and grazes at other frequencies."""
    solved, law, digits = cell("single-mass", GIVEN), OneImpact(1.0, ZETA, R), "two digits of a starting guess"
    impacts = trace("single-mass", GIVEN | dict(zip(("x", "v"), solved["state"], strict=True)), 1).impacts
    window = (0.05, 1.5)
    return [
        Statement("x at the phase -pi", -0.98, solved["state"][0], 0.01, digits),
        Statement("x' at the phase -pi", -0.29, solved["state"][1], 0.01, digits),
        Statement("phase of the impact", 0.076, float(impacts[0, 0]) - pi, 0.001, digits),
        Statement("x' after the impact", -1.36, -R * solved["max_impact_speed"], 0.005, digits),
        Statement("x' after the impact, exact", -R * law.speeds(1.0, 1.0)[0], -R * solved["max_impact_speed"]),
        Statement("A at the graze, w = 1", graze(1.0), event("single-mass", GIVEN, "A", window, "impact_lost")),
        Statement("A at the fold beside it, w = 1", 1.0 / law.fold, event("single-mass", GIVEN, "A", window, "fold")),
        Statement("A at the graze, w = 0.5 to 1.3: largest difference", 0.0,
                  largest_difference([grazing(w) for w in FREQUENCIES], [graze(w) for w in FREQUENCIES])),
    ]  # fmt: skip


@in_house_style
def draw(path: Path) -> None:
    """Three orbits of the branch in (x1, x2), and the curve of grazes in (A, w), over the demo's axes."""
    figure = Figure(figsize=(7.0, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    for k, A in enumerate((1.0, 0.5, 0.1001)):
        x, v = cell_orbit(GIVEN | {"A": A}, "single-mass", PERIODIC).states.T
        left.plot(x, v, color=f"C{k}", lw=1.2, label=f"$A = {A:g}$")
    left.axvline(1.0, color="black", lw=1.5, label="stop")
    left.set(xlabel="displacement $x_1$", ylabel="velocity $x_2$", xlim=(-1.5, 2.0), ylim=(-2.0, 2.0))
    left.legend(loc="lower left")
    omega = np.linspace(0.0, 1.5, 301)
    right.plot([graze(w) for w in omega], omega, color="black", lw=1.0)
    right.plot([grazing(w) for w in FREQUENCIES], FREQUENCIES, "o", ms=5, color=COLORS[3])
    right.set(
        xlabel="amplitude of the force $A$", ylabel=r"forcing frequency $\omega$", xlim=(0.0, 1.0), ylim=(0.0, 1.5)
    )
    save(figure, path, "single-mass, orbits and grazes of COCO's example", GIVEN)


ENTRY = PublishedEntry(
    name="dankowicz-schilder-2013",
    work="H. Dankowicz and F. Schilder, Recipes for Continuation, SIAM 2013",
    link="https://doi.org/10.1137/1.9781611972573",
    place="Example 15.2, with the numbers of the demo that COCO distributes with it",
    title="COCO's impact oscillator",
    machine="System `single-mass`, zeta = 0.05, R = 0.8, b = 1.",
    statements=statements,
    commands=(
        "atlas branch --system single-mass --set omega=1 --set A=1 --set zeta=0.05 --set R=0.8 --along A"
        " --from 0.05 --to 1.5",
    ),
    picture=draw,
    caption="Left: orbits of the branch. Right: grazes, the line from the closed form, dots from branches. The axes"
    " are those of the demo.",
)
