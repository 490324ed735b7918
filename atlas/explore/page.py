"""The page: the plane with its axes, its colours, the controls, the cell under the pointer, and a line on the work.

The ranges of the axes belong to the browser. This side learns of them and sends images; setting them from here would
race with the user.
"""

import html
import logging
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.events import MouseLeave, MouseMove, RangesUpdate, SelectionGeometry, Tap
from bokeh.layouts import column, row
from bokeh.models import (
    ColumnDataSource,
    CustomJS,
    Div,
    GlobalInlineStyleSheet,
    InlineStyleSheet,
    Toggle,
)

from atlas.errors import InputError
from atlas.explore.actions import new_atlas, picture_file
from atlas.explore.background import Background
from atlas.explore.chosen import Chosen, from_address, to_address
from atlas.explore.controls import Controls
from atlas.explore.details import Details
from atlas.explore.explorer import Explorer
from atlas.explore.painter import KEY_WIDTH, Painted, Painter
from atlas.explore.plot import label_axes, make_plot
from atlas.explore.style import FOLD, KEY, LINE, MIDDLE, PAGE, PANEL, PLANE, TEXT, WHOLE
from atlas.explore.words import png_address, progress, title
from atlas.render import SCALAR

LEFT, RIGHT = 232, 320
"""Widths of the columns beside the plane, in pixels, where the page is wide enough to have them there."""
FOLDED = "folded"
"""The class of controls that a page of a single column hides."""
LINE_HEIGHT = 20
LEAST = 16
"""Pixels of a plane that is worth drawing."""


def fill(document: Document, explorer: Explorer, folder: Path, pages: "set[Page]") -> None:
    """Make a page of a document, one of ``pages`` while it lasts; specs of new atlases are written into the folder."""
    context = document.session_context
    arguments = context.request.arguments if context is not None and context.request is not None else {}
    trouble = ""
    try:
        chosen = from_address(explorer.subject, arguments)
    except InputError as error:
        chosen, trouble = from_address(explorer.subject, {}), str(error)
    try:
        page = Page(document, explorer, chosen, folder)
    except Exception:
        logging.getLogger(__name__).exception("a page could not be made")
        raise
    page.trouble = trouble
    pages.add(page)

    def end(_: Any) -> None:
        pages.discard(page)
        page.close()

    document.on_session_destroyed(end)


