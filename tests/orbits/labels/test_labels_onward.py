"""Labels of machines with modes through continuous changes of their contacts."""

from typing import Any

import numpy as np
import pytest

from atlas.orbits.labels.attractor_orbits import AttractorOrbitTable
from atlas.orbits.labels.links import find_links
from tests.orbits.branches.test_branches_onward import GRAZE
from tests.orbits.branches.test_branches_onward import followed as branch_through
from workers.results import PERIODIC


def attractors(rows: Any, **changed: Any) -> AttractorOrbitTable:
    """Two cells along omega with the orbits of two points of a branch."""
    table, count = branch_through(0.85), len(rows)
    given = {
        "system": table.system, "axes": ("omega",), "fixed": dict(table.parameters), "shape": (count,), "keep": 1,
        "points": rows[["omega"]].to_numpy(), "cell": np.arange(count), "rank": np.zeros(count, np.int64),
        "regime": np.full(count, PERIODIC), "period": rows.period.to_numpy(), "state": rows[["x", "v"]].to_numpy(),
        "impacts_upper": rows.impacts_upper.to_numpy(), "impacts_lower": rows.impacts_lower.to_numpy(),
        "symmetric": np.zeros(count, np.bool_), "share": np.ones(count), "twin": np.full(count, -1),
    }  # fmt: skip
    return AttractorOrbitTable(**(given | changed))


@pytest.fixture(scope="module")
def beside() -> Any:
    """The points of the branch before and after its graze."""
    points = branch_through(0.85).points
    at = int(np.flatnonzero(points.event == "graze")[0])
    assert points.omega[at] == pytest.approx(GRAZE, abs=1e-10)
    return points.iloc[[at - 1, at + 20]]


def test_orbits_on_both_sides_of_a_continuous_graze_are_linked(beside: Any) -> None:
    assert beside.impacts_upper.tolist() == [1, 2]
    assert find_links(attractors(beside)).pairs.tolist() == [[0, 1]]


def test_another_orbit_beyond_a_graze_is_not_linked(beside: Any) -> None:
    states = beside[["x", "v"]].to_numpy() + np.array([[0.0, 0.0], [1e-4, 0.0]])
    assert find_links(attractors(beside, state=states)).pairs.tolist() == []
