"""Claims about basins: labels that depend on nothing but the initial state, mirror images, measures of boundaries."""

import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner
from distributed import Client

import atlas
from atlas import render
from atlas.check.verify import verify
from atlas.cli.main import main
from atlas.errors import InputError, RunError
from atlas.query.basins import basin_entropy, table, uncertainty_exponent
from atlas.store.groups import drop_group
from atlas.store.object_backend import LocalBackend
from atlas.store.store import open_store
from atlas.store.tile_records import RunTileRecords, TileRecords, complete_records
from atlas.store.tiles import read_tile, write_tile
from atlas.task import label_basins
from atlas.task.label_basins import complete_basins
from atlas.task.store_ref import StoreRef
from atlas.task.tile_job import LABELS, DerivedReport, RunJob, execute_job
from tests.simulators.test_oracle import FIG3
from workers import Settings, solve_tile
from workers.attractors.basins import solve_basins
from workers.attractors.initial_states import AttractorSettings
from workers.results import BEYOND_TABLE, NO_IMPACT, PERIODIC

PLANE = {"x1": np.linspace(-0.09, 0.09, 7)[None, :], "v1": np.linspace(-1.0, 1.0, 9)[:, None]}
SECOND = {"x2": 0.03, "v2": -0.2}
"""The plane of the initial states of mass 1 through the one that reaches period 3."""


def spec_of(tile: list[int], starts: int = 16, **changes: object) -> atlas.Spec:
    axes = {"x1": {"start": -0.09, "stop": 0.09, "num": 7}, "v1": {"start": -1.0, "stop": 1.0, "num": 9}}
    parameters = {"omega": 4.0, "b": 0.1, **SECOND}
    given = {"axes": axes, "parameters": parameters, "attractors": {"starts": starts}, "store": {"tile": tile}}
    return atlas.Spec("two-mass", **(given | changes))


@pytest.fixture(scope="module")
def solved(solved_once: Callable[[atlas.Spec], Path]) -> Path:
    return solved_once(spec_of([4, 3]))


def test_the_initial_state_that_reaches_period_3_lies_in_its_basin() -> None:
    found = solve_basins("two-mass", {**FIG3, **SECOND, "x1": 0.05, "v1": 0.5}, None, AttractorSettings(16))
    assert (found["label"], found["period"]) == (1, 3)


def test_every_initial_state_has_the_results_of_the_attractor_that_it_reaches_alone() -> None:
    found = solve_basins("two-mass", FIG3 | SECOND | PLANE, None, AttractorSettings(16))
    alone = solve_tile("two-mass", FIG3 | SECOND | PLANE)
    assert set(np.unique(found["label"])) >= {0, 1}
    assert np.array_equal(found["period"], alone["period"]) and np.array_equal(found["regime"], alone["regime"])
    assert found["largest"] == pytest.approx(alone["largest"], abs=1e-9)


def test_basins_are_mirrored_where_the_force_is() -> None:
    """Truth: x -> -x, force -> -force takes motions to motions: half a period later the force has the other sign."""
    other = {**FIG3, "tau": FIG3["tau"] + math.pi, "x2": -0.03, "v2": 0.2}
    turned = {name: -values for name, values in PLANE.items()}
    one = solve_basins("two-mass", FIG3 | SECOND | PLANE, None, AttractorSettings(16))
    mirrored = solve_basins("two-mass", other | turned, None, AttractorSettings(16))
    assert np.array_equal(one["period"], mirrored["period"])
    assert np.abs(one["settled"] - mirrored["settled"]).max() <= 1


def test_without_impact_the_basin_is_where_no_impact_follows() -> None:
    """Truth: solved alone, with a gap that is wide enough for many initial states to stay between the stops."""
    params = {**FIG3, "b": 0.5, "x1": 0.1, "v1": np.linspace(-6.0, 6.0, 13)}
    found, alone = solve_basins("two-mass", params, None, AttractorSettings(16)), solve_tile("two-mass", params)
    assert {NO_IMPACT, PERIODIC} == set(np.unique(found["regime"]))
    assert np.array_equal(found["regime"], alone["regime"])
    assert len(np.unique(found["label"])) == len(np.unique(alone["regime"]))


