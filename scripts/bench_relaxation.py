"""How often what is called chaotic settles later, by how fast the machine forgets.

Cells are drawn over all parameters. Those that come out chaotic with each ``survival`` are told apart by the forcing
periods in which their energy relaxes; *settles* are those that a watch of so many periods, the same for all of them,
sees settle on an orbit, or without impact, after they were called chaotic.

Usage: python -m scripts.bench_relaxation [--cells 16000] [--far 200000] [--survivals 0,48000]
"""

import argparse
import multiprocessing
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np

from scripts.bench_error_bars import drawn
from scripts.bench_survival import FURTHER, SETTLED, followed, solved
from scripts.measured import parsed, print_table
from workers import Settings
from workers.attractors.starts import wilson
from workers.results import CHAOTIC

EDGES = (0.0, 1.0, 2.0, 3.0, 5.0, 10.0, np.inf)
"""Forcing periods of relaxation between which cells are counted together."""


def rows(pool: Any, cells: int, seed: int, far: int, survivals: list[int], tolerance: float) -> Iterator[list[str]]:
    """The rows of the table, one for each range of relaxation times: three numbers for each survival."""
    params = drawn(seed, cells)
    called = [
        (survival, solved(pool, params, Settings(tolerance=tolerance, survival=survival))[0]) for survival in survivals
    ]
    looked_chaotic = np.flatnonzero(np.any([found["regime"] == CHAOTIC for _, found in called], axis=0))
    truth = followed(pool, {name: values[looked_chaotic] for name, values in params.items()}, far)
    settles = np.isin(truth["regime"], SETTLED)
    for low, high in pairwise(EDGES):
        row = [f"{low:g} to {high:g}" if np.isfinite(high) else f"{low:g} and more"]
        for _, found in called:
            used = found["periods_used"][looked_chaotic]
            here = (truth["relaxation"] >= low) & (truth["relaxation"] < high)
            here &= found["regime"][looked_chaotic] == CHAOTIC
            if not here.any():
                row += ["0", "", ""]
                continue
            wrong = int(np.sum(here & settles & (truth["periods_used"] <= used + FURTHER)))
            least, most = wilson(wrong, int(here.sum()))
            share = f"{100 * wrong / here.sum():.2f} ({100 * least:.1f} to {100 * most:.1f})"
            row += [str(here.sum()), share, f"{used[here].mean():,.0f}"]
        yield row


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, default=16_000)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--far", type=int, default=200_000, help="periods for which all are watched")
    parser.add_argument("--survivals", default="0,48000")
    parser.add_argument("--tolerance", type=float, default=0.02)
    options = parsed(parser)
    survivals = [int(survival) for survival in options.survivals.split(",")]
    head = ["relaxation, periods"]
    for survival in survivals:
        head += [f"chaotic at survival {survival:,}", "wrong, %", "periods a cell"]
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        table = list(rows(pool, options.cells, options.seed, options.far, survivals, options.tolerance))
    print_table("relaxation", head, table, options.keep)


if __name__ == "__main__":
    main()
