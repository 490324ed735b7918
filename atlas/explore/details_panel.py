"""The column about cells of an explorer page.

It shows the cell under the pointer, and the clicked cell with its motion and all its attractors.
"""

import html
from collections.abc import Callable
from functools import partial
from typing import Any

from bokeh.events import Tap
from bokeh.layouts import row
from bokeh.models import Button, ColumnDataSource, Div, TextInput
from bokeh.plotting import figure

from atlas.errors import InputError
from atlas.explore.actions import orbit_of
from atlas.explore.attractors import AttractorsPanel
from atlas.explore.background import BackgroundTasks, Show
from atlas.explore.cell_lookup import CellResult
from atlas.explore.explorer import Explorer
from atlas.explore.follow_panel import FollowPanel
from atlas.explore.front.script import call, html_part
from atlas.explore.motion import motion_of
from atlas.explore.motion_panel import MotionPanel
from atlas.explore.page_state import PageModel
from atlas.explore.panel import Panel
from atlas.explore.style import POINTER, TEXT
from atlas.explore.text import cell_given, cell_line, cell_text, point_line
from atlas.explore.view_state import Point, ViewState
from atlas.explore.viewport import Viewport

CLICKED = "<h4>cell clicked</h4>"
ROW = 15.6
"""Height, in pixels, of a row of the table under the pointer."""


class DetailsPanel(Panel[Point]):
    """The panels of the clicked cell, and the table of the cell under the pointer.

    explorer     the explorer that looks up and solves cells
    background   the threads of the page
    store        model of the page's state
    viewport     returns the visible cells of the page; None before the first picture
    mark         Bokeh data source of the mark (x, y) on the clicked cell
    plane        the plot of the plane
    """

    def __init__(
        self,
        explorer: Explorer,
        background: BackgroundTasks,
        store: PageModel,
        viewport: Callable[[], Viewport | None],
        mark: ColumnDataSource,
        plane: figure,
    ) -> None:
        super().__init__(explorer, background)
        self._store, self._sight, self._mark = store, viewport, mark
        style: dict[str, Any] = {"stylesheets": [TEXT], "sizing_mode": "stretch_width"}
        rows = 9  # as many as the numbers of a map fill, so that nothing below them moves
        look = {"stylesheets": [TEXT, POINTER], "styles": {"min-height": f"{round(rows * ROW)}px"}}
        self._pointed = Div(text=f"<h4>cell under the pointer</h4>{html_part('pointer')}", **style | look)
        read_out: Any = {"html_attributes": {"aria-live": "polite"}}
        self._clicked = Div(text="<h4>click a cell: its motion and all its attractors</h4>", **read_out, **style)
        self._reason, self._numbers, self._motion = Div(**style), Div(**style), MotionPanel(self._subject)
        self._attractors = AttractorsPanel(explorer, background, self._motion)
        self._follow = FollowPanel(explorer, background, store, plane)
        self._copy_all = Button(label="copy all numbers, in full", visible=False, sizing_mode="stretch_width")
        self._point = TextInput(title="this cell by itself", visible=False, sizing_mode="stretch_width")
        self._copy = Button(label="copy", visible=False, width=70, align="end")
        for button, source in ((self._copy, self._point), (self._copy_all, self._copy_all)):
            button.js_on_event("button_click", call("copy", source=source))

    @property
    def panels(self) -> list[Any]:
        """The widgets of the column, from the top."""
        line = row(self._point, self._copy, sizing_mode="stretch_width")
        below = [self._attractors.panel, self._motion.panel, self._reason]
        return [self._pointed, self._clicked, line, self._follow.panel, *below, self._numbers, self._copy_all]

    def close(self) -> None:
        """Cancel all computations of the panels."""
        for panel in (self._attractors, self._follow):
            panel.close()

    def click(self, event: Tap) -> None:
        """Choose the cell at a clicked point."""
        if event.x is not None and event.y is not None:
            self.choose(event.x, event.y)

    def choose(self, x: float, y: float) -> None:
        """Choose the cell of the viewport nearest to a point, whether it is known yet or not."""
        self._background.run(partial(self._choose_nearest, (x, y)))

    def show(self, view: ViewState) -> None:
        """Mark the chosen cell if it lies in the visible plane, and show its details if they are not shown yet."""
        cell = view.cell
        at = cell[1:] if cell is not None and cell[0] == view.plane else None
        data = {"x": [at[0]], "y": [at[1]]} if at else {"x": [], "y": []}
        if data != self._mark.data:
            self._mark.data = data
        self._follow.show(view)
        if cell is not None and at and self._sight() is not None:
            self.set_topic(cell)

    def start(self, cell: Point) -> None:
        """Show that a cell is being solved, and look it up or solve it in a thread of the page."""
        self._clicked.text, self._reason.text = f"{CLICKED}solving it", ""
        self._motion.clear()
        self._attractors.set_topic(None)
        self._follow.offer_cell(None)
        self.run_in_background(partial(self._detail, cell, self.progress_callback()))

    def _choose_nearest(self, point: tuple[float, float]) -> Show:
        plane, sight = self._store.now.view.plane, self._sight()
        at = point if sight is None else self._explorer.known.point(plane, sight, *point)
        return lambda: self._store.choose(cell=(plane, *at))

    def _detail(self, at: Point, soon: Callable[[Show], None]) -> Show:
        plane, point = at[0], at[1:]  # not the present plane: a slider may have moved since
        sight = self._sight()
        cell = None if sight is None else self._explorer.known.cell(plane, sight, *point)
        if cell is None or point != tuple(cell.parameters[name] for name in self._subject.axes):
            cell = self._explorer.known.solve_cell(plane, *point)
        soon(partial(self._show, cell))
        try:
            return partial(self._motion.show, motion_of(orbit_of(self._subject, cell)))
        except InputError as error:
            return partial(self._reason.update, text=html.escape(str(error)))

    def _show(self, cell: CellResult) -> None:
        self._clicked.text = f"{CLICKED}{cell_line(cell, self._subject)}"
        self._numbers.text = html_part("cell", cell_given(cell, self._subject))
        self._point.update(value=point_line(cell, self._subject), visible=True)
        self._copy.visible = self._copy_all.visible = True
        self._copy_all.tags = [cell_text(cell)]
        self._attractors.set_topic(cell)
        self._follow.offer_cell(cell)
