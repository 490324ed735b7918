"""Sticking cells solved by scipy's event integrator, as a careful user would write it, against this solver.

The user's loop: solve_ivp (DOP853, rtol 1e-9, atol 1e-12 b, steps of T/100 at most) from rest at the origin, one
terminal event a stop, direction outward, the restitution law at each event, and a restart. A restart on the stop would
end at once, at an event that is the last one; of the two usual remedies one restarts a hair (1e-12 b) inside, the other
does not look for events during the first 1e-6 of a period. Nothing is done about chatter, because nothing announces it.
A cell goes wrong if the trajectory passes through the wall (|x1| > b by more than 1e-6 b), if it does not get through
the periods within a bounded number of impacts, or if it ends on another state.
Usage: python -m scripts.compare_sticking [--light] [--cells N] [--seed S] [--keep]
"""

import argparse
import math
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from scripts.measured import parsed, print_table
from workers import Settings, solve_tile, trace

Array = NDArray[np.float64]

FIG6 = {"mu_k": 5.0, "mu_m": 2.0, "zeta": 0.05, "f2": 0.0, "tau": math.pi}
PERIODS = 5
IMPACTS_PER_PERIOD = 200
"""The most impacts that the loop may take; our own chatter needs fewer than a hundred before it is at rest."""
REMEDIES = ("restart a hair inside the stop", "no events for the first 1e-6 T")
THROUGH = 1e-6
"""Share of b beyond a stop that counts as through the wall."""
OTHER_STATE = 1e-3
"""Relative distance of the last state from ours that counts as another state."""


@dataclass(frozen=True)
class Outcome:
    """How far beyond the stop the general integrator got, whether it finished, its distance from our last state."""

    beyond: float
    finished: bool
    distance: float
    impacts: int
    seconds: float


def follow(params: dict[str, float], start: Array, periods: int, remedy: str) -> tuple[float, bool, Array, int]:
    """The user's loop: largest |x1| / b - 1, whether all periods were completed, last state, impacts."""
    w, tau, b, R, zeta = (params[name] for name in ("omega", "tau", "b", "R", "zeta"))
    K = np.array([[1.0, -1.0], [-1.0, 1.0 + params["mu_k"]]])
    mass = np.array([1.0, params["mu_m"]])
    force = np.array([1.0 - params["f2"], params["f2"]])

    def rates(t: float, z: Array) -> Array:
        x, v = z[:2], z[2:]
        return np.concatenate([v, (force * math.sin(w * t + tau) - K @ (x + 2.0 * zeta * v)) / mass])

    T = 2.0 * math.pi / w
    blind_until = -1.0

    def upper(t: float, z: Array) -> float:
        return float(z[0] - b) if t > blind_until else -b

    def lower(t: float, z: Array) -> float:
        return float(z[0] + b) if t > blind_until else b

    for event, direction in ((upper, 1.0), (lower, -1.0)):
        event.terminal = True  # type: ignore[attr-defined]
        event.direction = direction  # type: ignore[attr-defined]
    t, end, z = 0.0, periods * T, start.copy()
    beyond, impacts = 0.0, 0
    while t < end:
        if impacts > IMPACTS_PER_PERIOD * periods:
            return beyond, False, z, impacts
        flight = solve_ivp(
            rates,
            (t, end),
            z,
            method="DOP853",
            events=(upper, lower),
            rtol=1e-9,
            atol=1e-12 * b,
            max_step=T / 100,
        )
        beyond = max(beyond, float(np.max(np.abs(flight.y[0]))) / b - 1.0)
        t, z = float(flight.t[-1]), flight.y[:, -1].copy()
        if flight.status == 1:
            z[2] = -R * z[2]
            if remedy == REMEDIES[0]:
                z[0] = math.copysign(b * (1.0 - 1e-12), z[0])
            else:
                blind_until = t + 1e-6 * T
            impacts += 1
    return beyond, True, z, impacts


def sample(cells: int, seed: int) -> list[dict[str, float]]:
    """Cells of the window that stick on their attractor, drawn uniformly in omega and log b."""
    rng = np.random.default_rng(seed)
    omega, b = rng.uniform(0.5, 3.0, 8 * cells), np.exp(rng.uniform(math.log(1e-3), math.log(1e-1), 8 * cells))
    solved = solve_tile("two-mass", {**FIG6, "R": 0.5, "omega": omega, "b": b}, Settings(exponents="none"))
    chosen = np.flatnonzero(solved["sticks"])[:cells]
    return [{**FIG6, "R": 0.5, "omega": float(omega[i]), "b": float(b[i])} for i in chosen]


def compare(params: dict[str, float], remedy: str) -> Outcome:
    """Both solvers from rest at the origin, over the same periods."""
    ours = trace("two-mass", params, PERIODS).states[-1]
    begun = time.process_time()
    beyond, finished, last, impacts = follow(params, np.zeros(4), PERIODS, remedy)
    seconds = time.process_time() - begun
    distance = float(np.max(np.abs(last - ours)) / np.max(np.abs(ours)))
    return Outcome(beyond, finished, distance, impacts, seconds)


def tally(outcomes: list[Outcome]) -> dict[str, float]:
    """Counts of what went wrong."""
    through = [o.beyond > THROUGH for o in outcomes]
    stalled = [not o.finished for o in outcomes]
    other = [o.finished and o.distance > OTHER_STATE for o in outcomes]
    silent = [o.finished and (a or c) for o, a, c in zip(outcomes, through, other, strict=True)]
    return {
        "cells": len(outcomes),
        "through_the_wall": sum(through),
        "never_finishes": sum(stalled),
        "another_state": sum(other),
        "wrong_without_a_word": sum(silent),
        "right": sum(not (a or b or c) for a, b, c in zip(through, stalled, other, strict=True)),
        "deepest_beyond_in_b": max((o.beyond for o in outcomes), default=0.0),
        "seconds_per_period": sum(o.seconds for o in outcomes) / max(1, PERIODS * len(outcomes)),
    }


def table(facts: dict[str, dict[str, float]]) -> tuple[list[str], list[list[str]]]:
    """The head and the rows of a table of the tallies, one column for each remedy."""
    cells = int(next(iter(facts.values()))["cells"])
    rows = [
        ("passes through the wall by more than 1e-6 b", "through_the_wall"),
        (f"does not finish {PERIODS} periods in {IMPACTS_PER_PERIOD * PERIODS} impacts", "never_finishes"),
        ("finishes on another state", "another_state"),
        ("wrong without a message", "wrong_without_a_word"),
        ("agrees with this solver", "right"),
    ]
    shares = [[f"{100.0 * tally[key] / max(1, cells):.0f} %" for tally in facts.values()] for _, key in rows]
    return [f"of {cells} sticking cells", *facts], [[text, *each] for (text, _), each in zip(rows, shares, strict=True)]


def run(cells: int, seed: int) -> dict[str, dict[str, float]]:
    """The tally of each remedy."""
    chosen = sample(cells, seed)
    return {remedy: tally([compare(params, remedy) for params in chosen]) for remedy in REMEDIES}


def main(argv: list[str] | None = None) -> None:
    """Compare and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cells", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--light", action="store_true", help="4 cells")
    options = parsed(parser, argv)
    facts = run(4 if options.light else options.cells, options.seed)
    print_table("sticking", *table(facts), options.keep)
    for remedy, counts in facts.items():
        print(f"\n{remedy}: up to {counts['deepest_beyond_in_b']:.2g} b beyond a stop, ", end="")
        print(f"{counts['seconds_per_period']:.2g} s of processor time a period", end="")
    print()


if __name__ == "__main__":
    main()
