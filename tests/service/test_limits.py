"""Every public function with its smallest and its largest legal arguments, and with what lies just beyond."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from distributed import Client

import atlas
import workers
from atlas.errors import InputError
from atlas.service.plan import make_plan
from atlas.service.probe import with_time
from atlas.spec.axis import MAX_POINTS
from tests import naive
from workers import Settings
from workers.history import MAX_TRACE_PERIODS
from workers.results import CHAOTIC, FAILED, PERIODIC, empty_results, result_variables
from workers.settings import MAX_ORBIT_PERIOD, MAX_PERIODS, MAX_SAMPLES
from workers.sweep import solve_lines

pytestmark = pytest.mark.slow

ORBIT, CHAOS = naive.FIGURES[3], naive.FIGURES[5]
EXPONENTS = ("none", "largest", "spectrum")
BRIEF: dict[str, Any] = {"method": "fixed", "transient_periods": 0, "periods": 1}
SMALLEST: list[dict[str, Any]] = [
    {"max_periods": 1},
    {"max_period": 1, "max_periods": 500},
    {"tolerance": 5e-324, "max_periods": 3000},
    {"tolerance": 1e-200, "max_periods": 3000},
    {"section_samples": 1, "max_periods": 500},
    BRIEF,
    BRIEF | {"max_period": 1, "max_periods": 1},
]
LARGEST: list[dict[str, Any]] = [
    {"max_period": MAX_ORBIT_PERIOD, "max_periods": 500},
    {"tolerance": 1.7e308},
    {"section_samples": 5000, "max_periods": 500},
    BRIEF | {"max_period": MAX_ORBIT_PERIOD},
]


@pytest.mark.parametrize("exponents", EXPONENTS)
@pytest.mark.parametrize("given", SMALLEST + LARGEST, ids=str)
def test_cells_are_solved_at_the_ends_of_every_setting(given: dict[str, Any], exponents: str) -> None:
    settings = Settings(exponents=exponents, **given)
    cells = {name: np.array([ORBIT[name], CHAOS[name], naive.STICKING[name]]) for name in ORBIT}
    found = workers.solve_tile("two-mass", cells, settings)
    assert set(found) == {variable.name for variable in result_variables(settings)}
    assert not (found["regime"] == FAILED).any()


def test_a_tolerance_of_next_to_nothing_takes_a_chaotic_cell_to_the_end_of_its_budget() -> None:
    found = workers.solve_tile("two-mass", CHAOS, Settings(tolerance=1e-200, max_periods=3000))
    assert (found["regime"], found["periods_used"] >= 2700) == (CHAOTIC, True)


def test_the_longest_schedules_and_budgets_fit_their_counter() -> None:
    """A schedule, and the search for its orbit within max_periods."""
    assert np.iinfo(np.int32).max > 3 * MAX_PERIODS
    Settings(max_periods=MAX_PERIODS, transient_periods=MAX_PERIODS, periods=MAX_PERIODS)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("max_periods", 0), ("max_periods", MAX_PERIODS + 1), ("transient_periods", -1),
        ("transient_periods", MAX_PERIODS + 1), ("periods", 0), ("periods", MAX_PERIODS + 1), ("max_period", 0),
        ("max_period", MAX_ORBIT_PERIOD + 1), ("section_samples", -1), ("section_samples", MAX_SAMPLES + 1),
        ("tolerance", 0.0), ("tolerance", -1.0), ("tolerance", np.inf), ("tolerance", np.nan), ("tolerance", 10**400),
    ],
)  # fmt: skip
def test_a_setting_beyond_its_limits_is_refused_in_one_line(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"^{name}: found ") as refused:
        Settings(**{name: value})  # type: ignore[arg-type]
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("shape", [(0,), (0, 3), (3, 0), (1,), (1, 1), ()], ids=str)
def test_results_have_the_shape_of_no_cell_and_of_one(shape: tuple[int, ...]) -> None:
    settings = Settings(exponents="spectrum", max_periods=100, section_samples=2)
    given = {"omega": np.full(shape, 3.0)}
    expected = empty_results(result_variables(settings), shape, {"exponent": 4, "state": 4, "sample": 2})
    kinds = [workers.solve_tile("two-mass", given, settings)]
    if shape:
        kinds += [solve_lines("two-mass", given, settings, backward=back) for back in (False, True)]
    for found in kinds:
        assert {name: (array.shape, array.dtype) for name, array in found.items()} == {
            name: (array.shape, array.dtype) for name, array in expected.items()
        }


@pytest.mark.parametrize("exponents", EXPONENTS)
@pytest.mark.parametrize("periods", [0, 1])
def test_a_history_may_have_no_period_or_one(periods: int, exponents: str) -> None:
    history = workers.trace("two-mass", CHAOS, periods, Settings(exponents=exponents))
    vectors = {"none": 0, "largest": 1, "spectrum": 4}[exponents]
    assert (history.times.shape, history.states.shape) == ((periods + 1,), (periods + 1, 4))
    assert history.exponents.shape == (periods, vectors)
    assert history.impacts.shape[1] == 3
    assert periods or not history.impacts.size


@pytest.mark.parametrize("periods", [-1, MAX_TRACE_PERIODS + 1, 10**12, 1.5, True, None])
def test_a_history_of_another_length_is_refused_in_one_line(periods: Any) -> None:
    with pytest.raises(ValueError, match=f"^periods: found .*, must be a whole number, 0 to {MAX_TRACE_PERIODS}$"):
        workers.trace("two-mass", CHAOS, periods)


@pytest.mark.parametrize(
    "axes",
    [{"omega": [3.0]}, {"omega": [3.0], "b": [0.2]}, {"omega": {"values": [3.0], "continuation": "forward"}}],
    ids=["a point", "a plane of one cell", "a sweep of one cell"],
)
def test_an_atlas_may_have_a_single_cell(axes: dict[str, Any], tmp_path: Path, client: Client) -> None:
    spec = atlas.Spec("two-mass", axes=axes, solve={"section_samples": 1})
    store = tmp_path / "one.zarr"
    quiet = atlas.RunOptions(on_progress=with_time(lambda progress: None))  # a single cell is not probed
    assert atlas.run(spec, store, client=client, options=quiet).cells_solved == 1
    assert atlas.verify(store).is_sound
    with atlas.open(store) as ds:
        assert ds.regime.values.ravel().tolist() == [PERIODIC]
        assert ds.atlas.fractions().to_dict() == {"periodic": 1.0}
        ds.atlas.plot().savefig(tmp_path / "one.png")
    assert (tmp_path / "one.png").stat().st_size > 0


def test_an_atlas_of_one_cell_can_grow(tmp_path: Path, client: Client) -> None:
    small = atlas.Spec("two-mass", axes={"omega": [3.0], "b": [0.2]})
    atlas.run(small, tmp_path / "one.zarr", client=client)
    wider = atlas.Spec("two-mass", axes={"omega": [3.0, 3.5], "b": [0.2]})
    done = atlas.extend(tmp_path / "one.zarr", tmp_path / "two.zarr", wider, client=client)
    assert done.cells_solved == 1


@pytest.mark.parametrize("count", [0, MAX_POINTS + 1, 10**12])
def test_an_axis_of_too_few_or_too_many_points_is_refused(count: int) -> None:
    with pytest.raises(InputError, match=f"axes.omega.num: found {count} points, must be 1 to {MAX_POINTS}"):
        atlas.Spec("two-mass", axes={"omega": {"start": 2.0, "stop": 4.0, "num": count}})


def test_a_tile_whose_sections_no_codec_takes_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    """2^31 bytes are one too many: 64 x 32 cells, 2^15 samples of four numbers of eight bytes."""
    axes = {"omega": {"start": 2.0, "stop": 4.0, "num": 64}, "b": {"start": 0.1, "stop": 0.5, "num": 64}}
    solve = {"section_samples": 2**15}
    with pytest.raises(
        InputError, match=r"^store.tile: found 64 x 32, in which a chunk of section has 2147483648 bytes, "
    ):
        atlas.run(atlas.Spec("two-mass", axes, solve=solve, store={"tile": [64, 32]}), tmp_path / "out.zarr")
    assert not list(tmp_path.iterdir())
    make_plan(atlas.Spec("two-mass", axes, solve=solve, store={"tile": [63, 32]}), workers=1)


def test_an_axis_may_have_the_most_points() -> None:
    spec = atlas.Spec("two-mass", axes={"omega": {"start": 2.0, "stop": 4.0, "num": MAX_POINTS}})
    assert spec.shape == (MAX_POINTS,)


@pytest.mark.parametrize("settings", [Settings(max_periods=1), Settings(**BRIEF)], ids=["adaptive", "fixed"])
def test_a_portrait_may_have_the_least_of_a_motion(settings: Settings, tmp_path: Path) -> None:
    atlas.portrait(ORBIT, settings=settings, path=tmp_path / "cell.png")
    assert (tmp_path / "cell.png").stat().st_size > 0
