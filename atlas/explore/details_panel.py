"""The panel of the chosen cell: its numbers, its motion, all its attractors, and its orbit along a parameter."""

from collections.abc import Callable
from functools import partial

from atlas.errors import InputError
from atlas.explore.actions import orbit_of
from atlas.explore.attractors import AttractorsPanel
from atlas.explore.background import BackgroundTasks, Show
from atlas.explore.cell_lookup import CellResult
from atlas.explore.explorer import Explorer
from atlas.explore.follow_panel import FollowPanel
from atlas.explore.motion import motion_of
from atlas.explore.panel import Panel, Tell
from atlas.explore.text import cell_given, cell_text, point_line, where
from atlas.explore.view_state import Point, ViewState
from atlas.explore.viewport import Viewport
from workers.results import REGIME


class DetailsPanel(Panel[Point]):
    """The panel of the chosen cell.

    explorer     the explorer that looks up and solves cells
    background   the threads of the page
    tell         tells the page something
    viewport     returns the visible cells of the page; None before the first picture

    follow       the panel that follows the cell's orbit
    """

    def __init__(
        self, explorer: Explorer, background: BackgroundTasks, tell: Tell, viewport: Callable[[], Viewport | None]
    ) -> None:
        super().__init__(explorer, background, tell)
        self._sight = viewport
        self._attractors = AttractorsPanel(explorer, background, tell)
        self.follow = FollowPanel(explorer, background, tell)

    def close(self) -> None:
        """Cancel all computations of the panels."""
        for panel in (self._attractors, self.follow):
            panel.close()

    def show(self, view: ViewState) -> None:
        """Show the chosen cell if it lies in the visible plane and is not shown yet, and its followed orbit."""
        self.follow.show(view)
        if view.cell is not None and view.cell[0] == view.plane and self._sight() is not None:
            self.set_topic(view.cell)

    def start(self, cell: Point) -> None:
        """Tell that a cell is being solved, and look it up or solve it in a thread of the page."""
        self.tell("cell", solving=True)
        self._attractors.set_topic(None)
        self.run_in_background(partial(self._detail, cell, self.progress_callback()))

    def _detail(self, at: Point, soon: Callable[[Show], None]) -> Show:
        plane, point = at[0], at[1:]  # not the present plane: a slider may have moved since
        sight = self._sight()
        cell = None if sight is None else self._explorer.known.cell(plane, sight, *point)
        if cell is None or point != tuple(cell.parameters[name] for name in self._subject.axes):
            cell = self._explorer.known.solve_cell(plane, *point)
        soon(partial(self._show, cell))
        try:
            return partial(self.tell, "motion", motion=motion_of(orbit_of(self._subject, cell)).fields)
        except InputError as error:
            return partial(self.tell, "motion", reason=str(error))

    def _show(self, cell: CellResult) -> None:
        subject, regime = self._subject, str(cell.results[REGIME.name])
        self.tell(
            "cell",
            places=[*where(subject, cell.parameters).items()],
            regime=regime.replace("_", " "),
            given=cell_given(cell, subject),
            command=point_line(cell, subject),
            text=cell_text(cell),
        )
        self._attractors.set_topic(cell)
        self.follow.offer_cell(cell)
