"""The browser outlines regions and enlarges single cells as files of the same map do."""

import re
from typing import Any

import numpy as np
import pytest
import xarray as xr

from atlas.render.coded_maps import coded_maps
from atlas.render.outlines import small_regions
from atlas.render.raster import MAX_MARKS, VISIBLE
from tests import pictures
from tests.explore.modules import FRONT, run

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning:playwright")

SCENE = """
const { drawPlane, drawnAxis, pixelsOf } = await import("/front/plane.mjs")
const { pixel, rgb } = await import("/front/colors.mjs")
const axisOf = (count) => drawnAxis({edges: [0, count], count, log: false})
const sceneOf = (columns, rows, entries, codes) => ({
    axes: [columns, rows].map(axisOf), window: [[0, columns], [0, rows]],
    plot: {left: 0, top: 0, width: 400, height: 200}, hidden: new Set(), lines: {}, names: [],
    shown: {map: {entries}, codes, regions: null, colors: codes.map((code) => pixel(rgb(entries[code].color)))}})
"""
"""Made-up scenes."""


def test_the_browser_finds_the_small_regions_that_render_enlarges(browser: Any) -> None:
    rng = np.random.default_rng(5)
    regime = rng.choice([0, 1, 2], (40, 60), p=[0.6, 0.25, 0.15]).astype(np.uint8)
    script = """
        const { specksOf } = await import("/front/plane.mjs"), { codes, width } = given
        const entries = [{}, {enlarged: "one", color: "#ff0000"}, {enlarged: "two", color: "#00ff00"}]
        return specksOf({ map: { entries }, codes }, width)
    """
    found = run(browser, script, {"codes": regime.ravel().tolist(), "width": 60})
    for code, name in ((1, "one"), (2, "two")):
        expected = small_regions(regime == code, np.arange(61.0), np.arange(41.0), np.ones(2), 2.5)
        boxes = np.array([box[:4] for box in found[name]])
        small = boxes[(np.diff(boxes[:, :2])[:, 0] < 2) & (np.diff(boxes[:, 2:])[:, 0] < 2)]
        middles = np.column_stack([small[:, :2].mean(axis=1), small[:, 2:].mean(axis=1)]) + 0.5
        assert len(expected) > 50
        assert sorted(map(tuple, middles)) == sorted(map(tuple, expected))


def test_the_browser_enlarges_what_is_smaller_than_in_files_and_at_most_as_many() -> None:
    text = (FRONT / "plane.mjs").read_text(encoding="utf-8")
    found = re.search(r"VISIBLE = ([\d.]+) \* POINT, MOST_MARKS = (\d+)", text)
    assert found is not None
    assert (float(found[1]), int(found[2])) == (VISIBLE, MAX_MARKS)


@pytest.mark.parametrize("ds", [pictures.plane(), pictures.every_regime()], ids=["plane", "regimes"])
def test_the_page_knows_the_regions_that_a_file_outlines(ds: xr.Dataset) -> None:
    count = 0
    for made in coded_maps(ds, ds):
        expected = np.zeros(made.codes.shape, dtype=bool)
        for texture in made.layers.textures:
            expected |= False if texture.outlined is None else texture.outlined
        flags = np.array([entry.get("outlined", False) for entry in made.described["entries"]])
        assert np.array_equal(flags[made.codes], expected), made.name
        count += expected.any()
    assert count > 0


def test_cells_without_a_result_are_enlarged_under_the_label_of_their_legend() -> None:
    maps = {made.name: made for made in coded_maps(pictures.every_regime(), pictures.every_regime())}
    entries = maps["exponent"].described["entries"]
    labels = {entry["label"] for entry in maps["exponent"].described["legend"]}
    enlarged = {entry["enlarged"] for entry in entries if "enlarged" in entry}
    assert enlarged == {"undetermined", "invalid", "failed"} and enlarged <= labels


def test_a_single_cell_is_drawn_larger_until_it_is_large_enough_itself(browser: Any) -> None:
    script = (
        SCENE
        + """
        const entries = [{color: "#0000ff"}, {color: "#ff0000", enlarged: "failed"}]
        const drawn = (columns, rows) => {
            const codes = Array(columns * rows).fill(0)
            codes[Math.floor(rows / 2) * columns + Math.floor(columns / 2)] = 1
            const canvas = new OffscreenCanvas(400, 200), pen = canvas.getContext("2d")
            const labels = drawPlane(pen, sceneOf(columns, rows, entries, codes), 1)
            const data = new Uint32Array(pen.getImageData(0, 0, 400, 200).data.buffer)
            return [[...labels].join(), data.filter((one) => one !== pixel(rgb("#0000ff"))).length]
        }
        return [drawn(1600, 800), drawn(40, 20)]"""
    )
    small, large = run(browser, script)
    assert small[0] == "failed" and 4 <= small[1] <= 16  # of a quarter of a pixel
    assert large == ["", 100]


def test_the_border_of_an_outlined_region_is_drawn_and_the_frame_of_the_plane_is_not(browser: Any) -> None:
    script = (
        SCENE
        + """
        const entries = [{color: "#0000ff"}, {color: "#0000ff", outlined: true}]
        const codes = Array.from({length: 800}, (_, k) => Number(k % 40 < 20))
        const {data} = pixelsOf(sceneOf(40, 20, entries, codes), 1), words = new Uint32Array(data.buffer)
        return [...words.entries()].filter(([, one]) => one === pixel(rgb("#1a2433"))).map(([k]) => k % 400)"""
    )
    columns = run(browser, script)
    assert len(columns) == 200 and {*columns} == {199}


def test_ticks_of_a_window_a_million_times_smaller_count_from_a_round_number(browser: Any) -> None:
    low, high = 2.9941234567, 2.9941234567 + 3.5e-6
    script = """
        const { tickFormat } = await import("/front/plane.mjs")
        return given.map(([low, high]) => tickFormat({ label: "omega" }, low, high))
    """
    found, wide = run(browser, script, [[low, high], [2.0, 4.0]])
    assert low - 1e-5 < found["base"] < high + 1e-5 and len(repr(found["base"])) <= 9
    assert found["unit"] == pytest.approx(1e-6) and found["label"] == f"omega: distance from {found['base']} in 10⁻⁶"
    assert wide == {"base": 0, "unit": 1, "label": "omega"}
