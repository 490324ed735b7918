"""What watching chaos costs, and whether a cheaper watch finds as many of the motions that settle.

Chaotic cells of some planes are found without watching and then followed for long, as in bench_survival. From these
lifetimes tables are made:

watching-rules   rules for the length of the watch, by the relaxation time t_r and the exponent: what each costs, how
                 many motions it sees settle, and how many it misses
watching-rivals  of how many cells another stable orbit is found, among motions that settle and among others: from a few
                 other starts in the cell, and by following the orbits of its eight neighbours in a fine plane into it
watching-noise   how many motions settle in time if each second state is disturbed as much as rounding in single
                 precision would, or a hundred times as much
watching-cost    periods and processor time of the stages of a cell, in the packaged plane

Usage: python -m scripts.bench_watching [--light] [--side 64] [--far 130000] [--keep]
"""

import argparse
import multiprocessing
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scripts.bench_survival import FURTHER, SETTLED, followed, plane, solved
from scripts.measured import parsed, print_table
from workers import Settings, solve_tile
from workers.attractors.starts import wilson
from workers.cell import stretch
from workers.cell.cells import Cells
from workers.cell.course import AVERAGING, LEAST_PART, SEARCHING, WARMING, WATCHING, Course, part_to_survive
from workers.kernel.motion import FREE
from workers.model.oscillator import Rows
from workers.model.system import find_system
from workers.results import CHAOTIC, result_variables
from workers.tile import result_arrays

PLANES = ("packaged omega-b", "low damping, omega-b", "R near 1, omega-b")
"""Planes of bench_survival."""

NOISY = "omega-R, zeta .005"
"""The plane of bench_survival whose motions are disturbed: half of its chaos settles."""

SURVIVAL = Settings().survival

STARTS, SHORT = 8, 400
"""Other starts in a cell; periods in which a motion is to be seen to settle on another orbit."""

NEIGHBOURS = {"omega": 3.5 / 1249, "b": 0.55 / 799}
"""Distances of neighbours: of 1250 x 800 cells of the packaged plane."""

BEFORE = 2000
"""Periods in which a neighbour is to have settled."""

NOISE = (0.0, 1e-15, 1e-7, 1e-5)
"""Disturbances, as shares of a motion's largest block coordinate. Single precision rounds at 6e-8."""

TIMES = (1000, 2000, 4000, 8000, 16_000)
"""Periods by which settled motions are counted."""

Params = dict[str, NDArray[Any]]


class Lifetimes:
    """Chaotic cells, as they are found without watching, and when their motions settle.

    params   of each cell; relaxation (N,) in periods, exponent (N,)
    used, survived  (N,) periods, when the cell would be called chaotic
    settles  (N,) periods after which the motion is seen to have settled, infinity where it is not
    """

    def __init__(self, pool: Any, params: dict[str, Any], far: int) -> None:
        early, _ = solved(pool, params, Settings(tolerance=0.02, survival=0))
        cells = np.flatnonzero(early["regime"] == CHAOTIC)
        count = len(early["regime"])
        self.params = {name: np.broadcast_to(values, count)[cells].copy() for name, values in params.items()}
        truth = followed(pool, self.params, far)
        self.relaxation, self.exponent = truth["relaxation"], early["largest"][cells]
        self.used, self.survived = early["periods_used"][cells].astype(float), early["survived"][cells]
        self.settles = np.where(np.isin(truth["regime"], SETTLED), truth["periods_used"], np.inf)

    def watched(self, part: NDArray[np.float64]) -> NDArray[np.float64]:
        """Periods without tangent vectors, beyond those of the averages, if chaos is watched for a part of SURVIVAL."""
        return np.maximum(part * SURVIVAL - self.survived, 0.0)

    def seen_and_missed(self, part: NDArray[np.float64]) -> tuple[int, int]:
        """Motions that settle while they are watched, and those that do so within FURTHER periods after that."""
        verdict = self.used + self.watched(part)
        seen = self.settles <= verdict
        return int(seen.sum()), int((~seen & (self.settles <= verdict + FURTHER)).sum())


def power(exponent: float, memory: float) -> Callable[[Lifetimes], NDArray[np.float64]]:
    """The rule (t_r / memory)^exponent, within the limits of the solver's."""
    return lambda life: np.clip((life.relaxation / memory) ** exponent, LEAST_PART, 1.0)


RULES: dict[str, Callable[[Lifetimes], NDArray[np.float64]]] = {
    "the solver's: (t_r/5)², at least 1/32": lambda life: part_to_survive(life.relaxation),
    "none": lambda life: np.zeros(len(life.used)),
    "half of the solver's": lambda life: 0.5 * part_to_survive(life.relaxation),
    "(t_r/7)²": power(2, 7.0),
    "(t_r/5)³": power(3, 5.0),
    "(t_r/4.5)³": power(3, 4.5),
    "(t_r/4.5)⁴": power(4, 4.5),
    "(t_r/4)⁴": power(4, 4.0),
    "1/12 for all": lambda life: np.full(len(life.used), 1.0 / 12.0),
    "(t_r/7)² .7/exponent": lambda life: np.clip(
        0.7 * (life.relaxation / 7.0) ** 2 / np.maximum(life.exponent, 0.02), LEAST_PART, 1.0
    ),
}
"""Parts of SURVIVAL by what is known of cells when they are first called chaotic."""


