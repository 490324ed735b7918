"""The panel of a cut: the line over the plane, and below it the diagrams along the line, which share the pointer."""

import html
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
    Legend,
    LegendItem,
    PanTool,
    Range1d,
    Select,
    Span,
)
from bokeh.plotting import figure

from atlas.errors import InputError
from atlas.explore.accessibility import accessible_name
from atlas.explore.background import BackgroundTasks
from atlas.explore.branches import BranchDiagram
from atlas.explore.cut import (
    MAX_IMPACTS,
    SAMPLES,
    SECTION_WORDS,
    CutCells,
    CutLine,
    cut_computation,
    exponents,
    follow_branches,
    shown_points,
    sweep_of,
    to_observe,
    too_long,
)
from atlas.explore.explorer import Explorer
from atlas.explore.front.script import call
from atlas.explore.jobs import Computation
from atlas.explore.page_state import PageModel, PageState
from atlas.explore.panel import Panel
from atlas.explore.plot import BranchLines, style_plain
from atlas.explore.style import CUT, CUT_HEAD, DIAGRAM, TEXT
from atlas.explore.text import symbol_of, ticks
from atlas.explore.view_state import Cut
from atlas.formatting import plural

ENTRIES = "cells", "stable", "unstable", "events"
SWITCHES: dict[str, Any] = {
    "click_policy": "hide", "orientation": "horizontal", "border_line_color": None, "label_text_font_size": "11px",
    "margin": 0, "padding": 0, "location": "left",
}  # fmt: skip
"""Options of a legend above a diagram, whose entries show and hide the parts that they name."""


