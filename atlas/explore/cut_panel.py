"""The panel of a cut: the line over the plane, and below the plane diagrams of the cells along the line.

The pointer marks the same point in the plane and in all diagrams.
"""

from functools import partial
from typing import Any

import numpy as np
from bokeh.events import MouseMove
from bokeh.layouts import column, row
from bokeh.models import (
    Button,
    ColumnDataSource,
    Div,
    FreehandDrawTool,
    PanTool,
    Range1d,
    Select,
    Span,
)
from bokeh.plotting import figure

from atlas.explore.accessibility import accessible_name
from atlas.explore.background import BackgroundTasks
from atlas.explore.cut import (
    SAMPLES,
    SECTION_WORDS,
    CutCells,
    CutLine,
    cut_computation,
    exponents,
    shown_points,
    to_observe,
)
from atlas.explore.explorer import Explorer
from atlas.explore.front.script import call
from atlas.explore.page_state import PageModel, PageState
from atlas.explore.panel import Panel
from atlas.explore.plot import style_plain
from atlas.explore.style import CUT, CUT_HEAD, DIAGRAM, TEXT
from atlas.explore.text import symbol_of, ticks
from atlas.explore.view_state import Cut
from atlas.formatting import plural


class CutPanel(Panel[CutLine]):
    """The panel with the diagrams along the line of the cut; it requests the cells of the line from the workers."""

    def __init__(self, explorer: Explorer, background: BackgroundTasks, store: PageModel, plane: figure) -> None:
        super().__init__(explorer, background)
        self._store, self._plane = store, plane
        self._cells: CutCells | None = None
        self._drawn = ColumnDataSource({"xs": [], "ys": []})
        self._sources = {
            "shown": ColumnDataSource({"x": [], "y": []}),
            "exponents": ColumnDataSource({"x": [], "largest": [], "low": [], "high": []}),
        }
        self._over_plane()
        subject, scale = explorer.subject, "linear"
        look: dict[str, Any] = {
            "x_range": Range1d(0.0, 1.0), "x_axis_type": scale, "tools": "xpan,xwheel_zoom,reset,save",
            "sizing_mode": "stretch_both", "min_border_left": 76, "output_backend": "webgl", "stylesheets": [DIAGRAM],
        }  # fmt: skip
        self._section = figure(y_axis_label=SECTION_WORDS, toolbar_location="right", **look)
        look |= {"x_range": self._section.x_range, "toolbar_location": None}
        self._exponents = figure(y_axis_label="exponent", **look)
        self._section.toolbar.logo = None
        self._draw()
        self._says = Div(stylesheets=[TEXT], sizing_mode="stretch_width")
        self._possible = to_observe(subject)
        self._shows = Select(options=[*self._possible], value=SECTION_WORDS, width=230)
        self._shows.on_change("value", lambda attr, old, new: self.show(store.now))
        close = Button(label="close the cut", width=100)
        close.on_click(lambda: store.choose(cut=None))
        head = row(self._says, self._shows, close, sizing_mode="stretch_width", stylesheets=[CUT_HEAD])
        self.panel = column(
            head, self._section, self._exponents, sizing_mode="stretch_width", visible=False, stylesheets=[CUT],
        )  # fmt: skip
        self.buttons = [Button(label=label, sizing_mode="stretch_width") for label in ("cut across", "cut up")]
        for k, button in enumerate(self.buttons):
            button.on_click(partial(self._straight, k))
        self._link()

    def show(self, state: PageState) -> None:
        """Show the diagrams of the cut that the page's state has; hide them if it has none."""
        view, observe = state.view, self._possible[str(self._shows.value)]
        self.set_topic(None if view.cut is None else CutLine(self._subject, view.plane, view.cut, observe))

    def clear(self) -> None:
        """Remove the line and the diagrams."""
        self.panel.visible = False
        self._drawn.data = {"xs": [], "ys": []}

    def start(self, line: CutLine) -> None:
        """Show a line with empty diagrams, and request its cells from the workers."""
        x0, y0, x1, y1 = line.ends
        self._drawn.data = {"xs": [[x0, x1]], "ys": [[y0, y1]]}
        self._cells = None
        for source in self._sources.values():
            source.data = {name: [] for name in source.data}
        low, high = sorted((line.ends[line.axis], line.ends[2 + line.axis]))
        self._along.data = {"along": [line.axis]}
        self._section.x_range.update(start=low, end=high)
        self._label(line, low, high)
        self._section.yaxis[0].axis_label = str(self._shows.value)
        self._says.text = "solving the cells along the cut"
        self.panel.visible = True
        self._plane.toolbar.active_drag = self._plane.select_one(PanTool)
        self.submit([cut_computation(line, part) for part in line.batches()], partial(self._take, line))

    def show_error(self, reason: str) -> None:
        """Show the reason why some cells cannot be shown."""
        super().show_error(f"part of the cut: {reason}")

    def _take(self, line: CutLine, cells: CutCells) -> None:
        """Add solved cells of the cut to its diagrams."""
        self._cells = known = cells.merged_with(self._cells)
        self._sources["shown"].data = dict(shown_points(line, known))
        self._sources["exponents"].data = dict(exponents(line, known))
        more = int(np.count_nonzero(known.results.get("more", 0)))
        long = f"; {plural(more, 'orbit')} with more than {SAMPLES} values: the first of them" if more else ""
        self._says.text = f"{plural(known.index.size, 'cell')} along the cut{long}"

    def _straight(self, along: int) -> None:
        """Start a cut along one axis (0 across, 1 up), through the clicked cell or the middle of the window."""
        view = self._store.now.view
        x, y = view.middle(self._subject)
        ends: Cut = (view.x[0], y, view.x[1], y) if along == 0 else (x, view.y[0], x, view.y[1])
        self._store.choose(cut=ends)

    def _drew(self, attribute: str, old: Any, new: Any) -> None:
        """Start a cut along the line that the user drew with the pointer, from its press to its release."""
        if not new["xs"] or len(new["xs"][0]) <= 2:
            return
        x, y = new["xs"][0], new["ys"][0]
        ends = tuple(float(value) for value in (x[0], y[0], x[-1], y[-1]))
        if np.isfinite(ends).all() and ends[:2] != ends[2:]:
            self._store.choose(cut=ends)

    def _over_plane(self) -> None:
        """Add to the plot of the plane the cut's line, a dot for its point under the pointer, and a drawing tool."""
        lines = [
            self._plane.multi_line(xs="xs", ys="ys", source=self._drawn, line_color=color, line_width=width)
            for color, width in (("white", 5.0), ("black", 2.0))
        ]
        self._dot = ColumnDataSource({"at_x": [], "at_y": []})
        self._plane.scatter(x="at_x", y="at_y", source=self._dot, size=9, fill_color="white", line_color="black")
        self._plane.add_tools(FreehandDrawTool(renderers=lines[1:], num_objects=1, description="draw a cut"))
        self._drawn.on_change("data", self._drew)

    def _draw(self) -> None:
        """Create the diagrams: the values that are shown, and the largest exponent with its error band."""
        of, sources = self._section, self._sources
        of.scatter(x="x", y="y", source=sources["shown"], size=1.8, color="#1a2433", line_color=None)
        below = self._exponents
        below.add_layout(Span(location=0.0, dimension="width", line_color="#9aa4b0"))
        below.varea(x="x", y1="low", y2="high", source=sources["exponents"], fill_alpha=0.25, fill_color="#004488")
        below.line(x="x", y="largest", source=sources["exponents"], line_color="#004488")
        self._spans = [Span(dimension="height", line_color="#bb5566", line_dash="dotted") for _ in range(2)]
        for plot, span in zip((of, below), self._spans, strict=True):
            plot.add_layout(span)
            style_plain(plot)
        of.xaxis[0].visible = False
        of.html_attributes, below.html_attributes = (
            accessible_name("section states along the cut"),
            accessible_name("exponent along the cut"),
        )

    def _link(self) -> None:
        """Have the pointer in one plot mark the same point of the cut in the other plots."""
        self._along = ColumnDataSource({"along": [0]})
        args = {"line": self._drawn, "plane": self._plane, "axis": self._along}
        args |= {"spans_of": self._spans, "dot": self._dot}
        for plot in (self._plane, self._section, self._exponents):
            plot.js_on_event(MouseMove, call("linkPointer", **args, of_plane=plot is self._plane))

    def _label(self, line: CutLine, low: float, high: float) -> None:
        marks, system = ticks(line.subject, line.name, low, high), line.subject.system
        axis, other = self._exponents.xaxis[0], line.subject.axes[1 - line.axis]
        formatter: Any = axis.formatter
        formatter.args = {"base": marks.base, "unit": marks.unit, "decimals": marks.decimals}
        axis.axis_label = marks.label if line.level else f"{marks.label}, {symbol_of(system, other)} along the cut"
