"""A plane of the page: its title, its figure, what explains its colours, and what paints it."""

import html
from collections.abc import Callable
from typing import Any

from bokeh.layouts import column, row
from bokeh.models import ColumnDataSource, CrosshairTool, Div, NumericInput, Span
from bokeh.plotting import figure

from atlas.explore.background import Background, Latest, Show
from atlas.explore.chosen import Chosen
from atlas.explore.explorer import Explorer
from atlas.explore.painter import Painted, Painter
from atlas.explore.picture import Picture
from atlas.explore.plot import label_axes, make_plot
from atlas.explore.style import BAR, KEY, KEY_WIDTH, LINE, PANE, PLANE, TEXT
from atlas.explore.words import cell_reading, key_image, progress_bar, title

LINE_HEIGHT = 20
Paint = Callable[[Callable[[Painted], None], Callable[[str], None]], Painter]


class Pane:
    """A plane of a page.

    paint   makes its painter of what takes pictures and of what hears why there is none
    heard   hears of each picture, or why there is none; without it the plane says so itself
    like    the plane beside it, whose view it shares
    inputs  where the ends of its scale are typed

    ``pointed`` is asked for the cells at points, (x, y).
    """

    def __init__(
        self,
        explorer: Explorer,
        background: Background,
        chosen: Chosen,
        paint: Paint,
        heard: Callable[[Painted | str], None] | None = None,
        like: "Pane | None" = None,
        inputs: tuple[NumericInput, NumericInput] | None = None,
    ) -> None:
        self._explorer, self._chosen = explorer, chosen
        self._heard = self._say if heard is None else heard
        # Of fixed height, whatever they say: else the plane would change its size with every word.
        line: dict[str, Any] = {"stylesheets": [TEXT, LINE], "sizing_mode": "stretch_width", "height": LINE_HEIGHT}
        self._title = Div(text=title(explorer.subject, chosen.plane), **line)
        self._note, self._reading = (Div(visible=False, margin=(0, 5), **line) for _ in range(2))
        self._bar = Div(sizing_mode="stretch_width", height=3, margin=0, stylesheets=[BAR])
        self._key = Div(width=KEY_WIDTH, sizing_mode="stretch_height", margin=0, stylesheets=[TEXT, KEY])
        self.mark: ColumnDataSource = ColumnDataSource({"x": [], "y": []}) if like is None else like.mark
        self.plot: figure
        self.plot, image = make_plot(explorer.subject, chosen, self.mark, None if like is None else like.plot)
        self._picture = Picture(image, *(inputs or (NumericInput(), NumericInput())))
        plane = row(self.plot, self._key, sizing_mode="stretch_both", stylesheets=[PLANE])
        parts = self._title, self._reading, self._note, self._bar, plane
        self.panel = column(*parts, sizing_mode="stretch_both", stylesheets=[PANE])
        self.pointed = Latest(background, self._look_up)
        later = background.later
        self.painter = paint(later(self._show), later(self._unpainted))

    def show(self, chosen: Chosen, size: tuple[int, int], rests: bool) -> None:
        """Show what is chosen on so many pixels."""
        old, self._chosen, subject = self._chosen, chosen, self._explorer.subject
        if (chosen.x, chosen.y) != (old.x, old.y):
            label_axes(self.plot, subject, chosen)
        if chosen.plane != old.plane:
            self._title.text = title(subject, chosen.plane)
        self.painter.show(chosen, size, rests)

    def compare(self, crosshair: tuple[Span, Span] | None) -> None:
        """Show, or show no more, notes, cells under the pointer, and a crosshair that planes side by side share."""
        self._note.visible = self._reading.visible = crosshair is not None
        self._reading.text = ""
        tools = [tool for tool in self.plot.tools if not isinstance(tool, CrosshairTool)]
        self.plot.tools = tools if crosshair is None else [*tools, CrosshairTool(overlay=crosshair)]

    def _look_up(self, at: tuple[float, float]) -> Show:
        """Show what is known of the cell at a point."""
        chosen, sight, subject = self._chosen, self.painter.sight, self._explorer.subject
        cell = None if sight is None else self._explorer.known.cell(chosen.plane, sight, *at)
        text = "not known yet" if cell is None else cell_reading(cell, subject, chosen.names)
        return lambda: self._reading.update(text=text)

    def _say(self, found: Painted | str) -> None:
        """Show the note on a picture, or why there is none."""
        self._note.text = html.escape(found if isinstance(found, str) else found.note)

    def _show(self, painted: Painted) -> None:
        """Put a picture on the page."""
        self._picture.show(painted)
        self._key.text = key_image(painted.screen)
        self._bar.text = progress_bar(painted.cells, painted.left)
        self._heard(painted)

    def _unpainted(self, why: str) -> None:
        """Show no picture, least of all one of something else, and say why."""
        self._picture.clear()
        self._key.text = self._bar.text = ""
        self._heard(why)
