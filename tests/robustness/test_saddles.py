"""Claims about saddles between basins and their stable manifolds: motions to either side, branches, differences."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from distributed import Client

import atlas
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.robustness import boundary_tracking
from atlas.robustness import saddles as of_saddles
from atlas.robustness.manifold import OUTSIDE
from atlas.robustness.saddles import manifold_of
from workers import solve_tile, trace

RIGID = {"omega": 1.1, "A": 0.15}
"""A periodic orbit with impacts and motion without, of one mass with a rigid stop at x = 1."""
FIG3 = {"omega": 4.0, "b": 0.1}


@pytest.fixture(scope="module")
def rigid() -> dict[str, Any]:
    box = {"x": (-2.0, 1.0), "v": (-2.0, 2.0)}
    return atlas.saddles(RIGID, system="single-mass", starts=16, manifolds=True, box=box)


@pytest.fixture(scope="module")
def gears() -> dict[str, Any]:
    return atlas.saddles(system="gear-mesh", starts=16, manifolds=True, box={"x": (-2.0, 2.0), "v": (-0.9, 0.9)})


@pytest.fixture(scope="module")
def masses() -> dict[str, Any]:
    return atlas.saddles(FIG3, starts=8)


def system_of(found: dict[str, Any]) -> str:
    return str(found["system"])


def regimes(found: dict[str, Any], states: np.ndarray) -> np.ndarray:
    """Truth: the class of the motion from each state (N, 2n), solved by the solver of cells, which knows no saddle."""
    given = {**found["parameters"], **dict(zip(found["norm"], np.moveaxis(states, -1, 0), strict=True))}
    solved = solve_tile(system_of(found), given)
    return np.asarray(solved["regime"]) * 100 + solved["period"]


def differences(found: dict[str, Any], state: np.ndarray, periods: int, step: float = 1e-7) -> np.ndarray:
    """Central differences of the map of some periods, simulated from physical states."""

    def image(at: np.ndarray) -> np.ndarray:
        given = {**found["parameters"], **dict(zip(found["norm"], at, strict=True))}
        return trace(system_of(found), given, periods).states[-1]

    columns = [(image(state + step * e) - image(state - step * e)) / (2.0 * step) for e in np.eye(len(state))]
    return np.array(columns).T


@pytest.mark.parametrize("case", ["rigid", "gears", "masses"])
def test_saddles_are_fixed_points_with_multipliers_of_finite_differences(
    case: str, request: pytest.FixtureRequest
) -> None:
    found = request.getfixturevalue(case)
    assert found["saddles"]
    for saddle in found["saddles"]:
        ours = np.array([complex(*pair) for pair in saddle["multipliers"]])
        assert np.sum(np.abs(ours) > 1.0) == 1
        if np.abs(ours).max() > 1e3:  # differences would leave the orbit
            continue
        state = np.array(saddle["states"][0])
        given = {**found["parameters"], **dict(zip(found["norm"], state, strict=True))}
        states = trace(system_of(found), given, saddle["period"]).states
        assert states[-1] == pytest.approx(state, abs=1e-9)
        assert states[:-1] == pytest.approx(np.array(saddle["states"]), abs=1e-9)
        jacobian = differences(found, state, saddle["period"])
        unstable = ours[np.argmax(np.abs(ours))].real
        naive = np.linalg.eigvals(jacobian)
        assert naive[np.argmax(np.abs(naive))].real == pytest.approx(unstable, rel=1e-5)
        assert np.linalg.det(jacobian) == pytest.approx(np.prod(ours).real, rel=1e-4, abs=1e-8)
        left = np.array(saddle["normal"][0]) * list(found["norm"].values())
        assert left @ jacobian == pytest.approx(unstable * left, abs=1e-4 * abs(unstable))


def test_a_saddle_is_the_unstable_orbit_of_the_branch_through_the_fold(rigid: dict[str, Any]) -> None:
    """Truth: the branch of the stable orbit, followed by its equations round the fold, back to the cell's own A."""
    points = atlas.branch(RIGID, system="single-mass", along="A", window=(0.02, RIGID["A"])).points
    (end,) = [points.iloc[k] for k in (0, -1) if points.iloc[k]["unstable"] == 1]
    assert end["A"] == RIGID["A"]
    (saddle,) = rigid["saddles"]
    assert saddle["states"][0] == pytest.approx([end["x"], end["v"]], abs=1e-10)
    assert max(abs(complex(*multiplier)) for multiplier in saddle["multipliers"]) == pytest.approx(
        abs(end["multiplier"]), rel=1e-9
    )


