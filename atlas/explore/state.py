"""The one state of a page: what is chosen and what stands on it; all that the page shows is derived from it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from atlas.explore.chosen import Chosen, Range

Ends = tuple[float | None, float | None]


@dataclass(frozen=True)
class State:
    """What a page shows.

    chosen    what its address holds
    size      pixels of the plane; 0 before the browser has laid it out
    rests     whether nothing moves: while a slider does, only the first stage is solved
    box       the window that was chosen for a new atlas
    ends      those of the scale of the picture in view
    lacking   what the picture in view lacks, and why
    trouble   what else cannot be done, and why
    """

    chosen: Chosen
    size: tuple[int, int] = (0, 0)
    rests: bool = True
    box: tuple[Range, Range] | None = None
    ends: Ends = (None, None)
    lacking: str = ""
    trouble: str = ""


class Store:
    """Holds the state. Those who listen get the state before and the state after each change."""

    def __init__(self, state: State) -> None:
        self.now = state
        self._listeners: list[Callable[[State, State], None]] = []

    def listen(self, listener: Callable[[State, State], None]) -> None:
        """Call a listener after every change."""
        self._listeners.append(listener)

    def set(self, **fields: Any) -> None:
        """Change fields of the state."""
        old, self.now = self.now, replace(self.now, **fields)
        if old != self.now:
            for listener in self._listeners:
                listener(old, self.now)

    def choose(self, rests: bool = True, **fields: Any) -> None:
        """Change fields of what is chosen; what was said against the last choice no longer holds."""
        old, chosen = self.now, replace(self.now.chosen, **fields)
        if chosen != old.chosen:
            ends = old.ends if chosen.scale == old.chosen.scale else (None, None)
            self.set(chosen=chosen, rests=rests, trouble="", ends=ends)

    def escape(self) -> None:
        """Close the cut, or else the second plane."""
        fields: dict[str, Any] = {"beside": None} if self.now.chosen.cut is None else {"cut": None}
        self.choose(**fields)
