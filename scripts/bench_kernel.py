"""Microseconds per forcing period of the solver, as a ratio to a general integrator measured in the same run.

The cells are those of Figs 3, 4 and 5 of Li & Tan (2011); no, one or all four Lyapunov exponents; and one of the system
soft-impact, which touches its soft stop once a period, beside heyoka alone. The references are
heyoka (heyoka_reference.py, tolerance 1e-10) and scipy's DOP853 (rtol 1e-10, atol 1e-12), with event location at the
stops, the variational equations beside the state, the saltation matrix at every impact and one QR per period. DOP853 is
measured twice: plain, with the right-hand side in numpy and scipy's own first step after each impact; and tuned, with a
right-hand side compiled by Numba and the step size kept across impacts.

All are timed in processor time on one core, best of several: the solver on many cells side by side and on one alone, as
the difference of two lengths of the same run, so that start-up and transient cancel, the references after a transient.

Usage: python -m scripts.bench_kernel [--light] [--json] [--keep]
"""

import argparse
import json
import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scripts.general_integrator import FIGURES, GeneralIntegrator, numpy_rates
from scripts.heyoka_reference import INSTALLED, SoftTaylor, Taylor
from scripts.measured import parsed, print_table
from workers import Settings, solve_tile
from workers.cell.interval import run_periods
from workers.kernel.coordinates import motion_from
from workers.kernel.motion import EVALUATIONS
from workers.model.oscillator import COLUMN
from workers.model.system import find_system

Array = NDArray[np.float64]

SETTINGS_NAME = {0: "none", 1: "largest", 2: "spectrum", 4: "spectrum"}


def processor_seconds(work: Callable[[], object]) -> float:
    """Processor time that a call takes."""
    start = time.process_time()
    work()
    return time.process_time() - start


@dataclass(frozen=True)
class Schedule:
    """How long to measure: periods of the solver's runs, side by side and alone, and of the references; repetitions."""

    short: int
    long: int
    alone: int
    warm: int
    periods: int
    taylor: int
    repeats: int


FULL = Schedule(short=200, long=2200, alone=42000, warm=30, periods=50, taylor=4000, repeats=5)
LIGHT = Schedule(short=50, long=550, alone=2100, warm=5, periods=5, taylor=400, repeats=2)
TRANSIENT = 200
CELLS = 256
"""Cells side by side, with slightly different b, so that nothing can be shared between them."""


def in_turn(repeats: int, *works: Callable[[], float]) -> list[float]:
    """The least that each of these gives, taken in turn so many times: a busy spell of the machine hits all alike."""
    return [min(given) for given in zip(*([work() for work in works] for _ in range(repeats)), strict=True)]


def solver(
    params: dict[str, Any], exponents: int, periods: int, system: str = "two-mass"
) -> Callable[[], dict[str, NDArray[Any]]]:
    """The solver on these cells, side by side if there are several, for so many periods."""
    settings = Settings(
        method="fixed", exponents=SETTINGS_NAME[exponents], transient_periods=TRANSIENT, periods=periods
    )
    return lambda: solve_tile(system, params, settings)


def reference_cost(integrator: GeneralIntegrator, schedule: Schedule) -> tuple[float, list[float]]:
    """The reference's microseconds per period after a transient, and the exponents over the same periods."""
    integrator.run(schedule.warm)
    integrator.restart_average()
    seconds = min(processor_seconds(lambda: integrator.run(schedule.periods)) for _ in range(schedule.repeats))
    return 1e6 * seconds / schedule.periods, integrator.exponents.tolist()


