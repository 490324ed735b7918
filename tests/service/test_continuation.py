"""Claims about sweeps by continuation: solved by hand cell by cell, planned in whole lines, stored and found again."""

from pathlib import Path

import numpy as np
import pytest
from distributed import Client

import atlas
from atlas.errors import InputError, RunError
from atlas.service.plan import make_plan
from atlas.task.solve_block import solve_block
from workers import Settings
from workers.results import INVALID, NO_IMPACT, PERIODIC, reason_counts
from workers.sweep import solve_lines
from workers.tile import solve_tile

QUICK = Settings(exponents="none", max_periods=1000)
OMEGA = np.linspace(2.0, 4.0, 6)


def states(arrays: dict[str, np.ndarray]) -> list[dict[str, float]]:
    """Each cell's final state as the initial state of another."""
    return [dict(zip(("x1", "x2", "v1", "v2"), map(float, array), strict=True)) for array in arrays["state"]]


def same(one: dict[str, np.ndarray], two: dict[str, np.ndarray]) -> bool:
    return all(np.array_equal(one[name], two[name], equal_nan=one[name].dtype.kind == "f") for name in one)


def test_each_cell_starts_from_the_state_of_the_one_before_it() -> None:
    swept = solve_lines("two-mass", {"omega": OMEGA, "b": 0.3}, QUICK)
    starts = [{}, *states(swept)[:-1]]
    for i, start in enumerate(starts):
        alone = solve_tile("two-mass", {"omega": OMEGA[i], "b": 0.3} | start, QUICK)
        assert same({name: array[i] for name, array in swept.items()}, alone)


def test_backward_is_forward_on_the_axis_turned_round() -> None:
    back = solve_lines("two-mass", {"omega": OMEGA, "b": 0.3}, QUICK, backward=True)
    turned = solve_lines("two-mass", {"omega": OMEGA[::-1], "b": 0.3}, QUICK)
    assert same({name: array[::-1] for name, array in back.items()}, turned)


@pytest.mark.parametrize("axis", [0, 1])
def test_lines_do_not_depend_on_each_other(axis: int) -> None:
    b = np.array([0.2, 0.3, 0.5])
    grid = {"omega": OMEGA[:, None], "b": b[None, :]} if axis == 0 else {"omega": OMEGA[None, :], "b": b[:, None]}
    swept = solve_lines("two-mass", grid, QUICK, axis=axis)
    for k in range(3):
        alone = solve_lines("two-mass", {"omega": OMEGA, "b": b[k]}, QUICK)
        assert same({name: np.take(array, k, axis=1 - axis) for name, array in swept.items()}, alone)


def test_sweeps_up_and_down_end_on_different_motions_where_two_coexist() -> None:
    """Truth: |Y| < b for these frequencies, so that a mass not yet impacting never will."""
    params = {"omega": np.linspace(2.6, 4.0, 4), "b": 0.4}
    up = solve_lines("two-mass", params, QUICK)["regime"]
    down = solve_lines("two-mass", params, QUICK, backward=True)["regime"]
    assert up.tolist() == [PERIODIC] * 4
    assert down.tolist() == [NO_IMPACT] * 4


def test_a_cell_without_a_state_is_passed_over() -> None:
    R = np.array([0.8, 1.5, 0.7])
    swept = solve_lines("two-mass", {"omega": 3.0, "R": R}, QUICK)
    assert swept["regime"][1] == INVALID
    assert reason_counts(swept["reason"]) == {"a parameter lies outside its valid range": 1}
    alone = solve_tile("two-mass", {"omega": 3.0, "R": 0.7} | states(swept)[0], QUICK)
    assert same({name: array[2] for name, array in swept.items()}, alone)


def test_before_the_first_state_cells_start_at_their_own() -> None:
    swept = solve_lines("two-mass", {"omega": 3.0, "R": [1.5, 0.7], "x1": 0.1}, QUICK)
    alone = solve_tile("two-mass", {"omega": 3.0, "R": 0.7, "x1": 0.1}, QUICK)
    assert same({name: array[1] for name, array in swept.items()}, alone)


def test_a_gap_that_closes_in_pushes_the_mass_along() -> None:
    wide = solve_tile("two-mass", {"omega": 2.3, "b": 0.5}, QUICK)
    (start,) = states({"state": wide["state"][None]})
    narrow = 0.3 * abs(start["x1"])
    swept = solve_lines("two-mass", {"omega": 2.3, "b": [narrow, 0.5]}, QUICK, backward=True)
    pushed = start | {"x1": float(np.copysign(narrow, start["x1"]))}
    alone = solve_tile("two-mass", {"omega": 2.3, "b": narrow} | pushed, QUICK)
    assert swept["regime"][0] != INVALID
    assert same({name: array[0] for name, array in swept.items()}, alone)