def rules(lives: list[Lifetimes]) -> list[list[str]]:
    """Each rule over all planes: the mean length of its watch, and what it sees and misses."""
    rows, count = [], sum(len(life.used) for life in lives)
    for name, rule in RULES.items():
        periods = sum(float(life.watched(rule(life)).sum()) for life in lives) / count
        seen, missed = (sum(each) for each in zip(*(life.seen_and_missed(rule(life)) for life in lives), strict=True))
        low, high = wilson(missed, count - seen)
        share = f"{100 * missed / (count - seen):.2f} ({100 * low:.1f} to {100 * high:.1f})"
        rows.append([name, f"{periods:,.0f}", str(seen), str(missed), share])
    return rows


def _from_starts(params: Params) -> NDArray[np.bool_]:
    """Of which cells one of STARTS random motions settles within SHORT periods."""
    rng, count = np.random.default_rng(1), len(params["omega"])
    found = np.zeros(count, dtype=np.bool_)
    for _ in range(STARTS):
        state = {name: rng.uniform(-1.5, 1.5, count) for name in ("x2", "v1", "v2")}
        start = params | state | {"x1": rng.uniform(-1.0, 1.0, count) * params["b"]}
        found |= _settles(start, SHORT)
    return found


def _settles(params: Params, periods: int) -> NDArray[np.bool_]:
    found = solve_tile("two-mass", params, Settings(exponents="none", survival=0, max_periods=periods))
    return np.isin(found["regime"], SETTLED)


def _from_neighbours(params: Params) -> NDArray[np.bool_]:
    """Of which cells the motion of a neighbour that has settled leads to a stable orbit of the cell itself."""
    found = np.zeros(len(params["omega"]), dtype=np.bool_)
    settings = Settings(exponents="none", survival=0, max_periods=BEFORE)
    for right in (-1, 0, 1):
        for up in (-1, 0, 1):
            steps = {"omega": right, "b": up}
            beside = params | {name: params[name] + step * NEIGHBOURS[name] for name, step in steps.items()}
            solution = solve_tile("two-mass", beside, settings)
            rows = np.flatnonzero(np.isin(solution["regime"], SETTLED)) if right or up else np.zeros(0, dtype=int)
            if len(rows):
                state = dict(zip(("x1", "x2", "v1", "v2"), solution["state"][rows].T, strict=True))
                found[rows] |= _settles({name: values[rows] for name, values in params.items()} | state, SHORT)
    return found


def rivals(pool: Any, lives: list[Lifetimes]) -> list[list[str]]:
    """In each plane: of how many motions that settle late, and of how many others, another stable orbit is known."""
    rows = []
    for name, life in zip(PLANES, lives, strict=True):
        filled = {"b": np.full(len(life.used), 0.15)} | life.params
        ways = pool.map(_known, [(way, filled) for way in ("starts", "neighbours")], chunksize=1)
        settles = np.isfinite(life.settles)
        counts = [f"{int((way & group).sum())} of {group.sum()}" for way in ways for group in (settles, ~settles)]
        rows.append([f"`{name}`", *counts])
    return rows


def _known(work: tuple[str, Params]) -> NDArray[np.bool_]:
    way, params = work
    return _from_starts(params) if way == "starts" else _from_neighbours(params)


class Disturbed(Cells):
    """Cells whose motions are disturbed after each second period, but for the last ones of a stretch.

    noise: the largest disturbance, as a share of the largest block coordinate of the motion.
    """

    noise = 0.0

    def run(self, rows: Rows, *, to_end: bool = False) -> Rows:
        """As Cells.run; the sections that are kept of a stretch are those of its undisturbed end."""
        batch, rng = self.bare, np.random.default_rng(len(rows))
        states, contact, kept = batch.motions.h, batch.motions.contact, batch.sections.shape[1]
        steps = batch._replace(
            sections=np.zeros((len(states), 0, *states.shape[1:])),
            periods=batch.done.copy(),
            weighted=np.zeros_like(batch.weighted),
        )
        while self.noise > 0.0:
            some = rows[(batch.periods[rows] - kept > batch.done[rows]) & ~stretch.ended(batch)[rows]]
            if not len(some):
                break
            steps.periods[some] = batch.done[some] + 2
            stretch.run(steps, some)
            free = some[contact[some, 0] == FREE]
            size = np.abs(states[free]).max(axis=(1, 2), keepdims=True)
            states[free] += self.noise * size * rng.uniform(-1.0, 1.0, states[free].shape)
        return super().run(rows, to_end=to_end)


