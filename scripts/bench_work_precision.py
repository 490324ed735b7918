"""Time per cell against the true error of its largest exponent, for this solver and for two general integrators.

Methods, on the same cells, in one run, processor time on one core:
  adaptive   this solver at several tolerances
  fixed      this solver on the schedule of Li & Tan (2011) at several lengths, a quarter of each a transient
  heyoka     adaptive Taylor series with terminal events, one variational vector, saltation and normalisation compiled
             by Numba, on the same schedule (optional: pip install heyoka)
  DOP853     scipy's, with events, variational equations and saltation; on a few cells, a few periods

Cells: Figs 3, 4 and 5, the orbits of tests/data/periodic_orbits.json, cells drawn at random from the plane omega
1..4.5, b .05...6 of Fig. 6, and chaotic ones from omega .8..2, b .05...3.
Truth: the 40-digit Floquet exponent where the file has it, else the Floquet exponent of the proved orbit (heyoka's
averages, which share no code with it, are compared with it); for chaotic cells a plain average over twenty times
(--long N: N times) the periods that a cell takes at tolerance 1e-2 without being watched. What that long run does not
find chaotic was a chaotic transient or too close to call, and is counted separately.

Cells are timed one at a time; those of the plane once more in batches, as a tile is solved.

Usage: python -m scripts.bench_work_precision [--light] [--json] [--long N] [--picture FILE] [--keep]
"""

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scripts.bench_kernel import one_core
from scripts.general_integrator import FIGURES, GeneralIntegrator
from scripts.heyoka_reference import INSTALLED, Taylor
from scripts.measured import parsed, print_table
from scripts.work_precision_report import KINDS, TARGET, Cell, Point, draw_picture, merits, report
from tests.support import ROOT
from workers import Settings, solve_tile
from workers.results import CHAOTIC, PERIODIC

Array = NDArray[np.float64]
ORBITS = ROOT / "tests" / "data" / "periodic_orbits.json"
FIG_6 = {"mu_k": 5.0, "mu_m": 2.0, "zeta": 0.05, "f2": 0.0, "R": 0.8, "tau": math.pi}
PAPER = 8000
"""Periods of the paper's schedule, 2000 of them dropped."""


@dataclass(frozen=True)
class Plan:
    """What one run measures."""

    window: int
    chaotic: int
    tolerances: tuple[float, ...]
    lengths: tuple[int, ...]
    heyoka_lengths: tuple[int, ...]
    scipy_periods: int
    long: float

    @property
    def tolerance(self) -> float:
        """At which the figures of merit are taken."""
        return 0.01 if 0.01 in self.tolerances else self.tolerances[-1]

    @property
    def paper(self) -> int:
        """Periods of the schedule that they are compared with."""
        return PAPER if PAPER in self.lengths else self.lengths[-1]


FULL = Plan(400, 200, (0.1, 0.03, 0.01), (500, 2000, 8000), (500, 2000, 8000), 40, 20.0)
LIGHT = Plan(8, 3, (0.1, 0.03), (200, 800), (200, 800), 4, 3.0)


def draw(group: str, omega: tuple[float, float], b: tuple[float, float], seed: int) -> Iterator[Cell]:
    """Cells at random from a rectangle of the (omega, b) plane, without end."""
    random = np.random.default_rng(seed)
    while True:
        yield Cell(group, FIG_6 | {"omega": float(random.uniform(*omega)), "b": float(random.uniform(*b))})


def known_cells() -> list[Cell]:
    """The figures and the reference orbits."""
    cells = [Cell("figures", dict(params)) for params in FIGURES.values()]
    for record in json.loads(ORBITS.read_text()):
        params = {"R" if k == "restitution" else k: float(v) for k, v in record["params"].items()} | {"tau": 0.0}
        cells.append(Cell("orbits", params, truth=float(record["exponents"][0]), source="40 digits"))
    for cell, value in zip(cells, (-0.235569640371152, -0.475914135412643), strict=False):
        cell.truth, cell.source = value, "40 digits"
    return cells


def solve(params: dict[str, float], settings: Settings) -> dict[str, float]:
    """One cell's scalar results."""
    found = solve_tile("two-mass", params, settings)
    return {name: float(values) for name, values in found.items() if values.ndim == 0}


