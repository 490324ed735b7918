"""Cells of the packaged plane whose class or digits differ where another kind of processor solves them.

The other kind is pretended: Numba compiles for the oldest 64-bit processor of this architecture, without AVX and fused
multiply-add, OpenBLAS takes its kernels for such a one, and numpy leaves its newer loops out. What stays is this
machine's C library and its versions of all packages.

Usage: python -m scripts.compare_processors [--part kernels|blas|numpy|all] [--light] [--step N] [--json] [--keep]
"""

import argparse
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import atlas
from atlas.spec.examples import example_text
from scripts.measured import parsed, print_table

EXAMPLE = "omega-b"
LIGHT = 40
"""Every so-many-th column and row is solved in the light mode."""
PARTS = {
    "kernels": {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
    "blas": {"OPENBLAS_CORETYPE": "Prescott"},
    "numpy": {"NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR"},
}
"""What pretends another processor to Numba, to the linear algebra of numpy and scipy, and to numpy's own loops."""
PARTS["all"] = {name: value for each in PARTS.values() for name, value in each.items()}
DESCRIBED = {
    "kernels": "the kernels, compiled by Numba",
    "blas": "the linear algebra of numpy and scipy",
    "numpy": "numpy's own vector loops",
    "all": "all three",
}


def coarse_spec(step: int) -> str:
    """The packaged plane with a step-th of its columns and rows."""
    return re.sub(r"(?m)^num = (\d+)", lambda found: f"num = {max(2, int(found[1]) // step)}", example_text(EXAMPLE))


def solve(spec: Path, store: Path, settings: dict[str, str]) -> None:
    """Run a spec in processes with these environment variables."""
    command = [sys.executable, "-m", "atlas", "run", str(spec), "-o", str(store)]
    done = subprocess.run(command, env=os.environ | settings, capture_output=True, encoding="utf-8", check=False)
    if done.returncode:
        sys.exit(done.stderr[-2000:])


def compared(one: Path, other: Path) -> dict[str, Any]:
    """Cells, and in how many of them the class or any bit of any result differs; the largest change of an exponent."""
    first, second = atlas.open(one), atlas.open(other)
    wrong = np.zeros(first["regime"].shape, dtype=bool)
    dims = first["regime"].dims
    for name in first.data_vars:
        a, b = (np.asarray(ds[name].transpose(*dims, ...)) for ds in (first, second))
        differs = (a != b) & ~((a != a) & (b != b))
        wrong |= differs.reshape(*wrong.shape, -1).any(axis=-1)
    change = np.abs(first["largest"].values - second["largest"].values)
    return {
        "cells": wrong.size,
        "digits_differ": int(wrong.sum()),
        "class_differs": int((first["regime"].values != second["regime"].values).sum()),
        "largest_change": float(np.nanmax(change, initial=0.0)),
    }


def main(arguments: list[str] | None = None) -> None:
    """Solve the plane twice and print what differs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--part", choices=PARTS, help="pretend it to this part alone; default: to each, then to all")
    parser.add_argument("--step", type=int, default=1, help="solve every N-th column and row")
    parser.add_argument("--light", action="store_true", help=f"the same as --step {LIGHT}")
    parser.add_argument("--json", action="store_true", help="one JSON object")
    options = parsed(parser, arguments)
    found: dict[str, dict[str, Any]] = {}
    with TemporaryDirectory(prefix="compare-processors-") as folder:
        home = Path(folder)
        spec = home / "plane.toml"
        spec.write_text(coarse_spec(LIGHT if options.light else options.step), encoding="utf-8")
        solve(spec, home / "native.zarr", {})
        for part in [options.part] if options.part else PARTS:
            solve(spec, home / f"{part}.zarr", PARTS[part])
            found[part] = compared(home / "native.zarr", home / f"{part}.zarr")
    if options.json:
        print(json.dumps(found))
        return
    head = ["pretended to", "cells", "with another digit", "with another class", "largest change of an exponent"]
    rows = [[DESCRIBED[part], *map(_text, each.values())] for part, each in found.items()]
    print_table("processors", head, rows, options.keep)


def _text(number: float) -> str:
    """A count, or a change to three digits."""
    return f"{number:.3g}" if isinstance(number, float) else str(number)


if __name__ == "__main__":
    main()