def _cells(kind: type[Cells], params: dict[str, Any], settings: Settings) -> Cells:
    """Cells of the two-mass oscillator at the start of their course."""
    record, count = find_system("two-mass"), max(np.size(values) for values in params.values())
    flat = {p.name: np.broadcast_to(params.get(p.name, p.default), count).copy() for p in record.parameters}
    oscillators, reasons = record.build_many(flat)
    found = result_arrays(result_variables(settings), settings, count, len(record.states))
    return kind(oscillators, reasons, np.zeros((count, len(record.states))), settings, found)


def _lifetimes_with(work: tuple[Params, int, float]) -> NDArray[np.float64]:
    """Periods after which the motions of cells settle, with noise; infinity where they do not in so many periods."""
    params, periods, noise = work
    cells = _cells(Disturbed, params, Settings(exponents="none", survival=periods))
    cells.noise = noise  # type: ignore[attr-defined]
    with np.errstate(all="ignore"):
        Course(cells, part=np.ones_like).take()
    return np.where(np.isin(cells.found["regime"], SETTLED), cells.found["periods_used"], np.inf)


def noises(pool: Any, params: Params) -> list[list[str]]:
    """For each disturbance: how many motions have settled by some times."""
    lives = pool.map(_lifetimes_with, [(params, TIMES[-1], noise) for noise in NOISE], chunksize=1)
    return [
        [f"{noise:g}", *(str(int((life <= time).sum())) for time in TIMES)]
        for noise, life in zip(NOISE, lives, strict=True)
    ]


class TimedCourse(Course):
    """A course that adds up the periods and the seconds of processor time of its stages.

    spent  by stage (periods, seconds); proofs: seconds of the search for stable orbits.
    """

    def __init__(self, cells: Cells) -> None:
        super().__init__(cells)
        self.spent, self.proofs = np.zeros((4, 2)), 0.0
        run_all = cells.run

        def run(rows: Rows, *, to_end: bool = False) -> Rows:
            through = []
            for stage in np.unique(self.stage[rows]):
                some = rows[self.stage[rows] == stage]
                done, begun = cells.batch.done[some].sum(), time.process_time()
                through.append(run_all(some, to_end=to_end))
                self.spent[stage] += cells.batch.done[some].sum() - done, time.process_time() - begun
            return np.concatenate(through)

        cells.run = run  # type: ignore[method-assign]

    def end_on_orbits(self, rows: Rows, budget: Rows, near: NDArray[np.float64]) -> Rows:
        """As Course.end_on_orbits, which takes the time of the search."""
        begun = time.process_time()
        rest = super().end_on_orbits(rows, budget, near)
        self.proofs += time.process_time() - begun
        return rest


def costs(params: dict[str, Any]) -> list[list[str]]:
    """What each stage costs a cell of a plane at tolerance 0.02, on average."""
    begun = time.process_time()
    cells = _cells(Cells, params, Settings(tolerance=0.02))
    course = TimedCourse(cells)
    with np.errstate(all="ignore"):
        course.take()
    whole, count = time.process_time() - begun, len(cells.used)
    averaged = course.spent[WARMING] + course.spent[AVERAGING]
    stages = {
        "searching": course.spent[SEARCHING],
        "averaging, with a tangent vector": averaged,
        "watching": course.spent[WATCHING],
        "looking for stable orbits": np.array([np.nan, course.proofs]),
        "all": np.array([course.spent[:, 0].sum(), whole]),
    }
    return [
        [name, "" if np.isnan(periods) else f"{periods / count:,.0f}", f"{100 * seconds / whole:.0f}"]
        for name, (periods, seconds) in stages.items()
    ]


RULES_HEAD = ("rule", "watched, periods a chaotic cell", "seen to settle", "missed", "missed, % of the chaotic")
RIVALS_HEAD = ("plane", "starts: settles", "starts: does not", "neighbours: settles", "neighbours: does not")
COSTS_HEAD = ("stage", "periods a cell", "processor time, %")
NOISE_HEAD = ("noise", *(f"settled by {time:,}" for time in TIMES))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--light", action="store_true", help="few cells, short: rough numbers in seconds")
    parser.add_argument("--side", type=int, default=64, help="cells along each axis")
    parser.add_argument("--far", type=int, default=130_000, help="periods for which chaos is followed")
    options = parsed(parser)
    side, far = (12, 4000) if options.light else (options.side, options.far)
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        lives = [Lifetimes(pool, plane(name, side), far) for name in PLANES]
        print_table("watching-rules", RULES_HEAD, rules(lives), options.keep)
        print_table("watching-rivals", RIVALS_HEAD, rivals(pool, lives), options.keep)
        noisy = Lifetimes(pool, plane(NOISY, side), 0)
        print_table("watching-noise", NOISE_HEAD, noises(pool, noisy.params), options.keep)
    costs(plane(PLANES[0], 6))  # kernels are loaded
    print_table("watching-cost", COSTS_HEAD, costs(plane(PLANES[0], side)), options.keep)


if __name__ == "__main__":
    main()
