"""Claims about connected windows of one class, and about where a variable has its extremes."""

import json
from collections import deque
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import atlas
from atlas.errors import InputError
from atlas.query.connected_regions import labels, regions
from atlas.query.extremes import extremes
from atlas.query.read_counter import count_chunk_reads
from atlas.store import create, store
from atlas.store.tile_records import complete_records
from atlas.store.tiles import write_tile
from tests.interface.test_cli import call
from tests.query.test_query import plane, spec
from tests.synthetic import complete, results, spec_of
from workers.results import CHAOTIC, NO_IMPACT, PENDING, PERIODIC, UNDETERMINED

P, C, N, Q = PERIODIC, CHAOTIC, NO_IMPACT, PENDING


def periods(rows: list[list[int]], omega: list[float] | None = None, **attrs: str) -> xr.Dataset:
    """A plane of periodic cells with these periods, chaotic where it is 0."""
    period = np.array(rows, np.int32)
    omega = omega or [float(k) for k in range(1, period.shape[1] + 1)]
    ds = plane(omega, [0.1 * k for k in range(1, period.shape[0] + 1)], np.where(period > 0, P, C), **attrs)
    return ds.assign(period=(("b", "omega"), period))


def naive_labels(values: np.ndarray) -> np.ndarray:
    """Connected sets by flooding each from its first cell."""
    found = np.zeros(values.shape, int)
    count = 0
    for start in np.ndindex(values.shape):
        if found[start]:
            continue
        count += 1
        queue = deque([start])
        found[start] = count
        while queue:
            y, x = queue.popleft()
            for at in ((y + 1, x), (y - 1, x), (y, x + 1), (y, x - 1)):
                inside = 0 <= at[0] < values.shape[0] and 0 <= at[1] < values.shape[1]
                if inside and not found[at] and values[at] == values[y, x]:
                    found[at] = count
                    queue.append(at)
    return found


# Windows


def test_a_window_has_its_cells_area_share_centre_and_box() -> None:
    ds = periods([[0, 0, 0, 0], [0, 3, 3, 0], [0, 0, 0, 0]])
    (found,) = regions(ds, "period", 3)
    assert (found["label"], found["period"], found["cells"], found["cut"]) == (1, 3, 2, [])
    assert found["area"] == pytest.approx(2 * 1.0 * 0.1)
    assert found["share"] == pytest.approx(2 / 12)
    assert found["centre"] == pytest.approx({"omega": 2.5, "b": 0.2})
    assert found["box"]["omega"] == pytest.approx((1.5, 3.5))
    assert found["box"]["b"] == pytest.approx((0.15, 0.25))


def test_cells_that_share_a_corner_only_are_two_regions() -> None:
    assert [region["cells"] for region in regions(periods([[3, 0], [0, 3]]), "period", 3)] == [1, 1]


def test_neighbours_of_different_periods_are_two_regions() -> None:
    assert [region["period"] for region in regions(periods([[2, 2, 3]]), "period")] == [2, 3]


def test_regions_of_all_regimes_are_those_of_a_flood() -> None:
    codes = np.random.default_rng(1).choice([P, C, N], (23, 31))
    found = labels(plane(list(range(1, 32)), list(range(1, 24)), codes)).values
    naive = naive_labels(codes)
    assert found.min() > 0
    pairs = {*zip(found.ravel().tolist(), naive.ravel().tolist(), strict=True)}
    assert len(pairs) == found.max() == naive.max()


def test_areas_of_all_regions_add_up_to_the_plane_and_their_cells_to_its_cells() -> None:
    codes = np.random.default_rng(2).choice([P, C], (9, 7))
    found = regions(plane([1, 2, 4, 8, 16, 32, 64], list(range(1, 10)), codes))
    assert sum(region["share"] for region in found) == pytest.approx(1.0)
    assert sum(region["cells"] for region in found) == 63


def test_regions_come_by_falling_area_and_not_by_cells() -> None:
    # Edges of 1, 2, 4, 8 are 0.5, 1.5, 3, 6, 10.
    found = regions(periods([[2, 2, 0, 3]], [1, 2, 4, 8], spec=spec(omega="linear", b="linear")), "period")
    assert [(region["period"], region["cells"]) for region in found] == [(3, 1), (2, 2)]


def test_areas_on_a_log_axis_are_in_its_own_unit() -> None:
    # Edges of 1, 4, 16 are 0.5, 2, 8, 32.
    found = regions(periods([[0, 2, 0]], [1, 4, 16]).isel(b=0), "period", 2)
    assert (found[0]["area"], found[0]["box"]) == (pytest.approx(6.0), {"omega": pytest.approx((2.0, 8.0))})


