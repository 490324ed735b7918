"""Laws in segments beside the smooth laws that they stand for: how results converge, and what segments cost.

Three machines of one mass, forced by A cos omega t, with laws of chords at multiples of h: a hardening spring with a
rigid stop, a Hertz contact, and a belt whose friction falls. The truth is DOP853 of the smooth law and Newton's method
(tests/support/oracle/smooth.py). States converge as h^2; multipliers stay within an envelope of h^1.5, in which their
error changes its sign. Of each, the last two columns are such errors over such powers.

The cost is that of the Hertz contact with n segments as deep as it goes, against one segment of the same largest depth
and force, in microseconds of processor time a period, all in one run.

Usage: python -m scripts.check_laws [--light] [--keep]
"""

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from scripts.bench_kernel import CELLS, Array, in_turn, one_core, processor_seconds
from scripts.measured import parsed, print_table
from tests.support.oracle.smooth import SmoothMass, orbit
from tests.support.solver_bridge import follow
from workers import Settings, System, solve_tile
from workers.model.mode_table import build_hybrid

FORCED: dict[str, Any] = {"coordinates": ["x"], "mass": [[1.0]], "damping": [[0.1]], "phase": ["pi / 2"]}
QUARTER = math.pi / 2.0


def spring(x: float) -> float:
    """x + x^3."""
    return x + x**3


def hertz(d: float) -> float:
    """5 d^1.5."""
    return 5.0 * d**1.5


def stribeck(v: float) -> float:
    """.5 + .5 e^(-2 v)."""
    return 0.5 + 0.5 * math.exp(-2.0 * v)


def chords(law: Callable[[float], float], h: float, low: int, high: int) -> list[list[float]]:
    """The table of a law at multiples of h."""
    return [[i * h, law(i * h)] for i in range(low, high + 1)]


def duffing_with(h: float) -> dict[str, Any]:
    """The oscillator with a stop at .6."""
    n = round(1.2 / h)
    beam = {"name": "beam", "row": [1.0], "law": chords(spring, h, -n, n)}
    return {"force": [0.5], "gap": [1.0], "upper": 0.6, "restitution": 0.8, "springs": [beam]}


def hertz_with(table: list[list[float]]) -> dict[str, Any]:
    """The mass on a spring whose contact beyond .3 has this law."""
    ball = {"name": "ball", "gap": [1.0], "upper": 0.3, "law": table}
    return {"force": [0.5], "stiffness": [[1.0]], "contacts": [ball]}


def belt_with(h: float) -> dict[str, Any]:
    """The mass on a belt of speed 1, whose friction is constant beyond the sliding speed 3.5, which it never has."""
    law = chords(stribeck, h, 0, round(3.5 / h))
    belt = {"name": "belt", "row": [1.0], "belt": 1.0, "law": [*law, [5.0, law[-1][1]]]}
    return {"force": [0.3], "stiffness": [[1.0]], "friction": [belt]}


@dataclass(frozen=True)
class Machine:
    """A machine in words, with chords and smooth; a state near its orbit, and the spacings of its rows."""

    words: str
    of_chords: Callable[[float], dict[str, Any]]
    smooth: SmoothMass
    near: tuple[float, float]
    spacings: tuple[float, ...]


MACHINES = (
    Machine(
        "spring x + x^3, stop at .6 with R = .8", duffing_with,
        SmoothMass(omega=1.2, c=0.1, A=0.5, phase=QUARTER, spring=spring, stop=0.6, R=0.8),
        (0.511, 0.831), (0.2, 0.1, 0.05, 0.0375),
    ),
    Machine(
        "contact 5 d^1.5 beyond .3", lambda h: hertz_with(chords(hertz, h, 0, round(1.6 / h))),
        SmoothMass(omega=1.1, c=0.1, A=0.5, phase=QUARTER, stop=0.3, push=hertz),
        (0.872, 0.664), (0.2, 0.1, 0.05, 0.025),
    ),
    Machine(
        "friction .5 + .5 e^(-2v), belt of speed 1", belt_with,
        SmoothMass(omega=1.0, c=0.1, A=0.3, phase=QUARTER, rub=stribeck, belt=1.0),
        (0.9, 1.0), (0.5, 0.25, 0.125, 0.0625),
    ),
)  # fmt: skip


