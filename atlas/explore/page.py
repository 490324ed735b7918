"""A page of the explorer: the plane, the controls, the details of cells, and a progress line.

The windows of the axes and the style of the plane belong to the browser. The server receives the windows and the style
and sends cells. It does not set the windows or the style, since its changes would race with the user's.
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
from bokeh.events import RangesUpdate, SelectionGeometry, Tap
from bokeh.layouts import column, row
from bokeh.models import ColumnDataSource, Div, GlobalInlineStyleSheet, InlineStyleSheet, Toggle

from atlas.errors import InputError
from atlas.explore.accessibility import install_key_handler, make_accessible
from atlas.explore.actions import new_atlas, picture_file
from atlas.explore.background import BackgroundTasks
from atlas.explore.controls import Controls
from atlas.explore.cut_panel import CutPanel
from atlas.explore.details_panel import DetailsPanel
from atlas.explore.explorer import Explorer
from atlas.explore.front.script import call
from atlas.explore.page_state import PageModel, PageState
from atlas.explore.picture_renderer import RenderedPicture
from atlas.explore.plane_pane import LINE_HEIGHT, PlanePane
from atlas.explore.style import CUTTING, FOLD, LINE, MIDDLE, PAGE, PANEL, TEXT, WHOLE
from atlas.explore.text import progress
from atlas.explore.view_state import (
    STYLE_FIELDS,
    Range,
    apply_style_query,
    carry_over,
    explorer_for_query,
    from_address,
    overlays,
    place_query,
)

LEFT, RIGHT = 232, 350
"""Widths, in pixels, of the columns on the left and right of the plane on a page that is wide enough for them."""
FOLDED = "folded"
"""CSS class of the controls that a page of a single column hides."""
MIN_PLANE_PIXELS = 16
"""Minimum width and height, in pixels, of a plane that is drawn."""


def build_page(document: Document, explorer: Explorer, folder: Path, pages: "set[ExplorerPage]") -> None:
    """Fill a Bokeh document with a page, at the view that the document's address asks for.

    document   the document, empty so far
    explorer   explorer that an address without a query opens
    folder     folder in which specs of new atlases are written
    pages      set of open pages; the page belongs to it until the session of the document ends

    If the address is invalid, the page shows the initial view and the reason.
    """
    context = document.session_context
    arguments = context.request.arguments if context is not None and context.request is not None else {}
    home, trouble = explorer, ""
    try:
        explorer = explorer_for_query(explorer, arguments)
        view = from_address(explorer.subject, arguments)
    except InputError as error:
        view, trouble = from_address(explorer.subject, {}), str(error)
    try:
        page = ExplorerPage(document, explorer, PageModel(PageState(view, trouble=trouble)), folder, home)
    except Exception:
        logging.getLogger(__name__).exception("a page could not be made")
        raise
    pages.add(page)

    def end(_: Any) -> None:
        pages.discard(page)
        page.close()

    document.on_session_destroyed(end)


class ExplorerPage:
    """One page, in one tab of a browser. All that the page shows follows from the state in ``store``.

    document   the Bokeh document to fill
    explorer   explorer of the page's axes and layer
    store      model of the page's state
    folder     folder in which specs of new atlases are written
    home       explorer of the axes and layer that an address without a query means
    """

    def __init__(self, document: Document, explorer: Explorer, store: PageModel, folder: Path, home: Explorer) -> None:
        self._explorer, self._subject, self._store = explorer, explorer.subject, store
        self._folder, self._home, view = folder, home, store.now.view
        self._background = BackgroundTasks(document, lambda why: store.set(trouble=why))
        self._controls = Controls(self._subject, store, self._go)
        self._pane = PlanePane(explorer, self._background, view, self._note_picture, self._note_look)
        plot, painter = self._pane.plot, self._pane.painter
        self._details = DetailsPanel(explorer, self._background, store, lambda: painter.sight, self._pane.mark, plot)
        self._cut = CutPanel(explorer, self._background, store, plot)
        self._make_panels()
        self._keys = install_key_handler(document, plot, self._show_window, store.escape, self._details.choose)
        self._pane.begin(document, self._address)
        self._wire()
        self._cut.show(store.now)
        document.title = f"{self._subject.name}: explorer"
        make_accessible(document)
        document.add_root(self._layout())
        document.add_periodic_callback(self._say_progress, 500)
        store.subscribe(self._changed)

    def close(self) -> None:
        """Stop the threads of the page, and cancel its jobs."""
        self._background.close()
        self._details.close()
        self._cut.close()
        self._pane.painter.close()

    def wait(self) -> None:
        """Wait until all threads of a closed page have ended."""
        self._pane.painter.wait()
        self._background.wait()

    def _make_panels(self) -> None:
        look: dict[str, Any] = {"sizing_mode": "stretch_width"}
        self._line = Div(text="<span>no picture yet</span>", height=LINE_HEIGHT, stylesheets=[TEXT, LINE], **look)
        self._made = Div(visible=False, stylesheets=[TEXT], **look)
        self._address, self._opened = Div(visible=False), ColumnDataSource({"place": [], "overlays": []})
        self._download = ColumnDataSource({"name": [], "href": []})

    def _wire(self) -> None:
        """Connect the events of the plot and of the buttons with their handlers."""
        controls = self._controls
        plot = self._pane.plot
        for k, attribute in enumerate(("inner_width", "inner_height")):
            plot.on_change(attribute, partial(self._resized, k))
        plot.on_event(RangesUpdate, self._window_changed)
        plot.js_on_event(RangesUpdate, call("tell"))  # before the event reaches the server
        plot.on_event(Tap, lambda event: self._details.click(event))
        plot.on_event(SelectionGeometry, self._boxed)
        for suffix, button in controls.files.items():
            button.on_click(partial(self._save, suffix))
        controls.make.on_click(self._make)
        self._opened.js_on_change("data", call("turn"))
        self._download.js_on_change("data", call("download"))

    def _layout(self) -> Any:
        panel: dict[str, Any] = {"stylesheets": [InlineStyleSheet(css=PANEL)], "sizing_mode": "stretch_height"}
        left = column(*self._controls.columns(self._cut.buttons), width=LEFT, css_classes=[FOLDED], **panel)
        fold = Toggle(label="controls", sizing_mode="stretch_width", stylesheets=[FOLD])
        fold.js_on_change("active", call("mark", model=left, name=FOLDED, property="active", unless=True))
        parts = self._pane.panel, self._cut.panel, self._line
        middle = column(*parts, sizing_mode="stretch_both", stylesheets=[MIDDLE])
        widen = call("mark", model=middle, name=CUTTING, property="visible", unless=False)
        self._cut.panel.js_on_change("visible", widen)
        middle.css_classes = [CUTTING] if self._cut.panel.visible else []
        right = column(self._made, *self._details.panels, self._address, width=RIGHT, **panel)
        # Bokeh sends a source without a view, and its changes, only if it is a tag of a model with a view.
        self._address.tags = [self._download, self._keys, self._opened]
        layout = row(fold, left, middle, right, sizing_mode="stretch_both")
        layout.stylesheets = [GlobalInlineStyleSheet(css=PAGE), InlineStyleSheet(css=WHOLE)]
        return layout

    def _changed(self, old: PageState, new: PageState) -> None:
        """Show the new state of the page in all its parts."""
        view = new.view
        self._controls.show(new)
        self._details.show(view)
        self._cut.show(new)
        if min(new.size) >= MIN_PLANE_PIXELS:
            self._address.text = place_query(self._home.subject, self._subject, view)
            self._pane.show(view, new.size, new.at_rest)

    def _go(self, axes: tuple[str, str] | None = None, layer: float | None = None) -> None:
        """Have the browser open the page of other axes or of another layer of a stack.

        The new plane goes through the clicked cell, or else through the middle of the window.
        """
        subject, view = self._subject, self._store.now.view
        turned = self._home.explorer_for_axes(
            axes or subject.axes, subject.layer_value if layer is None else layer
        ).subject
        values = subject.values(view.plane, *view.middle(subject))
        if layer is not None and turned.stack_axis is not None:
            values[turned.stack_axis.name] = layer
        new_view = carry_over(turned, view, values)
        new_view = new_view if axes else replace(new_view, x=view.x, y=view.y)
        query = place_query(self._home.subject, turned, new_view)
        self._opened.data = {"place": [query], "overlays": [overlays(turned)]}

    def _resized(self, dimension: int, attribute: str, old: Any, new: Any) -> None:
        width, height = self._store.now.size
        self._store.set(size=(int(new or 0), height) if dimension == 0 else (width, int(new or 0)))

    def _window_changed(self, event: RangesUpdate) -> None:
        ends = (event.x0, event.x1, event.y0, event.y1)
        left, right, low, high = (float("nan") if end is None else float(end) for end in ends)
        self._show_window((left, right), (low, high))

    def _show_window(self, x: Range, y: Range) -> None:
        if x[0] < x[1] and y[0] < y[1] and np.isfinite([*x, *y]).all():
            self._store.choose(x=x, y=y)

    def _note_look(self, query: str) -> None:
        """Record the style of the plane (map, overlays, colour limits) that the browser reports as a query."""
        try:
            looks = apply_style_query(self._subject, self._store.now.view, query)
            self._store.choose(**{name: getattr(looks, name) for name in STYLE_FIELDS})
        except InputError as error:
            self._store.set(trouble=str(error))

    def _note_picture(self, picture: RenderedPicture | str) -> None:
        """Record a new picture of the plane, or, given a string, the reason why there is no picture."""
        if isinstance(picture, str):
            self._store.set(missing_parts=picture, shares=())
            return
        self._store.set(missing_parts=picture.note, shares=picture.shares)
        self._details.show(self._store.now.view)  # the cell of the address, which needs a viewport to be found

    def _say_progress(self) -> None:
        explorer, now = self._explorer, self._store.now
        trouble = "; ".join(filter(None, (now.trouble, now.missing_parts)))
        left = explorer.patches.n_remaining(self._pane.painter)
        text = progress(explorer.patches.state, left, self._notes(), now.shares)
        if trouble:
            text = f'<span class="trouble" role="alert">{html.escape(trouble)}</span> &middot; {text}'
        self._line.text = f"<span>{text}</span>"

    def _notes(self) -> list[str]:
        subject, view = self._subject, self._store.now.view
        notes = [f"exploring tolerance {subject.settings.tolerance:g}"]
        for lattice, (low, high) in ((subject.x, view.x), (subject.y, view.y)):
            first, last = lattice.ends
            slack = 1e-9 * (last - first)
            if low < first - slack or high > last + slack:
                notes.append("partly outside the atlas's window")
                break
        if view.plane != subject.plane:
            notes.append("not the plane of the atlas")
        failed = sum(1 for plane, _ in list(self._explorer.failures) if plane == view.plane)
        return notes + ([f"{failed} tiles failed"] if failed else [])

    def _boxed(self, event: SelectionGeometry) -> None:
        box: Any = event.geometry or {}
        if event.final and box.get("type") == "rect":
            self._store.set(box=((box["x0"], box["x1"]), (box["y0"], box["y1"])))

    def _save(self, suffix: str) -> None:
        sight = self._pane.painter.sight
        if sight is None:
            return
        view = self._store.now.view
        ends = self._pane.painter.ends(view)

        def work() -> Callable[[], None]:
            name, href = picture_file(self._explorer, view, sight, suffix, ends)
            return lambda: self._download.update(data={"name": [name], "href": [href]})

        self._background.run(work)

    def _make(self) -> None:
        view, cells = self._store.now.view, int(self._controls.cells.value or 2)
        x, y = self._store.now.box or (view.x, view.y)
        self._made.update(text="<h4>new atlas</h4>solving a few cells for its cost", visible=True)

        def work() -> Callable[[], None]:
            new_spec = new_atlas(self._subject, view, x, y, cells, self._folder)
            parts = (str(new_spec.file), new_spec.text, new_spec.line, new_spec.cost)
            file, text, line, cost = map(html.escape, parts)
            markup = f"<h4>new atlas: {file}</h4><pre>{text}</pre><pre>{line}</pre><pre>{cost}</pre>"
            return lambda: self._made.update(text=markup)

        def refuse(reason: str) -> None:
            self._made.visible = False
            self._background.refuse(reason)

        self._background.run(work, refuse)
