"""Curves of machines with friction, and what is said where there is no curve."""

import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from distributed import Client

import atlas
from atlas.orbits.branches.table import BranchTable
from atlas.orbits.curves import following
from atlas.orbits.curves.cell_orbits import PERSISTS
from atlas.orbits.curves.chords import find_passages
from atlas.orbits.curves.following import PlaneEvent, follow_event
from atlas.orbits.curves.plane import CurvePlane, plane_of
from atlas.orbits.curves.queries import curves_of
from atlas.orbits.curves.search import CurveSearch
from atlas.orbits.curves.search_result import finish_search
from atlas.orbits.curves.settings import CurveSettings
from atlas.orbits.curves.tasks import PersistTask
from atlas.service.curves import CurveSummary
from atlas.store.store import open_store
from tests.curve_planes import found_serially
from tests.workers.continuation.test_den_hartog import least_force
from workers.continuation import BranchRun, Condition, curve, family_of
from workers.model.system import find_system
from workers.results import PERIODIC

STICK_SLIP = find_system("stick-slip")
VALUES = {p.name: p.default for p in STICK_SLIP.parameters}


def along(u: float) -> BranchTable:
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
    located = PlaneEvent("grazing_sliding", Condition("speed"), point.orbit, point.contacts, point.values, np.nan)
    found = follow_event(Orbits(), located, 0.02, 10)  # type: ignore[arg-type]
    assert found == "the grazing sliding is alone: no step along its curve converges"


def plane_of_two_regions(periods: tuple[int, int] = (1, 2), changes: tuple[int, int] = (0, 0)) -> CurvePlane:
    """Six by six cells, of one period at the left and another at the right: six edges between them."""
    x, y, cells = np.linspace(1.0, 2.0, 6), np.linspace(0.4, 0.9, 6), 36
    left = np.arange(cells) % 6 < 3
    period, none = np.where(left, *periods), np.zeros(cells, dtype=np.int64)
    return CurvePlane(
        system=STICK_SLIP, axes=("omega", "u"), x=x, y=y, log=(False, False), fixed={}, regime=np.full(cells, PERIODIC),
        period=period, impacts_upper=none, impacts_lower=none, symmetric=np.zeros(cells, dtype=np.bool_),
        speed=np.full(cells, np.nan), state=np.zeros((cells, 2)), changes=np.where(left, *changes)[:, None],
    )  # fmt: skip


@pytest.mark.parametrize(("changes", "edges"), [((0, 0), 0), ((0, 1), 6), ((3, 4), 6)])
def test_cells_of_one_orbit_that_stick_or_not_have_a_border_and_so_have_other_counts_at_a_contact(
    changes: tuple[int, int], edges: int
) -> None:
    """Nothing jumps there, and the branch goes on: without a border none would look for its curve."""
    assert len(plane_of_two_regions((1, 1), changes).edges) == edges


def sliding(omega: list[float], force: list[float], **given: float) -> atlas.Spec:
    return atlas.Spec(
        "friction-oscillator",
        {"omega": omega, "A": force},
        given,
        {"tolerance": 0.1, "survival": 0, "exponents": "none"},
    )


def test_a_store_tells_the_search_which_cells_stick(solved_once: Callable[[atlas.Spec], Path]) -> None:
    """Below the line of Den Hartog the mass stops, above it does not."""
    force = least_force(0.8)
    plane = plane_of(open_store(solved_once(sliding([0.8, 0.805], [0.9 * force, 1.1 * force], s=1.0, zeta=0.0))))
    assert plane.changes[:, 0].tolist() == [1, 1, 0, 0]
    assert plane.edges.tolist() == [[0, 2], [1, 3]]


@pytest.mark.slow
def test_the_end_of_sticking_has_the_curve_of_den_hartog(solved_once: Callable[[atlas.Spec], Path]) -> None:
    omega, force = np.linspace(0.62, 0.95, 6).tolist(), np.linspace(1.05, 2.3, 6).tolist()
    found = found_serially(plane_of(open_store(solved_once(sliding(omega, force, s=1.0, zeta=0.0)))))
    counts = found.report["edges"]["regions"]
    assert counts["all"] > 0
    assert counts["curve"] == counts["all"]
    points = np.concatenate([curve.points for curve in found if curve.kind in ("stick_onset", "stick_end")])
    assert np.ptp(points[:, 0]) > 0.3
    assert points[:, 1] == pytest.approx([least_force(omega) for omega in points[:, 0]], rel=1e-9)