def test_a_pushed_mass_is_never_left_beyond_its_stop() -> None:
    """Truth: solve_tile calls a start beyond a stop invalid; 300 gaps of awkward digits."""
    rng = np.random.default_rng(5)
    b = np.stack([np.full(300, 0.9), rng.uniform(1e-6, 0.02, 300)])
    settings = Settings(exponents="none", max_periods=1)
    solved = solve_lines("two-mass", {"omega": 2.3, "b": b, "x1": 0.85}, settings, axis=0)
    assert np.all(np.abs(solved["state"][0, :, 0]) > 0.02)
    assert not np.any(solved["regime"] == INVALID)


@pytest.mark.parametrize("axis", [1, -2])
def test_an_axis_that_does_not_exist_is_refused(axis: int) -> None:
    with pytest.raises(ValueError, match=f"axis: found {axis}, must be one of the 1 axes of the cells"):
        solve_lines("two-mass", {"omega": OMEGA}, QUICK, axis=axis)


# The spec


def spec(direction: str | None, **changes: object) -> atlas.Spec:
    omega = {"start": 2.6, "stop": 4.0, "num": 5} | ({"continuation": direction} if direction else {})
    return atlas.Spec("two-mass", {"omega": omega, "b": [0.3, 0.4, 0.5]}, solve={"max_periods": 500}, **changes)  # type: ignore[arg-type]


def test_direction_decides_the_digest_and_an_ordinary_spec_keeps_its_own() -> None:
    digests = {spec(direction).digest for direction in (None, "forward", "backward")}
    assert len(digests) == 3
    assert "continuation" not in str(spec(None).to_resolved())


def test_a_resolved_spec_keeps_its_direction() -> None:
    again = atlas.Spec.from_resolved(spec("backward").to_resolved())
    assert again.continuation == (1, True)
    assert again.digest == spec("backward").digest


def test_a_whole_line_is_one_tile() -> None:
    wide = atlas.Spec(
        "two-mass",
        {
            "omega": {"start": 2, "stop": 4, "num": 500, "continuation": "forward"},
            "b": {"start": 0.1, "stop": 1, "num": 90},
        },
    )
    plan = make_plan(wide, workers=2)
    assert plan.tiling.tile[1] == 500
    assert plan.tiling.count >= 32


@pytest.mark.parametrize(
    ("build", "says"),
    [
        (lambda: spec("up"), r"axes.omega.continuation: found 'up', must be one of forward, backward"),
        (lambda: spec("forward", store={"tile": [1, 4]}), r"must hold whole lines of omega.* 5 cells"),
        (lambda: atlas.Spec("two-mass", {"x1": {"values": [0, 0.1], "continuation": "forward"}}), "initial state"),
        (
            lambda: atlas.Spec(
                "two-mass",
                {name: {"values": [0.1, 0.2], "continuation": "forward"} for name in ("omega", "b")},
            ),
            "found continuation on omega and b, must be on one",
        ),
    ],
)
def test_a_continuation_that_cannot_be_is_refused(build: object, says: str) -> None:
    with pytest.raises(InputError, match=says):
        build()  # type: ignore[operator]


def test_a_store_of_one_direction_is_not_gone_on_with_in_the_other(tmp_path: Path, client: Client) -> None:
    atlas.run(spec("forward"), tmp_path / "sweep.zarr", client=client)
    with pytest.raises(InputError, match=r"continued forward\) in the store, .*continued backward\) in the spec"):
        atlas.run(spec("backward"), tmp_path / "sweep.zarr", client=client)


def test_a_run_stores_what_solving_its_lines_gives(tmp_path: Path, client: Client) -> None:
    one = spec("backward", store={"tile": [2, 5]})
    assert atlas.run(one, tmp_path / "sweep.zarr", client=client).tiles == 2
    params = {"omega": np.array(one.axes[0].values)[None, :], "b": np.array([0.3, 0.4, 0.5])[:, None]}
    expected = solve_lines("two-mass", params, one.settings, axis=1, backward=True)
    stored = atlas.open(tmp_path / "sweep.zarr")
    assert same(expected, {name: stored[name].values for name in expected})
    assert not same(expected, solve_tile("two-mass", params, one.settings))


def test_a_part_of_a_line_is_not_solved_as_if_it_were_one() -> None:
    with pytest.raises(RunError, match="part of a line along omega"):
        solve_block(spec("forward"), (slice(0, 1), slice(1, 5)))
    assert solve_block(spec("forward"), (slice(0, 1), slice(0, 5)))["regime"].shape == (1, 5)
    assert solve_block(spec(None), (slice(0, 1), slice(1, 5)))["regime"].shape == (1, 4)
