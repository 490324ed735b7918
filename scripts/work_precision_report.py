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


def draw_picture(path: str, points: list[Point], errors: Array, cells: list[Cell], curves: dict[str, Any]) -> None:
    """Work-precision diagram: a panel for periodic and one for chaotic cells."""
    import matplotlib

    from atlas.render.provenance import computed_here, metadata

    matplotlib.use("Agg")
    from matplotlib import pyplot

    looks = {
        "adaptive": ("#0072b2", "o"),
        "fixed": ("#e69f00", "s"),
        "heyoka": ("#009e73", "^"),
        "DOP853": ("#cc79a7", "D"),
    }
    names = {"adaptive": "this solver, adaptive", "fixed": "this solver, fixed schedule", "heyoka": "heyoka",
             "DOP853": "scipy DOP853"}  # fmt: skip
    figure, axes = pyplot.subplots(1, 2, figsize=(10.0, 4.4), sharey=True, layout="constrained")
    for panel, kind in zip(axes, TARGET, strict=True):
        for method, (colour, marker) in looks.items():
            chosen = [i for i, p in enumerate(points) if p.method == method and cells[p.cell].kind == kind]
            if not chosen:
                continue
            panel.plot(
                np.maximum(errors[chosen], 1e-17), [1e3 * points[i].seconds for i in chosen], marker,
                color=colour, ms=2.5, mew=0, alpha=0.25 if method != "DOP853" else 1.0,
                label=names[method] if method == "DOP853" else None,
            )  # fmt: skip
            rows = curves.get(method, {}).get(kind, [])
            if rows:
                panel.plot(
                    [row["error"] for row in rows], [1e3 * row["median_seconds"] for row in rows], marker + "-",
                    color=colour, ms=7, mec="white", label=names[method],
                )  # fmt: skip
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.set_xlabel("true error of the largest exponent (per forcing period)")
        panel.set_title(f"{kind} cells")
        panel.grid(alpha=0.3)
    axes[0].set_ylabel("milliseconds per cell, one core")
    axes[0].legend(frameon=False)
    settings = {method: sorted({point.setting for point in points if point.method == method}) for method in looks}
    spec = {"system": "two-mass", "cells": [cell.params for cell in cells], "settings": settings}
    kind = Path(path).suffix.removeprefix(".")
    figure.savefig(path, dpi=160, metadata=metadata(computed_here("two-mass, time against error", spec), kind))
    pyplot.close(figure)


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
