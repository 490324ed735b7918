"""Claims about atlases of all attractors: their specs, what a store holds, and what is asked of it and drawn."""

import json
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
from atlas.check.overviews import check_overviews
from atlas.check.rules import broken_rules
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.overview.builder import OverviewBuilder
from atlas.query.attractors import select_dominant
from atlas.query.cell import read_cell_spec
from atlas.query.queries import nearest_cell
from atlas.store.store import open_store
from atlas.store.tiles import drop_tile, read_tile
from workers import Settings, solve_tile
from workers.attractors.coexistence import solve_attractors
from workers.attractors.initial_states import AttractorSettings
from workers.results import CHAOTIC, FAILED, PENDING

AXES = {"omega": {"start": 3.6, "stop": 4.4, "num": 3}, "R": {"start": 0.7, "stop": 0.9, "num": 4}}
SOLVE = {"max_periods": 2000, "survival": 2000, "tolerance": 0.1, "section_samples": 3}
STARTS = {"starts": 8, "seed": 2, "keep": 3}


def spec_of(**changes: object) -> atlas.Spec:
    given = {"axes": AXES, "parameters": {"b": 0.1}, "solve": SOLVE, "attractors": STARTS, "store": {"tile": [2, 2]}}
    return atlas.Spec("two-mass", **(given | changes))


@pytest.fixture(scope="module")
def solved(solved_once: Callable[[atlas.Spec], Path]) -> Path:
    return solved_once(spec_of())


def test_the_table_is_kept_in_the_resolved_spec_exactly() -> None:
    table = {"starts": 12, "seed": 5, "box": {"v1": [-0.5, 1], "x1": [-0.1, 0.1]}, "keep": 2}
    spec = spec_of(attractors=table, store=None)
    assert atlas.Spec.from_resolved(json.loads(json.dumps(spec.to_resolved()))) == spec
    assert spec.attractors == AttractorSettings(12, 5, (("x1", -0.1, 0.1), ("v1", -0.5, 1.0)), 2)


def test_the_table_enters_the_digest_and_its_absence_changes_none() -> None:
    without = spec_of(attractors=None)
    assert "attractors" not in without.to_resolved()
    assert len({spec_of().digest, without.digest, spec_of(attractors=STARTS | {"seed": 3}).digest}) == 3


def test_specs_that_differ_in_their_initial_states_are_told_apart(tmp_path: Path) -> None:
    handle = Path(shutil.copytree(_empty(tmp_path), tmp_path / "b.zarr"))
    with pytest.raises(InputError, match="starts = 8 in the store, 16 in the spec"):
        atlas.run(spec_of(attractors=STARTS | {"starts": 16}), handle)


def _empty(tmp_path: Path) -> Path:
    from atlas.store.create import create_store

    return create_store(tmp_path / "a.zarr", spec_of(), (2, 2)).path


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"start": 3}, "unknown key in attractors 'start'; did you mean 'starts'"),
        ({"starts": 0}, "attractors.starts: found 0, must be a whole number, 1 to 10000"),
        ({"keep": 1.5}, "attractors.keep: found 1.5"),
        ({"box": {"y": [0, 1]}}, "unknown component in attractors.box 'y'"),
        ({"box": {"x1": [1, 0]}}, "attractors.box.x1: found 1 to 0, must rise"),
        ({"box": {"x1": 3}}, "attractors.box.x1: found 3, must be two numbers"),
        ({"box": 3}, "attractors.box: found 3, must be a table"),
        (3, "attractors: found 3, must be a table"),
        ({"starts": 10000}, None),
    ],
)
def test_a_wrong_table_is_refused_in_one_line(table: object, says: str | None) -> None:
    if says is None:
        spec_of(attractors=table)
        return
    with pytest.raises(InputError, match=says):
        spec_of(attractors=table)


def test_the_cost_of_a_cell_has_to_fit_its_variable() -> None:
    with pytest.raises(InputError, match=r"attractors.starts: found 10000, of at most 1000000 periods each"):
        spec_of(attractors={"starts": 10000}, solve={"max_periods": 500_000, "survival": 500_000})


