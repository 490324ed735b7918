"""Claims about stores and files that are wrong on purpose: one line says what, and nothing is written.

Truth is what was done to them.
"""

import json
import os
import shutil
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

import atlas
from atlas.cli.main import main
from atlas.errors import ChunkError, InputError
from atlas.platform import file_lock
from atlas.query.attractors import select_attractor
from atlas.service.lease import LEASE_NAME, hold_lease
from atlas.service.pack import pack
from atlas.store import create
from atlas.store.create import remove_half_made
from atlas.store.sidecar import sidecar_of
from tests.synthetic import complete, spec_of

pytestmark = pytest.mark.slow

NESTED = "[" * 100_000 + "]" * 100_000


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return complete(tmp_path_factory.mktemp("wrong") / "plane.zarr", spec=spec_of(20, 16)).path


@pytest.fixture
def plane(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "plane.zarr"))


def call(*args: object) -> Result:
    return CliRunner().invoke(main, [str(arg) for arg in args])


def assert_one_line(result: Result, code: int, *says: object) -> None:
    assert result.exit_code == code, result.output
    lines = [line for line in result.stderr.splitlines() if line.startswith("Error: ")]
    assert len(lines) == 1
    assert "Traceback" not in result.stderr
    assert all(str(word) in lines[0] for word in says)


def edit(path: Path, key: str, change: Callable[[dict[str, Any]], Any]) -> None:
    metadata = json.loads((path / key).read_text())
    change(metadata)
    (path / key).write_text(json.dumps(metadata))


# Metadata


@pytest.mark.parametrize("key", ["zarr.json"])
@pytest.mark.parametrize("command", ["status", "query"])
def test_metadata_nested_without_end_are_bad_input(plane: Path, key: str, command: str) -> None:
    (plane / key).write_text(NESTED)
    assert_one_line(call(command, plane), 2, plane)


def test_metadata_of_a_result_nested_without_end_are_named_and_restored(plane: Path) -> None:
    before = json.loads((plane / "largest/zarr.json").read_text())
    (plane / "largest/zarr.json").write_text(NESTED)
    assert "largest/zarr.json is damaged" in call("verify", plane, "--sample", 0).output
    assert call("verify", plane, "--sample", 0, "--repair").exit_code == 1
    assert json.loads((plane / "largest/zarr.json").read_text()) == before


@pytest.mark.parametrize("size", [[0, 0], [-1, 2], ["a", 1], [1e3, 2], [10**12, 10**12]])
@pytest.mark.parametrize("command", ["status", "query"])
def test_tiles_of_a_size_that_none_has_are_found_and_mislead_nobody(plane: Path, size: list[Any], command: str) -> None:
    edit(plane, "regime/zarr.json", lambda m: m["chunk_grid"]["configuration"].update(chunk_shape=size))
    assert call(command, plane).exit_code == 0  # the spec decides, not this object
    assert "regime/zarr.json" in call("verify", plane, "--sample", 0).output


@pytest.mark.parametrize("shape", [[10**12, 10**12], [0, 0], [-1, 1]])
@pytest.mark.parametrize("command", ["status", "query"])
def test_a_shape_that_is_not_the_specs_is_found_and_misleads_none(plane: Path, shape: list[int], command: str) -> None:
    edit(plane, "regime/zarr.json", lambda m: m.update(shape=shape))
    assert call(command, plane).exit_code == 0  # the spec decides, not this object
    assert "regime/zarr.json" in call("verify", plane, "--sample", 0).output


def assert_found_and_mended(path: Path, key: str, made: Path) -> None:
    """``verify`` names the entry and its remedy, which writes the metadata again as they were made."""
    found = call("verify", path, "--sample", 0)
    assert found.exit_code == 1
    assert f"found: {key} " in found.output
    assert f"atlas verify --repair {path} restores them" in " ".join(found.output.split())
    call("verify", path, "--sample", 0, "--repair")
    assert json.loads((path / key).read_text()) == json.loads((made / key).read_text())


@pytest.mark.parametrize("key", ["zarr.json", "regime/zarr.json"])
def test_verify_finds_and_mends_metadata_nested_without_end(plane: Path, made: Path, key: str) -> None:
    (plane / key).write_text(NESTED)
    assert_found_and_mended(plane, key, made)


@pytest.mark.parametrize("size", [[0, 0], [-1, 2], ["a", 1], [1e3, 2], [10**12, 10**12]])
def test_verify_finds_and_mends_tiles_of_a_size_that_none_has(plane: Path, made: Path, size: list[Any]) -> None:
    edit(plane, "regime/zarr.json", lambda m: m["chunk_grid"]["configuration"].update(chunk_shape=size))
    assert_found_and_mended(plane, "regime/zarr.json", made)


@pytest.mark.parametrize("shape", [[10**12, 10**12], [0, 0], [-1, 1]])
def test_verify_finds_and_mends_a_shape_that_is_not_the_specs(plane: Path, made: Path, shape: list[int]) -> None:
    edit(plane, "regime/zarr.json", lambda m: m.update(shape=shape))
    assert_found_and_mended(plane, "regime/zarr.json", made)


