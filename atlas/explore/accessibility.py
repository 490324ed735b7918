"""Access to the explorer's page by keyboard, touch and screen reader: visible focus, sizes, names and keys.

Arrows move the window, + and - zoom it, and two fingers zoom. Enter on the plane chooses the cell in its middle. Esc
ends a followed orbit, the cut or an enlarged picture.
"""

from collections.abc import Callable
from typing import Any

from bokeh.document import Document
from bokeh.events import DocumentReady
from bokeh.models import ColumnDataSource
from bokeh.plotting import figure
from bokeh.themes import Theme

from atlas.explore.front.script import call, page_script
from atlas.explore.style import FOCUS

HEAD = """
{% block preamble %}<meta name="viewport" content="width=device-width, initial-scale=1">
<script>{{ page_script }}</script>{% endblock %}
"""
"""Head of the page. Without its viewport, a phone would lay the page out as wide as on a desktop."""


def accessible_name(text: str) -> dict[str, Any]:
    """Return the HTML attributes by which a screen reader announces a Bokeh model as a group with the name ``text``."""
    return {"role": "group", "aria-label": text}


def make_accessible(document: Document) -> None:
    """Mark the focused widget of a page visibly, and have the browser name the elements that have no label."""
    document.template = HEAD
    document.template_variables["page_script"] = page_script()
    document.theme = Theme(json={"attrs": {"Widget": {"stylesheets": [FOCUS]}, "Toolbar": {"stylesheets": [FOCUS]}}})
    document.js_on_event(DocumentReady, call("nameAll"))


def install_key_handler(
    document: Document,
    plot: figure,
    show_window: Callable[[tuple[float, float], tuple[float, float]], None],
    escape: Callable[[], None],
    choose: Callable[[float, float], None],
) -> ColumnDataSource:
    """Install the key handler of a page, and return the Bokeh data source with which the browser reports the keys.

    document      the document of the page, of which the returned source must become a part
    plot          the plot of the plane
    show_window   called with the new limits (low, high) of both axes when keys or fingers move or zoom the window
    escape        called for Esc
    choose        called with the point (x, y) of the cell that Enter chooses
    """
    heard = ColumnDataSource({"x": [], "y": []})

    def hear(attribute: str, old: object, new: dict[str, list[float]]) -> None:
        if "escape" in new:
            escape()
        elif "cell" in new:
            choose(*new["cell"][:2])
        else:
            (left, right), (low, high) = new["x"], new["y"]
            show_window((float(left), float(right)), (float(low), float(high)))

    heard.on_change("data", hear)
    document.js_on_event(DocumentReady, call("hearKeys", heard=heard, plot=plot))
    return heard
