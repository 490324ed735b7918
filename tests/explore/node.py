"""The modules of the pages run by the Node that Playwright brings along, or by the system's."""

import json
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import atlas
from atlas.explore.front.numbers import pack
from atlas.query.plane import Plane
from atlas.render.coded import CodedMap

FRONT = Path(atlas.__file__).parent / "explore/front"
COLORS = """
import { readFileSync } from "node:fs"
const numbers = await import(`${process.argv[1]}/numbers.mjs`), colors = await import(`${process.argv[1]}/colors.mjs`)
for (const { map, arrays, width, ends } of JSON.parse(readFileSync(0, "utf-8"))) {
    const found = {}
    for (const [name, { type, text }] of Object.entries(arrays))
        found[name] = await numbers.unpacked(Buffer.from(text, "base64"), type, width)
    for (const each of ends) process.stdout.write(Buffer.from(colors.colorsOf(map, found.codes, found, each).buffer))
}
"""


def node() -> str:
    """The program; tests skip where there is none."""
    try:
        from playwright._impl._driver import compute_driver_executable

        return str(compute_driver_executable()[0])
    except ImportError:
        found = shutil.which("node")
        return found if found is not None else pytest.skip("needs Playwright or Node")


def run(script: str, given: Any) -> bytes:
    """What a script writes that gets the folder of the shared modules as its argument, and JSON to read."""
    words = [node(), "--input-type=module", "-e", script, FRONT.as_uri()]
    done = subprocess.run(words, input=json.dumps(given).encode(), capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout


Ends = tuple[float, float] | None


def colored(
    maps: Sequence[tuple[CodedMap, Plane]], ends: Sequence[Ends]
) -> Iterator[tuple[CodedMap, Ends, np.ndarray]]:
    """The colours (y, x, 4) that JavaScript gives the cells of maps, on scales with each of these ends."""
    given = []
    for made, plane in maps:
        arrays = {"codes": made.codes} | {name: narrow(plane[name]) for name in made.needs}
        packed = {name: pack(values) for name, values in arrays.items()}
        texts = {name: {"type": each.type, "text": each.text} for name, each in packed.items()}
        given.append({"map": made.described, "arrays": texts, "width": made.codes.shape[1], "ends": ends})
    found, begin = np.frombuffer(run(COLORS, given), np.uint8), 0
    for made, _ in maps:
        for each in ends:
            size = 4 * made.codes.size
            yield made, each, found[begin : begin + size].reshape(*made.codes.shape, 4)
            begin += size
    assert begin == found.size


def narrow(values: np.ndarray) -> np.ndarray:
    """Values of a type that stores have."""
    return values.astype(np.int32) if values.dtype == np.int64 else values
