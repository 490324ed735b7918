"""Processor time of a cell and of a forcing period, of this version of the solver and another one in alternation.

Cells: periodic, free of impacts, free of impacts with a structure of their own (masses, springs or dampers that no
other cell has), and a periodic one at a time. Periods: those of Figs 3, 4 and 5 of Li & Tan (2011) with no, one or all
exponents, as the difference of two lengths of the same run; and, of this version alone, those of machines of 1, 2, 4
and 8 masses. Planes: a part of the packaged one, and one without chaos. Each version runs in processes of its own, one
after another, since where memory happens to lie makes up to a tenth of a measure; one waits while the other measures;
best of all.

Usage: python -m scripts.bench_cell [--against ROOT] [--light] [--keep]      ROOT: a checkout of the other version
"""

import argparse
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from scripts.measured import parsed, print_table
from tests.support import ROOT
from workers.results import NO_IMPACT, PERIODIC, UNDETERMINED

_FIG = {"tau": math.pi, "R": 0.8}
FIGURES = {
    "3": {**_FIG, "mu_k": 5.0, "mu_m": 2.0, "zeta": 0.05, "f2": 0.0, "omega": 4.0, "b": 0.1},
    "4": {**_FIG, "mu_k": 4.0, "mu_m": 6.0, "zeta": 0.5, "f2": 2.0, "omega": 1.0, "b": 0.2},
    "5": {**_FIG, "mu_k": 2.0, "mu_m": 2.0, "zeta": 0.5, "f2": 5.0, "omega": 3.0, "b": 0.2},
}
EXPONENTS = ("none", "largest", "spectrum")
MASSES = {1: "single-mass", 2: "two-mass", 4: "chain-4", 8: "chain-8"}
"""A packaged system of so many masses, measured with its default parameters."""


def cells(kind: str, count: int) -> dict[str, Any]:
    """Parameters of so many cells of a kind."""
    omega = {"omega": np.linspace(3.9, 4.1, count)}
    if kind == "periodic":
        return {**omega, "b": 0.1}
    if kind == "alone":
        return {"omega": 4.0, "b": 0.15}
    if kind == "impact-free":
        return {**omega, "b": 5.0}
    if kind == "new structure":
        return {"mu_m": np.random.default_rng().uniform(2.0, 2.1, count), "b": 5.0}
    side = math.isqrt(count)
    if kind == "plane of omega and b":
        return {"omega": np.linspace(2.0, 4.0, side)[None, :], "b": np.linspace(0.05, 0.5, side)[:, None]}
    return {"R": np.linspace(0.5, 0.95, side)[None, :], "zeta": np.linspace(0.05, 0.5, side)[:, None], "b": 0.1}


KINDS = ("periodic", "alone", "impact-free", "new structure", "plane of omega and b", "plane of R and zeta")
DESCRIBED = {
    "periodic": "periodic",
    "alone": "periodic, one cell at a time",
    "impact-free": "without impact",
    "new structure": "without impact, different masses in each cell",
    "plane of R and zeta": "R from .5 to .95, zeta from .05 to .5: no chaos",
    "plane of omega and b": "omega from 2 to 4, b from .05 to .5: with chaos",
}
"""The kinds in words."""
ALLOWED = {
    "periodic": {PERIODIC},
    "alone": {PERIODIC},
    "impact-free": {NO_IMPACT},
    "new structure": {NO_IMPACT},
    "plane of R and zeta": {PERIODIC, NO_IMPACT, UNDETERMINED},
}
"""Regimes that cells of a kind may have; any where none are given."""

LEAST_SECONDS = 0.1
"""Of a measure: cells that take less are solved several times."""
LAUNCHES, ROUNDS = 4, 4
"""Processes of each version one after another, and measures of a case in each besides the first."""


def processor_time(work: Callable[[], object]) -> float:
    """Seconds of processor time that a piece of work takes."""
    start = time.process_time()
    work()
    return time.process_time() - start


