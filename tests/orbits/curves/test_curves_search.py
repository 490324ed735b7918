"""Finding the curves of a plane through the whole service: what is found, by whom, and after an interruption."""

import math
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner
from distributed import Client

import atlas
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.orbits.curves.cell_orbits import CellOrbits
from atlas.orbits.curves.following import events_between, follow_event, lies_on
from atlas.orbits.curves.plane import plane_of
from atlas.orbits.curves.settings import CurveSettings
from atlas.orbits.curves.table import read_curves, write_curves
from atlas.service.curves import CurveSummary, find_curves
from atlas.service.options import RunOptions
from atlas.service.progress import Progress
from atlas.store.create import create_store
from atlas.store.groups import CURVES
from atlas.store.parts import part_names
from atlas.store.store import open_store
from atlas.store.tiles import write_tile
from tests import synthetic
from tests.curve_planes import all_same, ball, forces, found_serially, pair
from tests.paths import ROOT
from tests.reference_machines import amplitude
from tests.support.faults import ATLAS
from workers.continuation import Orbit
from workers.results import CHAOTIC


@pytest.fixture(scope="module")
def solved(solved_once: Callable[[atlas.Spec], Path]) -> Path:
    """The plane of ``forces``, without curves, only to be read."""
    return solved_once(forces())


@pytest.fixture(scope="module")
def searched(solved: Path, client: Client) -> tuple[Path, CurveSummary]:
    """The same with its curves, and what finding them said."""
    path = Path(shutil.copytree(solved, solved.parent / "searched.zarr"))
    return path, find_curves(path, client=client)


@pytest.fixture
def fresh(solved: Path, tmp_path: Path) -> Path:
    """A copy without curves."""
    return Path(shutil.copytree(solved, tmp_path / "out.zarr"))


def amplitudes(path: Path, points: np.ndarray) -> np.ndarray:
    """|Y| of the motion without impact at points (N, 2) of the plane of ``forces``."""
    return amplitude(CellOrbits(plane_of(open_store(path))).family.model(points))


def test_every_border_between_regions_is_explained(searched: tuple[Path, CurveSummary]) -> None:
    edges = searched[1].as_dict()["edges"]["regions"]
    assert edges["all"] > 0
    assert edges["curve"] + edges["basins"] == edges["all"]


def test_workers_do_not_go_with_a_client(tmp_path: Path, client: Client) -> None:
    with pytest.raises(InputError, match="workers: found 2, applies to a local cluster only, not to a client"):
        find_curves(tmp_path / "plane.zarr", client=client, options=RunOptions(workers=2))


def test_the_search_is_its_naive_twin_to_the_bit(searched: tuple[Path, CurveSummary]) -> None:
    path, summary = searched
    assert all_same(summary.curves, found_serially(plane_of(open_store(path))))


def test_a_store_that_has_the_curves_gives_them_at_once(searched: tuple[Path, CurveSummary]) -> None:
    path, summary = searched
    again = find_curves(path)
    assert again.tasks == 0
    assert all_same(again.curves, summary.curves)
    assert not list(part_names(open_store(path), CURVES))


@pytest.mark.slow
@pytest.mark.parametrize("stop_after", [2, 5])
def test_a_search_that_was_stopped_goes_on_and_finds_the_same_to_the_bit(
    fresh: Path, searched: tuple[Path, CurveSummary], client: Client, stop_after: int
) -> None:
    def stop(progress: Progress) -> None:
        if progress.cells and len(list(part_names(open_store(fresh), CURVES))) >= stop_after:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        find_curves(fresh, client=client, options=RunOptions(on_progress=stop))
    assert read_curves(open_store(fresh)) is None
    resumed = find_curves(fresh, client=client)
    assert resumed.tasks < searched[1].tasks
    assert all_same(resumed.curves, searched[1].curves)


@pytest.mark.slow
def test_parts_of_another_search_are_not_used(fresh: Path, searched: tuple[Path, CurveSummary], client: Client) -> None:
    def stop(progress: Progress) -> None:
        if progress.cells:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        find_curves(fresh, CurveSettings(edges=1), client=client, options=RunOptions(on_progress=stop))
    assert all_same(find_curves(fresh, client=client).curves, searched[1].curves)


