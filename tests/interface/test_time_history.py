"""Time histories: exact at events, with forces that the equations of motion confirm."""

import csv
from collections.abc import Callable
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner

import atlas
from atlas.cli.main import main
from atlas.errors import InputError

H = 1e-4
"""Step of the central difference of velocities, in units of time."""


def forces_and_their_sum(
    system: str, instants: np.ndarray, balance: Callable[[pd.Series, np.ndarray], np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """The forces of a history, and those that the equations of motion need, from differences of its velocities."""
    asked = np.sort(np.concatenate([instants - H, instants, instants + H]))
    table = atlas.time_history(tau=0.0, system=system, periods=12, times=asked.tolist())
    table = table[table["time"].isin(asked)].drop_duplicates("time").reset_index(drop=True)
    velocities = table[[name for name in table.columns if name.startswith("v")]].to_numpy()
    middle = table.iloc[1::3]
    acceleration = (velocities[2::3] - velocities[:-2:3]) / (2.0 * H)
    needed = np.array([balance(row, a) for (_, row), a in zip(middle.iterrows(), acceleration, strict=True)])
    return middle[[name for name in table.columns if name.endswith("_force")]].to_numpy(), needed


def smooth(system: str, instants: np.ndarray) -> np.ndarray:
    """The instants that are far from any event."""
    events = atlas.time_history(tau=0.0, system=system, periods=12, events_only=True)["time"].to_numpy()
    return instants[np.min(np.abs(instants[:, None] - events), axis=1) > 10.0 * H]


def test_forces_of_a_soft_stop_and_of_friction_balance_the_equations_of_motion() -> None:
    def balance(row: pd.Series, a: np.ndarray) -> np.ndarray:
        drive = 1.6 * np.sin(0.9 * row["time"])
        first = a[0] + a[1] + 0.1 * row["v"] + row["r"] - drive  # of (r, x2): the stop's row is (1, 0)
        return np.array([first, a[0] + 6.0 * a[1] - drive])  # and the friction's (0, 1)

    instants = smooth("capsule", np.linspace(1.0, 80.0, 301))
    forces, needed = forces_and_their_sum("capsule", instants, balance)
    assert np.count_nonzero(forces[:, 0]) > 10
    assert np.max(np.abs(forces - needed)) < 1e-5


def test_the_force_of_friction_that_sticks_balances_the_equation_of_motion() -> None:
    def balance(row: pd.Series, a: np.ndarray) -> np.ndarray:
        return np.array([a[0] + 0.04 * row["v"] + row["x"] - 2.0 * np.sin(0.4 * row["time"])])

    instants = smooth("friction-oscillator", np.linspace(1.0, 180.0, 201))
    forces, needed = forces_and_their_sum("friction-oscillator", instants, balance)
    assert np.count_nonzero(np.abs(forces) < 0.99) > 10
    assert np.max(np.abs(forces - needed)) < 1e-5


def test_a_ball_that_rests_is_carried_by_the_table() -> None:
    table = atlas.time_history(system="bouncing-ball", omega=1.0, tau=0.0, periods=12)
    assert {"rests on stop", "leaves stop"} <= set(table["event"])
    resting = table[(table["v"] == 0.0) & (table["y"] == 0.0) & (table["event"] == "")]
    needed = 1.0 - 1.2 * np.sin(resting["time"].to_numpy())  # g - A omega^2 sin(omega t)
    assert len(resting) > 20
    assert resting["stop_force"].to_numpy() == pytest.approx(needed, abs=1e-9)


def test_impacts_are_those_of_trace_and_reverse_the_speed() -> None:
    table = atlas.time_history(omega=4.0, b=0.1, periods=20)
    impacts = table[table["event"].str.startswith("impact")]
    traced = atlas.trace("two-mass", {"omega": 4.0, "b": 0.1}, periods=20).impacts
    assert impacts["time"].tolist() == traced[:, 0].tolist()
    assert np.abs(impacts["x1"]).to_numpy() == pytest.approx(0.1, abs=1e-15)
    before = table.loc[impacts.index - 1]
    assert before["time"].tolist() == impacts["time"].tolist()
    assert impacts["v1"].to_numpy() == pytest.approx(-0.8 * before["v1"].to_numpy(), rel=1e-12)


def test_sections_are_those_of_trace_after_a_transient() -> None:
    table = atlas.time_history(omega=3.0, b=0.3, periods=2, transient=5, samples=1)
    states = table[table["event"] == ""].drop_duplicates("time")[["x1", "x2", "v1", "v2"]].iloc[[0, -1]]
    traced = atlas.trace("two-mass", {"omega": 3.0, "b": 0.3}, periods=7).states[[5, 7]]
    assert states.to_numpy() == pytest.approx(traced, abs=1e-12)


def test_the_command_prints_and_writes_the_numbers_of_the_function(tmp_path: Path) -> None:
    expected = atlas.time_history(omega=4.0, b=0.1, periods=1, samples=5)
    line = ["trace", "--set", "omega=4", "--set", "b=0.1", "--samples", "5"]
    printed = list(csv.reader(StringIO(CliRunner().invoke(main, line).stdout)))
    assert printed[0] == expected.columns.tolist()
    for name, *values in zip(*printed, strict=True):
        found = values if name == "event" else [float(value) for value in values]
        assert np.array_equal(found, expected[name], equal_nan=name == "impact_speed")
    assert CliRunner().invoke(main, [*line, "-o", str(tmp_path / "a.nc")]).exit_code == 0
    with xr.open_dataset(tmp_path / "a.nc") as ds:
        assert ds["event"].astype(str).values.tolist() == expected["event"].tolist()
        assert ds["v1"].values.tolist() == expected["v1"].tolist()


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"periods": 0}, "periods: found 0, must be a whole number, 1 or more"),
        ({"transient": -1}, "transient: found -1, must be a whole number, 0 or more"),
        ({"times": [9.0]}, r"times: found \[9.0\], must be from 0 to 1.57"),
        ({"times": "now"}, "times: found 'now', must be numbers"),
        ({"omega": -4.0}, "omega = -4.0: must satisfy 0 < omega"),
    ],
)
def test_arguments_out_of_range_are_refused(changes: dict[str, object], says: str) -> None:
    with pytest.raises(InputError, match=says):
        atlas.time_history(**{"omega": 4.0, "periods": 1} | changes)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["time", "impact_speed", "wall_force"])
def test_a_coordinate_with_the_name_of_another_column_is_refused(name: str) -> None:
    wall = {"name": "wall", "gap": [1.0], "upper": 1.0, "restitution": 0.5}
    parameters = {key: {"default": 1.0} for key in ("omega", name, "v")}
    system = {"name": "mine", "coordinates": [name], "velocities": ["v"], "mass": [[1.0]], "stiffness": [[1.0]]}
    system |= {"force": [1.0], "contacts": [wall], "parameters": parameters}
    with pytest.raises(InputError, match=f"mine: the coordinate '{name}' has the name of a column of time histories"):
        atlas.time_history(periods=1, system=system)
