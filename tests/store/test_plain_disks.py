"""Disks without hard links or locks, a lock that is never released, and files that a crash has emptied.

Truth: the bits of a store on an ordinary disk, and the calls to the operating system.
"""

import errno
import fcntl
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from distributed import Client

import atlas
from atlas.overview.builder import OverviewBuilder
from atlas.overview.pyramid import GROUP
from atlas.store.create import create_store
from atlas.store.object_backend import LocalBackend
from atlas.store.store import done_tiles, is_done, open_store
from atlas.store.tile_records import forget_records
from atlas.task.store_ref import StoreRef
from atlas.task.tile_job import RunJob, run_tile_job
from tests.paths import ROOT
from tests.planes import plane_of


def refused(code: int, *_: object, **__: object) -> None:
    raise OSError(code, os.strerror(code))


def arrays_of(store: Path) -> dict[str, bytes]:
    ds = atlas.open(store)
    return {str(name): ds[name].values.tobytes() for name in ds.variables}


@pytest.mark.parametrize("lock", [errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK])
def test_a_run_on_a_disk_without_links_and_locks_has_the_same_bits_and_leaves_nothing_beside_its_store(
    tmp_path: Path, solved_plane: Path, client: Client, monkeypatch: pytest.MonkeyPatch, lock: int
) -> None:
    monkeypatch.setattr(os, "link", partial(refused, errno.EPERM))
    monkeypatch.setattr(fcntl, "flock", partial(refused, lock))
    atlas.run(plane_of(), tmp_path / "out.zarr", client=client)
    assert os.listdir(tmp_path) == ["out.zarr"]
    monkeypatch.undo()
    assert arrays_of(tmp_path / "out.zarr") == arrays_of(solved_plane)


def test_an_object_is_put_new_only_once_where_there_are_no_links(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "link", partial(refused, errno.ENOTSUP))
    place = LocalBackend(tmp_path)
    assert [place.put_new("a", b"1"), place.put_new("a", b"2")] == [True, False]
    assert place.get("a") == b"1"
    assert os.listdir(tmp_path) == ["a"]


def test_a_tile_whose_regime_a_crash_has_emptied_is_solved_again(
    finished: Path, solved_plane: Path, client: Client
) -> None:
    """Before the record of the tile was written: only then is a tile not yet flushed to the disk."""
    forget_records(open_store(finished), [(1, 1)])
    (finished / "regime/c/1/1").write_bytes(b"")
    handle = open_store(finished)
    assert not is_done(handle, (1, 1))
    assert len(done_tiles(handle)) == 8
    assert atlas.status(finished).tiles_done == 8
    assert atlas.run(plane_of(), finished, client=client).tiles_solved == 1
    assert arrays_of(finished) == arrays_of(solved_plane)


def test_an_overview_whose_regime_a_crash_has_emptied_is_made_again(finished: Path) -> None:
    shutil.rmtree(finished / GROUP, ignore_errors=True)
    OverviewBuilder(open_store(finished), side=2, minimum=1).finish()
    (key, *_) = [key for key in LocalBackend(finished).list_keys(f"{GROUP}/") if "/regime/c/" in key]
    before = (finished / key).read_bytes()
    (finished / key).write_bytes(b"")
    OverviewBuilder(open_store(finished), side=2, minimum=1).finish()
    assert (finished / key).read_bytes() == before


def test_an_atlas_is_read_in_a_process_that_was_forked_from_a_reader(finished: Path) -> None:
    """As by multiprocessing on Linux."""
    code = f"""
import os, atlas
whole = atlas.open({str(finished)!r}).regime.values.tobytes()
if child := os.fork():
    raise SystemExit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
os._exit(atlas.open({str(finished)!r}).regime.values.tobytes() != whole)
"""
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, timeout=120, check=False).returncode == 0


def test_every_file_of_a_store_is_flushed_before_it_gets_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flushed, named = set[int](), dict[str, bool]()
    fsync, replace, link = os.fsync, os.replace, os.link

    def look(rename: Callable[..., None], source: Any, target: Any) -> None:
        if ".run/" not in str(target):  # notes: they have a checksum, and end with their run
            named[str(target)] = os.stat(source).st_ino in flushed
        rename(source, target)

    monkeypatch.setattr(os, "fsync", lambda file: (fsync(file), flushed.add(os.fstat(file).st_ino)))
    monkeypatch.setattr(os, "replace", partial(look, replace))
    monkeypatch.setattr(os, "link", partial(look, link))
    handle = create_store(tmp_path / "out.zarr", plane_of(), (2, 3))
    run_tile_job(RunJob((0, 0), StoreRef(str(handle.backend), handle.run_id, handle.solver_version)))
    assert all(named.values()), named
    names = {name.rpartition(".partial/")[2].removeprefix(f"{tmp_path}/out.zarr/") for name in named}
    assert {*LocalBackend(tmp_path / "out.zarr").list_keys()} <= names
