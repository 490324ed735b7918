"""All attractors of a cell that is clicked: found on the cluster, or those that the store has."""

import shutil
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue

import numpy as np
import pytest
from distributed import Client

import atlas
from atlas.explore.actions import new_atlas
from atlas.explore.attractors import AttractorListing, attractor_computation, attractors_table, stored_attractors
from atlas.explore.cell_lookup import CellLookup, CellResult
from atlas.explore.explorer import Explorer
from atlas.explore.jobs import ComputationJob
from atlas.explore.subject import Subject, subject_of
from atlas.explore.tile_cache import TileCache
from atlas.explore.view_state import initial_view
from atlas.query.queries import nearest_cell
from atlas.store.store import open_store
from atlas.store.tiles import drop_tile, read_tile, write_tile
from tests.explore.test_solving import exploring, solved
from tests.query.test_coexistence import spec_of
from workers import Settings
from workers.attractors.coexistence import solve_attractors
from workers.results import PENDING, REGIME

CELL = {"omega": 4.1234567, "b": 0.1}
"""Between the cells of the plane: an orbit of period 1 there, with others beside it."""


def asked(explorer: Explorer, cell: CellResult) -> AttractorListing:
    """The attractors that the explorer finds of a cell."""
    answers: SimpleQueue[AttractorListing] = SimpleQueue()
    explorer.patches.request(
        "test", [ComputationJob(attractor_computation(explorer.subject, cell), answers.put, pytest.fail)]
    )
    return answers.get(timeout=120.0)


@pytest.fixture(scope="module")
def coexistence(tmp_path_factory: pytest.TempPathFactory, client: Client) -> Path:
    """An atlas of all attractors of a few cells."""
    path = tmp_path_factory.mktemp("coexistence") / "out.zarr"
    atlas.run(spec_of(), path, client=client)
    return path


def test_the_attractors_found_are_those_of_solve_attractors_with_the_settings_of_exploring(
    finished: Path, client: Client
) -> None:
    with exploring(finished, client) as explorer:
        subject = explorer.subject
        parameters = dict(subject.plane.parameters) | CELL
        found = asked(explorer, CellResult(parameters, CELL, of_atlas=False))
    alone = solve_attractors(subject.system, parameters, subject.settings, subject.starts)
    assert found.count == int(alone["attractors"]) > 1
    assert [row["share"] for row in found.listed] == alone["share"][: found.count].tolist()
    assert [row["largest"] for row in found.listed] == alone["largest"][: found.count].tolist()
    assert (found.starts, found.own_index, found.stored) == (int(alone["starts"]), int(alone["own_attractor"]), False)


def test_the_known_attractors_of_a_coexistence_atlas_are_shown(coexistence: Path) -> None:
    subject = subject_of(str(coexistence))
    assert subject.all_attractors is not None
    point = {"omega": 4.0, "R": 0.7}
    found = nearest_cell(subject.all_attractors, point)
    cell = CellResult(dict(subject.plane.parameters) | point, nearest_cell(subject.part({}), point), of_atlas=True)
    shown = stored_attractors(subject, cell)
    assert shown is not None and shown.stored
    assert str(list(shown.listed)) == str(found["coexisting"])  # NaN is not equal to itself
    assert stored_attractors(subject, CellResult(cell.parameters, cell.results, of_atlas=False)) is None


def test_cells_of_a_coexistence_atlas_have_the_motion_from_their_own_initial_state(coexistence: Path) -> None:
    subject = subject_of(str(coexistence))
    every, ds = subject.all_attractors, subject.part({})
    assert every is not None
    for place, own in np.ndenumerate(every["own_attractor"].values):
        if own < 0:
            assert ds[REGIME.name].values[place] == PENDING
        else:
            for name in ("largest", REGIME.name, "period"):
                assert np.array_equal(ds[name].values[place], every[name].values[*place, own], equal_nan=True)


def test_what_is_explored_between_the_cells_of_a_coexistence_atlas_has_one_motion_a_cell(
    coexistence: Path, client: Client
) -> None:
    with exploring(coexistence, client) as explorer:
        subject = explorer.subject
        sight = subject.viewport((3.9, 4.1), (0.75, 0.8), (16, 16))
        solved(explorer, sight)
        shown = explorer.known.visible_cells(subject.plane, sight, ["largest"]).ds
    assert shown.largest.dims == ("R", "omega") and not np.any(shown[REGIME.name].values == PENDING)


def test_by_the_papers_schedule_attractors_are_not_sought(finished: Path) -> None:
    subject = subject_of(str(finished))
    fixed = replace(subject, settings=Settings(method="fixed"))
    found = stored_attractors(fixed, CellResult(dict(subject.plane.parameters) | CELL, CELL, of_atlas=False))
    assert found is not None and "adaptive" in attractors_table(found, fixed)["trouble"]