class CutPanel(Panel[CutLine]):
    """The panel with the diagrams along the chosen line; it requests the cells and branches to show."""

    def __init__(self, explorer: Explorer, background: BackgroundTasks, store: PageModel, plane: figure) -> None:
        super().__init__(explorer, background)
        self._store, self._plane = store, plane
        self._cells: CutCells | None = None
        self._note = ""
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
        self._follow = Button(label="branches, stable and unstable", width=210)
        self._follow.on_click(self._find_branches)
        self._possible = to_observe(subject)
        self._shows = Select(options=[*self._possible], value=SECTION_WORDS, width=230)
        self._shows.on_change("value", lambda attr, old, new: self.show(store.now))
        close = Button(label="close the cut", width=100)
        close.on_click(lambda: store.choose(cut=None))
        head = row(self._says, self._shows, self._follow, close, sizing_mode="stretch_width", stylesheets=[CUT_HEAD])
        self.panel = column(
            head, self._section, self._exponents, sizing_mode="stretch_width", visible=False, stylesheets=[CUT],
        )  # fmt: skip
        self.buttons = [Button(label=label, sizing_mode="stretch_width") for label in ("cut across", "cut up")]
        for k, button in enumerate(self.buttons):
            button.on_click(partial(self._straight, k))
        self._link()

    def show(self, state: PageState) -> None:
        """Show the diagrams along the chosen line of the chosen plane."""
        chosen, observe = state.view, self._possible[str(self._shows.value)]
        self.set_topic(None if chosen.cut is None else CutLine(self._subject, chosen.plane, chosen.cut, observe))

    def clear(self) -> None:
        """Show no line and no diagram."""
        self.panel.visible = False
        self._drawn.data = {"xs": [], "ys": []}

    def start(self, line: CutLine) -> None:
        """Show a line and empty diagrams, and have the cells of the line solved."""
        x0, y0, x1, y1 = line.ends
        self._drawn.data = {"xs": [[x0, x1]], "ys": [[y0, y1]]}
        self._cells = None
        for source in self._sources.values():
            source.data = {name: [] for name in source.data}
        self._show_branches(None)
        low, high = sorted((line.ends[line.axis], line.ends[2 + line.axis]))
        self._along.data = {"along": [line.axis]}
        self._section.x_range.update(start=low, end=high)
        self._label(line, low, high)
        self._section.yaxis[0].axis_label = str(self._shows.value)
        self._ended("solving the cells along the cut")
        self._follow.disabled, self._note = line.observe is not None, ""
        self.panel.visible = True
        self._plane.toolbar.active_drag = self._plane.select_one(PanTool)
        self.submit([cut_computation(line, part) for part in line.batches()], partial(self._take, line))

    def show_error(self, reason: str) -> None:
        """Show the reason why some cells cannot be shown."""
        super().show_error(f"part of the cut: {reason}")

    def _take(self, line: CutLine, cells: CutCells) -> None:
        """Show further cells of the line."""
        self._cells = known = cells.merged_with(self._cells)
        self._sources["shown"].data = dict(shown_points(line, known))
        self._sources["exponents"].data = dict(exponents(line, known))
        self._say()

    def _say(self) -> None:
        """Show the number of known cells, and the note about their branches."""
        count = "" if self._cells is None else f"{plural(self._cells.index.size, 'cell')} along the cut"
        more = 0 if self._cells is None else int(np.count_nonzero(self._cells.results.get("more", 0)))
        long = f"{plural(more, 'orbit')} with more than {SAMPLES} values: the first of them" if more else ""
        self._says.text = "; ".join(filter(None, (count, long, html.escape(self._note))))

    def _find_branches(self) -> None:
        if self.topic is None or self._cells is None:
            return
        try:
            sweep = sweep_of(self.topic, self._cells)
        except InputError as error:
            self._ended(str(error))
            return
        self._ended("following branches")
        self._follow.disabled = True  # a running job cannot be cancelled, so each click would occupy another worker
        self.submit([Computation(follow_branches, sweep)], self._take_branches, self._ended)

    def _ended(self, says: str) -> None:
        """Show a note about the branches, and enable the button that follows them."""
        self._note, self._follow.disabled = says, False
        self._say()

    def _take_branches(self, drawn: BranchDiagram) -> None:
        self._show_branches(drawn)
        counts = f"{plural(len(drawn.stretches), 'segment', 'segments')}, {plural(len(drawn.events), 'event')}"
        long = 0 if self._cells is None else too_long(self._cells)
        omitted = f"; without {plural(long, 'cell')} whose orbits have more than {MAX_IMPACTS} impacts" if long else ""
        self._ended(f"branches: {counts}{omitted}; point at an event to read it")

    def _straight(self, along: int) -> None:
        """Cut along one axis, through the clicked cell or the middle of the window."""
        chosen = self._store.now.view
        x, y = chosen.middle(self._subject)
        ends: Cut = (chosen.x[0], y, chosen.x[1], y) if along == 0 else (x, chosen.y[0], x, chosen.y[1])
        self._store.choose(cut=ends)

    def _drew(self, attribute: str, old: Any, new: Any) -> None:
        """Cut along a drawn line, from where the pointer went down to where it went up."""
        if not new["xs"] or len(new["xs"][0]) <= 2:
            return
        x, y = new["xs"][0], new["ys"][0]
        ends = tuple(float(value) for value in (x[0], y[0], x[-1], y[-1]))
        if np.isfinite(ends).all() and ends[:2] != ends[2:]:
            self._store.choose(cut=ends)

    def _over_plane(self) -> None:
        """Add the line to the plane, the point of the line under the pointer, and the drawing tool."""
        lines = [
            self._plane.multi_line(xs="xs", ys="ys", source=self._drawn, line_color=color, line_width=width)
            for color, width in (("white", 5.0), ("black", 2.0))
        ]
        self._dot = ColumnDataSource({"at_x": [], "at_y": []})
        self._plane.scatter(x="at_x", y="at_y", source=self._dot, size=9, fill_color="white", line_color="black")
        self._plane.add_tools(FreehandDrawTool(renderers=lines[1:], num_objects=1, description="draw a cut"))
        self._drawn.on_change("data", self._drew)

    def _draw(self) -> None:
        """Create the parts of the diagrams."""
        of, sources = self._section, self._sources
        of.scatter(x="x", y="y", source=sources["shown"], size=1.8, color="#1a2433", line_color=None)
        self._branches = BranchLines(of)
        below = self._exponents
        below.add_layout(Span(location=0.0, dimension="width", line_color="#9aa4b0"))
        below.varea(x="x", y1="low", y2="high", source=sources["exponents"], fill_alpha=0.25, fill_color="#004488")
        below.line(x="x", y="largest", source=sources["exponents"], line_color="#004488")
        self._spans = [Span(dimension="height", line_color="#bb5566", line_dash="dotted") for _ in range(2)]
        for plot, span in zip((of, below), self._spans, strict=True):
            plot.add_layout(span)
            style_plain(plot)
        of.xaxis[0].visible = False
        entries = zip(ENTRIES, of.renderers, strict=True)
        self._items = [LegendItem(label=label, renderers=[lines]) for label, lines in entries]
        of.add_layout(Legend(items=self._items, **SWITCHES), "above")
        self._show_branches(None)
        of.html_attributes, below.html_attributes = (
            accessible_name("section states along the cut"),
            accessible_name("exponent along the cut"),
        )

    def _show_branches(self, drawn: BranchDiagram | None) -> None:
        """Show branches and their entries in the legend; None hides both."""
        self._branches.show(drawn)
        for item in self._items[1:]:
            item.visible = drawn is not None

    def _link(self) -> None:
        """Have the pointer on one plot mark the same point on the others."""
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
