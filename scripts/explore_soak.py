"""Random visitors of the explorer for some minutes: is memory bounded, is no tile solved twice, is the store fine?

Usage: python -m scripts.explore_soak STORE [--minutes 20] [--tabs 1] [--seed 1] [--size 1280x800] [--workers 2]

A visitor zooms, drags, draws cuts, follows orbits, and opens the link of a view
that some tab has shown.
Needs chromium, Playwright and Linux. Scheduler and workers are processes of their own; the store is explored in place.
Ends with exit code 1 where a tile of the atlas's plane failed, or was solved twice though memory had room for it, where
a browser complained, or where verifying finds a fault. Memory is printed to be judged, with the slope of
its second half: after the caches are full it should stay.
"""

import argparse
import math
import os
import random
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from statistics import linear_regression

import atlas
from atlas.explore.session import ExplorerSession, explore
from atlas.explore.viewport import TileKey
from tests.support.browser import Tab, opened, started

STAY = 0.5, 6.0
"""Seconds between two moves, at least and at most."""
REPORT = 30.0
"""Seconds between two lines."""
STEPS_IN, DEEPEST = 6, 10
"""Turns of the wheel in one move; after so many in a row it begins anew, about 10^6 deep."""
KINDS = "exponent", "period", "impacts", "combined"
PATIENCE = 300.0
"""Seconds for a page to show its plane, on a machine with much else to do."""
LINKS = 10
"""Views, the latest, whose links a visitor opens."""
BUTTONS = "cut across", "cut up", "close the cut", "follow"
"""What a visitor presses where it is there: cuts and followed orbits."""


def resident(*processes: int) -> float:
    """MiB of memory that processes have now; those that are gone have none."""
    total = 0
    for process in processes:
        try:
            lines = Path(f"/proc/{process}/status").read_text(encoding="ascii", errors="replace").splitlines()
        except (FileNotFoundError, ProcessLookupError):
            continue
        total += sum(int(line.split()[1]) for line in lines if line.startswith("VmRSS:"))
    return total / 2**10


