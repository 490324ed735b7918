"""What bench_work_precision measures of a cell, and how that is shown: its picture and its lines."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.results import CHAOTIC, NO_IMPACT, PERIODIC, QUASIPERIODIC

Array = NDArray[np.float64]
KINDS = {NO_IMPACT: "periodic", PERIODIC: "periodic", QUASIPERIODIC: "quasiperiodic", CHAOTIC: "chaotic"}
TARGET = {"periodic": 1e-4, "chaotic": 1e-2}
"""True error of the largest exponent at which the methods are compared."""


@dataclass
class Cell:
    """One cell: where it comes from, its parameters, what is true of it and where the truth comes from."""

    group: str
    params: dict[str, float]
    truth: float = math.nan
    truth_error: float = 0.0
    source: str = ""
    kind: str = "undetermined"
    found: dict[str, float] = field(default_factory=dict)


class Point(NamedTuple):
    """One measurement: a method at one setting on one cell."""

    method: str
    setting: float
    cell: int
    seconds: float
    periods: int
    largest: float
    stated: float


class Look(NamedTuple):
    """How a method is drawn: its name, its colour and marker, and where the labels of its settings stand, in points."""

    name: str
    color: str
    marker: str
    beside: tuple[float, float]


LOOKS = {
    "adaptive": Look("this solver, with its tolerance", "#0072b2", "o", (9.0, 6.0)),
    "fixed": Look("this solver, fixed schedule, with its periods", "#c46a00", "s", (-8.0, -12.0)),
    "heyoka": Look("heyoka, the same schedules", "#00785a", "^", (8.0, 5.0)),
    "DOP853": Look("scipy DOP853, one marker a cell", "#b5528c", "D", (0.0, 0.0)),
}
LEAST = 1e-17
"""Errors below are drawn here: what is exact has no place on a logarithmic axis."""
SPREAD = (16.0, 84.0)
"""Per cent of cells between which bars reach."""


def draw_picture(path: str, points: list[Point], errors: Array, cells: list[Cell], curves: dict[str, Any]) -> None:
    """Work-precision diagram: a panel for periodic and one for chaotic cells.

    A marker for each setting of a method, with its name, at the typical error and the median time; bars reach over the
    middle 68 % of the cells.
    """
    import matplotlib

    from atlas.render.provenance import metadata, provenance_of_values
    from atlas.render.style import rc_params

    matplotlib.use("Agg")
    from matplotlib import pyplot, rc_context
    from matplotlib.patheffects import withStroke

    look_of_pages: Any = rc_params(1.1)
    with rc_context(look_of_pages):
        figure, axes = pyplot.subplots(1, 2, figsize=(10.0, 5.0), sharey=True, layout="constrained")
        for panel, kind in zip(axes, TARGET, strict=True):
            for method, look in LOOKS.items():
                chosen = [i for i, p in enumerate(points) if p.method == method and cells[p.cell].kind == kind]
                chosen = [i for i in chosen if math.isfinite(errors[i])]
                if method == "DOP853":
                    times = [1e3 * points[i].seconds for i in chosen]
                    panel.plot(
                        np.maximum(errors[chosen], LEAST), times, look.marker, color=look.color, ms=5, label=look.name
                    )
                    continue
                rows = curves.get(method, {}).get(kind, [])
                if not rows:
                    continue
                at = np.array([[max(row["error"], LEAST), 1e3 * row["median_seconds"]] for row in rows])
                panel.plot(*at.T, "-", color=look.color, lw=1.2, zorder=2)
                for row, place in zip(rows, at, strict=True):
                    own = [i for i in chosen if points[i].setting == row["setting"]]
                    ends = [
                        np.percentile(values, SPREAD)
                        for values in (np.maximum(errors[own], LEAST), np.array([1e3 * points[i].seconds for i in own]))
                    ]
                    panel.plot(ends[0], [place[1]] * 2, color=look.color, lw=2.5, alpha=0.35, solid_capstyle="butt")
                    panel.plot([place[0]] * 2, ends[1], color=look.color, lw=2.5, alpha=0.35, solid_capstyle="butt")
                panel.plot(
                    *at.T, look.marker, color=look.color, ms=6.5, mec="white", mew=0.7, zorder=3, label=look.name
                )
                for place, text in labels(at, [row["setting"] for row in rows]):
                    side = "left" if look.beside[0] > 0.0 else "right"
                    panel.annotate(
                        text, tuple(place), xytext=look.beside, textcoords="offset points", ha=side, fontsize=8.5,
                        color=look.color, zorder=4, path_effects=[withStroke(linewidth=2.0, foreground="white")],
                    )  # fmt: skip
            panel.set_xscale("log")
            panel.set_yscale("log")
            panel.margins(0.08)
            panel.set_xlabel("true error of the largest exponent [per forcing period]")
            panel.set_title(f"{kind} cells; bars: the middle 68 % of them")
            panel.grid(alpha=0.3)
        axes[0].set_ylabel("milliseconds per cell, one core")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
        settings = {method: sorted({point.setting for point in points if point.method == method}) for method in LOOKS}
        spec = {"system": "two-mass", "cells": [cell.params for cell in cells], "settings": settings}
        kind = Path(path).suffix.removeprefix(".")
        figure.savefig(
            path, dpi=200, metadata=metadata(provenance_of_values("two-mass, time against error", spec), kind)
        )
        pyplot.close(figure)


def labels(at: Array, settings: list[float]) -> list[tuple[Array, str]]:
    """The names of settings and where they stand (x, y), those of one place in one text.

    >>> labels(np.array([[1e-15, 2.0], [1.1e-15, 2.0], [1e-3, 9.0]]), [0.1, 0.03, 0.01])[0][1]
    '0.1, 0.03'
    """
    found: list[tuple[Array, str]] = []
    for place, setting in zip(at, settings, strict=True):
        if found and np.all(np.abs(np.log10(place / found[-1][0])) < [0.5, 0.12]):
            found[-1] = found[-1][0], f"{found[-1][1]}, {setting:g}"
        else:
            found.append((place, f"{setting:g}"))
    return found


def report(result: dict[str, Any]) -> None:
    """Print the figures of merit, one a line."""
    print("method     kind       setting  cells   ms a cell (median)    periods   true error")
    for method, kinds in result["curves"].items():
        for kind, rows in kinds.items():
            for r in rows:
                print(
                    f"{method:<10} {kind:<9} {r['setting']:>8g} {r['cells']:>6} {1e3 * r['seconds']:>10.3f} "
                    f"({1e3 * r['median_seconds']:>8.3f}) {r['periods']:>9.0f}   {r['error']:.1e}"
                )
    for name, value in result.items():
        if name != "curves":
            print(f"{name}: {value}")


def merits(result: dict[str, Any]) -> list[tuple[str, str, str]]:
    """The figures of merit beside what was aimed at; without heyoka, those that need none."""
    curves, tolerance, paper = result["curves"], result["tolerance"], result["paper_periods"]
    errors = {
        method: next(row["error"] for row in curves[method]["periodic"] if row["setting"] == setting)
        for method, setting in (("adaptive", tolerance), ("fixed", paper))
    }
    together, cells = result["window_together_seconds"], sum(result["window_cells"].values())
    rows = [
        (
            f"median periodic cell, against {paper} periods of the paper's schedule with the same kernels",
            f"{result['periodic_median_ratio']:.1f} times faster, error {errors['adaptive']:.0e} against "
            f"{errors['fixed']:.0e}",
            "20",
        ),
        (
            f"{cells} cells of the plane of Fig. 6 at tolerance {tolerance}, against the same",
            f"{result['window_ratio']:.1f} times faster",
            "4",
        ),
        (
            "the same cells, both methods in a batch",
            f"{result['window_together_ratio']:.1f} times faster ({together['adaptive']:.2f} s against "
            f"{together['fixed']:.2f} s)",
            "4",
        ),
    ]
    if "heyoka_window_together_ratio" in result:
        rows += [
            (
                "the same cells in a batch, against heyoka to errors of 1e-4 and 1e-2, one at a time",
                f"{result['heyoka_window_together_ratio']:.1f} times faster (periodic cells alone, one at a time: "
                f"{result['heyoka_periodic_ratio']:.1f})",
                "40",
            ),
            (
                "against DOP853, extrapolated from three cells",
                f"{result['dop853_window_ratio']:.0f} times faster one at a time, "
                f"{result['dop853_window_together_ratio']:.0f} in a batch",
                "10,000",
            ),
        ]
    spread = f"root mean square {result['z_rms']:.2f}, {100 * result['z_below_2']:.1f} % below 2"
    return [*rows, ("chaotic cells, (short - long) / combined standard error", spread, "0.8 to 1.25, 90 %")]
