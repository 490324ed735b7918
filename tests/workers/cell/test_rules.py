"""The rules that ``atlas verify`` checks hold for the results of motion of every kind."""

from typing import Any

import numpy as np
import pytest

from atlas.check.rules import broken_rules
from atlas.spec.spec import Spec
from tests.unforced import machine
from workers import System, solve_tile
from workers.results import LOCKING, NO_IMPACT, PERIODIC, REGULAR

STOPPED = {"gap": [1.0], "upper": "b", "restitution": 0.7, "parameters": {"b": 1.0}}
BELT = {"name": "belt", "row": [1.0], "kinetic": 0.4, "static": 1.0, "belt": "v0"}

MOTIONS: dict[str, tuple[str | System, dict[str, list[float]], dict[str, float], int]] = {
    "a cycle on a belt": (
        machine(damping=[[0.1]], friction=[BELT], parameters={"v0": 0.5}), {"v0": [0.3, 0.5, 0.9]}, {"x": 1.6}, PERIODIC
    ),
    "a cycle that a stop holds": (machine(damping=[[-0.1]], **STOPPED), {"b": [0.5, 1.0]}, {"x": 0.1}, PERIODIC),
    "rest on a stop and off it": (machine(damping=[[0.1]], load=[1.0], **STOPPED), {"b": [0.3, 2.0]}, {}, NO_IMPACT),
    "a ball that locks": ("bouncing-ball", {"A": [3.2, 3.3]}, {"R": 0.5, "omega": 1.0}, LOCKING),
    "a ball that loses nothing": ("bouncing-ball", {"v": [0.5, 0.77, 3.0]}, {"A": 0.01, "R": 1.0}, REGULAR),
    "a mass in a box that loses nothing": ("impact-pair", {"v": [0.5, 0.77, 3.0]}, {"alpha": 0.5, "R": 1.0}, REGULAR),
}  # fmt: skip


@pytest.mark.parametrize("motion", MOTIONS)
def test_results_obey_the_rules(motion: str) -> None:
    system, axes, parameters, regime = MOTIONS[motion]
    spec = Spec(system, axes, parameters, {"exponents": "spectrum"})
    cells = (slice(0, spec.shape[0]),)
    arrays: dict[str, Any] = solve_tile(spec.system_def, spec.cell_params(cells), spec.settings)
    assert np.any(arrays["regime"] == regime)
    assert broken_rules(spec, cells, arrays) == {}
