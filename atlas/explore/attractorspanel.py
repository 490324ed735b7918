"""The panel of all attractors of the cell that was clicked, with their portraits in one phase plane."""

from functools import partial

from bokeh.models import Div

from atlas.explore.attractors import KeptAttractors, attractors_asked, known_attractors
from atlas.explore.background import Background, Show
from atlas.explore.explorer import Explorer
from atlas.explore.known import Cell
from atlas.explore.motion import motions
from atlas.explore.motionpanel import MotionPanel
from atlas.explore.panel import Panel
from atlas.explore.style import TEXT
from atlas.explore.words import attractors_table, compiled_first
from atlas.task.compile import ATTRACTORS

ALL = "<h4>all attractors of this cell</h4>"


class AttractorsPanel(Panel[Cell]):
    """Their table; ``motion`` gets their portraits."""

    def __init__(self, explorer: Explorer, background: Background, motion: MotionPanel) -> None:
        super().__init__(explorer, background)
        self._motion = motion
        self.panel = Div(stylesheets=[TEXT], sizing_mode="stretch_width")

    def begin(self, cell: Cell) -> None:
        """Look for the attractors of a cell in the store, and have them sought otherwise."""
        self.panel.text = ALL
        self.work(lambda: partial(self._known, cell, known_attractors(self._subject, cell)))

    def clear(self) -> None:
        """Show none."""
        self.panel.text = ""

    def refuse(self, why: str) -> None:
        """Say why there are none."""
        self._show(KeptAttractors(trouble=why))

    def _known(self, cell: Cell, found: KeptAttractors | None) -> None:
        if found is None:
            first = compiled_first(self._subject.system, ATTRACTORS)
            sought = f"being sought from {self._subject.starts.count} initial states{first}"
            self.panel.text = f'{ALL}<span class="waiting">{sought}</span>'
            self.ask([attractors_asked(self._subject, cell)], partial(self._take, cell))
        else:
            self._take(cell, found)

    def _take(self, cell: Cell, found: KeptAttractors) -> None:
        """Show attractors, and draw the portraits of more than one."""
        self._show(found)
        states = [each["state"] for each in found.each if "state" in each]

        def portraits() -> Show:
            drawn = motions(self._subject, cell.parameters, states)
            return lambda: self._motion.portray(drawn) if drawn else None

        if len(found.each) > 1:
            self.work(portraits)

    def _show(self, found: KeptAttractors) -> None:
        self.panel.text = ALL + attractors_table(found, self._subject)
