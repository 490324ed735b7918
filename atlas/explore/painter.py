"""What a page shows, made in a thread of the page's own: looked up, drawn, wanted, drawn again as tiles come in.

Each step is planned for a time; what is chosen meanwhile replaces the steps that are not taken yet.
"""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from atlas.errors import InputError, RunError
from atlas.explore.chosen import CHART, Chosen, Ends, Range, beginning
from atlas.explore.explorer import Explorer
from atlas.explore.style import KEY_WIDTH
from atlas.explore.subject import SubjectPlane
from atlas.explore.threads import steady
from atlas.explore.view import STAGES, Sight, TileKey
from atlas.platform import give_back_memory
from atlas.render import has_scale
from atlas.render.kinds import OverlayError
from atlas.render.screen import Screen, screen
from workers.results import PENDING, REGIME

if TYPE_CHECKING:
    import xarray as xr

REST = 0.15
"""Seconds without a change after which a view is looked up."""
STAY = 0.7
"""Seconds without a change after which a plane that a slider moves to is solved in full."""
GIVE_BACK = 10.0
"""Seconds, at least, between two times that memory freed by drawing is returned to the system."""
PAUSE = 0.35
"""Seconds between two pictures, at least."""
SHARE = 0.6
"""At most so much of the time is spent on drawing."""
WHOLE = (240, 180)
"""Pixels of the picture of the whole plane that the ends of a scale are taken from."""
SETTLED = 0.01
"""Share of pending cells from which on a picture can say how far a scale should reach."""

FIRST, ALL = range(STAGES, STAGES - 1, -1), range(STAGES, -1, -1)
"""The stages that are solved of a view while a slider moves, and once it rests."""


@dataclass(frozen=True)
class Painted:
    """A picture: its pixels, the window that it fills, the ends of its scale, and a note on it, such as why lines that
    were asked for are missing; of each stage, the coarsest first, the share of the view that is known as densely.
    """

    screen: Screen
    x: Range
    y: Range
    ends: Ends
    note: str
    shares: tuple[float, ...]


def warm(explorer: Explorer) -> None:
    """Draw something once, so that the first page need not wait for all that drawing loads."""
    chosen = beginning(explorer.subject)
    sight = explorer.subject.sight(chosen.x, chosen.y, WHOLE)
    _drawn(explorer.known.seen(chosen.plane, sight, chosen.names), chosen, WHOLE)


