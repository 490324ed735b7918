"""Points of bifurcation curves that others have published, found from a cell of the solver.

arXiv 2510.16218: x'' + .04 x' + x = A cos(omega t), one stop at x = 1, R = .9, the orbit with one impact in two forcing
periods; 15 digits of A are given.
"""

import math

import pytest

from workers import solve_tile
from workers.continuation import branch, family_of, orbit_from_state
from workers.model.system import find_system
from workers.results import PERIODIC

PUBLISHED = [("period_doubling", 0.81, 0.347533397412283), ("fold", 0.799, 0.362836201980888)]
SINGLE_MASS = find_system("single-mass")


@pytest.mark.parametrize(("kind", "omega", "A"), PUBLISHED)
def test_the_branch_of_a_single_mass_cell_has_its_event_where_it_was_published(
    kind: str, omega: float, A: float
) -> None:
    values = {"omega": omega, "A": A + 1e-3, "b": 1.0, "zeta": 0.02, "R": 0.9, "tau": 0.5 * math.pi}
    cell = solve_tile("single-mass", values)
    assert (cell["regime"], cell["period"], cell["impacts_upper"]) == (PERIODIC, 2, 1)
    orbit = orbit_from_state(SINGLE_MASS, values, cell["state"], 2)
    run = branch(family_of(SINGLE_MASS, values, ("A",)), orbit, values["A"], (A - 0.03, A + 0.03))
    assert [float(event.point.values[0]) for event in run.events if event.kind == kind] == pytest.approx([A], abs=1e-14)


@pytest.mark.parametrize(("kind", "omega", "A"), PUBLISHED)
def test_no_cell_of_a_single_mass_settles_on_the_published_orbit_beyond_its_event(
    kind: str, omega: float, A: float
) -> None:
    start = {"x": 0.0, "v": 0.0}
    cell = solve_tile("single-mass", {"omega": omega, "A": A - 1e-4, "R": 0.9, "tau": 0.5 * math.pi} | start)
    assert (cell["regime"], cell["period"], cell["impacts_upper"]) != (PERIODIC, 2, 1)
