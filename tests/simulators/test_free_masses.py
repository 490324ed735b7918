"""The fast simulator of free masses against the slow one, and random cells of the solver against the fast one.

The simulator (support/oracle/shaken_mass.py) starts from each cell's ``state`` and follows it on. What has to hold:

periodic       the state recurs after ``period`` periods and not before, with the impacts that were counted; the mass
               rests if and only if the cell sticks; exponents are the logarithms of the multipliers, both -infinity
               where it rests
chaotic        followed for as long as the cell was watched, from the state and from neighbours of it, most runs neither
               rest nor become periodic (one that does shows chaos that ends some day, not a wrong class: such cells are
               counted); the mean growth agrees within four standard errors
locking        the mass rests now and then in the simulation too, and disturbances grow so far from a rest to the next
               that no double knows where that comes
undetermined   the simulator finds no short orbit either
All others are wrong here: a mass alone with R < 1 has no tori, and a bouncing ball always lands.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.support.oracle import simulate
from tests.support.oracle.machines import single_mass
from tests.support.oracle.shaken_mass import ShakenMassHistory, follow
from workers import Settings, solve_tile
from workers.results import CHAOTIC, LOCKING, PERIODIC, UNDETERMINED

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]


@pytest.mark.parametrize("seed", range(6))
def test_the_fast_simulator_of_free_masses_agrees_with_the_one_in_multiprecision(seed: int) -> None:
    """Truth: Taylor series in 30 digits. Chatter, rest and release are among the motions."""
    rng = np.random.default_rng(seed)
    box = seed % 2
    machine = {
        "load": -1.0 if not box else -float(rng.uniform(0.0, 0.5)),
        "omega": float(rng.uniform(0.5, 2.0)), "R": float(rng.uniform(0.1, 0.8)), "tau": float(rng.uniform(0.0, 6.0)),
    }  # fmt: skip
    force, lower, upper = float(rng.uniform(1.0, 2.0)), -1.0 * box, 1.0 if box else math.inf
    start = (float(rng.uniform(0.0, 0.9)), float(rng.uniform(-0.5, 0.5)))
    run = follow(force=force, lower=lower, upper=upper, start=start, periods=4, **machine)
    true = simulate(
        single_mass(damping=0, stiffness=0, force_sin=force, lower=lower, upper=upper, start=start, **machine),
        4, digits=30,
    )  # fmt: skip
    assert bool(true.stuck) == bool(run.rests.any())
    assert np.allclose(run.states, np.array(true.sections, dtype=float), rtol=0.0, atol=1e-8)


CLOSE, FAR = 1e-6, 1e-5
"""Relative distances of section states: below the first they are one, from the second on they differ."""

AGREES = 1e-7
"""Between exponents of one orbit, relative or absolute, beside the ``error`` of the cell."""

NEIGHBOURS, APART = 4, 1e-6
"""Starts beside the state of a chaotic cell, and how far from it they lie relative to the motion."""

LONGEST_WATCH = 20_000
"""Periods for which a cell of no orbit is followed here at most."""

METASTABLE = "some neighbours of this chaos settle"
"""What is said of a chaotic cell of which a minority of the runs ends; not a fault."""

MOST_PERIODS = 64
"""Periods of orbits that an undetermined cell must not have."""

LOST = 18.0
"""Logarithm of the growth from a rest to the next beyond which doubles have lost half of their digits and more."""


@dataclass(frozen=True)
class Machine:
    """A free mass as the simulator takes it; see tests/support/oracle/shaken_mass.py."""

    load: float
    force: float
    omega: float
    tau: float
    lower: float
    upper: float
    R: float

    def run(self, start: Array, periods: int) -> ShakenMassHistory:
        """Its motion from a section state."""
        return follow(**vars(self), start=(float(start[0]), float(start[1])), periods=periods)


def ball(rng: np.random.Generator, count: int) -> dict[str, Array]:
    """Parameters of balls at rest on the table, or above it."""
    height = np.where(rng.random(count) < 0.5, 0.0, rng.uniform(0.0, 5.0, count))
    return {
        "omega": np.ones(count), "g": np.ones(count), "A": rng.uniform(0.8, 4.0, count),
        "R": rng.uniform(0.05, 0.95, count), "tau": rng.uniform(0.0, 2.0 * np.pi, count), "y": height,
    }  # fmt: skip


def pair(rng: np.random.Generator, count: int) -> dict[str, Array]:
    """Parameters of impact pairs, half of them without drag; a quarter begin where the box stands at an end."""
    drag = np.where(rng.random(count) < 0.5, 0.0, rng.uniform(0.0, 0.5, count))
    return {
        "omega": np.ones(count), "alpha": np.ones(count), "delta": drag,
        "nu": rng.uniform(0.2, 6.0, count), "R": rng.uniform(0.05, 0.95, count),
        "tau": np.where(rng.random(count) < 0.25, 0.0, rng.uniform(0.0, 2.0 * np.pi, count)),
    }  # fmt: skip


def machines(name: str, cells: dict[str, Array]) -> list[Machine]:
    """The machines of these cells."""
    rows = [dict(zip(cells, map(float, values), strict=True)) for values in zip(*cells.values(), strict=True)]
    if name == "bouncing-ball":
        return [Machine(-c["g"], c["A"], 1.0, c["tau"], 0.0, np.inf, c["R"]) for c in rows]
    return [Machine(-c["delta"], c["alpha"], 1.0, c["tau"], -c["nu"] / 2, c["nu"] / 2, c["R"]) for c in rows]


def distances(run: ShakenMassHistory, scale: float) -> Array:
    """Of each section from the first one, relative to the motion's size."""
    found: Array = np.max(np.abs(run.states - run.states[0]), axis=1) / scale
    return found


