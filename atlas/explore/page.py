"""The page: the plane, the controls, the cell under the pointer, and a line on the work.

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
from bokeh.events import MouseMove, RangesUpdate, SelectionGeometry, Tap
from bokeh.layouts import column, row
from bokeh.models import ColumnDataSource, CustomJS, Div, GlobalInlineStyleSheet, InlineStyleSheet, Toggle

from atlas.errors import InputError
from atlas.explore.access import make_accessible
from atlas.explore.actions import new_atlas, picture_file
from atlas.explore.background import Background
from atlas.explore.chosen import Range, carried, from_address, to_address, turned_to
from atlas.explore.controls import Controls
from atlas.explore.cutpanel import CutPanel
from atlas.explore.details import Details
from atlas.explore.explorer import Explorer
from atlas.explore.keys import hear_keys
from atlas.explore.painter import Painted
from atlas.explore.pane import LINE_HEIGHT, Pane
from atlas.explore.state import State, Store
from atlas.explore.style import CUTTING, FOLD, LINE, MIDDLE, PAGE, PANEL, TEXT, WHOLE
from atlas.explore.words import progress

LEFT, RIGHT = 232, 350
"""Widths of the columns beside the plane, in pixels, where the page is wide enough to have them there."""
FOLDED = "folded"
"""The class of controls that a page of a single column hides."""
TOKEN = """
const token = new URLSearchParams(window.location.search).get("token")
const query = "?" + cb_obj.text + (token ? "&token=" + token : "")
"""
HISTORY = """
const page = window.atlas ??= {rests: false}
window.history[page.rests ? "pushState" : "replaceState"](null, "", query)
window.onpopstate = () => window.location.reload()
page.rests = false
clearTimeout(page.timer)
page.timer = setTimeout(() => { page.rests = true }, 1500)
"""
"""A view at which somebody rested stays in the browser's history."""
LEAST = 16
"""Pixels of a plane that is worth drawing."""


def fill(document: Document, explorer: Explorer, folder: Path, pages: "set[Page]") -> None:
    """Make a page of a document, one of ``pages`` while it lasts; specs of new atlases are written into the folder."""
    context = document.session_context
    arguments = context.request.arguments if context is not None and context.request is not None else {}
    home, trouble = explorer, ""
    try:
        explorer = turned_to(explorer, arguments)
        chosen = from_address(explorer.subject, arguments)
    except InputError as error:
        chosen, trouble = from_address(explorer.subject, {}), str(error)
    try:
        page = Page(document, explorer, Store(State(chosen, trouble=trouble)), folder, home)
    except Exception:
        logging.getLogger(__name__).exception("a page could not be made")
        raise
    pages.add(page)

    def end(_: Any) -> None:
        pages.discard(page)
        page.close()

    document.on_session_destroyed(end)


