"""Draw the amplitude of a mass with dry friction over the frequency, as Den Hartog did (Trans. ASME 53 (1931) 107).

Lines are his closed form, which holds where the mass never stops; dots are cells of the system friction-oscillator with
s = 1 and zeta = 0, hollow where the mass stops for a while. tests/test_den_hartog.py has the numbers.

Usage: python -m scripts.den_hartog docs/den-hartog.png
"""

import sys

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from atlas.render.provenance import computed_here, metadata
from workers import Settings, solve_tile

FORCES = (1.4, 2.0, 3.0, 5.0)
"""Amplitudes A of the force over friction."""
NEAR = 0.05
"""How far frequencies stay off the resonance, where the amplitude grows without bound if A is large."""

Array = NDArray[np.float64]


def amplitude(omega: Array, A: float) -> Array:
    """The amplitude x / A of motion that never stops; NaN where it would."""
    U, V = np.sin(np.pi / omega) / (omega * (1.0 + np.cos(np.pi / omega))), 1.0 / (1.0 - omega**2)
    square = (A * V) ** 2 - U**2
    return np.asarray(np.sqrt(np.where(square >= omega**-4.0, square, np.nan)) / A)


def draw(path: str) -> None:
    """Write the picture."""
    figure = Figure(figsize=(5.0, 3.4), layout="constrained")
    ax = figure.subplots()
    below, above = (0.5, 1.0 - NEAR), (1.0 + NEAR, 2.0)
    line = np.concatenate([np.linspace(*below, 400), [np.nan], np.linspace(*above, 400)])
    dots = np.concatenate([np.linspace(*below, 16), np.linspace(*above, 16)])
    for k, A in enumerate(FORCES):
        cells = solve_tile(
            "friction-oscillator", {"omega": dots, "A": A, "s": 1.0, "zeta": 0.0}, Settings(survival=0, tolerance=0.05)
        )
        sizes, color = 0.5 * cells["peak_to_peak"] / A, f"C{k}"
        ax.plot(line, amplitude(line, A), color=color, lw=1.2, label=f"$A = {A:g}$")
        for stops in (False, True):
            some = cells["sticks"] == stops
            ax.plot(dots[some], sizes[some], "o", ms=4, color=color, mfc="white" if stops else color)
    ax.set(xlabel=r"forcing frequency $\omega$", ylabel="amplitude over $A$", xlim=(0.5, 2.0), ylim=(0.0, 5.0))
    ax.legend(frameon=False)
    spec = {"system": "friction-oscillator", "omega": dots.tolist(), "A": FORCES, "s": 1.0, "zeta": 0.0}
    figure.savefig(path, dpi=110, metadata=metadata(computed_here("friction-oscillator, amplitudes", spec), "png"))


if __name__ == "__main__":
    draw(sys.argv[1])
