"""The state of a page, from which all that the page shows is derived, and its listeners."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from atlas.explore.view_state import Range, ViewState


@dataclass(frozen=True)
class PageState:
    """The state of a page.

    view            view state, which the address of the page holds
    size            width and height of the plane, in pixels; 0 before the browser has laid the page out
    at_rest         False while a slider moves, when only the coarsest stage is solved
    box             windows (x, y) that were selected for a new atlas in this view; None if there are none
    missing_parts   missing parts of the picture, with reasons; empty if nothing is missing
    shares          share of the viewport that is known at each stage, the coarsest first; empty without a picture
    trouble         other failures, with reasons; empty if there are none

    A stage is a number of halvings of the full density of cells.
    """

    view: ViewState
    size: tuple[int, int] = (0, 0)
    at_rest: bool = True
    box: tuple[Range, Range] | None = None
    missing_parts: str = ""
    shares: tuple[float, ...] = ()
    trouble: str = ""


class PageModel:
    """Holds the state of a page, and calls its listeners with the old and the new state after each change."""

    def __init__(self, state: PageState) -> None:
        self.now = state
        self._listeners: list[Callable[[PageState, PageState], None]] = []

    def subscribe(self, listener: Callable[[PageState, PageState], None]) -> None:
        """Call ``listener`` with the old and the new state after each change."""
        self._listeners.append(listener)

    def set(self, **fields: Any) -> None:
        """Replace the given fields of the state, and call the listeners if the state has changed."""
        old, self.now = self.now, replace(self.now, **fields)
        if old != self.now:
            for listener in self._listeners:
                listener(old, self.now)

    def choose(self, rests: bool = True, **fields: Any) -> None:
        """Replace the given fields of the view state.

        The trouble of the last view is cleared, and so is the selected box if windows or plane change. Choosing another
        cell ends the followed orbit. ``rests`` is False while a slider moves.
        """
        old, view = self.now, replace(self.now.view, **fields)
        before = old.view
        if view.cell != before.cell and "follow" not in fields:
            view = replace(view, follow=None)
        if view != before:
            stays = (view.x, view.y, view.plane) == (before.x, before.y, before.plane)
            self.set(view=view, at_rest=rests, trouble="", box=old.box if stays else None)

    def escape(self) -> None:
        """End the followed orbit if there is one, else close the cut."""
        if self.now.view.follow is not None:
            self.choose(follow=None)
        else:
            self.choose(cut=None)
