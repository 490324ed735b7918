"""Draw the two-mass oscillator with its stops, its symbols with units beside it: docs/machine.svg.

Usage: python -m scripts.machine_drawing [FILE]      the suffix chooses the format
"""

import sys
from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

FILE = "docs/machine.svg"
LINE, STOP, FORCE, GAP = "#24292f", "#8c2d04", "#0b5fa5", "#5b2a86"


def line(ax: Axes, xs: Sequence[float], ys: Sequence[float], color: str = LINE, width: float = 1.4) -> None:
    """A line through points."""
    ax.plot(xs, ys, color=color, lw=width, solid_joinstyle="round", solid_capstyle="round")


def spring(ax: Axes, left: float, right: float, y: float, label: str) -> None:
    """A spring at height y, its symbol above it."""
    ends, turns, half = 0.35, 7, 0.17
    xs = np.linspace(left + ends, right - ends, 2 * turns + 1)
    ys = np.array([0.0, *(half * (-1) ** k for k in range(2 * turns - 1)), 0.0])
    line(ax, [left, *xs, right], [y, *(y + ys), y])
    ax.text((left + right) / 2, y + 0.27, label, ha="center", va="bottom")


def damper(ax: Axes, left: float, right: float, y: float, label: str) -> None:
    """A dashpot at height y, its symbol below it."""
    middle, half = (left + right) / 2, 0.15
    line(ax, [left, middle - 0.22], [y, y])
    line(ax, [middle + 0.22, middle - 0.22, middle - 0.22, middle + 0.22], [y + half, y + half, y - half, y - half])
    line(ax, [middle + 0.02, right], [y, y])
    line(ax, [middle + 0.02] * 2, [y - 0.7 * half, y + 0.7 * half])
    ax.text(middle, y - 0.25, label, ha="center", va="top")


def mass(ax: Axes, left: float, label: str) -> None:
    """A mass on two rollers."""
    ax.add_patch(Rectangle((left, 0.3), 1.5, 1.6, facecolor="#e8eef4", edgecolor=LINE, lw=1.4, zorder=2))
    ax.text(left + 0.75, 1.1, label, ha="center", va="center", fontsize=13)
    for x in (left + 0.35, left + 1.15):
        ax.add_patch(matplotlib.patches.Circle((x, 0.15), 0.15, facecolor="white", edgecolor=LINE, lw=1.2, zorder=2))


def hatched(ax: Axes, corners: Sequence[tuple[float, float]], color: str) -> None:
    """A body that does not move."""
    ax.add_patch(Polygon(corners, facecolor="white", edgecolor=color, hatch="/////", lw=0.0))


def arrow(ax: Axes, start: tuple[float, float], end: tuple[float, float], color: str, style: str = "-|>") -> None:
    """A straight arrow."""
    ax.annotate("", end, start, arrowprops={"arrowstyle": style, "color": color, "lw": 1.4, "shrinkA": 0, "shrinkB": 0})


def coordinate(ax: Axes, x: float, label: str) -> None:
    """A displacement, counted from where the springs are at rest."""
    line(ax, [x, x], [1.9, 2.35], width=1.0)
    arrow(ax, (x, 2.25), (x + 0.6, 2.25), LINE)
    ax.text(x + 0.68, 2.25, label, ha="left", va="center")


def drawing() -> Figure:
    """The machine."""
    figure = Figure(figsize=(8.2, 3.3))
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    ax.set(xlim=(-0.9, 11.6), ylim=(-1.55, 3.45))
    ax.axis("off")
    left, other, wall = 1.2, 5.6, 10.6
    line(ax, [-0.6, wall], [0.0, 0.0], width=1.0)
    hatched(ax, [(-0.6, 0.0), (wall + 0.3, 0.0), (wall + 0.3, -0.18), (-0.6, -0.18)], "#8a929b")
    hatched(ax, [(wall, 0.0), (wall + 0.3, 0.0), (wall + 0.3, 2.2), (wall, 2.2)], "#8a929b")
    line(ax, [wall, wall], [0.0, 2.2])
    mass(ax, left, "$m_1$")
    mass(ax, other, "$m_2$")
    # The stops hold a nose under the first mass; the gap is drawn larger than the masses are.
    nose, gap = left + 0.75, 0.95
    ax.add_patch(Rectangle((nose - 0.14, -0.85), 0.28, 1.15, facecolor="#e8eef4", edgecolor=LINE, lw=1.4, zorder=3))
    for side, name in ((-1, "$-B$"), (1, "$B$")):
        edge = nose + side * (gap + 0.14)
        hatched(ax, [(edge, -0.18), (edge + side * 0.32, -0.18), (edge + side * 0.32, -0.95), (edge, -0.95)], STOP)
        line(ax, [edge, edge], [-0.18, -0.95], STOP, 2.2)
        arrow(ax, (nose + side * 0.14, -0.66), (edge, -0.66), GAP, "<|-|>")
        ax.text(edge + side * 0.1, -1.05, name, ha="center", va="top", color=STOP)
        ax.text(nose + side * (0.14 + gap / 2), -0.56, "$B$", ha="center", va="bottom", color=GAP, fontsize=9)
    ax.text(nose, -1.08, r"$\dot X_1\to-R\,\dot X_1$", ha="center", va="top", color=STOP, fontsize=10)
    spring(ax, left + 1.5, other, 1.45, "$k_1$")
    damper(ax, left + 1.5, other, 0.7, "$c_1$")
    spring(ax, other + 1.5, wall, 1.45, "$k_2$")
    damper(ax, other + 1.5, wall, 0.7, "$c_2$")
    for x, name, number in ((left, "$X_1$", 1), (other, "$X_2$", 2)):
        coordinate(ax, x + 0.75, name)
        arrow(ax, (x + 0.75, 2.85), (x + 1.6, 2.85), FORCE)
        text = rf"$P_{number}\,\sin(\Omega\,t+\tau)$"
        ax.text(x + 1.7, 2.85, text, ha="left", va="center", color=FORCE)
    return figure


def main() -> None:
    """Draw it into the file named on the command line."""
    file = sys.argv[1] if len(sys.argv) > 1 else FILE
    with matplotlib.rc_context({"font.size": 12, "mathtext.fontset": "cm", "svg.hashsalt": "machine"}):
        drawing().savefig(file, metadata={"Date": None} if file.endswith(".svg") else None)


if __name__ == "__main__":
    main()
