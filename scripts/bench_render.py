"""What a picture and a share cost on a large atlas: seconds, peak memory, chunks read, of a whole plane and a window.

    python -m scripts.bench_render                      # 10^4 x 10^4 synthetic cells; made once, some minutes
    python -m scripts.bench_render --cells 1000 --store /tmp/small.zarr

The atlas is made up (bands of periodic motion in a chaotic sea, a few doubtful cells), so that its size costs no
solving; store and overviews are written as a run writes them. Each question is a process of its own, imports included.
"""

import argparse
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from atlas.overview.builder import OverviewBuilder
from atlas.spec.spec import Spec
from atlas.store.create import create_store
from atlas.store.store import done_tiles, find_store
from atlas.store.tile_records import complete_records
from atlas.store.tiles import write_tile
from atlas.store.tiling import Tile
from scripts.measured import parsed, print_table
from workers.results import CHAOTIC, FAILED, GAVE_UP, PERIODIC, UNDETERMINED, empty_results, result_variables

COUNTS = ("MB", "chunks")
WINDOW = ("--window", "omega=2.5:2.6", "--window", "b=0.2:0.22")


def synthetic(spec: Spec, tile: Tile) -> dict[str, np.ndarray]:
    """Made-up results of a tile; one cell in about 10^4 is undetermined, one of all failed."""
    shape = tuple(part.stop - part.start for part in tile.slices)
    sizes = {"exponent": 4, "state": 4, "sample": 0}
    arrays = empty_results(result_variables(spec.settings), shape, sizes)
    params = spec.cell_params(tile.slices)
    omega, b = np.broadcast_arrays(params["omega"], params["b"])
    wave = np.sin(9.0 * omega * (1.0 + b)) + np.sin(60.0 * b - 4.0 * omega)
    arrays["largest"][...] = np.round(np.where(wave > 0.6, 0.5 * (wave - 0.6), 0.8 * (wave - 0.6)), 3)
    arrays["error"][...] = 1e-3
    regime = arrays["regime"]
    regime[...] = np.where(arrays["largest"] > 0, CHAOTIC, PERIODIC)
    arrays["period"][...] = np.where(regime == PERIODIC, 1 + np.floor(8 * (b - spec.axes[1].values[0])), 0)
    arrays["periods_used"][...] = 1000
    rows, columns = (np.arange(part.start, part.stop) for part in tile.slices)
    doubtful = (rows[:, None] * 7919 + columns * 104729) % 10007 == 0
    regime[doubtful] = UNDETERMINED
    if all(part.start <= 1234 < part.stop for part in tile.slices):
        regime[1234 - tile.slices[0].start, 1234 - tile.slices[1].start] = FAILED
    arrays["reason"][regime == FAILED] = GAVE_UP
    arrays["largest"][regime >= UNDETERMINED] = np.nan
    return arrays


def make(path: Path, cells: int, tile: int) -> dict[str, float]:
    """Write the synthetic atlas, or what of it is missing; seconds for its tiles and for its overviews."""
    axes = {
        "omega": {"start": 2.0, "stop": 4.0, "num": cells},
        "b": {"start": 0.05, "stop": 0.5, "num": cells},
    }
    spec = Spec("two-mass", axes=axes, store={"tile": [tile, tile]})
    handle = find_store(path) or create_store(path, spec, (tile, tile))
    done = done_tiles(handle)
    missing = [due for due in handle.tiling.tiles() if due.index not in done]
    begin = time.perf_counter()
    overviews = OverviewBuilder(handle)
    for count, due in enumerate(missing):
        if count % 100 == 0:
            print(f"writing tile {count} of {len(missing)}", file=sys.stderr)
        write_tile(handle, due.index, synthetic(spec, due))
    complete_records(handle)
    middle = time.perf_counter()
    print("writing overviews", file=sys.stderr)
    overviews.finish()
    return {"tiles": middle - begin, "overviews": time.perf_counter() - middle}


def ask(*command: str) -> dict[str, Any]:
    """One ``atlas`` command as a process: seconds, those of the processor, peak MB, chunks read as it says."""
    code = (
        "import atexit, sys; from pathlib import Path; from atlas.cli.main import main\n"
        "atexit.register(lambda: print(Path('/proc/self/status').read_text(), file=sys.stderr))\n"
        "main(sys.argv[1:])"
    )
    with tempfile.TemporaryFile("w+") as output:
        before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        ended = subprocess.run([sys.executable, "-c", code, *command], stdout=output, stderr=output, check=False)
        seconds, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
        output.seek(0)
        text = output.read()
    if ended.returncode:
        raise SystemExit(f"atlas {' '.join(command)}: {text}")
    chunks = re.search(r"(\d+) chunks? read", text)
    peak = re.search(r"VmHWM:\s+(\d+) kB", text)  # of this process alone, which its exit status would not give
    return {
        "seconds": seconds,
        "cpu": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
        "MB": int(peak[1]) / 1e3 if peak else None,
        "chunks": int(chunks[1]) if chunks else None,
    }


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Make the atlas, ask, print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=10_000, help="cells along each axis")
    parser.add_argument("--tile", type=int, default=250, help="cells along each side of a tile")
    parser.add_argument("--store", type=Path, default=Path("build/bench-render.zarr"))
    parser.add_argument("--light", action="store_true", help="ask for shares only")
    given = parsed(parser, arguments)
    made = make(given.store, given.cells, given.tile)
    store = str(given.store)
    with tempfile.TemporaryDirectory() as folder:
        picture = str(Path(folder) / "map.png")
        questions = {
            "chaos map of the whole plane": ("plot", store, "-o", picture),
            "period map of the whole plane": ("plot", store, "-o", picture, "--kind", "period"),
            "chaos map of a window of 500 × 444 cells": ("plot", store, "-o", picture, *WINDOW),
            "fractions of the whole plane": ("query", store),
            "fractions of the window": ("query", store, *WINDOW),
            "status": ("status", store),
        }
        found = {name: ask(*words) for name, words in questions.items() if "fractions" in name or not given.light}
    print(f"{given.cells} x {given.cells} cells in tiles of {given.tile}")
    print(f"written now in {made['tiles']:.1f} s, overviews in {made['overviews']:.1f} s")
    rows = [
        [
            name,
            f"{row['seconds']:.1f}",
            f"{row['cpu']:.1f}",
            *("-" if row[k] is None else f"{row[k]:.0f}" for k in COUNTS),
        ]
        for name, row in found.items()
    ]
    print_table("render", ["question", "seconds", "seconds of CPU", "peak MB", "chunks read"], rows, given.keep)
    return found


if __name__ == "__main__":
    main()
