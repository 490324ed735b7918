"""The panel that shows the basins of the clicked cell."""

import html
from functools import partial
from typing import Any

import numpy as np
from bokeh.layouts import column
from bokeh.models import Button, ColumnDataSource, Div, Range1d
from bokeh.plotting import figure
from numpy.typing import NDArray

from atlas.explore.accessibility import accessible_name
from atlas.explore.background import BackgroundTasks
from atlas.explore.basins import BAND, SIDE, UNSOLVED, BasinGrid, label_computation
from atlas.explore.cell_lookup import CellResult
from atlas.explore.explorer import Explorer
from atlas.explore.panel import Panel
from atlas.explore.plot import style_plain
from atlas.explore.style import TEXT
from atlas.explore.text import first_compile_notice, symbol_of
from atlas.formatting import plural
from atlas.render.class_maps import BASINS
from atlas.task.compile import ATTRACTORS


class BasinsPanel(Panel[CellResult]):
    """The button that requests the basins of a cell, and the plane of initial states that shows them."""

    def __init__(self, explorer: Explorer, background: BackgroundTasks) -> None:
        super().__init__(explorer, background)
        self._labels = np.zeros((0, 0), dtype=np.int32)
        self._button = Button(label="basins of this cell", visible=False, sizing_mode="stretch_width")
        self._button.on_click(self._ask)
        self._says = Div(stylesheets=[TEXT], visible=False)
        self._image = ColumnDataSource({"basins": [], "x0": [], "y0": [], "w": [], "h": []})
        self._start = ColumnDataSource({"start_x": [], "start_y": []})
        self._plot = figure(
            height=260, sizing_mode="stretch_width", toolbar_location=None, tools="", visible=False,
            x_range=Range1d(0.0, 1.0), y_range=Range1d(0.0, 1.0),
        )  # fmt: skip
        self._plot.html_attributes = accessible_name("basins of the cell over its initial states")
        self._plot.image_rgba(image="basins", x="x0", y="y0", dw="w", dh="h", source=self._image)
        look: dict[str, Any] = {"marker": "circle", "fill_color": "white", "line_color": "black"}
        self._plot.scatter(x="start_x", y="start_y", source=self._start, size=8, **look)
        style_plain(self._plot)
        self.panel = column(self._button, self._says, self._plot, sizing_mode="stretch_width")

    def start(self, cell: CellResult) -> None:
        """Offer the basins of a cell if they can be searched."""
        self.clear()
        self._button.visible = self._subject.can_search_attractors

    def clear(self) -> None:
        """Hide the button and the plane."""
        self._button.visible = self._says.visible = self._plot.visible = False

    def show_error(self, reason: str) -> None:
        """Show the reason why there are no basins."""
        self._says.text = html.escape(f"basins: {reason}")

    def _ask(self) -> None:
        cell = self.topic
        if cell is None:
            return
        first = first_compile_notice(self._subject.system, ATTRACTORS)
        self._says.update(text=f"solving initial states{first}", visible=True)
        self._button.visible = False
        self.run_in_background(
            lambda: partial(self._lay_out, cell, BasinGrid.from_cell(self._subject, cell.parameters))
        )

    def _lay_out(self, cell: CellResult, grid: BasinGrid) -> None:
        """Set up the plot of a plane of initial states, and have the states solved."""
        self._labels = np.full((SIDE, SIDE), UNSOLVED, dtype=np.int32)
        self._plot.xaxis[0].axis_label, self._plot.yaxis[0].axis_label = (
            symbol_of(self._subject.system, name) for name in (grid.x[0], grid.y[0])
        )
        own = [cell.parameters[name] for name in (grid.x[0], grid.y[0])]
        self._start.data = {"start_x": own[:1], "start_y": own[1:]}
        (left,), (low,), (width,), (height,) = (grid.box[name] for name in ("x0", "y0", "w", "h"))
        self._plot.x_range.update(start=left, end=left + width)
        self._plot.y_range.update(start=low, end=low + height)
        self._plot.visible = True
        rows = [slice(first, first + BAND) for first in range(0, SIDE, BAND)]
        self.submit([label_computation(grid, some) for some in rows], partial(self._take, grid))

    def _take(self, grid: BasinGrid, answer: tuple[slice, NDArray[np.int32]]) -> None:
        rows, labels = answer
        self._labels[rows] = labels
        self._image.data = {"basins": [label_colors(self._labels)], **grid.box}
        count = np.unique(self._labels[self._labels >= 0]).size
        left = np.count_nonzero(self._labels == UNSOLVED)
        more = f"; {left} not solved yet" if left else ""
        self._says.text = (
            f"initial states reach {plural(count, 'attractor')}, mirror images counted apart, in colours of their own;"
            f" of grey ones the attractor is not known{more}"
        )


def label_colors(labels: NDArray[np.int32]) -> NDArray[np.uint32]:
    """Return the colour of each label as Bokeh expects it: grey for an unknown attractor, transparent if unsolved."""
    colors = np.array([[int(color[k : k + 2], 16) for k in (1, 3, 5)] + [255] for color in BASINS], dtype=np.uint8)
    grey = np.array([[221, 221, 221, 255]], dtype=np.uint8)
    chosen = np.where((labels >= 0)[..., None], colors[labels % len(BASINS)], grey)
    chosen[labels == UNSOLVED] = 0
    return np.ascontiguousarray(chosen).view(np.uint32)[..., 0]
