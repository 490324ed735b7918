"""Claims about two atlases held against each other, and about several drawn side by side."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure
from PIL import Image

import atlas
from atlas import render
from atlas.errors import InputError
from atlas.query.compare import Comparison
from atlas.query.read_counter import count_chunk_reads
from atlas.render import side_by_side
from atlas.render.scales import scale_ends
from atlas.store import create, store
from tests import pictures
from tests.interface.test_cli import call
from tests.pictures import labels
from tests.query.test_query import plane, spec
from tests.synthetic import fill, keep, spec_of
from workers.results import CHAOTIC, LOCKING, NO_IMPACT, OF_MOTIONS, PENDING, PERIODIC, UNDETERMINED

P, C, N, Q, U = PERIODIC, CHAOTIC, NO_IMPACT, PENDING, UNDETERMINED


def made(path: Path, seed: int, nx: int = 45, **parameters: float) -> store.AtlasStore:
    given = spec_of(nx=nx)
    changed = atlas.Spec("two-mass", axes={axis.name: list(axis.values) for axis in given.axes}, parameters=parameters)
    handle = create.create_store(path, changed, (19, 23))
    fill(handle, seed=seed)
    keep(handle)
    return handle


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three stores of the same cells, a.zarr, b.zarr and c.zarr, with R from 0.8 to 0.6; d.zarr has fewer cells."""
    path = tmp_path_factory.mktemp("compare")
    for seed, (name, R) in enumerate({"a": 0.8, "b": 0.7, "c": 0.6}.items()):
        made(path / f"{name}.zarr", seed, R=R)
    made(path / "d.zarr", 3, nx=30)
    return path


# In numbers


def test_a_difference_is_there_minus_here_and_none_where_a_class_is_not_known() -> None:
    one = plane([1, 2], [0.1, 0.2], [[P, C], [U, P]])
    other = plane([1, 2], [0.1, 0.2], [[C, C], [P, Q]])
    found = Comparison.from_atlases(one, other.assign(largest=other.largest + 0.5)).difference
    np.testing.assert_array_equal(found, [[0.5, 0.5], [np.nan, np.nan]])


def test_a_locking_cell_has_a_difference_since_it_has_exponents() -> None:
    one, other = plane([1], [0.1], [[LOCKING]]), plane([1], [0.1], [[LOCKING]])
    compared = Comparison.from_atlases(one, other.assign(largest=other.largest + 0.5))
    np.testing.assert_allclose(compared.difference, [[0.5]])


def test_an_infinite_exponent_has_no_difference() -> None:
    one, other = plane([1, 2], [0.1]), plane([1, 2], [0.1])
    one["largest"][0, 0] = other["largest"][0, 0] = -np.inf
    np.testing.assert_array_equal(Comparison.from_atlases(one, other).difference, [[np.nan, 0.0]])


def test_the_table_counts_cells_by_both_regimes() -> None:
    one = plane([1, 2, 3], [0.1, 0.2], [[P, P, C], [C, N, Q]])
    other = plane([1, 2, 3], [0.1, 0.2], [[P, C, C], [C, P, P]])
    table = Comparison.from_atlases(one, other).regimes
    assert table.sel(first="periodic", second="chaotic") == 1
    assert table.sel(first="chaotic", second="chaotic") == 2
    assert table.sel(first="no_impact", second="periodic") == 1
    assert table.sel(first="pending", second="periodic") == 1
    assert table.sum() == 6


def test_the_same_regime_is_a_share_of_the_area_that_is_pending_in_neither() -> None:
    # Edges of 1, 2, 4 are 0.5, 1.5, 3, 5: widths 1, 1.5, 2.
    one = plane([1, 2, 4], [0.1], [[P, P, Q]], spec=spec(omega="linear", b="linear"))
    other = plane([1, 2, 4], [0.1], [[P, C, P]], spec=spec(omega="linear", b="linear"))
    assert Comparison.from_atlases(one, other).numbers.same == pytest.approx(1.0 / 2.5)


def test_an_atlas_compared_with_itself_differs_nowhere(folder: Path) -> None:
    ds = atlas.open(folder / "a.zarr")
    compared = ds.atlas.compare(ds)
    table = compared.regimes.values
    assert compared.numbers.same == 1.0
    assert (table == np.diag(table.diagonal())).all() and table.sum() == ds.regime.size
    assert (compared.numbers.mean, compared.numbers.size, compared.differing) == (0.0, 0.0, {})


