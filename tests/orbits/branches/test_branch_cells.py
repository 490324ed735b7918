"""Claims about branches that start from a cell: their tables, events, what leaves them, budgets, and bad questions."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

import atlas
from atlas.accessor import PlottableBranches
from atlas.cli.main import main
from atlas.errors import InputError
from tests.orbits.branches.test_branch_fig6 import KNOWN, TWO_MASS
from workers import Settings
from workers.continuation import section_states
from workers.kernel.coordinates import blocks_to_physical, motion_from
from workers.kernel.motion import RUNNING, STATUS
from workers.kernel.period import propagate

pytestmark = pytest.mark.slow

BREAKING, DOUBLING, _, _ = (bifurcation.omega for bifurcation in KNOWN[:4])
QUICK = Settings(max_periods=2000, survival=0)


@pytest.fixture(scope="module")
def found() -> PlottableBranches:
    """The symmetric orbit of Fig. 6 from omega = 3.02, and the asymmetric one that leaves it."""
    return atlas.branch({"omega": 3.02}, along="omega", window=(2.9, 3.05), settings=QUICK, switch_branches=True)


def test_what_leaves_is_followed_and_says_so(found: PlottableBranches) -> None:
    assert found.branches.symmetric.tolist() == [True, False]
    assert found.branches.leaves.tolist() == [-1, 0]
    assert found.events[found.events.branch == 0].leaving.tolist() == [1]
    assert found.branches["at"].tolist() == ["", "symmetry_breaking"]
    assert found.untried == ()


def test_the_event_is_a_point_of_both_branches(found: PlottableBranches) -> None:
    marked = found.points[found.points.event == "symmetry_breaking"]
    assert marked.branch.tolist() == [0, 1]
    assert marked.multiplier.tolist() == pytest.approx([1.0, 1.0], abs=1e-6)
    assert np.ptp(marked[["x1", "x2", "v1", "v2"]].to_numpy(), axis=0) == pytest.approx(0.0, abs=1e-8)


def test_the_orbit_is_unstable_just_where_a_multiplier_exceeds_one(found: PlottableBranches) -> None:
    points = found.points[found.points.event == ""]
    assert ((points.unstable > 0) == (points.multiplier > 1.0)).all()
    symmetric = points[points.branch == 0]
    assert ((symmetric.unstable == 1) == (symmetric.omega < BREAKING)).all()
    assert (points[points.branch == 1].unstable == 0).all()


def test_both_ends_lie_at_the_ends_that_were_asked_for(found: PlottableBranches) -> None:
    omega = found.points[found.points.branch == 0].omega
    assert (omega.min(), omega.max()) == (2.9, 3.05)
    assert found.branches.loc[0, ["first_end", "last_end"]].tolist() == ["edge", "edge"]


@pytest.mark.parametrize("shift", [0.0, 0.5])
def test_section_states_are_those_of_simulated_motion(found: PlottableBranches, shift: float) -> None:
    """Half a period on, those of the mirror image with the other sign."""
    branch = found.traced[1]
    k = 5
    omega = branch.run.points[k].values
    osc = TWO_MASS.build({p.name: p.default for p in TWO_MASS.parameters} | {"omega": float(omega[0])})
    motion = motion_from(osc, branch.sections[k, 0])
    propagate(osc, motion, osc.period if shift == 0.0 else 0.5 * osc.period)
    assert motion.tally[STATUS] == RUNNING
    there = blocks_to_physical(osc._replace(tau=osc.tau + 2.0 * np.pi * shift), motion)
    states = section_states(TWO_MASS, {"omega": omega}, [branch.run.points[k].orbit], shift)[0, 0]
    assert states == pytest.approx(there, abs=1e-12)
    assert branch.mirrored is not None
    assert (branch.sections if shift == 0.0 else -branch.mirrored)[k, 0] == pytest.approx(states, abs=1e-13)


def test_a_spent_budget_is_told() -> None:
    cut = atlas.branch(
        {"omega": 3.02}, along="omega", window=(2.99, 3.03), settings=QUICK, switch_branches=True, budget=1
    )
    assert [(start.branch, start.event.kind, start.why) for start in cut.untried] == [
        (0, "symmetry_breaking", "1 branches followed")
    ]


def test_a_branch_that_ends_at_another_follows_that_too() -> None:
    """From the asymmetric orbit: the symmetric one is the branch that it leaves."""
    found = atlas.branch({"omega": 2.98}, along="omega", window=(2.95, 3.03), settings=QUICK, switch_branches=True)
    assert found.branches.symmetric.tolist() == [False, True]
    assert found.branches.leaves.tolist() == [1, -1]


def test_impact_free_motion_is_followed_to_its_graze() -> None:
    """Truth: |Y| = b, the amplitude of its closed form."""
    found = atlas.branch({"omega": 4.0, "b": 0.5}, along="b", window=(0.02, 0.6), settings=QUICK)
    assert found.events.kind.tolist() == ["graze"]
    osc = TWO_MASS.build({p.name: p.default for p in TWO_MASS.parameters} | {"omega": 4.0})
    amplitude = float(np.hypot(osc.gap.sin_part[0], osc.gap.cos_part[0]))
    assert found.events.b.iloc[0] == pytest.approx(amplitude, abs=1e-10)


CHAOTIC = {"omega": 2.35}


@pytest.mark.parametrize(
    ("given", "along", "window", "message"),
    [
        (CHAOTIC, "omega", (2.0, 3.0), "this cell is (chaotic|undetermined).*: a branch starts from a periodic cell"),
        ({"omega": 3.02}, "omga", (2.0, 4.0), "unknown parameter 'omga'; did you mean 'omega'"),
        ({"omega": 3.02}, "x1", (2.0, 4.0), "x1: found an initial state, on which no orbit depends"),
        ({"omega": 3.02}, "omega", (4.0, 3.0), "omega: found 4 to 3, must increase"),
        ({"omega": 3.02}, "omega", (3.5, 4.0), "omega: found 3.5 to 4, must contain the cell's value 3.02"),
        ({"omega": 3.02}, "b", (-1.0, 1.0), "b = -1.0"),
    ],
)
def test_a_bad_question_is_refused_in_one_line(
    given: dict[str, float], along: str, window: tuple[float, float], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        atlas.branch(given, along=along, window=window, settings=QUICK)


def call(*args: object) -> Result:
    return CliRunner().invoke(main, [str(arg) for arg in args])


LINE = ("branch", "--along", "omega", "--from", 2.9, "--to", 3.05, "--max-periods", 2000, "--survival", 0)
CELL = ("--set", "omega=3.02")


def test_the_command_prints_events_and_how_branches_end() -> None:
    shown = call(*LINE, *CELL, "--switch-branches").stdout
    assert "symmetry breaking  3.00409423506  1-1-1 symmetric  0         1" in shown
    assert "branch 1: 1-1-1, leaves branch 0" in shown
    assert "3.004094235 (symmetry breaking)" in shown


def test_the_command_answers_in_json() -> None:
    message = json.loads(call(*LINE, *CELL, "--json").stdout)
    assert [(event["kind"], event["leaving"]) for event in message["events"]] == [("symmetry_breaking", -1)]
    assert message["branches"][0]["last_end"] == "edge"
    assert message["parameters"]["b"] == 0.15


def test_points_are_written_as_csv_and_everything_as_json(tmp_path: Path) -> None:
    assert call(*LINE, *CELL, "-o", tmp_path / "branch.csv").exit_code == 0
    handle, *rows = (tmp_path / "branch.csv").read_text().splitlines()
    assert handle == "branch,omega,x1,x2,v1,v2,multiplier,unstable,period,impacts_upper,impacts_lower,symmetric,event"
    assert call(*LINE, *CELL, "-o", tmp_path / "branch.json").exit_code == 0
    whole = json.loads((tmp_path / "branch.json").read_text())
    assert len(whole["points"]) == len(rows)
    assert [point["omega"] for point in whole["points"] if point["event"]] == pytest.approx([BREAKING], abs=1e-9)


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("--set", "omega=2.35"), "a branch starts from a periodic cell"),
        (("--at", "omega=3"), "--at needs a STORE"),
        ((*CELL, "-o", "branch.txt"), "possible: .csv, .json, .png, .svg, .pdf"),
    ],
)
def test_the_command_refuses_with_code_2(args: tuple[object, ...], message: str) -> None:
    shown = call(*LINE, *args)
    assert shown.exit_code == 2
    assert message in shown.output


def test_a_cell_of_a_store_is_followed_from_its_stored_state(finished: Path) -> None:
    ds = atlas.open(finished)
    cell = {name: value.item() for name, value in ds.atlas.at(omega=4.0, b=0.2).items() if value.ndim == 0}
    assert (cell["regime"], cell["period"]) == ("periodic", 1)
    found = ds.atlas.branch(omega=4.0, b=0.2, along="b", window=(0.15, 0.25))
    near = found.points.iloc[(found.points.b - 0.2).abs().argmin()]
    assert near[["impacts_upper", "impacts_lower"]].tolist() == [cell["impacts_upper"], cell["impacts_lower"]]
    shown = call("branch", finished, "--at", "omega=4", "--at", "b=0.2", "--along", "b", "--from", 0.15, "--to", 0.25)
    assert shown.exit_code == 0
    assert "branch 0: 1-1-1" in shown.stdout
    refused = call("branch", finished, *CELL, "--along", "b", "--from", 0.1, "--to", 0.2)
    assert (refused.exit_code, "--set is for a cell without a STORE" in refused.output) == (2, True)
