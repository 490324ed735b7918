"""The picture of the explorer in README.md and docs/: a page on an atlas, zoomed, with a cell in detail.

Usage: python -m scripts.explorer_picture STORE PICTURE.png [--seconds 60]

Needs chromium and Playwright. The store is explored in place; what is solved is kept there.
"""

import argparse
import shutil
import time

from playwright.sync_api import sync_playwright

from atlas.explore.painter import Painter
from atlas.explore.session import explore

WINDOW = "omega=1.55:2.6&b=0.12:0.34&overlay=grazing"
SIZE = 1440, 820
CELL = 640, 470
PAINTED = """() => window.Bokeh && Bokeh.documents.length && [...Bokeh.documents[0]._all_models.values()].some(
    (model) => model.type === "ColumnDataSource" && model.data.image && model.data.image.length)"""


def main() -> None:
    """Open a page, let it solve what is in view, click a cell, and take the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("store")
    parser.add_argument("picture")
    parser.add_argument("--seconds", type=float, default=60.0, help="at most, for what is in view")
    given = parser.parse_args()
    running = explore(given.store)
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
            page = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
            page.goto(f"{running.url}?{WINDOW}")
            end = time.monotonic() + given.seconds
            page.wait_for_function(PAINTED, timeout=120_000)
            painters = [who for who in running.explorer.listeners if isinstance(who, Painter)]
            while time.monotonic() < end and any(painter.busy for painter in painters):
                time.sleep(1.0)
            page.mouse.click(*CELL)
            page.locator("img.portrait").wait_for(timeout=60_000)
            page.mouse.move(CELL[0] + 40, CELL[1] - 30)
            time.sleep(2.0)
            page.screenshot(path=given.picture)
            browser.close()
    finally:
        running.stop()


if __name__ == "__main__":
    main()
