"""The plane of the page: its title, its figure, what explains its colours, and what paints it."""

from collections.abc import Callable
from typing import Any

from bokeh.layouts import column, row
from bokeh.models import ColumnDataSource, Div, Label, NumericInput
from bokeh.plotting import figure

from atlas.explore.background import Background
from atlas.explore.chosen import Chosen
from atlas.explore.explorer import Explorer
from atlas.explore.painter import Painted, Painter
from atlas.explore.picture import Picture
from atlas.explore.plot import label_axes, make_plot
from atlas.explore.style import BAR, KEY, KEY_WIDTH, LINE, PANE, PLANE, TEXT
from atlas.explore.words import key_image, progress_bar, title

LINE_HEIGHT = 20


class Pane:
    """The plane of a page.

    inputs  where the ends of its scale are typed
    heard   hears of each picture, or why there is none
    """

    def __init__(
        self,
        explorer: Explorer,
        background: Background,
        chosen: Chosen,
        inputs: tuple[NumericInput, NumericInput],
        heard: Callable[[Painted | str], None],
    ) -> None:
        self._subject, self._chosen, self._heard = explorer.subject, chosen, heard
        # Of fixed height, whatever they say: else the plane would change its size with every word.
        line: dict[str, Any] = {"stylesheets": [TEXT, LINE], "sizing_mode": "stretch_width", "height": LINE_HEIGHT}
        self._title = Div(text=title(explorer.subject, chosen.plane), **line)
        self._bar = Div(sizing_mode="stretch_width", height=3, margin=0, stylesheets=[BAR])
        self._key = Div(width=KEY_WIDTH, sizing_mode="stretch_height", margin=0, stylesheets=[TEXT, KEY])
        self.mark = ColumnDataSource({"x": [], "y": []})
        self.plot: figure
        self.plot, image = make_plot(explorer.subject, chosen, self.mark)
        self._picture = Picture(image, *inputs)
        self._waiting = Label(x=12, y=12, x_units="screen", y_units="screen", text="drawing the first picture")
        self.plot.add_layout(self._waiting)
        plane = row(self.plot, self._key, sizing_mode="stretch_both", stylesheets=[PLANE])
        self.panel = column(self._title, self._bar, plane, sizing_mode="stretch_both", stylesheets=[PANE])
        self.painter = Painter(explorer, background.later(self._show), background.later(self._unpainted))

    def show(self, chosen: Chosen, size: tuple[int, int], rests: bool) -> None:
        """Show what is chosen on so many pixels."""
        old, self._chosen, subject = self._chosen, chosen, self._subject
        if (chosen.x, chosen.y) != (old.x, old.y):
            label_axes(self.plot, subject, chosen)
        if chosen.plane != old.plane:
            self._title.text = title(subject, chosen.plane)
        self.painter.show(chosen, size, rests)

    def _show(self, painted: Painted) -> None:
        """Put a picture on the page."""
        self._waiting.visible = False
        self._picture.show(painted)
        self._key.text = key_image(painted.screen)
        self._bar.text = progress_bar(painted.shares)
        self._heard(painted)

    def _unpainted(self, why: str) -> None:
        """Show no picture, least of all one of something else, and say why."""
        self._picture.clear()
        self._key.text = self._bar.text = ""
        self._heard(why)
