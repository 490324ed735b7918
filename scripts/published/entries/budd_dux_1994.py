"""The undamped impact oscillator x'' + x = cos(omega t), x < sigma, and its orbits with one impact in n periods.

In the plane of the stop's position and the speed of the impact these orbits form an ellipse, see ``one_impact``. At
omega = 2 n its axes are those of the plane, v = 2 omega F sqrt(1 - (sigma / F)^2) / (1 - r) with
F = 1 / (omega^2 - 1), and both multipliers are r. Below omega = 2 n the orbit that is born at a fold remains stable;
above, its period doubles before it grazes.
"""

from math import log, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from atlas.spec.spec import Spec
from scripts.published.entry import PublishedEntry, Statement
from scripts.published.helpers import PERIODIC, cell, event
from scripts.published.one_impact import OneImpact
from scripts.published.picture import in_house_style, save
from workers import solve_tile

R = 0.8
EXAMPLE = "budd-dux-1994"
ON_THE_WAY = {"x": -1.0, "v": 1.5}
"""An initial state from which these orbits are reached."""


def speed_at_2n(sigma: float, n: int) -> float:
    """Speed of the impact at omega = 2 n."""
    F = 1.0 / ((2.0 * n) ** 2 - 1.0)
    return 2.0 * (2.0 * n) * F * sqrt(1.0 - (sigma / F) ** 2) / (1.0 - R)


def statements() -> list[Statement]:
    """The speeds and multipliers at omega = 2 n; fold and doubling on either side of omega = 2."""
    system, found = Spec.from_toml(EXAMPLE).system_def, []
    for n, sigma in ((1, 0.1), (1, -0.2), (2, 0.02)):
        solved = cell(system, ON_THE_WAY | {"omega": 2.0 * n, "sigma": sigma, "r": R})
        where = f"omega = {2 * n}, sigma = {sigma}"
        found += [
            Statement(f"{where}: periods, impacts", f"{n}, 1", f"{solved['period']}, {solved['impacts_upper']}"),
            Statement(f"{where}: speed of the impact", speed_at_2n(sigma, n), solved["max_impact_speed"]),
            Statement(f"{where}: largest exponent, ln r / n", log(R) / n, solved["largest"], 1e-7, CLOSED_DOUBLE),
        ]
    for omega, sigma, kind, law in (
        (1.8, 0.2, "fold", OneImpact(1.8, 0.0, R).fold), (2.2, 0.1, "period_doubling", OneImpact(2.2, 0.0, R).doubling)
    ):  # fmt: skip
        given = ON_THE_WAY | {"omega": omega, "sigma": sigma, "r": R}
        ours = event(system, given, "sigma", (-1.0, 2.0), kind)
        found.append(Statement(f"omega = {omega}: sigma at the {kind.replace('_', ' ')}", law, ours))
    return found


CLOSED_DOUBLE = "closed form; a double multiplier, which rounding splits by 1e-8"


@in_house_style
def draw(path: Path) -> None:
    """The ellipses of the (1, 1) orbits and the cells that reach them."""
    system = Spec.from_toml(EXAMPLE).system_def
    figure = Figure(figsize=(5.0, 3.4), layout="constrained")
    ax = figure.subplots()
    for k, omega in enumerate((1.8, 2.0, 2.2)):
        law, angles = OneImpact(omega, 0.0, R), np.linspace(0.0, 2.0 * np.pi, 721)
        v = law.response * omega / law.beta * np.sin(angles)
        sigma = law.response * np.cos(angles) + law.alpha * v
        ax.plot(sigma, v, color=f"C{k}", lw=1.0, label=rf"$\omega = {omega:g}$")
        stops = np.linspace(sigma.min(), sigma.max(), 26)[1:-1]
        begin = np.minimum(ON_THE_WAY["x"], stops - 0.1)
        given: dict[str, Any] = {**ON_THE_WAY, "omega": omega, "sigma": stops, "r": R, "x": begin}
        cells = solve_tile(system, given, PERIODIC)
        one = (cells["period"] == 1) & (cells["impacts_upper"] == 1)
        ax.plot(stops[one], cells["max_impact_speed"][one], "o", ms=4, color=f"C{k}")
    ax.axhline(0.0, color="black", lw=0.8)
    ax.set(xlabel=r"position of the stop $\sigma$", ylabel="speed of the impact", ylim=(0.0, None))
    ax.legend(frameon=False)
    save(figure, path, "impact oscillator, orbits with one impact", {"example": EXAMPLE, "r": R} | ON_THE_WAY)


ENTRY = PublishedEntry(
    name="budd-dux-1994",
    work="C. Budd and F. Dux, Nonlinearity 7 (1994) 1191",
    link="https://doi.org/10.1088/0951-7715/7/4/007",
    place="the (1, n) orbits close to the resonances omega = 2 n, which the public programs of F. Dux (imposccpp and"
    " others) draw as ellipses",
    title="Impact oscillator without damping",
    machine="The machine of the spec: x'' + x = cos(omega t), x < sigma, with r = 0.8.",
    statements=statements,
    example=EXAMPLE,
    picture=draw,
    caption="Ellipses of the orbits with one impact in each period, from the closed form. Dots: cells that reach such"
    " an orbit. Where there is no dot the orbit is unstable, is not reached from this start, or passes beyond the stop,"
    " which the closed form does not exclude.",
)