def size(run: ShakenMassHistory) -> float:
    """The largest height or velocity at a section."""
    return float(np.nanmax(np.abs(run.states)))


def periodic_faults(machine: Machine, cell: dict[str, Any]) -> list[str]:
    """What is wrong with a cell that is called periodic."""
    p = int(cell["period"])
    run = machine.run(cell["state"], p)
    away = distances(run, max(size(run), 1e-300))
    faults = []
    if not away[p] < CLOSE:
        faults.append(f"does not close after {p} periods: {away[p]:.1e}")
    shorter = [q for q in range(1, p) if p % q == 0 and away[q] < FAR]
    if shorter:
        faults.append(f"closes after {shorter[0]} of {p} periods")
    rests = bool(run.rests.any())
    if rests != bool(cell["sticks"]):
        faults.append(f"sticks is {bool(cell['sticks'])}, rests in the simulation: {rests}")
        return faults
    if rests:
        if not np.all(cell["spectrum"] == -np.inf):
            faults.append(f"rests, with exponents {cell['spectrum']}")
        return faults
    lower, upper = run.hits.sum(axis=0)
    if (lower, upper) != (cell["impacts_lower"], cell["impacts_upper"]):
        faults.append(f"{lower} and {upper} impacts, counted {cell['impacts_lower']} and {cell['impacts_upper']}")
    with np.errstate(divide="ignore"):
        exact = np.sort(np.log(np.abs(np.linalg.eigvals(run.jacobian))) / p)[::-1]
    # The smaller multiplier of a product in double precision is known by the determinant.
    exact[1] = 2.0 * np.log(machine.R) * (lower + upper) / p - exact[0]
    tolerance = max(AGREES, 10.0 * float(cell["error"]))
    if not np.allclose(exact, cell["spectrum"], rtol=tolerance, atol=tolerance):
        faults.append(f"exponents {cell['spectrum']}, simulated {exact}")
    return faults