@contextmanager
def processes(workers: int) -> Iterator[tuple[str, int, list[int]]]:
    """A scheduler and its workers: its address, its process, and theirs."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    lines = [["dask_scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]]
    lines += [["dask_worker", address, "--no-nanny", "--nthreads", "1", "--no-dashboard"]] * workers
    quiet = subprocess.DEVNULL
    started = [
        subprocess.Popen([sys.executable, "-m", f"distributed.cli.{name}", *words], stdout=quiet, stderr=quiet)
        for name, *words in lines
    ]
    try:
        yield address, started[0].pid, [process.pid for process in started[1:]]
    finally:
        for process in started:
            process.kill()
            process.wait()


class Visitor:
    """Somebody at the page, who does something at random with each ``move``.

    ``links`` are addresses of views, which all visitors share; ``done`` counts what they did.
    """

    def __init__(self, tab: Tab, links: list[str], done: Counter[str], draw: random.Random) -> None:
        self.tab, self._page, self._links, self._draw, self._depth = tab, tab.page, links, draw, 0
        self._done = done
        tab.until(tab.image, PATIENCE)

    def move(self) -> None:
        """Mostly zoom in at a random point; now and then out, aside, to a cell, a slider, a button or the start."""
        draw, what = self._draw, self._draw.random()
        x, y = self._point()
        self._page.mouse.move(x, y)
        if self._depth >= DEEPEST or what < 0.03:
            self._open(self._links[0])
        elif what < 0.05:
            self._links.append(self.tab.address())
            self._open(draw.choice(self._links[-LINKS:]))
        elif what < 0.1:
            self._page.locator("#look select").select_option(draw.choice(KINDS))
        elif what < 0.15:
            self._page.mouse.click(x, y)
        elif what < 0.17:
            self._page.locator("#parameters input[type=range]").first.focus()
            self._page.keyboard.press(draw.choice(["ArrowLeft", "ArrowRight"]))
        elif what < 0.3:
            self._press(draw.choice(BUTTONS))
        elif what < 0.42:
            self._page.mouse.down()
            self._page.mouse.move(*self._point(), steps=5)
            self._page.mouse.up()
        else:
            inward = what < 0.87
            self._depth = max(0, self._depth + (1 if inward else -2))
            for _ in range(STEPS_IN if inward else 2 * STEPS_IN):
                self._page.mouse.wheel(0.0, -120.0 if inward else 120.0)

    def _press(self, name: str) -> None:
        button = self._page.get_by_role("button", name=name, exact=True)
        if button.count() and button.first.is_visible() and button.first.is_enabled():
            button.first.click()
            self._done[name] += 1

    def _open(self, link: str) -> None:
        self._depth = 0
        self._page.goto(link)
        self.tab.until(self.tab.image, PATIENCE)
        self._done["a link"] += 1

    def _point(self) -> tuple[float, float]:
        left, top, width, height = self.tab.plot()
        return left + self._draw.uniform(0.1, 0.9) * width, top + self._draw.uniform(0.1, 0.9) * height


class Report:
    """What was solved and how much memory everything takes, line by line, and a summary."""

    def __init__(self, running: ExplorerSession, scheduler: int, workers: list[int]) -> None:
        self._running, self._scheduler, self._workers = running, scheduler, workers
        self._begin = time.monotonic()
        self.counts: Counter[TileKey] = Counter()
        self.moves = 0
        self._memory: list[tuple[float, float, float]] = []
        self._minutes: list[float] = []
        plane = running.explorer.subject.plane
        running.explorer.subscribe("soak", lambda of, key: self.counts.update([key] if of == plane else []))

    @property
    def seconds(self) -> float:
        """How long it has lasted."""
        return time.monotonic() - self._begin

    def line(self) -> None:
        """Say how it stands."""
        explorer = self._running.explorer
        memory = resident(os.getpid()), resident(self._scheduler), max(resident(worker) for worker in self._workers)
        self._memory.append(memory)
        self._minutes.append(self.seconds / 60.0)
        server, scheduler, worker = memory
        cached = f"{threading.active_count()} threads, tiles {explorer.tiles.memory.bytes / 2**20:.0f} MiB"
        print(
            f"{self.seconds:5.0f} s  {self.moves:4d} moves  {sum(self.counts.values()):6d} tiles  "
            f"server {server:4.0f}, scheduler {scheduler:4.0f}, largest worker {worker:4.0f} MiB  ({cached})",
            flush=True,
        )

    def summary(self, store: str, complaints: list[str]) -> bool:
        """Print how it went, and return whether nothing was wrong."""
        half = len(self._memory) // 2
        for what, column in zip(
            ("server", "scheduler", "largest worker"), zip(*self._memory, strict=True), strict=True
        ):
            first, last = max(column[: half + 1]), max(column[half:])
            slope = 60.0 * linear_regression(self._minutes[half:], column[half:]).slope if half > 1 else math.nan
            print(
                f"memory of the {what}: at most {first:.0f} MiB in the first half, {last:.0f} MiB in the second", end=""
            )
            print(f", where it rises by {slope:.0f} MiB an hour")
        memory = self._running.explorer.tiles.memory
        was_full = memory.bytes > 0.9 * memory.most
        twice = [key for key, count in self.counts.items() if count > 1]
        again = [] if was_full else twice
        failed = len(self._running.explorer.failures)
        why = "; memory was full, and evicted tiles are solved again" if was_full else ""
        print(f"tiles of the atlas's plane solved twice: {len(twice)} of {len(self.counts)}{why}; failed: {failed}")
        for key in again[:10]:
            print(f"  {key}")
        print(f"complaints of the browser: {len(complaints)}", *sorted(set(complaints)), sep="\n  ")
        verified = atlas.verify(store)
        print(verified)
        return verified.is_sound and not (again or failed or complaints)


def main() -> None:
    """Zoom, report every half minute, verify."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("store")
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--tabs", type=int, default=1, help="each in a browser window of its own, with its own cookies")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--size", default="1280x800", help="of the browser's window, in pixels")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    width, height = map(int, given.size.split("x"))
    draw = random.Random(given.seed)
    with processes(given.workers) as (address, scheduler, workers), started() as browser:
        running = explore(given.store, scheduler=address)
        try:
            report, said = Report(running, scheduler, workers), 0.0
            links, done = [running.url], Counter[str]()
            with ExitStack() as tabs:
                shown = [tabs.enter_context(opened(browser, running.url, width, height)) for _ in range(given.tabs)]
                visitors = [Visitor(tab, links, done, draw) for tab in shown]
                while report.seconds < 60.0 * given.minutes:
                    visitor = draw.choice(visitors)
                    visitor.move()
                    report.moves += 1
                    visitor.tab.page.wait_for_timeout(1e3 * draw.uniform(*STAY) / given.tabs)
                    if report.seconds - said >= REPORT:
                        said = report.seconds
                        report.line()
            report.line()
            print("done:", ", ".join(f"{name} {count}" for name, count in done.most_common()))
        finally:
            running.stop()
    complaints = [said for tab in shown for said in tab.complaints]
    sys.exit(0 if report.summary(given.store, complaints) else 1)


if __name__ == "__main__":
    main()