def test_the_fixed_schedule_and_continuation_are_refused() -> None:
    with pytest.raises(InputError, match='attractors: need method = "adaptive"'):
        spec_of(solve={"method": "fixed"})
    with pytest.raises(InputError, match="attractors: an axis with continuation"):
        spec_of(axes={"omega": AXES["omega"] | {"continuation": "forward"}}, store=None)


def test_plain_xarray_finds_every_result_along_the_attractors(solved: Path) -> None:
    ds = xr.open_zarr(solved)
    for name in ("regime", "period", "largest", "share", "share_error", "symmetric", "reason"):
        assert ds[name].dims == ("R", "omega", "attractor"), name
    assert ds["state"].dims == ("R", "omega", "attractor", "component")
    assert ds["section"].dims == ("R", "omega", "attractor", "sample", "component")
    assert ds["attractors"].dims == ds["periods_used"].dims == ("R", "omega")
    assert ds.sizes["attractor"] == 3


def test_the_store_holds_what_solve_attractors_gives(solved: Path) -> None:
    ds, spec = xr.open_zarr(solved), spec_of()
    params = spec.cell_params((slice(0, 4), slice(0, 3)))
    for name, values in solve_attractors("two-mass", params, Settings(**SOLVE), AttractorSettings(8, 2, (), 3)).items():
        assert ds[name].values.tobytes() == values.tobytes(), name


def test_shares_fall_and_add_up_with_what_is_left_and_undecided(solved: Path) -> None:
    ds = xr.open_zarr(solved)
    share = np.nan_to_num(ds["share"].values)
    assert np.all(np.diff(share, axis=-1) <= 0)
    rest = (ds["starts_unstored"] + ds["undecided"]).values / ds["starts"].values
    assert share.sum(axis=-1) + rest == pytest.approx(np.ones((4, 3)))
    assert int(ds["attractors"].max()) >= 2


def test_a_store_of_all_attractors_is_sound_to_the_bit(solved: Path) -> None:
    report = atlas.verify(solved, sample=3, seed=1)
    assert report.is_sound and report.comparison == "bits" and report.cells_solved == 3


def test_a_run_that_was_stopped_is_completed_to_the_same_bits(solved: Path, tmp_path: Path, client: Client) -> None:
    path = Path(shutil.copytree(solved, tmp_path / "out.zarr"))
    handle = open_store(path)
    before = read_tile(handle, (1, 1))
    drop_tile(handle, (1, 1))
    assert (xr.open_zarr(path)["regime"].values[2:, 2:] == PENDING).all()
    summary = atlas.run(spec_of(), path, client=client)
    assert summary.tiles == 4
    assert all(values.tobytes() == before[name].tobytes() for name, values in read_tile(handle, (1, 1)).items())


def test_arrays_do_not_depend_on_the_tile_shape(solved: Path, tmp_path: Path, client: Client) -> None:
    atlas.run(spec_of(store={"tile": [4, 1]}), tmp_path / "other.zarr", client=client)
    one, other = xr.open_zarr(solved), xr.open_zarr(tmp_path / "other.zarr")
    assert all(one[name].values.tobytes() == other[name].values.tobytes() for name in one.data_vars)


def test_cells_of_a_tile_that_ends_its_process_are_failed_in_the_first_place(solved: Path) -> None:
    """What marks them writes into the results of the first attractor, which are those of the tile itself."""
    handle = open_store(solved)
    arrays = read_tile(handle, (0, 0))
    handle.dominant_arrays(arrays)["regime"][...] = FAILED
    assert (arrays["regime"][..., 0] == FAILED).all() and (arrays["regime"][..., 1] != FAILED).all()


def test_overviews_are_of_the_attractor_with_the_largest_share(solved: Path, tmp_path: Path) -> None:
    handle = open_store(shutil.copytree(solved, tmp_path / "out.zarr"))
    made = OverviewBuilder(handle, side=2, minimum=2)
    assert made.finish() > 0
    assert not check_overviews(handle, set(), lambda _level: None)[1]
    coarse = xr.open_zarr(handle.path, group="overviews/1", chunks=None)
    assert coarse["share"].dims == ("R_coarse", "omega_coarse")
    largest = xr.open_zarr(handle.path)["share"].values[:2, :2, 0]
    assert coarse["share"].values[0, 0] == pytest.approx(largest.mean())


