"""Stored cells as orbits; the truth is the stored motion itself and the same orbit found in another way."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from atlas.orbits.orbit_table import are_on_orbit
from atlas.orbits.stored_orbits import NEEDED, orbits_of
from tests import naive
from workers import Settings, solve_tile
from workers.continuation import Orbit, family_of, orbit_from_state, section_state
from workers.model.system import System, find_system
from workers.results import NO_IMPACT, PERIODIC, REGIME

TWO_MASS = find_system("two-mass")
OMEGA = np.array([2.98, 3.02, 4.0, 4.2, 6.0])
"""An orbit and its mirror image, symmetric orbits, and motion without impact."""


def solved(system: System, values: Mapping[str, Any]) -> dict[str, Any]:
    """The columns of some cells that orbits are made of."""
    arrays = solve_tile(system, values, Settings(max_periods=2000))
    return {name: np.atleast_1d(arrays[name]) if name != "state" else np.atleast_2d(arrays[name]) for name in NEEDED}


@pytest.fixture(scope="module")
def cells() -> dict[str, Any]:
    return solved(TWO_MASS, {"omega": OMEGA})


def same(one: Orbit | str, other: Orbit | str) -> bool:
    """Whether two orbits are one to the bit."""
    assert isinstance(one, Orbit) and isinstance(other, Orbit)
    fields = zip(one[1:], other[1:], strict=True)  # the length of a turn is unknown of cycles alone, else NaN
    return one.itinerary == other.itinerary and all(np.array_equal(a, b, equal_nan=True) for a, b in fields)


def test_an_orbit_passes_through_the_stored_state(cells: dict[str, Any]) -> None:
    for k, orbit in enumerate(orbits_of(family_of(TWO_MASS, {}, ("omega",)), OMEGA[:, None], cells)):
        assert isinstance(orbit, Orbit)
        assert section_state(TWO_MASS, {"omega": OMEGA[k]}, orbit) == pytest.approx(cells["state"][k], abs=1e-9)


def test_orbits_do_not_depend_on_the_cells_beside_them(cells: dict[str, Any]) -> None:
    family = family_of(TWO_MASS, {}, ("omega",))
    together = orbits_of(family, OMEGA[:, None], cells)
    for k, orbit in enumerate(together):
        (alone,) = orbits_of(family, OMEGA[k : k + 1, None], {name: cells[name][k : k + 1] for name in NEEDED})
        assert same(orbit, alone)


def test_a_family_without_free_parameters_gives_the_same_orbits(cells: dict[str, Any]) -> None:
    """The start of a branch is the orbit that curves and labels have of the cell, and that of its state by itself."""
    together = orbits_of(family_of(TWO_MASS, {}, ("omega",)), OMEGA[:, None], cells)
    for k, orbit in enumerate(together):
        values, row = {"omega": float(OMEGA[k])}, {name: cells[name][k : k + 1] for name in NEEDED}
        (own,) = orbits_of(family_of(TWO_MASS, values, ()), np.zeros((1, 0)), row)
        symmetric = bool(cells["symmetric"][k]) or cells[REGIME.name][k] == NO_IMPACT
        assert same(orbit, own)
        assert same(orbit, orbit_from_state(TWO_MASS, values, cells["state"][k], int(cells["period"][k]), symmetric))


@pytest.mark.parametrize(
    ("system", "values"), [("two-mass", {"omega": 6.0}), ("soft-suspension", {"omega": 6.0, "a": 0.01})]
)
def test_motion_without_impact_is_its_own_mirror_image_where_the_machine_has_any(
    system: str, values: dict[str, float]
) -> None:
    """Linear motion is the only one of its machine, and so is its mirror image."""
    record = find_system(system)
    cell = solved(record, values)
    assert cell[REGIME.name].tolist() == [NO_IMPACT]
    (orbit,) = orbits_of(family_of(record, values, ()), np.zeros((1, 0)), cell)
    assert isinstance(orbit, Orbit)
    assert orbit.itinerary.symmetric
    assert not orbit.itinerary.sides


def test_an_orbit_that_is_its_own_mirror_image_is_found_so_from_a_rough_state(cells: dict[str, Any]) -> None:
    """Its recorded halves differ by more than is taken for a mirror image; those of the exact orbit do not."""
    k = 2
    rough = {name: cells[name][k : k + 1].copy() for name in NEEDED}
    rough["state"] += 1e-5
    rough["symmetric"][:] = False
    (orbit,) = orbits_of(family_of(TWO_MASS, {}, ("omega",)), OMEGA[k : k + 1, None], rough)
    assert isinstance(orbit, Orbit)
    assert orbit.itinerary.symmetric


def test_a_state_that_is_on_no_orbit_is_told_in_words_and_its_neighbours_are_found(cells: dict[str, Any]) -> None:
    """Truth: far beyond its stop nothing moves."""
    values = dict(naive.STICKING)
    resting = solved(TWO_MASS, values)
    assert resting[REGIME.name].tolist() == [PERIODIC]
    family = family_of(TWO_MASS, {}, tuple(values))
    defaults = {p.name: p.default for p in TWO_MASS.parameters} | {"omega": OMEGA[2]}
    points = np.array([list(values.values())] * 2 + [[defaults[name] for name in values]])
    lost = resting | {"state": resting["state"] + 1e3}
    every = {name: np.concatenate([lost[name], resting[name], cells[name][2:3]]) for name in NEEDED}
    why, *orbits = orbits_of(family, points, every)
    assert isinstance(why, str)
    assert all(isinstance(orbit, Orbit) for orbit in orbits)


def test_a_state_is_on_an_orbit_within_a_millionth_of_its_size_at_any_section() -> None:
    orbit = np.array([[[1.0, 2.0], [-4.0, 0.5]]] * 3)
    states = np.array([[1.0, 2.0 + 3.9e-6], [-4.0 - 4.1e-6, 0.5], [1.0, 0.5]])
    assert are_on_orbit(orbit, states).tolist() == [True, False, False]
