"""Motions of packaged machines as the oracle measures them."""

import math
from typing import Any

from mpmath import mp

from tests.oscillators import RIGID, rigid_numbers
from tests.support.oracle.free_mass import bouncing_ball_orbits
from tests.support.oracle.model import OracleMachine, pieces_of
from tests.support.oracle.piecewise import measures
from tests.workers.model.test_systems import values_of
from workers import Settings, solve_tile
from workers.model.system import find_system


def ball_in_flight(A: float, R: float) -> dict[str, float]:
    """A bouncing ball on its stable orbit with one impact a period, at time 1 after the impact.

    At the impact itself the section would lie where the map is not smooth.
    """
    orbit = bouncing_ball_orbits(A, R)[0]
    phase, v = float(orbit.phase), float(orbit.after)
    return {
        "omega": 1.0, "A": A, "R": R, "tau": phase + 1.0,
        "y": v - 0.5 + A * (math.cos(phase) - math.sin(phase + 1.0) + math.sin(phase)),
        "v": v - 1.0 + A * (math.cos(phase) - math.cos(phase + 1.0)),
    }  # fmt: skip


def on_attractor(name: str, params: dict[str, float], settings: Settings | None = None) -> dict[str, float]:
    """The parameters with the state on the attractor in place of the initial one."""
    system = find_system(name)
    found = solve_tile(name, params, settings)
    return params | dict(zip(system.states, found["state"].tolist(), strict=True))


def measured(name: str, params: dict[str, float], periods: int) -> dict[str, Any]:
    """What the oracle measures of the motion of a packaged machine from its initial state, see ``measures``."""
    system = find_system(name)
    start = [params.get(state, system.parameter(state).default) for state in system.states]
    numbers = rigid_numbers(system.definition.machines(values_of(system, **params)))
    with mp.workdps(30):
        machine = pieces_of(OracleMachine(*(numbers[key][0] for key in RIGID), start))
    return measures(machine, start, periods, digits=30)
