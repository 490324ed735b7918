"""A mass on a spring with dry friction alone.

If the mass never stops, its amplitude is sqrt((A V)^2 - U^2), in units of kinetic friction over the stiffness, with V =
1 / (1 - omega^2) and U = sin(pi / omega) / (omega (1 + cos(pi / omega))). It stops if that is below 1 / omega^2.
"""

from math import cos, hypot, nan, pi, sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from scripts.published.entry import PublishedEntry, Statement
from scripts.published.helpers import cell, events
from scripts.published.picture import in_house_style, save
from workers import Settings, solve_tile

FORCES = (1.4, 2.0, 3.0, 5.0)
"""Amplitudes A of the force over friction, in the picture."""
NEAR = 0.05
"""Distance of frequencies from the resonance, where the amplitude grows without bound for large A."""
DRY = {"s": 1.0, "zeta": 0.0}


def of_friction(omega: float) -> float:
    """U."""
    return sin(pi / omega) / (omega * (1.0 + cos(pi / omega)))


def of_force(omega: float) -> float:
    """V."""
    return 1.0 / (1.0 - omega**2)


def least_force(omega: float) -> float:
    """The force below which the mass stops at its turning points."""
    return hypot(of_friction(omega), omega**-2) / abs(of_force(omega))


def amplitude(omega: float, A: float) -> float:
    """Amplitude of motion that never stops; NaN if the mass would stop."""
    square = (A * of_force(omega)) ** 2 - of_friction(omega) ** 2
    return sqrt(square) if square >= omega**-4 else float("nan")


def statements() -> list[Statement]:
    """Amplitudes, and the force at which stops begin, at four frequencies."""
    rows = []
    for omega in (0.6, 0.8, 1.3, 1.8):
        given = DRY | {"omega": omega, "A": round(1.5 * least_force(omega), 3)}
        ours = 0.5 * cell("friction-oscillator", given)["peak_to_peak"]
        window = (0.5 * given["A"], 2.0 * given["A"])
        onsets = events("friction-oscillator", given, "A", window, "stick_onset")  # the branch goes on with stops
        rows += [
            Statement(f"omega = {omega}: amplitude at A = {given['A']:g}", amplitude(omega, given["A"]), ours),
            Statement(f"omega = {omega}: A below which the mass stops", least_force(omega), max(onsets, default=nan)),
        ]  # fmt: skip
    return rows


@in_house_style
def draw(path: Path) -> None:
    """Amplitude over the frequency, as in his diagram."""
    figure = Figure(figsize=(5.0, 3.4), layout="constrained")
    ax = figure.subplots()
    below, above = (0.5, 1.0 - NEAR), (1.0 + NEAR, 2.0)
    line = np.concatenate([np.linspace(*below, 400), [np.nan], np.linspace(*above, 400)])
    dots = np.concatenate([np.linspace(*below, 16), np.linspace(*above, 16)])
    for k, A in enumerate(FORCES):
        given: dict[str, Any] = {**DRY, "omega": dots, "A": A}
        cells = solve_tile("friction-oscillator", given, Settings(survival=0, tolerance=0.05))
        sizes, color = 0.5 * cells["peak_to_peak"] / A, f"C{k}"
        ax.plot(line, [amplitude(w, A) / A for w in line], color=color, lw=1.2, label=f"$A = {A:g}$")
        for stops in (False, True):
            some = cells["sticks"] == stops
            ax.plot(dots[some], sizes[some], "o", ms=4, color=color, mfc="white" if stops else color)
    ax.set(xlabel=r"forcing frequency $\omega$", ylabel="amplitude over $A$", xlim=(0.5, 2.0), ylim=(0.0, 5.0))
    ax.legend(frameon=False)
    save(figure, path, "friction-oscillator, amplitudes", DRY | {"omega": dots.tolist(), "A": FORCES})


ENTRY = PublishedEntry(
    name="den-hartog-1931",
    work="J. P. Den Hartog, Trans. ASME 53 (1931) 107",
    place="amplitude of a mass with Coulomb friction, and where it begins to stop",
    title="Forced mass with dry friction",
    machine="System `friction-oscillator`, s = 1, zeta = 0.",
    statements=statements,
    commands=(
        "atlas branch --system friction-oscillator --set s=1 --set zeta=0 --set omega=1.3 --set A=2 --along A"
        " --from 0.8 --to 3",
    ),
    picture=draw,
    caption="Amplitude relative to that of the force. Lines: Den Hartog's closed form. Dots: cells, hollow where the"
    " mass stops for a while in each period.",
)