class Page:
    """One page, of one browser's tab."""

    def __init__(self, document: Document, explorer: Explorer, chosen: Chosen, folder: Path) -> None:
        self._document, self._explorer, self._subject = document, explorer, explorer.subject
        self._chosen, self._folder = chosen, folder
        self._rests, self.trouble = True, ""
        self._box: tuple[tuple[float, float], tuple[float, float]] | None = None
        self._ends: tuple[float | None, float | None] = (None, None)
        self._controls = Controls(self._subject, chosen)
        self._background = Background(document, self._refused)
        self._sizes: dict[str, int] = {}
        self._plot, self._image, mark = make_plot(self._subject, chosen)
        self._details = Details(explorer, self._background, lambda: (self._chosen.plane, self._painter.sight), mark)
        self._make_panels()
        self._wire()
        document.title = f"{self._subject.name}: explorer"
        document.add_root(self._layout())
        document.add_periodic_callback(self._say_progress, 500)
        self._painter = Painter(
            explorer,
            lambda painted: self._background.show(partial(self._show, painted)),
            lambda why: self._background.show(partial(self._unpainted, why)),
        )

    def close(self) -> None:
        """Free what the page holds."""
        self._background.close()
        self._details.close()
        self._painter.close()

    def wait(self) -> None:
        """Wait until nothing of a page that is closed is at work any more."""
        self._painter.wait()
        self._background.wait()

    def _make_panels(self) -> None:
        style: dict[str, Any] = {"stylesheets": [TEXT]}
        # Of fixed height, whatever they say: else the plane would change its size with every word.
        line: dict[str, Any] = {"stylesheets": [TEXT, LINE], "sizing_mode": "stretch_width", "height": LINE_HEIGHT}
        self._title = Div(text=title(self._subject, self._chosen.plane), **line)
        self._key = Div(width=KEY_WIDTH, sizing_mode="stretch_height", margin=0, stylesheets=[TEXT, KEY])
        self._line = Div(**line)
        self._made = Div(sizing_mode="stretch_width", visible=False, **style)
        self._address = Div(visible=False)
        self._download = ColumnDataSource({"name": [], "href": []})

    def _wire(self) -> None:
        """Connect events with what they lead to."""
        plot, controls = self._plot, self._controls
        plot.on_event(RangesUpdate, self._moved)
        plot.on_event(MouseMove, self._details.point)
        plot.on_event(MouseLeave, lambda _: self._details.leave())
        plot.on_event(Tap, self._details.click)
        plot.on_event(SelectionGeometry, self._boxed)
        plot.on_change("inner_width", self._resized)
        plot.on_change("inner_height", self._resized)
        for widget, name in (
            (controls.kind, "value"),
            (controls.variable, "value"),
            (controls.log, "active"),
            (controls.overlays, "active"),
            (controls.vmin, "value"),
            (controls.vmax, "value"),
        ):
            widget.on_change(name, _heard(self._chose))
        for name, slider in controls.sliders.items():
            slider.on_change("value", partial(self._slid, name))
        controls.rescale.on_click(self._rescale)
        controls.keep.on_click(lambda on: self._explorer.keep_plane(self._chosen.plane) if on else None)
        for suffix, button in controls.files.items():
            button.on_click(partial(self._save, suffix))
        controls.make.on_click(self._make)
        script = "window.history.replaceState(null, '', '?' + cb_obj.text)"
        self._address.js_on_change("text", CustomJS(code=script))
        script = """
            const link = document.createElement("a")
            link.href = cb_obj.data["href"][0]; link.download = cb_obj.data["name"][0]; link.click()
        """
        self._download.js_on_change("data", CustomJS(code=script))

    def _layout(self) -> Any:
        controls, panel = (
            self._controls,
            {"stylesheets": [InlineStyleSheet(css=PANEL)], "sizing_mode": "stretch_height"},
        )
        states = controls.sliders_of(states=True)
        left = column(
            controls.kind, controls.variable, controls.log,
            row(controls.vmin, controls.vmax, sizing_mode="stretch_width"), controls.rescale,
            controls.heading("lines over it"), controls.overlays,
            controls.heading("parameters"), *controls.sliders_of(states=False), controls.keep,
            controls.heading("save the picture"), row(*controls.files.values(), sizing_mode="stretch_width"),
            controls.heading("a new atlas of the view, or of a box"), controls.cells, controls.make,
            *([controls.heading("initial state"), *states] if states else []),
            width=LEFT, css_classes=[FOLDED], **panel,
        )  # fmt: skip
        fold = Toggle(label="controls", sizing_mode="stretch_width", stylesheets=[FOLD])
        unfolding = CustomJS(args={"left": left}, code=f"left.css_classes = cb_obj.active ? [] : ['{FOLDED}']")
        fold.js_on_change("active", unfolding)
        plane = row(self._plot, self._key, sizing_mode="stretch_both", stylesheets=[PLANE])
        middle = column(
            self._title, plane, self._line, fold, sizing_mode="stretch_both", stylesheets=[MIDDLE]
        )  # fmt: skip
        right = column(self._made, *self._details.panels, self._address, width=RIGHT, **panel)
        # A source without a view is sent along, and heard, as the tag of a model that has one.
        self._address.tags = [self._download]
        whole = row(left, middle, right, sizing_mode="stretch_both")
        whole.stylesheets = [GlobalInlineStyleSheet(css=PAGE), InlineStyleSheet(css=WHOLE)]
        return whole

    def _update(self) -> None:
        """Have what is chosen shown, and say it in the address."""
        size = (self._sizes.get("inner_width", 0), self._sizes.get("inner_height", 0))
        if min(size) < LEAST:  # the browser has not laid it out yet
            return
        self._painter.show(self._chosen, size, self._rests)
        self._address.text = to_address(self._subject, self._chosen)

    def _resized(self, attr: str, old: Any, new: Any) -> None:
        self._sizes[attr] = int(new or 0)
        self._update()

    def _moved(self, event: RangesUpdate) -> None:
        ends = (event.x0, event.x1, event.y0, event.y1)
        left, right, low, high = (float("nan") if end is None else float(end) for end in ends)
        if not (left < right and low < high and np.isfinite([left, right, low, high]).all()):
            return
        self._chosen, self._rests = replace(self._chosen, x=(left, right), y=(low, high)), True
        label_axes(self._plot, self._subject, self._chosen)
        self._update()

    def _chose(self) -> None:
        controls = self._controls
        controls.variable.visible = controls.log.visible = controls.kind.value == SCALAR
        self._chosen, self._rests, self.trouble = replace(self._chosen, **controls.read()), True, ""
        self._update()

    def _slid(self, name: str, attribute: str, old: Any, new: Any) -> None:
        plane = self._subject.moved(self._chosen.plane, name, float(new))
        self._chosen, self._rests = replace(self._chosen, plane=plane), False
        self._title.text = title(self._subject, plane)
        self._details.draw_mark()
        self._controls.keep.update(
            visible=plane != self._subject.plane and self._subject.header is not None, active=False
        )
        self._update()

    def _rescale(self) -> None:
        self._controls.vmin.value = self._controls.vmax.value = None
        self._painter.rescale()

    def _show(self, painted: Painted) -> None:
        """Put a picture on the page."""
        pixels = np.ascontiguousarray(painted.cells[::-1]).view(np.uint32)[..., 0]
        (left, right), (low, high) = painted.x, painted.y
        self._image.data = {"image": [pixels], "x": [left], "y": [low], "dw": [right - left], "dh": [high - low]}
        above = int(np.argmax(np.any(painted.key[..., :3] != 255, axis=(1, 2))))  # rows of white
        self._key.text = f'<img style="--above: {above}px" src="{png_address(painted.key[above:])}">'
        self._ends = painted.ends
        self.trouble = painted.lacking

    def _unpainted(self, why: str) -> None:
        """Show no picture, least of all one of something else, and say why."""
        self._image.data = {name: [] for name in self._image.data}
        self._key.text = ""
        self._refused(why)

    def _refused(self, why: str) -> None:
        self.trouble = why
        self._details.refused()

    def _say_progress(self) -> None:
        explorer = self._explorer
        left = explorer.patches.left(self._painter)
        text = progress(explorer.patches.state, left, [*self._notes(), explorer.keeper.trouble])
        if self.trouble:
            text = f'<span class="trouble">{html.escape(self.trouble)}</span> &middot; {text}'
        if text != self._line.text:
            self._line.text = text

    def _notes(self) -> list[str]:
        subject, chosen = self._subject, self._chosen
        notes = [f"exploring tolerance {subject.settings.tolerance:g}"]
        if self._explorer.keeper.header is not None and chosen.plane == subject.plane:
            notes.append(f"kept in {subject.name}")
        for lattice, (low, high) in ((subject.x, chosen.x), (subject.y, chosen.y)):
            first, last = lattice.edges(0, 0, len(lattice.axis) - 1)
            slack = 1e-9 * (last - first)
            if low < first - slack or high > last + slack:
                notes.append("partly outside the atlas's window")
                break
        if chosen.plane != subject.plane:
            notes.append("another plane than the atlas's" + ("" if self._controls.keep.active else ", not kept"))
        failed = sum(1 for plane, _ in list(self._explorer.failures) if plane == chosen.plane)
        return notes + ([f"{failed} tiles failed"] if failed else [])

    def _boxed(self, event: SelectionGeometry) -> None:
        box: Any = event.geometry or {}
        if event.final and box.get("type") == "rect":
            self._box = (box["x0"], box["x1"]), (box["y0"], box["y1"])

    def _save(self, suffix: str) -> None:
        sight = self._painter.sight
        if sight is None:
            return
        chosen, ends = self._chosen, self._ends

        def work() -> Callable[[], None]:
            name, href = picture_file(self._explorer, chosen, sight, suffix, ends)
            return lambda: self._download.update(data={"name": [name], "href": [href]})

        self._background.run(work)

    def _make(self) -> None:
        chosen, cells = self._chosen, int(self._controls.cells.value or 2)
        x, y = self._box or (chosen.x, chosen.y)
        self._made.update(text="<h4>new atlas</h4>solving a few cells for its cost", visible=True)

        def work() -> Callable[[], None]:
            made = new_atlas(self._subject, chosen, x, y, cells, self._folder)
            parts = (str(made.file), made.text, made.line, made.cost)
            file, text, line, cost = map(html.escape, parts)
            shown = f"<h4>new atlas: {file}</h4><pre>{text}</pre><pre>{line}</pre><pre>{cost}</pre>"
            return lambda: self._made.update(text=shown)

        self._background.run(work)


def _heard(act: Callable[[], None]) -> Callable[[str, Any, Any], None]:
    """A function as Bokeh calls it when a property has changed."""

    def callback(attr: str, old: Any, new: Any) -> None:
        act()

    return callback