def test_a_window_at_an_edge_is_cut_by_it() -> None:
    (found,) = regions(periods([[0, 3, 3], [0, 0, 0]]), "period", 3)
    assert found["cut"] == ["highest omega", "lowest b"]


def test_a_window_at_the_edge_of_the_part_that_was_asked_for_is_cut_by_it() -> None:
    ds = periods([[0] * 5, [0, 3, 3, 3, 0], [0] * 5])
    (found,) = regions(ds, "period", 3, {"omega": (1, 3)})
    assert (found["cells"], found["cut"], found["share"]) == (2, ["highest omega"], pytest.approx(2 / 9))


def test_a_window_next_to_pending_cells_may_go_on_there() -> None:
    ds = plane([1, 2, 3], [0.1, 0.2, 0.3], [[C, C, C], [C, P, Q], [C, C, C]])
    found = {region["regime"]: region["cut"] for region in regions(ds)}
    assert found["periodic"] == ["pending cells"]
    assert set(found) == {"periodic", "chaotic"}


def test_the_cell_of_a_bent_window_lies_in_it_though_its_centre_does_not() -> None:
    ds = periods([[3, 3, 3], [3, 0, 3], [3, 0, 3]])
    (found,) = regions(ds, "period", 3)
    cell = ds.sel(found["cell"], method="nearest")
    assert int(ds.sel(found["centre"], method="nearest").period) == 0
    assert int(cell.period) == 3


def test_a_falling_axis_changes_no_window() -> None:
    ds = periods([[0, 3, 3, 2], [0, 0, 3, 2]])
    turned = ds.isel(omega=slice(None, None, -1))
    assert regions(turned, "period") == regions(ds, "period")
    xr.testing.assert_equal(labels(turned, "period").sortby("omega"), labels(ds, "period"))


def test_labels_are_those_of_the_list() -> None:
    ds = periods([[0, 3, 3, 2], [0, 0, 0, 2]])
    listed, marked = regions(ds, "period"), labels(ds, "period")
    assert [int((marked == region["label"]).sum()) for region in listed] == [region["cells"] for region in listed]


def test_small_regions_are_left_out_where_asked() -> None:
    ds = periods([[3, 0, 3, 3]])
    assert [region["cells"] for region in regions(ds, "period", min_cells=2)] == [2]
    assert labels(ds, "period", min_cells=2).values.tolist() == [[0, 0, 1, 1]]


def test_regions_of_impacts_are_named_n_p_q_and_all_that_stick_are_one_class() -> None:
    ds = periods([[1, 1, 2, 2]]).assign(
        impacts_upper=(("b", "omega"), [[1, 2, -1, -1]]), impacts_lower=(("b", "omega"), [[1, 1, -1, -1]])
    )
    ds["period"][0, 3] = 3
    assert {region["impacts"]: region["cells"] for region in regions(ds, "impacts")} == {
        "1-1-1": 1,
        "1-2-1": 1,
        "sticks": 2,
    }
    assert [region["impacts"] for region in regions(ds, "impacts", "1-2-1")] == ["1-2-1"]


def test_a_sweep_has_regions_too() -> None:
    found = regions(periods([[2, 2, 0, 2]]).isel(b=0), "period")
    assert [(region["cells"], region["cut"]) for region in found] == [(2, ["lowest omega"]), (1, ["highest omega"])]