def system_of(definition: dict[str, Any], omega: float) -> System:
    """The machine of a definition at a frequency."""
    table = FORCED | {"name": "mass", "parameters": {"omega": {"default": omega}}} | definition
    return System.from_mapping(table)


def found_by(system: System) -> tuple[float, complex]:
    """x at the section of the orbit of period 1 of a machine at its defaults, and its larger multiplier."""
    cell = solve_tile(system, {}, Settings(exponents="none"))
    assert cell["period"] == 1
    hybrid, _ = build_hybrid(system.definition.machines({p.name: np.array([p.default]) for p in system.parameters}))
    return float(cell["state"][0]), larger(follow(hybrid, cell["state"]).jacobian)


def larger(jacobian: Array) -> complex:
    """The multiplier of the largest modulus; of a pair the one above the real line."""
    return complex(max(np.linalg.eigvals(jacobian), key=lambda mu: (round(abs(mu), 9), mu.imag)))


def converge(light: bool) -> list[list[str]]:
    """The rows of the table of convergence."""
    rows = []
    for machine in MACHINES:
        state, jacobian, _ = orbit(machine.smooth, machine.near)
        true = larger(jacobian)
        for h in machine.spacings[: 1 if light else None]:
            x, mu = found_by(system_of(machine.of_chords(h), machine.smooth.omega))
            off = [f"{(x - state[0]) / h**2:.3f}", f"{(mu - true).real / h**1.5:.3f}"]
            rows.append([machine.words, f"{h:g}", f"{x:.10f}", f"{mu.real:.8f}", *off])
        rows.append([machine.words, "smooth", f"{state[0]:.10f}", f"{true.real:.8f}", "", ""])
    return rows


DEEPEST = 1.0
"""The depth down to which the contact has its segments: a little more than its orbit goes."""


def cost(light: bool) -> list[list[str]]:
    """The rows of the table of cost."""
    counts = (1, 8) if light else (1, 2, 4, 8, 16, 32)
    lengths = (60, 20) if light else (1200, 200)
    works: list[Callable[[], float]] = []
    events = []
    for n in counts:
        system = system_of(hertz_with(chords(hertz, DEEPEST / n, 0, n)), 1.1)
        hybrid, _ = build_hybrid(system.definition.machines({p.name: np.array([p.default]) for p in system.parameters}))
        cell = solve_tile(system, {}, Settings(exponents="none"))
        events.append(len(follow(hybrid, cell["state"]).events))
        given = {"omega": 1.1 * (1.0 + 1e-5 * np.arange(CELLS))}
        for exponents in ("none", "spectrum"):
            for length in lengths:
                settings = Settings(method="fixed", exponents=exponents, transient_periods=50, periods=length)
                works.append(partial(processor_seconds, partial(solve_tile, system, given, settings)))
                works[-1]()  # compiles, or loads what an earlier run compiled
    seconds = np.reshape(in_turn(1 if light else 5, *works), (len(counts), 2, 2))
    per_period = 1e6 * (seconds[..., 0] - seconds[..., 1]) / (lengths[0] - lengths[1]) / CELLS
    return [
        [str(n), str(many), *(f"{one:.2f}" for pair in zip(own, own / per_period[0], strict=True) for one in pair)]
        for n, many, own in zip(counts, events, per_period, strict=True)
    ]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--light", action="store_true", help="one spacing, short runs: seconds, rough numbers")
    options = parsed(parser)
    one_core()
    head = ["law", "h", "x(0)", "Re mu", "error of x(0) / h^2", "of Re mu / h^1.5"]
    print_table("laws", head, converge(options.light), options.keep)
    head = ["segments", "events a period", "µs a period", "ratio", "all exponents, µs", "ratio"]
    print_table("laws-cost", head, cost(options.light), options.keep)


if __name__ == "__main__":
    main()