def test_what_a_store_may_not_hold_is_found(solved: Path) -> None:
    handle = open_store(solved)
    tile = handle.tiling.at((0, 0))

    def broken(**changes: np.ndarray) -> str:
        return "; ".join(broken_rules(handle.spec, tile.slices, read_tile(handle, (0, 0)) | changes))

    arrays = read_tile(handle, (0, 0))
    assert broken() == ""
    assert "do not add up" in broken(share=arrays["share"] * 0.5)
    assert "shares are not descending" in broken(share=arrays["share"][..., ::-1])
    assert "own_attractor is not one of the attractors" in broken(own_attractor=arrays["own_attractor"] + 9)
    assert "has a regime but does not exist" in broken(attractors=np.ones_like(arrays["attractors"]))
    regime = np.where(arrays["regime"] == PENDING, PENDING, CHAOTIC).astype(np.int8)
    assert "attractor 0: chaotic, but largest is not positive" in broken(regime=regime)


def test_a_query_at_a_point_lists_all_attractors(solved: Path) -> None:
    ds = atlas.open(solved)
    found = nearest_cell(ds, {"omega": 4.0, "R": 0.7})
    assert len(found["coexisting"]) == found["attractors"]
    first = found["coexisting"][0]
    assert (first["regime"], first["share"]) == (found["regime"], found["share"])
    assert len(first["state"]) == 4
    assert found["distance"] == {"omega": 0.0, "R": 0.0}
    together = ds.atlas.at(omega=[4.0], R=[0.7])["share"]
    assert together.dims == ("point", "attractor") and together.values[0, 0] == first["share"]


def test_other_questions_are_of_the_attractor_with_the_largest_share(solved: Path) -> None:
    ds = atlas.open(solved)
    assert ds.atlas.fractions().to_dict() == select_dominant(ds).atlas.fractions().to_dict()
    assert sum(ds.atlas.fractions().to_dict().values()) == pytest.approx(1.0)
    assert sum(ds.isel(attractor=1).atlas.fractions().to_dict().values()) == pytest.approx(1.0)
    assert ds.atlas.extremes("share")["value"][0] > 0.0


def test_the_command_lists_attractors_at_a_point_and_picks_one_by_its_place(solved: Path, tmp_path: Path) -> None:
    asked = CliRunner().invoke(main, ["query", str(solved), "--at", "omega=4", "--at", "R=0.7", "--json"])
    assert len(json.loads(asked.stdout)["coexisting"]) >= 1
    shown = CliRunner().invoke(main, ["query", str(solved), "--at", "omega=4", "--at", "R=0.7"])
    assert "share_low" in shown.stdout and shown.exit_code == 0
    picture = str(tmp_path / "second.png")
    drawn = CliRunner().invoke(main, ["plot", str(solved), "--select", "attractor=1", "-o", picture])
    assert drawn.exit_code == 0, drawn.output
    wrong = CliRunner().invoke(main, ["plot", str(solved), "--select", "attractor=3", "-o", picture])
    assert wrong.exit_code == 2 and "attractor: found 3, must be a whole number, 0 to 2" in wrong.output


@pytest.mark.parametrize("asked", ["attractors", "exponent", "period", ("share",), ("periods_used",)])
def test_every_map_is_drawn_of_all_attractors(solved: Path, tmp_path: Path, asked: str | tuple[str]) -> None:
    look = {"kind": asked} if isinstance(asked, str) else {"variable": asked[0]}
    assert render.render(atlas.open(solved), tmp_path / "map.png", **look).exists()


def test_a_sweep_of_all_attractors_is_drawn_with_their_shares(tmp_path: Path, client: Client) -> None:
    path = tmp_path / "sweep.zarr"
    atlas.run(spec_of(axes={"omega": AXES["omega"]}, store=None), path, client=client)
    figure = render.figure(atlas.open(path))
    assert [ax.get_ylabel().split("\n")[0] for ax in figure.axes] == ["displacement of mass 1", "share of the"]


def test_a_plain_atlas_has_no_second_attractor(solved_plane: Path) -> None:
    with pytest.raises(InputError, match="needs all attractors, and this atlas has one per cell"):
        render.figure(atlas.open(solved_plane).isel(b=0), "coexistence")