@pytest.mark.parametrize(
    ("by", "value", "message"),
    [
        ("colour", None, "unknown class of cells 'colour'"),
        ("regime", "chaos", "unknown regime 'chaos'; did you mean 'chaotic'"),
        ("regime", "pending", "unknown regime 'pending'"),
        ("period", 0, "period: found 0, must be a whole number, 1 or more"),
        ("period", 2.5, "period: found 2.5, must be a whole number"),
        ("impacts", "3-2", "this atlas has no variable 'impacts_upper'"),
    ],
)
def test_a_class_that_cannot_be_is_answered_with_one_line(by: str, value: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        regions(periods([[3]]), by, value)


# What is read


@pytest.fixture(scope="module")
def handle(tmp_path_factory: pytest.TempPathFactory) -> store.AtlasStore:
    return complete(tmp_path_factory.mktemp("regions") / "a.zarr", (8, 8), spec_of(nx=40, ny=32))


@pytest.mark.parametrize("by", ["regime", "period", "impacts"])
def test_regions_of_a_store_are_those_of_its_cells(handle: store.AtlasStore, by: str) -> None:
    ds = atlas.open(handle.path)
    part = {"omega": (1.5, 3.2), "b": (0.15, 0.42)}
    assert regions(ds, by, window=part) == regions(ds.load(), by, window=part)
    assert regions(ds, by)


def test_regions_in_a_part_read_the_tiles_of_that_part_alone(handle: store.AtlasStore) -> None:
    ds = atlas.open(handle.path)
    part = {"omega": (float(ds.omega[0]), float(ds.omega[15])), "b": (float(ds.b[0]), float(ds.b[7]))}
    with count_chunk_reads() as reads:
        regions(ds, "period", window=part)
    assert reads.chunks == 2 * 2  # of two tiles, the regimes and the periods


def recorded(path: Path) -> store.AtlasStore:
    """Three tiles in a row: all chaotic, all periodic, mixed; and one that is pending."""
    handle = create.create_store(path, spec_of(nx=32, ny=8), (8, 8))
    for column, code in enumerate((CHAOTIC, PERIODIC, None)):
        made = results(handle, (0, column))
        if code is not None:
            made["regime"][...] = code
        made["period"] = np.where(made["regime"] == PERIODIC, 2, 0).astype(np.int32)
        write_tile(handle, (0, column), made)
    complete_records(handle)
    return handle


def test_tiles_that_records_say_enough_of_are_not_read(tmp_path: Path) -> None:
    ds = atlas.open(recorded(tmp_path / "a.zarr").path)
    with count_chunk_reads() as reads:
        regions(ds, "regime")
    assert reads.chunks == 1  # the regimes of the mixed tile
    with count_chunk_reads() as reads:
        regions(ds, "period", 2)
    assert reads.chunks == 1 + 2  # nothing of the chaotic tile, periods of the periodic one, both of the mixed
    with count_chunk_reads() as reads:
        extremes(ds, "periods_used", "regime")
    assert reads.chunks == 1 + 3


def test_regions_by_records_are_those_of_the_cells(tmp_path: Path) -> None:
    ds = atlas.open(recorded(tmp_path / "a.zarr").path)
    assert regions(ds, "regime") == regions(ds.copy(deep=True).load(), "regime")
    assert any("pending cells" in region["cut"] for region in regions(ds, "regime"))


# Extremes


def test_extremes_of_a_regime_name_the_cell_its_value_and_its_error() -> None:
    ds = plane([1, 2], [0.1, 0.2], [[P, C], [C, P]]).assign(error=(("b", "omega"), [[0.1, 0.2], [0.3, 0.4]]))
    assert extremes(ds, "largest") == [
        {"regime": "periodic", "extreme": "smallest", "omega": 1.0, "b": 0.1, "value": 0.0, "error": 0.1, "cells": 2},
        {"regime": "periodic", "extreme": "largest", "omega": 2.0, "b": 0.2, "value": 3.0, "error": 0.4, "cells": 2},
        {"regime": "chaotic", "extreme": "smallest", "omega": 2.0, "b": 0.1, "value": 1.0, "error": 0.2, "cells": 2},
        {"regime": "chaotic", "extreme": "largest", "omega": 1.0, "b": 0.2, "value": 2.0, "error": 0.3, "cells": 2},
    ]


def test_extremes_of_the_plane_are_those_of_all_cells_with_a_class() -> None:
    ds = plane([1, 2], [0.1, 0.2], [[UNDETERMINED, P], [C, Q]])
    assert [(extreme["value"], extreme["cells"]) for extreme in extremes(ds, "largest", "all")] == [(1.0, 2), (2.0, 2)]


def test_an_infinite_exponent_is_no_extreme() -> None:
    ds = plane([1, 2], [0.1], [[P, P]])
    ds["largest"][0, 0] = -np.inf
    assert [extreme["value"] for extreme in extremes(ds, "largest")] == [1.0, 1.0]


def test_impacts_that_are_infinitely_many_are_no_smallest_number() -> None:
    ds = periods([[1, 1, 1]]).assign(impacts_upper=(("b", "omega"), [[-1, 2, 5]]))
    assert [extreme["value"] for extreme in extremes(ds, "impacts_upper", "all")] == [2, 5]


def test_extremes_for_each_period_come_by_period() -> None:
    found = extremes(periods([[3, 1, 3, 1]]), "largest", "period")
    assert [(region["period"], region["value"]) for region in found] == [(1, 1.0), (1, 3.0), (3, 0.0), (3, 2.0)]


@pytest.mark.parametrize("name", ["largest", "periods_used"])
@pytest.mark.parametrize("by", ["all", "regime", "period", "impacts"])
def test_extremes_of_a_store_are_those_of_its_cells(handle: store.AtlasStore, name: str, by: str) -> None:
    ds, part = atlas.open(handle.path), {"omega": (1.5, 3.2)}
    found = extremes(ds, name, by, part)
    whole = ds.load()
    np.testing.assert_equal(found, extremes(whole, name, by, part))
    for region in found:
        cell = whole.sel({axis: region[axis] for axis in ("omega", "b")})
        assert float(cell[name]) == region["value"]


def test_of_equal_values_the_first_cell_counts(handle: store.AtlasStore) -> None:
    ds = atlas.open(handle.path)
    found = extremes(ds, "periods_used", "all")[0]
    first = np.argwhere(ds.periods_used.values == ds.periods_used.values.min())[0]
    assert (found["b"], found["omega"]) == (float(ds.b[first[0]]), float(ds.omega[first[1]]))


@pytest.mark.parametrize("name", ["sticks", "regime", "state", "lagrest"])
def test_a_variable_without_an_order_is_refused_and_the_others_named(name: str) -> None:
    with pytest.raises(InputError, match=rf"variable '{name}'.*\blargest\b"):
        extremes(plane([1, 2], [0.1]), name)


# From the shell


def test_the_command_lists_regions_and_says_how_much_was_read(handle: store.AtlasStore) -> None:
    shown = call("find", "regions", handle.path, "period=2")
    assert shown.exit_code == 0
    assert "centre omega" in shown.stdout.splitlines()[0]
    assert shown.stderr.endswith("chunks read from the store\n")


def test_the_command_gives_regions_as_json(handle: store.AtlasStore) -> None:
    message = json.loads(call("find", "regions", handle.path, "period=2", "--min-cells", 3, "--json").stdout)
    assert message["by"] == "period"
    found = regions(atlas.open(handle.path), "period", 2, min_cells=3)
    assert message["regions"] == json.loads(json.dumps(found))


def test_the_command_gives_extremes_as_json(handle: store.AtlasStore) -> None:
    message = json.loads(call("find", "extremes", handle.path, "largest", "--by", "all", "--json").stdout)
    assert (message["variable"], [extreme["extreme"] for extreme in message["extremes"]]) == (
        "largest",
        ["smallest", "largest"],
    )


@pytest.mark.parametrize("question", [("regions", "period"), ("extremes", "largest")])
def test_the_command_writes_a_list_as_csv(handle: store.AtlasStore, tmp_path: Path, question: tuple[str, str]) -> None:
    out = tmp_path / "a.csv"
    message = json.loads(call("find", question[0], handle.path, question[1], "-o", out, "--json").stdout)
    assert message == {"file": str(out), "rows": len(out.read_text().splitlines()) - 1}


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("regions", "omega=1:2"), "--window omega=1:2 limits an axis"),
        (("regions", "period=many"), "period: found 'many', must be a whole number"),
        (("regions", "period", "--min-cells", "0"), "min_cells: found 0, must be a whole number of cells"),
        (("regions", "period", "-o", "a.nc"), "a.nc: the suffix chooses the format, found '.nc'; possible: .csv"),
        (("extremes", "largest", "--by", "place"), "place"),
    ],
)
def test_a_bad_question_is_answered_with_one_line(
    handle: store.AtlasStore, args: tuple[str, ...], message: str
) -> None:
    shown = call("find", args[0], handle.path, *args[1:])
    assert (shown.exit_code, shown.stdout) == (2, "")
    assert message in shown.stderr and len(shown.stderr.splitlines()) == 1