def test_numbers_of_two_stores_are_those_of_their_cells(folder: Path) -> None:
    one, other = (atlas.open(folder / name).load() for name in ("a.zarr", "b.zarr"))
    found = atlas.open(folder / "a.zarr").atlas.compare(atlas.open(folder / "b.zarr"))
    known = one.regime.isin(list(OF_MOTIONS)) & other.regime.isin(list(OF_MOTIONS))
    known &= np.isfinite(one.largest) & np.isfinite(other.largest)
    difference = (other.largest - one.largest).where(known)
    np.testing.assert_array_equal(found.difference, difference)
    assert found.numbers.compared == int(known.sum())
    assert found.numbers.mean == pytest.approx(float(difference.mean()))
    assert found.numbers.size == pytest.approx(float(abs(difference).mean()))
    most, where = found.numbers.most
    assert abs(most) == float(abs(difference).max())
    assert float(difference.sel(where)) == most
    assert found.numbers.same == pytest.approx(float((one.regime == other.regime).mean()))
    assert found.differing == {"R": (0.8, 0.7)}


def test_a_comparison_of_a_window_reads_its_tiles_alone(folder: Path) -> None:
    one, other = (atlas.open(folder / name) for name in ("a.zarr", "b.zarr"))
    window = {"omega": (1.0, float(one.omega[10])), "b": (0.1, float(one.b[10]))}
    with count_chunk_reads() as reads:
        numbers = one.atlas.compare(other, window).numbers
    assert (reads.chunks, int(numbers.cells.sum())) == (2 * 2, 11 * 11)


def test_a_comparison_prints_as_one_line() -> None:
    one, other = plane([1, 2], [0.1]), plane([1, 2], [0.1]).assign_coords(R=0.7)
    assert repr(Comparison.from_atlases(one, other)) == "<Comparison of two atlases of 2 x 1 cells, R 0.8 and 0.7>"


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (plane([1, 2, 3], [0.1]), "axis omega differs: 2 values from 1 to 2 here, 3 values from 1 to 3 there"),
        (plane([1, 2.5], [0.1]), "axis omega differs: 2 values from 1 to 2 here, 2 values from 1 to 2.5 there"),
        (plane([1, 2], [0.1]).isel(b=0), "the axes differ: omega, b here, omega there"),
        (plane([1, 2], [0.1], spec=json.dumps({"system": "ball"})), "the systems differ: "),
    ],
)
def test_atlases_of_other_cells_are_refused_with_what_differs(other: xr.Dataset, message: str) -> None:
    with pytest.raises(InputError, match=message):
        plane([1, 2], [0.1]).atlas.compare(other)


def test_a_value_that_differs_in_its_last_bit_is_named_with_all_its_digits() -> None:
    middle = np.nextafter(2.0, 3.0)
    with pytest.raises(InputError, match=f"axis omega differs: value 2 is 2.0 here, {middle!s} there"):
        Comparison.from_atlases(plane([1, 2, 3], [0.1]), plane([1, middle, 3], [0.1]))


def test_exponents_in_other_units_are_not_compared(folder: Path) -> None:
    ds = atlas.open(folder / "a.zarr")
    with pytest.raises(
        InputError, match="exponents differ in their unit: per forcing period here, per unit time there"
    ):
        ds.atlas.compare(ds.atlas.per_unit_time())


# From the shell


def test_the_command_prints_the_table_and_writes_the_picture(folder: Path, tmp_path: Path) -> None:
    shown = call("compare", folder / "a.zarr", folder / "b.zarr", "-o", tmp_path / "a.png")
    assert shown.exit_code == 0
    assert shown.stdout.splitlines()[0] == f"R: 0.8 in {folder / 'a.zarr'}, 0.7 in {folder / 'b.zarr'}"
    assert "the same regime: " in shown.stdout
    with Image.open(tmp_path / "a.png") as image:
        assert len(image.info["Digest"].split()) == 2


def test_the_command_gives_a_comparison_as_json(folder: Path) -> None:
    message = json.loads(call("compare", folder / "a.zarr", folder / "b.zarr", "--json").stdout)
    assert message["parameters"] == {"R": [0.8, 0.7]}
    assert sum(n for row in message["regimes"].values() for n in row.values()) == 45 * 38


def test_the_command_refuses_atlases_of_other_cells_in_one_line(folder: Path, tmp_path: Path) -> None:
    shown = call("compare", folder / "a.zarr", folder / "d.zarr", "-o", tmp_path / "a.png")
    assert (shown.exit_code, shown.stdout, len(shown.stderr.splitlines())) == (2, "", 1)
    assert "axis omega differs: 45 values from 1 to 4 here, 30 values from 1 to 4 there" in shown.stderr
    assert list(tmp_path.iterdir()) == []


# Pictures


def texts(drawn: Figure) -> list[str]:
    return [ax.get_title("left") for ax in drawn.axes]


