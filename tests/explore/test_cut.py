"""Cuts: the cells along a line over a plane."""

import numpy as np
import pytest
from distributed import Client

import atlas
from atlas.explore.cut import (
    SAMPLES,
    STEPS,
    CutCells,
    CutLine,
    cut_computation,
    exponents,
    shown_points,
    to_observe,
)
from atlas.explore.jobs import ComputationJob
from atlas.explore.subject import Subject, subject_of
from tests.explore.test_solving import exploring, waited


@pytest.fixture(scope="module")
def subject() -> Subject:
    return subject_of("omega-b")


def solved(line: CutLine, parts: list[tuple[int, ...]]) -> CutCells:
    """Cells of a line, solved here."""
    found = None
    for part in parts:
        question = cut_computation(line, part)
        assert question.n_cells == len(part)
        found = question.postprocess(question.function(question.argument)).merged_with(found)
    assert found is not None
    return found


def test_each_point_of_a_line_is_solved_once_and_coarse_points_first(subject: Subject) -> None:
    parts = CutLine(subject, subject.plane, (2.0, 0.2, 3.0, 0.3)).batches()
    assert sorted(k for part in parts for k in part) == list(range(STEPS + 1))
    assert parts[0] == tuple(range(0, STEPS + 1, 8))
    gaps = [min(np.diff(sorted(k for part in parts[: n + 1] for k in part))) for n in range(len(parts))]
    assert gaps == sorted(gaps, reverse=True)


def test_a_line_begins_and_ends_where_it_was_drawn_to_the_bit(subject: Subject) -> None:
    ends = (2.0123456789, 0.2012345678, 3.3, 0.1)
    x, y = CutLine(subject, subject.plane, ends).points(np.array([0, STEPS]))
    assert (x[0], y[0], x[1], y[1]) == ends


def test_the_cells_of_a_slanted_line_are_those_of_the_point_command_to_the_bit(subject: Subject) -> None:
    line = CutLine(subject, subject.plane.with_value("R", 0.7), (3.6, 0.45, 3.9, 0.5))
    cells = solved(line, [(0, 100, STEPS)])
    x, y = line.points(cells.index)
    for k in range(3):
        alone = atlas.point({"omega": x[k], "b": y[k], "R": 0.7}, settings=subject.settings)
        assert cells.results["largest"][k] == alone["largest"]
        assert cells.results["state"][k].tolist() == alone["state"]


def test_an_orbit_of_period_one_is_one_point_of_the_section(subject: Subject) -> None:
    line = CutLine(subject, subject.plane, (3.9, 0.1, 4.0, 0.1))
    cells = solved(line, [(0, 128)])
    assert cells.results["period"].tolist() == [1, 1]
    drawn = shown_points(line, cells)
    assert drawn["x"].tolist() == line.points(cells.index)[0].tolist()
    states = [atlas.point({"omega": x, "b": 0.1}, settings=subject.settings)["state"] for x in drawn["x"]]
    assert np.allclose(drawn["y"], [state[0] for state in states], atol=1e-6)


def test_cells_that_come_twice_are_drawn_once(subject: Subject) -> None:
    index = np.array([0, 128, 256])
    cells = CutCells(index, {"shown": index[:, None] / 10.0})
    both = CutCells(np.array([64, 128]), {"shown": np.array([[6.4], [12.8]])}).merged_with(cells)
    assert both.index.tolist() == [0, 64, 128, 256]
    assert both.results["shown"].ravel().tolist() == [0.0, 6.4, 12.8, 25.6]


def test_chaos_fills_the_section_and_the_exponent_has_its_error_about_it(subject: Subject) -> None:
    line = CutLine(subject, subject.plane, (1.5, 0.1, 1.6, 0.1))
    cells = solved(line, [(0,)])
    assert shown_points(line, cells)["x"].size == SAMPLES
    found = exponents(line, cells)
    assert found["low"][0] < found["largest"][0] < found["high"][0] and found["largest"][0] > 0


def test_a_cut_shows_the_phases_of_impacts_of_its_cells(subject: Subject) -> None:
    """Of symmetric orbits: two a cell, half a turn apart."""
    line = CutLine(subject, subject.plane, (3.9, 0.15, 4.0, 0.15), to_observe(subject)["phase of the force at impacts"])
    cells = solved(line, [(0, 128, 256)])
    drawn = shown_points(line, cells)
    assert drawn["x"].tolist() == [3.9, 3.9, 3.95, 3.95, 4.0, 4.0]
    assert np.abs(np.diff(drawn["y"])[::2]) == pytest.approx([np.pi] * 3, abs=1e-5)
    assert not cells.results["more"].any()


def test_a_cut_is_solved_on_the_cluster_and_dropped_when_nobody_wants_it(subject: Subject, client: Client) -> None:
    with exploring("omega-b", client) as explorer:
        line, came = CutLine(explorer.subject, explorer.subject.plane, (3.7, 0.45, 3.9, 0.45)), []
        jobs = [ComputationJob(cut_computation(line, part), came.append, pytest.fail) for part in line.batches()]
        explorer.patches.request("page", jobs[:2])
        assert waited(lambda: explorer.patches.n_remaining("page") == 0)
        assert sum(cells.index.size for cells in came) == sum(map(len, line.batches()[:2]))
        explorer.patches.request("page", jobs)
        explorer.patches.request("page", ())
        assert explorer.patches.n_remaining("page") == 0
