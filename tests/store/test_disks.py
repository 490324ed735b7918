"""Real disks that fill up, turn read-only, or are not there for a worker: small ones, mounted where the machine allows.

test_faults.py has the same by errors put in, which every machine can do.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.paths import ROOT

APART = ["unshare", "--mount", "--map-root-user"]


def may_mount() -> bool:
    try:
        shown = subprocess.run([*APART, "mount", "-t", "tmpfs", "none", "/mnt"], capture_output=True, check=False)
    except OSError:
        return False
    return shown.returncode == 0


pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not may_mount(), reason="no mounts of its own for a process on this machine"),
]


def printed_by(*command: str | Path) -> list[str]:
    """The lines that a command of the checkout prints."""
    ended = subprocess.run(
        command,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout.splitlines()


TROUBLE = """
import errno, subprocess, sys, time
from pathlib import Path

import numpy as np
from distributed import Client

import atlas
from atlas.errors import RunError
from atlas.service.timing import Timing
from atlas.store.tiles import read_tile
from atlas.store.store import done_tiles, open_store
from tests.planes import plane_of
from workers.tile import solve_tile

disk, trouble = Path(sys.argv[1]), sys.argv[2]
options = atlas.RunOptions(timing=Timing(expire_after=5.0))  # how long a claim of this process is watched
subprocess.run(["mount", "-t", "tmpfs", "-o", "size=8m", "none", disk], check=True)
plane, store = plane_of(), disk / "out.zarr"


def remount(how):
    while subprocess.run(["mount", "-o", "remount," + how, disk], capture_output=True).returncode:
        time.sleep(0.01)  # a file is being written


def spoil(progress):
    if progress.tiles_done == 2 and not spoilt:
        spoilt.append(True)
        if trouble == "read-only":
            remount("ro")
            return
        with open(disk / "ballast", "wb", buffering=0) as ballast:
            try:
                while True:
                    ballast.write(bytes(4096))
            except OSError as error:
                assert error.errno == errno.ENOSPC


spoilt = []
with Client(processes=False, n_workers=1, threads_per_worker=2, dashboard_address="127.0.0.1:0") as client:
    try:
        atlas.run(plane, store, client=client, options=atlas.RunOptions(on_progress=spoil))
    except RunError as error:
        print(error)
    (remount("rw") if trouble == "read-only" else (disk / "ballast").unlink())
    handle = open_store(store)
    kept = done_tiles(handle)
    for index in kept:
        assert (read_tile(handle, index)["regime"] >= 0).all()
    summary = atlas.run(plane, store, client, options)
print(2 <= len(kept) < 9, summary.tiles_solved <= 9 - len(kept), summary.tiles_done)
expected = solve_tile(plane.system, plane.cell_params((slice(0, 5), slice(0, 7))), plane.settings)
stored = atlas.open(store)
for name, values in expected.items():
    np.testing.assert_array_equal(stored[name].values, values, err_msg=name)
"""


@pytest.mark.parametrize(
    ("trouble", "message"),
    [
        ("full", "No space left on device; finished tiles are kept, make room and rerun the same command"),
        ("read-only", "all workers are excluded, for example inproc://"),
    ],
)
def test_a_disk_that_fails_under_a_run_costs_nothing_that_was_stored(
    tmp_path: Path, trouble: str, message: str
) -> None:
    lines = printed_by(*APART, sys.executable, "-c", TROUBLE, tmp_path, trouble)
    error, outcome = lines
    assert message in error
    assert outcome == "True True 9"


BLIND = """
import subprocess, sys, threading

import atlas
from distributed import Client, LocalCluster
from tests.planes import plane_of

folder = sys.argv[1]
with LocalCluster(processes=False, n_workers=1, threads_per_worker=1, host="127.0.0.1", protocol="tcp",
                  dashboard_address="127.0.0.1:0") as cluster, Client(cluster) as client:
    hide = f"mount -t tmpfs none {folder}; exec {sys.executable} -m distributed.cli.dask_worker "
    hide += f"{cluster.scheduler_address} --nthreads 1 --no-nanny --no-dashboard --local-directory /tmp"
    blind = subprocess.Popen(["unshare", "--mount", "--map-root-user", "sh", "-c", hide], stderr=subprocess.DEVNULL)
    try:
        client.wait_for_workers(2, timeout=60)
        summary = atlas.run(plane_of(), folder + "/out.zarr", client=client)
    finally:
        blind.kill()
        blind.wait()
print(summary.tiles_done, len(summary.failures), *summary.refused.values(), sep="\\n")
"""


def test_a_worker_that_does_not_see_the_store_is_left_out_and_the_rest_finishes(tmp_path: Path) -> None:
    lines = printed_by(sys.executable, "-c", BLIND, tmp_path)
    assert lines == [
        "9",
        "0",
        f"{tmp_path}/out.zarr: no such store; check that the path is the same on every host",
    ]