@pytest.mark.slow
def test_the_end_of_sticking_has_a_curve_through_points_that_are_known(
    solved_once: Callable[[atlas.Spec], Path],
) -> None:
    omega, force = np.linspace(0.6, 1.05, 8).tolist(), np.linspace(1.15, 2.25, 8).tolist()
    plane = plane_of(open_store(solved_once(sliding(omega, force))))
    found = found_serially(plane)
    for point in [(0.990514757, 1.316622742), (0.646426019, 1.929849689), (0.826138815, 1.314929928)]:
        at = np.array(point) / plane.width
        assert any(find_passages(curve.points / plane.width, at, 1e-3) for curve in found.of_kind("stick_end")), point


@pytest.mark.parametrize("found", [{"events": [], "why": "no orbit is found"}, {"trouble": "no orbit is found"}])
def test_each_border_that_stays_unexplained_says_why(found: dict[str, Any]) -> None:
    search = CurveSearch(plane_of_two_regions(), CurveSettings())
    while tasks := search.tasks():
        search.add_results([{} if isinstance(task, PersistTask) else found for task in tasks.values()])
    report = finish_search(search).report
    assert report["edges"]["regions"]["unexplained"] == 6
    (border,) = report["unexplained"]
    assert (border["edges"], border["why"]) == (6, "no orbit is found")
    assert border["at"] == pytest.approx({"omega": 1.5, "u": 0.4})
    shown = str(CurveSummary("a.zarr", finish_search(search)))
    assert "unexplained: 6 edges of the border at omega = 1.5, u = 0.4: no orbit is found" in shown


def test_an_orbit_that_goes_on_beyond_a_border_makes_it_one_of_basins() -> None:
    search = CurveSearch(plane_of_two_regions(), CurveSettings())
    while tasks := search.tasks():
        search.add_results(
            [{} if isinstance(task, PersistTask) else {"events": [], "there": PERSISTS} for task in tasks.values()]
        )
    assert finish_search(search).report["edges"]["regions"] == {
        "all": 6, "curve": 0, "basins": 6, "unexplained": 0, "not_tried": 0,
    }  # fmt: skip


@pytest.mark.parametrize("changed", [0, 1])
def test_cells_that_stick_and_cells_that_do_not_are_two_regions_though_all_else_is_alike(changed: int) -> None:
    """The left three columns stick, or have another contact: six edges, and none without such a change."""
    plane, cells = plane_of_two_regions(), np.arange(36)
    alike = replace(plane, period=np.ones(36, dtype=np.int64), changes=np.zeros((36, 2), dtype=np.int64))
    assert len(alike.edges) == 0
    changes = np.zeros((36, 2), dtype=np.int64)
    changes[cells % 6 < 3, changed] = 1
    parted = replace(alike, changes=changes)
    assert len(parted.edges) == 6
    assert len({plane.digest, alike.digest, parted.digest}) == 3


@pytest.mark.slow
@pytest.mark.parametrize(("omega", "A", "kind"), [
    (0.990514757, 1.316622742, "stick_onset"), (0.826138815, 1.314929928, "stick_end"),
])  # fmt: skip
def test_a_branch_has_the_end_of_sticking_where_the_curve_must_pass(omega: float, A: float, kind: str) -> None:
    """Truth: points that a search found when branches ended there; the branch now continues through the event.

    It starts below: of the first point where the mass does not stick, of the second where it does.
    """
    window = (omega - 0.002, omega + 0.002)
    found = atlas.branch({"omega": omega - 1e-3, "A": A}, along="omega", window=window, system="friction-oscillator")
    assert found.events.kind.tolist() == [kind]
    assert found.events.omega.tolist() == [pytest.approx(omega, abs=2e-9)]
    assert found.branches.last_end.tolist() == ["edge"]


@pytest.mark.slow
def test_the_border_of_sticking_has_its_curve_though_branches_continue_through_it(
    tmp_path: Path, client: Client
) -> None:
    axes = {"omega": {"start": 0.6, "stop": 1.1, "num": 5}, "A": {"start": 1.05, "stop": 2.05, "num": 5}}
    atlas.run(atlas.Spec("friction-oscillator", axes), tmp_path / "stick.zarr", client=client)
    atlas.find_curves(tmp_path / "stick.zarr", client=client)
    curves = curves_of(atlas.open(tmp_path / "stick.zarr"))
    edges = curves.report["edges"]["regions"]
    assert (edges["all"], edges["curve"]) == (9, 9)
    (ends,) = curves.of_kind("stick_end")
    assert ends.ends == ("edge", "edge")
    for at in ((0.990514757, 1.316622742), (0.826138815, 1.314929928), (0.646426019, 1.929849689)):
        assert np.min(np.hypot(*(ends.points - at).T)) < 0.01  # its points are up to .02 apart
    (onset,) = curves.of_kind("adding_sliding")
    assert onset.points[:, 1] == pytest.approx(1.2, abs=1e-12)  # an amplitude of static friction moves the mass
