"""Curves of machines with friction, and what is said where there is no curve."""

import warnings
from typing import Any

import numpy as np
import pytest

import atlas
from atlas.orbits.branches.table import Branches
from atlas.orbits.curves import following
from atlas.orbits.curves.cells import PERSISTS
from atlas.orbits.curves.finish import finished
from atlas.orbits.curves.following import Located, follow_event
from atlas.orbits.curves.plane import CurvePlane
from atlas.orbits.curves.search import CurveSearch
from atlas.orbits.curves.settings import CurveSettings
from atlas.orbits.curves.tasks import Persist
from atlas.service.curves import CurvesSummary
from workers.continuation import BranchRun, Condition, curve, family_of
from workers.model.system import find_system
from workers.results import PERIODIC

STICK_SLIP = find_system("stick-slip")
VALUES = {p.name: p.default for p in STICK_SLIP.parameters}


def along(u: float) -> Branches:
    return atlas.branch({"omega": 1.0, "u": u}, along="omega", window=(0.9, 1.6), system="stick-slip")


@pytest.mark.slow
def test_where_a_mass_begins_to_stick_at_no_rate_there_is_a_curve_without_a_warning() -> None:
    """The orbit itself has the condition; the one without that event is none. Branches at another speed agree."""
    event = along(0.5).traced[0].run.events[-1]
    assert event.kind == "grazing_sliding"
    window, start = {"omega": (0.9, 1.6), "u": (0.4, 0.7)}, np.array([event.point.values[0], 0.5])
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        run = curve(family_of(STICK_SLIP, VALUES, ("omega", "u")), event, start, window)
    assert run.ends == ("edge", "edge")
    assert min(np.max(np.abs(point.values - start)) for point in run.points) < 1e-10
    omega, u = run.points[len(run.points) // 3].values
    other = along(float(u)).events
    assert np.min(np.abs(other[other.kind == "grazing_sliding"].omega - omega)) < 1e-10


def test_an_event_whose_curve_has_one_point_alone_is_told_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    event = along(0.5).traced[0].run.events[-1]
    run = BranchRun([event.point], [], ("stalled", "stalled"), 1)
    monkeypatch.setattr(following, "curve", lambda *_, **__: run)

    class Orbits:
        family = None

        class plane:  # noqa: N801
            window = None

    point = event.point
    located = Located("grazing_sliding", Condition("speed"), point.orbit, point.contacts, point.values, np.nan)
    found = follow_event(Orbits(), located, 0.02, 10)  # type: ignore[arg-type]
    assert found == "the grazing sliding is alone: no step along its curve converges"


def plane_of_two_regions() -> CurvePlane:
    """Six by six cells, of period 1 at the left and 2 at the right: six edges between them."""
    x, y, cells = np.linspace(1.0, 2.0, 6), np.linspace(0.4, 0.9, 6), 36
    period, none = np.where(np.arange(cells) % 6 < 3, 1, 2), np.zeros(cells, dtype=np.int64)
    return CurvePlane(
        system=STICK_SLIP, axes=("omega", "u"), x=x, y=y, log=(False, False), fixed={}, regime=np.full(cells, PERIODIC),
        period=period, impacts_upper=none, impacts_lower=none, symmetric=np.zeros(cells, dtype=np.bool_),
        speed=np.full(cells, np.nan), state=np.zeros((cells, 2)),
    )  # fmt: skip


@pytest.mark.parametrize("found", [{"events": [], "why": "no orbit is found"}, {"trouble": "no orbit is found"}])
def test_each_border_that_stays_unexplained_says_why(found: dict[str, Any]) -> None:
    search = CurveSearch(plane_of_two_regions(), CurveSettings())
    while tasks := search.tasks():
        search.take([{} if isinstance(task, Persist) else found for task in tasks.values()])
    report = finished(search).report
    assert report["edges"]["regions"]["unexplained"] == 6
    (border,) = report["unexplained"]
    assert (border["edges"], border["why"]) == (6, "no orbit is found")
    assert border["at"] == pytest.approx({"omega": 1.5, "u": 0.4})
    shown = str(CurvesSummary("a.zarr", finished(search)))
    assert "unexplained: 6 edges of the border at omega = 1.5, u = 0.4: no orbit is found" in shown


def test_an_orbit_that_goes_on_beyond_a_border_makes_it_one_of_basins() -> None:
    search = CurveSearch(plane_of_two_regions(), CurveSettings())
    while tasks := search.tasks():
        search.take([{} if isinstance(task, Persist) else {"events": [], "there": PERSISTS} for task in tasks.values()])
    assert finished(search).report["edges"]["regions"] == {
        "all": 6, "curve": 0, "basins": 6, "unexplained": 0, "not_tried": 0,
    }  # fmt: skip
