"""The pane of an explorer page that shows the plane: its title, its plot, and its legend."""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.events import DocumentReady, MouseMove
from bokeh.layouts import column, row
from bokeh.models import ColumnDataSource, Div, Label
from bokeh.plotting import figure

from atlas.explore.background import BackgroundTasks
from atlas.explore.explorer import Explorer
from atlas.explore.front.script import call, html_part, legend_css
from atlas.explore.picture_renderer import PictureRenderer, RenderedPicture
from atlas.explore.plot import label_axes, make_plot
from atlas.explore.static.about import meanings, variable
from atlas.explore.style import BAR, KEY, KEY_WIDTH, LINE, PANE, PLANE, TEXT
from atlas.explore.subject import Subject
from atlas.explore.text import HELP, symbol_of, title
from atlas.explore.view_state import ViewState, kinds, overlays, style_query
from atlas.render import SCALAR
from atlas.render.kinds import NUMBER
from workers.results import REASON, REGIME

LINE_HEIGHT = 20
NOTHING: dict[str, Any] = {"message": [], "share": []}


class PlanePane:
    """The plane of a page with its title and its legend.

    explorer     the explorer that looks up and solves cells
    background   the threads of the page
    view         the view state at first
    on_picture   called with each picture, or with the reason why there is no picture
    on_look      called with the style of the plane in the browser, as a query, before the browser requests anything
    """

    def __init__(
        self,
        explorer: Explorer,
        background: BackgroundTasks,
        view: ViewState,
        on_picture: Callable[[RenderedPicture | str], None],
        on_look: Callable[[str], None],
    ) -> None:
        self._subject, self._chosen, self._on_picture = explorer.subject, view, on_picture
        # The height is fixed, so that the plane keeps its size for all texts.
        line: dict[str, Any] = {"stylesheets": [TEXT, LINE], "sizing_mode": "stretch_width", "height": LINE_HEIGHT}
        self._title = Div(text=title(explorer.subject, view.plane), **line)
        self._bar = Div(text=html_part("bar"), sizing_mode="stretch_width", height=3, margin=0, stylesheets=[BAR])
        key: dict[str, Any] = {"width": KEY_WIDTH, "sizing_mode": "stretch_height", "margin": 0}
        self._key = Div(text=html_part("key"), stylesheets=[TEXT, legend_css(), KEY], **key)
        self.mark = ColumnDataSource({"x": [], "y": []})
        self.plot: figure
        self.plot, self._image = make_plot(explorer.subject, view, self.mark)
        self._sent, self._look = ColumnDataSource(NOTHING), ColumnDataSource({"query": []})
        self._blank = ColumnDataSource({"words": [np.zeros((1, 1), np.uint32)]})
        self._look.on_change("data", lambda attribute, old, new: on_look(str(new["query"][0])))
        self._waiting = Label(x=12, y=12, x_units="screen", y_units="screen", text="drawing the first picture")
        self.plot.add_layout(self._waiting)
        plane = row(self.plot, self._key, sizing_mode="stretch_both", stylesheets=[PLANE])
        self.panel = column(self._title, self._bar, plane, sizing_mode="stretch_both", stylesheets=[PANE])
        self.painter = PictureRenderer(
            explorer, background.deferred_call(self._show), background.deferred_call(self._unpainted)
        )

    def begin(self, document: Document, address: Div) -> None:
        """Have the browser draw the plane once it has the document, and keep the plane's style in the address."""
        self._image.tags = [self._sent, self._look, self._blank]  # sources without a view are sent as tags
        models = {"plot": self.plot, "image": self._image, "sent": self._sent, "look": self._look}
        models |= {"blank": self._blank, "waiting": self._waiting, "address": address}
        subject = json.dumps(described(self._subject, self._chosen))
        document.js_on_event(DocumentReady, call("begin", subject=subject, **models))
        address.js_on_change("text", call("remember"))
        self.plot.js_on_event(MouseMove, call("point"))

    def show(self, view: ViewState, size: tuple[int, int], rests: bool) -> None:
        """Show a view, for a plane of ``size`` (width, height) in pixels; ``rests`` is False while a slider moves."""
        old, self._chosen, subject = self._chosen, view, self._subject
        if (view.x, view.y) != (old.x, old.y):
            label_axes(self.plot, subject, view)
        if view.plane != old.plane:
            self._title.text = title(subject, view.plane)
        self.painter.show(view, size, rests)

    def _show(self, painted: RenderedPicture) -> None:
        """Send a picture to the browser."""
        self._sent.data = {"message": [painted.message], "share": [sum(painted.shares) / len(painted.shares)]}
        self._on_picture(painted)

    def _unpainted(self, reason: str) -> None:
        """Remove the picture, since it may show an older view, and report the reason why there is no new picture."""
        self._sent.data = NOTHING
        self._on_picture(reason)


def described(subject: Subject, view: ViewState) -> dict[str, Any]:
    """Return what the browser's script must know of the subject, as plain JSON: axes, variables, maps and overlays.

    ``look`` in it is the style of the plane at first, as a query.
    """
    from atlas.explore.compose import dataset

    points = [np.array(lattice.axis.values[:2]) for lattice in (subject.x, subject.y)]
    names = [REGIME.name, REASON.name, *subject.numbers]
    ds = dataset(subject, subject.plane, points[0], points[1], subject.without_results(names, (2, 2)))
    variables = {name: variable(ds, name) for name in names}
    axes = [
        {"symbol": symbol_of(subject.system, lattice.axis.name), "label": "", "log": lattice.log}
        for lattice in (subject.x, subject.y)
    ]
    maps = [(kind, kind) for kind in kinds(subject) if kind != SCALAR]
    maps += [(f"{NUMBER}{name}", variables[name]["label"]) for name in subject.numbers]
    return meanings() | {
        "axes": axes,
        "variables": variables,
        "maps": maps,
        "overlays": overlays(subject),
        "help": HELP,
        "look": style_query(view),
    }