def measured(case: Mapping[str, Any]) -> float:
    """Milliseconds a cell, or microseconds a period, of one case in this process."""
    from workers import Settings, solve_tile  # which version, PYTHONPATH decides

    count = case["cells"]
    if "kind" in case:
        total, times = 0.0, 0
        while total < LEAST_SECONDS:
            given = cells(case["kind"], count)
            found: list[dict[str, Any]] = []
            total += processor_time(lambda p=given, f=found: f.append(solve_tile("two-mass", p)))  # type: ignore[misc]
            times += 1
            regimes = set(np.unique(found[0]["regime"]).tolist())
            if not regimes <= ALLOWED.get(case["kind"], regimes):
                raise SystemExit(f"{case['kind']}: found cells of the regimes {sorted(regimes)}")
        return 1e3 * total / (count * times)
    system = case.get("system", "two-mass")
    params: dict[str, Any] = {**FIGURES.get(case.get("figure", ""), {})}
    slightly = 1.0 + 1e-5 * np.arange(count)
    params = {**params, "b": params["b"] * slightly} if params else {"omega": default_omega(system) * slightly}
    seconds = []
    for periods in (case["periods"], 4 * case["periods"]):
        settings = Settings(
            exponents=case["exponents"], method="fixed", transient_periods=50, periods=periods, max_period=1
        )
        seconds.append(processor_time(lambda s=settings: solve_tile(system, params, s)))  # type: ignore[misc]
    return 1e6 * (seconds[1] - seconds[0]) / (3 * case["periods"] * count)


def default_omega(system: str) -> float:
    """The forcing frequency of a packaged system where none is given."""
    from workers.model.system import find_system

    return next(float(p.default) for p in find_system(system).parameters if p.name == "omega")


def serve() -> None:
    """Answer each case on standard input with its measure, a line each."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    for line in sys.stdin:
        print(measured(json.loads(line)), flush=True)


class Version:
    """A version of the solver in a process of its own."""

    def __init__(self, root: Path) -> None:
        self.process = subprocess.Popen(
            [sys.executable, __file__, "--serve"],
            # Scripts that the other version lacks are this one's.
            env={**os.environ, "PYTHONPATH": f"{root}{os.pathsep}{ROOT}"},
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip

    def measure(self, case: Mapping[str, Any]) -> float:
        """The measure of one case."""
        assert self.process.stdin is not None and self.process.stdout is not None
        print(json.dumps(case), file=self.process.stdin, flush=True)
        return float(self.process.stdout.readline())

    def end(self) -> None:
        """End the process."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait()


def cases(light: bool, alone: bool) -> list[dict[str, Any]]:
    """What is measured of two versions, or of this one alone."""
    size = 144 if light else 1024
    found: list[dict[str, Any]] = [{"kind": kind, "cells": 1 if kind == "alone" else size} for kind in KINDS]
    for figure in FIGURES:
        for exponents in EXPONENTS:
            found.append({"figure": figure, "exponents": exponents, "cells": 256, "periods": 20 if light else 500})
    for system in MASSES.values() if alone else ():
        for exponents in EXPONENTS:
            found.append({"system": system, "exponents": exponents, "cells": 256, "periods": 20 if light else 500})
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--against", type=Path, help="a checkout of another version")
    parser.add_argument("--light", action="store_true", help="few cells, few periods: rough numbers")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    options = parsed(parser)
    if options.serve:
        serve()
        return
    roots = [root for root in (options.against, ROOT) if root]
    asked = cases(options.light, alone=options.against is None)
    best = np.full((len(asked), len(roots)), np.inf)
    for _ in range(1 if options.light else LAUNCHES):
        versions = [Version(root) for root in roots]
        for k, case in enumerate(asked):
            for _ in range(1 + (1 if options.light else ROUNDS)):
                best[k] = np.minimum(best[k], [version.measure(case) for version in versions])
        for version in versions:
            version.end()
    versions_head = ["the other version", "this version", "ratio"] if options.against else ["this version"]
    rows: dict[str, list[list[str]]] = {"cell": [], "period": []}
    for case, found in zip(asked, best, strict=True):
        numbers = [f"{b:.3f}" for b in found] + ([f"{found[0] / found[1]:.2f}"] if options.against else [])
        if "kind" in case:
            rows["cell"].append([DESCRIBED[case["kind"]], *numbers])
        else:
            what = case.get("system") or f"Fig. {case['figure']}"
            rows["period"].append([f"{what}, exponents: {case['exponents']}", *numbers])
    print_table("cell", ["milliseconds a cell", *versions_head], rows["cell"], options.keep)
    print()
    print_table("period", ["microseconds a period", *versions_head], rows["period"], False)


if __name__ == "__main__":
    main()