class Page:
    """One page, of one browser's tab. What it shows follows from the state that ``store`` holds."""

    def __init__(self, document: Document, explorer: Explorer, store: Store, folder: Path, home: Explorer) -> None:
        self._explorer, self._subject, self._store = explorer, explorer.subject, store
        self._folder, self._home, chosen = folder, home, store.now.chosen
        self._background = Background(document, lambda why: store.set(trouble=why))
        self._controls = Controls(self._subject, store, self._go)
        inputs = self._controls.vmin, self._controls.vmax
        self._pane = Pane(explorer, self._background, chosen, inputs, self._heard)
        plot, painter = self._pane.plot, self._pane.painter
        self._details = Details(explorer, self._background, store, lambda: painter.sight, self._pane.mark, plot)
        self._cut = CutPanel(explorer, self._background, store, plot)
        self._make_panels()
        logs = [lattice.log for lattice in (self._subject.x, self._subject.y)]
        self._keys = hear_keys(document, plot, logs, self._show_window, store.escape, self._details.choose)
        self._wire()
        self._cut.show(store.now)
        document.title = f"{self._subject.name}: explorer"
        make_accessible(document)
        document.add_root(self._layout())
        document.add_periodic_callback(self._say_progress, 500)
        store.listen(self._changed)

    def close(self) -> None:
        """Free what the page holds."""
        self._background.close()
        self._details.close()
        self._cut.close()
        self._pane.painter.close()

    def wait(self) -> None:
        """Wait until nothing of a page that is closed is at work any more."""
        self._pane.painter.wait()
        self._background.wait()

    def _make_panels(self) -> None:
        look: dict[str, Any] = {"sizing_mode": "stretch_width"}
        self._line = Div(height=LINE_HEIGHT, stylesheets=[TEXT, LINE], **look)
        self._made = Div(visible=False, stylesheets=[TEXT], **look)
        self._address, self._opened = Div(visible=False), Div(visible=False)
        self._download = ColumnDataSource({"name": [], "href": []})

    def _wire(self) -> None:
        """Connect events with what they lead to."""
        controls, store = self._controls, self._store
        plot = self._pane.plot
        for k, attribute in enumerate(("inner_width", "inner_height")):
            plot.on_change(attribute, partial(self._resized, k))
        plot.on_event(RangesUpdate, self._moved)
        plot.on_event(MouseMove, lambda event: self._details.point(event))
        plot.on_event(Tap, lambda event: self._details.click(event))
        plot.on_event(SelectionGeometry, self._boxed)
        controls.rescale.on_click(self._rescale)
        controls.keep.on_click(lambda on: self._explorer.tiles.keep_plane(store.now.chosen.plane, on))
        for suffix, button in controls.files.items():
            button.on_click(partial(self._save, suffix))
        controls.make.on_click(self._make)
        self._address.js_on_change("text", CustomJS(code=TOKEN + HISTORY))
        self._opened.js_on_change("text", CustomJS(code=TOKEN + "window.location.assign(query)"))
        script = """
            const link = document.createElement("a")
            link.href = cb_obj.data["href"][0]; link.download = cb_obj.data["name"][0]; link.click()
        """
        self._download.js_on_change("data", CustomJS(code=script))

    def _layout(self) -> Any:
        panel: dict[str, Any] = {"stylesheets": [InlineStyleSheet(css=PANEL)], "sizing_mode": "stretch_height"}
        left = column(*self._controls.columns(self._cut.buttons), width=LEFT, css_classes=[FOLDED], **panel)
        fold = Toggle(label="controls", sizing_mode="stretch_width", stylesheets=[FOLD])
        unfolding = CustomJS(args={"left": left}, code=f"left.css_classes = cb_obj.active ? [] : ['{FOLDED}']")
        fold.js_on_change("active", unfolding)
        parts = self._pane.panel, self._cut.panel, self._line
        middle = column(*parts, sizing_mode="stretch_both", stylesheets=[MIDDLE])
        widen = f"middle.css_classes = cb_obj.visible ? ['{CUTTING}'] : []"
        self._cut.panel.js_on_change("visible", CustomJS(args={"middle": middle}, code=widen))
        middle.css_classes = [CUTTING] if self._cut.panel.visible else []
        right = column(self._made, *self._details.panels, self._address, self._opened, width=RIGHT, **panel)
        # A source without a view is sent along, and heard, as the tag of a model that has one.
        self._address.tags = [self._download, self._keys]
        whole = row(fold, left, middle, right, sizing_mode="stretch_both")
        whole.stylesheets = [GlobalInlineStyleSheet(css=PAGE), InlineStyleSheet(css=WHOLE)]
        return whole

    def _changed(self, old: State, new: State) -> None:
        """Show what the state says now."""
        chosen = new.chosen
        self._controls.show(new, self._explorer.tiles.keeps(chosen.plane))
        self._details.show(chosen)
        self._cut.show(new)
        if min(new.size) >= LEAST:
            self._address.text = to_address(self._home.subject, self._subject, chosen)
            self._pane.show(chosen, new.size, new.rests)

    def _go(self, axes: tuple[str, str] | None = None, layer: float | None = None) -> None:
        """Open the page of other axes or of another layer, with what is in the middle of the view, or clicked, kept."""
        subject, chosen = self._subject, self._store.now.chosen
        turned = self._home.turned(axes or subject.axes, subject.layer_value if layer is None else layer).subject
        values = subject.values(chosen.plane, *chosen.middle(subject))
        if layer is not None and turned.third is not None:
            values[turned.third.name] = layer
        there = carried(turned, chosen, values)
        there = there if axes else replace(there, x=chosen.x, y=chosen.y)
        self._opened.text = to_address(self._home.subject, turned, there)

    def _resized(self, place: int, attribute: str, old: Any, new: Any) -> None:
        width, height = self._store.now.size
        self._store.set(size=(int(new or 0), height) if place == 0 else (width, int(new or 0)))

    def _moved(self, event: RangesUpdate) -> None:
        ends = (event.x0, event.x1, event.y0, event.y1)
        left, right, low, high = (float("nan") if end is None else float(end) for end in ends)
        self._show_window((left, right), (low, high))

    def _show_window(self, x: Range, y: Range) -> None:
        if x[0] < x[1] and y[0] < y[1] and np.isfinite([*x, *y]).all():
            self._store.choose(x=x, y=y)

    def _rescale(self) -> None:
        """Choose the ends of the scale by what is in view."""
        chosen = self._store.now.chosen

        def work() -> Callable[[], None]:
            low, high = self._pane.painter.fitted(chosen) or (None, None)
            return lambda: self._store.choose(vmin=low, vmax=high)

        self._background.run(work)

    def _heard(self, found: Painted | str) -> None:
        """Take note of a picture of the plane, or of why there is none."""
        if isinstance(found, str):
            self._store.set(lacking=found, shares=())
            return
        self._store.set(ends=found.ends, lacking=found.note, lines=found.screen.lines, shares=found.shares)
        self._details.show(self._store.now.chosen)  # a cell of the address, once there is a view to find it in

    def _say_progress(self) -> None:
        explorer, now = self._explorer, self._store.now
        trouble = "; ".join(filter(None, (now.trouble, now.lacking)))
        left = explorer.patches.left(self._pane.painter)
        text = progress(explorer.patches.state, left, [*self._notes(), explorer.tiles.keeper.trouble], now.shares)
        if trouble:
            text = f'<span class="trouble" role="alert">{html.escape(trouble)}</span> &middot; {text}'
        self._line.text = f"<span>{text}</span>"

    def _notes(self) -> list[str]:
        subject, chosen = self._subject, self._store.now.chosen
        notes = [f"exploring tolerance {subject.settings.tolerance:g}"]
        keeper = self._explorer.tiles.keeper
        if keeper.handle is not None and not keeper.trouble and chosen.plane == subject.plane:
            notes.append(f"kept in {subject.name}")
        for lattice, (low, high) in ((subject.x, chosen.x), (subject.y, chosen.y)):
            first, last = lattice.ends
            slack = 1e-9 * (last - first)
            if low < first - slack or high > last + slack:
                notes.append("partly outside the atlas's window")
                break
        if chosen.plane != subject.plane:
            kept = keeper.handle is not None and self._explorer.tiles.keeps(chosen.plane)
            notes.append("another plane than the atlas's" + ("" if kept else ", not kept"))
        failed = sum(1 for plane, _ in list(self._explorer.failures) if plane == chosen.plane)
        return notes + ([f"{failed} tiles failed"] if failed else [])

    def _boxed(self, event: SelectionGeometry) -> None:
        box: Any = event.geometry or {}
        if event.final and box.get("type") == "rect":
            self._store.set(box=((box["x0"], box["x1"]), (box["y0"], box["y1"])))

    def _save(self, suffix: str) -> None:
        sight = self._pane.painter.sight
        if sight is None:
            return
        chosen, ends = self._store.now.chosen, self._store.now.ends

        def work() -> Callable[[], None]:
            name, href = picture_file(self._explorer, chosen, sight, suffix, ends)
            return lambda: self._download.update(data={"name": [name], "href": [href]})

        self._background.run(work)

    def _make(self) -> None:
        chosen, cells = self._store.now.chosen, int(self._controls.cells.value or 2)
        x, y = self._store.now.box or (chosen.x, chosen.y)
        self._made.update(text="<h4>new atlas</h4>solving a few cells for its cost", visible=True)

        def work() -> Callable[[], None]:
            made = new_atlas(self._subject, chosen, x, y, cells, self._folder)
            parts = (str(made.file), made.text, made.line, made.cost)
            file, text, line, cost = map(html.escape, parts)
            shown = f"<h4>new atlas: {file}</h4><pre>{text}</pre><pre>{line}</pre><pre>{cost}</pre>"
            return lambda: self._made.update(text=shown)

        def refuse(why: str) -> None:
            self._made.visible = False
            self._background.refuse(why)

        self._background.run(work, refuse)
