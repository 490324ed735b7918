"""The panel that follows the periodic orbit of the clicked cell along a parameter.

It has a slider along the branch of the orbit, the motion, and marks over the plane.
"""

import html
from typing import Any

from bokeh.layouts import column, row
from bokeh.models import Arrow, Button, ColumnDataSource, Div, NormalHead, NumericInput, Select, Slider, Span
from bokeh.plotting import figure

from atlas.explore.background import BackgroundTasks
from atlas.explore.branches import (
    BranchDiagram,
    BranchPosition,
    FollowedBranch,
    arrows,
    branch_computation,
    distance,
    initial_follow,
)
from atlas.explore.branches import EventArrow as Reach
from atlas.explore.cell_lookup import CellResult
from atlas.explore.explorer import Explorer
from atlas.explore.motion_panel import MotionPanel
from atlas.explore.page_state import PageModel
from atlas.explore.panel import Panel
from atlas.explore.plot import BranchLines, style_plain
from atlas.explore.style import TEXT
from atlas.explore.text import first_compile_notice, number, symbol_of
from atlas.explore.view_state import FollowedOrbit, Point, Range, ViewState, followable
from atlas.formatting import plural
from atlas.orbits.branches.table import cycle_period, orbit_name
from atlas.task.compile import ORBITS

FOLLOWABLE = "periodic", "no_impact"
"""Regimes of cells that have an orbit to follow."""
ROOM = 0.3
"""Maximum share of the window's width that the label of an arrow may take; beside the border it changes sides."""
BOUND = 1e9
"""Largest finite multiplier. A larger one belongs to an impact without speed, whose multiplier is infinite but for
rounding.
"""
INK = "#aa3377"
"""Colour of the marks and lines of the followed orbit."""


class FollowPanel(Panel[tuple[Point, tuple[str, float, float]]]):
    """The button and the menu that start and end following an orbit, and the display of the followed orbit."""

    def __init__(self, explorer: Explorer, background: BackgroundTasks, store: PageModel, plane: figure) -> None:
        super().__init__(explorer, background)
        self._store = store
        self._shown: _FollowControls | None = None
        system = explorer.subject.system
        options = [
            (name, f"{symbol_of(system, name)} {system.parameter(name).meaning.split(':')[0]}")
            for name in followable(explorer.subject)
        ]
        self._along = Select(title="its orbit along", options=options, value=options[0][0], sizing_mode="stretch_width")
        self._button = Button(label="follow", width=110, align="end")
        self._button.on_click(self._press)
        self._along.on_change("value", lambda _, old, new: self._label())
        self._says = Div(stylesheets=[TEXT], sizing_mode="stretch_width", visible=False)
        self._body = column(sizing_mode="stretch_width")
        head = row(self._along, self._button, sizing_mode="stretch_width")
        self.panel = column(head, self._says, self._body, sizing_mode="stretch_width", visible=False)
        self._marker = ColumnDataSource({"follow_x": [], "follow_y": []})
        self._arrows = ColumnDataSource({name: [] for name in _COLUMNS})
        self._over_plane(plane)

    def offer_cell(self, cell: CellResult | None) -> None:
        """Show the controls if the cell has an orbit to follow, or an orbit is followed already."""
        there_is_one = cell is not None and cell.results["regime"] in FOLLOWABLE
        self.panel.visible = there_is_one or self.topic is not None

    def show(self, view: ViewState) -> None:
        """Follow the orbit that the view state chooses, and show its position on the branch."""
        follow, cell = view.follow, view.cell
        self.set_topic(None if follow is None or cell is None else (cell, follow[:3]))
        if self._shown is not None and follow is not None and cell is not None:
            self._mark(view, cell, self._shown.branch, self._shown.move(follow))

    def start(self, about: tuple[Point, tuple[str, float, float]]) -> None:
        """Have the branch of a cell's orbit computed on a worker.

        about   the cell, and the parameter with the limits (low, high) between which the branch has smaller steps
        """
        self.clear()
        cell, (along, low, high) = about
        self.panel.visible, self._along.value = True, along
        self._label()
        system = self._subject.system
        self._say(f"following its branch along {symbol_of(system, along)}{first_compile_notice(system, ORBITS)}")
        self.submit([branch_computation(self._subject, cell, (along, low, high))], self._take)

    def clear(self) -> None:
        """Remove the branch from the panel, and its marks from the plane."""
        if self._shown is not None:
            self._shown.motion.clear()
        self._shown, self._body.children = None, []
        self._say("")
        self._label()
        self._marker.data = {name: [] for name in self._marker.data}
        self._arrows.data = {name: [] for name in _COLUMNS}

    def show_error(self, reason: str) -> None:
        """End following, and show the reason."""
        self._store.choose(follow=None)
        self._say(reason)

    def _follows(self) -> bool:
        """Return True if an orbit is being followed along the parameter that the menu shows."""
        follow = self._store.now.view.follow
        return follow is not None and follow.along == self._along.value

    def _label(self) -> None:
        self._button.label = "end following" if self._follows() else "follow"

    def _press(self) -> None:
        view = self._store.now.view
        if self._follows():
            self._store.choose(follow=None)
        elif view.cell is not None:
            self._store.choose(follow=initial_follow(self._subject, view, view.cell, str(self._along.value)))

    def _take(self, branch: FollowedBranch) -> None:
        self._say("")
        self._shown = _FollowControls(self._explorer, self._store, branch)
        self._body.children = self._shown.parts
        self.show(self._store.now.view)

    def _say(self, text: str) -> None:
        self._says.update(text=html.escape(text), visible=bool(text))

    def _over_plane(self, plane: figure) -> None:
        """Add to the plot of the plane the marker of the followed orbit and the arrows to its neighbouring events."""
        ends: dict[str, Any] = {"x_start": "x0", "y_start": "y0", "x_end": "x1", "y_end": "y1"}
        for color, width, size in (("white", 5.0, 12), (INK, 2.0, 9)):
            head = NormalHead(size=size, line_color=color, fill_color=color)
            plane.add_layout(Arrow(end=head, source=self._arrows, line_color=color, line_width=width, **ends))
        at: dict[str, Any] = {"x": "follow_x", "y": "follow_y", "source": self._marker, "level": "overlay"}
        plane.scatter(marker="diamond", size=18, fill_color=INK, line_color="white", line_width=1.5, **at)
        at = {"x": "x0", "y": "y0", "text": "text", "source": self._arrows, "level": "overlay"}
        at |= {"text_align": "align", "text_baseline": "baseline", "x_offset": "right", "y_offset": "down"}
        look = {"text_color": INK, "text_font_size": "13px", "background_fill_color": "white", "padding": 2}
        plane.text(background_fill_alpha=0.85, **at, **look)

    def _mark(self, view: ViewState, cell: Point, branch: FollowedBranch, position: BranchPosition) -> None:
        """Mark the followed orbit over the plane, with its arrows, if its fixed parameters are those of the plane."""
        values = self._subject.values(*cell) | {branch.table.along: position.value}
        inside = all(values[name] == value for name, value in view.plane.parameters)
        names = zip(self._marker.data, self._subject.axes, strict=True)
        marker = {name: [values[axis]] if inside else [] for name, axis in names}
        drawn: dict[str, list[Any]] = {name: [] for name in _COLUMNS}
        for k, arrow in enumerate(arrows(branch, position, self._subject, view, cell) if inside else ()):
            ends = arrow.x0, arrow.y0, arrow.x1, arrow.y1
            for name, value in zip(_COLUMNS, (*ends, *label_of(arrow, k, view.x)), strict=True):
                drawn[name].append(value)
        for source, data in ((self._marker, marker), (self._arrows, drawn)):
            if source.data != data:
                source.data = data


