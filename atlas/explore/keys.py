"""The keyboard: arrows move the view, + and - zoom it, Enter on the plane chooses the cell in its middle, Esc ends a
followed orbit, the cut or what is enlarged; and two fingers, which zoom.
"""

from collections.abc import Callable

from bokeh.document import Document
from bokeh.events import DocumentReady
from bokeh.models import ColumnDataSource
from bokeh.plotting import figure

from atlas.explore.front.script import call

SHARE = 0.1
"""How far an arrow moves the view, as a share of it."""
FACTOR = 1.25
"""How far + and - zoom."""


def hear_keys(
    document: Document,
    plot: figure,
    logs: list[bool],
    moved: Callable[[tuple[float, float], tuple[float, float]], None],
    escaped: Callable[[], None],
    chose: Callable[[float, float], None],
) -> ColumnDataSource:
    """Have the keys of a page heard; the source returned has to be sent along with the page."""
    heard = ColumnDataSource({"x": [], "y": []})

    def hear(attribute: str, old: object, new: dict[str, list[float]]) -> None:
        if "escape" in new:
            escaped()
        elif "cell" in new:
            chose(*new["cell"][:2])
        else:
            (left, right), (low, high) = new["x"], new["y"]
            moved((float(left), float(right)), (float(low), float(high)))

    heard.on_change("data", hear)
    args = {"heard": heard, "plot": plot, "logs": logs, "share": SHARE, "factor": FACTOR}
    document.js_on_event(DocumentReady, call("hearKeys", **args))
    return heard