def find_truth(cell: Cell, long: float) -> Cell:
    """The cell with its kind and its true exponent."""
    first = cell.found = solve(cell.params, Settings())
    cell.kind = KINDS.get(int(first["regime"]), "undetermined")
    if cell.kind == "periodic":
        if not cell.source:
            cell.truth, cell.truth_error, cell.source = first["largest"], first["error"], "Floquet"
    elif cell.kind == "chaotic":
        periods = int(long * solve(cell.params, Settings(survival=0))["periods_used"])  # less those of watching
        moved = cell.params | {"x1": 1e-9}  # soon another trajectory: the short run must not be a part of the long one
        slow = solve(moved, Settings(method="fixed", transient_periods=2000, periods=periods))
        cell.truth, cell.truth_error, cell.source = slow["largest"], slow["error"], f"{periods} periods"
        if int(slow["regime"]) != CHAOTIC:
            cell.kind = "transient"
    elif cell.kind == "quasiperiodic":
        cell.truth, cell.source = 0.0, "torus"
    return cell


def collect(plan: Plan, workers: int) -> list[Cell]:
    """All cells with their truth, found on several cores: nothing is timed here."""
    window = draw("window", (1.0, 4.5), (0.05, 0.6), seed=1)
    cells = known_cells() + [next(window) for _ in range(plan.window)]
    pool = draw("chaotic", (0.8, 2.0), (0.05, 0.3), seed=2)
    wanted = plan.chaotic
    while wanted:
        cell = next(pool)
        if int(solve(cell.params, Settings())["regime"]) == CHAOTIC:
            cells.append(cell)
            wanted -= 1
    if workers == 1:
        return [find_truth(cell, plan.long) for cell in cells]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as processes:
        return list(processes.map(find_truth, cells, [plan.long] * len(cells), chunksize=1))


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    """Processor seconds of a call, and what it returns."""
    start = time.process_time()
    result = work()
    return time.process_time() - start, result


