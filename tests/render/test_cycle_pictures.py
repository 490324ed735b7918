"""Claims about pictures and commands of machines without a force."""

from pathlib import Path

import numpy as np
import pytest
from distributed import Client
from matplotlib.figure import Figure
from matplotlib.text import Text

import atlas
from atlas.cell.portrait_data import periods
from atlas.cell.trajectory import cell_orbit, describe
from atlas.errors import InputError
from atlas.query.compare import Comparison
from atlas.render.drawing import figure
from atlas.spec.system import must_offer, parse_system
from workers import trace

FAST = atlas.Settings(survival=0, max_periods=2000)


def test_a_portrait_shows_a_cycle_once_around_over_its_own_period() -> None:
    orbit = cell_orbit({"u": 0.3}, "belt", FAST)
    T = float(orbit.cell["cycle_period"])
    assert orbit.period == pytest.approx(T, rel=1e-15)
    assert orbit.times[-1] == pytest.approx(T, rel=1e-12)
    np.testing.assert_allclose(orbit.states[-1], orbit.states[0], atol=1e-12)
    np.testing.assert_allclose(orbit.section, orbit.states[:1], atol=1e-12)
    assert periods(orbit) == 2
    assert describe(orbit).startswith(f"periodic, cycle of {T:.6g}, ")
    labels = {ax.get_xlabel() for ax in figure(orbit).axes}
    assert {"time $t$", "periods averaged over"} <= labels


def test_a_portrait_of_an_equilibrium_has_no_period() -> None:
    orbit = cell_orbit({"u": 1.2, "zeta": 0.2}, "belt", FAST)
    assert describe(orbit) == "equilibrium"
    assert np.ptp(orbit.states, axis=0).max() < 1e-12


def test_a_history_follows_a_machine_over_any_cycle_and_only_one_without_a_force() -> None:
    history = trace("belt", {"u": 0.3}, 3, cycle=2.0)
    assert history.times.tolist() == [0.0, 2.0, 4.0, 6.0]
    with pytest.raises(ValueError, match="cycle: found 2, must be left out: system 'two-mass' has the period"):
        trace("two-mass", {}, 3, cycle=2.0)


def test_a_plane_of_belts_is_solved_asked_and_drawn(tmp_path: Path, client: Client) -> None:
    spec = atlas.Spec("belt", {"u": [0.3, 0.6, 1.1], "zeta": [0.02, 0.1]}, solve={"max_periods": 2000, "survival": 0})
    atlas.run(spec, tmp_path / "belt.zarr", client=client)
    ds = atlas.open(tmp_path / "belt.zarr")
    assert ds["largest"].attrs["long_name"].endswith("per unit time")
    assert np.array_equal(ds["cycle_period"] > 0.0, ds["regime"] == 1)
    assert atlas.verify(tmp_path / "belt.zarr").is_sound
    drawn = figure(ds, kind="scalar", variable="cycle_period")
    assert "time that a cycle takes" in {ax.get_ylabel() for ax in drawn.axes}
    said = [text.get_text() for legend in figure(ds, kind="period").legends for text in legend.get_texts()]
    assert "equilibrium" in said
    assert "no impact" not in said


def texts_of(drawn: Figure) -> str:
    """All labels, titles and legends of a figure."""
    return "\n".join(text.get_text() for text in drawn.findobj(Text)).replace("\n", " ")


def test_every_picture_without_a_force_has_the_units_and_the_words_of_its_machine(
    tmp_path: Path, client: Client
) -> None:
    atlases = []
    for r in (0.4, 0.5):
        solve = {"max_periods": 2000, "survival": 0}
        spec = atlas.Spec("belt", {"u": [0.3, 0.6, 1.1], "zeta": [0.02, 0.1]}, {"r": r}, solve)
        atlas.run(spec, tmp_path / f"belt-{r}.zarr", client=client)
        atlases.append(atlas.open(tmp_path / f"belt-{r}.zarr"))
    both = [figure(atlases), figure(Comparison.from_atlases(*atlases))]
    for drawn in (*both, figure(atlases[0])):
        assert "per unit time" in texts_of(drawn) and "per forcing period" not in texts_of(drawn)
        assert "no impact" not in texts_of(drawn)
    assert "equilibrium" in texts_of(both[0]) and ": stick erases disturbances" in texts_of(both[0])
    assert "natural periods simulated" in texts_of(figure(atlases[0], variable="periods_used"))
    assert "$n$ passages" in texts_of(figure(atlases[0], kind="impacts"))


def test_what_is_not_there_without_a_force_is_refused_in_a_line() -> None:
    line = "system 'belt': saddles do not exist for a machine without a force"
    with pytest.raises(InputError, match=line):
        must_offer(parse_system("belt"), "saddles")
    for what in (atlas.stability, atlas.saddles):
        with pytest.raises(InputError, match=r"system 'belt': .* do not exist for a machine without a force"):
            what({"u": 0.3}, system="belt", starts=4)


def test_basins_without_a_force_show_the_whole_cycle_and_are_sound(tmp_path: Path, client: Client) -> None:
    axes = {"x": np.linspace(-0.6, 1.5, 8), "v": np.linspace(-1.0, 1.0, 7)}
    solve = {"max_periods": 1000, "survival": 0}
    spec = atlas.Spec("belt", axes, {"u": 0.5, "zeta": 0.05}, solve, attractors={"starts": 16})
    atlas.run(spec, tmp_path / "belt.zarr", client=client)
    ds = atlas.open(tmp_path / "belt.zarr")
    assert atlas.verify(tmp_path / "belt.zarr").is_sound
    shares = ds.atlas.basin_measures().to_dataframe()
    assert {*shares["regime"]} == {"periodic", "no_impact"}
    (cycle,) = shares[shares["regime"] == "periodic"].to_dict("records")
    said = "\n".join(text.get_text() for legend in figure(ds).legends for text in legend.get_texts())
    assert f"cycle of {cycle['cycle_period']:.4g}, {100 * cycle['share']:.3g} %" in said
    assert "natural periods" in said
    assert "1: equilibrium" in said or "0: equilibrium" in said
    assert "kT" not in said
