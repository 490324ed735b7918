"""The picture of the explorer in README.md and docs/: a page on an atlas, zoomed, with a cell in detail.

Usage: python -m scripts.explorer_picture STORE PICTURE.png [--seconds 60]

STORE is of the plane of the example omega-b, at any density. Needs chromium and Playwright. The store
is explored in place; what is solved is kept there.
"""

import argparse
import time

from PIL import Image
from PIL.PngImagePlugin import PngInfo

from atlas.explore.picture_renderer import PictureRenderer
from atlas.explore.session import explore
from atlas.query.open import open_atlas
from atlas.render.provenance import metadata, provenance_of
from tests.support.browser import opened, started

WINDOW = "omega=1.55:2.6&b=0.12:0.34&overlay=boundaries"
SIZE = 1440, 900
CELL = 0.249, 0.35
"""The cell that is clicked, as shares of the plane's width and height: chaos beside an orbit."""


def main() -> None:
    """Open a page, let it solve what is in view, click a cell, and take the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("store")
    parser.add_argument("picture")
    parser.add_argument("--seconds", type=float, default=60.0, help="at most, for what is in view")
    given = parser.parse_args()
    running = explore(given.store)
    try:
        with started() as browser, opened(browser, f"{running.url}&{WINDOW}", *SIZE) as tab:
            end = time.monotonic() + given.seconds
            tab.until(tab.image, 120.0)
            painters = [who for who in running.explorer.listeners if isinstance(who, PictureRenderer)]
            while time.monotonic() < end and any(painter.is_busy for painter in painters):
                tab.page.wait_for_timeout(1e3)
            left, top, width, height = tab.plot()
            x, y = left + CELL[0] * width, top + CELL[1] * height
            tab.page.mouse.click(x, y)
            tab.page.get_by_role("button", name="move the machine").wait_for(timeout=120_000)
            tab.until(lambda: "n-p-q" in tab.text(), 120.0)
            tab.page.mouse.move(x + 40, y - 30)
            tab.page.wait_for_timeout(2e3)
            tab.page.screenshot(path=given.picture)
    finally:
        running.stop()
    sign(given.picture, given.store)


def sign(picture: str, store: str) -> None:
    """Write into a PNG what it says of its numbers."""
    words = PngInfo()
    for name, text in metadata(provenance_of(open_atlas(store)), "png").items():
        words.add_text(name, str(text))
    with Image.open(picture) as image:
        image.load()
    image.save(picture, pnginfo=words)


if __name__ == "__main__":
    main()
