"""Random zooming in an atlas for some minutes: is memory bounded, is no tile solved twice, is the store fine?

Usage: python -m scripts.explore_soak STORE [--minutes 20] [--seed 1] [--pixels 500x400]

Looks as a page does, picture by picture, without a browser; the store is explored in place.
"""

import argparse
import random
import resource
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from distributed import Client

import atlas
from atlas.explore.chosen import Chosen, beginning
from atlas.explore.explorer import Explorer
from atlas.explore.painter import Painter
from atlas.explore.subject import subject_of
from atlas.service.cluster import local_cluster

STAY = (0.5, 6.0)
"""Seconds between two moves, at least and at most."""


def moved(chosen: Chosen, start: Chosen, draw: random.Random) -> Chosen:
    """The next window: mostly a zoom in at a random point, now and then out, back, aside or to another kind."""
    what = draw.random()
    if what < 0.1:
        return replace(start, kind=chosen.kind)
    if what < 0.2:
        return replace(chosen, kind=draw.choice(["exponent", "period", "impacts", "combined"]))
    factor = 0.35 if what < 0.75 else 2.5 if what < 0.9 else 1.0
    sides = []
    for low, high in (chosen.x, chosen.y):
        centre, half = draw.uniform(low, high), 0.5 * (high - low) * factor
        sides.append((centre - half, centre + half))
    deep = (start.x[1] - start.x[0]) / (sides[0][1] - sides[0][0]) > 1e6
    return start if deep else replace(chosen, x=sides[0], y=sides[1])


def resident() -> float:
    """MiB of memory that this process has now, the local cluster's scheduler in it (Linux)."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 2**20


def main() -> None:
    """Zoom, report every half minute, verify."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("store")
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--pixels", default="500x400")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    size = tuple(map(int, given.pixels.split("x")))
    draw, counts, pictures = random.Random(given.seed), Counter[object](), 0
    clients: list[Client] = []

    @contextmanager
    def connect() -> Iterator[Client]:
        with local_cluster(given.workers) as client:
            clients.append(client)
            yield client

    def painted(_: object) -> None:
        nonlocal pictures
        pictures += 1

    explorer = Explorer(subject_of(given.store), connect)
    explorer.listen("soak", lambda plane, key: counts.update([(plane, key)]))
    painter = Painter(explorer, painted, print)
    start = beginning(explorer.subject)
    chosen, begin, told, moves = start, time.monotonic(), 0.0, 0
    try:
        while (spent := time.monotonic() - begin) < 60.0 * given.minutes:
            painter.show(chosen, (size[0], size[1]))
            time.sleep(draw.uniform(*STAY))
            chosen, moves = moved(chosen, start, draw), moves + 1
            if spent - told >= 30.0 or told == 0.0:
                told = max(spent, 1e-3)
                done = f"{moves:4d} moves  {pictures:5d} pictures  {sum(counts.values()):6d} tiles solved"
                memory = f"{resident():5.0f} MiB, of it tiles {explorer.known.tiles.bytes / 2**20:4.0f} MiB"
                print(f"{spent:5.0f} s  {done}  server and scheduler {memory}", flush=True)
    finally:
        painter.close()
        explorer.stop()
    twice = sum(1 for count in counts.values() if count > 1)
    print(f"tiles solved twice: {twice} of {len(counts)}; failed: {len(explorer.failures)}")
    print(atlas.verify(given.store))


if __name__ == "__main__":
    main()