def label_of(arrow: Reach, k: int, visible: Range) -> tuple[str, str, str, int, int]:
    """Return the label of an arrow to an event: its text, alignment, baseline, and offsets from the marker in pixels.

    arrow     the arrow
    k         index of the arrow, 0 or 1; it decides on which side of the line, or how far along it, the text stands
    visible   limits (low, high) of the horizontal axis

    The text lies on the side to which the arrow points, if the window has room there.
    """
    (low, high), across = visible, arrow.y0 == arrow.y1
    ahead = arrow.x1 + arrow.y1 > arrow.x0 + arrow.y0
    position = (arrow.x0 - low) / (high - low)
    if across:
        leftwards = ahead == ((1.0 - position if ahead else position) < ROOM)
        text, baseline, down = (f"{arrow.text} →" if ahead else f"← {arrow.text}"), ("bottom", "top")[k], (-8, 8)[k]
    else:
        leftwards = position > 1.0 - ROOM
        text, baseline = (f"↑ {arrow.text}", "bottom") if ahead else (f"↓ {arrow.text}", "top")
        down = (10 + 18 * k) * (-1 if ahead else 1)
    return text, "right" if leftwards else "left", baseline, -14 if leftwards else 14, down


_COLUMNS = ("x0", "y0", "x1", "y1", "text", "align", "baseline", "right", "down")


