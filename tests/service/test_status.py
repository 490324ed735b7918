"""A status is true at some moment between its question and its answer, whatever the run at work does meanwhile."""

import json
import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from distributed import Client
from numpy.typing import NDArray

import atlas
from atlas.cli.main import main
from atlas.platform import process_name
from atlas.service.lease import LeaseObserver, LeaseRecord
from atlas.service.progress import Progress
from atlas.service.status import StoreCounts, read_status
from atlas.service.timing import Timing
from atlas.store import tile_records
from atlas.store.create import create_store
from atlas.store.object_backend import LocalBackend
from atlas.store.sidecar import LEASE_NAME, sidecar_of
from atlas.store.store import AtlasStore, open_store
from atlas.store.tiles import drop_tile, read_tile, write_tile
from tests.planes import plane_of


def claim(progress: dict[str, object] | None = None) -> LeaseRecord:
    return LeaseRecord("ours", 1, "here", os.getpid(), process_name(), progress=progress or {})


def test_a_run_that_ends_while_its_tiles_are_counted_is_not_reported_as_ended_before_its_last_tile(
    finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    handle, counted, notes = open_store(finished), tile_records.done_mask, sidecar_of(finished)
    last = read_tile(handle, (1, 1))
    drop_tile(handle, (1, 1))
    notes.put_new(LEASE_NAME, claim().pack())

    def slow(of: AtlasStore, sized: bool) -> NDArray[np.bool_]:
        found = counted(of, sized)
        if notes.get(LEASE_NAME):  # the run writes its last tile and ends, after the listing and before the next look
            write_tile(handle, (1, 1), last)
            notes.remove(LEASE_NAME)
        return found

    monkeypatch.setattr(tile_records, "done_mask", slow)
    status = read_status(handle)
    assert (status.tiles_done, status.run, status.trouble) == (9, None, "")
    assert ("run", "complete") in status.rows


def test_a_status_looks_at_the_claim_twice_and_counts_the_tiles_once(
    finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted, whole = tile_records.done_mask, LocalBackend.get
    looks: list[str] = []

    def count(of: AtlasStore, sized: bool) -> NDArray[np.bool_]:
        looks.append("tiles")
        return counted(of, sized)

    def read(place: LocalBackend, name: str, part: slice | None = None) -> bytes | None:
        looks.extend([name] * (place.path.suffix == ".run"))
        return whole(place, name, part)

    monkeypatch.setattr(tile_records, "done_mask", count)
    monkeypatch.setattr(LocalBackend, "get", read)
    read_status(open_store(finished))
    assert looks == ["claim", "tiles", "claim"]


def test_a_status_has_the_trouble_that_a_run_reports_in_place_of_the_time_left(finished: Path) -> None:
    trouble = "no job finished for 40 s: Dask has paused 1 worker short of memory: tcp://10.0.0.2:1 (limit 300 MB)"
    reported = {"workers": 1, "cells": 35, "cells_done": 30, "cells_solved": 30, "seconds": 3.0, "trouble": trouble}
    sidecar_of(finished).put_new(LEASE_NAME, claim(reported).pack())
    status = read_status(open_store(finished))
    assert status.as_dict()["trouble"] == trouble
    assert (status.seconds_left, status.as_dict()["cells_per_second"]) == (None, 0.0)
    line = next(line for line in str(status).splitlines() if line.startswith("run "))
    assert line.endswith(trouble)
    assert " left" not in line


@pytest.mark.parametrize("value", [1, None, ["a"], {"a": 1}])
def test_a_trouble_that_is_no_text_is_none(value: object) -> None:
    assert claim({"trouble": value}).trouble == ""


HELD = {"tiles": 4, "regimes": {"periodic": 15, "chaotic": 1}, "reasons": {}}


def test_a_status_is_what_the_run_at_work_says_that_its_store_holds(
    finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tile_records, "done_mask", lambda *_, **__: pytest.fail("the store was listed"))
    sidecar_of(finished).put_new(LEASE_NAME, claim({"holds": HELD}).pack())
    status = read_status(open_store(finished))
    assert (status.tiles_done, status.cells_done, status.regimes) == (4, 16, {"periodic": 15, "chaotic": 1})


@pytest.mark.parametrize(
    "held",
    [
        None,
        7,
        [],
        {"tiles": 4},
        HELD | {"tiles": "4"},
        HELD | {"tiles": True},
        HELD | {"regimes": {"lazy": 1}},
        HELD | {"regimes": {"periodic": -1}},
        HELD | {"regimes": ["periodic"]},
        HELD | {"reasons": {"tired": 1}},
        HELD | {"reasons": None},
    ],
)
def test_a_claim_that_does_not_say_what_the_store_holds_is_not_believed(finished: Path, held: object) -> None:
    sidecar_of(finished).put_new(LEASE_NAME, claim({"holds": held}).pack())
    assert read_status(open_store(finished)).cells_done == 35


def test_a_claim_whose_holder_is_gone_is_not_believed(finished: Path) -> None:
    gone = LeaseRecord("ours", 1, "here", 2**31 - 1, process_name(), progress={"holds": HELD})
    sidecar_of(finished).put_new(LEASE_NAME, gone.pack())
    assert read_status(open_store(finished)).cells_done == 35


def test_a_run_says_in_its_claim_what_its_store_holds(tmp_path: Path, client: Client) -> None:
    path, seen = tmp_path / "out.zarr", []

    def look(progress: Progress) -> None:
        if progress.stage == "solving" and 0 < progress.tiles_done < 9:
            found = StoreCounts.from_lease(LeaseObserver(sidecar_of(path)).observe())
            seen.append(found and (found.tiles, sum(found.regimes.values())))

    timing = Timing(tick=0.0, heartbeat=0.001)
    atlas.run(plane_of(), path, client, atlas.RunOptions(on_progress=look, timing=timing))
    assert any(held and 0 < held[0] < 9 and held[1] > 0 for held in seen)


# Leases that others hold


@pytest.fixture
def claimed_store(tmp_path: Path) -> Callable[[bytes], Path]:
    def make(claim: bytes) -> Path:
        store = create_store(tmp_path / "out.zarr", plane_of((5, 7)), (5, 7)).path
        sidecar_of(store).put_new(LEASE_NAME, claim)
        return store

    return make


def status(store: Path) -> tuple[str, dict[str, object]]:
    """The line of the run, and the object of --json."""
    timing = Timing(lease_poll=0.02, warn_after=0.1)
    text, message = (CliRunner().invoke(main, ["status", str(store), *more], obj=timing) for more in ((), ("--json",)))
    assert (text.exit_code, message.exit_code) == (0, 0)
    line = next(line for line in text.stdout.splitlines() if line.startswith("run "))
    return line.removeprefix("run").strip(), json.loads(message.stdout)


FAR = LeaseRecord("theirs", 7, "far", 1, "another-boot pid:[1] 1 1", progress={"workers": 3})


def test_status_says_that_a_claim_from_elsewhere_stands_still(claimed_store: Callable[[bytes], Path]) -> None:
    line, message = status(claimed_store(FAR.pack()))
    assert line.startswith("no heartbeat from process 1 on far for ")
    assert (message["run"], str(message["trouble"])[:24]) == ("process 1 on far", "no heartbeat from proces")


@pytest.mark.parametrize("damage", [{"beat": "x"}, {"pid": None}, {"progress": [1]}, {"token": 1}])
def test_status_says_that_a_claim_is_damaged(claimed_store: Callable[[bytes], Path], damage: dict[str, object]) -> None:
    line, message = status(claimed_store(json.dumps(json.loads(FAR.pack()) | damage).encode()))
    assert line == "none at work; the lease is damaged; the next run takes it over"
    assert message["run"] is None


def test_status_says_that_a_runs_process_was_killed(claimed_store: Callable[[bytes], Path]) -> None:
    with subprocess.Popen(["sleep", "600"]) as sleeper:
        pid = sleeper.pid
        process = process_name(pid)
        sleeper.kill()
    line, message = status(claimed_store(LeaseRecord("t", 7, "here", pid, process).pack()))
    gone = f"process {pid} on here ended without releasing its lease; the next run takes it over"
    assert (line, message["run"], message["trouble"]) == (f"none at work; {gone}", None, gone)