def test_python_gives_regions_and_extremes_as_data_frames(handle: store.AtlasStore) -> None:
    ds = atlas.open(handle.path)
    found, ends = ds.atlas.regions("period"), ds.atlas.extremes("largest", "all")
    assert found["cells"].tolist() == [region["cells"] for region in regions(ds, "period")]
    assert found["centre_omega"].tolist() == [region["centre"]["omega"] for region in regions(ds, "period")]
    assert ends["extreme"].tolist() == ["smallest", "largest"]


def test_a_regime_alone_names_its_regions(handle: store.AtlasStore) -> None:
    ds = atlas.open(handle.path)
    meant = ds.atlas.regions("regime", "chaotic")
    assert len(meant) and ds.atlas.regions("chaotic").equals(meant)
    assert ds.atlas.labels("chaotic").equals(ds.atlas.labels("regime", "chaotic"))
    short, whole = (
        call("find", "regions", handle.path, table, "--json").stdout for table in ("chaotic", "regime=chaotic")
    )
    assert json.loads(short)["regions"] and short == whole


def test_a_class_that_is_none_is_answered_with_the_nearest(handle: store.AtlasStore) -> None:
    shown = call("find", "regions", handle.path, "chaotc")
    assert (shown.exit_code, shown.stderr) == (2, "Error: unknown class of cells 'chaotc'; did you mean 'chaotic'?\n")
