"""Solve random cells over the whole parameter space, of the two-mass oscillator and of random systems, and report
what goes wrong.

A random system is any linear machine with one gap, given as a definition: 1, 2, 3 or 8 masses, damping of any kind,
rigid modes, loads, up to four harmonics, one stop or two. Others are machines with soft and several contacts, friction
and phases (stress_modes.py). Every cell's results are checked for NaN and infinity where
none belongs, for contradictions, for positions beyond a stop and against the law of the exponents' sum. Some cells are
re-evaluated by the independent simulator of the tests: their first flights (no crossing missed) and
their orbit over up to 20 periods in multiprecision.

Cells depend on the seed and their number alone. The work is spread over local processes by Dask. What the report lists
can be solved again alone: it gives the parameters, and a random system's whole definition.
Usage: python -m scripts.stress [--cells N] [--systems SHARE] [--modes SHARE] [--seed S] [--workers W]
    [--light] [--json] [--report FILE] [--keep]
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scripts.measured import keep_table, parsed
from scripts.stress import modes as stress_modes
from scripts.stress.findings import StressFindings
from scripts.stress.orbit_checks import recheck
from scripts.stress.report import report, summary, table
from scripts.stress.result_checks import cells_of, solve
from scripts.stress.systems import CELLS
from workers import Settings

TILE, RECHECKED = 5 * CELLS, 4
"""Cells of one task, solved and re-evaluated."""

SYSTEMS = 1 / 3
"""Share of the cells that are of random systems."""

MODES = 1 / 6
"""Share of the cells that are of machines with modes."""


@dataclass(frozen=True)
class Task:
    """Cells of a seed by number, of one kind, see stress_results.cells_of, to be solved or re-evaluated."""

    seed: int
    kind: str
    numbers: tuple[int, ...]
    max_periods: int
    recheck: bool


def perform(task: Task) -> StressFindings:
    """The findings over a task's cells."""
    settings = Settings(
        exponents="spectrum", max_periods=task.max_periods, survival=0, tolerance=0.05, section_samples=4
    )
    with_modes = task.kind == stress_modes.KIND
    if with_modes:
        cells = [stress_modes.draw_of_modes(task.seed, number) for number in task.numbers]
    else:
        cells = cells_of(task.seed, task.kind == "systems", task.numbers)
    if not task.recheck:
        return stress_modes.solve(cells, settings) if with_modes else solve(cells, settings)
    found = StressFindings()
    for cell in cells:
        found.add(stress_modes.recheck(cell, settings) if with_modes else recheck(cell, orbit=True))
    return found


def tasks(seed: int, cells: int, systems: float, modes: float, rechecked: int, max_periods: int) -> list[Task]:
    """All tasks, the slow ones first; shares of kinds hold for cells solved and re-evaluated."""
    slow: list[Task] = []
    quick: list[Task] = []
    for kind, part in (("systems", systems), (stress_modes.KIND, modes), ("two-mass", 1.0 - systems - modes)):
        count, checked = round(cells * part), round(rechecked * part)
        # Re-evaluated cells are spread over all, so that they are of many systems.
        spread_out = [k * count // checked for k in range(checked)]
        for numbers, size, again, into in (
            (spread_out, RECHECKED, True, slow), (range(count), TILE, False, quick),
        ):  # fmt: skip
            into += [
                Task(seed, kind, tuple(numbers[k : k + size]), max_periods, again) for k in range(0, len(numbers), size)
            ]
    return slow + quick


def spread(work: list[Task], workers: int) -> Iterator[StressFindings]:
    """The findings of each task as they come, from so many processes; 0 for this one."""
    if workers == 0:
        yield from map(perform, work)
        return
    from distributed import Client, LocalCluster, as_completed

    cluster = LocalCluster(
        n_workers=workers, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0", security=True
    )
    with cluster, Client(cluster) as client:
        futures = as_completed(client.map(perform, work, pure=False), with_results=True)
        for future, findings in futures:
            future.release()
            yield findings


def run(
    cells: int,
    seed: int,
    rechecked: int,
    max_periods: int,
    workers: int,
    systems: float = SYSTEMS,
    modes: float = MODES,
    progress: bool = False,
) -> dict[str, Any]:
    """Solve and check; the summary."""
    begun = time.perf_counter()
    work = tasks(seed, cells, systems, modes, rechecked, max_periods)
    found = StressFindings()
    for done, findings in enumerate(spread(work, workers), start=1):
        found.add(findings)
        if progress and (done % 20 == 0 or done == len(work)):
            print(f"{done} of {len(work)} tasks, {time.perf_counter() - begun:.0f} s", file=sys.stderr, flush=True)
    arguments = {
        "seed": seed, "systems": systems, "modes": modes, "rechecked": rechecked, "max_periods": max_periods,
        "workers": workers,
    }  # fmt: skip
    return summary(found, time.perf_counter() - begun, arguments)


def failed(facts: dict[str, Any]) -> bool:
    """Whether something happened that must not."""
    return any(facts["never"].values()) or facts["sum_law_broken"] > 0


def main(argv: list[str] | None = None) -> int:
    """Run and print the report; 1 if something happened that must not, else 0."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cells", type=int, default=100_000)
    parser.add_argument(
        "--systems", type=float, default=SYSTEMS, metavar="SHARE", help="share that is of random systems"
    )
    parser.add_argument(
        "--modes", type=float, default=MODES, metavar="SHARE", help="share that is of machines with modes"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--recheck", type=int, default=1000, help="cells re-evaluated by the independent simulator")
    parser.add_argument("--max-periods", type=int, default=400)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes; 0 for this one alone")
    parser.add_argument("--light", action="store_true", help="240 cells, 12 of them re-evaluated, in this process")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the report there as well")
    options = parsed(parser, argv)
    for name in ("systems", "modes"):
        share = getattr(options, name)
        if not 0.0 <= share <= 1.0:
            parser.error(f"--{name}: found {share:g}, must be 0 to 1")
    if options.systems + options.modes > 1.0:
        parser.error(f"--systems and --modes: found {options.systems + options.modes:g} together, must be 0 to 1")
    if options.light:
        options.cells, options.recheck, options.workers = 240, 12, 0
    facts = run(
        options.cells, options.seed, options.recheck, options.max_periods, options.workers, options.systems,
        options.modes, progress=not (options.light or options.json),
    )  # fmt: skip
    if options.report:
        options.report.write_text(report(facts), encoding="utf-8")
    print(json.dumps(facts, allow_nan=False) if options.json else report(facts), end="" if not options.json else "\n")
    if options.keep:
        keep_table("stress" if options.modes < 1.0 else "stress-modes", ("", "found"), table(facts))
    return 1 if failed(facts) else 0


if __name__ == "__main__":
    sys.exit(main())
