"""The order of tiles on a large cluster, simulated.

256 workers are simulated on the costs of a real atlas, each of its cells split into smaller ones, since it has too few
for so many: share of the workers' time spent solving, for each order of tiles. The bound is that of the costliest tile.
The plane is taken as it is and turned, since the order by rows depends on which corner is costly. "probe" solves some
cells of each tile beforehand, and pays for it.

Usage: python -m scripts.bench_order STORE... [--workers W] [--keep]
"""

import argparse
import heapq
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

import atlas
from atlas.service.dispatch import IN_FLIGHT
from atlas.service.schedule import Order
from scripts.measured import parsed, print_table

SPLIT = 4
"""Along each axis, into how many cells one cell of the real atlas is split."""
SIDES = (16, 10, 8)
"""Cells along each side of a tile, after the split."""
PROBED = 4
"""Cells of each tile that the probe solves."""


def costs_of(store: Path) -> np.ndarray:
    """Cost of every cell of an atlas, in impacts and periods, each cell split into smaller ones of its cost."""
    ds = atlas.open(store)
    impacts = np.nan_to_num(ds.impacts_per_period.values, nan=10.0)
    cells = ds.periods_used.values * (0.3 + impacts) + 20.0
    return np.kron(cells, np.ones((SPLIT, SPLIT)))


def tile_costs(cells: np.ndarray, side: int) -> np.ndarray:
    """Costs of tiles of that side."""
    rows, columns = (np.arange(n) // side for n in cells.shape)
    costs = np.zeros((rows[-1] + 1, columns[-1] + 1))
    np.add.at(costs, (rows[:, None], columns[None]), cells)
    return costs


def simulate(
    costs: np.ndarray,
    order: Iterable[tuple[int, ...]],
    workers: int,
    note: Callable[[tuple[int, ...], float], None] = lambda *_: None,
) -> float:
    """Time to the end of the last tile; the window is that of the dispatch, and a free worker takes what is queued."""
    waiting, queue = iter(order), deque[tuple[int, ...]]()
    busy: list[tuple[float, tuple[int, ...]]] = []
    now = 0.0
    while True:
        for _, index in zip(range(IN_FLIGHT * workers - len(queue) - len(busy)), waiting, strict=False):
            queue.append(index)
        while queue and len(busy) < workers:
            index = queue.popleft()
            heapq.heappush(busy, (now + float(costs[index]), index))
        if not busy:
            return now
        now, index = heapq.heappop(busy)
        note(index, float(costs[index]))


def efficiencies(cells: np.ndarray, side: int, workers: int) -> dict[str, float]:
    """Share of the workers' time spent solving, for each order of the tiles."""
    costs = tile_costs(cells, side)
    ideal = costs.sum() / workers
    learned = Order(np.ones(costs.shape, dtype=bool))
    guess = _probed(cells, costs.shape, side)
    return {
        "rows": ideal / simulate(costs, np.ndindex(costs.shape), workers),
        "lattice": ideal / simulate(costs, learned, workers, learned.note),
        "probe": ideal / (simulate(costs, _descending(guess), workers) + guess.sum() / workers),
        "oracle": ideal / simulate(costs, _descending(costs), workers),
        "bound": min(1.0, ideal / costs.max()),
    }


def _probed(cells: np.ndarray, shape: tuple[int, ...], side: int) -> np.ndarray:
    draw = np.random.default_rng(1)
    guess = np.zeros(shape)
    for _ in range(PROBED):
        places = (
            np.minimum(side * np.arange(n).reshape(along) + draw.integers(0, side, shape), top - 1)
            for n, top, along in zip(shape, cells.shape, ((-1, 1), (1, -1)), strict=True)
        )
        guess += cells[tuple(places)]
    return guess


def _descending(costs: np.ndarray) -> Iterator[tuple[int, ...]]:
    for place in np.argsort(-costs, axis=None, kind="stable"):
        yield tuple(map(int, np.unravel_index(place, costs.shape)))


ORDERS = {
    "rows": "row by row",
    "lattice": "lattice first",
    "probe": f"{PROBED} cells of each tile probed",
    "oracle": "costs known",
    "bound": "bound by the costliest tile",
}


def tiles_and_shares(cells: np.ndarray, side: int, workers: int) -> list[str]:
    """A row of the table: the number of tiles, and for each order its shares in per cent, one per orientation."""
    turned = (cells, cells[::-1], cells.T, cells.T[::-1])
    shares = [efficiencies(plane, side, workers) for plane in turned]
    row = [f"{tile_costs(cells, side).size:,}"]
    for order in ORDERS:
        each = [f"{100 * share[order]:.0f}" for share in shares]
        row.append(f"{each[0] if len(set(each)) == 1 else ', '.join(each)} %")
    return row


def main(argv: list[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("store", type=Path, nargs="+", help="the atlases whose costs are taken")
    parser.add_argument("--workers", type=int, default=256)
    given = parsed(parser, argv)
    planes = [costs_of(store) for store in given.store]
    rows = [tiles_and_shares(cells, side, given.workers) for cells in planes for side in SIDES]
    print_table(
        "order", ["tiles", *ORDERS.values()], sorted(rows, key=lambda row: int(row[0].replace(",", ""))), given.keep
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