def test_basins_are_of_one_machine() -> None:
    with pytest.raises(ValueError, match=r"omega: found 3 to 4, must be one value: a basin is of one machine"):
        solve_basins("two-mass", {"omega": np.array([3.0, 4.0])})


@pytest.mark.slow
@pytest.mark.parametrize("starts", [1, 16])
def test_labels_and_the_table_have_the_same_bits_for_any_tiles(tmp_path: Path, client: Client, starts: int) -> None:
    """With one initial state in the reference set most attractors are found by the tiles, and labelled last."""
    stores = [tmp_path / f"{k}.zarr" for k in range(3)]
    for path, tile in zip(stores, ([2, 7], [9, 2], [5, 4]), strict=True):
        atlas.run(spec_of(tile, starts), path, client=client)
    one, *others = (xr.open_zarr(path).load() for path in stores)
    tables = [xr.open_zarr(path, group="attractors").load() for path in stores]
    assert int(one["label"].min()) >= 0 and int(one["label"].max()) >= 1
    for other in others:
        assert all(one[name].values.tobytes() == other[name].values.tobytes() for name in one.data_vars)
    for other in tables[1:]:
        assert all(tables[0][name].values.tobytes() == other[name].values.tobytes() for name in tables[0].data_vars)


@pytest.mark.slow
def test_several_worker_processes_give_the_bits_of_one(tmp_path: Path) -> None:
    """With one initial state in the reference set each process meets, in tiles of its own, what the table has not."""
    stores = [tmp_path / "one.zarr", tmp_path / "two.zarr"]
    for path, workers, tile in zip(stores, (1, 2), ([9, 7], [2, 3]), strict=True):
        atlas.run(spec_of(tile, starts=1), path, options=atlas.RunOptions(workers))
    for group in (None, "attractors"):
        one, two = (xr.open_zarr(path, group=group).load() for path in stores)
        assert all(one[name].values.tobytes() == two[name].values.tobytes() for name in one.data_vars)


@pytest.mark.slow
def test_labels_given_last_are_those_of_a_larger_reference_set_by_period(tmp_path: Path, client: Client) -> None:
    periods = []
    for starts in (1, 16):
        path = tmp_path / f"{starts}.zarr"
        atlas.run(spec_of([4, 4], starts), path, client=client)
        ds, known = xr.open_zarr(path), xr.open_zarr(path, group="attractors")
        assert np.array_equal(known["period"].values[ds["label"].values], ds["period"].values)
        periods.append(ds["period"].values)
    assert np.array_equal(*periods)


def test_a_store_of_basins_is_sound_to_the_bit(solved: Path) -> None:
    report = atlas.verify(solved, sample=3, seed=1)
    assert report.is_sound and report.comparison == "bits"


def test_nothing_is_labelled_after_the_claim_of_the_store_is_lost(solved: Path, tmp_path: Path) -> None:
    def lost() -> None:
        raise RunError("another run has this store")

    store = Path(shutil.copytree(solved, tmp_path / "basins.zarr"))
    shutil.rmtree(store / "attractors")
    handle = open_store(store)
    before = {path: path.read_bytes() for path in store.rglob("*") if path.is_file()}
    with pytest.raises(RunError, match="another run has this store"):
        complete_basins(handle.with_backend(handle.backend.with_lease(lost)))
    assert {path: path.read_bytes() for path in store.rglob("*") if path.is_file()} == before


