"""The modules of the pages, run in a browser: they are served at ``/front`` and ``/static`` of a host of no network."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import atlas
from atlas.explore.front.numbers import pack
from atlas.query.plane import Plane
from atlas.render.coded_maps import CodedMap

FRONT = Path(atlas.__file__).parent / "explore/front"
COLORS = """
const numbers = await import("/front/numbers.mjs"), colors = await import("/front/colors.mjs"), found = []
for (const { map, arrays, width, ends } of given) {
    const read = {}
    for (const [name, { type, text }] of Object.entries(arrays))
        read[name] = await numbers.unpacked(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)), type, width)
    for (const each of ends) found.push(...colors.colorsOf(map, read.codes, read, each))
}
return found
"""
Ends = tuple[float, float] | None


def run(browser: Any, script: str, given: Any = None) -> Any:
    """The value that a script returns: the body of an asynchronous function of ``given``, which may import modules."""

    def serve(route: Any) -> None:
        file = FRONT.parent / route.request.url.removeprefix("http://modules.test/")
        if file.suffix == ".mjs":
            route.fulfill(body=file.read_text(encoding="utf-8"), content_type="text/javascript")
        else:
            route.fulfill(body="", content_type="text/html")

    page = browser.new_page()
    try:
        page.route("**/*", serve)
        page.goto("http://modules.test/")
        return page.evaluate(f"async (given) => {{ {script} }}", given)
    finally:
        page.close()


def colored(
    browser: Any, maps: Sequence[tuple[CodedMap, Plane]], ends: Sequence[Ends]
) -> Iterator[tuple[CodedMap, Ends, np.ndarray]]:
    """The colours (y, x, 4) that JavaScript gives the cells of maps, on scales with each of these ends."""
    given = []
    for made, plane in maps:
        arrays = {"codes": made.codes} | {name: narrow(plane[name]) for name in made.needs}
        packed = {name: pack(values) for name, values in arrays.items()}
        texts = {name: {"type": file.type, "text": file.text} for name, file in packed.items()}
        given.append({"map": made.described, "arrays": texts, "width": made.codes.shape[1], "ends": ends})
    found, begin = np.array(run(browser, COLORS, given), "<u4").view(np.uint8), 0
    for made, _ in maps:
        for end in ends:
            size = 4 * made.codes.size
            yield made, end, found[begin : begin + size].reshape(*made.codes.shape, 4)
            begin += size
    assert begin == found.size


def narrow(values: np.ndarray) -> np.ndarray:
    """Values of a type that stores have."""
    return values.astype(np.int32) if values.dtype == np.int64 else values
