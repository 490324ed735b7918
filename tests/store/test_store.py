import json
import os
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import zarr

import atlas
from atlas.errors import ChunkError, InputError, RunError
from atlas.store import create, groups, store
from atlas.store.backend import LocalBackend
from atlas.store.tiles import read_tile
from atlas.task.store_ref import StoreRef
from atlas.task.tile_job import RunJob, run_tile_job
from tests.planes import find, plane_of
from tests.synthetic import complete, set_attribute, spec_of
from workers.results import REGIMES, result_variables


@pytest.fixture
def handle(tmp_path: Path, plane: atlas.Spec) -> store.AtlasStore:
    return create.create_store(tmp_path / "out.zarr", plane, (2, 3))


def solve(handle: store.AtlasStore, index: tuple[int, ...]) -> None:
    run_tile_job(RunJob(index, StoreRef(str(handle.path), handle.run_id, handle.solver_version)))


def test_a_new_store_holds_every_variable_and_no_result(handle: store.AtlasStore, plane: atlas.Spec) -> None:
    ds = xr.open_zarr(handle.path)
    assert set(ds.data_vars) == {variable.name for variable in result_variables(plane.settings)}
    assert (ds.regime.values == -1).all()
    assert store.done_tiles(handle) == set()


def test_plain_xarray_opens_a_half_done_store_without_a_warning(handle: store.AtlasStore) -> None:
    solve(handle, (0, 1))
    ds = xr.open_zarr(handle.path)  # warnings are errors here
    done = ds.regime.values >= 0
    assert done[0:2, 3:6].all()
    assert done.sum() == 6
    assert np.isnan(ds.state.values[~done]).all()


def test_fixed_parameters_are_scalar_coordinates(handle: store.AtlasStore) -> None:
    ds = xr.open_zarr(handle.path)
    assert ds.R.item() == 0.8
    assert {"R", "mu_k", "x1"} <= set(ds.regime.coords)
    assert ds.indexes["omega"].size == 7


def test_atlases_concatenate_along_a_fixed_parameter(tmp_path: Path) -> None:
    parts = []
    for R in (0.5, 0.8):
        handle = create.create_store(tmp_path / f"{R}.zarr", plane_of(R=R), (5, 7))
        parts.append(xr.open_zarr(handle.path))
    whole = xr.concat(parts, dim="R", data_vars="all", coords="different", compat="equals", join="exact")
    assert whole.regime.dims == ("R", "b", "omega")
    assert whole.R.values.tolist() == [0.5, 0.8]


def test_components_of_the_state_are_named(handle: store.AtlasStore) -> None:
    assert xr.open_zarr(handle.path).component.values.tolist() == ["x1", "x2", "v1", "v2"]


def test_regime_has_cf_flags_and_no_fill_value_attribute(handle: store.AtlasStore) -> None:
    regime = xr.open_zarr(handle.path).regime
    assert regime.attrs["flag_values"] == [entry.code for entry in REGIMES]
    assert regime.attrs["flag_meanings"].split()[0] == "pending"
    assert len(regime.attrs["flag_colors"].split()) == len(REGIMES)
    assert "_FillValue" not in regime.attrs
    assert zarr.open_group(handle.path, mode="r")["regime"].fill_value == -1


def test_one_tile_is_one_chunk_of_every_array(handle: store.AtlasStore) -> None:
    ds = xr.open_zarr(handle.path)
    assert {ds[name].encoding["chunks"][:2] for name in ds.data_vars} == {(2, 3)}


def test_an_atlas_exports_to_netcdf_attributes(handle: store.AtlasStore) -> None:
    attrs = xr.open_zarr(handle.path).attrs
    assert all(isinstance(value, str | int) for value in attrs.values())
    assert json.loads(attrs["spec"])["system"] == "two-mass"


def test_the_store_keeps_the_spec_exactly(handle: store.AtlasStore, plane: atlas.Spec) -> None:
    assert handle.spec.digest == plane.digest == handle.digest


