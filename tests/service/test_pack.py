"""Claims about an atlas packed into one zip file: it reads as the store does, is never half there, and is read only."""

import json
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import zarr
from distributed import Client

import atlas
from atlas.check.verify import verify
from atlas.errors import ChunkError, InputError
from atlas.platform import process_name
from atlas.query.read_counter import count_chunk_reads
from atlas.service.lease import LeaseRecord
from atlas.service.pack import pack, write_zip
from atlas.store import create, store
from atlas.store.sidecar import LEASE_NAME, sidecar_of
from tests.interface.test_cli import call
from tests.planes import plane_of
from tests.synthetic import complete, fill, spec_of


@pytest.fixture(scope="module")
def handle(tmp_path_factory: pytest.TempPathFactory) -> store.AtlasStore:
    return complete(tmp_path_factory.mktemp("pack") / "a.zarr", (19, 23))


@pytest.fixture(scope="module")
def packed(handle: store.AtlasStore) -> Path:
    file = handle.path.with_name("a.zip")
    assert pack(handle.path, file).is_complete
    return file


def changed(packed: Path, into: Path, key: str) -> Path:
    """A copy with a byte of a member flipped, the table of contents as it was."""
    data = bytearray(packed.read_bytes())
    with zipfile.ZipFile(packed) as archive:
        member = archive.getinfo(key)
    data[member.header_offset + 30 + len(key) + member.file_size // 2] ^= 255
    into.write_bytes(data)
    return into


# Reading


def test_plain_xarray_opens_it_and_finds_what_the_store_holds(handle: store.AtlasStore, packed: Path) -> None:
    with zarr.storage.ZipStore(packed, read_only=True) as zipped:
        xr.testing.assert_identical(xr.open_zarr(zipped).load(), xr.open_zarr(handle.path).load())


def test_atlas_opens_it_and_reads_as_few_chunks_as_of_the_store(handle: store.AtlasStore, packed: Path) -> None:
    found = []
    for place in (handle.path, packed):
        with count_chunk_reads() as reads:
            shares = atlas.open(place).atlas.fractions({"omega": (1.2, 3.1)}).to_dict()
        found.append((shares, reads.chunks))
    assert found[0] == found[1]


def test_a_picture_of_it_is_that_of_the_store(handle: store.AtlasStore, packed: Path, tmp_path: Path) -> None:
    for place, out in ((handle.path, "a.png"), (packed, "b.png")):
        assert call("plot", place, "-o", tmp_path / out, "--kind", "period").exit_code == 0
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


@pytest.mark.parametrize("args", [("status", "STORE"), ("query", "STORE"), ("find", "regions", "STORE", "period")])
def test_commands_that_read_answer_as_of_the_store(
    handle: store.AtlasStore, packed: Path, args: tuple[str, ...]
) -> None:
    of_store, of_file = (
        json.loads(call(*(place if arg == "STORE" else arg for arg in args), "--json").stdout)
        for place in (handle.path, packed)
    )
    for message in (of_store, of_file):
        message.pop("store", None)
    assert of_store == of_file


@pytest.mark.slow
def test_a_packed_atlas_can_be_extended_into_a_folder(client: Client, tmp_path: Path) -> None:
    spec = plane_of()
    atlas.run(spec, tmp_path / "a.zarr", client)
    pack(tmp_path / "a.zarr", tmp_path / "a.zip")
    assert verify(tmp_path / "a.zip", sample=2).is_sound
    finer = atlas.extend(tmp_path / "a.zip", tmp_path / "b.zarr", refine={"b": 2}, client=client)
    assert finer.tiles_done == finer.tiles
    old, new = atlas.open(tmp_path / "a.zip"), atlas.open(tmp_path / "b.zarr")
    np.testing.assert_array_equal(new.largest.values[::2], old.largest.values)


# The file


def test_a_file_is_the_same_bytes_each_time(handle: store.AtlasStore, packed: Path, tmp_path: Path) -> None:
    pack(handle.path, tmp_path / "b.zip")
    assert (tmp_path / "b.zip").read_bytes() == packed.read_bytes()


def test_chunks_are_stored_as_they_are(handle: store.AtlasStore, packed: Path) -> None:
    with zipfile.ZipFile(packed) as archive:
        members = archive.infolist()
    assert {member.compress_type for member in members} == {zipfile.ZIP_STORED}
    assert {member.filename for member in members} == {*handle.backend.list_keys()}


def test_a_pack_that_fails_in_the_middle_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    def members() -> object:
        yield "zarr.json", b"{}"
        raise KeyboardInterrupt

    (tmp_path / "a.zip").write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt):
        write_zip(tmp_path / "a.zip", members())  # type: ignore[arg-type]
    assert (tmp_path / "a.zip").read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a.zip"]


def test_a_file_that_is_there_is_replaced_only_by_force(handle: store.AtlasStore, tmp_path: Path) -> None:
    (tmp_path / "a.zip").write_bytes(b"mine")
    shown = call("pack", handle.path, tmp_path / "a.zip")
    assert (shown.exit_code, shown.stdout, len(shown.stderr.splitlines())) == (2, "", 1)
    assert "exists already; --force" in shown.stderr
    assert (tmp_path / "a.zip").read_bytes() == b"mine"
    assert call("pack", handle.path, tmp_path / "a.zip", "--force").exit_code == 0
    assert zipfile.is_zipfile(tmp_path / "a.zip")