def test_cells_are_exported_with_a_column_for_each_attractor(solved: Path, tmp_path: Path) -> None:
    asked = CliRunner().invoke(main, ["export", str(solved), "-o", str(tmp_path / "cells.csv")])
    assert asked.exit_code == 0, asked.output
    handle, *rows = (tmp_path / "cells.csv").read_text().splitlines()
    assert {"omega", "R", "attractors", "period_1", "period_3", "state_2_x1"} <= set(handle.split(","))
    assert len(rows) == 12


def test_what_cannot_be_done_with_all_attractors_is_refused_in_one_line(solved: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="an atlas of all attractors cannot be extended"):
        atlas.extend(solved, tmp_path / "more.zarr", refine=2)
    with pytest.raises(InputError, match="an atlas of all attractors cannot be retried"):
        atlas.retry(solved, tmp_path / "again.zarr", "undetermined", 10**5)


def test_a_packed_store_reads_as_the_store_does(solved: Path, tmp_path: Path) -> None:
    atlas.pack(solved, tmp_path / "out.zip")
    one, other = atlas.open(solved), atlas.open(tmp_path / "out.zip")
    assert one["share"].values.tobytes() == other["share"].values.tobytes()


def test_all_attractors_of_one_cell_are_those_of_an_atlas_of_it(solved: Path) -> None:
    """Truth: the same cell of the store, whose initial states are fewer of the same box, and which keeps three."""
    cell = nearest_cell(atlas.open(solved), {"omega": 4.0, "R": 0.8})
    settings = Settings(max_periods=2000, survival=2000, tolerance=0.1)
    found = atlas.attractors({"omega": cell["omega"], "R": cell["R"], "b": 0.1}, settings=settings, starts=16)
    assert found["attractors"] == len(found["coexisting"]) == cell["attractors"] > 1
    assert sum(row["share"] for row in found["coexisting"]) + found["undecided"] / found["starts"] == pytest.approx(1)
    patterns = [
        {(row["regime"], row["period"], row["impacts_upper"], row["impacts_lower"]) for row in of["coexisting"]}
        for of in (found, cell)
    ]
    assert patterns[0] >= patterns[1]
    assert found["search"]["starts"] == 16


def test_the_command_lists_all_attractors_of_one_cell() -> None:
    """At b = 0.6 the motion from rest has no impact; all that is printed is in the JSON too."""
    line = ["point", "--set", "omega=4", "--set", "b=0.6", "--attractors", "--starts", "4", "--max-periods", "500"]
    found = json.loads(CliRunner().invoke(main, [*line, "--json"]).stdout)
    assert [(row["regime"], row["share"]) for row in found["coexisting"]] == [("no_impact", 1.0)]
    shown = CliRunner().invoke(main, line)
    assert "share_low" in shown.stdout and "unseen_share" in shown.stdout
    refused = CliRunner().invoke(main, ["point", "--starts", "4"])
    assert (refused.exit_code, "--starts needs --attractors" in refused.output) == (2, True)


def test_a_cell_without_motion_lists_no_attractor_and_says_why() -> None:
    found = atlas.attractors({"x1": 5.0}, starts=1)
    assert (found["coexisting"], found["regime"]) == ([], "invalid")
    assert found["reason"] == "the initial state lies beyond a stop"


@pytest.mark.parametrize("place", [0, 1])
def test_a_cell_is_solved_again_on_the_attractor_selected(solved: Path, place: int) -> None:
    """Truth: the stored pattern of that attractor, where another one has another pattern."""
    ds = atlas.open(solved).load()
    names = ["regime", "period", "impacts_upper", "impacts_lower"]
    pattern = np.stack([ds[name].values for name in names], axis=-1)
    differs = (pattern[:, :, 0] != pattern[:, :, 1]).any(axis=-1) & np.isin(pattern[:, :, :2, 0], [0, 1]).all(axis=-1)
    i, j = np.argwhere(differs)[0]
    cell = read_cell_spec(ds.isel(attractor=place), {"R": float(ds.R[i]), "omega": float(ds.omega[j])})
    again = solve_tile(cell.system, cell.parameters, cell.settings)
    assert [again[name].item() for name in names] == pattern[i, j, place].tolist()