def test_a_tile_is_done_when_its_regime_chunk_exists(handle: store.AtlasStore) -> None:
    solve(handle, (1, 2))
    assert store.done_tiles(handle) == {(1, 2)}
    (handle.path / "regime" / "c" / "1" / "2").unlink()
    assert store.done_tiles(handle) == set()


def test_leftovers_of_a_killed_write_are_no_tile(handle: store.AtlasStore) -> None:
    solve(handle, (1, 2))
    (handle.path / "regime" / "c" / "1" / "0.4fbe.partial").write_bytes(b"half")
    assert store.done_tiles(handle) == {(1, 2)}


def test_a_finished_tile_has_a_chunk_in_every_array_but_of_reasons_that_it_has_none_of(
    handle: store.AtlasStore, plane: atlas.Spec
) -> None:
    solve(handle, (0, 0))
    for variable in result_variables(plane.settings):
        tail = ["0"] * len(variable.extra_dims)
        exists = (handle.path.joinpath(variable.name, "c", "0", "0", *tail)).exists()
        assert exists != (variable.name == "reason")


def test_regime_is_written_last(handle: store.AtlasStore, monkeypatch: pytest.MonkeyPatch) -> None:
    order = []
    whole = zarr.Array.__setitem__
    monkeypatch.setattr(
        zarr.Array, "__setitem__", lambda a, key, value: (order.append(a.basename), whole(a, key, value))
    )
    solve(handle, (0, 0))
    assert order[-1] == "regime"
    assert len(order) == len(set(order)) > 10


def test_writing_a_tile_twice_changes_no_byte(handle: store.AtlasStore) -> None:
    solve(handle, (0, 0))
    before = {path: path.read_bytes() for path in handle.path.rglob("*") if path.is_file()}
    solve(handle, (0, 0))
    assert {path: path.read_bytes() for path in handle.path.rglob("*") if path.is_file()} == before


def test_a_torn_chunk_is_noticed_when_it_is_read(handle: store.AtlasStore) -> None:
    solve(handle, (0, 0))
    chunk = handle.path / "state" / "c" / "0" / "0" / "0"
    data = bytearray(chunk.read_bytes())
    data[len(data) // 2] ^= 1
    chunk.write_bytes(data)
    with pytest.raises(ValueError, match=r"[Cc]hecksum"):
        _ = xr.open_zarr(handle.path).state.values


def test_a_worker_with_another_store_at_the_path_fails_loudly(handle: store.AtlasStore) -> None:
    with pytest.raises(RunError, match="check that the path is the same on every host"):
        run_tile_job(RunJob((0, 0), StoreRef(str(handle.path), "another run", handle.solver_version)))


def test_a_worker_with_another_solver_version_fails_loudly(handle: store.AtlasStore) -> None:
    with pytest.raises(RunError, match="this worker has solver version"):
        run_tile_job(RunJob((0, 0), StoreRef(str(handle.path), handle.run_id, handle.solver_version + 1)))


def test_a_failed_creation_leaves_nothing(tmp_path: Path, plane: atlas.Spec, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.rename", full)
    with pytest.raises(InputError, match="cannot be written: No space left on device"):
        create.create_store(tmp_path / "out.zarr", plane, (2, 3))
    assert list(tmp_path.iterdir()) == []


def test_nothing_yet_is_no_store(tmp_path: Path, plane: atlas.Spec) -> None:
    (tmp_path / "empty").mkdir()
    assert find(tmp_path / "new.zarr", plane) is None
    assert find(tmp_path / "empty", plane) is None
    assert [path.name for path in tmp_path.iterdir()] == ["empty"]


def test_the_same_spec_may_go_on(handle: store.AtlasStore) -> None:
    assert find(handle.path, plane_of(tile=(5, 5))) == handle


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (plane_of(R=0.5), "R = 0.8 in the store, 0.5 in the spec"),
        (
            atlas.Spec(
                "two-mass",
                axes={"b": {"start": 0.1, "stop": 0.5, "num": 5}, "omega": {"start": 2.0, "stop": 4.0, "num": 7}},
                solve=plane_of().settings,
            ),
            r"axis order differs: \(omega, b\) in the store, \(b, omega\) in the spec",
        ),
        (atlas.Spec("two-mass", axes={"tau": [0.0]}), r"axes differ: .* max_periods = 500 in the store"),
        (
            atlas.Spec("two-mass", axes={"omega": [2.0, 3.0], "b": [0.1]}, solve=plane_of().settings),
            r"axis omega 2..4 \(7 values\) in the store, omega 2..3 \(2 values\) in the spec; axis b",
        ),
    ],
    ids=["parameter", "transposed", "axes and settings", "values"],
)
def test_another_spec_is_refused_by_every_difference(handle: store.AtlasStore, other: atlas.Spec, message: str) -> None:
    with pytest.raises(InputError, match=message):
        find(handle.path, other)


