"""Curves as values: what a store's group, CSV and JSON keep of them."""

import csv
import json
import warnings
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from atlas.errors import ChunkError, InputError
from atlas.orbits.curves.export import export
from atlas.orbits.curves.following import FollowedCurve, PlaneEvent
from atlas.orbits.curves.search_result import as_curve
from atlas.orbits.curves.table import CodimTwoPoint, Curve, Curves, read_curves, write_curves
from atlas.spec.spec import Spec
from atlas.store.create import create_store
from atlas.store.store import AtlasStore
from tests.curve_planes import same
from workers.continuation import Condition, Itinerary, Orbit
from workers.continuation.extended_system import UNIT

FOLD = Curve(
    kind="fold",
    period=3,
    impacts_upper=np.array([4, 4, 5]),
    impacts_lower=np.array([2, 2, 2]),
    symmetric=False,
    points=np.array([[0.1, 0.2], [1.0 / 3.0, 0.4], [0.5, 0.7]]),
    unstable=np.array([0, 0, 1]),
    ends=("edge", "cusp"),
    corners=(CodimTwoPoint("graze_fold", 0.2, 0.3, 0), CodimTwoPoint("cusp", 0.5, 0.7, 2)),
)
GRAZE = Curve(
    kind="graze",
    period=1,
    impacts_upper=np.array([1, 1]),
    impacts_lower=np.array([1, 1]),
    symmetric=True,
    points=np.array([[0.3, 0.2], [0.3, 0.3]]),
    unstable=np.array([0, 0]),
    ends=("edge", "edge"),
)
BOTH = Curves(("omega", "b"), (FOLD, GRAZE), {"edges": 2})


@pytest.fixture
def handle(tmp_path: Path) -> AtlasStore:
    axes = {"omega": {"start": 2.0, "stop": 3.0, "num": 3}, "b": {"start": 0.1, "stop": 0.2, "num": 2}}
    return create_store(tmp_path / "store.zarr", Spec("two-mass", axes), (2, 3))


@pytest.mark.parametrize("curves", [BOTH, Curves(("omega", "b"), ())], ids=["two", "none"])
def test_a_store_gives_curves_back_to_the_bit(handle: AtlasStore, curves: Curves) -> None:
    assert read_curves(handle) is None
    write_curves(handle, curves)
    found = read_curves(handle)
    assert found is not None
    assert (found.axes, dict(found.report)) == (curves.axes, dict(curves.report))
    assert len(found) == len(curves)
    assert all(same(one, other) for one, other in zip(found, curves, strict=True))


def test_writing_again_replaces(handle: AtlasStore) -> None:
    write_curves(handle, BOTH)
    write_curves(handle, Curves(("omega", "b"), (GRAZE,)))
    found = read_curves(handle)
    assert found is not None
    assert [curve.kind for curve in found] == ["graze"]


def test_plain_xarray_opens_the_group_and_the_atlas_without_a_warning(handle: AtlasStore) -> None:
    write_curves(handle, BOTH)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert "curves" not in xr.open_zarr(handle.path)
        group = xr.open_zarr(handle.path, group="curves", consolidated=False)
    assert group["kind"].values.tolist() == ["fold", "graze"]
    assert group["position"].sizes == {"point": 5, "axis": 2}


def test_a_group_whose_arrays_were_exchanged_is_refused(handle: AtlasStore) -> None:
    write_curves(handle, BOTH)
    before = (handle.path / "curves" / "zarr.json").read_bytes()
    write_curves(handle, Curves(("omega", "b"), (GRAZE, FOLD), {"edges": 2}))
    (handle.path / "curves" / "zarr.json").write_bytes(before)
    with pytest.raises(ChunkError, match=r"is damaged or belongs to other arrays: atlas find curves .* makes it anew"):
        read_curves(handle)


def test_csv_has_a_row_a_point_and_then_codimension_two_points_as_rows_of_their_kind(tmp_path: Path) -> None:
    export(BOTH, tmp_path / "curves.csv")
    with (tmp_path / "curves.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[:8] == [
        "curve", "kind", "period", "impacts_upper", "impacts_lower", "symmetric", "omega", "b",
    ]  # fmt: skip
    assert [row["kind"] for row in rows] == ["fold", "fold", "fold", "graze", "graze", "graze_fold", "cusp"]
    assert [row["curve"] for row in rows] == ["0"] * 3 + ["1"] * 2 + ["0"] * 2
    assert float(rows[1]["omega"]) == 1.0 / 3.0
    assert [row["impacts_upper"] for row in rows] == ["4", "4", "5", "1", "1", "4", "5"]


def test_json_has_all_there_is(tmp_path: Path) -> None:
    export(BOTH, tmp_path / "curves.json")
    found = json.loads((tmp_path / "curves.json").read_text())
    assert found["axes"] == ["omega", "b"]
    assert found["curves"][0]["points"] == FOLD.points.tolist()
    assert found["curves"][0]["impacts_upper"] == [4, 4, 5]
    assert found["curves"][0]["corners"][1] == FOLD.corners[1]._asdict()


def test_the_label_of_a_curve_names_its_orbits_in_turn() -> None:
    assert (FOLD.label, GRAZE.label) == ("3-4-2, 3-5-2", "1-1-1")


def test_a_table_without_a_curve_is_a_header(tmp_path: Path) -> None:
    export(Curves(("omega", "b"), ()), tmp_path / "curves.csv")
    assert (tmp_path / "curves.csv").read_text().startswith("curve,kind,period")
    assert (tmp_path / "curves.csv").read_text().count("\n") == 1


@pytest.mark.parametrize("name", ["curves.txt", "curves"])
def test_another_suffix_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"possible: \.csv, \.json"):
        export(BOTH, tmp_path / name)
    assert not (tmp_path / name).exists()


@pytest.mark.parametrize(("mirrored", "label"), [(False, "1-0-1"), (True, "1-1-0")])
def test_a_curve_counts_impacts_at_the_stop_where_they_are_unless_the_mirror_image_is_an_orbit_too(
    mirrored: bool, label: str
) -> None:
    orbit = Orbit(Itinerary((-1,), 1), np.array([0.5]), np.array([-2.0]))
    values, none = np.array([[0.8, 0.3], [0.9, 0.4]]), np.zeros(0)
    followed = FollowedCurve(
        event=PlaneEvent("fold", Condition(UNIT), orbit, none, values[0], np.nan), values=values, orbits=[orbit, orbit],
        contact_times=np.zeros((2, 0)), conditions=[Condition(UNIT)] * 2, unstable=np.zeros(2, dtype=np.int64),
        corners=[],
        ends=("edge", "edge"),
    )  # fmt: skip
    assert as_curve(followed, mirrored).label == label
