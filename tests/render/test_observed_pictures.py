"""Observables in specs, stores, commands and pictures."""

import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from distributed import Client

import atlas
from atlas.cell.trajectory import cell_orbit
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.orbits.branches.table import align_rows
from atlas.render import portrait_figure as portrait
from atlas.render.plotted_values import PlottedValues, atlas_observables
from workers import Settings
from workers.model.observables import Observable

SWEEP = {"omega": [2.3, 3.5, 4.0]}
SOLVE = {"max_periods": 1000, "survival": 0, "observe_values": 3}


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory, client: Client) -> Path:
    """A sweep with two observables and without section states."""
    path = tmp_path_factory.mktemp("observed") / "sweep.zarr"
    solve = SOLVE | {"observe": "impact_phase:stop,energy_loss"}
    atlas.run(atlas.Spec("two-mass", SWEEP, {"b": 0.15}, solve), path, client=client)
    return path


def test_a_store_keeps_so_many_values_of_each_cell_and_counts_them_all(store: Path) -> None:
    ds = atlas.open(store)
    assert ds["impact_phase_stop"].dims == ("omega", "value")
    assert ds["impact_phase_stop"].shape == (3, 3)
    assert ds["impact_phase_stop"].attrs["units"] == "rad"
    assert int(ds["impact_phase_stop_number"][0]) > 3
    assert ds["impact_phase_stop_number"].values[1:].tolist() == [2, 2]
    assert [observable.name for observable in atlas_observables(ds)] == ["impact_phase:stop", "energy_loss"]


def test_a_sweep_shows_the_first_observable_where_it_holds_no_sections_and_another_one_if_asked(store: Path) -> None:
    ds = atlas.open(store)
    assert PlottedValues.resolve(None, ds) == PlottedValues(Observable("impact_phase", "stop", 0))
    drawn = ds.atlas.plot(observe="energy_loss")
    assert drawn.axes[0].get_ylabel() == "energy lost in a forcing period"
    assert ds.atlas.plot().axes[0].get_ylabel() == "phase of the force\nat impacts on stop [rad]"


def test_an_observable_that_an_atlas_does_not_hold_is_refused_with_those_that_it_holds(store: Path) -> None:
    with pytest.raises(InputError, match=r"has no 'maximum:gap'; it has impact_phase:stop, energy_loss"):
        atlas.open(store).atlas.plot(observe="maximum:gap")


def test_an_observable_of_a_spec_that_its_system_does_not_have_is_refused() -> None:
    with pytest.raises(InputError, match=r"solve.observe: impact_phase:wall: unknown contact 'wall'; possible: stop"):
        atlas.Spec("two-mass", SWEEP, solve={"observe": "impact_phase:wall"})


def test_the_command_refuses_an_unknown_observable_in_one_line() -> None:
    ran = CliRunner().invoke(main, ["point", "--observe", "phase"])
    assert ran.exit_code == 2
    assert "unknown observable 'phase'; possible: impact_phase[:CONTACT][:SIDE]" in ran.output
    assert len(ran.output.strip().splitlines()) == 1


def test_a_spec_without_observables_keeps_its_digest_and_one_with_them_comes_back_from_its_store(store: Path) -> None:
    plain = atlas.Spec("two-mass", SWEEP, {"b": 0.15}, {key: value for key, value in SOLVE.items() if "obs" not in key})
    assert plain.digest == plain.with_observables("").digest
    spec = atlas.Spec.from_dataset(atlas.open(store))
    assert spec.settings.observe == "impact_phase:stop,energy_loss"
    assert spec.digest != plain.digest


def test_values_of_neighbouring_orbits_keep_their_places_where_one_passes_the_section() -> None:
    before, after = [0.1, 2.0, 5.0], [2.1, 5.1, 0.05 + 2.0 * math.pi - 0.1]
    found = align_rows(np.array([before, after, [1.0, np.nan, np.nan]]), 2.0 * math.pi)
    assert found[1].tolist() == [after[2], after[0], after[1]]
    assert found[2][0] == 1.0


def test_phases_along_a_branch_are_those_of_the_cells_beside_it(store: Path) -> None:
    """And a branch is drawn in pieces where a phase passes 2 pi."""
    ds = atlas.open(store)
    asked = {"along": "omega", "window": (3.4, 4.1), "observe": "impact_phase:stop"}
    table = atlas.branch({"omega": 3.9, "b": 0.15}, **asked)
    known = np.sort(ds["impact_phase_stop"].sel(omega=4.0).values[:2])
    for values in table.plotted_values(table.traced[0]):
        rows = np.sort(values[:, :2], axis=1)
        along = np.argsort(table.traced[0].values)
        for k in range(2):
            here = np.interp(4.0, table.traced[0].values[along], rows[along, k])
            assert here == pytest.approx(known[k], abs=1e-3)
    assert all(np.all(np.abs(np.diff(line[:, 1])) < math.pi) for _, line in table.lines())


def test_points_of_branches_have_the_values_of_an_observable(tmp_path: Path) -> None:
    """Truth: section values are the first component of the state, here of two masses the gap coordinate."""
    asked = ["branch", "--set", "omega=3.9", "--set", "b=0.15", "--along", "omega", "--from", "3.8", "--to", "4.0"]
    for observe, columns in (("impact_phase:stop", 2), ("section:x1", 1)):
        for suffix in (".csv", ".json"):
            path = tmp_path / f"branch{suffix}"
            ended = CliRunner().invoke(main, [*asked, "--observe", observe, "-o", str(path)])
            assert ended.exit_code == 0, ended.output
            rows = pd.read_csv(path) if suffix == ".csv" else pd.DataFrame(json.loads(path.read_text())["points"])
            names = [name for name in rows if name.startswith(observe.replace(":", "_"))]
            assert names == [f"{observe.replace(':', '_')}_{i}" for i in range(1, columns + 1)]
            assert np.isfinite(rows[names].to_numpy()).all()
    np.testing.assert_allclose(rows["section_x1_1"], rows["x1"], atol=1e-9)


def test_a_branch_of_what_cannot_be_observed_is_refused_in_one_line() -> None:
    with pytest.raises(InputError, match=r"observe: impact_phase:wall: unknown contact 'wall'; possible: stop"):
        atlas.branch(omega=3.9, b=0.15, along="omega", window=(3.8, 4.0), observe="impact_phase:wall")


def test_a_portrait_shows_the_return_map_of_the_first_observable_over_the_whole_orbit() -> None:
    settings = Settings(survival=0, max_periods=1000, observe="impact_phase:stop,energy_loss")
    orbit = cell_orbit({"omega": 3.5, "b": 0.15}, settings=settings)
    first, second = orbit.cell["impact_phase_stop"][:2]
    assert orbit.cell["impact_phase_stop_number"] == 2
    (ax,) = (ax for ax in portrait.figure(orbit).axes if ax.get_ylabel() == "the next one")
    (line,) = ax.lines
    np.testing.assert_array_equal(line.get_xydata(), [(first, second), (second, first)])
    assert ax.get_xlabel() == "phase of the force at impacts on stop [rad]"
