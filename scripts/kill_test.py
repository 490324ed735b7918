"""Kill -9 workers, scheduler and coordinator of a running atlas, again and again, and see that nothing is lost.

A scheduler, two workers and a coordinator run as processes of their own. Every few tiles one of them, drawn at random,
is killed and started again; the atlas that comes out is compared, array by array and bit by bit, with one solved in
peace, and the attempts at tiles are counted: a kill may cost those that were under way, and no other.
Usage: .venv/bin/python -m scripts.kill_test [--kills N] [--seed S]
"""

import argparse
import math
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from atlas.store.store import open_store
from atlas.store.tiles import read_tile
from tests.support.faults import attempts, environment

WORKERS = 2
IN_FLIGHT = {"worker": 1, "scheduler": WORKERS, "coordinator": WORKERS}
"""Tiles under way that the death of each may cost; every worker has one thread."""
COORDINATOR = """import sys, atlas
atlas.run(atlas.Spec.from_toml(sys.argv[1]), sys.argv[2], options=atlas.RunOptions(scheduler=sys.argv[3]))
"""


@dataclass(frozen=True)
class Report:
    """What came of it. ``again`` is how many attempts at tiles were more than one each, ``bound`` how many may be.

    >>> Report(tiles=4, kills=Counter(worker=1), again=1, bound=1, different=(), seconds=1.0).passed
    True
    >>> Report(tiles=4, kills=Counter(worker=1), again=2, bound=1, different=(), seconds=1.0).passed
    False
    >>> Report(tiles=4, kills=Counter(worker=1), again=1, bound=1, different=("regime",), seconds=1.0).passed
    False
    """

    tiles: int
    kills: Counter[str]
    again: int
    bound: int
    different: tuple[str, ...]
    seconds: float

    @property
    def passed(self) -> bool:
        """Whether nothing was lost and no more was redone than what was under way."""
        return not self.different and self.again <= self.bound

    def __str__(self) -> str:
        shown = ", ".join(f"{count} {victim}" for victim, count in sorted(self.kills.items()))
        same = f"differ in {', '.join(self.different)}" if self.different else "bit for bit as undisturbed"
        return (
            f"{self.tiles} tiles, {self.kills.total()} kills ({shown}) in {self.seconds:.0f} s\n"
            f"arrays {same}\n"
            f"attempts at tiles beyond the first: {self.again} (under way when killed: at most {self.bound})"
        )


class Deployment:
    """A scheduler, its workers and a coordinator, each a process that can be killed and is started again."""

    def __init__(self, folder: Path, spec: Path, store: Path, env: dict[str, str]) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        run = [sys.executable, "-c", COORDINATOR, str(spec), str(store), address]
        dask = [sys.executable, "-m"]
        serve = [*dask, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", address.rpartition(":")[2]]
        labour = [*dask, "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
        self.commands = {"scheduler": [*serve, "--no-dashboard"], "coordinator": run}
        self.commands |= {f"worker {k}": [*labour, "--local-directory", str(folder)] for k in range(WORKERS)}
        self.env = env
        self.log: IO[bytes] = open(folder / "processes.log", "wb")  # noqa: SIM115
        self.processes: dict[str, subprocess.Popen[bytes]] = {}

    def keep_up(self) -> bool:
        """Start what does not run; False once the coordinator has ended well."""
        for name, command in self.commands.items():
            process = self.processes.get(name)
            if process is None or process.poll() is not None:
                if process is not None and name == "coordinator" and process.returncode == 0:
                    return False
                self.processes[name] = subprocess.Popen(command, env=self.env, stdout=self.log, stderr=self.log)
        return True

    def kill(self, name: str) -> bool:
        """Kill -9 one of them; False where it had ended by itself."""
        process = self.processes[name]
        if process.poll() is not None:
            return False
        process.send_signal(signal.SIGKILL)
        process.wait()
        return True

    def close(self) -> None:
        """End all that is left."""
        for process in self.processes.values():
            with suppress(ProcessLookupError):
                process.kill()
            process.wait()
        self.log.close()


def kill_test(folder: Path, kills: int, seed: int, say: Callable[[str], None] = lambda _: None) -> Report:
    """Run an atlas in a folder, under that many kills, and compare it with one solved in this process."""
    draw = random.Random(seed)
    spec_file, store, faults = folder / "spec.toml", folder / "out.zarr", folder / "faults"
    side = math.ceil((5 * kills) ** 0.5)  # tiles enough for all kills to find some left
    spec_file.write_text(_spec(side))
    env = environment(faults, {"*": ["slow"]})
    deployment = Deployment(folder, spec_file, store, env)
    done: Counter[str] = Counter()
    begin, due = time.monotonic(), draw.randint(1, 3)
    try:
        while deployment.keep_up():
            time.sleep(0.02)
            if done.total() < kills and attempts(faults).total() >= due:
                time.sleep(0.3 * draw.random())  # at any moment of a tile
                name = draw.choice(["scheduler", "coordinator", *(f"worker {k}" for k in range(WORKERS))])
                if deployment.kill(name):
                    done[name.split()[0]] += 1
                    say(f"kill {done.total()}: {name}, {attempts(faults).total()} attempts at tiles so far")
                due = attempts(faults).total() + draw.randint(1, 4)
    finally:
        deployment.close()
    seconds = time.monotonic() - begin
    tried = attempts(faults)
    bound = sum(IN_FLIGHT[victim] * count for victim, count in done.items())
    return Report(len(tried), done, tried.total() - len(tried), bound, _differences(store), seconds)


def _differences(store: Path) -> tuple[str, ...]:
    """Variables of a store that are not what solve_tile gives, tile by tile."""
    from workers.tile import solve_tile

    handle = open_store(store)
    spec, found = handle.spec, set()
    for tile in handle.tiling.tiles():
        stored = read_tile(handle, tile.index)
        for name, values in solve_tile(spec.system_def, spec.cell_params(tile.slices), spec.settings).items():
            if stored[name].dtype != values.dtype or stored[name].tobytes() != np.ascontiguousarray(values).tobytes():
                found.add(name)
    return tuple(sorted(found))


def _spec(side: int) -> str:
    return f"""
system = "two-mass"
[axes.omega]
start = 2.0
stop = 4.0
num = {side}
[axes.b]
start = 0.1
stop = 0.5
num = {side}
[solve]
exponents = "spectrum"
max_periods = 300
tolerance = 0.1
section_samples = 2
[store]
tile = [1, 1]
"""


def main(argv: list[str] | None = None) -> int:
    """Print the report; 1 where something was lost, or more redone than was under way."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args(argv)
    with tempfile.TemporaryDirectory(prefix="kill-test-") as folder:
        report = kill_test(Path(folder), given.kills, given.seed, say=lambda text: print(text, flush=True))
    print(report)
    return int(not report.passed)


if __name__ == "__main__":
    sys.exit(main())
