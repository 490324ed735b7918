"""A cell depends on its own parameters alone, to the bit: whatever machines are solved with it, in whatever order."""

from typing import Any

import numpy as np
import pytest

from workers import Settings, System, solve_tile
from workers.model.system import find_system, system_names

SHORT = Settings(exponents="spectrum", max_periods=300, survival=100, section_samples=2)

CELLS = 6
"""Machines that are solved together, and each alone."""

OSCILLATOR: dict[str, Any] = {
    "name": "own", "coordinates": ["x1", "x2"], "mass": [[1.0, 0.0], [0.0, 1.0]], "damping": [[0.1, 0.0], [0.0, 0.1]],
    "stiffness": [["k", -0.5], [-0.5, 1.5]], "force": ["A", 0.0],
}  # fmt: skip
"""Two masses on springs, whose elements follow."""

PARAMETERS: dict[str, Any] = {
    name: {"default": value}
    for name, value in {"k": 1.5, "A": 1.0, "p": 0.0, "s": 0.25, "q": 0.1, "omega": 0.9}.items()
}

MEASURED = {
    "place": {"displacement": [1.0, 0.0], "report": ["mean", "rms", "peak"]},
    "damper": {"velocity": [1.0, -1.0], "weight": 0.1, "report": ["power"]},
}

OWN: dict[str, tuple[dict[str, Any], dict[str, list[float]]]] = {
    "a row of friction that is that of a contact in some": (
        {"contacts": [{"name": "stop", "gap": [1.0, 0.0], "upper": 0.4, "restitution": 0.6}],
         "friction": [{"name": "rub", "row": [1.0, "p"], "kinetic": 0.2}]},
        {"p": [0.0, 0.5, 0.0, -1.0, 1e-14, 0.2]},
    ),
    "stops that are none in some": (
        {"contacts": [{"name": "pad", "gap": [1.0, 0.0], "upper": "sqrt(s)", "lower": -0.4, "stiffness": 5.0,
                       "damping": 0.3, "release": "force"}]},
        {"s": [0.25, -1.0, 0.3, 0.01, -2.0, 1.0]},
    ),
    "stiffness that loses its spring in some": (
        {"contacts": [{"name": "stop", "gap": [1.0, 0.0], "upper": 0.4, "restitution": 0.6},
                      {"name": "pad", "gap": [0.0, 1.0], "lower": -0.5, "stiffness": 8.0}]},
        {"k": [1.5, 1.0 / 6.0, 3.0, 0.2, 1.0, 5.0]},
    ),
    "friction that falls with speed in some": (
        {"friction": [{"name": "rub", "row": [1.0, 0.0], "kinetic": 0.3, "slope": "q"}]},
        {"q": [0.1, -0.05, 0.0, -0.3, 0.4, -0.01]},
    ),
    "measures of a rigid contact": (
        {"gap": [1.0, 0.0], "upper": 0.4, "restitution": 0.6, "measures": MEASURED},
        {"omega": [0.7, 1.03, 1e300, 0.9, 1.3, 2.5]},
    ),
    "a rigid machine without mass in some": (
        {"gap": [1.0, 0.0], "upper": 0.4, "restitution": 0.6, "mass": [["s", 0.0], [0.0, 1.0]]},
        {"s": [1.0, 0.0, 2.0, 0.5, 0.0, 1.5]},
    ),
    "a soft machine without mass in some": (
        {"contacts": [{"name": "pad", "gap": [1.0, 0.0], "upper": 0.4, "stiffness": 9.0}],
         "mass": [["s", 0.0], [0.0, 1.0]]},
        {"s": [1.0, 0.0, 2.0, 0.5, 0.0, 1.5]},
    ),
    "a law that is none in some": (
        {"springs": [{"name": "beam", "row": [1.0, 0.0], "law": [[0.0, 0.0], ["s", 1.0], [1.0, 3.0]]}]},
        {"s": [0.25, 1.5, 0.5, -1.0, 0.75, 0.9]},
    ),
    "an order of the force that has no amplitude in some": (
        {"gap": [1.0, 0.0], "upper": 0.4, "restitution": 0.6, "harmonics": [{"order": 17, "force": ["q", 0.0]}]},
        {"q": [0.0, 3.0, 0.0, 0.0, 1.0, 0.0]},
    ),
    "a chatter, a preload, friction and a load that is switched, measured": (
        {"contacts": [{"name": "stop", "gap": [1.0, 0.0], "upper": 0.4, "restitution": 0.6},
                      {"name": "pad", "gap": [-1.0, 1.0], "lower": -0.3, "stiffness": 20.0, "damping": 0.1,
                       "preload": 0.05, "release": "force"}],
         "friction": [{"name": "rub", "row": [0.0, 1.0], "kinetic": 0.2, "static": 0.3}],
         "phases": [{"start": 0.0}, {"start": 0.4, "load": ["q", -0.1]}], "measures": MEASURED},
        {"omega": [0.6, 0.9, 1.2, 1.5, 1.8, 2.2]},
    ),
    "phases of other loads": (
        {"contacts": [{"name": "stop", "gap": [1.0, 0.0], "lower": 0.0, "restitution": 0.5}],
         "phases": [{"start": 0.0}, {"start": 0.4, "load": ["q", 0.0]}]},
        {"q": [0.1, -0.5, 0.0, -3.0, 0.4, 1.0]},
    ),
}  # fmt: skip


def random_cells(system: System, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Parameters about their defaults, some at them, and initial states."""
    found = {}
    for parameter in system.parameters:
        if parameter.name in system.states:
            values = rng.uniform(-0.2, 0.2, CELLS)
        else:
            values = parameter.default * rng.choice([1.0, 1.0, 0.7, 1.3, 0.0], CELLS)
        fits = np.array([parameter.admits(value) for value in values])
        found[parameter.name] = np.where(fits, values, parameter.default)
    return found


def differing(system: System, cells: dict[str, np.ndarray], rng: np.random.Generator) -> list[str]:
    """Results that are other ones alone and in company, in any order."""
    order, found = rng.permutation(CELLS), set[str]()
    together = solve_tile(system, {name: values[order] for name, values in cells.items()}, SHORT)
    for place, k in enumerate(order):
        alone = solve_tile(system, {name: values[k] for name, values in cells.items()}, SHORT)
        for name, value in alone.items():
            if value.tobytes() != np.ascontiguousarray(together[name][place]).tobytes():
                found.add(name)
    return sorted(found)


@pytest.mark.parametrize("name", system_names())
def test_a_random_machine_of_the_package_is_the_same_alone_and_in_company(name: str) -> None:
    rng, system = np.random.default_rng(47), find_system(name)
    assert differing(system, random_cells(system, rng), rng) == []


@pytest.mark.parametrize("kind", OWN)
def test_a_machine_of_ones_own_is_the_same_alone_and_in_company(kind: str) -> None:
    more, values = OWN[kind]
    system, rng = System.from_mapping(OSCILLATOR | {"parameters": PARAMETERS} | more), np.random.default_rng(3)
    given = {name: np.array(column) for name, column in values.items()}
    assert differing(system, given | {"A": np.linspace(0.6, 1.4, CELLS)}, rng) == []
