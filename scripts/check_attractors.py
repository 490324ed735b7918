"""Whether all attractors are found: 64 initial states a cell against 2000 others, each solved in full.

The 2000 are random, of the same box, and solved one by one as ``solve_tile`` does, without knowing of each other.
They are told apart by their section states alone: an orbit is the same as another one where its state is one of that
one's sections. What is not periodic counts as one attractor of its cell. The law to hold against: an attractor of
share p is missed by n initial states with probability (1 - p)^n.
"""

import argparse
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from scripts.measured import parsed, print_table
from workers.attractors.starts import Starts, boxes
from workers.attractors.waves import solve_attractors
from workers.model.system import find_system
from workers.results import APERIODIC, CHAOTIC, NO_IMPACT, PERIODIC, QUASIPERIODIC
from workers.settings import Settings
from workers.tile import solve_tile

SYSTEM = "two-mass"
RANGES = {"omega": (0.5, 4.5), "b": (0.02, 0.8)}
"""Of the random cells."""
BRIEF = Settings(exponents="none", max_periods=4000, survival=8192, section_samples=64)
"""For the many: what is not periodic is not watched for long."""
SAME = 1e-6
"""Between states of one orbit."""
NEITHER = (QUASIPERIODIC, CHAOTIC, APERIODIC)


@dataclass
class Checked:
    """One cell: shares of the attractors among the many; which of them the few have found, whose interval covers."""

    cell: dict[str, float]
    shares: list[float]
    found: list[bool]
    covered: list[bool]
    tried: int
    beyond: int


def many_shares(cell: dict[str, float], count: int, seed: int) -> tuple[list[float], list[Any]]:
    """Shares of the attractors that so many random initial states reach, and what each is: sections, or None."""
    record = find_system(SYSTEM)
    values = {p.name: np.array([cell.get(p.name, p.default)]) for p in record.parameters}
    oscillators, _ = record.build_many(values)
    low, high = (each[0] for each in boxes(Starts(), oscillators, record))
    states = low + np.random.default_rng(seed).random((count, len(low))) * (high - low)
    given = cell | {name: states[:, k] for k, name in enumerate(record.states)}
    solved = solve_tile(SYSTEM, given, BRIEF)
    kinds: list[Any] = []
    hits: list[int] = []
    for k in range(count):
        regime = int(solved["regime"][k])
        if regime not in (NO_IMPACT, PERIODIC, *NEITHER):
            continue
        sections = solved["section"][k][: max(int(solved["period"][k]), 1)] if regime not in NEITHER else None
        place = next((i for i, kind in enumerate(kinds) if same(kind, sections)), len(kinds))
        if place == len(kinds):
            kinds.append(sections)
            hits.append(0)
        hits[place] += 1
    total = sum(hits)
    return [n / total for n in hits], kinds


def same(one: Any, other: Any) -> bool:
    """Whether two kinds are one: sections of one orbit, or neither periodic."""
    if one is None or other is None:
        return one is None and other is None
    return len(one) == len(other) and bool(np.abs(one - other[0]).max(axis=1).min() < SAME)


def check(cell: dict[str, float], few: int, many: int, seed: int) -> Checked:
    """Hold the few initial states of a cell against the many."""
    shares, kinds = many_shares(cell, many, seed)
    found = solve_attractors(SYSTEM, cell, Settings(), Starts(few, seed=seed, keep=16))
    mine: list[tuple[Any, float, float]] = []
    for k in range(min(int(found["attractors"]), 16)):
        aperiodic = int(found["regime"][k]) in NEITHER
        mine.append((None if aperiodic else found["state"][k], found["share_low"][k], found["share_high"][k]))
    result = Checked(cell, shares, [], [], int(found["starts"]), 0)
    used = set()
    for share, kind in zip(shares, kinds, strict=True):
        places = [i for i, (state, _, _) in enumerate(mine) if is_on(state, kind)]
        used.update(places)
        result.found.append(bool(places))
        if len(places) == 1:  # several kinds of chaos are one among the many
            _, low, high = mine[places[0]]
            result.covered.append(bool(low <= share <= high))
    result.beyond = len(mine) - len(used)
    return result


def is_on(state: Any, kind: Any) -> bool:
    """Whether a state lies on the attractor of that kind; of what is not periodic there is one a cell."""
    if state is None or kind is None:
        return state is None and kind is None
    return bool(np.abs(kind - state).max(axis=1).min() < SAME)


def main(arguments: list[str] | None = None) -> None:
    """Print each cell, then misses against the law and the coverage of the intervals."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, default=50)
    parser.add_argument("--few", type=int, default=64)
    parser.add_argument("--many", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    asked = parsed(parser, arguments)
    rng = np.random.default_rng(asked.seed)
    reached, missed, expected, variance, covered, intervals, beyond = 0, 0, 0.0, 0.0, 0, 0, 0
    begin = time.perf_counter()
    for k in range(asked.cells):
        cell = {name: float(rng.uniform(*ends)) for name, ends in RANGES.items()}
        one = check(cell, asked.few, asked.many, asked.seed + 1 + k)
        chance = np.array([(1.0 - share) ** one.tried for share in one.shares])
        reached, missed = reached + len(one.found), missed + one.found.count(False)
        expected, variance = expected + float(chance.sum()), variance + float((chance * (1.0 - chance)).sum())
        covered, intervals = covered + sum(one.covered), intervals + len(one.covered)
        beyond += one.beyond
        shown = " ".join(
            f"{share:.4f}{'' if there else ' missed'}" for share, there in zip(one.shares, one.found, strict=True)
        )
        where = " ".join(f"{name} {value:.4f}" for name, value in cell.items())
        print(f"{k} {where}: {one.tried} starts, shares {shown}, {one.beyond} beyond the many", flush=True)
    law = f"the law (1 - p)^n expects {expected:.1f} ± {variance**0.5:.1f}"
    rows = [
        (f"attractors that the {asked.many} reach", str(reached)),
        (f"of these missed by the {asked.few}", f"{missed}; {law}"),
        (f"attractors that only the {asked.few} reach", str(beyond)),
        (
            f"Wilson intervals of the {asked.few} that cover the share among the {asked.many}",
            f"{covered} of {intervals}",
        ),
    ]
    print_table("attractors", [f"in {asked.cells} cells", ""], rows, asked.keep)
    print(f"{time.perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