def test_the_picture_of_a_comparison_has_two_maps(folder: Path) -> None:
    drawn = atlas.open(folder / "a.zarr").atlas.compare(atlas.open(folder / "b.zarr")).plot()
    assert texts(drawn)[:2] == ["difference of exponents", "another regime"]
    assert "$R = 0.7$  compared with  $R = 0.8$" in drawn.get_suptitle()
    assert {"same regime", "chaotic instead", "without an exponent in one"} <= {*labels(drawn)}


def test_the_scale_of_differences_has_zero_in_its_middle() -> None:
    one = pictures.plane()
    other = one.assign(largest=one.largest + 0.25)
    bar = side_by_side.difference(Comparison.from_atlases(one, other)).axes[-1]
    assert bar.get_xlim() == pytest.approx((-0.25, 0.25))


def test_atlases_without_exponents_are_compared_by_their_regimes() -> None:
    one = pictures.plane().drop_vars("largest")
    drawn = side_by_side.difference(Comparison.from_atlases(one, one))
    assert (texts(drawn), labels(drawn)) == (["another regime"], ["same regime", "pending"])


def test_a_comparison_of_sweeps_is_drawn_otherwise() -> None:
    sweep = pictures.line()
    with pytest.raises(InputError, match="sweeps: atlas plot --against"):
        side_by_side.difference(Comparison.from_atlases(sweep, sweep))


def test_maps_side_by_side_are_named_by_the_parameter_that_differs(folder: Path) -> None:
    first, *others = (atlas.open(folder / f"{name}.zarr") for name in "abc")
    drawn = first.atlas.plot_side_by_side(*others)
    assert texts(drawn)[:3] == ["$R = 0.8$", "$R = 0.7$", "$R = 0.6$"]
    assert "R =" not in drawn.get_suptitle()
    assert len(drawn.axes) == 4  # with one scale for all


def test_size_and_scale_have_the_same_names_for_several_atlases(folder: Path) -> None:
    one, other = (atlas.open(folder / f"{name}.zarr") for name in "ab")
    drawn = (
        one.atlas.plot_side_by_side(other, width="85mm", vmin=-1, vmax=2),
        one.atlas.compare(other).plot(width="85mm"),
    )
    assert [figure.get_size_inches()[0] for figure in drawn] == pytest.approx([85 / 25.4] * 2)
    assert drawn[0].axes[-1].get_xlim() == (-1.0, 2.0)  # below the maps of a narrow page


def test_maps_side_by_side_have_the_one_scale_of_all_their_cells() -> None:
    one = pictures.plane()
    wide = one.assign(largest=one.largest * 10)
    drawn = render.figure([one, wide])
    cells = np.concatenate([ds.largest.where(ds.regime <= C).values.ravel() for ds in (one, wide)])
    assert drawn.axes[-1].get_ylim() == pytest.approx(scale_ends(cells))
    colors = [np.asarray(ax.images[0].get_array())[3, 1].tolist() for ax in drawn.axes[:2]]
    assert colors[0] != colors[1]


def test_periods_side_by_side_share_one_legend() -> None:
    one = pictures.plane()
    drawn = render.figure([one, one.isel(omega=slice(0, 3))], "period")
    assert len(labels(drawn)) == len(set(labels(drawn)))
    assert drawn.axes[0].get_xlim() == drawn.axes[1].get_xlim()


@pytest.mark.parametrize(("count", "shape"), [(2, (1, 2)), (3, (1, 3)), (4, (2, 2)), (5, (2, 3)), (7, (3, 3))])
def test_maps_are_laid_out_in_rows_of_three_at_most(count: int, shape: tuple[int, int]) -> None:
    drawn = render.figure([pictures.plane()] * count, "period")
    grid = drawn.axes[0].get_subplotspec().get_gridspec()
    assert (len(drawn.axes), (grid.nrows, grid.ncols)) == (count, shape)


def test_the_command_draws_several_stores_named_where_nothing_differs(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.svg"
    stores = [folder / "a.zarr", folder / "b.zarr", folder / "c.zarr"]
    assert call("plot", *stores, "-o", out, "--kind", "period").exit_code == 0
    assert out.read_text().startswith("<?xml")


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("--kind", "impacts"), "kind 'impacts' is drawn of one atlas; side by side: exponent, period"),
        (("--overlay", "boundaries"), "--overlay takes one STORE, found 2"),
        (("--against", "c.zarr"), "--against takes one STORE, found 2"),
    ],
)
def test_what_cannot_be_drawn_side_by_side_is_refused_in_one_line(
    folder: Path, tmp_path: Path, args: tuple[str, ...], message: str
) -> None:
    shown = call("plot", folder / "a.zarr", folder / "b.zarr", "-o", tmp_path / "a.png", *args)
    assert (shown.exit_code, shown.stdout) == (2, "")
    assert shown.stderr.splitlines()[-1] == f"Error: {message}"
    assert list(tmp_path.iterdir()) == []
