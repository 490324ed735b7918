"""The connection of a live page: it takes the requests of a page, and sends answers, pictures and what panels tell.

The browser holds the state of the page. Each request has it as the query of an address, so the server keeps only what
it is computing for the latest one.
"""

import json
import logging
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tornado.escape import parse_qs_bytes
from tornado.ioloop import PeriodicCallback

from atlas.errors import InputError
from atlas.explore.actions import new_atlas, picture_file
from atlas.explore.background import BackgroundTasks
from atlas.explore.branches import initial_follow
from atlas.explore.cut_panel import CutPanel
from atlas.explore.details_panel import DetailsPanel
from atlas.explore.explorer import Explorer
from atlas.explore.live.page import CELLS, page_of
from atlas.explore.picture_renderer import PictureRenderer, RenderedPicture
from atlas.explore.text import plain, progress
from atlas.explore.threads import why
from atlas.explore.view_state import (
    ViewState,
    carry_over,
    explorer_for_query,
    followable,
    from_address,
    place_query,
    style_query,
)

MIN_PLANE_PIXELS, MAX_PLANE_PIXELS = 16, 16384
"""Minimum and maximum width and height, in pixels, of a plane that is drawn."""
PROGRESS_MILLISECONDS = 500
"""Time, in milliseconds, between two looks at the progress, which is sent if it has changed."""

Arguments = Mapping[str, list[bytes]]
Work = Callable[[], dict[str, Any]]
"""Work in a thread of the page that returns the fields of an answer."""


def opened(home: Explorer, arguments: Arguments) -> tuple[Explorer, ViewState, str]:
    """Return the explorer and the view that an address asks for, and why they are not those; empty if they are.

    ``home`` is the explorer of the address without arguments, which an invalid address shows.
    """
    try:
        explorer = explorer_for_query(home, arguments)
        return explorer, from_address(explorer.subject, arguments), ""
    except InputError as error:
        return home, from_address(home.subject, {}), str(error)


def page_for(home: Explorer, arguments: Arguments) -> str:
    """Return the HTML of the page for the arguments of an address."""
    explorer, view, trouble = opened(home, arguments)
    return page_of(home.subject, explorer.subject, view, trouble)


