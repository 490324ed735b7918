"""Solve random cells over the whole parameter space and report what goes wrong.

Every cell's results are checked for NaN and infinity where none belongs, for positions beyond a stop and against the
law of the exponents' sum. Some cells are re-evaluated by the independent simulator of the tests: their first flights
by dense sampling (no crossing missed), their orbit over up to 20 periods in multiprecision.

Cells depend on the seed and their number alone. The work is spread over local processes by Dask.
Usage: .venv/bin/python -m scripts.stress [--cells N] [--seed S] [--workers W] [--light] [--json] [--report FILE]
"""

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scripts.stress_cells import LISTED, SUM_LAW, Findings, Params, solve
from scripts.stress_checks import recheck
from workers import Settings

TILE, RECHECKED = 100, 4
"""Cells of one task, solved and re-evaluated."""

NEVER = (
    "NaN or infinity where none belongs",
    "position beyond a stop",
    "crossing missed",
    "a state beyond a stop not recognised",
)
"""What must not happen to a single cell."""

FAILURES = 1e-4
"""Share of the cells that may fail."""


@dataclass(frozen=True)
class Task:
    """Cells ``first`` to ``first + count`` of a seed, to be solved or re-evaluated."""

    seed: int
    first: int
    count: int
    max_periods: int
    recheck: bool


def perform(task: Task) -> Findings:
    """The findings over a task's cells."""
    if not task.recheck:
        settings = Settings(
            exponents="spectrum", max_periods=task.max_periods, survival=0, tolerance=0.05, section_samples=4
        )
        return solve(task.seed, task.first, task.count, settings)
    found = Findings()
    for number in range(task.first, task.first + task.count):
        found.add(recheck(task.seed, number, orbit=True))
    return found


def tasks(seed: int, cells: int, rechecked: int, max_periods: int) -> list[Task]:
    """All tasks, the slow ones first."""
    result = [
        Task(seed, first, min(RECHECKED, rechecked - first), max_periods, True)
        for first in range(0, rechecked, RECHECKED)
    ]
    result += [Task(seed, first, min(TILE, cells - first), max_periods, False) for first in range(0, cells, TILE)]
    return result


def spread(work: list[Task], workers: int) -> Iterator[Findings]:
    """The findings of each task as they come, from so many processes; 0 for this one."""
    if workers == 0:
        yield from map(perform, work)
        return
    from distributed import Client, LocalCluster, as_completed

    cluster = LocalCluster(n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None)
    with cluster, Client(cluster) as client:
        futures = as_completed(client.map(perform, work, pure=False), with_results=True)
        for future, findings in futures:
            future.release()
            yield findings


def summary(found: Findings, seconds: float, arguments: dict[str, Any]) -> dict[str, Any]:
    """Everything that was found, as plain values; NaN and infinity as None."""

    def listed(kind: str) -> list[dict[str, Any]]:
        return [{"what": what, "cell": number, "parameters": p} for what, number, p in found.listed.get(kind, [])]

    return {
        **arguments,
        "wall_seconds": round(seconds, 1),
        "cells": found.cells,
        "processor_seconds": round(found.seconds, 1),
        "regimes": dict(found.regimes.most_common()),
        "with_impacts": found.impacting,
        "sticking": found.sticking,
        "invalid": dict(found.invalid.most_common()),
        "failed": dict(found.stopped.most_common()),
        "failed_share": sum(found.stopped.values()) / max(1, found.cells),
        "given_up": found.counts["given up, said to be undetermined"],
        "never": {kind: found.counts[kind] for kind in NEVER},
        "checked": dict(sorted(found.checked.items())),
        "sum_law_broken": found.counts["sum law broken by a periodic cell"],
        "worst": {
            kind: {"value": value if math.isfinite(value) else None, "cell": number, "parameters": p}
            for kind, (value, number, p) in sorted(found.worst.items())
        },
        "distributions": {
            kind: dict(zip(("median", "90%", "99%", "max"), np.percentile(values, [50, 90, 99, 100]), strict=True))
            for kind, values in sorted(found.samples.items())
        },
        "listed": {kind: listed(kind) for kind in sorted(found.listed)},
    }


