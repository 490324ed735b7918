"""Claims about the metadata of a store: a change of any part of them is found, and a repair writes them again.

Truth is the metadata before they were changed, and what plain Zarr opens.
"""

import json
import os
import re
import shutil
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
import zarr
from click.testing import CliRunner

import atlas
from atlas.check.metadata import RightObjects, metadata_faults, open_damaged_store
from atlas.check.verify import verify
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.overview.builder import OverviewBuilder
from atlas.store import create
from atlas.store.groups import CURVES, STABILITY, write_group, write_table
from atlas.store.host import host_from_facts
from atlas.store.host_records import record_host
from atlas.store.object_backend import open_backend
from atlas.store.schema import SPEC_KEY, StoredArray
from tests.synthetic import spec_of

SPEC = spec_of(8, 7)
MACHINE = host_from_facts({"processor": "Z80", "software": "numpy 2"})


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store without a tile, and with every kind of group."""
    handle = create.create_store(tmp_path_factory.mktemp("made") / "plane.zarr", SPEC, (4, 4))
    OverviewBuilder(handle, side=4, minimum=4)
    column = {"w": StoredArray(np.arange(3.0), ("row",), {"units": "1"})}
    write_table(handle, STABILITY, column, {})
    write_group(handle, CURVES, column, {})
    record_host(handle, MACHINE)  # the root has no copy of it
    return handle.path


@pytest.fixture
def store(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "plane.zarr"))


def flips(data: bytes) -> Iterator[bytes]:
    """Metadata with a bit flipped in a key: of every key once, at its last place."""
    last = {match.group(1): match for match in re.finditer(rb'"([^"\\\\]+)":', data)}
    for match in last.values():
        middle = (match.start(1) + match.end(1)) // 2
        yield data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]


SPEC_DECIDES = (
    "zarr.json", SPEC_KEY, "largest/zarr.json", "omega/zarr.json", "tiles/zarr.json", "tiles/records/zarr.json",
    "hosts/zarr.json",
)  # fmt: skip
DERIVED = (
    "curves/zarr.json", "curves/w/zarr.json", "stability/zarr.json", "overviews/zarr.json", "overviews/1/zarr.json",
    "overviews/1/regime_share/zarr.json",
)  # fmt: skip


@pytest.mark.parametrize("file", [*SPEC_DECIDES, *(pytest.param(file, marks=pytest.mark.slow) for file in DERIVED)])
def test_a_bit_flipped_in_any_key_is_found_and_mended(store: Path, file: str) -> None:
    before = (store / file).read_bytes()
    assert verify(store, sample=0).faults == ()
    for after in flips(before):
        (store / file).write_bytes(after)
        handle = open_damaged_store(open_backend(store))
        right = RightObjects(handle)
        assert any(fault.what.startswith(f"{file} ") for fault in metadata_faults(handle, right)), after
        assert right[file] == before, after
    assert verify(store, sample=0, repair=True).restored == (f"{file} written again",)
    assert (store / file).read_bytes() == before
    assert verify(store, sample=0).faults == ()


def test_a_bit_flipped_in_the_record_of_a_host_is_found(store: Path) -> None:
    record = store / f"hosts/{MACHINE.name}/zarr.json"
    for after in flips(record.read_bytes()):
        record.write_bytes(after)
        assert verify(store, sample=0).faults, after


def change(path: Path, file: str, at: tuple[str, ...], key: str, new: dict[str, Any]) -> None:
    """Replace a key of an object within the metadata of a file."""
    metadata = node = json.loads((path / file).read_text())
    for name in at:
        node = node[name]
    node.pop(key, None)
    node.update(new)
    (path / file).write_text(json.dumps(metadata))


ROOT = "zarr.json"
CHANGES: list[tuple[str, tuple[str, ...], str, dict[str, Any]]] = [
    (ROOT, ("consolidated_metadata",), "kind", {"kine": "inline"}),
    (ROOT, ("consolidated_metadata",), "kind", {"kind": "inlinf"}),
    (ROOT, ("consolidated_metadata",), "must_understand", {"must_understand": True}),
    (ROOT, ("consolidated_metadata", "metadata", "hosts"), "node_type", {"node_typf": "group"}),
    (ROOT, ("consolidated_metadata", "metadata", "hosts", "consolidated_metadata"), "kind", {"kine": "inline"}),
    (ROOT, ("consolidated_metadata", "metadata", "overviews"), "node_type", {"node_typf": "group"}),
    (ROOT, ("consolidated_metadata", "metadata"), "largest", {"largest": [1]}),
    (ROOT, ("consolidated_metadata", "metadata"), "", {"overwiews": {"zarr_format": 3, "node_type": "array"}}),
    (ROOT, (), "node_type", {"node_typd": "group"}),
    (ROOT, (), "node_type", {"node_type": "groun"}),
    (ROOT, (), "zarr_format", {"zarr_format": 2}),
    (ROOT, (), "", {"x": 1}),
    ("hosts/zarr.json", (), "", {"x": 1}),
    ("hosts/zarr.json", ("attributes",), "", {"x": 1}),
    (f"hosts/{MACHINE.name}/zarr.json", (), "", {"x": 1}),
    (f"hosts/{MACHINE.name}/zarr.json", (), "node_type", {"node_type": "array"}),
    ("largest/zarr.json", (), "", {"x": 1}),
    ("largest/zarr.json", ("attributes",), "", {"x": 1}),
    ("largest/zarr.json", ("attributes",), "units", {"units": "s"}),
]


@pytest.mark.parametrize(("file", "at", "key", "new"), CHANGES)
def test_changed_metadata_are_found_and_a_repair_writes_them_again(
    store: Path, file: str, at: tuple[str, ...], key: str, new: dict[str, Any]
) -> None:
    before = opened(store)
    change(store, file, at, key, new)
    found = CliRunner().invoke(main, ["verify", str(store), "--sample", "0"])
    assert found.exit_code == 1
    assert f"found: {file} " in found.output
    verify(store, sample=0, repair=True)
    assert opened(store) == before
    assert verify(store, sample=0).faults == ()


def opened(path: Path) -> dict[str, Any]:
    """All metadata of a store, as plain Zarr reads them with the root's copies, and without."""
    consolidated, own = (
        dict(zarr.open_group(path, mode="r", use_consolidated=use).members(None)) for use in (True, False)
    )
    late = (CURVES, f"hosts/{MACHINE.name}")  # a repair copies what was added after the root was written
    nodes = {f"copy of {name}": node for name, node in consolidated.items() if not name.startswith(late)} | own
    alone = {name: node.metadata.to_dict() | {"consolidated_metadata": None} for name, node in nodes.items()}
    return {name: str(metadata) for name, metadata in sorted(alone.items())}