@pytest.mark.slow
def test_a_budget_that_is_spent_is_told(fresh: Path, client: Client) -> None:
    summary = find_curves(fresh, CurveSettings(curves=1), client=client)
    assert len(summary.curves) == 1
    assert summary.curves.report["events_not_followed"] > 0
    assert "not followed" in str(summary)


@pytest.mark.slow
def test_a_curve_cut_short_by_the_budget_of_points_says_so(fresh: Path, client: Client) -> None:
    summary = find_curves(fresh, CurveSettings(points=20), client=client)
    assert summary.curves.report["points"] <= 22
    assert any("budget" in curve.ends for curve in summary.curves)


@pytest.mark.slow
def test_an_event_elsewhere_on_a_known_curve_is_on_it_and_one_of_another_orbit_at_the_same_place_is_not(
    solved: Path,
) -> None:
    orbits = CellOrbits(plane_of(open_store(solved)))
    row = len(orbits.plane.x)
    events = []
    for start in (0, row):
        cells = [(start + k, start + k + 1) for k in range(row - 1)]
        ways = [(b, a) for a, b in cells if orbits.plane.symmetric[b] and not orbits.plane.symmetric[a]]
        events.append(events_between(orbits, *ways[0], 2.0).events[0])
    known = follow_event(orbits, events[0], 0.02, 200)
    assert not isinstance(known, str)
    assert lies_on(orbits, events[1], known)
    other = events[1].orbit
    faster = Orbit(other.itinerary, other.times, 1.001 * other.speeds)
    assert not lies_on(orbits, events[1]._replace(orbit=faster), known)


def test_verify_and_plain_xarray_and_a_zip_file_take_a_store_with_curves(
    searched: tuple[Path, CurveSummary], tmp_path: Path
) -> None:
    path, summary = searched
    assert atlas.verify(path, sample=0).is_sound
    assert "curves" not in xr.open_zarr(path)
    atlas.pack(path, tmp_path / "out.zip")
    assert all_same(find_curves(tmp_path / "out.zip").curves, summary.curves)


@pytest.mark.slow
def test_an_extended_atlas_begins_without_curves(
    searched: tuple[Path, CurveSummary], tmp_path: Path, client: Client
) -> None:
    atlas.extend(searched[0], tmp_path / "finer.zarr", refine={"b": 2}, client=client)
    assert read_curves(open_store(tmp_path / "finer.zarr")) is None


def test_the_accessor_gives_the_curves_as_two_tables_and_one_kind_of_them(
    searched: tuple[Path, CurveSummary],
) -> None:
    path, summary = searched
    ds = atlas.open(path)
    points, corners = ds.atlas.curves()
    assert len(points) == sum(len(curve.points) for curve in summary.curves)
    assert len(corners) == sum(len(curve.corners) for curve in summary.curves)
    assert set(ds.atlas.curves("symmetry_breaking").points["kind"]) == {"symmetry_breaking"}
    assert points.attrs["report"] == dict(summary.curves.report)
    with pytest.raises(atlas.errors.InputError, match="did you mean 'fold'"):
        ds.atlas.curves("folt")


@pytest.mark.slow
def test_the_distance_to_an_event_along_an_axis_ends_on_its_curve(searched: tuple[Path, CurveSummary]) -> None:
    """Along b the event lies where the curve of that kind has the cell's f2: on b = const |Y(f2)|."""
    path, summary = searched
    at = {"b": 0.29, "f2": -0.1}
    found = atlas.open(path).atlas.distance_to(at, kind="symmetry_breaking").to_dict("records")
    along = next(entry for entry in found if entry["axis"] == "b")
    assert along["distance"] == pytest.approx(along["value"] - at["b"], abs=1e-15)
    curve = summary.curves.of_kind("symmetry_breaking")[0]
    const = curve.points[0, 0] / amplitudes(path, curve.points[:1])[0]
    exact = const * amplitudes(path, np.array([[along["value"], at["f2"]]]))[0]
    assert along["value"] == pytest.approx(exact, rel=1e-9)
    assert [entry["share"] for entry in found] == sorted(entry["share"] for entry in found)


def test_the_distance_from_a_chaotic_cell_is_refused_in_one_line(tmp_path: Path) -> None:
    path = chaotic(tmp_path)
    with pytest.raises(atlas.errors.InputError, match="is chaotic: events need a proven periodic orbit"):
        atlas.open(path).atlas.distance_to(omega=2.0, b=0.3)


