"""The panel of a cut: it has the cells along the line solved, and tells the page what its diagrams draw."""

import numpy as np

from atlas.explore.background import BackgroundTasks
from atlas.explore.cut import SAMPLES, CutCells, CutLine, cut_computation, exponents, shown_points, to_observe
from atlas.explore.explorer import Explorer
from atlas.explore.panel import Panel, Tell
from atlas.explore.text import axis_label, symbol_of
from atlas.explore.view_state import ViewState
from atlas.formatting import plural


class CutPanel(Panel[CutLine]):
    """The panel with the diagrams along the line of the cut; it requests the cells of the line from the workers."""

    def __init__(self, explorer: Explorer, background: BackgroundTasks, tell: Tell) -> None:
        super().__init__(explorer, background, tell)
        self._possible = to_observe(explorer.subject)
        self._cells: CutCells | None = None

    def show(self, view: ViewState, shows: str) -> None:
        """Show the diagrams of a view's cut, if it has one, with the quantity ``shows``, by its words in the menu."""
        observe = self._possible.get(shows)
        self.set_topic(None if view.cut is None else CutLine(self._subject, view.plane, view.cut, observe))

    def start(self, line: CutLine) -> None:
        """Tell that nothing is known of a line yet, and request its cells from the workers."""
        self._cells = None
        self._show(
            line, CutCells(np.zeros(0, np.int64), {"shown": np.zeros((0, 1))}), "solving the cells along the cut"
        )
        self.submit([cut_computation(line, part) for part in line.batches()], lambda cells: self._take(line, cells))

    def _take(self, line: CutLine, cells: CutCells) -> None:
        """Add solved cells of the cut to its diagrams."""
        self._cells = known = cells.merged_with(self._cells)
        more = int(np.count_nonzero(known.results.get("more", 0)))
        long = f"; {plural(more, 'orbit')} with more than {SAMPLES} values: the first of them" if more else ""
        self._show(line, known, f"{plural(known.index.size, 'cell')} along the cut{long}")

    def _show(self, line: CutLine, cells: CutCells, says: str) -> None:
        low, high = sorted((line.ends[line.axis], line.ends[2 + line.axis]))
        label, other = axis_label(line.subject.system, line.name), line.subject.axes[1 - line.axis]
        self.tell(
            "cut",
            axis=line.axis,
            label=label if line.level else f"{label}, {symbol_of(line.subject.system, other)} along the cut",
            range=(low, high),
            shown=dict(shown_points(line, cells)),
            exponents=dict(exponents(line, cells)),
            says=says,
        )
