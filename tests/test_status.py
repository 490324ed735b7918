"""A status is true at some moment between its question and its answer, whatever the run at work does meanwhile."""

import os
from pathlib import Path

import numpy as np
import pytest

from atlas.service import status as statuses
from atlas.service.lease import Record
from atlas.service.process import this_process
from atlas.service.status import read_status
from atlas.store.sidecar import CLAIM, Folder, notes_of
from atlas.store.store import Header, read_header
from atlas.store.tiles import drop_tile, read_tile, write_tile


def claim(progress: dict[str, object] | None = None) -> Record:
    return Record("ours", 1, "here", os.getpid(), this_process(), progress=progress or {})


def test_a_run_that_ends_while_its_tiles_are_counted_is_not_reported_as_ended_before_its_last_tile(
    finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    header, counted, notes = read_header(finished), statuses.done_mask, notes_of(finished)
    last = read_tile(header, (1, 1))
    drop_tile(header, (1, 1))
    notes.put(CLAIM, claim().pack(), expected=None)

    def slow(of: Header) -> np.ndarray:
        found = counted(of)
        if notes.read(CLAIM):  # the run writes its last tile and ends, after the listing and before the next look
            write_tile(header, (1, 1), last)
            notes.remove(CLAIM, claim().pack())
        return found

    monkeypatch.setattr(statuses, "done_mask", slow)
    status = read_status(header)
    assert (status.tiles_done, status.run, status.trouble) == (9, None, "")
    assert "run      complete" in str(status)


def test_a_status_looks_at_the_claim_twice_and_counts_the_tiles_once(
    finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted, whole = statuses.done_mask, Folder.read
    looks: list[str] = []

    def count(of: Header) -> np.ndarray:
        looks.append("tiles")
        return counted(of)

    def read(notes: Folder, name: str) -> bytes | None:
        looks.append(name)
        return whole(notes, name)

    monkeypatch.setattr(statuses, "done_mask", count)
    monkeypatch.setattr(Folder, "read", read)
    read_status(read_header(finished))
    assert looks == ["claim", "tiles", "claim", "ended"]


def test_a_status_has_the_trouble_that_a_run_reports_in_place_of_the_time_left(finished: Path) -> None:
    trouble = "nothing has ended for 40 s: Dask has paused 1 worker for want of memory: tcp://10.0.0.2:1 (limit 300 MB)"
    reported = {"workers": 1, "cells": 35, "cells_done": 30, "cells_solved": 30, "seconds": 3.0, "trouble": trouble}
    notes_of(finished).put(CLAIM, claim(reported).pack(), expected=None)
    status = read_status(read_header(finished))
    assert status.as_dict()["trouble"] == trouble
    assert (status.seconds_left, status.as_dict()["cells_per_second"]) == (None, 0.0)
    line = next(line for line in str(status).splitlines() if line.startswith("run "))
    assert line.endswith(trouble)
    assert " left" not in line


@pytest.mark.parametrize("value", [1, None, ["a"], {"a": 1}])
def test_a_trouble_that_is_no_text_is_none(value: object) -> None:
    assert claim({"trouble": value}).trouble == ""
