"""The difference of two planes in view: compared at cells that both know, no others; nothing is solved."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import atlas
from atlas.errors import InputError
from atlas.explore.chosen import beginning
from atlas.explore.difference import Seen, changes, exact, same_points
from atlas.explore.kept import Keeper
from atlas.explore.known import Known
from atlas.explore.lattice import Lattice
from atlas.explore.subject import Subject, exploring, subject_of
from atlas.explore.view import STAGES, TILE, Sight, TileKey
from atlas.render.change import CHANGE, change_of
from atlas.render.screen import screen
from atlas.render.style import rgb
from atlas.render.together import SAME
from atlas.spec.axis import Axis
from workers.results import CHAOTIC, PENDING, PERIODIC, REGIME, UNDETERMINED, empty_results

AXES = {"omega": {"start": 2, "stop": 4, "num": 101}, "b": {"start": 0.1, "stop": 0.5, "num": 81}}
WINDOW = (2.3, 2.9), (0.2, 0.3), (150, 100)


def known_of(axes: Mapping[str, Any] = AXES) -> Known:
    spec = atlas.Spec("two-mass", axes)
    subject = Subject(spec, exploring(spec.settings))
    return Known(subject, Keeper(subject))


def put(known: Known, R: float, keys: Iterable[TileKey], seed: int) -> list[xr.Dataset]:
    """Put tiles of made-up cells into memory, and return them as datasets."""
    rng, made = np.random.default_rng(seed), []
    subject = known.subject
    for key in keys:
        arrays = empty_results(
            subject.system.variables(subject.settings), (TILE, TILE), {"exponent": 4, "state": 4, "sample": 0}
        )
        arrays["largest"][:] = rng.normal(size=(TILE, TILE))
        arrays[REGIME.name][:] = rng.choice([PERIODIC, CHAOTIC, UNDETERMINED], (TILE, TILE))
        arrays["period"][:] = np.where(arrays[REGIME.name] == PERIODIC, rng.integers(1, 4, (TILE, TILE)), 0)
        known.tiles.put(subject.plane.moved("R", R), key, arrays)
        coords = {
            "b": subject.y.values(key.level_y, key.rows.index),
            "omega": subject.x.values(key.level_x, key.columns.index),
        }
        names = ("largest", "regime", "period")
        made.append(xr.Dataset({name: (("b", "omega"), arrays[name]) for name in names}, coords))
    return made


def naive(tiles: list[xr.Dataset], known: Known, sight: Sight) -> xr.Dataset:
    """Cells at the parameters of a view, found by their coordinates in tiles of which later ones go over earlier."""
    omega, b = known.subject.points(*sight)
    found = xr.Dataset(coords={"b": b, "omega": omega})
    for name in ("largest", "regime", "period"):
        values = xr.DataArray(np.full((b.size, omega.size), np.nan), {"b": b, "omega": omega}, ("b", "omega"))
        for tile in tiles:
            values = (
                tile[name]
                .astype(float)
                .reindex(b=b, omega=omega, method="nearest", tolerance=1e-12)
                .combine_first(values)
            )
        found[name] = values
    return found


@pytest.fixture
def planes() -> tuple[Seen, Seen, xr.Dataset, xr.Dataset]:
    """Two planes of which some tiles are known, in full density or coarser, and the same by the naive twin."""
    known = known_of()
    sight = known.subject.sight(*WINDOW)
    coarse, fine = sight.tiles(2), sight.tiles(0)
    here = put(known, 0.7, [*coarse, *fine[::2]], 1)
    there = put(known, 0.75, [*sight.tiles(1), *fine[: len(fine) // 2]], 2)
    one, other = (Seen(known, known.subject.plane.moved("R", R), sight) for R in (0.7, 0.75))
    return one, other, naive(here, known, sight), naive(there, known, sight)


def test_cells_are_exact_where_they_are_known_at_their_own_parameters_and_pending_elsewhere(
    planes: tuple[Seen, Seen, xr.Dataset, xr.Dataset],
) -> None:
    for seen, twin in (planes[0], planes[2]), (planes[1], planes[3]):
        found = exact(seen, ["largest", "regime"])
        assert 0 < np.isnan(twin.regime.values).mean() < 1
        assert np.array_equal(found["largest"], twin["largest"].values, equal_nan=True)
        assert np.array_equal(found["regime"], twin["regime"].fillna(PENDING).values)


def determined(regime: xr.DataArray) -> xr.DataArray:
    return regime.isin([PERIODIC, CHAOTIC])


def test_the_difference_of_exponents_is_that_of_the_naive_twin_at_cells_that_both_know(
    planes: tuple[Seen, Seen, xr.Dataset, xr.Dataset],
) -> None:
    here, there, one, other = planes
    made, says = changes(here, there, replace(beginning(here.known.subject), kind="exponent"))
    both = determined(one.regime) & determined(other.regime)
    expected = (other.largest - one.largest).where(both)
    assert bool(both.any()) and not bool(both.all())
    assert np.array_equal(made[CHANGE].values[both.values], expected.values[both.values])
    assert says.startswith(f"{int(both.sum())} cells: mean difference ")


@pytest.mark.parametrize("kind", ["period", "impacts"])
def test_classes_differ_where_those_of_the_naive_twin_do(
    planes: tuple[Seen, Seen, xr.Dataset, xr.Dataset], kind: str
) -> None:
    here, there, one, other = planes
    made, says = changes(here, there, replace(beginning(here.known.subject), kind=kind))
    both = (determined(one.regime) & determined(other.regime)).values
    differ = ((one.regime != other.regime) | (one.period != other.period)).values
    assert np.array_equal(made[CHANGE].values[both], differ[both])
    assert says.startswith(f"{(differ & both).sum()} of {both.sum()} cells differ, compared where both are known")


def test_a_cell_that_is_not_compared_takes_what_the_nearest_coarser_one_has_and_is_not_counted(
    planes: tuple[Seen, Seen, xr.Dataset, xr.Dataset],
) -> None:
    known, sight = planes[0].known, planes[0].sight
    known.tiles = type(known.tiles)()
    one, other = (Seen(known, known.subject.plane.moved("R", R), sight) for R in (0.7, 0.75))
    for R in (0.7, 0.75):
        put(known, R, sight.tiles(STAGES), 3)
    made, says = changes(one, other, replace(beginning(known.subject), kind="period"))
    shares = (made.regime.values != PENDING).mean(), int(says.split(" of ")[1].split()[0]) / made.regime.size
    assert shares[0] > 0.3 > 0.02 > shares[1] > 0
    assert says.startswith("0 of ")


def test_grids_are_compared_at_their_common_points_alone() -> None:
    halves, thirds = (known_of({"omega": {"start": 2, "stop": 4, "num": num}, "b": AXES["b"]}) for num in (101, 151))
    one, other = (Seen(known, known.subject.plane, known.subject.sight(*WINDOW)) for known in (halves, thirds))
    R = dict(one.plane.parameters)["R"]
    tiles = [put(seen.known, R, seen.sight.tiles(0), seed) for seed, seen in enumerate((one, other))]
    here, there = (naive(each, halves, one.sight) for each in tiles)
    made, says = changes(one, other, replace(beginning(halves.subject), kind="exponent"))
    both = (determined(here.regime) & determined(there.regime)).values
    assert 0.05 < both.mean() < 0.3
    assert np.array_equal(made[CHANGE].values[both], (there.largest - here.largest).values[both])
    assert says.startswith(f"{both.sum()} cells: ")


def test_planes_without_a_common_cell_are_said_to_have_none() -> None:
    one, other = (known_of({"omega": {"start": start, "stop": 4, "num": 101}, "b": AXES["b"]}) for start in (2, 2.003))
    seen = [Seen(known, known.subject.plane, known.subject.sight(*WINDOW)) for known in (one, other)]
    for known, sight in ((each.known, each.sight) for each in seen):
        put(known, dict(known.subject.plane.parameters)["R"], sight.tiles(0), 1)
    made, says = changes(seen[0], seen[1], replace(beginning(one.subject), kind="exponent"))
    assert says == "no cell in view is known in both planes at the same parameters"
    assert np.all(made.regime.values == PENDING) and np.all(np.isnan(made[CHANGE].values))
    assert screen(made, change_of("exponent"), (150, 100), 60).ends is None


def test_points_that_round_differently_are_the_same_and_neighbours_are_not() -> None:
    coarse, fine = np.linspace(0.1, 4.5, 101), 0.1 + 4.4 * (np.arange(201) / 200)
    one, other = same_points(coarse, fine)
    assert np.array_equal(one, np.arange(101)) and np.array_equal(other, 2 * one)
    lattice = Lattice(Axis("omega", tuple(coarse.tolist())))
    deep = lattice.values(lattice.deepest, np.arange(64) + (50 << lattice.deepest))
    assert same_points(deep[:-1], deep[1:])[0].size == 62


def test_a_plane_of_a_store_is_compared_at_its_own_cells_also_where_pixels_are_coarser(finished: Path) -> None:
    subject = subject_of(str(finished))
    known = Known(subject, Keeper(subject))
    (x, y) = (np.array(axis.values) for axis in subject.spec.axes)
    sight = subject.sight((float(x[0]), float(2 * x[-1] - x[0])), (float(y[0]), float(y[-1])), (6, 3))
    assert min(sight.x.level, sight.y.level) < 0
    seen = Seen(known, subject.plane, sight)
    found, (omega, b) = exact(seen, ["largest", "regime"]), seen.points
    cells = atlas.open(finished)[["largest", "regime"]].reindex(b=b, omega=omega)
    assert 2 < int(cells.regime.notnull().sum()) < cells.regime.size
    assert np.array_equal(found["largest"], cells.largest.values, equal_nan=True)
    assert np.array_equal(found["regime"], cells.regime.fillna(PENDING).values)


def test_a_picture_that_one_of_both_cannot_have_is_refused(planes: tuple[Seen, Seen, xr.Dataset, xr.Dataset]) -> None:
    spec = atlas.Spec("two-mass", AXES, solve={"exponents": "none"})
    subject = Subject(spec, exploring(spec.settings))
    other = Seen(Known(subject, Keeper(subject)), subject.plane, planes[0].sight)
    with pytest.raises(InputError, match="two-mass has no variable 'largest' to compare"):
        changes(planes[0], other, replace(beginning(planes[0].known.subject), kind="exponent"))


@pytest.mark.parametrize("kind", ["exponent", "period", "impacts", "symmetry", "combined", "cost", "scalar", "regions"])
def test_every_kind_has_a_picture_of_its_difference(
    planes: tuple[Seen, Seen, xr.Dataset, xr.Dataset], kind: str
) -> None:
    here, there, *_ = planes
    chosen = replace(beginning(here.known.subject), kind=kind, variable="peak_to_peak" if kind == "scalar" else "")
    made, _ = changes(here, there, chosen)
    picture = screen(made, change_of(kind, chosen.variable), (150, 100), 60)
    assert picture.cells.shape == (100, 150, 4)
    if picture.ends is not None:
        assert picture.ends[0] == -picture.ends[1]


def test_a_class_that_differs_has_the_colour_of_the_second_plane_and_others_are_white() -> None:
    known = known_of()
    sight = known.subject.sight(*WINDOW)
    for R, seed in ((0.7, 1), (0.75, 1)):
        put(known, R, sight.tiles(0), seed)
    moved = known.subject.plane.moved("R", 0.75)
    for _, arrays in known.tiles.of(moved):
        arrays["regime"][:] = PERIODIC
        arrays["period"][:] = 2
    one = Seen(known, known.subject.plane.moved("R", 0.7), sight)
    made, _ = changes(one, Seen(known, moved, sight), replace(beginning(known.subject), kind="period"))
    size = made.regime.shape[1], made.regime.shape[0]
    found = {tuple(color) for color in screen(made, change_of("period"), size, 60).cells.reshape(-1, 4).tolist()}
    assert rgb(SAME) in found and rgb("#38ad83") in found
