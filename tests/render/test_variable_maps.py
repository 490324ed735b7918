"""Maps of any variable, and exponents of -inf in pictures, counts and means."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner
from matplotlib import colors
from matplotlib.figure import Figure

from atlas import render
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.overview.coarsen import coarsen, from_cells
from atlas.query.extremes import extremes
from atlas.render import scalar_maps
from atlas.render.kinds import KIND_TABLE
from atlas.render.scales import LINEAR, ColorMapping, both_signs, color_table
from atlas.store.create import create_store
from atlas.store.tiles import write_tile
from tests.pictures import colour, labels, line, pixel, plane
from tests.planes import plane_of
from workers import Settings, solve_tile
from workers.results import CHAOTIC, FAILED, INVALID, NO_IMPACT, PERIODIC, UNDETERMINED, empty_results

SPEED = {"long_name": "fastest impact; and more", "units": "1"}
LOST = r"$-\infty$: rest on a stop erases disturbances"


def speeds() -> xr.Dataset:
    """A plane with impact speeds from 1 to 9 along x, NaN without impact and in one periodic cell, 0 in another."""
    ds = plane()
    moving = np.isin(ds["regime"].values, (PERIODIC, CHAOTIC))
    values = np.where(moving, 1.0 + np.arange(9.0), np.nan)
    values[1, 0], values[1, 1] = np.nan, 0.0
    ds["max_impact_speed"] = (ds["regime"].dims, values, SPEED)
    return ds


def balls() -> xr.Dataset:
    """The packaged bouncing ball, where it comes to rest on the table and where it does not."""
    omega, R = np.array([0.5, 1.0, 2.2]), np.array([0.1, 0.5, 0.9])
    found = solve_tile("bouncing-ball", {"omega": omega[None, :], "R": R[:, None]}, Settings(max_periods=4000))
    axes = {"omega": ("omega", omega, {"units": "1"}), "R": ("R", R, {"units": "1"})}
    arrays = {name: (("R", "omega"), found[name]) for name in ("regime", "largest", "error", "peak_to_peak")}
    return xr.Dataset(arrays, axes, {"spec": '{"system": "bouncing-ball", "axes": []}'})


def drawn(figure: Figure) -> np.ndarray:
    return np.asarray(figure.axes[0].images[0].get_array())


def rgb(color: str) -> tuple[int, ...]:
    return tuple(round(255 * part) for part in colors.to_rgb(color))


def test_a_scale_that_ends_at_zero_is_pointed_where_values_lie_above_it(monkeypatch: pytest.MonkeyPatch) -> None:
    ends, draw = [], Figure.colorbar

    def noted(drawn: Figure, *given: Any, extend: str, **look: Any) -> Any:
        ends.append(extend)
        return draw(drawn, *given, extend=extend, **look)

    monkeypatch.setattr(Figure, "colorbar", noted)
    ds = speeds()
    ds["max_impact_speed"] = ds["max_impact_speed"] - 8.5
    render.figure(ds, variable="max_impact_speed", vmin=-9.0, vmax=0.0)
    assert ends == ["max"]


def test_a_variable_is_drawn_on_its_scale_with_its_name_and_unit() -> None:
    figure = render.figure(speeds(), variable="max_impact_speed")
    assert figure.axes[1].get_ylabel() == "fastest impact"
    cells = drawn(figure)
    lightness = cells[2, :, :3] @ [0.2126, 0.7152, 0.0722]
    assert np.all(np.diff(lightness) < 0)


def test_a_unit_that_a_meaning_ends_with_is_written_once() -> None:
    ds = plane()
    ds["largest"].attrs.update(long_name="largest Lyapunov exponent per forcing period", units="1")
    bar = render.figure(ds, variable="largest").axes[1]
    assert bar.get_ylabel() == "largest Lyapunov exponent [per forcing period]"


def test_the_kind_scalar_is_what_a_named_variable_is_drawn_as() -> None:
    one, other = (render.figure(speeds(), kind, variable="max_impact_speed") for kind in (None, "scalar"))
    np.testing.assert_array_equal(drawn(one), drawn(other))


def test_cells_without_such_a_number_are_neutral_and_those_without_a_result_as_everywhere() -> None:
    ds = speeds()
    figure = render.figure(ds, variable="max_impact_speed")
    cells, regime = drawn(figure), ds["regime"].values
    assert tuple(cells[1, 0, :3]) == rgb(scalar_maps.NEUTRAL)
    assert "no such number" in labels(figure)
    for code in (NO_IMPACT, UNDETERMINED, INVALID, FAILED):
        assert tuple(cells[regime == code][0]) == colour(code)


def test_zero_is_neutral_on_a_logarithmic_scale_and_said_to_be() -> None:
    figure = render.figure(speeds(), variable="max_impact_speed", log=True)
    assert tuple(drawn(figure)[1, 1, :3]) == rgb(scalar_maps.NEUTRAL)
    assert "0 or no such number" in labels(figure)


def test_numbers_below_zero_have_no_logarithmic_scale() -> None:
    with pytest.raises(InputError, match="'largest' has values below zero"):
        render.figure(plane(), variable="largest", log=True)


def test_a_negative_variable_spans_its_own_scale() -> None:
    norm = render.figure(plane(), variable="largest").axes[1]
    low, high = norm.get_ylim()
    assert low < 0.0 < high


def test_a_wrong_name_is_answered_with_the_nearest() -> None:
    with pytest.raises(InputError, match=r"max_impact_sped.*did you mean.*max_impact_speed"):
        render.figure(speeds(), variable="max_impact_sped")


def test_what_is_no_number_of_each_cell_is_refused() -> None:
    with pytest.raises(InputError, match="variable 'regime' does not have one number per cell; possible: largest"):
        render.figure(speeds(), variable="regime")


@pytest.mark.parametrize(
    ("given", "line_"),
    [
        ({"kind": "period", "variable": "largest"}, "needs kind 'scalar', found 'period'"),
        ({"kind": "scalar"}, "kind 'scalar' needs the name of a variable"),
        ({"log": True}, "kind 'scalar' needs the name of a variable"),
    ],
)
def test_what_does_not_go_together_is_refused(given: dict[str, Any], line_: str) -> None:
    with pytest.raises(InputError, match=line_):
        render.figure(speeds(), **given)


def test_a_sweep_has_no_map() -> None:
    with pytest.raises(InputError, match="kind 'scalar' draws two axes, found one"):
        render.figure(line(), variable="largest")


def test_the_command_draws_a_variable_of_a_store_or_says_why_not_and_writes_nothing(tmp_path: Path) -> None:
    handle, out = create_store(tmp_path / "plane.zarr", plane_of((5, 7)), (5, 7)), tmp_path / "speed.png"
    arrays = empty_results(handle.spec.variables, (5, 7), handle.spec.extra_sizes)
    arrays["regime"][:], arrays["min_impact_speed"][:] = PERIODIC, np.linspace(0.1, 1.0, 7)
    write_tile(handle, (0, 0), arrays)
    call = ["plot", str(handle.path), "-o", str(out), "--variable"]
    missing = CliRunner().invoke(main, [*call, "kaplan_yorke"])
    assert missing.exit_code == 2
    assert "min_impact_speed" in missing.output
    assert not out.exists()
    assert CliRunner().invoke(main, [*call, "min_impact_speed", "--log"]).exit_code == 0
    assert out.exists()


def test_a_scale_of_both_signs_is_pale_at_zero_and_as_dark_on_either_side_of_it() -> None:
    above = KIND_TABLE["scalar"].scale.colors
    scale = ColorMapping(LINEAR, (-1.0, 2.0), color_table(above), both_signs(above))
    colors = scale.colors(np.array([-0.5, 0.0, 0.5])) / 255
    lightness = colors @ [0.2126, 0.7152, 0.0722]
    assert lightness[1] > 0.9
    assert lightness[0] == pytest.approx(lightness[2], abs=0.02)
    below, _, above_zero = colors
    assert below[1] > below[0] and above_zero[0] > above_zero[1]  # green, purple
    for ends in ((0.0, 2.0), (-2.0, -1.0)):
        assert replace(scale, ends=ends).table is color_table(above)


# Exponents of -inf


def test_where_a_ball_comes_to_rest_no_exponent_is_left_and_the_map_says_so(tmp_path: Path) -> None:
    ds = balls()
    assert np.isneginf(ds["largest"].values).sum() >= 3
    figure = render.figure(ds)
    assert LOST in labels(figure)
    assert "||" in {patch.get_hatch() for patch in figure.axes[0].patches}
    assert np.isfinite(figure.axes[1].get_ylim()).all()
    path = render.render(ds, tmp_path / "balls.png")
    lost = tuple(np.argwhere(np.isneginf(ds["largest"].values))[0])
    assert pixel(path, figure, float(ds["omega"][lost[1]]), float(ds["R"][lost[0]])) != (255, 255, 255)


def test_a_plane_of_nothing_but_rest_is_drawn() -> None:
    ds = balls().isel(omega=[0], R=[0])
    assert np.isneginf(ds["largest"].values).all()
    for name in (None, "largest"):
        assert LOST in labels(render.figure(ds, variable=name))


def test_extremes_leave_out_exponents_of_minus_infinity() -> None:
    ds = balls()
    finite = ds["largest"].values[np.isfinite(ds["largest"].values)]
    found = [entry["value"] for entry in extremes(ds, "largest", by="all")]
    assert found == [finite.min(), finite.max()]


def test_the_mean_of_a_coarse_cell_leaves_them_out_unless_there_is_nothing_else() -> None:
    regime = np.full((2, 4), PERIODIC, np.int8)
    largest = np.array([[-np.inf, -np.inf, -np.inf, -1.0], [-np.inf, -np.inf, -3.0, -2.0]])
    names = ["regime", "largest", "largest_count", "regime_share", "cells"]
    made = coarsen(from_cells({"regime": regime, "largest": largest}, names), (np.ones(2), np.ones(4)))
    assert made["largest"].tolist() == [[-np.inf, -2.0]]
    assert made["largest_count"].tolist() == [[0, 3]]


def test_a_sweep_marks_exponents_of_minus_infinity_at_its_foot() -> None:
    ds = line()
    ds["largest"].values[2] = -np.inf
    ax = next(ax for ax in render.figure(ds).axes if "Lyapunov" in ax.get_ylabel())
    assert r"▾: $-\infty$" in ax.get_ylabel()
    marks = [line for line in ax.lines if line.get_marker() == "v"]
    assert [mark.get_xdata().tolist() for mark in marks] == [[float(ds["omega"][2])]]


def test_contacts_without_end_and_those_of_no_orbit_are_no_numbers_of_a_map_nor_extremes() -> None:
    axes = {"omega": ("omega", np.arange(4.0), {"units": "1"}), "R": ("R", np.arange(1.0), {"units": "1"})}
    cells = {
        "regime": np.array([[PERIODIC, PERIODIC, PERIODIC, CHAOTIC]]),
        "stop_upper": np.array([[-1, 2, 3, 7]], np.int32),
    }
    spec = {"spec": '{"system": "capsule", "axes": []}'}
    ds = xr.Dataset({name: (("R", "omega"), values) for name, values in cells.items()}, axes, spec)
    shown = drawn(render.figure(ds, variable="stop_upper"))[0]
    neutral = [tuple(color[:3]) == rgb(scalar_maps.NEUTRAL) for color in shown]
    assert neutral == [True, False, False, True]
    assert [extreme["value"] for extreme in extremes(ds, "stop_upper", "all")] == [2, 3]
