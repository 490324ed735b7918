"""Branches of machines with modes through continuous changes of their contacts and slides."""

from typing import Any

import numpy as np
import pytest

import atlas
from tests.oscillators import cosine_mass
from tests.workers.continuation.test_hybrid_branches import places
from workers.continuation import BranchRun, branch, family_of, orbit_from_state
from workers.model.system import System


def forced(share: float) -> System:
    """x'' + .02 x' + x + 29 (x - 1 beyond 1) = share omega^2 / 1.26 cos omega t."""
    return cosine_mass(
        damping=[[0.02]], force=[f"{share} * omega**2 / 1.26"],
        contacts=[{"name": "stop", "gap": [1.0], "upper": 1.0, "stiffness": 29.0}],
    )  # fmt: skip


def pushed(c: float, p: float = 0.0) -> System:
    """A stop at 1 with damping c and preload p that can only push: the linear answer touches it where A = |Z(.8)|."""
    stop = {"name": "stop", "gap": [1.0], "upper": 1.0, "stiffness": 29.0, "damping": c, "preload": p}
    return cosine_mass(damping=[[0.02]], contacts=[stop | {"release": "force" if c else "displacement"}])


def along_amplitude(system: System, window: tuple[float, float] = (0.01, 0.6)) -> BranchRun:
    """The branch of the linear answer at omega = .8 over the amplitude A of the force."""
    omega, A = 0.8, 0.1
    X = A / complex(1.0 - omega**2, 0.02 * omega)
    values = {p.name: p.default for p in system.parameters} | {"omega": omega, "A": A}
    orbit = orbit_from_state(system, values, np.array([X.real, -omega * X.imag]), 1)
    return branch(family_of(system, values, ("A",)), orbit, A, window)


def followed(omega: float, **given: Any) -> Any:
    return atlas.branch({"omega": omega}, along="omega", window=(0.8, 1.0), system=forced(0.9), **given)


GRAZE, DOUBLING = 0.9150558485, 0.9155816520
"""Of the orbit of two periods and one contact, and of the orbit of one period, by an independent simulator."""


def test_through_a_graze_of_a_soft_contact_a_branch_goes_on_with_one_contact_more() -> None:
    found = followed(0.85)
    assert found.branches.iloc[0][["first_end", "last_end"]].tolist() == ["edge", "period_doubling"]
    assert found.events.kind.tolist() == ["graze", "period_doubling"]
    assert found.events.omega.tolist() == pytest.approx([GRAZE, DOUBLING], abs=1e-10)
    beyond = found.points[(found.points.omega > GRAZE + 1e-9) & (found.points.event == "")]
    assert set(zip(beyond.period, beyond.impacts_upper, beyond.unstable, strict=True)) == {(2, 2, 0)}


@pytest.mark.slow
def test_a_branch_goes_on_with_one_contact_less_where_a_soft_contact_is_lost() -> None:
    """The same branch from beyond the graze."""
    found = followed(0.9153)
    assert found.branches.iloc[0][["first_end", "last_end"]].tolist() == ["edge", "period_doubling"]
    assert found.events.kind.tolist() == ["contact_lost", "period_doubling"]
    assert found.events.omega.tolist() == pytest.approx([GRAZE, DOUBLING], abs=1e-10)
    before = found.points[(found.points.omega < GRAZE - 1e-9) & (found.points.event == "")]
    assert set(zip(before.period, before.impacts_upper, before.unstable, strict=True)) == {(2, 1, 0)}


@pytest.mark.slow
def test_branches_that_leave_are_followed_through_changes_too() -> None:
    """The doubled branch ends on that of one period, which leaves nothing untried."""
    found = followed(0.85, switch_branches=True)
    assert sorted(zip(found.branches.period, found.branches.impacts_upper, strict=True)) == [(1, 1), (2, 1)]
    assert found.events[found.events.leaving >= 0].kind.tolist() == ["period_doubling"]
    assert not found.untried


@pytest.mark.slow
@pytest.mark.parametrize("c", [0.5, 8.0, 30.0])
def test_a_border_collision_is_passed_whatever_the_damping(c: float) -> None:
    """The contact turns the branch sharply there, the more the greater its damping."""
    found, omega = along_amplitude(pushed(c)), 0.8
    assert places(found, "graze") == pytest.approx([abs(complex(1.0 - omega**2, 0.02 * omega))], abs=1e-12)
    assert found.ends == ("edge", "edge")
    assert found.points[-1].orbit.itinerary.impacts(1) == 1


def test_a_preload_ends_a_branch_at_its_graze() -> None:
    """Beyond, the change of state is a square root of the depth."""
    assert along_amplitude(pushed(0.0, 0.5)).ends == ("edge", "graze")


def test_states_are_continuous_through_a_change() -> None:
    points = followed(0.85).points
    at = int(np.searchsorted(points.omega, GRAZE - 1e-9))
    before, there, after = (points[["x", "v"]].to_numpy()[at + k] for k in (-1, 0, 1))
    assert points.event[at] == "graze"
    assert np.max(np.abs(after - there)) < 1e-4
    assert np.max(np.abs(before - there)) < 0.02


@pytest.mark.slow
def test_the_onset_of_stick_and_its_end_are_passed_alike() -> None:
    """From either side the branch is the same one; s = 1 has static friction of the kinetic level."""
    friction = [{"name": "ground", "row": [1.0], "kinetic": 1.0, "static": 1.0}]
    sides = [atlas.branch({"omega": omega, "tau": 0.0}, along="omega", window=(0.5, 0.8),
                          system=cosine_mass(friction=friction)) for omega in (0.55, 0.75)]  # fmt: skip
    sticking, sliding = (found.events for found in sides)
    assert (sticking.kind.tolist(), sliding.kind.tolist()) == (["stick_end"], ["stick_onset"])
    assert sticking.omega.tolist() == pytest.approx(sliding.omega.tolist(), abs=1e-12)
    assert all(found.branches[["first_end", "last_end"]].iloc[0].tolist() == ["edge", "edge"] for found in sides)
