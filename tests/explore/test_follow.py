"""The orbit of a cell, followed along a parameter: its branch, the events next to it, its motion, its address."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from urllib.parse import parse_qs

import numpy as np
import pytest

import atlas
from atlas.errors import InputError
from atlas.explore.branches import (
    BranchPosition,
    EventArrow,
    FollowedBranch,
    arrows,
    branch_computation,
    distance,
    follow_orbit,
    initial_follow,
)
from atlas.explore.details_panel import DetailsPanel
from atlas.explore.follow_panel import FollowPanel, label_of
from atlas.explore.subject import Subject, subject_of
from atlas.explore.view_state import FollowedOrbit, Point, ViewState, followable, from_address
from atlas.orbits.branches.table import orbit_name
from tests.explore.messages import to_address

CELL = {"omega": 1.75, "b": 0.125}
"""Its orbit of period 1 breaks its symmetry at 1.60, turns back at a fold at 1.758, and loses an impact at 1.27."""
WINDOW = (1.2, 2.0)


@pytest.fixture(scope="module")
def subject() -> Subject:
    return subject_of("omega-b")


def at_cell(subject: Subject, cell: dict[str, float] = CELL, **fields: Any) -> ViewState:
    """The cell chosen in a view around it."""
    chosen = ViewState((1.2, 2.0), (0.05, 0.3), subject.plane, "period", cell=(subject.plane, cell["omega"], cell["b"]))
    return replace(chosen, **fields)


def cell_of(subject: Subject) -> Point:
    """The cell by itself."""
    return subject.plane, CELL["omega"], CELL["b"]


def followed(subject: Subject, chosen: ViewState, along: str) -> FollowedBranch:
    """The branch of the cell that is chosen, found here."""
    assert chosen.cell is not None
    question = branch_computation(subject, chosen.cell, initial_follow(subject, chosen, chosen.cell, along)[:3])
    return question.postprocess(question.function(question.argument))


@pytest.fixture(scope="module")
def found(subject: Subject) -> FollowedBranch:
    return followed(subject, at_cell(subject), "omega")


@pytest.fixture(scope="module")
def own(found: FollowedBranch) -> BranchPosition:
    return found.position_at(found.own_index, CELL["omega"])


@pytest.fixture(scope="module")
def alone(subject: Subject) -> Any:
    """The branch by the public function."""
    return atlas.branch(CELL, along="omega", window=WINDOW, settings=subject.spec.settings)


def test_the_events_beside_the_cell_are_those_of_atlas_branch_to_the_bit(
    own: BranchPosition, found: FollowedBranch, alone: Any
) -> None:
    events = alone.events.set_index("kind")["omega"]
    before, after = found.neighbouring_events(own)
    assert before is not None and (before.kind, before.value) == ("symmetry breaking", events["symmetry_breaking"])
    assert after is not None and (after.kind, after.value) == ("fold", events["fold"])
    assert float(distance(after, own)) == pytest.approx(events["fold"] - CELL["omega"], rel=1e-4)
    assert distance(before, own).startswith("−0.148") and distance(after, own).startswith("+0.008")


def test_beyond_the_fold_both_events_lie_on_either_side_of_it_again(found: FollowedBranch, alone: Any) -> None:
    """In the order of the branch the parameter falls after the fold, and the impact is lost on the way down."""
    fold = next(mark for mark in found.events if mark.kind == "fold")
    here = found.position_at(fold.point_index + 3, found.values[fold.point_index + 3])
    before, after = found.neighbouring_events(here)
    assert before == fold and after is not None and after.kind == "impact lost"
    assert after.value < here.value < fold.value
    assert here.point.unstable == 1


def test_what_is_in_view_has_smaller_steps_and_the_branch_goes_on_beyond_it(
    found: FollowedBranch, subject: Subject
) -> None:
    """The view ends between the symmetry breaking at 1.60 and the fold at 1.758, which the branch passes twice."""
    near = followed(subject, at_cell(subject, x=(1.74, 1.79)), "omega")
    assert near.values[near.own_index] == CELL["omega"]
    seen = [1.74 <= value <= 1.79 for value in near.values]
    assert sum(seen) > 50 > sum(1.74 <= value <= 1.79 for value in found.values)
    assert seen[near.own_index] and not seen[0] and not seen[-1]
    assert [mark.kind for mark in near.events] == [mark.kind for mark in found.events]
    assert [mark.value for mark in near.events] == pytest.approx([mark.value for mark in found.events], abs=1e-9)
    steps = np.abs(np.diff(next(near.table.gap_values(near.branch))[:, 0]))
    assert steps.max() < 0.004  # no jump where the parts meet


def test_at_an_event_the_orbit_says_so_and_the_events_beside_it_are_others(found: FollowedBranch) -> None:
    fold = next(mark for mark in found.events if mark.kind == "fold")
    here = found.position_at(fold.point_index, fold.value)
    before, after = found.neighbouring_events(here)
    assert here.kind == "fold" and here.multiplier == pytest.approx(1.0, abs=1e-6)
    assert before is not None and after is not None and fold not in (before, after)


def test_a_closed_branch_has_the_events_beside_it_all_around(found: FollowedBranch) -> None:
    branch = found.branch
    run = branch.run._replace(ends=("closed", "closed"))
    ring = FollowedBranch(replace(found.table, traced=(replace(branch, run=run),)), found.own_index)
    assert ring.neighbouring_events(ring.position_at(0, ring.values[0]))[0] == ring.events[-1]


def test_the_cells_own_orbit_is_a_point_of_the_branch(
    own: BranchPosition, found: FollowedBranch, subject: Subject
) -> None:
    cell = atlas.point(CELL, settings=subject.spec.settings)
    assert own.value == CELL["omega"] and orbit_name(own.point.orbit.itinerary, found.table.system) == "1-2-2 symmetric"
    motion = found.motion(own)
    assert motion.moving[0][0] == pytest.approx(cell["state"][0], abs=1e-9)


def test_a_value_that_is_typed_is_solved_exactly(found: FollowedBranch, own: BranchPosition, subject: Subject) -> None:
    value = 1.7312345
    place = found.find_point(value, own)
    assert place is not None
    here, cell = found.position_at(place, value), atlas.point({**CELL, "omega": value}, settings=subject.spec.settings)
    assert here.value == value and value not in found.values
    assert found.motion(here).moving[0][0] == pytest.approx(cell["state"][0], abs=1e-9)
    # The largest multiplier of a stable orbit is the exponential of its largest exponent.
    assert np.log(here.multiplier) == pytest.approx(cell["largest"], abs=1e-8)
    assert found.neighbouring_events(here) == found.neighbouring_events(own)


def test_a_value_is_sought_on_the_side_of_the_fold_where_one_is(found: FollowedBranch, own: BranchPosition) -> None:
    fold = next(mark for mark in found.events if mark.kind == "fold")
    there = found.position_at(fold.point_index + 5, found.values[fold.point_index + 5])
    value = 0.5 * (there.value + found.values[fold.point_index + 6])
    assert found.find_point(value, there) == fold.point_index + 5
    first = found.find_point(value, own)
    assert first is not None and first < fold.point_index
    assert found.find_point(2.5, own) is None


@pytest.mark.parametrize("beyond", [0, 7])
def test_the_motion_of_stable_and_unstable_orbits_closes_and_reaches_both_stops(
    found: FollowedBranch, beyond: int
) -> None:
    fold = next(mark for mark in found.events if mark.kind == "fold")
    place = fold.point_index + beyond - 1
    here = found.position_at(place, found.values[place])
    motion = found.motion(here)
    assert here.point.unstable == (1 if beyond else 0)
    assert motion.y.max() == pytest.approx(CELL["b"], abs=1e-9) and motion.y.min() == pytest.approx(
        -CELL["b"], abs=1e-9
    )
    assert motion.y[-1] == pytest.approx(motion.y[0], abs=1e-9)
    assert motion.stops == [-CELL["b"], CELL["b"]] and motion.moving.shape == (4, 200)


def test_the_drawn_velocity_jumps_at_an_impact_by_the_law_of_restitution(
    found: FollowedBranch, own: BranchPosition
) -> None:
    motion = found.motion(own)
    at_stop = np.flatnonzero(np.isclose(motion.y, CELL["b"], rtol=0.0, atol=1e-8))
    assert motion.v[at_stop[1]] == pytest.approx(-found.table.parameters["R"] * motion.v[at_stop[0]], rel=1e-6)


def test_the_sections_of_an_orbit_of_several_periods_are_those_of_its_branch(subject: Subject) -> None:
    cell = {"omega": 2.5, "b": 0.125}
    found = followed(subject, at_cell(subject, cell, x=(2.4, 2.6)), "omega")
    here = found.position_at(found.own_index, cell["omega"])
    motion = found.motion(here)
    gap = next(found.table.gap_values(found.branch))[found.own_index]
    assert gap.size == 2 and motion.per_period == 200
    assert motion.moving[0][::200] == pytest.approx(gap, abs=1e-10)


def test_a_motion_closes_also_where_an_impact_has_moved_over_the_section(subject: Subject) -> None:
    """Along this branch an impact of the turn passes the end of the turn."""
    cell = {"omega": 2.0, "b": 0.05}
    found = followed(subject, at_cell(subject, cell, x=(1.9, 2.1), y=(0.02, 0.1)), "b")
    points = found.branch.run.points
    beyond = [k for k, point in enumerate(points) if point.orbit.times[-1] > 1.5 * np.pi]
    assert beyond
    for k in beyond:
        motion = found.motion(found.position_at(k, found.values[k]))
        assert motion.y[-1] == pytest.approx(motion.y[0], abs=1e-9)


def test_an_arrow_ends_at_its_event_or_at_the_edge_of_the_view(
    found: FollowedBranch, own: BranchPosition, subject: Subject
) -> None:
    back, on = arrows(found, own, subject, at_cell(subject, x=(1.7, 1.9)), cell_of(subject))
    before, after = found.neighbouring_events(own)
    assert before is not None and after is not None
    assert (back.x0, back.x1) == (1.75, 1.7) and before.value < 1.7
    assert (on.x0, on.x1) == (1.75, after.value) and on.y0 == on.y1 == CELL["b"]
    assert on.text == f"fold {distance(after, own)}" and back.text == f"symmetry breaking {distance(before, own)}"


@pytest.mark.parametrize(
    ("place", "end", "text", "align", "right"),
    [
        (0.5, 0.7, "fold →", "left", 14), (0.5, 0.2, "← fold", "right", -14),  # outwards
        (0.9, 1.0, "fold →", "right", -14), (0.1, 0.0, "← fold", "left", 14),  # no room there
    ],
)  # fmt: skip
def test_the_label_of_an_arrow_lies_on_its_side_of_the_marker_where_there_is_room(
    place: float, end: float, text: str, align: str, right: int
) -> None:
    said, aligned, _, offset, _ = label_of(EventArrow(place, 0.1, end, 0.1, "fold"), 0, (0.0, 1.0))
    assert (said, aligned, offset) == (text, align, right)


def test_a_parameter_that_is_no_axis_has_events_but_no_arrows(subject: Subject) -> None:
    chosen = at_cell(subject)
    found = followed(subject, chosen, "R")
    here = found.position_at(found.own_index, 0.8)
    assert found.table.window[0] < 0.8 < found.table.window[1]
    assert any(found.neighbouring_events(here)) and arrows(found, here, subject, chosen, cell_of(subject)) == []


def test_a_view_beyond_the_range_of_a_parameter_is_followed_within_that(subject: Subject) -> None:
    follow = initial_follow(subject, at_cell(subject, y=(-0.1, 0.3)), cell_of(subject), "b")
    assert 0.0 < follow.low <= CELL["b"] and follow.high == 0.3
    assert initial_follow(subject, at_cell(subject, y=(0.2, 0.3)), cell_of(subject), "b").low == CELL["b"]


def test_orbits_are_followed_along_parameters_and_not_along_initial_states(subject: Subject) -> None:
    assert followable(subject)[:2] == ["omega", "b"]
    assert not {*followable(subject)} & {*subject.system.states}


def test_the_orbit_of_a_chaotic_cell_is_refused_in_one_line(subject: Subject) -> None:
    with pytest.raises(InputError, match="this cell is chaotic: a branch starts from a periodic cell"):
        followed(subject, at_cell(subject, {"omega": 1.5, "b": 0.1}), "omega")


def test_a_branch_of_one_point_is_refused_in_one_line(subject: Subject) -> None:
    window = CELL["omega"], float(np.nextafter(CELL["omega"], 2.0))
    asked = subject.system, dict(subject.plane.parameters) | CELL, subject.spec.settings, "omega", (window, window)
    with pytest.raises(InputError, match=r"has only one point, at 1\.75"):
        follow_orbit(asked)


def test_an_orbit_of_a_machine_with_modes_is_drawn_too() -> None:
    subject = subject_of("soft-impact")
    assert subject.axes == ("omega", "a")
    chosen = ViewState((0.85, 0.95), (0.4, 0.6), subject.plane, "period", cell=(subject.plane, 0.9, 0.5))
    found = followed(subject, chosen, "omega")
    here = found.position_at(found.own_index, found.values[found.own_index])
    motion, gap = found.motion(here), next(found.table.gap_values(found.branch))[found.own_index]
    assert motion.moving[0][:: int(motion.per_period)] == pytest.approx(gap, abs=1e-9)
    assert motion.y[-1] == pytest.approx(motion.y[0], abs=1e-8)


def arguments(query: str) -> dict[str, list[bytes]]:
    return {name: [text.encode() for text in texts] for name, texts in parse_qs(query).items()}


def test_an_address_has_what_is_followed_and_where(subject: Subject) -> None:
    chosen = at_cell(subject, follow=FollowedOrbit("omega", 1.2, 2.0, -7, 1.7312345))
    address = to_address(subject, subject, chosen)
    assert "follow.orbit=omega,1.2,2.0,-7,1.7312345" in address
    assert from_address(subject, arguments(address)).follow == chosen.follow


@pytest.mark.parametrize(
    ("query", "said"),
    [
        ("follow.orbit=omega,1.2,2.0,0,1.75", "follow: needs a cell"),
        ("cell=1.75,0.125&follow.orbit=x1,1.2,2.0,0,1.75", "parameter in follow"),
        ("cell=1.75,0.125&follow.orbit=omega,1.2", "follow.orbit: found '1.2', must be 4 numbers"),
    ],
)
def test_an_address_that_cannot_be_followed_is_refused(subject: Subject, query: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        from_address(subject, arguments(query))


@pytest.fixture
def told() -> list[dict[str, Any]]:
    """What panels tell the page."""
    return []


@pytest.fixture
def parts(subject: Subject, told: list[dict[str, Any]]) -> Any:
    """What panels are made of, with the jobs that each kind of panel has asked for, and the work in the background."""
    wanted, works = dict[type, list[Any]](), list[Any]()
    patches = SimpleNamespace(request=lambda who, jobs, keep_earlier=False: wanted.update({type(who): list(jobs)}))
    background = SimpleNamespace(deferred_call=lambda act: act, run=lambda work, refuse: works.append(work))
    made = (
        SimpleNamespace(subject=subject, patches=patches),
        background,
        lambda what, **given: told.append({"tell": what, **given}),
    )
    return SimpleNamespace(made=made, wanted=wanted, works=works)


def test_a_panel_tells_the_branch_and_the_orbit_that_the_view_chooses(
    subject: Subject, found: FollowedBranch, parts: Any, told: list[dict[str, Any]]
) -> None:
    panel, follow = FollowPanel(*parts.made), FollowedOrbit("omega", *WINDOW, 0, CELL["omega"])
    view = at_cell(subject, follow=follow)
    panel.show(view)
    (job,) = parts.wanted[FollowPanel]
    assert told.pop()["says"].startswith("following its branch along ω")
    job.take(found)
    branch, orbit = told
    assert (branch["tell"], len(branch["values"]), branch["own"]) == ("branch", len(found.values), found.own_index)
    assert dict(orbit["rows"])["orbit n-p-q"] == "1-2-2 symmetric" and orbit["at"] == [CELL["omega"], CELL["b"]]
    assert [arrow["text"].split()[-2] for arrow in orbit["arrows"]] != [] and orbit["index"] == found.own_index
    moved = panel.find(view, 1.7312345)
    panel.show(replace(view, follow=moved))
    assert told[-1]["value"] == 1.7312345 == moved.value
    assert found.values[told[-1]["index"]] < 1.7312345 < found.values[told[-1]["index"] + 1]
    with pytest.raises(InputError, match=r"ω: found 2\.5, must be .* on this branch"):
        panel.find(view, 2.5)
    panel.show(at_cell(subject))
    assert parts.wanted[FollowPanel] == [] and len(told) == 3


def test_an_orbit_of_another_plane_is_followed_without_marks(
    subject: Subject, found: FollowedBranch, parts: Any, told: list[dict[str, Any]]
) -> None:
    panel, follow = FollowPanel(*parts.made), FollowedOrbit("omega", *WINDOW, 0, CELL["omega"])
    panel.show(at_cell(subject, follow=follow, plane=subject.plane.with_value("R", 0.7)))
    parts.wanted[FollowPanel][0].take(found)
    assert told[-1]["tell"] == "orbit" and told[-1]["at"] is None and told[-1]["arrows"] == []


def test_a_branch_that_is_not_found_ends_following_with_its_reason(
    subject: Subject, parts: Any, told: list[dict[str, Any]]
) -> None:
    FollowPanel(*parts.made).show(at_cell(subject, follow=FollowedOrbit("omega", *WINDOW, 0, CELL["omega"])))
    parts.wanted[FollowPanel][0].refuse("this cell is chaotic")
    assert told[-1] == {"tell": "follow", "ended": True, "says": "this cell is chaotic"}


def test_a_link_to_a_followed_orbit_has_its_branch_found_and_shows_its_cell(subject: Subject, parts: Any) -> None:
    chosen = at_cell(subject, follow=FollowedOrbit("omega", *WINDOW, 0, CELL["omega"]))
    details = DetailsPanel(*parts.made, lambda: "a sight")  # type: ignore[arg-type, return-value]
    details.show(chosen)
    assert details.topic == chosen.cell and len(parts.works) == 1
    assert [errand.question.function for errand in parts.wanted[FollowPanel]] == [follow_orbit]
