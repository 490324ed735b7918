"""Claims about saddles between basins: motions to either side, branches, differences."""

from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from distributed import Client

import atlas
from atlas.cli.main import main
from atlas.errors import InputError
from workers import solve_tile, trace

RIGID = {"omega": 1.1, "A": 0.15}
"""A periodic orbit with impacts and motion without, of one mass with a rigid stop at x = 1."""
FIG3 = {"omega": 4.0, "b": 0.1}


@pytest.fixture(scope="module")
def rigid() -> dict[str, Any]:
    return atlas.saddles(RIGID, system="single-mass", starts=16)


@pytest.fixture(scope="module")
def gears() -> dict[str, Any]:
    return atlas.saddles(system="gear-mesh", starts=16)


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
        assert np.all(np.abs(states[1:-1] - state).max(axis=-1) > 1e-6)  # its period is the least
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
def test_the_slope_is_that_of_the_stable_direction(case: str, request: pytest.FixtureRequest) -> None:
    """Truth: the eigenvector of the small multiplier of finite differences."""
    found = request.getfixturevalue(case)
    (saddle,) = found["saddles"]
    values, vectors = np.linalg.eig(differences(found, np.array(saddle["states"][0]), saddle["period"]))
    x, v = np.real(vectors[:, np.argmin(np.abs(values))])
    assert saddle["slopes"][0] == pytest.approx(v / x, rel=1e-4)


def test_a_cell_with_one_attractor_has_no_saddle_and_says_why() -> None:
    found = atlas.saddles({"omega": 1.9, "A": 1.0}, system="single-mass", starts=4)
    assert (found["attractors"], found["saddles"]) == (1, [])
    assert found["troubles"] == ["between basins: number of attractors: found 1, must be 2 or more"]


def test_bad_input_is_one_line() -> None:
    with pytest.raises(InputError, match="capsule"):
        atlas.saddles(system="capsule")


def test_the_command_lists_the_saddles() -> None:
    words = "attractors saddles --system single-mass --set omega=1.1 --set A=0.15 --starts 16"
    shown = CliRunner().invoke(main, words.split())
    assert shown.exit_code == 0, shown.output
    assert "saddles: 1, between 2 attractors" in shown.stdout


@pytest.mark.slow
def test_the_overlay_draws_the_saddle_over_basins_of_one_mass(tmp_path: Any, client: Client) -> None:
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
