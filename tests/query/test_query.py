"""Claims about atlas.query, on small atlases made by hand whose answers can be counted."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from distributed import Client

import atlas
from atlas.errors import InputError
from atlas.query import queries as query
from atlas.query import window
from workers.results import APERIODIC, CHAOTIC, NO_IMPACT, PENDING, PERIODIC


def plane(omega: list[float], b: list[float], regime: np.ndarray | None = None, **attrs: str) -> xr.Dataset:
    shape = (len(b), len(omega))
    codes = np.full(shape, PERIODIC, np.int8) if regime is None else np.asarray(regime, np.int8)
    numbered = np.arange(codes.size, dtype=float).reshape(shape)
    return xr.Dataset(
        {
            "regime": (("b", "omega"), codes),
            "largest": (("b", "omega"), numbered),
            "sticks": (("b", "omega"), numbered > 3),
            "state": (("b", "omega", "component"), np.zeros((*shape, 4))),
        },
        {"omega": omega, "b": b, "R": 0.8},
        attrs,
    )


def spec(**scales: str) -> str:
    return json.dumps({"axes": [{"name": name, "scale": scale} for name, scale in scales.items()]})


def test_at_finds_the_cell_whose_values_are_asked_for() -> None:
    cell = query.nearest_cell(plane([1, 2, 3], [0.1, 0.2]), {"omega": 3, "b": 0.2})
    assert (cell["omega"], cell["b"], cell["largest"]) == (3.0, 0.2, 5.0)


def test_at_takes_the_nearest_cell_and_reports_its_distance_per_axis() -> None:
    cell = query.nearest_cell(plane([1, 2, 3], [0.1, 0.2]), {"omega": 1.75, "b": 0.1})
    assert cell["omega"] == 2.0
    assert cell["distance"] == {"omega": 0.25, "b": 0.0}


def test_at_takes_the_cell_that_is_drawn_at_the_point_on_a_log_axis() -> None:
    """The edges of .1, .316, 1 are at geometric means, .178 and .562; midway would be at .208 and .658."""
    values = np.geomspace(0.1, 1.0, 3)
    for order in (values, values[::-1]):
        ds = plane(order, [0.1, 0.2], spec=spec(omega="log", b="linear"))
        assert query.nearest_cell(ds, {"omega": 0.19, "b": 0.1})["omega"] == pytest.approx(0.316, rel=1e-3)
        assert query.nearest_cell(ds, {"omega": 0.17, "b": 0.1})["omega"] == 0.1
        assert query.nearest_cell(ds, {"omega": 0.57, "b": 0.1})["omega"] == 1.0
        assert float(window.select(ds, {"omega": 0.19}).omega) == pytest.approx(0.316, rel=1e-3)


def test_at_finds_each_cell_of_an_axis_of_neighbouring_floats() -> None:
    values = [1.0, np.nextafter(1.0, 2.0), np.nextafter(np.nextafter(1.0, 2.0), 2.0)]
    for value in values:
        assert query.nearest_cell(plane(values, [0.1, 0.2]), {"omega": value, "b": 0.1})["omega"] == value


def test_at_names_the_regime() -> None:
    assert (
        query.nearest_cell(plane([1, 2], [0.1, 0.2], [[0, 1], [2, 3]]), {"omega": 2, "b": 0.2})["regime"] == "chaotic"
    )


def test_at_gives_every_variable_with_one_value_a_cell_as_a_plain_python_value() -> None:
    cell = query.nearest_cell(plane([1, 2], [0.1, 0.2]), {"omega": 1, "b": 0.1})
    kinds = {name: type(value) for name, value in cell.items()}
    assert kinds == {"omega": float, "b": float, "distance": dict, "regime": str, "largest": float, "sticks": bool}


def test_at_takes_a_point_up_to_half_a_cell_beyond_the_grid() -> None:
    assert query.nearest_cell(plane([1, 2, 3], [0.1, 0.2]), {"omega": 3.5, "b": 0.1})["omega"] == 3.0


def test_at_works_along_a_sweep() -> None:
    sweep = xr.Dataset({"regime": ("omega", np.array([1, 3], np.int8))}, {"omega": [2.0, 4.0], "b": 0.15})
    assert query.nearest_cell(sweep, {"omega": 4.0})["regime"] == "chaotic"


def test_at_finds_the_only_point_of_an_axis() -> None:
    assert query.nearest_cell(plane([1, 2], [0.15]), {"omega": 1, "b": 0.15})["b"] == 0.15


@pytest.mark.parametrize(
    ("point", "message"),
    [
        ({"omega": 4.0, "b": 0.1}, "omega = 4 lies outside the grid; valid: 0.5 to 3.5"),
        ({"omega": float("nan"), "b": 0.1}, "omega = nan: must be a finite number"),
        ({"omega": 1.0, "zeta": 0.1}, "unknown axis 'zeta'; the axes are: omega, b"),
        ({"omega": 1.0, "R": 0.7}, "R is not an axis here but fixed at 0.8; axes: omega, b"),
        ({"omega": 1.0}, "point: found no b, must have a value for each axis: omega, b"),
    ],
)
def test_at_answers_a_bad_point_with_one_line(point: Mapping[str, float], message: str) -> None:
    with pytest.raises(InputError) as error:
        query.nearest_cell(plane([1, 2, 3], [0.1, 0.2]), point)
    assert str(error.value) == message


@pytest.mark.parametrize("ask", ["fractions", "count_reasons", "regions", "at", "boundary", "plot"])
def test_selections_without_cells_and_masked_atlases_are_answered_with_one_line(ask: str) -> None:
    """A mask makes floats of codes, and NaN is no regime; an empty selection has no shares."""
    ds = plane([1, 2, 3], [0.1, 0.2])
    ds["reason"] = ds.regime * 0
    given: dict[str, Any] = {"at": {"omega": 1, "b": 0.1}}.get(ask, {})
    words = {"regions": ["period"], "boundary": ["periodic"]}.get(ask, [])
    for wrong, message in (
        (ds.isel(omega=slice(0, 0)), "omega: found a selection without cells, must have one or more"),
        (ds.where(ds.omega > 1), r"regime: found float\d\d, must be whole numbers; choose cells by .sel, a window or "),
    ):
        with pytest.raises(InputError, match=f"^{message}"):
            getattr(wrong.atlas, ask)(*words, **given)


def test_at_reads_no_variable_with_more_than_one_value_a_cell() -> None:
    ds = plane([1, 2], [0.1, 0.2]).drop_vars("state")
    ds["section"] = xr.Variable(("b", "omega", "sample"), _Unreadable((2, 2, 9)))
    assert "section" not in query.nearest_cell(ds, {"omega": 1, "b": 0.1})


def test_fractions_of_even_cells_are_shares_of_their_number() -> None:
    ds = plane([1, 2], [0.1, 0.2], [[PERIODIC, PERIODIC], [PERIODIC, CHAOTIC]])
    assert query.fractions(ds) == {"periodic": 0.75, "chaotic": 0.25}


def test_fractions_count_pending_cells_and_leave_out_absent_regimes() -> None:
    ds = plane([1, 2], [0.1, 0.2], [[PENDING, PENDING], [NO_IMPACT, NO_IMPACT]])
    assert query.fractions(ds) == {"pending": 0.5, "no_impact": 0.5}


def test_fractions_weigh_cells_with_their_area() -> None:
    # Edges of 1, 2, 4 are 0.5, 1.5, 3, 5: widths 1, 1.5, 2.
    ds = plane([1, 2, 4], [0.1, 0.2], [[PERIODIC, PERIODIC, CHAOTIC]] * 2, spec=spec(omega="linear", b="linear"))
    assert query.fractions(ds) == pytest.approx({"periodic": 2.5 / 4.5, "chaotic": 2 / 4.5})


def test_fractions_take_edges_of_a_log_axis_at_geometric_means() -> None:
    # Edges of 1, 4, 16 are 0.5, 2, 8, 32.
    ds = plane([1, 4, 16], [0.1, 0.2], [[PERIODIC, PERIODIC, CHAOTIC]] * 2)
    assert query.fractions(ds) == pytest.approx({"periodic": 7.5 / 31.5, "chaotic": 24 / 31.5})


def test_fractions_do_not_depend_on_the_order_of_an_axis() -> None:
    codes = np.array([[PERIODIC, PERIODIC, CHAOTIC]] * 2)
    turned = plane([4, 2, 1], [0.1, 0.2], codes[:, ::-1])
    assert query.fractions(turned) == query.fractions(plane([1, 2, 4], [0.1, 0.2], codes))


def test_a_window_takes_cells_whose_centres_it_holds_ends_included() -> None:
    ds = plane([1, 2, 3], [0.1, 0.2], [[PERIODIC, CHAOTIC, CHAOTIC], [PERIODIC, PERIODIC, CHAOTIC]])
    assert query.fractions(ds, {"omega": (2.0, 3.4), "b": (0.1, 0.15)}) == {"chaotic": 1.0}


def test_fractions_of_a_sweep_are_shares_of_its_length() -> None:
    sweep = xr.Dataset({"regime": ("omega", np.array([1, 1, 3, 3], np.int8))}, {"omega": [1.0, 2.0, 3.0, 4.0]})
    assert query.fractions(sweep) == {"periodic": 0.5, "chaotic": 0.5}


def test_a_window_without_a_cell_is_answered_with_one_line() -> None:
    with pytest.raises(InputError) as error:
        query.fractions(plane([1, 2, 3], [0.1, 0.2]), {"omega": (2.1, 2.4)})
    assert str(error.value) == "no cell centre with omega from 2.1 to 2.4; the centres reach from 1 to 3"


def test_an_unknown_axis_in_a_window_is_named() -> None:
    with pytest.raises(InputError, match="unknown axis 'zeta'"):
        query.fractions(plane([1, 2], [0.1, 0.2]), {"zeta": (0, 1)})


def test_fractions_read_the_regimes_alone() -> None:
    ds = plane([1, 2], [0.1, 0.2])[["regime"]]
    ds["largest"] = xr.Variable(("b", "omega"), _Unreadable((2, 2)))
    assert query.fractions(ds) == {"periodic": 1.0}


def test_a_dataset_that_is_no_atlas_is_said_to_be_none() -> None:
    with pytest.raises(InputError, match="not an atlas"):
        query.fractions(xr.Dataset())


def test_atlases_concatenated_along_a_parameter_are_a_stack() -> None:
    regimes = [np.full((2, 2), PERIODIC), np.array([[PERIODIC, CHAOTIC], [CHAOTIC, CHAOTIC]])]
    planes = zip(regimes, (0.7, 0.8), strict=True)
    both = xr.concat([plane([1, 2], [0.1, 0.2], regime).assign_coords(R=R) for regime, R in planes], "R")
    assert query.fractions(both) == {"periodic": 5 / 8, "chaotic": 3 / 8}


def test_more_than_three_axes_must_be_taken_one_at_a_time() -> None:
    four = plane([1, 2], [0.1, 0.2]).expand_dims({"tau": [0.0, 1.0], "R": [0.7, 0.8]})
    with pytest.raises(InputError, match=r"found 4 axes \(omega, b, R, tau\), must be 1 to 3"):
        query.fractions(four)


class _Unreadable(xr.backends.BackendArray):
    """An array on disk that nobody may read."""

    def __new__(cls, shape: tuple[int, ...]) -> "xr.core.indexing.LazilyIndexedArray":  # type: ignore[misc]
        array = super().__new__(cls)
        array.shape, array.dtype = shape, np.dtype(float)
        return xr.core.indexing.LazilyIndexedArray(array)

    def __getitem__(self, key: object) -> np.ndarray:
        raise AssertionError("was read")


def test_aperiodic_cells_have_a_fraction_and_say_how_long_they_survived(tmp_path: Path, client: Client) -> None:
    spec = atlas.Spec(
        "two-mass",
        axes={"omega": [1.4, 2.5, 3.0, 3.5], "b": [0.1, 0.2, 0.3]},
        solve={"exponents": "none", "max_periods": 2000, "survival": 800},
    )
    atlas.run(spec, tmp_path / "out.zarr", client=client)
    ds = atlas.open(tmp_path / "out.zarr")
    aperiodic = np.argwhere(ds.regime.values == APERIODIC)
    assert 0 < aperiodic.shape[0] < 12
    assert 0.0 < ds.atlas.fractions().to_dict()["aperiodic"] < 1.0
    row, column = aperiodic[0]
    found = ds.atlas.at(omega=float(ds.omega[column]), b=float(ds.b[row]))
    assert (found["regime"], bool(found["survived"] >= 800 // 8)) == ("aperiodic", True)
    assert np.isfinite(ds.atlas.where_regime("aperiodic").survived.values).sum() == aperiodic.shape[0]
