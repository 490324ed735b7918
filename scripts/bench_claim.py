"""What it costs many workers to read the claim of their run, on a folder that they share, while it is renewed.

Each reader is a thread that looks at the claim as a worker does before a write, again and again; many share a process,
so that the figures bound what a file system is asked for, not the time of a thread. The coordinator, a process of its
own, rewrites the claim as often as it can, a thousand times more often than a run does. A read that finds no token, or
any lock that a reader asks for, is counted.

Usage: python -m scripts.bench_claim [--readers N] [--seconds S] [--folder PATH]
"""

import argparse
import json
import multiprocessing
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.synchronize import Event
from pathlib import Path
from unittest import mock

import numpy as np

from atlas.store import sidecar
from atlas.store.sidecar import CLAIM, Folder, claim_token

READERS = 200
TOKEN = "of the run"


@dataclass(frozen=True)
class Readings:
    """Reads of the claim in all, those without its token, locks taken by readers, renewals, and percentiles in ms."""

    reads: int
    torn: int
    locks: int
    renewals: int
    median: float
    most: float


def measure(folder: Path, readers: int, seconds: float) -> Readings:
    """Have so many readers look at one claim in a folder while it is renewed."""
    notes, begin, locks = Folder(folder), threading.Barrier(readers + 1), [0]
    notes.put(CLAIM, _note(0), expected=None)
    times: list[list[float]] = [[] for _ in range(readers)]
    torn = [0] * readers

    def read(number: int) -> None:
        begin.wait()
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            start = time.perf_counter()
            token = claim_token(notes)
            times[number].append(time.perf_counter() - start)
            torn[number] += token != TOKEN

    def counted(*_: object) -> None:
        locks[0] += 1
        raise AssertionError("a reader asks for a lock")

    with _renewed(folder), mock.patch.object(sidecar, "file_lock", counted):
        threads = [threading.Thread(target=read, args=(number,)) for number in range(readers)]
        for thread in threads:
            thread.start()
        begin.wait()
        for thread in threads:
            thread.join()
    taken = 1e3 * np.concatenate([np.asarray(each) for each in times])
    renewals = int(json.loads(notes.read(CLAIM) or b"{}")["beat"])
    return Readings(taken.size, sum(torn), locks[0], renewals, float(np.median(taken)), float(taken.max()))


def _note(beat: int) -> bytes:
    return json.dumps({"token": TOKEN, "beat": beat}).encode()


def _renew(folder: Path, stopped: Event) -> None:
    notes, beat = Folder(folder), 0
    while not stopped.is_set():
        notes.put(CLAIM, _note(beat + 1), expected=_note(beat))
        beat += 1


@contextmanager
def _renewed(folder: Path) -> Iterator[None]:
    """A process that renews the claim in a folder; at the end it has done so at least once."""
    context = multiprocessing.get_context("spawn")
    stopped = context.Event()
    coordinator = context.Process(target=_renew, args=(folder, stopped))
    coordinator.start()
    notes = Folder(folder)
    try:
        while notes.read(CLAIM) == _note(0):
            time.sleep(0.01)
        yield
    finally:
        stopped.set()
        coordinator.join()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--readers", type=int, default=READERS)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--folder", type=Path, help="on the file system to be measured; default: a temporary one")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=args.folder) as folder:
        found = measure(Path(folder), args.readers, args.seconds)
    print(
        f"{args.readers} readers, {args.seconds:g} s: {found.reads} reads ({found.reads / args.seconds:.0f} a second), "
        f"{found.torn} without the token, {found.locks} locks, {found.renewals} renewals; "
        f"median {found.median:.3g} ms, at most {found.most:.3g} ms"
    )


if __name__ == "__main__":
    main()
