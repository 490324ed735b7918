"""How often two attractors that are not periodic are taken for one, and how often one is taken for two.

Of random cells of a symmetric machine whose motion from rest is chaotic or on a torus, two sets of motions are put to
the attractor of that motion, by the statistics by which all attractors of a cell are told apart:

own       motions that begin at states of that very motion, later on: on one attractor by construction
image     motions that begin at the mirror images of such states. Whether the mirror image is another attractor, two
          runs of PERIODS periods decide, in blocks of BLOCK: where one of the means of their section states, or of
          their squares, differs by more than CLEAR standard errors they are two, below SAME they are one, between
          these it is not clear, and they count for nothing.

A lump is a motion on another attractor that is put to the one known; a split one on it that is not. Rates come with
95 % Wilson intervals. Motions of one cell depend on each other, so cells are counted too.

Usage: .venv/bin/python -m scripts.check_lumps [--cells N] [--motions N] [--seed N]
"""

import argparse
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scripts.measured import parsed, print_table
from workers.attractors.basins import AttractorTable, added
from workers.attractors.record import STATISTICAL
from workers.attractors.same import distance, mirrored
from workers.attractors.starts import Starts, wilson
from workers.model.system import find_system
from workers.settings import Settings
from workers.tile import solve_tile

SYSTEM = "two-mass"
RANGES = {"omega": (0.5, 4.5), "b": (0.02, 0.8)}
"""Of the random cells."""
SETTINGS = Settings(exponents="none")
PERIODS, BLOCK = 16_384, 512
LONG = Settings(exponents="none", max_periods=20_000, survival=32 * PERIODS, section_samples=PERIODS)
"""A 32nd of ``survival`` is what chaos is watched for at least: all of the section states."""
CLEAR, SAME = 8.0, 4.0

Array = NDArray[np.float64]


@dataclass
class Counts:
    """Motions and cells of one set: how many there are, and how many were put where they do not belong."""

    motions: int = 0
    wrong: int = 0
    cells: int = 0
    cells_wrong: int = 0

    def add(self, motions: int, wrong: int) -> None:
        """Count one cell."""
        self.motions, self.wrong = self.motions + motions, self.wrong + wrong
        self.cells, self.cells_wrong = self.cells + 1, self.cells_wrong + (wrong > 0)

    def columns(self) -> list[str]:
        """Mistakes among motions with their 95 % interval, then among cells."""
        found = []
        for hits, count in ((self.wrong, self.motions), (self.cells_wrong, self.cells)):
            low, high = wilson(hits, count)
            found += [f"{hits} of {count}", f"{100 * float(low):.1f} to {100 * float(high):.1f} %"]
        return found


@dataclass
class Found:
    """What all cells have shown: splits of motions on one attractor, lumps of those on two; cells that show nothing."""

    splits: Counts = field(default_factory=Counts)
    lumps: Counts = field(default_factory=Counts)
    unclear: int = 0


def sections(cell: dict[str, float], names: tuple[str, ...], state: Array) -> Array | None:
    """Section states (PERIODS, 2n) of the motion from a state; None where it comes to an orbit."""
    solved = solve_tile(SYSTEM, cell | dict(zip(names, state.tolist(), strict=True)), LONG)
    found = np.asarray(solved["section"], dtype=np.float64)
    return found if int(solved["regime"]) in STATISTICAL and np.isfinite(found).all() else None


def apart(one: Array, other: Array) -> float:
    """How far apart two long runs are in standard errors, by means over blocks."""
    blocks = [run.reshape(-1, BLOCK, run.shape[1]) for run in (one, other)]
    first, second = (np.concatenate([b.mean(axis=1), (b * b).mean(axis=1)], axis=1) for b in blocks)
    return distance(first, second)


def put_elsewhere(table: AttractorTable, states: Array) -> int:
    """How many motions from states (N, 2n) are not put to the only attractor of a table."""
    wrong = 0
    for state in states:
        wrong += int(added(table, state[None])[0]) != 0
        del table.attractors[1:]
    return wrong


def check(cell: dict[str, float], motions: int, found: Found) -> str:
    """Count what one cell shows; in words."""
    record = find_system(SYSTEM)
    values = {p.name: float(cell.get(p.name, p.default)) for p in record.parameters}
    table = AttractorTable(record, values, SETTINGS, Starts(1))
    if not table.attractors or table.attractors[0].regime not in STATISTICAL:
        return ""
    state = np.asarray(table.attractors[0].result["state"])
    own = sections(cell, record.states, state)
    contact = np.array([table.attractors[0].contact])
    image = sections(cell, record.states, mirrored(table.oscillators, state[None], contact)[0][0])
    if own is None or image is None:
        return "comes to an orbit"
    places = np.linspace(0, PERIODS - 1, motions).astype(int)
    away, split = apart(own, image), put_elsewhere(table, own[places])
    told = f"mirror image {away:.1f} standard errors away"
    if away < SAME:
        split += put_elsewhere(table, image[places])
        found.splits.add(2 * motions, split)
        return f"{told}, the same attractor: splits {split}"
    found.splits.add(motions, split)
    if away > CLEAR:
        lumped = motions - put_elsewhere(table, image[places])
        found.lumps.add(motions, lumped)
        return f"{told}, another attractor: splits {split}, lumps {lumped}"
    found.unclear += 1
    return f"{told}, not clear: splits {split}"


def main(arguments: list[str] | None = None) -> None:
    """Print each cell, then the rates."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=60, help="cells whose motion is not periodic")
    parser.add_argument("--motions", type=int, default=8, help="motions of each set in a cell")
    parser.add_argument("--seed", type=int, nargs="*", default=[1])
    asked = parsed(parser, arguments)
    found, begin = Found(), time.perf_counter()
    for seed in asked.seed:
        check_cells(asked.cells, asked.motions, seed, found)
    rows = [
        ["one attractor counted as two", *found.splits.columns()],
        ["two attractors, mirror images of each other, counted as one", *found.lumps.columns()],
    ]
    print_table("lumps", ["mistake", "motions", "95 % interval", "cells", "95 % interval"], rows, asked.keep)
    print(f"not clear: {found.unclear} cells; {time.perf_counter() - begin:.0f} s")


def check_cells(cells: int, motions: int, seed: int, found: Found) -> None:
    """Count what random cells show, and print a line for each."""
    rng, shown = np.random.default_rng(seed), 0
    while shown < cells:
        cell: dict[str, Any] = {name: float(rng.uniform(*ends)) for name, ends in RANGES.items()}
        told = check(cell, motions, found)
        if told:
            shown += 1
            where = " ".join(f"{name} {value:.4f}" for name, value in cell.items())
            print(f"{shown} {where}: {told}", flush=True)


if __name__ == "__main__":
    main()
