"""Metadata that are lost, damaged or wrong: named with their fault and the remedy, and written again by a repair.

Truth: the store before the damage, byte for byte, or as xarray reads it.
"""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import atlas
from atlas.check.verify import verify
from atlas.errors import ChunkError, InputError
from atlas.robustness.table import LINEAR, StoredMeasures, empty, of_family, write_measures
from atlas.store.create import create_store
from atlas.store.schema import SPEC_KEY
from atlas.store.store import open_store
from atlas.store.tile_records import TileRecords, complete_records, write_records
from atlas.store.tiles import read_tile, write_tile
from tests.planes import plane_of
from workers import solve_tile


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    handle = create_store(tmp_path_factory.mktemp("made") / "whole.zarr", plane_of((5, 7)), (5, 7))
    cells = handle.spec.cell_params((slice(0, 5), slice(0, 7)))
    write_tile(handle, (0, 0), solve_tile("two-mass", cells, handle.spec.settings))
    complete_records(handle)
    assert verify(handle.path, sample=0).is_sound
    return handle.path


@pytest.fixture
def whole(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "whole.zarr"))


def changed(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    found = json.loads(path.read_text())
    change(found)
    path.write_text(json.dumps(found))


DAMAGES: dict[str, tuple[Callable[[Path], object], str]] = {
    "the root is gone": (lambda at: (at / "zarr.json").unlink(), "zarr.json is missing"),
    "the root is empty": (lambda at: (at / "zarr.json").write_text(""), "zarr.json is damaged (Exp"),
    "the root is torn": (lambda at: (at / "zarr.json").write_text('{"attributes": {"for'), "zarr.json is damaged (Unt"),
    "the root is another group's": (
        lambda at: shutil.copy(at / "hosts/zarr.json", at / "zarr.json"),
        "zarr.json has attributes.Conventions None, must be 'CF-1.11'",
    ),
    "another run": (
        lambda at: changed(at / "zarr.json", lambda root: root["attributes"].update(run_id="0" * 32)),
        f"zarr.json has attributes.run_id '{'0' * 32}', must be ",
    ),
    "no copies": (
        lambda at: changed(at / "zarr.json", lambda root: root.update(consolidated_metadata=None)),
        "zarr.json has consolidated_metadata None, must be ",
    ),
    "a copy of another type": (
        lambda at: changed(
            at / "zarr.json",
            lambda root: root["consolidated_metadata"]["metadata"]["largest"].update(data_type="float44"),
        ),
        "zarr.json has consolidated_metadata.metadata.largest.data_type 'float44', must be 'float64'",
    ),
    "an array is gone": (lambda at: (at / "largest/zarr.json").unlink(), "largest/zarr.json is missing"),
    "an array is torn": (lambda at: (at / "regime/zarr.json").write_text("{"), "regime/zarr.json is damaged (Exp"),
    "another array's": (
        lambda at: shutil.copy(at / "largest/zarr.json", at / "period/zarr.json"),
        "period/zarr.json has data_type 'float64', must be 'int32'",
    ),
    "another shape": (
        lambda at: changed(at / "regime/zarr.json", lambda array: array.update(shape=[8, 7])),
        "regime/zarr.json has shape [8, 7], must be [5, 7]",
    ),
    "a coordinate of another type": (
        lambda at: changed(at / "omega/zarr.json", lambda array: array.update(data_type="float44")),
        "omega/zarr.json has data_type 'float44', must be 'float64'",
    ),
    "a coordinate's values": (lambda at: (at / "b/c/0").write_bytes(b"7"), "b/c/0 is damaged or another chunk"),
    "records": (lambda at: (at / "tiles/records/zarr.json").unlink(), "tiles/records/zarr.json is missing"),
    "the second spec is gone": (lambda at: (at / SPEC_KEY).unlink(), f"{SPEC_KEY} is missing"),
    "the second spec is torn": (lambda at: (at / SPEC_KEY).write_bytes(b"{"), f"{SPEC_KEY} is damaged"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_metadata_that_the_spec_decides_are_named_with_fault_and_remedy_and_written_again(
    whole: Path, made: Path, damage: str
) -> None:
    do, said = DAMAGES[damage]
    do(whole)
    found = [str(fault) for fault in verify(whole, sample=0).faults]
    assert any(line.startswith(said) for line in found), found
    assert all(line.endswith(f": atlas verify --repair {whole} restores them") for line in found)
    key = said.partition(" ")[0]
    assert f"{key} written again" in verify(whole, sample=0, repair=True).restored
    assert verify(whole, sample=0).is_sound
    keys = [path.relative_to(made) for path in made.rglob("*") if path.is_file()]
    assert all((whole / key).read_bytes() == (made / key).read_bytes() for key in keys)


@pytest.mark.parametrize("content", [None, b"", b"{", b"[]", b'{"attributes": 7}'])
def test_a_store_without_its_root_is_refused_with_the_remedy(whole: Path, content: bytes | None) -> None:
    (whole / "zarr.json").unlink() if content is None else (whole / "zarr.json").write_bytes(content)
    with pytest.raises(InputError, match=rf"zarr.json is (missing|damaged .*): atlas verify --repair {whole} restores"):
        open_store(whole)


def test_a_chunk_of_another_size_is_named_with_the_remedy(whole: Path) -> None:
    shutil.copy(whole / "sticks/c/0/0", whole / "largest/c/0/0")
    said = r"largest/c/0/0 is damaged \(it unpacks to 35 bytes, must be 280\): atlas verify --repair"
    with pytest.raises(ChunkError, match=said):
        np.asarray(atlas.open(whole)["largest"])


def big_endian(array: dict[str, Any]) -> None:
    array["codecs"][0]["configuration"]["endian"] = "big"


@pytest.mark.parametrize("key", ["largest/zarr.json", "zarr.json", "R/c", "omega/c/0"])
def test_cells_are_read_rightly_whatever_metadata_and_coordinates_have_become(
    whole: Path, made: Path, key: str
) -> None:
    def change(root: dict[str, Any]) -> None:
        big_endian(root["consolidated_metadata"]["metadata"]["largest"] if key == "zarr.json" else root)

    changed(whole / key, change) if key.endswith("zarr.json") else (whole / key).unlink()
    assert atlas.open(whole).load().identical(atlas.open(made).load())
    np.testing.assert_equal(read_tile(open_store(whole), (0, 0)), read_tile(open_store(made), (0, 0)))


FOLDERS = ("zarr.json", "largest/zarr.json", SPEC_KEY, "R/c", "omega/c/0", "largest/c/0/0", "tiles/records/c.0.0.0")


@pytest.mark.parametrize("key", FOLDERS)
def test_an_empty_folder_in_the_place_of_an_object_is_a_missing_object(whole: Path, made: Path, key: str) -> None:
    (whole / key).unlink()
    (whole / key).mkdir()
    found = verify(whole, sample=0)
    assert any(key.partition("/")[0] in str(fault) for fault in found.faults), found
    assert f"remedy: atlas verify --repair {whole}" in str(found)
    for index in verify(whole, sample=0, repair=True).repaired or ():
        write_tile(open_store(whole), index, read_tile(open_store(made), index))
    complete_records(open_store(whole))
    assert verify(whole, sample=0).is_sound
    with xr.open_zarr(whole) as mended, xr.open_zarr(made) as before:
        assert mended.identical(before)


def test_records_are_read_and_written_whatever_their_own_metadata_say(whole: Path, made: Path) -> None:
    shutil.copy(whole / "omega/zarr.json", whole / "tiles/records/zarr.json")
    handle = open_store(whole)
    rows = TileRecords(handle).columns()
    assert np.array_equal(rows, TileRecords(open_store(made)).columns())
    write_records(handle, rows)
    key = "tiles/records/c.0.0.0"
    assert (whole / key).read_bytes() == (made / key).read_bytes()


def test_measures_outlive_the_loss_of_the_root(whole: Path) -> None:
    handle = open_store(whole)
    write_measures(
        handle, StoredMeasures(empty(of_family(LINEAR), handle.spec.shape), {LINEAR: {"content": "", "norm": {}}})
    )
    before = atlas.open(whole).load()
    assert "reactivity" in before
    (whole / "zarr.json").unlink()
    verify(whole, sample=0, repair=True)
    assert verify(whole, sample=0).is_sound
    assert atlas.open(whole).load().identical(before)