def chaotic(folder: Path) -> Path:
    """A finished plane of nothing but chaos."""
    handle = create_store(folder / "chaos.zarr", synthetic.spec_of(6, 4), (4, 6))
    results = synthetic.results(handle, (0, 0))
    results["regime"][...], results["period"][...], results["impacts_upper"][...] = CHAOTIC, 0, 0
    write_tile(handle, (0, 0), results)
    return handle.path


def test_a_plane_of_chaos_has_no_curves(tmp_path: Path, client: Client) -> None:
    summary = find_curves(chaotic(tmp_path), client=client)
    assert len(summary.curves) == 0
    assert summary.as_dict()["edges"]["regions"]["all"] == 0


@pytest.mark.slow
@pytest.mark.parametrize("make", [ball, pair], ids=["ball", "pair"])
def test_curves_of_the_closed_forms_are_these(make: Any, tmp_path: Path) -> None:
    """Through the whole command: the ball's fold and doubling, the symmetry breaking of the pair."""
    atlas.run(make(), tmp_path / "out.zarr", options=RunOptions(workers=1))
    made = CliRunner().invoke(main, ["find", "curves", str(tmp_path / "out.zarr"), "--workers", "1"])
    assert made.exit_code == 0, made.output
    found = read_curves(open_store(tmp_path / "out.zarr"))
    assert found is not None
    checked = set()
    for curve in found:
        exact = {"ball": exact_ball, "pair": exact_pair}[make.__name__](curve.kind, curve.label, curve.symmetric)
        if exact is not None:
            checked.add(curve.kind)
            for x, R in curve.points:
                assert x == pytest.approx(exact(R), abs=1e-10)
    assert checked == {"ball": {"fold", "period_doubling"}, "pair": {"symmetry_breaking"}}[make.__name__]


def exact_ball(kind: str, label: str, symmetric: bool) -> Any:
    """omega at A = 1.2, g = 1 of the orbit of period 1: A omega^2 = Gamma_1 and Gamma_2."""

    def fold(R: float) -> float:
        return math.pi * (1.0 - R) / (1.0 + R)

    gamma = {
        "fold": fold,
        "period_doubling": lambda R: math.hypot(fold(R), 2.0 * (1.0 + R**2) / (1.0 + R) ** 2),
    }.get(kind)
    # the table is its lower stop, and no motion of a ball has a mirror image
    return None if label != "1-0-1" or gamma is None else lambda R: math.sqrt(gamma(R) / 1.2)


def exact_pair(kind: str, label: str, symmetric: bool) -> Any:
    """nu at alpha = 1 of the symmetric orbit with one impact at either wall."""

    def breaking(R: float) -> float:
        rho = (1.0 + R) / (1.0 - R)
        return rho * (math.pi - 4.0 / math.pi) / math.sqrt(1.0 + 4.0 * rho**2 / math.pi**2)

    return breaking if symmetric and label == "1-1-1" and kind == "symmetry_breaking" else None


@pytest.mark.slow
def test_worker_processes_find_the_same_to_the_bit(fresh: Path, searched: tuple[Path, CurveSummary]) -> None:
    found = find_curves(fresh, options=RunOptions(workers=2))
    assert all_same(found.curves, searched[1].curves)