def taylor(params: dict[str, float], exponents: int, schedule: Schedule) -> Callable[[], float]:
    """Seconds of heyoka for schedule.taylor / 2 periods; NaN where it is not installed."""
    if not INSTALLED:
        return lambda: math.nan
    integrator = Taylor(exponents)

    def seconds() -> float:
        first, second = integrator.run(params, (schedule.taylor // 2, schedule.taylor))
        return second[1] - first[1]

    return seconds


def counts(params: dict[str, float], periods: int = 1000) -> tuple[float, float]:
    """Evaluations per period on the attractor, and their exponentials, sines and cosines.

    A block has one of each, and two exponentials more where overdamped; the force a sine and a cosine. The first
    evaluation of a flight needs none, the one at its end is not counted by the march: they make up for each other.
    """
    system = find_system("two-mass")
    osc = system.build({parameter.name: parameter.default for parameter in system.parameters} | params)
    motion = motion_from(osc, np.zeros(len(system.states)))
    run_periods(osc, motion, periods)
    before = float(motion.tally[EVALUATIONS])
    run_periods(osc, motion, periods)
    count = (float(motion.tally[EVALUATIONS]) - before) / periods
    return count, count * (2 + sum(3 if d > 0.0 else 5 for d in osc.gap.blocks[:, COLUMN.d]))


def measure(schedule: Schedule) -> list[dict[str, Any]]:
    """One row per figure and number of exponents."""
    rows = []
    for figure, params in FIGURES.items():
        beside = params | {"b": params["b"] * (1.0 + 1e-5 * np.arange(CELLS))}
        count, calls = counts(params)
        for exponents in (0, 1, 4):
            lengths = (schedule.long, schedule.short)
            works = [solver(beside, exponents, length) for length in lengths]
            works += [solver(params, exponents, length) for length in (schedule.alone, schedule.alone // 20)]
            found = works[0]()  # compiles, or loads what an earlier run compiled
            averages = np.ravel(found["average"])[:exponents] if exponents else np.zeros(0)
            timed = [partial(processor_seconds, work) for work in works]
            slow, fast, alone, brief, reference = in_turn(schedule.repeats, *timed, taylor(params, exponents, schedule))
            together = 1e6 * (slow - fast) / (schedule.long - schedule.short) / CELLS
            row: dict[str, Any] = {
                "figure": figure,
                "exponents": exponents,
                "solver_us_per_period": together,
                "solver_alone_us_per_period": 1e6 * (alone - brief) / (schedule.alone - schedule.alone // 20),
                "heyoka_us_per_period": 1e6 * reference / (schedule.taylor - schedule.taylor // 2),
                "evaluations_per_period": count,
                "transcendentals_per_period": calls,
                "solver_exponents": averages.tolist(),
            }
            row["heyoka_ratio"] = row["heyoka_us_per_period"] / together
            if exponents:
                plain, check = reference_cost(GeneralIntegrator(params, exponents, numpy_rates), schedule)
                tuned, _ = reference_cost(GeneralIntegrator(params, exponents, keep_step=True), schedule)
                row |= {"dop853_us_per_period": plain, "dop853_tuned_us_per_period": tuned, "dop853_exponents": check}
                row |= {"ratio": plain / together, "ratio_tuned": tuned / together}
            rows.append(row)
    return rows


SOFT = {"omega": 0.95, "a": 0.8, "beta": 29.0, "e": 1.26, "zeta": 0.01}
"""A cell of soft-impact whose motion of period 1 touches the stop once a period."""


SOFT_COLUMNS = ("solver_us_per_period", "heyoka_us_per_period", "heyoka_ratio")


def measure_soft(schedule: Schedule) -> list[dict[str, Any]]:
    """One row per number of exponents of the soft stop: microseconds per period of the solver and of heyoka."""
    rows = []
    beside = SOFT | {"a": SOFT["a"] * (1.0 + 1e-5 * np.arange(CELLS))}
    for exponents in (0, 1, 2):
        works = [solver(beside, exponents, length, "soft-impact") for length in (schedule.long, schedule.short)]
        found = works[0]()
        timed = [partial(processor_seconds, work) for work in works]
        theirs: list[Array] = []

        def taylor_seconds(exponents: int = exponents, theirs: list[Array] = theirs) -> float:
            if not INSTALLED:
                return math.nan
            seconds, growth = SoftTaylor(exponents).run(SOFT, schedule.taylor)
            theirs.append(growth)
            return seconds

        slow, fast, reference = in_turn(schedule.repeats, *timed, taylor_seconds)
        ours = 1e6 * (slow - fast) / (schedule.long - schedule.short) / CELLS
        heyoka = 1e6 * reference / (schedule.taylor // 2)
        averages = np.ravel(found["average"])[:exponents].tolist() if exponents else []
        row: dict[str, Any] = {
            "figure": "soft stop",
            "exponents": exponents,
            "solver_us_per_period": ours,
            "heyoka_us_per_period": heyoka,
        }
        row |= {"heyoka_ratio": heyoka / ours, "solver_exponents": averages}
        rows.append(row | {"heyoka_exponents": theirs[-1].tolist() if theirs else []})
    return rows


def one_core() -> None:
    """Stay on one core, so that all sides run on the same one."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--light", action="store_true", help="short runs: seconds, rough numbers")
    parser.add_argument("--json", action="store_true", help="one JSON list on standard output, nothing else")
    options = parsed(parser)
    one_core()
    schedule = LIGHT if options.light else FULL
    rows, soft = measure(schedule), measure_soft(schedule)
    if options.json:
        print(json.dumps(rows + soft))
        return
    names = ["figure", "exponents", "batch, µs", "single, µs", "heyoka, µs", "ratio"]
    table = []
    for row in rows:
        columns = [f"{row['solver_us_per_period']:.2f}", f"{row['solver_alone_us_per_period']:.2f}"]
        columns += [f"{row['heyoka_us_per_period']:.1f}", f"{row['heyoka_ratio']:.1f}"]
        for name in ("dop853_us_per_period", "ratio", "dop853_tuned_us_per_period", "ratio_tuned"):
            columns.append(f"{row[name]:.0f}" if name in row else "")
        table.append([row["figure"], str(row["exponents"]), *columns])
    print_table("kernel", [*names, "DOP853, µs", "ratio", "tuned, µs", "ratio"], table, options.keep)
    for row in rows[::3]:
        count, calls = row["evaluations_per_period"], row["transcendentals_per_period"]
        print(f"Fig. {row['figure']}: {count:.2f} evaluations of two blocks and the force, {calls:.0f} exp, sin or cos")
    for row in rows:
        if row["exponents"] == 4:
            ours, check = ("  ".join(f"{x:.3f}" for x in row[f"{side}_exponents"]) for side in ("solver", "dop853"))
            print(f"Fig. {row['figure']}, exponents per period: {ours} (DOP853, fewer periods: {check})")
    table = [[str(row["exponents"]), *(f"{row[name]:.2f}" for name in SOFT_COLUMNS)] for row in soft]
    print_table("kernel-soft", ["exponents", "solver, µs a period", "heyoka, µs", "ratio"], table, options.keep)


if __name__ == "__main__":
    main()
