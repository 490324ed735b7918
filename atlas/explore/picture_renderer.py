"""The pictures of a page, made in a thread of their own.

For each view the thread looks up the known cells, sends a picture, requests the unknown tiles, and sends further
pictures as tiles are solved. Each of these steps is planned for a time. A new view cancels the steps that are still
planned.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError, RunError
from atlas.explore.explorer import Explorer
from atlas.explore.plane_message import ends_of, maps_of, message
from atlas.explore.subject import PlaneParameters
from atlas.explore.threads import restarting_thread
from atlas.explore.view_state import Ends, Range, ViewState, initial_view
from atlas.explore.viewport import STAGES, TileKey, Viewport
from atlas.platform import release_memory
from workers.results import PENDING, REGIME

REST_SECONDS, FIRST_REST_SECONDS = 0.15, 0.03
"""Times, in seconds without a change, after which cells are looked up for a view, and for the first view of a page."""
FULL_SOLVE_SECONDS = 0.7
"""Time, in seconds, for which a slider must rest before cells are solved at all densities, not only at the coarsest."""
RELEASE_MEMORY_SECONDS = 10.0
"""Minimum time, in seconds, between two releases of freed memory to the system."""
MIN_FRAME_SECONDS = 0.35
"""Minimum time, in seconds, between two pictures."""
MAX_RENDER_SHARE = 0.6
"""Maximum share of a renderer's time that is spent on drawing, so that solving is not held up."""
LIMITS_PICTURE_PIXELS = (240, 180)
"""Width and height, in pixels, of the picture of the whole plane from which colour limits are taken."""
MAX_PENDING_SHARE = 0.01
"""Maximum share of unsolved cells in a picture from which colour limits are taken."""

COARSEST_STAGE, ALL_STAGES = range(STAGES, STAGES - 1, -1), range(STAGES, -1, -1)
"""Numbers of halvings of the full density at which cells are solved while a slider moves, and once it rests."""


@dataclass(frozen=True)
class RenderedPicture:
    """A picture of the visible cells, as sent to the browser.

    message   bytes from which the browser draws the picture
    note      note about the picture, such as why requested overlays are missing
    shares    share of the viewport that is known at each density of cells, the coarsest first
    """

    message: NDArray[np.uint8]
    note: str
    shares: tuple[float, ...]


def warm_up(explorer: Explorer) -> None:
    """Make a picture once, so that the first page does not wait for the modules and caches that a picture loads."""
    view = initial_view(explorer.subject)
    sight = explorer.subject.viewport(view.x, view.y, LIMITS_PICTURE_PIXELS)
    seen = explorer.known.visible_cells(view.plane, sight, view.names)
    message(seen, explorer.subject, view, maps_of(seen, view, others=True), {}, LIMITS_PICTURE_PIXELS)