def blocked_error(growth: Array) -> float:
    """Standard error of the mean of correlated values, from means over 32 blocks."""
    blocks = growth[: len(growth) // 32 * 32].reshape(32, -1).mean(axis=1)
    return float(blocks.std(ddof=1) / np.sqrt(32))


def chaotic_faults(machine: Machine, cell: dict[str, Any], rng: np.random.Generator) -> list[str]:
    """What is wrong with a cell that is called chaotic; METASTABLE if a minority of the runs ends."""
    watch = int(min(cell["survived"], LONGEST_WATCH))
    scale = max(abs(float(cell["largest"])), 1.0)
    settled, means, errors = 0, [], []
    for k in range(NEIGHBOURS + 1):
        start = np.array(cell["state"])
        if k:
            start[1] += APART * rng.normal() * scale
        run = machine.run(start, watch)
        if run.rests.any() or recurs(run):
            settled += 1
        elif np.isfinite(run.stretch).all():
            means.append(run.stretch.mean())
            errors.append(blocked_error(run.stretch))
    if 2 * settled > NEIGHBOURS + 1:
        return [f"rests or settles within {watch} periods from {settled} of {NEIGHBOURS + 1} starts"]
    mean, error = float(np.mean(means)), float(np.hypot(np.mean(errors) / np.sqrt(len(means)), cell["error"]))
    if abs(mean - cell["largest"]) > 4.0 * error:
        return [f"largest exponent {cell['largest']:.4f} +- {cell['error']:.4f}, simulated {mean:.4f} ({error:.4f})"]
    return [METASTABLE] if settled else []


def recurs(run: ShakenMassHistory) -> bool:
    """Whether the last sections repeat to rounding."""
    last = run.states[-1]
    away = np.max(np.abs(run.states[-MOST_PERIODS - 1 : -1] - last), axis=1)
    return bool(np.min(away) < 1e-11 * size(run))


def locking_faults(machine: Machine, cell: dict[str, Any]) -> list[str]:
    """What is wrong with a cell that is called locking, or undetermined."""
    run = machine.run(cell["state"], LONGEST_WATCH)
    if run.rests.any() and not cell["sticks"]:
        return ["rests in the simulation, and sticks is false"]
    if recurs(run) or run.rests.any():
        growth = growth_between_rests(run.stretch)
        if growth < LOST:
            return [f"no period after {cell['periods_used']} periods, but repeats; growth e^{growth:.1f}"]
    return []


def growth_between_rests(stretch: Array) -> float:
    """The largest logarithm of growth since a rest, over sections before the next one."""
    since = largest = 0.0
    for row in stretch:
        since = 0.0 if np.isneginf(row) else since + row
        largest = max(largest, since)
    return largest


def faults(machine: Machine, cell: dict[str, Any], rng: np.random.Generator) -> list[str]:
    """What is wrong with the results of a cell."""
    if cell["regime"] == PERIODIC:
        return periodic_faults(machine, cell)
    if cell["regime"] == CHAOTIC:
        return chaotic_faults(machine, cell, rng)
    if cell["regime"] in (LOCKING, UNDETERMINED):
        return locking_faults(machine, cell)
    return [f"regime {cell['regime']}"]


def check(cells: int, seed: int, tolerance: float) -> tuple[dict[str, dict[str, int]], list[str]]:
    """Cells of each class of each system, and a line for each fault."""
    counts: dict[str, dict[str, int]] = {}
    lines = []
    for name, draw in (("bouncing-ball", ball), ("impact-pair", pair)):
        rng = np.random.default_rng(seed)
        params = draw(rng, cells // 2)
        found = solve_tile(name, params, Settings(exponents="spectrum", tolerance=tolerance))
        classes = {PERIODIC: "periodic", CHAOTIC: "chaotic", LOCKING: "locking", UNDETERMINED: "undetermined"}
        named = [
            "sticking" if sticks else classes.get(int(regime), str(regime))
            for regime, sticks in zip(found["regime"], found["sticks"], strict=True)
        ]
        counts[name] = {kind: named.count(kind) for kind in sorted(set(named))}
        for k, machine in enumerate(machines(name, params)):
            cell = {key: values[k] for key, values in found.items()}
            where = " ".join(f"{key}={float(values[k])!r}" for key, values in params.items())
            wrong = faults(machine, cell, rng)
            counts[name]["metastable"] = counts[name].get("metastable", 0) + wrong.count(METASTABLE)
            lines += [f"{name} {where}: {fault}" for fault in wrong if fault != METASTABLE]
    return counts, lines


def test_random_cells_of_the_ball_and_the_impact_pair_are_what_an_independent_simulator_says() -> None:
    counts, faults = check(cells=60, seed=2, tolerance=0.02)
    assert not faults
    assert all(found.get("sticking") and found.get("periodic") for found in counts.values())
