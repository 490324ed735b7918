"""The one state of a page, from which all that it shows is derived."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from atlas.explore.view_state import Range, ViewState


@dataclass(frozen=True)
class PageState:
    """The state of a page.

    chosen    the choice in its address
    size      pixels of the plane; 0 before the browser has laid it out
    rests     whether nothing moves: while a slider does, only the first stage is solved
    box       the window that was chosen for a new atlas, in this view
    lacking   missing parts of the picture in view, and why
    shares    of each stage, the coarsest first, the share of the view that is drawn as densely; empty without a picture
    trouble   other failures, and why
    """

    view: ViewState
    size: tuple[int, int] = (0, 0)
    at_rest: bool = True
    box: tuple[Range, Range] | None = None
    missing_parts: str = ""
    shares: tuple[float, ...] = ()
    trouble: str = ""


class PageModel:
    """Holds the state. Those who listen get the state before and the state after each change."""

    def __init__(self, state: PageState) -> None:
        self.now = state
        self._listeners: list[Callable[[PageState, PageState], None]] = []

    def subscribe(self, listener: Callable[[PageState, PageState], None]) -> None:
        """Call a listener after every change."""
        self._listeners.append(listener)

    def set(self, **fields: Any) -> None:
        """Change fields of the state."""
        old, self.now = self.now, replace(self.now, **fields)
        if old != self.now:
            for listener in self._listeners:
                listener(old, self.now)

    def choose(self, rests: bool = True, **fields: Any) -> None:
        """Change fields of the choice; the trouble of the last choice goes, and the box of another view.

        An orbit is followed until another cell is chosen.
        """
        old, chosen = self.now, replace(self.now.view, **fields)
        before = old.view
        if chosen.cell != before.cell and "follow" not in fields:
            chosen = replace(chosen, follow=None)
        if chosen != before:
            stays = (chosen.x, chosen.y, chosen.plane) == (before.x, before.y, before.plane)
            self.set(view=chosen, at_rest=rests, trouble="", box=old.box if stays else None)

    def escape(self) -> None:
        """Follow an orbit no further, or else close the cut."""
        if self.now.view.follow is not None:
            self.choose(follow=None)
        else:
            self.choose(cut=None)