def fixed(length: int) -> Settings:
    """The schedule of Li & Tan (2011) at this length, a quarter of it a transient."""
    return Settings(method="fixed", transient_periods=length // 4, periods=length - length // 4)


def measure_solver(cells: list[Cell], method: str, value: float) -> list[Point]:
    """This solver on every cell at one tolerance or one length."""
    if method == "adaptive":
        settings = Settings(tolerance=value, max_periods=20000 if value >= 0.01 else 400000)
    else:
        settings = fixed(int(value))
    points = []
    for k, cell in enumerate(cells):
        seconds, found = timed(lambda cell=cell: solve(cell.params, settings))  # type: ignore[misc]
        exponent = found["average" if method == "fixed" else "largest"]
        points.append(Point(method, value, k, seconds, int(found["periods_used"]), exponent, found["error"]))
    return points


def measure_together(cells: list[Cell], plan: Plan) -> dict[str, float]:
    """Seconds for all cells of the window in batches, as a tile is solved: adaptive, and the paper's schedule."""
    window = [cell.params for cell in cells if cell.group == "window"]
    params = {name: np.array([one[name] for one in window]) for name in window[0]}
    schedules = {"adaptive": Settings(tolerance=plan.tolerance), "fixed": fixed(plan.paper)}
    return {
        name: timed(lambda settings=settings: solve_tile("two-mass", params, settings))[0]  # type: ignore[misc]
        for name, settings in schedules.items()
    }


def measure_heyoka(cells: list[Cell], lengths: tuple[int, ...]) -> list[Point]:
    """Heyoka on every cell; empty if it is not installed."""
    if not INSTALLED:
        print("heyoka is not installed: skipped (pip install heyoka)", file=sys.stderr)
        return []
    taylor = Taylor(1)
    return [
        Point("heyoka", length, k, seconds, length, float(exponents[0]), math.nan)
        for k, cell in enumerate(cells)
        for length, seconds, exponents in taylor.run(cell.params, lengths)
    ]


def measure_scipy(cells: list[Cell], periods: int) -> list[Point]:
    """DOP853 on the figures, a quarter of the periods dropped."""
    points = []
    for k, cell in enumerate(cells):
        if cell.group == "figures":
            GeneralIntegrator(cell.params, 1).run(1)  # compiles what it calls
            integrator = GeneralIntegrator(cell.params, 1)

            def work(integrator: GeneralIntegrator = integrator) -> None:
                integrator.run(periods // 4)
                integrator.restart_average()
                integrator.run(periods - periods // 4)

            seconds, _ = timed(work)
            points.append(Point("DOP853", periods, k, seconds, periods, float(integrator.exponents[0]), math.nan))
    return points


def true_errors(points: list[Point], cells: list[Cell]) -> Array:
    """|exponent - truth|; for an adaptive periodic cell whose truth is its own, what it states."""
    return np.array(
        [
            p.stated
            if p.method == "adaptive" and cells[p.cell].source == "Floquet"
            else abs(p.largest - cells[p.cell].truth)
            for p in points
        ]
    )


def typical(errors: Array, kind: str) -> float:
    """One number for many errors: the median of periodic cells, the root mean square of chaotic ones."""
    return float(np.sqrt(np.mean(errors**2)) if kind == "chaotic" else np.median(errors))


def curve(points: list[Point], errors: Array, cells: list[Cell], method: str, kind: str) -> list[dict[str, float]]:
    """Mean seconds, median seconds, periods and typical error at each setting of a method."""
    rows = []
    for setting in sorted({p.setting for p in points if p.method == method}):
        chosen = [i for i, p in enumerate(points) if (p.method, p.setting) == (method, setting)]
        chosen = [i for i in chosen if cells[points[i].cell].kind == kind and math.isfinite(errors[i])]
        if chosen:
            seconds = np.array([points[i].seconds for i in chosen])
            rows.append(
                {
                    "setting": setting,
                    "cells": len(chosen),
                    "seconds": float(np.mean(seconds)),
                    "median_seconds": float(np.median(seconds)),
                    "periods": float(np.mean([points[i].periods for i in chosen])),
                    "error": typical(errors[chosen], kind),
                }
            )
    return rows


def seconds_to_reach(rows: list[dict[str, float]], target: float) -> float:
    """Mean seconds at a typical error, along the straight line through the curve's ends in log-log; NaN without.

    >>> round(seconds_to_reach([{"error": 1e-2, "seconds": 1.0}, {"error": 1e-3, "seconds": 10.0}], 1e-4), 9)
    100.0
    """
    if not rows:
        return math.nan
    if rows[0]["error"] <= target or len(rows) == 1:
        return rows[0]["seconds"] if rows[0]["error"] <= target else math.nan
    log_error = np.log([max(row["error"], 1e-300) for row in rows])
    log_seconds = np.log([row["seconds"] for row in rows])
    slope, start = np.polyfit(log_error, log_seconds, 1)
    return float(np.exp(start + slope * math.log(target)))


def z_scores(points: list[Point], cells: list[Cell], tolerance: float) -> Array:
    """(short - long) / combined error of the chaotic cells at one tolerance."""
    return np.array(
        [
            (p.largest - cells[p.cell].truth) / math.hypot(p.stated, cells[p.cell].truth_error)
            for p in points
            if (p.method, p.setting) == ("adaptive", tolerance) and cells[p.cell].kind == "chaotic"
        ]
    )


def summary(
    points: list[Point], errors: Array, cells: list[Cell], plan: Plan, together: dict[str, float]
) -> dict[str, Any]:
    """The figures of merit."""
    reference, paper = plan.tolerance, plan.paper

    def chosen(method: str, setting: float, keep: Callable[[Cell], bool]) -> Array:
        return np.array(
            [p.seconds for p in points if (p.method, p.setting) == (method, setting) and keep(cells[p.cell])]
        )

    def orbit(cell: Cell) -> bool:
        return cell.kind == "periodic" and int(cell.found["regime"]) == PERIODIC

    def in_window(cell: Cell) -> bool:
        return cell.group == "window"

    spent = {
        kind: float(np.sum(chosen("adaptive", reference, lambda c, kind=kind: in_window(c) and c.kind == kind)))  # type: ignore[misc]
        for kind in ("periodic", "quasiperiodic", "chaotic", "transient", "undetermined")
    }
    z = z_scores(points, cells, reference)
    kinds = [cell.kind for cell in cells if in_window(cell)]
    curves = {m: {k: curve(points, errors, cells, m, k) for k in TARGET} for m in ("adaptive", "fixed", "heyoka")}
    ours = sum(spent[kind] for kind in TARGET)
    general: dict[str, float] = {}
    if curves["heyoka"]["periodic"]:
        window = {
            kind: seconds_to_reach(curves["heyoka"][kind], TARGET[kind]) * kinds.count(kind)
            for kind in TARGET
            if kinds.count(kind)
        }
        general["heyoka_window_ratio"] = sum(window.values()) / ours
        general["heyoka_window_together_ratio"] = sum(window.values()) / together["adaptive"]
        for kind, seconds in window.items():
            general[f"heyoka_{kind}_ratio"] = seconds / spent[kind]
        per_period = {
            p.cell: p.seconds / p.periods
            for p in points
            if (p.method, p.setting) == ("heyoka", plan.heyoka_lengths[-1])
        }
        general["heyoka_us_per_period"] = 1e6 * float(np.mean(list(per_period.values())))
        dop853 = {p.cell: p.seconds / p.periods for p in points if p.method == "DOP853"}
        slower = float(np.mean([seconds / per_period[k] for k, seconds in dop853.items()]))
        general["dop853_us_per_period"] = 1e6 * float(np.mean(list(dop853.values())))
        general["dop853_window_ratio"] = general["heyoka_window_ratio"] * slower
        general["dop853_window_together_ratio"] = general["heyoka_window_together_ratio"] * slower
        check = [
            errors[i] for i, p in enumerate(points)
            if p.method == "heyoka" and p.setting == plan.heyoka_lengths[-1] and cells[p.cell].kind == "periodic"
        ]  # fmt: skip
        general["heyoka_periodic_off_by_more_than_0.01"] = float(np.sum(~(np.array(check) < 0.01)))
    return {
        "tolerance": reference,
        "paper_periods": paper,
        "periodic_median_ratio": float(
            np.median(chosen("fixed", paper, orbit)) / np.median(chosen("adaptive", reference, orbit))
        ),
        "window_ratio": float(
            np.sum(chosen("fixed", paper, in_window)) / np.sum(chosen("adaptive", reference, in_window))
        ),
        "window_together_seconds": together,
        "window_together_ratio": together["fixed"] / together["adaptive"],
        "window_cells": {kind: kinds.count(kind) for kind in spent},
        "window_seconds": spent,
        "chaotic_cells": len(z),
        "transients": sum(cell.kind == "transient" for cell in cells),
        "z_rms": float(np.sqrt(np.mean(z**2))),
        "z_below_2": float(np.mean(np.abs(z) < 2.0)),
        **general,
        "curves": curves,
    }


def main() -> None:
    """Measure, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--light", action="store_true", help="few cells, short runs: seconds, rough numbers")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output, nothing else")
    parser.add_argument("--long", type=float, metavar="N", help="true values of chaotic cells from N times the periods")
    parser.add_argument("--picture", metavar="FILE", help="draw the work-precision diagram")
    options = parsed(parser)
    plan = LIGHT if options.light else FULL
    plan = replace(plan, long=options.long or plan.long)
    cells = collect(plan, 1 if options.light else os.cpu_count() or 1)
    one_core()
    points: list[Point] = []
    for tolerance in plan.tolerances:
        points += measure_solver(cells, "adaptive", tolerance)
    for length in plan.lengths:
        points += measure_solver(cells, "fixed", length)
    points += measure_heyoka(cells, plan.heyoka_lengths)
    points += measure_scipy(cells, plan.scipy_periods)
    together = measure_together(cells, plan)
    errors = true_errors(points, cells)
    result = summary(points, errors, cells, plan, together)
    if options.picture:
        draw_picture(options.picture, points, errors, cells, result["curves"])
    if options.json:
        rows = [
            {"group": c.group, "params": c.params, "kind": c.kind, "truth": c.truth, "truth_error": c.truth_error,
             "source": c.source} for c in cells
        ]  # fmt: skip
        print(json.dumps({**result, "cells": rows, "points": [p._asdict() for p in points]}))
        return
    report(result)
    print_table("work-precision", ("", "measured", "aim"), merits(result), options.keep)


if __name__ == "__main__":
    main()
