"""The planes of a page: the first, and beside it the second that its state has, with one view and one pointer."""

from collections.abc import Callable
from functools import partial

from bokeh.events import MouseMove
from bokeh.layouts import row
from bokeh.models import NumericInput, Span
from bokeh.plotting import figure

from atlas.errors import InputError
from atlas.explore.background import Background
from atlas.explore.beside import second
from atlas.explore.chosen import Chosen
from atlas.explore.difference import DifferencePainter
from atlas.explore.explorer import Explorer
from atlas.explore.painter import Painted, Painter
from atlas.explore.pane import Paint, Pane
from atlas.explore.state import State, Store
from atlas.explore.style import PLANES


class Planes:
    """The planes of a page.

    inputs  where the ends of the first one's scale are typed
    heard   hears of each picture of the first plane, or why there is none
    wire    connects a plot with what hears its events
    """

    def __init__(
        self,
        home: Explorer,
        explorer: Explorer,
        background: Background,
        store: Store,
        inputs: tuple[NumericInput, NumericInput],
        heard: Callable[[Painted | str], None],
        wire: Callable[[figure], None],
    ) -> None:
        self._home, self._explorer, self._background, self._store, self._wire = home, explorer, background, store, wire
        self.first = Pane(explorer, background, store.now.chosen, partial(Painter, explorer), heard, None, inputs)
        self._each = [self.first]
        self._second: tuple[Explorer, bool] | None = None
        self.panel = row(self.first.panel, sizing_mode="stretch_both", stylesheets=[PLANES])
        self._hear(self.first)

    def show(self, state: State) -> None:
        """Show the planes that a state has."""
        self.first.show(state.chosen, state.size, state.rests)
        try:
            found = None if state.chosen.beside is None else second(self._home, self._explorer, state)
        except InputError as error:
            self._store.choose(beside=None)
            self._store.set(trouble=str(error))
            return
        wanted = None if found is None else (found[0], found[1].less is not None)
        if wanted != self._second:
            self._second = wanted
            self._replace(None if found is None else self._made(*found))
        if found is not None:
            self._each[1].show(found[1], state.size, state.rests)

    def close(self) -> None:
        """Paint no more."""
        for pane in self._each:
            pane.painter.close()

    def wait(self) -> None:
        """Wait until planes that are closed paint no more."""
        for pane in self._each:
            pane.painter.wait()

    @property
    def left(self) -> int:
        """Tiles that are still to be solved."""
        return sum(self._explorer.patches.left(pane.painter) for pane in self._each)

    def _made(self, explorer: Explorer, chosen: Chosen) -> Pane:
        """A second plane."""
        paint: Paint = partial(Painter, explorer)
        if chosen.less is not None:
            paint = partial(DifferencePainter, explorer, self._explorer)
        return Pane(explorer, self._background, chosen, paint, like=self.first)

    def _replace(self, pane: Pane | None) -> None:
        """Have another second plane, or none."""
        for old in self._each[1:]:
            old.painter.close()
        self._each = [self.first] if pane is None else [self.first, pane]
        lines = [Span(dimension=along, line_color="black", line_width=1) for along in ("width", "height")]
        for each in self._each:
            each.compare(None if pane is None else (lines[0], lines[1]))
        if pane is not None:
            self._hear(pane)
        self.panel.children = [each.panel for each in self._each]

    def _hear(self, pane: Pane) -> None:
        self._wire(pane.plot)
        pane.plot.on_event(MouseMove, self._pointed)

    def _pointed(self, event: MouseMove) -> None:
        """Show the cells at the pointer of both planes."""
        if len(self._each) > 1 and event.x is not None and event.y is not None:
            for pane in self._each:
                pane.pointed.ask((event.x, event.y))