class Painter:
    """Paints for one page. ``deliver`` and ``refuse`` get pictures and what speaks against one, in this thread."""

    def __init__(self, explorer: Explorer, deliver: Callable[[Painted], None], refuse: Callable[[str], None]) -> None:
        self._explorer, self._deliver, self._refuse = explorer, deliver, refuse
        self._changed, self._closed, self._at_work = threading.Condition(), False, False
        self._asked: tuple[Chosen, tuple[int, int]] | None = None
        self._looked: tuple[Chosen, tuple[int, int]] | None = None
        self._plan: dict[range | None, float] = {}
        self._rested = 0.0
        self._scales: dict[tuple[object, ...], Range] = {}
        self.looked = 0
        self.sight: Sight | None = None
        explorer.listen(self, self._told)
        self._thread = steady("atlas-painter", self._serve, self._mistaken)

    def show(self, chosen: Chosen, size: tuple[int, int], rests: bool = True) -> None:
        """Show this on so many pixels. While a slider moves, nothing ``rests``: at first the first stage is solved."""
        asked, now = (chosen.picture, size), time.monotonic()
        with self._changed:
            if asked != self._asked:
                self._asked = asked
                self._plan = {ALL: now + REST} if rests else {FIRST: now + REST, ALL: now + STAY}
                self._changed.notify()

    @property
    def busy(self) -> bool:
        """Whether something that was asked for is not looked up, solved and drawn yet."""
        return bool(self._plan) or self._at_work or self._explorer.patches.left(self) > 0

    def fitted(self, chosen: Chosen) -> Range | None:
        """The ends of the scale that suit what is in view; None for a picture without one scale."""
        sight = self.sight
        if sight is None:
            return None
        ds = self._explorer.known.seen(chosen.plane, sight, chosen.names)
        return _drawn(ds, replace(chosen, overlays=()), WHOLE).ends

    def close(self) -> None:
        """Paint no more, and want nothing more."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._explorer.listen(self, None)

    def wait(self) -> None:
        """Wait until a painter that is closed has ended."""
        self._thread.join()

    def _told(self, plane: SubjectPlane, key: TileKey) -> None:
        if self._asked and self._concerns(self._asked[0], plane, key):
            with self._changed:
                self._plan.setdefault(None, self._rested)
                self._changed.notify()

    def _concerns(self, chosen: Chosen, plane: SubjectPlane, key: TileKey) -> bool:
        """Whether a tile is seen in a picture."""
        return plane == chosen.plane and self.sight is not None and self.sight.shows(key)

    def _mistaken(self, error: str) -> None:
        """Say what went wrong with a picture, and plan it anew if it was not begun."""
        self._refuse(f"this picture could not be made: {error}")
        with self._changed:
            if self._asked is not None and self._asked != self._looked:
                self._plan.setdefault(ALL, time.monotonic() + REST)

    def _serve(self) -> None:
        given_back, used = time.monotonic(), False
        while True:
            if used and time.monotonic() >= given_back + GIVE_BACK:  # also where there is always more to be drawn
                give_back_memory()
                given_back, used = time.monotonic(), False
            with self._changed:
                if self._closed:
                    break
                step, now = min(self._plan, key=self._plan.__getitem__, default=None), time.monotonic()
                times = [*self._plan.values(), *([given_back + GIVE_BACK] if used else [])]
                if not self._plan or self._plan[step] > now:
                    self._changed.wait(max(0.0, min(times) - now) if times else None)
                    continue
                del self._plan[step]
                self._at_work = used = True
            try:
                if step is not None:
                    self._find(step)
                elif self._looked == self._asked:  # else another view is about to be looked up
                    self._paint()
            except (InputError, RunError) as error:
                self._refuse(str(error))
            except OSError as error:
                self._refuse(f"the store cannot be read: {error.strerror or error}")
            finally:
                self._at_work = False
        self._explorer.listen(self, None)

    def _find(self, stages: range) -> None:
        """Find out what is known of a view, show it, and have these stages of the rest solved."""
        self._looked = asked = self._asked
        if asked is None:
            return
        (chosen, size), explorer = asked, self._explorer
        self.looked += 1
        self.sight = sight = explorer.subject.sight(chosen.x, chosen.y, size)
        explorer.patches.want(self, ())
        explorer.known.look(chosen.plane, sight, chosen.names)
        explorer.want(self, chosen.plane, sight, stages)
        self._paint()

    def _paint(self) -> None:
        asked, sight = self._asked, self.sight
        if asked is None or sight is None:
            return
        (chosen, size), begin = asked, time.monotonic()
        ds, (x, y) = self._cells(chosen, sight), self._edges(chosen, sight)
        pixels = (
            _pixels(size[0], x, chosen.x, self._explorer.subject.x.log),
            _pixels(size[1], y, chosen.y, self._explorer.subject.y.log),
        )
        ends = self._ends(chosen)
        made, note = self._drawn(ds, chosen, pixels, ends)
        pending = float(np.mean(ds[REGIME.name].values == PENDING))
        if made.ends is not None and pending <= SETTLED and chosen.vmin is None and chosen.vmax is None:
            self._scales.setdefault(chosen.scale, made.ends)
        seconds = time.monotonic() - begin
        if asked == self._asked:
            shares = self._explorer.known.shares(chosen.plane, sight)
            self._deliver(Painted(made, x, y, made.ends or ends, note, shares))
        with self._changed:
            self._rested = begin + max(PAUSE, seconds / SHARE)
            if None in self._plan:
                self._plan[None] = self._rested

    def _cells(self, chosen: Chosen, sight: Sight) -> "xr.Dataset":
        """The cells of a picture."""
        return self._explorer.known.seen(chosen.plane, sight, chosen.names)

    def _edges(self, chosen: Chosen, sight: Sight) -> tuple[Range, Range]:
        """The window that they fill."""
        return self._explorer.subject.edges(sight)

    def _drawn(self, ds: "xr.Dataset", chosen: Chosen, pixels: tuple[int, int], ends: Ends) -> tuple[Screen, str]:
        """A picture with the lines that can be drawn, and why others cannot."""
        why = chosen.without_curves(self._explorer.subject)
        if why and chosen.kind == CHART:
            raise InputError(why)
        lacking, shown = [why] if why else [], replace(chosen, overlays=chosen.drawn(self._explorer.subject))
        while True:
            try:
                return _drawn(ds, shown, pixels, ends, numbers=True), "; ".join(lacking)
            except OverlayError as error:
                lacking.append(str(error))
                kept = tuple(name for name in shown.overlays if name != error.overlay)
                shown = replace(shown, overlays=kept)

    def _ends(self, chosen: Chosen) -> Ends:
        """The ends of the scale: those asked for, those held, those of the whole plane; None for the picture's own."""
        if chosen.scale not in self._scales:
            self._scales |= self._whole(chosen)
        low, high = self._scales.get(chosen.scale, (None, None))
        return low if chosen.vmin is None else chosen.vmin, high if chosen.vmax is None else chosen.vmax

    def _whole(self, chosen: Chosen) -> dict[tuple[object, ...], Range]:
        """The ends that suit the whole plane of the atlas, as far as it is known."""
        subject = self._explorer.subject
        if subject.ds is None or not has_scale(chosen.kind):
            return {}
        sight = subject.sight(subject.x.ends, subject.y.ends, WHOLE)
        ds = self._explorer.known.seen(subject.plane, sight, chosen.names)
        if float(np.mean(ds[REGIME.name].values == PENDING)) > 0.5:
            return {}
        made = _drawn(ds, replace(chosen, overlays=()), WHOLE)
        return {} if made.ends is None else {chosen.scale: made.ends}


def _drawn(
    ds: "xr.Dataset", chosen: Chosen, pixels: tuple[int, int], ends: Ends = (None, None), numbers: bool = False
) -> Screen:
    """A picture of what is chosen, with these ends of its scale where it has one that takes any."""
    return screen(ds, chosen.kind, pixels, KEY_WIDTH, numbers=numbers, **chosen.look(ends))


def _pixels(pixels: int, edges: Range, window: Range, log: bool) -> int:
    """Pixels of a picture whose ends reach a little over the window's."""
    spans = [math.log(high / low) if log else high - low for low, high in (edges, window)]
    return max(16, round(pixels * spans[0] / spans[1]))
