"""Whether the error bars of chaotic cells are true: z of random cells against runs 20 times as long from their start.

Cells are drawn over all parameters, solved, and those that come out chaotic are averaged again by the fixed schedule
over 20 times as many periods. z = (largest - longer average) / (both errors together) should have a root mean square
of 1. Where the two differ by more than FAR, or the longer run ends on an orbit, the motion has changed on the way: such
pairs are counted apart and listed.

Usage: .venv/bin/python -m scripts.bench_error_bars [--chaotic 200] [--seed 1] [--tolerance .02]
"""

import argparse
import math
import multiprocessing
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scripts.bench_survival import solved
from workers import Settings
from workers.results import CHAOTIC

LONGER = 20
FAR = 5.0
"""Errors beyond which two averages are not of one motion: 1 in 2 million if errors are normal."""

RANGES = {
    "omega": (0.8, 5.0), "b": (0.02, 0.8), "R": (0.3, 0.98), "zeta": (0.005, 0.3), "mu_m": (0.5, 6.0),
    "mu_k": (0.5, 6.0), "f2": (0.0, 2.0),
}  # fmt: skip


def drawn(seed: int, count: int) -> dict[str, NDArray[Any]]:
    """So many random cells."""
    rng = np.random.default_rng(seed)
    return {name: rng.uniform(low, high, count) for name, (low, high) in RANGES.items()}


def compared(pool: Any, seed: int, wanted: int, tolerance: float) -> tuple[dict[str, Any], dict[str, Any]]:
    """Parameters of chaotic cells, and with them ``largest``, ``error``, ``again`` and ``again_error``."""
    params = drawn(seed, 20 * wanted)
    found, _ = solved(pool, params, Settings(tolerance=tolerance))
    rows = np.flatnonzero((found["regime"] == CHAOTIC) & (found["reason"] == 0))[:wanted]
    cells = {name: values[rows] for name, values in params.items()}
    used = found["periods_used"][rows]
    again, error, settled = (np.full(len(rows), math.nan) for _ in range(3))
    lengths = 2.0 ** np.ceil(np.log2(LONGER * used))  # few different ones: each is a solution of its own
    for length in np.unique(lengths):
        same = lengths == length
        settings = Settings(method="fixed", transient_periods=1000, periods=int(length), max_periods=int(length))
        longer, _ = solved(pool, {name: values[same] for name, values in cells.items()}, settings)
        again[same], error[same] = longer["largest"], longer["error"]
        settled[same] = longer["regime"] != CHAOTIC
    values = {"largest": found["largest"][rows], "error": found["error"][rows], "again": again, "again_error": error}
    return cells, values | {"settled": settled.astype(bool), "used": used}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--chaotic", type=int, default=200, help="chaotic cells compared")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--tolerance", type=float, default=0.02)
    options = parser.parse_args()
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        cells, values = compared(pool, options.seed, options.chaotic, options.tolerance)
    z = (values["largest"] - values["again"]) / np.hypot(values["error"], values["again_error"])
    changed = values["settled"] | ~(np.abs(z) <= FAR)
    still = z[~changed]
    rms, share = float(np.sqrt(np.mean(still**2))), float(np.mean(np.abs(still) > 2.0))
    print(f"{len(z)} chaotic cells, tolerance {options.tolerance}, against {LONGER} times as many periods")
    print(f"rms z {rms:.2f} of {len(still)} stationary pairs; beyond 2: {100 * share:.1f} % (4.6 % if normal)")
    print(f"changed on the way: {changed.sum()} ({100 * changed.mean():.1f} %)")
    for k in np.flatnonzero(changed):
        where = ", ".join(f"{name} {column[k]:.12g}" for name, column in cells.items())
        first = f"{values['largest'][k]:.4f} +- {values['error'][k]:.4f} after {values['used'][k]} periods"
        then = f"{values['again'][k]:.4f} +- {values['again_error'][k]:.4f}"
        print(f"  {first}, then {then}{' (settled)' if values['settled'][k] else ''}: {where}")


if __name__ == "__main__":
    main()
