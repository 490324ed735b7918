"""Claims about tables, pictures and overlays of branches of cycles without a force. Truth: closed forms of the belt."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from distributed import Client

import atlas
from atlas.cli.main import main
from atlas.render.drawing import figure
from atlas.render.text import gap_label
from workers import solve_tile
from workers.model.system import packaged_system

FAST = atlas.Settings(survival=0, max_periods=2000)
END = 0.658855574469523615
"""The speed of the belt at which row 18 of piecewise.md has the end of the cycle: its machine is that of zeta .05."""


def period(u: "np.ndarray | float") -> "np.ndarray | float":
    """B1: the period of the undamped cycle on a belt."""
    return 1.2 / u + math.pi + 2.0 * np.arctan(u / 0.6)


def test_points_and_events_have_the_period_of_the_cycle() -> None:
    found = atlas.branch({"u": 0.5}, along="u", window=(0.3, 1.0), system="belt", settings=FAST)
    (event,) = found.events.to_dict("records")
    assert (event["kind"], event["period"], event["unstable"]) == ("grazing_sliding", 1, 0)
    assert event["u"] == pytest.approx(END, abs=1e-9)
    assert event["cycle_period"] == pytest.approx(6.439474890105244, abs=1e-9)
    free = atlas.branch({"u": 0.5, "zeta": 0.0}, along="u", window=(0.3, 1.0), system="belt", settings=FAST)
    np.testing.assert_allclose(free.points["cycle_period"], period(free.points["u"]), rtol=1e-11)
    assert set(free.points["multiplier"]) == {0.0}
    assert "cycle_period" not in atlas.branch(omega=4.0, b=0.1, along="b", window=(0.09, 0.11)).points


def test_the_state_of_a_point_is_the_section_state_that_cells_have() -> None:
    found = atlas.branch({"u": 0.5}, along="u", window=(0.4, 0.6), system="belt", settings=FAST)
    k = int(np.argmin(np.abs(found.points["u"] - 0.5)))
    state = solve_tile("belt", {"u": 0.5}, FAST)["state"]
    assert [found.points["x"][k], found.points["v"][k]] == pytest.approx(state, abs=1e-10)


def test_the_command_prints_the_period_and_draws_the_branch(tmp_path: Path) -> None:
    cell = ["branch", "--system", "belt", "--set", "u=0.5", "--max-periods", "2000", "--survival", "0"]
    asked = [*cell, "--along", "u", "--from", "0.4", "--to", "1", "-o", str(tmp_path / "belt.png")]
    told = CliRunner().invoke(main, asked)
    assert told.exit_code == 0, told.output
    assert "cycle period" in told.output
    assert "branch 0: cycle 1-0-0, " in told.output
    assert "grazing sliding 0.65885557447 6.43947489" in " ".join(told.output.split())
    assert (tmp_path / "belt.png").stat().st_size > 1000
    whole = json.loads(CliRunner().invoke(main, [*asked[:-2], "--json"]).stdout)
    assert whole["events"][0]["cycle_period"] == pytest.approx(6.439474890105244, abs=1e-9)


def test_a_branch_of_an_equilibrium_is_called_so(tmp_path: Path) -> None:
    cell = ["branch", "--system", "belt", "--set", "u=1.2", "--set", "zeta=0.2", "--max-periods", "2000"]
    told = CliRunner().invoke(main, [*cell, "--survival", "0", "--along", "u", "--from", "0.5", "--to", "1.5"])
    assert told.exit_code == 0, told.output
    assert "branch 0: equilibrium, " in told.output and "1-0-0" not in told.output


def test_the_label_of_a_branch_ends_where_the_meaning_says_its_scale() -> None:
    assert "displacement, in deflections" in packaged_system("belt").parameter("x").meaning
    assert gap_label(packaged_system("belt")) == "displacement\n$x$ at its event"


def test_branches_lie_over_a_sweep_of_cycles(tmp_path: Path, client: Client) -> None:
    solve = {"max_periods": 2000, "survival": 0, "section_samples": 2}
    atlas.run(atlas.Spec("belt", {"u": [0.3, 0.5, 0.6, 1.1]}, solve=solve), tmp_path / "belt.zarr", client=client)
    ds = atlas.open(tmp_path / "belt.zarr")
    ax = figure(ds, overlay="branches").axes[0]
    assert any(len(layer.get_segments()) for layer in ax.collections if hasattr(layer, "get_segments"))
    stored = ds.atlas.branch(u=0.5, along="u", window=(0.4, 0.7))
    assert stored.events["u"].tolist() == pytest.approx([END], abs=1e-9)