def test_a_replaced_file_is_read_anew(handle: store.AtlasStore, tmp_path: Path) -> None:
    other = create.create_store(tmp_path / "b.zarr", spec_of(), (19, 23))
    fill(other, seed=5)
    pack(handle.path, tmp_path / "a.zip")
    before = atlas.open(tmp_path / "a.zip").largest.values
    pack(other.path, tmp_path / "a.zip", force=True)
    after = atlas.open(tmp_path / "a.zip").largest.values
    np.testing.assert_array_equal(after, atlas.open(other.path).largest.values)
    assert not np.array_equal(before, after, equal_nan=True)


def test_a_half_done_atlas_is_packed_with_a_word_about_it(tmp_path: Path) -> None:
    half = create.create_store(tmp_path / "a.zarr", spec_of(), (19, 23))
    fill(half, skip=((0, 0),))
    shown = call("pack", half.path, tmp_path / "a.zip")
    assert shown.exit_code == 0
    assert "only 3 of 4 tiles are done: the rest reads as pending" in shown.stdout
    assert (
        atlas.open(tmp_path / "a.zip").atlas.fractions().to_dict() == atlas.open(half.path).atlas.fractions().to_dict()
    )
    assert not verify(tmp_path / "a.zip", sample=0).is_complete


def test_a_store_that_a_run_is_at_work_on_is_not_packed(handle: store.AtlasStore, tmp_path: Path) -> None:
    notes = sidecar_of(handle.path)
    claim = LeaseRecord("theirs", 1, "here", os.getpid(), process_name()).pack()
    assert notes.put_new(LEASE_NAME, claim)
    try:
        with pytest.raises(InputError, match=r"leased by another run .*; pack it when the run has ended"):
            pack(handle.path, tmp_path / "b.zip")
    finally:
        notes.remove(LEASE_NAME)
    assert os.listdir(tmp_path) == []


def test_progress_counts_the_objects(handle: store.AtlasStore, tmp_path: Path) -> None:
    seen: list[str] = []
    made = pack(handle.path, tmp_path / "b.zip", on_progress=lambda progress: seen.append(str(progress)))
    assert seen[-1] == f"packing: {made.objects} of {made.objects} objects"


@pytest.mark.parametrize(
    ("name", "message"),
    [("a.tar", r"a.tar: must end in \.zip"), ("no/such/folder/a.zip", "cannot be packed: No such file or directory")],
)
def test_a_file_that_cannot_be_made_is_refused(
    handle: store.AtlasStore, tmp_path: Path, name: str, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        pack(handle.path, tmp_path / name)
    assert os.listdir(tmp_path) == []


# Writing and damage


@pytest.mark.parametrize("name", ["a.zip", "new.zip"])
@pytest.mark.parametrize("command", ["run", "plan"])
def test_a_zip_file_is_no_place_for_a_run(packed: Path, tmp_path: Path, command: str, name: str) -> None:
    (tmp_path / "a.zip").write_bytes(packed.read_bytes())
    before = sorted(os.listdir(tmp_path))
    shown = call(command, "tiny", "-o", tmp_path / name)
    assert (shown.exit_code, shown.stdout, len(shown.stderr.splitlines())) == (2, "", 1)
    assert f"{name}: a zip file is read-only; give a folder" in shown.stderr
    assert sorted(os.listdir(tmp_path)) == before


def test_a_packed_atlas_is_not_repaired(packed: Path) -> None:
    with pytest.raises(InputError, match="a zip file is read-only"):
        verify(packed, repair=True)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.999])
@pytest.mark.parametrize("command", ["status", "query", "verify"])
def test_a_half_written_file_is_reported_in_one_line(packed: Path, tmp_path: Path, command: str, share: float) -> None:
    half = tmp_path / "half.zip"
    half.write_bytes(packed.read_bytes()[: int(share * packed.stat().st_size)])
    shown = call(command, half)
    assert (shown.exit_code, shown.stdout, len(shown.stderr.splitlines())) == (2, "", 1)
    assert "half.zip: cannot be read: the zip file is damaged or incomplete" in shown.stderr


def test_a_zip_file_of_something_else_is_no_atlas(tmp_path: Path) -> None:
    write_zip(tmp_path / "a.zip", [("letter.txt", b"Dear")])
    with pytest.raises(InputError, match=r"a\.zip: not an atlas"):
        atlas.open(tmp_path / "a.zip")


def test_a_damaged_chunk_is_named_where_it_is_read(packed: Path, tmp_path: Path) -> None:
    bad = changed(packed, tmp_path / "b.zip", "largest/c/0/1")
    with pytest.raises(
        ChunkError, match=r"largest/c/0/1 cannot be read \(the zip file is damaged.*pack the atlas again"
    ):
        atlas.open(bad).largest.load()
    shown = call("query", bad, "--at", "omega=4", "--at", "b=0.1")
    assert (shown.exit_code, len(shown.stderr.splitlines())) == (1, 1)


def test_verify_names_a_damaged_chunk(packed: Path, tmp_path: Path) -> None:
    report = verify(changed(packed, tmp_path / "b.zip", "largest/c/0/1"), sample=0)
    begin = "tile (0, 1): largest/c/0/1 cannot be read (the zip file is damaged"
    assert [str(fault).startswith(begin) for fault in report.faults if fault.tile == (0, 1)] == [True]


def test_damaged_metadata_are_reported_in_one_line(packed: Path, tmp_path: Path) -> None:
    shown = call("status", changed(packed, tmp_path / "b.zip", "zarr.json"))
    assert (shown.exit_code, shown.stdout, len(shown.stderr.splitlines())) == (2, "", 1)