@pytest.mark.slow
def test_after_a_kill_the_same_command_finds_the_same_to_the_bit(
    fresh: Path, searched: tuple[Path, CurveSummary], tmp_path: Path
) -> None:
    command = [*ATLAS, "find", "curves", str(fresh), "--workers", "2"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with (tmp_path / "log").open("w") as log:
        running = subprocess.Popen(command, env=environment, stdout=log, stderr=log, start_new_session=True)
        while running.poll() is None and len(list(part_names(open_store(fresh), CURVES))) < 4:
            time.sleep(0.1)
        assert running.poll() is None, (tmp_path / "log").read_text()
        os.killpg(running.pid, signal.SIGKILL)
        running.wait()
    assert read_curves(open_store(fresh)) is None
    subprocess.run(command, env=environment, check=True, capture_output=True, timeout=600)
    found = read_curves(open_store(fresh))
    assert found is not None
    assert all_same(found, searched[1].curves)


class TestBadInput:
    """One line, exit code 2, nothing written."""

    def refused(self, *words: str) -> str:
        made = CliRunner().invoke(main, ["find", "curves", *words])
        assert made.exit_code == 2, made.output
        assert made.stdout == ""
        (line,) = made.stderr.strip().splitlines()
        return line

    def test_a_store_that_is_not_finished(self, fresh: Path) -> None:
        (fresh / "regime" / "c" / "0" / "0").unlink()
        assert "1 tile unfinished; complete the store with atlas run" in self.refused(str(fresh))
        assert not (fresh / "curves").exists()

    def test_a_sweep(self, tmp_path: Path) -> None:
        spec = atlas.Spec("two-mass", {"omega": {"start": 2.0, "stop": 3.0, "num": 3}})
        create_store(tmp_path / "sweep.zarr", spec, (3,))
        assert "found one axis; curves need a plane" in self.refused(str(tmp_path / "sweep.zarr"))

    def test_an_axis_of_initial_states(self, tmp_path: Path) -> None:
        axes = {"x1": {"start": 0.0, "stop": 0.1, "num": 3}, "omega": {"start": 2.0, "stop": 3.0, "num": 3}}
        create_store(tmp_path / "start.zarr", atlas.Spec("two-mass", axes), (3, 3))
        assert "axis x1 only sets the start of a motion" in self.refused(str(tmp_path / "start.zarr"))

    def test_a_phase_of_the_force_that_no_orbit_depends_on(self, tmp_path: Path) -> None:
        axes = {"tau": {"start": 0.0, "stop": 3.0, "num": 3}, "omega": {"start": 2.0, "stop": 3.0, "num": 3}}
        create_store(tmp_path / "tau.zarr", atlas.Spec("two-mass", axes), (3, 3))
        assert "axis tau only sets the start of a motion" in self.refused(str(tmp_path / "tau.zarr"))

    def test_no_store(self, tmp_path: Path) -> None:
        assert "no such store" in self.refused(str(tmp_path / "none.zarr"))

    def test_another_suffix(self, fresh: Path) -> None:
        assert "possible: .csv, .json" in self.refused(str(fresh), "-o", "curves.txt")

    def test_a_zip_file_without_curves(self, fresh: Path, tmp_path: Path) -> None:
        atlas.pack(fresh, tmp_path / "out.zip")
        assert "a zip file is read-only" in self.refused(str(tmp_path / "out.zip"))

    def test_a_budget_of_nothing(self) -> None:
        with pytest.raises(atlas.errors.InputError, match="curves: found 0, must be a whole number, 1 or more"):
            CurveSettings(curves=0)


@pytest.mark.slow
def test_damaged_curves_are_found_anew(searched: tuple[Path, CurveSummary], tmp_path: Path, client: Client) -> None:
    path = Path(shutil.copytree(searched[0], tmp_path / "out.zarr"))
    (path / "curves" / "position" / "c" / "0" / "0").write_bytes(b"nothing that anybody wrote")
    assert all_same(find_curves(path, client=client).curves, searched[1].curves)


@pytest.mark.slow
def test_curves_of_cells_that_were_solved_again_are_found_anew(
    searched: tuple[Path, CurveSummary], tmp_path: Path, client: Client
) -> None:
    path = Path(shutil.copytree(searched[0], tmp_path / "out.zarr"))
    handle = open_store(path)
    stale = searched[1].curves
    write_curves(handle, type(stale)(stale.axes, (), {**stale.report, "digest": "of other cells"}))
    assert all_same(find_curves(path, client=client).curves, stale)


def test_the_angle_between_force_and_phases_is_an_axis_of_curves(tmp_path: Path, client: Client) -> None:
    """Where the stiffness of a gear mesh switches, tau says when in a mesh period: orbits depend on it."""
    axes = {"tau": {"start": 0.0, "stop": 6.0, "num": 6}, "eps": {"start": 0.05, "stop": 0.55, "num": 6}}
    solve = {"survival": 1000, "tolerance": 0.1}
    spec = atlas.Spec("gear-mesh", axes, parameters={"omega": 0.5, "E": 0.4}, solve=solve)
    atlas.run(spec, tmp_path / "mesh.zarr", client=client)
    plane = plane_of(open_store(tmp_path / "mesh.zarr"))
    assert (sorted(plane.axes), plane.shape) == (["eps", "tau"], (6, 6))