def test_what_an_attempt_to_label_wrote_before_it_died_is_recorded_by_the_next(
    solved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Path(shutil.copytree(solved, tmp_path / "basins.zarr"))
    handle = open_store(store)
    beyond = read_tile(handle, (0, 0))
    beyond["label"][...] = BEYOND_TABLE
    write_tile(handle, (0, 0), beyond)
    drop_group(handle, "attractors")
    shutil.rmtree(store / "attractors")
    run = RunTileRecords(handle, TileRecords(handle))
    run.clear_table()
    job = RunJob((), StoreRef(str(store), handle.run_id, handle.solver_version), level=LABELS)

    def dies(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(label_basins, "write_table", dies)
        with pytest.raises(KeyboardInterrupt):
            execute_job(job)
    made = execute_job(job)
    assert isinstance(made, DerivedReport)
    for index, record in made.records:
        run.add(index, record)
    run.finish()
    assert verify(store, sample=0).is_sound


def test_a_kill_between_a_tiles_last_labels_and_its_record_leaves_no_wrong_record(
    solved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Path(shutil.copytree(solved, tmp_path / "basins.zarr"))
    handle = open_store(store)
    known = read_tile(handle, (0, 0))
    write_tile(handle, (0, 0), known | {"label": np.full_like(known["label"], BEYOND_TABLE)})
    drop_group(handle, "attractors")
    shutil.rmtree(store / "attractors")
    whole = LocalBackend.put

    def put(place: LocalBackend, key: str, data: bytes) -> None:
        whole(place, key, data)
        if key == "label/c/0/0":
            raise KeyboardInterrupt

    RunTileRecords(handle, TileRecords(handle)).clear_table()  # what a run does before it has the tiles labelled
    with monkeypatch.context() as patch:
        patch.setattr(LocalBackend, "put", put)
        with pytest.raises(KeyboardInterrupt):
            complete_basins(handle)
    (fault,) = verify(store, sample=0).faults
    assert str(fault).startswith("tiles/records: the records of ")
    complete_basins(open_store(store))
    complete_records(open_store(store))
    np.testing.assert_array_equal(read_tile(handle, (0, 0))["label"], known["label"])
    assert verify(store, sample=3, seed=1).is_sound


def test_the_table_has_shares_mirror_images_and_section_points(solved: Path) -> None:
    known, ds = table(atlas.open(solved)), xr.open_zarr(solved)
    labels = ds["label"].values
    assert known["share"].values == pytest.approx([(labels == k).mean() for k in range(known.sizes["attractor"])])
    orbit = known.isel(attractor=0)
    points = orbit["points"].values[: int(orbit["period"])]
    assert np.abs(points - orbit["state"].values).max(axis=1).min() < 1e-12
    assert np.isnan(orbit["points"].values[int(orbit["period"]) :]).all()
    assert int(known["mirror"][0]) == 0


def test_a_plane_of_initial_states_says_how_mixed_it_is(solved: Path) -> None:
    found = atlas.open(solved).atlas.basin_measures()
    assert float(found["share"].sum() + found["unknown"]) == pytest.approx(1.0)
    assert 0.0 < found["entropy"] <= math.log(found.sizes["label"])
    assert found["regime"].values[0] == "periodic"


def test_the_command_computes_draws_and_asks(solved: Path, tmp_path: Path) -> None:
    asked = CliRunner().invoke(main, ["attractors", "basins", str(solved), "--json"])
    assert json.loads(asked.stdout)["starts"] == 63
    assert "share_low" in CliRunner().invoke(main, ["attractors", "basins", str(solved)]).stdout
    drawn = CliRunner().invoke(main, ["plot", str(solved), "-o", str(tmp_path / "basins.png")])
    assert drawn.exit_code == 0, drawn.output


def test_labels_of_branches_are_refused_where_labels_are_those_of_basins(solved: Path) -> None:
    with pytest.raises(InputError, match="not labelled; label them with atlas attractors label"):
        render.figure(atlas.open(solved), "labels")


def test_what_is_no_atlas_of_basins_has_none(solved_plane: Path) -> None:
    with pytest.raises(InputError, match="not an atlas of basins"):
        atlas.open(solved_plane).atlas.basin_measures()
    with pytest.raises(InputError, match="both axes must be initial states, and the spec must have"):
        render.figure(atlas.open(solved_plane), "basins")


def test_settings_of_the_solver_reach_basins() -> None:
    found = solve_basins("two-mass", FIG3 | {"x1": 0.01}, Settings(exponents="none"), AttractorSettings(2))
    assert "largest" not in found and found["label"] == 0


# What is measured of boundaries: planes whose answers are known


def test_a_plane_of_one_basin_has_no_entropy_and_no_boundary() -> None:
    labels = np.zeros((40, 40), dtype=np.int64)
    assert basin_entropy(labels, labels == 0) == ((0.0, 0.0), (0.0, 0.0))
    assert uncertainty_exponent(labels, labels == 0)[2] == "no initial state is uncertain"


def test_two_basins_mixed_at_random_have_an_entropy_near_log_2_and_no_power_law() -> None:
    labels = np.random.default_rng(1).integers(0, 2, (400, 400))
    (mean, error), (boundary, _) = basin_entropy(labels, labels >= 0)
    expected = _entropy_of_draws(25)
    assert abs(mean - expected) < 4.0 * error and boundary == pytest.approx(mean)
    alpha, error, reason = uncertainty_exponent(labels, labels >= 0)
    assert math.isnan(alpha) and math.isnan(error)
    assert reason.startswith("93.") and "are uncertain at distance 1" in reason


def _entropy_of_draws(n: int) -> float:
    """The mean entropy of n fair draws of two labels."""
    total = 0.0
    for k in range(1, n):
        p = k / n
        total -= math.comb(n, k) / 2.0**n * (p * math.log(p) + (1 - p) * math.log(1 - p))
    return total


@pytest.mark.parametrize("shape", ["line", "circle"])
def test_a_smooth_boundary_has_dimension_1(shape: str) -> None:
    y, x = np.mgrid[0:300, 0:300]
    inside = x + 0.37 * y > 210.3 if shape == "line" else (x - 150) ** 2 + (y - 140) ** 2 < 90.2**2
    alpha, error, reason = uncertainty_exponent(inside.astype(np.int64), np.ones(inside.shape, dtype=bool))
    assert alpha == pytest.approx(1.0, abs=0.05)
    assert error < 0.05 and not reason


def stripes(levels: int, finest: int = 0) -> np.ndarray:
    """A line of 3^levels states, labels that alternate in the gaps of the middle-third set down to a width."""
    labels = np.zeros(3**levels, dtype=np.int64)
    for level in range(1, levels + 1 - finest):
        width = 3 ** (levels - level)
        for k in range(2 ** (level - 1)):
            start = sum(2 * 3 ** (levels - 1 - i) for i in range(level - 1) if (k >> i) & 1)
            labels[start + width : start + 2 * width] = 1 + level % 2
    return labels


def test_a_cantor_set_of_stripes_has_its_dimension() -> None:
    """Truth: log 2 / log 3, the boundary of stripes that alternate in the gaps of the middle-third set."""
    labels = stripes(9)
    alpha, error, _ = uncertainty_exponent(labels, labels >= 0)
    assert 1.0 - alpha == pytest.approx(math.log(2) / math.log(3), abs=0.1)  # the finest are one state wide
    assert error > 0.015  # the shares' binomial errors alone make 0.008: they go up by steps


def test_distances_at_which_labels_are_mixed_are_no_part_of_the_power_law() -> None:
    """Truth: squares of 32 states with labels at random have smooth sides, and at 16 states most labels are mixed."""
    coarse = np.random.default_rng(2).integers(0, 2, (40, 40)).repeat(32, axis=0).repeat(32, axis=1)
    alpha, error, _ = uncertainty_exponent(coarse, coarse >= 0)
    assert alpha == pytest.approx(1.0, abs=0.1) and error < 0.1


def test_unsolved_initial_states_are_left_out_of_what_is_measured() -> None:
    labels = np.zeros((30, 30), dtype=np.int64)
    labels[:, 15:] = 7
    assert basin_entropy(labels, labels == 0)[0] == (0.0, 0.0)
    assert uncertainty_exponent(labels, labels == 0)[2] == "no initial state is uncertain"


def test_every_initial_state_observes_the_motion_that_it_reaches() -> None:
    """The same values wherever a label is, those of a cell that starts on the attractor."""
    settings = Settings(observe="impact_speed:stop", observe_values=4, max_periods=2000, survival=0)
    found = solve_basins("two-mass", FIG3 | SECOND | {"x1": np.array([0.0, 0.05])}, settings, AttractorSettings(4))
    assert np.all(found["label"] >= 0)
    for at in range(2):
        state = dict(zip(("x1", "x2", "v1", "v2"), found["state"][at].tolist(), strict=True))
        alone = solve_tile("two-mass", FIG3 | state, settings)
        assert found["impact_speed_stop_number"][at] == alone["impact_speed_stop_number"] > 0
        np.testing.assert_allclose(
            np.sort(found["impact_speed_stop"][at]), np.sort(alone["impact_speed_stop"]), rtol=1e-9
        )