@pytest.mark.parametrize(
    ("file", "at"),
    [
        (ROOT, ("consolidated_metadata", "metadata", "stability/w")),
        (ROOT, ("consolidated_metadata", "metadata", "stability")),
        ("stability/zarr.json", ("consolidated_metadata", "metadata", "w")),
        ("stability/zarr.json", ("consolidated_metadata",)),
    ],
)
def test_a_sound_table_outlives_its_damaged_copies(store: Path, file: str, at: tuple[str, ...]) -> None:
    """Its checksum shows that it is sound; measuring it again may take hours."""
    before = opened(store)
    change(store, file, at, "kind" if at[-1] == "consolidated_metadata" else "node_type", {"kine": 1})
    fault, *_ = verify(store, sample=0, repair=True).faults
    assert "stability" in str(fault) or str(fault).startswith("zarr.json has"), fault
    assert verify(store, sample=0).faults == ()
    assert opened(store) == before


def test_an_unknown_key_of_the_root_changes_nothing_that_is_read(store: Path) -> None:
    before = atlas.open(store).load()
    change(store, ROOT, (), "", {"x": 1})
    assert atlas.open(store).load().identical(before)


def test_of_a_root_and_a_spec_of_two_stores_the_one_of_the_arrays_is_right(store: Path, tmp_path: Path) -> None:
    before = (store / ROOT).read_bytes()
    other = create.create_store(tmp_path / "other.zarr", spec_of(7, 5), (5, 7)).path
    for key in (SPEC_KEY, ROOT):
        shutil.copy(other / key, store / key)
        assert verify(store, sample=0, repair=True).restored == (f"{key} written again",)
        assert (store / ROOT).read_bytes() == before
        assert verify(store, sample=0).faults == ()


def test_plain_zarr_has_nothing_to_warn_of(store: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        members = dict(zarr.open_group(store, mode="r", use_consolidated=False).members(None))
    assert {"spec", "largest", "hosts", "tiles/records", "overviews/1/largest"} <= members.keys()


def test_a_copy_by_xarray_is_called_one_and_answers_questions_as_a_dataset(store: Path, tmp_path: Path) -> None:
    ds = atlas.open(store)
    ds.to_zarr(tmp_path / "copy.zarr", consolidated=True)
    for command in ("status", "verify", "query"):
        answer = CliRunner().invoke(main, [command, str(tmp_path / "copy.zarr")])
        assert answer.exit_code == 2
        assert "copy.zarr: a copy made by xarray's to_zarr, which is no store of an atlas" in answer.stderr
    with xr.open_zarr(tmp_path / "copy.zarr") as copy:
        assert copy.atlas.fractions().to_dict() == ds.atlas.fractions().to_dict() == {"pending": 1.0}


def test_what_killed_writes_have_left_is_no_fault_and_a_repair_removes_it(store: Path) -> None:
    left = [store / f"{name}.{'0a' * 16}.partial" for name in ("regime/c/0/0", "zarr")]
    for path in left:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"half")
    report = verify(store, sample=0)
    assert report.faults == ()
    assert ("left", "2 files of killed writes, which nothing reads: --repair removes them") in report.rows
    assert sorted(verify(store, sample=0, repair=True).removed) == sorted(report.leftovers)
    assert not any(path.exists() for path in left)
    assert verify(store, sample=0).leftovers == ()


def test_a_pipe_in_place_of_a_zip_file_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "plane.zip")
    with pytest.raises(InputError, match=r"plane.zip: cannot be read: not a regular file"):
        atlas.open(tmp_path / "plane.zip")