@pytest.mark.parametrize("case", ["rigid", "gears", "masses"])
def test_beside_a_saddle_motions_go_to_the_two_attractors_that_it_lies_between(
    case: str, request: pytest.FixtureRequest
) -> None:
    found = request.getfixturevalue(case)
    w = np.array(list(found["norm"].values()))
    for saddle in found["saddles"]:
        state, normal = np.array(saddle["states"][0]), np.array(saddle["normal"][0]) / w
        sides = regimes(found, state + np.array([[-1e-6], [1e-6]]) * normal)
        assert sides[0] != sides[1]
        assert len(set(saddle["between"])) == 2


@pytest.mark.parametrize("case", ["rigid", "gears"])
def test_a_little_to_either_side_of_a_manifold_motions_reach_different_attractors(
    case: str, request: pytest.FixtureRequest
) -> None:
    """Truth: the solver of cells. The distance is a thousandth of the picture's; sharp bends are left out."""
    found = request.getfixturevalue(case)
    (saddle,) = found["saddles"]
    aside, seen = [], 0
    for line in map(np.array, saddle["manifold"]):
        steps = np.diff(line, axis=0)
        lengths = np.hypot(*steps.T)
        straight = np.flatnonzero(lengths > 5e-3)[::5]
        normal = np.stack([-steps[straight, 1], steps[straight, 0]], axis=1) / lengths[straight, None]
        middle = 0.5 * (line[straight] + line[straight + 1])
        aside.append(np.stack([middle - 3e-4 * normal, middle + 3e-4 * normal]))
        seen += len(straight)
    sides = regimes(found, np.concatenate(aside, axis=1))
    assert seen > 40
    assert np.mean(sides[0] != sides[1]) == 1.0


