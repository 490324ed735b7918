"""Draw the amplitude of a mass with dry friction over the frequency, as Den Hartog did (Trans. ASME 53 (1931) 107).

Lines are his closed form, which holds where the mass never sticks; marks are cells of the system friction-oscillator
with s = 1 and zeta = 0, hollow where the mass sticks for a while. tests/test_den_hartog.py has the numbers.

Usage: python -m scripts.den_hartog docs/den-hartog.png
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from atlas.render.page import Page
from atlas.render.provenance import computed_here, save
from atlas.render.style import mark
from workers import Settings, solve_tile

FORCES = (1.4, 2.0, 3.0, 5.0)
"""Amplitudes A of the force over friction."""
COLORS, MARKERS = ("#c9703f", "#b65c8f", "#4477aa", "#24324a"), "osD^"
"""Their colours, ever darker, and their markers."""
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
    page = Page(width=5.0, dpi=220.0)
    with page.context():
        figure, (ax,) = page.panels(3.7, 1)
        below, above = (0.5, 1.0 - NEAR), (1.0 + NEAR, 2.0)
        line = np.concatenate([np.linspace(*below, 400), [np.nan], np.linspace(*above, 400)])
        dots = np.concatenate([np.linspace(*below, 16), np.linspace(*above, 16)])
        entries = []
        for A, color, marker in zip(FORCES, COLORS, MARKERS, strict=True):
            cells = solve_tile(
                "friction-oscillator",
                {"omega": dots, "A": A, "s": 1.0, "zeta": 0.0},
                Settings(survival=0, tolerance=0.05),
            )
            sizes = 0.5 * cells["peak_to_peak"] / A
            ax.plot(line, amplitude(line, A), color=color, lw=1.0)
            for sticks, fill in ((False, color), (True, "white")):
                some = cells["sticks"] == sticks
                ax.plot(dots[some], sizes[some], **mark(marker, 4.0, fill, color, 0.9))
            entries.append(Line2D([], [], label=f"$A = {A:g}$", **mark(marker, 4.0, color, color, 0.9)))
        entries += [
            Line2D([], [], color="#404040", lw=1.0, label="Den Hartog, no stick"),
            Line2D([], [], label="computed, no stick", **mark("o", 4.0, "#404040", "#404040", 0.9)),
            Line2D([], [], label="computed, with stick", **mark("o", 4.0, "white", "#404040", 0.9)),
        ]
        ax.set(xlabel=r"forcing frequency $\omega$", ylabel="amplitude over $A$", xlim=(0.5, 2.0), ylim=(0.0, 5.0))
        page.legend(figure, entries)
        spec = {"system": "friction-oscillator", "omega": dots.tolist(), "A": FORCES, "s": 1.0, "zeta": 0.0}
        save(figure, Path(path), computed_here("friction-oscillator, amplitudes", spec), page)


if __name__ == "__main__":
    draw(sys.argv[1])