class _FollowControls:
    """The widgets of a branch: they show the followed orbit and change its position on the branch."""

    def __init__(self, explorer: Explorer, store: PageModel, branch: FollowedBranch) -> None:
        self.branch, self._subject, self._store = branch, explorer.subject, store
        self._symbol = symbol_of(self._subject.system, branch.table.along)
        self._at: FollowedOrbit | None = None
        self._here = branch.position_at(branch.own_index, branch.values[branch.own_index])
        wide: dict[str, Any] = {"sizing_mode": "stretch_width"}
        last = len(branch.values) - 1
        self._slider = Slider(
            title="along the branch", start=0, end=last, value=branch.own_index, step=1, show_value=False,
            bar_color=INK,
            **wide,
        )  # fmt: skip
        self._typed = NumericInput(
            title=self._symbol, value=self._here.value, mode="float", width=110, format="0[.]000000"
        )
        self._slider.on_change("value", self._slide)
        self._typed.on_change("value", self._type)
        self._text = Div(stylesheets=[TEXT], **wide)
        low, high = min(branch.values), max(branch.values)
        margin = 0.04 * (high - low)
        diagram = figure(
            height=170, x_range=(low - margin, high + margin), y_axis_label="gap at t = kT", toolbar_location=None,
            tools="", min_border_left=58, **wide,
        )  # fmt: skip
        BranchLines(diagram).show(BranchDiagram.from_table(branch.table))
        self._span = Span(location=self._here.value, dimension="height", line_color=INK)
        diagram.add_layout(self._span)
        self._points = ColumnDataSource({"branch_x": [], "branch_gap": []})
        diagram.scatter(x="branch_x", y="branch_gap", source=self._points, size=9, color=INK, line_color="white")
        style_plain(diagram)
        diagram.xaxis[0].axis_label = self._symbol
        self.motion = MotionPanel(self._subject)
        self.parts = [row(self._slider, self._typed, **wide), self._text, diagram, self.motion.panel]

    def move(self, follow: FollowedOrbit) -> BranchPosition:
        """Show the orbit that a view state chooses, and return its position on the branch."""
        if follow == self._at:
            return self._here
        self._at = follow
        self._here = position = self.branch.position_at(self.branch.own_index + follow.step, follow.value)
        self._slider.value, self._typed.value, self._span.location = (
            position.point_index,
            position.value,
            position.value,
        )
        self._text.text = self._table()
        motion = self.branch.motion(position)
        gap = motion.moving[0][:: int(motion.per_period)]
        self._points.data = {"branch_x": [position.value] * gap.size, "branch_gap": gap}
        self.motion.portray({0: motion})
        self.motion.show(motion)
        return position

    def _go(self, index: int, value: float) -> None:
        now = self._store.now.view.follow
        if now is not None:
            self._store.choose(follow=now._replace(step=index - self.branch.own_index, value=value))

    def _slide(self, attribute: str, old: Any, new: Any) -> None:
        """Go to the solution point that the slider was moved to; the arguments are those of Bokeh's callbacks."""
        if int(new) != self._here.point_index:
            self._go(int(new), self.branch.values[int(new)])

    def _type(self, attribute: str, old: Any, new: Any) -> None:
        """Go to the orbit with the typed value of the parameter, of several the nearest along the branch."""
        if new == self._here.value:
            return
        index = None if new is None else self.branch.find_point(float(new), self._here)
        if index is not None:
            self._go(index, float(new))
            return
        if new is not None:
            low, high = number(min(self.branch.values)), number(max(self.branch.values))
            said = html.escape(f"{self._symbol}: found {number(float(new))}, must be {low} to {high} on this branch")
            self._text.text = f'<span class="trouble">{said}</span>{self._table()}'
        self._typed.value = self._here.value

    def _table(self) -> str:
        """Return the properties of the followed orbit as an HTML table."""
        position, branch = self._here, self.branch
        outside = f"unstable, {plural(position.point.unstable, 'multiplier')} outside the unit circle"
        stability = outside if position.point.unstable else "stable"
        largest = f"{number(position.multiplier, 5)} in modulus" if position.multiplier < BOUND else "without bound"
        orbit = position.point.orbit.itinerary
        period = plural(orbit.periods, "forcing period")
        if orbit.is_cycle:
            period = f"cycle of {number(cycle_period(position.point, orbit), 8)}"
        rows = [
            (self._symbol, number(position.value, 8)), ("period", period),
            ("orbit n-p-q", orbit_name(orbit, branch.table.system)),
            ("stability", f"changes here: {position.kind}" if position.kind else stability),
            ("largest multiplier", largest),
        ]  # fmt: skip
        for mark, side, end in zip(branch.neighbouring_events(position), ("◄", "►"), (0, -1), strict=True):
            text = f"none up to {number(branch.values[end])}, where the range ends"
            if mark is not None:
                text = f"{mark.kind} at {number(mark.value)} ({distance(mark, position)})"
            rows.append((f"{side} next event", text))
        folds = [
            f"{number(mark.value)} (point {mark.point_index + 1})" for mark in branch.events if mark.kind == "fold"
        ]
        rows += [("turns back at", ", ".join(folds))] if folds else []
        point_text = f"point {position.point_index + 1} of {len(branch.values)}"
        body = "".join("<tr><td>{}</td><td>{}</td></tr>".format(*map(html.escape, entry)) for entry in rows)
        return f"<table><caption>orbit followed, {point_text}</caption>{body}</table>"