# Zip files


@pytest.mark.parametrize("packed", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_a_member_that_says_that_it_has_3_gigabytes_is_not_read(tmp_path: Path, packed: int) -> None:
    file = tmp_path / "plane.zip"
    with zipfile.ZipFile(file, "w", packed) as archive:
        archive.writestr("zarr.json", b"x" * 1000)
        archive.infolist()[0].file_size = 3 * 10**9
        if packed == zipfile.ZIP_STORED:
            archive.infolist()[0].compress_size = 3 * 10**9
    begin = time.process_time()
    assert_one_line(call("status", file), 2, file, "damaged or incomplete: zarr.json states a size of 3000000000 bytes")
    assert time.process_time() - begin < 5.0


# Packing


@pytest.mark.parametrize("target", ["/dev/zero", "largest/c/0/1", "nothing"])
def test_a_link_is_not_packed(plane: Path, tmp_path: Path, target: str) -> None:
    (plane / "largest/c/0/0").unlink()
    (plane / "largest/c/0/0").symlink_to(plane / target if not target.startswith("/") else target)
    assert_one_line(call("pack", plane, tmp_path / "a.zip"), 2, f"{plane}: largest/c/0/0 is a link")
    assert not list(tmp_path.glob("*.zip"))


def test_a_pipe_is_not_packed(plane: Path, tmp_path: Path) -> None:
    os.mkfifo(plane / "pipe")
    with pytest.raises(InputError, match="pipe is no file"):
        pack(plane, tmp_path / "a.zip")


@pytest.mark.parametrize("key", ["largest/c/0/1", "state/c/1/0/0"])
def test_a_store_with_a_lost_chunk_is_not_packed(plane: Path, tmp_path: Path, key: str) -> None:
    (plane / key).unlink()
    with pytest.raises(ChunkError, match=f"{plane}: {key} is missing: atlas verify --repair"):
        pack(plane, tmp_path / "a.zip")
    assert not list(tmp_path.glob("*.zip"))


def test_what_a_killed_pack_left_is_removed_by_the_next_and_a_living_ones_is_not(plane: Path, tmp_path: Path) -> None:
    left, living = (tmp_path / f".a.zip.{name * 32}.partial" for name in "ab")
    other = tmp_path / ".a.zip.zip.0123456789abcdef0123456789abcdef.partial"
    for file in (left, living, other):
        file.write_bytes(b"half")
    with file_lock(living.with_suffix(".lock")):
        pack(plane, tmp_path / "a.zip")
    assert [file.exists() for file in (left, living, other)] == [False, True, True]
    assert not left.with_suffix(".lock").exists()


# Claims and what is half made


def test_a_store_and_a_link_to_it_have_one_claim(plane: Path, tmp_path: Path) -> None:
    (tmp_path / "link.zarr").symlink_to(plane)
    with hold_lease(sidecar_of(plane), "plane"):
        assert sidecar_of(tmp_path / "link.zarr").get(LEASE_NAME) is not None
        link = hold_lease(sidecar_of(tmp_path / "link.zarr"), "link")
        with pytest.raises(InputError, match="leased by another run"), link:
            pass


def test_what_is_half_made_of_another_store_stays(tmp_path: Path) -> None:
    own, other = (tmp_path / f".{name}.{'0a' * 16}.partial" for name in ("plane", "plane.zarr"))
    for folder in (own, other):
        folder.mkdir()
    remove_half_made(tmp_path / "plane")
    assert (own.exists(), other.exists()) == (False, True)


# Options


@pytest.mark.parametrize("value", ["inf", "nan", "-1", "0.5"])
def test_an_attractor_that_is_no_place_is_refused(tmp_path: Path, value: str) -> None:
    axes = {"omega": [1.0, 2.0, 3.0, 4.0], "b": [0.1, 0.2, 0.3, 0.4]}
    handle = create.create_store(tmp_path / "all.zarr", atlas.Spec("two-mass", axes=axes, attractors={}), (4, 4))
    with pytest.raises(InputError, match=r"attractor: found .*, must be a whole number, 0 to"):
        select_attractor(atlas.open(handle.path), float(value))


@pytest.mark.parametrize("options", [["--dpi", "1.5"], ["--font-size", "0.01"]])
def test_letters_without_a_dot_are_refused(plane: Path, tmp_path: Path, options: list[str]) -> None:
    assert_one_line(call("plot", plane, "-o", tmp_path / "a.png", *options), 2, "dpi: found", "dots")
    assert not list(tmp_path.glob("*.png"))


def test_least_letters_are_drawn(plane: Path, tmp_path: Path) -> None:
    assert call("plot", plane, "-o", tmp_path / "a.png", "--dpi", 29).exit_code == 0


@pytest.mark.parametrize("out", ["nowhere/curves.csv", "folder.csv"])
def test_a_path_for_curves_that_cannot_be_written_is_refused_at_once(plane: Path, tmp_path: Path, out: str) -> None:
    (tmp_path / "folder.csv").mkdir()
    assert_one_line(call("find", "curves", plane, "-o", tmp_path / out), 2, f"{tmp_path / out}: cannot be written")