def test_another_solver_version_is_refused(handle: store.AtlasStore, plane: atlas.Spec) -> None:
    older = handle.solver_version - 1
    set_attribute(handle.path, "solver_version", older)
    with pytest.raises(InputError, match=f"computed by solver version {older}, installed is {handle.solver_version}"):
        find(handle.path, plane)


def test_an_unknown_format_version_is_refused(handle: store.AtlasStore) -> None:
    set_attribute(handle.path, "format_version", 99)
    with pytest.raises(InputError, match="format version 99, this program reads version 3"):
        atlas.open(handle.path)


def test_what_is_not_ours_is_refused(tmp_path: Path, plane: atlas.Spec) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "thesis.tex").write_text("mine")
    (tmp_path / "file").write_text("mine")
    zarr.create_group(tmp_path / "foreign.zarr")
    zarr.create_array(tmp_path / "array.zarr", shape=(2,), dtype="f8")
    for name in ("folder", "file", "foreign.zarr", "array.zarr"):
        with pytest.raises(InputError, match=f"{name}: not an atlas"):
            find(tmp_path / name, plane)


def test_opening_what_does_not_exist_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such store"):
        atlas.open(tmp_path / "none.zarr")


def test_open_reads_nothing_before_it_is_used(handle: store.AtlasStore) -> None:
    solve(handle, (0, 0))
    ds = atlas.open(handle.path)
    os.remove(handle.path / "state" / "c" / "0" / "0" / "0")
    with pytest.raises(ChunkError, match="state/c/0/0/0 is missing"):
        ds.state.load()


def test_reading_variables_of_a_tile_reads_no_metadata(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    handle = complete(tmp_path / "out.zarr", spec=spec_of(8, 8))
    asked, get = list[str](), LocalBackend.get
    monkeypatch.setattr(LocalBackend, "get", lambda place, key, *part: asked.append(key) or get(place, key, *part))
    names = ["largest", "period", "sticks", "regime"]
    assert read_tile(handle, (0, 0), names).keys() == {*names}
    assert len(asked) == len(names)
    assert not [key for key in asked if key.endswith("zarr.json")]


def test_a_table_that_no_chunk_can_hold_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tables are stored in one chunk, of which the codecs accept 2 GiB."""
    axes = {"omega": [2.0, 3.0, 4.0], "b": [0.1, 0.2]}
    spec = atlas.Spec("two-mass", axes, attractors={"starts": 4, "keep": 3})
    handle = create.create_store(tmp_path / "out.zarr", spec, (2, 3))
    monkeypatch.setattr(groups, "LARGEST_CHUNK", 71)
    with pytest.raises(InputError, match=r"out.zarr: label needs 72 bytes in one chunk, must be at most 71"):
        atlas.label_attractors(handle.path)
    with pytest.raises(InputError, match=r"out.zarr: return_time needs 144 bytes in one chunk, must be at most 71"):
        atlas.measure_attractors(handle.path)