class PageConnection:
    """The server's side of one page, in one tab of a browser. It must be created in the server's thread.

    home        explorer of the axes and layer that an address without a query means
    folder      folder in which specs of new atlases are written
    send        sends a text or bytes to the browser
    arguments   arguments of the page's address, which choose its axes and layer
    """

    def __init__(self, home: Explorer, folder: Path, send: Callable[[str | bytes], None], arguments: Arguments) -> None:
        self._home, self._folder, self._send = home, folder, send
        self._explorer, self._view, _ = opened(home, arguments)
        self._subject = self._explorer.subject
        self._background = BackgroundTasks(lambda reason: self.tell("refused", reason=reason))
        deferred, tell = self._background.deferred_call, self.tell
        self.painter = PictureRenderer(self._explorer, deferred(self._show), deferred(self._unpainted))
        self._details = DetailsPanel(self._explorer, self._background, tell, lambda: self.painter.sight)
        self._cut = CutPanel(self._explorer, self._background, tell)
        self._missing, self._shares, self._progress = "", tuple[float, ...](), dict[str, Any]()
        self._asks: dict[str, Callable[..., Work | None]] = {
            "view": self._ask_view, "cell": self._ask_cell, "follow": self._ask_follow, "find": self._ask_find,
            "turn": self._ask_turn, "save": self._ask_save, "make": self._ask_make,
        }  # fmt: skip
        self._timer = PeriodicCallback(self._tell_progress, PROGRESS_MILLISECONDS)
        self._timer.start()

    def close(self) -> None:
        """Stop the threads of the page, and cancel its jobs."""
        self._timer.stop()
        self._background.close()
        self._details.close()
        self._cut.close()
        self.painter.close()

    @property
    def is_closed(self) -> bool:
        """True once the page is closed."""
        return self._background.closed

    def wait(self) -> None:
        """Wait until all threads of a closed page have ended."""
        self.painter.wait()
        self._background.wait()

    def tell(self, what: str, **fields: Any) -> None:
        """Send what the page did not ask for, such as the progress, see ``text.plain``."""
        self._send(json.dumps({"tell": what, **plain(fields)}, allow_nan=False, ensure_ascii=False))

    def hear(self, text: str | bytes) -> None:
        """Take a request of the page, which is JSON, and answer it: {ask, id, query, ...}.

        The answer has the request's id, and the reason as ``error`` if the request is refused.
        """
        number: Any = None
        try:
            given = json.loads(text)
            number, ask, query = given.pop("id"), given.pop("ask"), given.pop("query")
            act = self._asks[ask]
        except (ValueError, KeyError, TypeError, AttributeError):
            self._answer(number, error="this is no request of a page")
            return
        refuse = partial(self._refuse, number)
        try:
            work = act(from_address(self._subject, parse_qs_bytes(query)), **given)
        except InputError as error:
            refuse(str(error))
        except Exception as error:
            logging.getLogger(__name__).exception("a request of a page could not be answered")
            refuse(f"this could not be done: {why(error)}")
        else:
            if work is None:
                self._answer(number)
            else:
                self._background.run(partial(self._done, number, work), refuse)

    def _answer(self, number: Any, **fields: Any) -> None:
        self._send(json.dumps({"id": number, **fields}, ensure_ascii=False))

    def _refuse(self, number: Any, reason: str) -> None:
        self._answer(number, error=reason)

    def _done(self, number: Any, work: Work) -> Callable[[], None]:
        return partial(self._answer, number, **work())

    def _ask_view(self, view: ViewState, size: list[int], rests: bool, shows: str) -> None:
        """Show a view, for a plane of ``size`` (width, height) in pixels; ``rests`` is False while a slider moves."""
        width, height = (min(MAX_PLANE_PIXELS, int(pixels)) for pixels in size)
        self._view = view
        self._details.show(view)
        self._cut.show(view, shows)
        if min(width, height) >= MIN_PLANE_PIXELS:
            self.painter.show(view, (width, height), rests)

    def _ask_cell(self, view: ViewState, at: list[float]) -> Work:
        """Answer the point of the cell of the viewport nearest to a point, whether the cell is known yet or not."""
        x, y, sight = float(at[0]), float(at[1]), self.painter.sight
        known = self._explorer.known
        return lambda: {"cell": (x, y) if sight is None else known.point(view.plane, sight, x, y)}

    def _ask_follow(self, view: ViewState, along: str) -> Work:
        """Answer the state in which the orbit of the chosen cell begins to be followed along a parameter."""
        if view.cell is None or along not in followable(self._subject):
            raise InputError(f"follow: found {along!r} and no cell, must be a parameter and a cell")
        follow = initial_follow(self._subject, view, view.cell, along)
        return lambda: {"follow": follow.text}

    def _ask_find(self, view: ViewState, value: float | None) -> Work:
        """Answer the state in which the followed orbit has a value of the parameter."""
        follow = self._details.follow.find(view, value)
        return lambda: {"follow": follow.text}

    def _ask_turn(self, view: ViewState, axes: list[str] | None = None, layer: float | None = None) -> Work:
        """Answer the query of the page of other axes or of another layer of a stack.

        The new plane goes through the chosen cell, or else through the middle of the window.
        """
        subject = self._subject
        names = subject.axes if axes is None else (axes[0], axes[1])
        turned = self._home.explorer_for_axes(names, subject.layer_value if layer is None else layer).subject
        values = subject.values(view.plane, *view.middle(subject))
        if layer is not None and turned.stack_axis is not None:
            values[turned.stack_axis.name] = layer
        new_view = carry_over(turned, view, values, keep_window=axes is None)
        query = f"{place_query(self._home.subject, turned, new_view)}&{style_query(new_view)}"
        return lambda: {"query": query}

    def _ask_save(self, view: ViewState, suffix: str) -> Work:
        """Answer the picture of the visible cells as a file: its name and its content as a data URL."""
        sight, ends = self.painter.sight, self.painter.ends(view)
        if sight is None:
            raise InputError("there is no picture yet")

        def work() -> dict[str, Any]:
            name, href = picture_file(self._explorer, view, sight, suffix, ends)
            return {"name": name, "href": href}

        return work

    def _ask_make(self, view: ViewState, box: list[list[float]] | None = None, cells: int = CELLS) -> Work:
        """Write the spec of an atlas of the view, or of a box in it, and answer it with its command and its cost."""
        (left, right), (low, high) = box or (view.x, view.y)

        def work() -> dict[str, Any]:
            new_spec = new_atlas(self._subject, view, (left, right), (low, high), max(2, cells), self._folder)
            return {"file": str(new_spec.file), "text": new_spec.text, "line": new_spec.line, "cost": new_spec.cost}

        return work

    def _show(self, picture: RenderedPicture) -> None:
        self._send(picture.message.tobytes())
        self._missing, self._shares = picture.note, picture.shares
        self._tell_progress()
        self._details.show(self._view)  # the cell of the address, which needs a viewport to be found

    def _unpainted(self, reason: str) -> None:
        """Remove the picture, since it may show an older view, and tell the reason why there is no new picture."""
        self._missing, self._shares = "", ()
        self.tell("picture", reason=reason)

    def _tell_progress(self) -> None:
        state, left = self._explorer.patches.state, self._explorer.patches.n_remaining(self.painter)
        now = {
            "text": progress(state, left, self._notes(), self._shares),
            "trouble": "; ".join(filter(None, (self._missing, state.trouble))),
            "share": float(np.mean(self._shares)) if self._shares else 0.0,
        }
        if now != self._progress:
            self._progress = now
            self.tell("progress", **now)

    def _notes(self) -> list[str]:
        subject, view = self._subject, self._view
        notes = [f"exploring tolerance {subject.settings.tolerance:g}"]
        for lattice, (low, high) in ((subject.x, view.x), (subject.y, view.y)):
            first, last = lattice.ends
            slack = 1e-9 * (last - first)
            if low < first - slack or high > last + slack:
                notes.append("partly outside the atlas's window")
                break
        if view.plane != subject.plane:
            notes.append("not the plane of the atlas")
        failed = sum(1 for plane, _ in list(self._explorer.failures) if plane == view.plane)
        return notes + ([f"{failed} tiles failed"] if failed else [])