@pytest.mark.parametrize("case", ["rigid", "gears"])
def test_states_of_a_manifold_tend_to_the_saddle(case: str, request: pytest.FixtureRequest) -> None:
    """The first points of each branch, and points far from the saddle, come near it before they leave."""
    found = request.getfixturevalue(case)
    (saddle,) = found["saddles"]
    state = np.array(saddle["states"][0])
    for line in map(np.array, saddle["manifold"]):
        for start in line[len(line) // 3 :: max(1, len(line) // 3)][:2]:
            given = {**found["parameters"], **dict(zip(found["norm"], start, strict=True))}
            away = np.abs(trace(system_of(found), given, 12).states - state).max(axis=1)
            assert away.min() < 0.02


def test_the_manifold_of_a_rigid_stop_goes_on_at_the_speed_after_the_impact(rigid: dict[str, Any]) -> None:
    (saddle,) = rigid["saddles"]
    ends = [(np.array(a[-1]), np.array(b[0])) for a, b in zip(saddle["manifold"], saddle["manifold"][1:], strict=False)]
    jumps = [(one, other) for one, other in ends if abs(one[0] - 1.0) < 1e-9 and abs(other[0] - 1.0) < 1e-9]
    assert jumps
    for one, other in jumps:
        before, after = max(one[1], other[1]), min(one[1], other[1])
        assert after == pytest.approx(-0.9 * before, rel=1e-9)
    assert set(saddle["ends"]) == {OUTSIDE}


def test_the_slope_is_that_of_the_first_step_of_the_manifold(gears: dict[str, Any]) -> None:
    (saddle,) = gears["saddles"]
    first = np.array(saddle["manifold"][0])[:2]
    step = first[1] - first[0]
    assert saddle["slopes"][0] == pytest.approx(step[1] / step[0], rel=1e-9)


@pytest.mark.parametrize("recurs", [1, 2, 4])
def test_a_saddle_has_its_least_period_after_however_many_turns_a_motion_recurs(
    recurs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A motion that turns by half a circle a period comes near itself every second period first.

    The map x -> 1 - 0.9 (x - 1), y -> 3 y has one saddle, (1, 0), of period 1.
    """

    class Turning:
        oscillator = None

        def orbit_with_jacobian(self, state: np.ndarray, periods: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            powers = np.array([[(-0.9) ** k, 3.0**k] for k in range(periods + 1)])
            states = np.array([1.0, 0.0]) + powers * (state - np.array([1.0, 0.0]))
            return states[:-1], states[-1], np.diag(powers[-1])

    monkeypatch.setattr(boundary_tracking, "not_smooth", lambda oscillator, states: "")
    monkeypatch.setattr(
        boundary_tracking, "reached_labels", lambda table, states: (states[:, 1] > 0.0).astype(np.int64)
    )
    tracker = object.__new__(boundary_tracking._Tracker)
    tracker.own, tracker.weights, tracker.map = 0, np.ones(2), Turning()  # type: ignore[assignment]
    tracker.table = None  # type: ignore[assignment]
    found = tracker.orbit(np.array([1.0003, 1e-9]), recurs, 1.0)
    assert found is not None and found.period == 1
    assert sorted(found.multipliers.real) == pytest.approx([-0.9, 3.0], rel=1e-12)
    assert found.states == pytest.approx(np.array([[1.0, 0.0]]), abs=1e-10)


@pytest.mark.parametrize(("inner", "turns"), [(0.9, 7), (-0.9, 8), (-0.85, 6), (-0.4, 2), (0.4, 1)])
def test_a_manifold_is_grown_by_a_power_of_the_map_that_keeps_its_sides(
    inner: float, turns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The least power whose inner multiplier is between 0 and 1/2: odd powers of a negative one change sides."""
    taken = list[int]()
    machine = SimpleNamespace(images=lambda states, periods: taken.append(periods) or states)
    monkeypatch.setattr("atlas.robustness.section_map.SectionMap", lambda oscillator: machine)
    monkeypatch.setattr("atlas.robustness.manifold.grow_manifold", lambda image, state, *_: image(state))
    monkeypatch.setattr(of_saddles, "_beyond_stops", lambda *_: (np.zeros(2), np.ones(2)))
    monkeypatch.setattr(of_saddles, "_across", lambda *_: None)
    table, one = SimpleNamespace(cell=SimpleNamespace(oscillator=None)), np.ones((1, 2))
    saddle = SimpleNamespace(weights=np.ones(2), multipliers=np.array([3.0, inner]), period=3, states=one, along=one)
    manifold_of(table, saddle, (np.zeros(2), np.ones(2)))  # type: ignore[arg-type]
    assert set(taken) == {3 * turns} and 0.0 < inner**turns <= 0.5


def test_a_cell_with_one_attractor_has_no_saddle_and_says_why() -> None:
    found = atlas.saddles({"omega": 1.9, "A": 1.0}, system="single-mass", starts=4)
    assert (found["attractors"], found["saddles"]) == (1, [])
    assert found["troubles"] == ["between basins: number of attractors: found 1, must be 2 or more"]


def test_bad_input_is_one_line() -> None:
    with pytest.raises(InputError, match="manifolds need a system with one mass, and 'two-mass' has 2"):
        atlas.saddles(FIG3, manifolds=True)
    with pytest.raises(InputError, match=r"box.x: found 1 to 0, must increase and be of x or v"):
        atlas.saddles(RIGID, system="single-mass", starts=16, manifolds=True, box={"x": (1.0, 0.0)})
    with pytest.raises(InputError, match="capsule"):
        atlas.saddles(system="capsule")
    for words, message in (
        (["--box", "x=0:1"], "--box needs --out"),
        (["-o", "a.png"], "a.png: the suffix chooses the format, found '.png'; possible: .csv"),
    ):
        shown = CliRunner().invoke(main, ["attractors", "saddles", *words])
        assert (shown.exit_code, shown.stdout) == (2, "") and message in shown.stderr


def test_the_command_writes_the_manifolds(tmp_path: Any) -> None:
    out = tmp_path / "boundary.csv"
    words = [
        "attractors",
        "saddles",
        "--system",
        "single-mass",
        "--set",
        "omega=1.1",
        "--set",
        "A=0.15",
        "--starts",
        "16",
    ]
    shown = CliRunner().invoke(main, [*words, "-o", str(out), "--box", "v=-2:2"])
    assert shown.exit_code == 0, shown.output
    assert "saddles: 1, between 2 attractors" in shown.stdout
    handle, *rows = out.read_text().splitlines()
    assert handle == "saddle,line,x,v" and len(rows) > 100


@pytest.mark.slow
def test_the_overlay_draws_saddle_and_manifold_over_basins_of_one_mass(tmp_path: Any, client: Client) -> None:
    axes = {"x": {"start": -1.0, "stop": 1.5, "num": 6}, "v": {"start": -0.5, "stop": 0.5, "num": 5}}
    atlas.run(atlas.Spec("gear-mesh", axes, attractors={"starts": 16}), tmp_path / "b.zarr", client=client)
    drawn = atlas.open(tmp_path / "b.zarr").atlas.plot("basins", overlay="saddles")
    (mark,) = [line for line in drawn.axes[0].lines if line.get_gid() == "saddle"]
    (saddle,) = atlas.saddles(system="gear-mesh", starts=16)["saddles"]
    assert mark.get_xydata()[0] == pytest.approx(saddle["states"][0], abs=1e-12)


@pytest.mark.slow
def test_the_overlay_of_another_map_is_refused(tmp_path: Any, client: Client) -> None:
    atlas.run(atlas.Spec("gear-mesh", {"omega": [0.7, 0.8], "eps": [0.1, 0.2]}), tmp_path / "p.zarr", client=client)
    with pytest.raises(InputError, match="overlay 'saddles' needs basins of one mass"):
        atlas.open(tmp_path / "p.zarr").atlas.plot(overlay="saddles")
