"""The phase at which the ball on a shaken table bounces, and the diagram of such phases over the acceleration.

The speed of the table at the bounce of an orbit of n periods is A omega cos(phase) = (g n T / 2) (1 - R) / (1 + R), see
holmes_1982.py, so that the stable one of the two orbits has

    phase = acos(n pi (1 - R) / ((1 + R) a)),

0 where they are born. Holmes draws his orbits, and the chaos beyond them, in the plane of phase and speed.
"""

from math import acos
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from scripts.published.entries.holmes_1982 import CASES, doubling, least, start
from scripts.published.entry import PublishedEntry, Statement
from scripts.published.helpers import cell
from scripts.published.picture import in_house_style, save
from workers import Settings, solve_tile

OBSERVED = Settings(survival=0, max_periods=4000, observe="impact_phase:stop,impact_speed:stop")
R, ENDS = 0.5, (1.04, 1.8)
"""Of the picture."""


def phase(R: float, n: int, a: float) -> float:
    """The phase of the bounce of the stable orbit of n periods."""
    return acos(least(R, n) / a)


def statements() -> list[Statement]:
    """Phases of three orbits at three accelerations each, and their number of values."""
    found = []
    for R, n, _ in CASES:
        low, high = least(R, n), doubling(R, n)
        for share in (0.1, 0.5, 0.9):
            a = round(low + share * (high - low), 3)
            solved = cell("bouncing-ball", start(R, n, a), OBSERVED)
            ours = solved["impact_phase_stop"][0]
            found.append(Statement(f"R = {R}, n = {n}, a = {a:g}: phase of the bounce", phase(R, n, a), ours))
        bounces = solved["impact_phase_stop_number"]
        found.append(Statement(f"R = {R}, n = {n}: phases of the last of these orbits", 1, bounces))
    return found


@in_house_style
def draw(path: Path) -> None:
    """Phases of all bounces over the acceleration, and the closed form."""
    figure = Figure(figsize=(5.0, 3.4), layout="constrained")
    ax = figure.subplots()
    A = np.linspace(*ENDS, 321)
    first = start(R, 1, 1.3)
    kept = Settings(survival=0, observe=OBSERVED.observe, observe_values=48, tolerance=0.05)
    phases = solve_tile("bouncing-ball", first | {"A": A}, kept)["impact_phase_stop"]
    phases = np.remainder(phases + np.pi, 2.0 * np.pi) - np.pi
    ax.plot(np.repeat(A, phases.shape[1]), phases.ravel(), ".", ms=2.0, mew=0, color="black", label="bounces")
    stable = np.linspace(least(R, 1), doubling(R, 1), 400)
    ax.plot(stable, [phase(R, 1, a) for a in stable], lw=1.5, label="closed form")
    ax.axvline(doubling(R, 1), ls="--", lw=1.0, label="doubling")
    ax.set(xlabel=r"acceleration $a = A \omega^2 / g$", ylabel="phase of the bounce [rad]", xlim=ENDS)
    ax.legend(frameon=False, loc="lower left")
    save(figure, path, "bouncing-ball, phases", first | {"A": A.tolist()})


ENTRY = PublishedEntry(
    name="holmes-1982-phase",
    work="P. J. Holmes, J. Sound Vib. 84 (1982) 173",
    place="phase of the bounce of the orbits with one bounce in n periods of the table",
    title="Phases of a bouncing ball",
    machine="System `bouncing-ball`, omega = g = 1, observed by `impact_phase:stop`.",
    statements=statements,
    commands=(
        "atlas branch --system bouncing-ball --set A=1.3 --set v=2 --set y=0.5 --along A --from 0.5 --to 2"
        " --observe impact_phase:stop -o phases.png",
    ),
    picture=draw,
    caption="Phases of all bounces from one start, R = 0.5. The line is the closed form of the orbit with one bounce in"
    " a period, which doubles at the dashed line.",
)