class PictureRenderer:
    """Makes the pictures of one page in a thread.

    explorer   the explorer that looks up and solves cells
    deliver    called in the renderer's thread with each picture
    on_error   called in the renderer's thread with the reason why there is no picture
    n_lookups  number of times that cells were looked up
    sight      viewport of the last look-up; None before the first
    """

    def __init__(
        self, explorer: Explorer, deliver: Callable[[RenderedPicture], None], on_error: Callable[[str], None]
    ) -> None:
        self._explorer, self._deliver, self._refuse = explorer, deliver, on_error
        self._changed, self._closed, self._at_work = threading.Condition(), False, False
        self._asked: tuple[ViewState, tuple[int, int]] | None = None
        self._looked: tuple[ViewState, tuple[int, int]] | None = None
        self._plan: dict[range | None, float] = {}
        self._rested = 0.0
        self._scales: dict[str, Range] = {}
        self._views, self._view = count(), 0
        self._sent: tuple[str, list[str], tuple[str, ...]] | None = None
        self._found: tuple[PlaneParameters, Viewport] | None = None
        self.n_lookups = 0
        self.sight: Viewport | None = None
        explorer.subscribe(self, self._plan_repaint)
        self._thread = restarting_thread("atlas-painter", self._serve, self._mistaken)

    def show(self, view: ViewState, size: tuple[int, int], rests: bool = True) -> None:
        """Have pictures of a view made, for a plane of ``size`` (width, height) in pixels.

        If not ``rests``, a slider is moving: cells are solved at the coarsest density only, until the slider rests.
        """
        picture, now = (view.picture, size), time.monotonic()
        with self._changed:
            if picture != self._asked:
                self._asked = picture
                soon = now + (FIRST_REST_SECONDS if self._looked is None else REST_SECONDS)
                self._plan = (
                    {ALL_STAGES: soon} if rests else {COARSEST_STAGE: soon, ALL_STAGES: now + FULL_SOLVE_SECONDS}
                )
                self._changed.notify()

    @property
    def is_busy(self) -> bool:
        """True until the requested view has been looked up, solved and drawn."""
        return bool(self._plan) or self._at_work or self._explorer.patches.n_remaining(self) > 0

    def ends(self, view: ViewState) -> Ends:
        """Return the lower and upper colour limit of the map of a view.

        They are the limits that the view sets, or else those fixed for this map by its first picture. A limit is None
        if it is unknown.
        """
        low, high = self._scales.get(view.map, (None, None))
        return low if view.vmin is None else view.vmin, high if view.vmax is None else view.vmax

    def close(self) -> None:
        """Stop the thread and cancel its jobs."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._explorer.subscribe(self, None)

    def wait(self) -> None:
        """Wait until the thread of a closed renderer has ended."""
        self._thread.join()

    def _plan_repaint(self, plane: PlaneParameters, key: TileKey) -> None:
        """Plan another picture if the solved tile ``key`` is visible in the last picture."""
        if self._asked and plane == self._asked[0].plane and self.sight is not None and self.sight.contains(key):
            with self._changed:
                self._view = next(self._views)
                self._plan.setdefault(None, self._rested)
                self._changed.notify()

    def _mistaken(self, error: str) -> None:
        """Report an exception in the renderer's thread. Plan the picture again if its cells were not looked up yet."""
        self._say_no(f"this picture could not be made: {error}")
        with self._changed:
            if self._asked is not None and self._asked != self._looked:
                self._plan.setdefault(ALL_STAGES, time.monotonic() + REST_SECONDS)

    def _say_no(self, reason: str) -> None:
        """Report the reason why there is no picture.

        The page then shows none, so that no picture of an older view remains.
        """
        self._sent = None
        self._refuse(reason)

    def _serve(self) -> None:
        given_back, used = time.monotonic(), False
        while True:
            if used and time.monotonic() >= given_back + RELEASE_MEMORY_SECONDS:  # even if there is always more to draw
                release_memory()
                given_back, used = time.monotonic(), False
            with self._changed:
                if self._closed:
                    break
                step, now = min(self._plan, key=self._plan.__getitem__, default=None), time.monotonic()
                times = [*self._plan.values(), *([given_back + RELEASE_MEMORY_SECONDS] if used else [])]
                if not self._plan or self._plan[step] > now:
                    self._changed.wait(max(0.0, min(times) - now) if times else None)
                    continue
                del self._plan[step]
                self._at_work = used = True
            try:
                if step is not None:
                    self._find(step)
                elif self._looked == self._asked:  # otherwise another view is about to be looked up
                    self._paint()
            except (InputError, RunError) as error:
                self._say_no(str(error))
            except OSError as error:
                self._say_no(f"the store cannot be read: {error.strerror or error}")
            finally:
                self._at_work = False
        self._explorer.subscribe(self, None)

    def _find(self, stages: range) -> None:
        """Look up the known cells of the requested view, send their picture, and request the unknown cells.

        ``stages`` are the numbers of halvings of the full density at which cells are requested, in this order.
        """
        self._looked = picture = self._asked
        if picture is None:
            return
        (view, size), explorer = picture, self._explorer
        self.n_lookups += 1
        sight = explorer.subject.viewport(view.x, view.y, size)
        if (view.plane, sight) != self._found:
            self._view, self._found = next(self._views), (view.plane, sight)
        self.sight = sight
        explorer.patches.request(self, ())
        self._paint()
        explorer.request_tiles(self, view.plane, sight, stages)

    def _paint(self) -> None:
        picture, sight = self._asked, self.sight
        if picture is None or sight is None:
            return
        (view, size), begin, explorer = picture, time.monotonic(), self._explorer
        of = f"{id(self)}-{self._view}"
        seen = replace(explorer.known.visible_cells(view.plane, sight, view.names), view_id=of)
        stages = seen.stages
        maps = maps_of(seen, view, others=not stages.any())
        self._hold(view, [coded_map.name for coded_map in maps])
        if np.mean(seen.ds[REGIME.name].values == PENDING) <= MAX_PENDING_SHARE:
            self._scales = {coded_map.name: ends for coded_map in maps if (ends := ends_of(coded_map))} | self._scales
        content, note = message(seen, explorer.subject, view, maps, self._scales, size)
        shares = tuple(float(np.mean(stages <= stage)) for stage in range(STAGES, -1, -1))
        seconds = time.monotonic() - begin
        sent = (of, [coded_map.name for coded_map in maps], view.overlays)
        if picture == self._asked and sent != self._sent:
            self._sent = sent
            self._deliver(RenderedPicture(content, note, shares))
        with self._changed:
            self._rested = begin + max(MIN_FRAME_SECONDS, seconds / MAX_RENDER_SHARE)
            if None in self._plan:
                self._plan[None] = self._rested

    def _hold(self, view: ViewState, names: list[str]) -> None:
        """Fix the colour limits of the maps ``names``, so that they stay the same when the user zooms.

        The limits are those of the whole plane of the atlas, if more than half of its cells are known.
        """
        subject = self._explorer.subject
        if subject.ds is None or self._scales.keys() >= set(names):
            return
        sight = subject.viewport(subject.x.ends, subject.y.ends, LIMITS_PICTURE_PIXELS)
        cells = self._explorer.known.visible_cells(subject.plane, sight, view.names)
        if np.mean(cells.ds[REGIME.name].values == PENDING) <= 0.5:
            maps = [coded_map for coded_map in maps_of(cells, view, others=True) if coded_map.name in names]
            self._scales = {coded_map.name: ends for coded_map in maps if (ends := ends_of(coded_map))} | self._scales