def _cell(number: int, params: Params) -> str:
    return f"cell {number}: " + " ".join(f"{name}={value!r}" for name, value in params.items())


def report(facts: dict[str, Any]) -> str:
    """The summary in words."""
    cells = facts["cells"]

    def counted(counts: dict[str, int]) -> list[str]:
        return [f"  {count:8d}  {100.0 * count / cells:8.4f} %  {what}" for what, count in counts.items()]

    lines = [
        f"Stress report: {cells} random cells, seed {facts['seed']}, at most {facts['max_periods']} periods a cell",
        f"{facts['wall_seconds']:.0f} s wall, {facts['processor_seconds']:.0f} s of processor time to solve; "
        f"{facts['with_impacts']} with impacts, {facts['sticking']} stick",
        "", "Regimes", *counted(facts["regimes"]),
        "", "Invalid, by reason", *counted(facts["invalid"]),
        "", f"Failed, by reason (share {facts['failed_share']:.1e}, goal below {FAILURES:.0e})",
        *counted(facts["failed"]),
        f"  {facts['given_up']:8d}  {100.0 * facts['given_up'] / cells:8.4f} %  given up for their cost, undetermined",
        "", "Must be 0", *(f"  {count:8d}  {kind}" for kind, count in facts["never"].items()),
        f"  {facts['sum_law_broken']:8d}  sum law of a periodic cell off by more than {SUM_LAW:.0e}",
        "", "Checked", *(f"  {count:8d}  {kind}" for kind, count in facts["checked"].items()),
        "", "Worst",
    ]  # fmt: skip
    for kind, worst in facts["worst"].items():
        value = "none" if worst["value"] is None else f"{worst['value']:.3g}"
        lines += [f"  {value:>10}  {kind}", f"              {_cell(worst['cell'], worst['parameters'])}"]
    lines += ["", "Orbits against the independent simulator, in eps x state size x norm of the accumulated Jacobian"]
    for kind, values in facts["distributions"].items():
        lines.append(f"  {kind}: " + ", ".join(f"{name} {value:.3g}" for name, value in values.items()))
    for kind, listed in facts["listed"].items():
        lines += ["", f"{kind} (the first {LISTED})"]
        lines += [f"  {one['what']}\n    {_cell(one['cell'], one['parameters'])}" for one in listed]
    return "\n".join(lines) + "\n"


def run(
    cells: int, seed: int, rechecked: int, max_periods: int, workers: int, progress: bool = False
) -> dict[str, Any]:
    """Solve and check; the summary."""
    begun = time.perf_counter()
    work = tasks(seed, cells, rechecked, max_periods)
    found = Findings()
    for done, findings in enumerate(spread(work, workers), start=1):
        found.add(findings)
        if progress and (done % 20 == 0 or done == len(work)):
            print(f"{done} of {len(work)} tasks, {time.perf_counter() - begun:.0f} s", file=sys.stderr, flush=True)
    arguments = {"seed": seed, "rechecked": rechecked, "max_periods": max_periods, "workers": workers}
    return summary(found, time.perf_counter() - begun, arguments)


def failed(facts: dict[str, Any]) -> bool:
    """Whether something happened that must not."""
    return any(facts["never"].values()) or facts["sum_law_broken"] > 0


def main(argv: list[str] | None = None) -> int:
    """Run and print the report; 1 if something happened that must not, else 0."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cells", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--recheck", type=int, default=1000, help="cells re-evaluated by the independent simulator")
    parser.add_argument("--max-periods", type=int, default=400)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes; 0 for this one alone")
    parser.add_argument("--light", action="store_true", help="200 cells, 4 of them re-evaluated, in this process")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the report there as well")
    options = parser.parse_args(argv)
    if options.light:
        options.cells, options.recheck, options.workers = 200, 4, 0
    facts = run(
        options.cells, options.seed, options.recheck, options.max_periods, options.workers,
        progress=not (options.light or options.json),
    )  # fmt: skip
    if options.report:
        options.report.write_text(report(facts), encoding="utf-8")
    print(json.dumps(facts, allow_nan=False) if options.json else report(facts), end="" if not options.json else "\n")
    return 1 if failed(facts) else 0


if __name__ == "__main__":
    sys.exit(main())