def test_a_cell_without_a_motion_has_no_attractors(finished: Path) -> None:
    told = attractors_table(AttractorListing(), subject_of(str(finished)))
    assert told == {"note": "none of 0 initial states is decided"}


def test_the_table_names_class_orbit_exponent_and_share_of_each_attractor(finished: Path) -> None:
    subject: Subject = subject_of(str(finished))
    orbit = {"regime": "periodic", "period": 3, "impacts_upper": 2, "impacts_lower": 1, "largest": -0.25}
    chaos = {"regime": "chaotic", "period": 0, "impacts_upper": 0, "impacts_lower": 0, "largest": 0.5}
    shares = {"share": 0.75, "share_low": 0.58, "share_high": 0.87}, {"share": 0.2, "share_low": 0.1, "share_high": 0.4}
    told = attractors_table(AttractorListing((orbit | shares[0], chaos | shares[1]), 3, 32, 1, 0.09, 1), subject)
    assert [row[1:] for row in told["rows"]] == [
        ["", "periodic", "3-2-1", "−0.25", "75 % (58–87)"],
        ["►", "chaotic", "", "0.5", "20 % (10–40)"],
    ]
    assert all(len(row) == len(told["heads"]) + 1 for row in told["rows"])
    assert {"of 32 initial states", "1 more, of smaller shares", "1 undecided"} <= {*told["note"].split("; ")}
    assert "9 %" in told["note"]


PLANE = """
system = "two-mass"

[axes.omega]
start = 2.0
stop = 3.0
num = 5

[axes.b]
start = 0.1
stop = 0.4
num = 4

[solve]
max_periods = 1000
survival = 0
"""
ALL_ATTRACTORS = """
[attractors]
starts = 8
seed = 3
keep = 2
box = { x1 = [-0.2, 0.1] }
"""


def test_the_thousandth_new_spec_has_a_file_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("atlas.explore.actions.probe", lambda spec, tile: None)
    (tmp_path / "plane.toml").write_text(PLANE, encoding="utf-8")
    for number in range(1, 1000):
        (tmp_path / f"two-mass-{number}.toml").touch()
    subject = subject_of(str(tmp_path / "plane.toml"))
    made = new_atlas(subject, initial_view(subject), (2.0, 2.5), (0.1, 0.2), 4, tmp_path)
    assert made.file == tmp_path / "two-mass-1000.toml"
    assert made.file.read_text(encoding="utf-8") == made.text
    assert not (tmp_path / "two-mass-999.toml").read_text()


@pytest.mark.parametrize("table", ["", ALL_ATTRACTORS])
def test_the_spec_of_a_new_atlas_seeks_all_attractors_where_the_explored_one_does(tmp_path: Path, table: str) -> None:
    path = tmp_path / "plane.toml"
    path.write_text(PLANE + table, encoding="utf-8")
    subject = subject_of(str(path))
    made = new_atlas(subject, initial_view(subject), (2.0, 2.5), (0.1, 0.2), 4, tmp_path)
    sought = atlas.Spec.from_toml(made.file).attractors
    assert sought == atlas.Spec.from_toml(path).attractors
    assert (sought is None) == (table == "")


def test_an_atlas_of_all_attractors_that_a_run_is_filling_is_seen_as_it_grows(
    coexistence: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("atlas.explore.tile_cache.RELIST_SECONDS", 0.0)
    path = Path(shutil.copytree(coexistence, tmp_path / "out.zarr"))
    handle = open_store(path)
    tiles = {tile.index: read_tile(handle, tile.index) for tile in handle.tiling.tiles()}
    for index in tiles:
        drop_tile(handle, index)
    subject = subject_of(str(path))
    known = CellLookup(TileCache(subject))
    sight = subject.viewport((3.6, 4.4), (0.7, 0.9), (3, 4))

    def pending() -> int:
        """Cells that no click and no picture shows; both agree."""
        seen = known.visible_cells(subject.plane, sight, ["largest"]).ds
        cells = [known.cell(subject.plane, sight, x, y) for y in seen.R.values for x in seen.omega.values]
        there = np.reshape([cell is not None for cell in cells], seen.regime.shape)
        assert np.array_equal(seen.regime.values != PENDING, there)
        covered = known.tiles.atlas_done()
        assert covered is not None and np.array_equal(covered, there)
        return int(np.sum(~there))

    left = [pending()]
    for index, arrays in tiles.items():
        write_tile(handle, index, arrays)
        left.append(pending())
    own = atlas.open(path)["own_attractor"].values
    assert left[0] == own.size and left[-1] == np.sum(own < 0) and left == sorted(set(left), reverse=True)
