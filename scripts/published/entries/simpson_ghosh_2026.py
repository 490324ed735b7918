"""Curves of folds and period doublings end on the curve of grazes where the forcing is in resonance.

The orbits have one impact in n periods. With the damped natural frequency omega_d the square root at the graze has no
effect at omega = 2 n omega_d / m, m = 1, 2, ... There alpha of ``one_impact`` is zero, so that both curves reach the
curve of grazes, A = b / F, with the same slope.
"""

from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from scripts.published.entry import PublishedEntry, Statement
from scripts.published.helpers import curves_of
from scripts.published.one_impact import OneImpact
from scripts.published.picture import in_house_style, save

EXAMPLE = "simpson-ghosh-2026"
ZETA, R = 0.05, 0.8


def resonance(n: int, m: int) -> float:
    """The frequency of a resonant graze."""
    return 2.0 * n * sqrt(1.0 - ZETA**2) / m


def statements() -> list[Statement]:
    """Both codimension-two points of the packaged plane, and the quadratic coefficients of the curves there."""
    curves, omega = curves_of(EXAMPLE), resonance(1, 1)
    A, rows = 1.0 / OneImpact(omega, ZETA, R).response, []
    for kind, n, m in (("graze_period_doubling", 1, 1), ("graze_fold", 2, 2)):
        ends = curves[(curves["kind"] == kind) & (curves["period"] == n)]
        where = f"end of the {kind.removeprefix('graze_').replace('_', ' ')} curve of orbits with n = {n} (m = {m})"
        rows += [Statement(f"{where}: number found", 1, len(ends))]
        if len(ends) == 1:
            rows += [
                Statement(f"{where}: omega", resonance(n, m), float(ends["omega"].iloc[0])),
                Statement(f"{where}: A", A, float(ends["A"].iloc[0])),
            ]
    for kind, n, reach in (("period_doubling", 1, 0.05), ("fold", 2, 0.03)):
        words = f"(A of the {kind.replace('_', ' ')} - A of the graze) / (omega - omega of the end)², limit at the end"
        exact = quadratic(kind, n)
        ours = measured(curves, kind, n, reach)
        rows.append(Statement(words, exact, ours, 0.01 * abs(exact), "closed form, to 1 %"))
    return rows


def quadratic(kind: str, n: int) -> float:
    """Limit of (A of a curve - A of the graze) / (omega - omega*)^2, from the closed form near the end."""
    step = 1e-4
    law = OneImpact(resonance(1, 1) + step, ZETA, R, n)
    return (1.0 / (law.fold if kind == "fold" else law.doubling) - 1.0 / law.response) / step**2


def measured(curves: Any, kind: str, n: int, reach: float) -> float:
    """The same from the points of the curve up to ``reach`` from the end, by a parabola in least squares."""
    rows = curves[(curves["kind"] == kind) & (curves["period"] == n)]
    away = rows["omega"].to_numpy() - resonance(1, 1)
    grazes = np.array([1.0 / OneImpact(omega, ZETA, R).response for omega in rows["omega"]])
    near = (away > 1e-3) & (away < reach)
    quotient = (rows["A"].to_numpy() - grazes)[near] / away[near] ** 2
    return float(np.polyfit(away[near], quotient, 2)[-1])


@in_house_style
def draw(path: Path) -> None:
    """The curves near the resonant graze: computed points on the closed forms."""
    curves, figure = curves_of(EXAMPLE), Figure(figsize=(5.0, 3.4), layout="constrained")
    ax, omega = figure.subplots(), np.linspace(1.8, 2.2, 400)
    laws = [(OneImpact(frequency, ZETA, R), OneImpact(frequency, ZETA, R, 2)) for frequency in omega]
    graze = np.array([1.0 / one.response for one, _ in laws])
    doubling = np.array([1.0 / one.doubling if one.doubling_ratio > 0.0 else np.nan for one, _ in laws])
    fold = np.array([1.0 / two.fold if two.alpha > 0.0 else np.nan for _, two in laws])
    kinds = (("graze", graze, 1), ("period_doubling", doubling, 1), ("fold", fold, 2))
    for k, (kind, line, n) in enumerate(kinds):
        label = "graze of the motion without impact" if kind == "graze" else f"{kind.replace('_', ' ')}, $n = {n}$"
        ax.plot(omega, line, color=f"C{k}", lw=1.0, label=label)
        rows = curves[(curves["kind"] == kind) & (curves["period"] == n)]
        ax.plot(rows["omega"][::4], rows["A"][::4], ".", ms=5, color=f"C{k}")
    ax.plot(resonance(1, 1), 1.0 / OneImpact(resonance(1, 1), ZETA, R).response, "ko", mfc="white", zorder=5)
    ax.set(xlabel=r"forcing frequency $\omega$", ylabel="amplitude of the force $A$", xlim=(1.8, 2.2), ylim=(1.0, 5.0))
    ax.legend(frameon=False)
    save(figure, path, "single-mass, curves at a resonant graze", {"example": EXAMPLE})


ENTRY = PublishedEntry(
    name="simpson-ghosh-2026",
    work="D. J. W. Simpson and I. Ghosh, arXiv 2602.22797 (2026)",
    link="https://arxiv.org/abs/2602.22797",
    place="where curves of folds and doublings end, quadratically tangent to the grazes: omega = 2 n omega_d / m",
    title="Resonant grazes",
    machine=f"System `single-mass`, zeta = {ZETA}, R = {R}, b = 1, whose omega_d is sqrt(1 - zeta²).",
    statements=statements,
    example=EXAMPLE,
    commands=(f"atlas run {EXAMPLE} -o resonant.zarr", "atlas find curves resonant.zarr"),
    picture=draw,
    caption="Lines: closed forms. Dots: every fourth point of the curves that `atlas find curves` finds. The circle is"
    " the resonant graze.",
)
